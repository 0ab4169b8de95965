"""What is learnt of the Lagrangian's curvature, carried from stage to stage.

IPOPT asks for a Hessian; it gets the exact one of the smoothness term plus a
dense BFGS matrix for all that comes out of simulations (Nocedal and Wright,
Numerical Optimization, 2nd ed., procedure 18.2: Powell's damping keeps it
positive definite). Unlike IPOPT's own limited-memory matrix nothing is
forgotten, and what cheap coarse stages taught serves the fine ones.
"""

import numpy as np

_DAMPING = 0.2


class QuasiNewton:
    """Dense damped BFGS matrix of a Lagrangian.

    Args:
        size: Number of variables.
        matrix: What an earlier stage learnt; None begins anew.
    """

    def __init__(self, size: int, matrix: np.ndarray | None = None):
        self.fresh = matrix is None
        self.matrix = 0.1 * np.eye(size) if self.fresh else matrix.copy()
        self._last = None

    def forget_point(self) -> None:
        """Keep the matrix; the next point belongs to another problem."""
        self._last = None

    def update(self, p, gradient, jacobian, multipliers) -> None:
        """Learn from an accepted point.

        Args:
            p: The point, (P,).
            gradient: Of the cost, (P,).
            jacobian: Of the constraints, (m, P).
            multipliers: Of the constraints, (m,); the same at both points.
        """
        last, self._last = self._last, (p.copy(), gradient, jacobian)
        if last is None or np.array_equal(p, last[0]):
            return
        s = p - last[0]
        y = gradient - last[1] + (jacobian - last[2]).T @ multipliers
        if self.fresh and y @ s > 0:
            self.matrix = np.eye(len(s)) * (y @ s) / (s @ s)
            self.fresh = False
        Bs = self.matrix @ s
        sBs, sy = s @ Bs, s @ y
        if sy < _DAMPING * sBs:
            share = (1 - _DAMPING) * sBs / (sBs - sy)
            y = share * y + (1 - share) * Bs
        self.matrix += np.outer(y, y) / (s @ y) - np.outer(Bs, Bs) / sBs
