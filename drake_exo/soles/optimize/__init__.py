"""Shapes of least cost, and what they are worth."""
