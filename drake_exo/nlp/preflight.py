"""What can be told before a solve: the faults that waste one."""

import numpy as np

from drake_exo.errors import InputError
from drake_exo.nlp.sparse import SparseProgram

# Below this a parameter moves no residual, in the units of the residuals.
_INFLUENCE = 1e-9


def check(
    problem: SparseProgram,
    guess: np.ndarray,
    parameters: dict[str, int],
) -> None:
    """Check guess, bounds and the influence of parameters.

    Args:
        problem: the compiled program.
        guess: (num_vars,) program variables.
        parameters: program index of each free parameter by name.

    Raises:
        InputError: the guess holds NaN, bounds exclude each other, a
            function is not finite at the guess, or a parameter moves neither
            a constraint nor a residual.
    """
    names = [v.get_name() for v in problem.program.prog.decision_variables()]
    if not np.isfinite(guess).all():
        bad = int(np.flatnonzero(~np.isfinite(guess))[0])
        raise InputError(
            f"the guess of {names[bad]} is {guess[bad]}; check the trial's "
            "data for gaps"
        )
    for lower, upper, what in (
        (problem.y_lower, problem.y_upper, "a variable"),
        (problem.g_lower, problem.g_upper, "a constraint"),
    ):
        if (lower > upper).any():
            raise InputError(
                f"{what} has a lower bound above its upper bound; check the "
                "bounds of parameters and end states"
            )
    y = problem.restrict(guess)
    g = problem.constraints(y)
    if not np.isfinite(g).all():
        row = int(np.flatnonzero(~np.isfinite(g))[0])
        raise InputError(
            f"{problem.rows.name(row)} is not finite at the guess; check the "
            "trial's data and the parameters' nominal values"
        )
    influence = _influence(problem, y)
    for name, index in parameters.items():
        columns = problem.unknowns.matrix[[index]].indices
        if influence[columns].max(initial=0.0) <= _INFLUENCE:
            raise InputError(
                f"parameter {name} influences nothing that was measured; fix "
                "it (free: false) or add data that depends on it"
            )


def _influence(problem, y):
    """Largest derivative of any constraint or residual by each unknown."""
    _, columns = problem.jacobian_structure
    influence = np.zeros(problem.num_unknowns)
    np.maximum.at(influence, columns, np.abs(problem.jacobian(y)))
    for block in problem.residual_blocks:
        J = np.abs(block.jacobian(problem.expand(y))).max(axis=1)
        keep = block.columns >= 0
        np.maximum.at(influence, block.columns[keep], J[keep])
    return influence
