"""A sole through one contact phase."""
