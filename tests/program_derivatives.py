"""A check of a program's derivatives that fails when it checked nothing."""

import numpy as np
import scipy.sparse as sp

from drake_exo.nlp.sparse import SparseProgram


class DerivativeError(AssertionError):
    """A derivative differs from finite differences, or none was checked."""


def check_derivatives(
    problem: SparseProgram,
    y: np.ndarray,
    directions: int = 8,
    step: float = 1e-6,
    tolerance: float = 1e-5,
    seed: int = 0,
) -> float:
    """Compare gradient and Jacobian with central directional differences.

    Args:
        problem: the compiled program.
        y: (ny,) unknowns.
        directions: random directions, each over all unknowns.
        step: along a direction of unit entries.
        tolerance: relative to the largest derivative along the direction.
        seed: of the directions.

    Returns:
        The largest relative difference found.

    Raises:
        DerivativeError: a derivative is wrong (the row is named), or the
            program has neither cost nor constraint that depends on y.
    """
    rng = np.random.default_rng(seed)
    rows, columns = problem.jacobian_structure
    J = sp.csr_array(
        (problem.jacobian(y), (rows, columns)),
        shape=(problem.num_constraints, problem.num_unknowns),
    )
    gradient = problem.gradient(y)
    if not np.abs(gradient).any() and not np.abs(J.data).any():
        raise DerivativeError(
            "nothing was checked: no cost nor constraint depends on y here"
        )
    worst = 0.0
    for _ in range(directions):
        d = rng.choice([-1.0, 1.0], problem.num_unknowns)
        up, down = y + step * d, y - step * d
        g = (problem.constraints(up) - problem.constraints(down)) / (2 * step)
        error = np.abs(J @ d - g)
        scale = max(np.abs(g).max(initial=0.0), 1.0)
        if error.max(initial=0.0) > tolerance * scale:
            row = int(error.argmax())
            raise DerivativeError(
                f"{problem.rows.name(row)}: derivative {(J @ d)[row]:.9g} "
                f"along a direction, but differences give {g[row]:.9g}"
            )
        f = (problem.objective(up) - problem.objective(down)) / (2 * step)
        slope = float(gradient @ d)
        size = max(abs(f), np.abs(gradient).max(), 1.0)
        if abs(slope - f) > tolerance * size:
            raise DerivativeError(
                f"cost: derivative {slope:.9g} along a direction, but "
                f"differences give {f:.9g}"
            )
        worst = max(
            worst, error.max(initial=0.0) / scale, abs(slope - f) / size
        )
    return worst
