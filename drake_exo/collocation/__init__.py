"""Trajectories of planar models as mathematical programs."""
