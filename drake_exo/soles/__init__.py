"""Compliant soles: elasticity, contact, stiffness, optimisation."""
