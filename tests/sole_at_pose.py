"""Contact forces of a sole that is held at a pose, by either method."""

import numpy as np

from drake_exo.soles.contact.newton import ContactSolver, State, Target


def contact_at_pose(solver: ContactSolver, R, O, reference, guess=None):  # noqa: E741
    """Forces at a given pose (Algorithm 3), by either solver.

    Args:
        solver: Semismooth Newton or Gauss–Seidel; friction 0 is allowed.
        R: Orientation (3, 3).
        O: Place of the sole frame's origin, world [m].
        reference: Places at the sample before (m, 3) [m].
        guess: Forces to start from (m, 3), default none.

    Returns:
        State with the forces, Convergence.
    """
    F = np.zeros_like(solver.lP) if guess is None else guess
    stiffness = 1.0 / np.median(np.diag(solver.C)[2::3])
    lowest = -((solver.lP @ R.T)[:, 2] + O[2]).min()
    scale = max(stiffness * max(lowest, 0.0), 1e-6)
    force = np.array([0.0, 0.0, scale])
    target = Target(force, np.zeros(2), reference, is_held=True)
    return solver.solve(State(F, np.array(O), np.array(R)), target)
