"""Bounds that stand in a program."""

import numpy as np


def bounds(problem, variables):
    """Lower and upper, as the solver sees them."""
    program = problem.program
    lower = np.full(program.prog.num_vars(), -np.inf)
    upper = -lower
    for binding in program.prog.bounding_box_constraints():
        i = program.indices(np.asarray(binding.variables()))
        e = binding.evaluator()
        np.maximum.at(lower, i, e.lower_bound())
        np.minimum.at(upper, i, e.upper_bound())
    i = program.indices(variables)
    return lower[i], upper[i]
