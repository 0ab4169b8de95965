"""Program variables as an affine function of the solver's unknowns.

x = offset + B y. The plain choice only drops fixed variables and applies the
program's variable scaling; a transcription may hand over a sparse B whose
columns satisfy its linear constraints exactly.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from pydrake.solvers import MathematicalProgram

from drake_exo.nlp.program import variable_bounds, variable_scaling


@dataclass(frozen=True)
class Substitution:
    """Program variables as an affine function of fewer unknowns.

    Attributes:
        variables: (na,) indices of the program variables substituted.
        matrix: (na, ny) sparse; x[variables] = matrix @ y + offset.
        offset: (na,).
        scale: (ny,) typical size of each unknown.
        accuracy: (na,) how well a guess of each variable is to be kept.
    """

    variables: np.ndarray
    matrix: sp.csr_array
    offset: np.ndarray
    scale: np.ndarray
    accuracy: np.ndarray


class Unknowns:
    """What the solver varies: y, each in units of its typical size.

    First come the variables that are unknowns by themselves ("direct"), then
    the unknowns of the substitutions.

    Attributes:
        matrix, offset: B (n, ny) and offset (n,) of x = offset + B y.
        lower, upper: (ny,) bounds on y.
        x_lower, x_upper: (n,) bounds on x.
        scale: (n,) typical size of each program variable.
        substituted: indices of the variables that are not direct.
    """

    def __init__(
        self,
        prog: MathematicalProgram,
        substitutions: tuple[Substitution, ...] = (),
    ):
        n = prog.num_vars()
        self.x_lower, self.x_upper = variable_bounds(prog)
        self.scale = variable_scaling(prog)
        fixed = self.x_lower == self.x_upper
        direct = ~fixed
        for s in substitutions:
            direct[s.variables] = False
        kept = self._direct = np.flatnonzero(direct)
        unit = self.scale[kept]
        blocks = [(kept, sp.diags_array(unit).tocsr())]
        self.offset = np.where(fixed, self.x_lower, 0.0)
        self._accuracy = self.scale.copy()
        for s in substitutions:
            matrix = s.matrix @ sp.diags_array(s.scale)
            blocks.append((s.variables, matrix.tocsr()))
            self.offset[s.variables] = s.offset
            self._accuracy[s.variables] = s.accuracy
        rows = np.concatenate([b[0] for b in blocks])
        stacked = sp.block_diag([b[1] for b in blocks], format="coo")
        self.matrix = sp.csr_array(
            (stacked.data, (rows[stacked.row], stacked.col)),
            shape=(n, stacked.shape[1]),
        )
        self.lower = np.full(self.count, -np.inf)
        self.upper = np.full(self.count, np.inf)
        self.lower[: len(kept)] = self.x_lower[kept] / unit
        self.upper[: len(kept)] = self.x_upper[kept] / unit
        self.substituted = np.setdiff1d(
            np.concatenate([s.variables for s in substitutions] or [[]]),
            kept,
        ).astype(int)

    @property
    def count(self) -> int:
        """Length of y."""
        return self.matrix.shape[1]

    def expand(self, y: np.ndarray) -> np.ndarray:
        """Program variables x of unknowns y."""
        return self.offset + self.matrix @ y

    def restrict(self, x: np.ndarray) -> np.ndarray:
        """Unknowns y whose x is nearest to the given one.

        Distances of substituted variables count in units of their accuracy.
        """
        direct, rows = self._direct, self.substituted
        y = np.zeros(self.count)
        y[: len(direct)] = x[direct] / self.scale[direct]
        if len(rows):
            unit = self._accuracy[rows]
            weight = sp.diags_array(1.0 / unit)
            W = (weight @ self.matrix[rows][:, len(direct) :]).tocsc()
            r = (x[rows] - self.offset[rows]) / unit
            y[len(direct) :] = sp.linalg.spsolve(W.T @ W, W.T @ r)
        return np.clip(y, self.lower, self.upper)

    def bounded_columns(self) -> np.ndarray:
        """Direct unknowns that have a bound."""
        bounded = np.isfinite(self.lower) | np.isfinite(self.upper)
        return np.flatnonzero(bounded[: len(self._direct)])

    def variable_of(self, columns: np.ndarray) -> np.ndarray:
        """Program variables of direct unknowns."""
        return self._direct[columns]

    def column_of(self, variables: np.ndarray) -> np.ndarray:
        """Unknown that is a program variable by itself, up to its scale.

        Raises:
            ValueError: a variable is fixed or substituted.
        """
        place = np.searchsorted(self._direct, variables)
        last = len(self._direct) - 1
        if (self._direct[np.minimum(place, last)] != variables).any():
            raise ValueError("not an unknown by itself")
        return place

    def bound_of(self, variable: int, upper: bool) -> float:
        """Bound of a program variable in its own unit."""
        return float((self.x_upper if upper else self.x_lower)[variable])
