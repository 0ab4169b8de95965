"""Small programs that stand for large ones."""

import numpy as np

from drake_exo.nlp.program import BatchedProgram, LinearKernel


class Rosenbrock:
    """Residuals (1 - x, 10 (y - x^2)) of each pair."""

    sparsity = np.array([[True, False], [True, True]])

    def evaluate(self, x, data):
        return np.stack(
            [1.0 - x[:, 0], 10.0 * (x[:, 1] - x[:, 0] ** 2)], axis=1
        )

    def jacobian(self, x, data):
        J = np.zeros((len(x), 2, 2))
        J[:, 0, 0], J[:, 1, 0], J[:, 1, 1] = -1.0, -20.0 * x[:, 0], 10.0
        return J


class Circle:
    """Squared distance from the origin."""

    sparsity = np.ones((1, 2), bool)

    def evaluate(self, x, data):
        return np.sum(x**2, axis=1)[:, None]

    def jacobian(self, x, data):
        return 2.0 * x[:, None, :]


def valleys(radius=3.0):
    """Three valleys, each on a disc; the program and its variables (3, 2)."""
    program = BatchedProgram()
    x = program.prog.NewContinuousVariables(6, "x").reshape(3, 2)
    program.add_residuals("valley", Rosenbrock(), x)
    program.add_constraints("disc", Circle(), x, -np.inf, radius)
    return program, x


PUSHES = 5


def pushed_cart(distance, limit=1.0):
    """A cart that five pushes of at most `limit` take to a distance.

    Returns:
        The program, places (6,) and pushes (5,).
    """
    program = BatchedProgram()
    prog = program.prog
    place = prog.NewContinuousVariables(PUSHES + 1, "place")
    push = prog.NewContinuousVariables(PUSHES, "push")
    program.add_constraints(
        "step",
        LinearKernel([[1.0, -1.0, 1.0]]),
        np.stack([place[:-1], place[1:], push], axis=1),
    )
    program.add_residuals("effort", LinearKernel([[1.0]]), push[:, None])
    prog.AddBoundingBoxConstraint(-limit, limit, push)
    prog.AddBoundingBoxConstraint(0.0, 0.0, place[0])
    prog.AddBoundingBoxConstraint(distance, distance, place[-1])
    when = [f"at {k} s" for k in range(PUSHES + 1)]
    program.label("limit", push[:, None], ["push"], when, [("kN", 1e-3)])
    program.label("state", place[:, None], ["place"], when, [("m", 1.0)])
    return program, place, push
