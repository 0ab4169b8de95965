"""A simulated measurement campaign with known truth, in laboratory formats."""
