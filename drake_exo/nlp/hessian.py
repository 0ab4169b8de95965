"""The Hessian of a sparse program's Lagrangian, put together from blocks."""

import numpy as np
import scipy.sparse as sp

from drake_exo.nlp.block import Block


class HessianLayout:
    """Union of all blocks' lower triangles, and where each one lands.

    Args:
        constant: (ny, ny) Hessian of the quadratic cost.
        gauss_newton: blocks that contribute J^T J.
        curved: blocks that may contribute their curvature besides.

    Attributes:
        structure: (rows, columns) of the lower triangle's nonzeros.
        constant: the quadratic cost's values there.
    """

    def __init__(
        self,
        constant: sp.sparray,
        gauss_newton: list[Block],
        curved: list[Block],
    ):
        coo = sp.tril(constant).tocoo()
        ny = constant.shape[0]
        keys = [coo.row.astype(np.int64) * ny + coo.col]
        self._triangles = []
        for b in [*gauss_newton, *curved]:
            row = np.broadcast_to(
                b.columns[:, :, None], (*b.columns.shape, b.columns.shape[1])
            )
            column = row.transpose(0, 2, 1)
            keep = (row >= column) & (column >= 0)
            if b not in gauss_newton:
                keep &= b.curved[:, :, None] & b.curved[:, None, :]
            keys.append(row[keep].astype(np.int64) * ny + column[keep])
            self._triangles.append((b, keep))
        unique, inverse = np.unique(np.concatenate(keys), return_inverse=True)
        parts = np.split(inverse, np.cumsum([len(k) for k in keys])[:-1])
        self.constant = np.bincount(parts[0], coo.data, minlength=len(unique))
        self._places = parts[1:]
        self.structure = (
            (unique // ny).astype(np.int32),
            (unique % ny).astype(np.int32),
        )

    def values(self, factor, x, jacobians, weights) -> np.ndarray:
        """Nonzeros in the order of `structure`.

        Args:
            factor: of the cost.
            x: (n,) program variables.
            jacobians: id of a residual block -> its Jacobian.
            weights: id of a block -> weights of its outputs' curvature.
        """
        H = factor * self.constant
        for (b, keep), places in zip(
            self._triangles, self._places, strict=True
        ):
            if id(b) in jacobians:
                J = jacobians[id(b)]
                term = factor * (J.transpose(0, 2, 1) @ J)
                H += np.bincount(places, term[keep], minlength=len(H))
            if id(b) in weights:
                term = b.curvature(x, weights[id(b)])
                H += np.bincount(places, term[keep], minlength=len(H))
        return H
