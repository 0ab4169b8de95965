"""From a MathematicalProgram to IPOPT: neutral ground for both halves."""
