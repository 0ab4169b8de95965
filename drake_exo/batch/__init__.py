"""Many tasks on many processes or machines, and tables of their results."""
