"""Contact of the sole with the ground: the node law and its solvers."""
