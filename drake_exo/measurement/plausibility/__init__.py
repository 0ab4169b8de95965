"""Whether recordings can be what they are taken for."""
