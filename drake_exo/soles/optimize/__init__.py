"""Shape optimisation: problem, limits, gradients, search, design and files."""
