"""Trajectories of planar trees as mathematical programs."""
