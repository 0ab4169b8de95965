"""Contact of the sole with the ground, with friction."""
