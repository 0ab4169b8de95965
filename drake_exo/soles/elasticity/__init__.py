"""Deformation of the sole: linear and neo-Hookean."""
