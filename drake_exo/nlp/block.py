"""A batch of kernels seen from the solver's unknowns."""

import numpy as np
import scipy.sparse as sp

from drake_exo.nlp.batch import Batch


class Block:
    """A batch seen from the unknowns: f(offset + B y), B gathered by node."""

    def __init__(self, batch: Batch, matrix: sp.csr_array):
        self.batch = batch
        n, n_in = batch.indices.shape
        ny = matrix.shape[1]
        rows = matrix[batch.indices.ravel()].tocoo()
        node, slot = np.divmod(rows.row, n_in)
        key, position = np.unique(node * ny + rows.col, return_inverse=True)
        first = np.searchsorted(key, np.arange(n) * ny)
        rank = np.arange(len(key)) - first[key // ny]
        width = int(rank.max()) + 1 if len(rank) else 1
        self.columns = np.full((n, width), -1)
        self.columns[key // ny, rank] = key % ny
        self.local = np.zeros((n, n_in, width))
        self.local[node, slot, rank[position]] = rows.data
        structure = np.abs(self.local) > 0
        if np.ptp(self.local, axis=0).max(initial=0.0) < 1e-14:
            self.local = self.local[0]
            structure = structure[:1]
        pattern = batch.kernel.sparsity.astype(float) @ structure > 0
        pattern = np.broadcast_to(pattern, (n, batch.num_outputs, width))
        self.pattern = pattern & (self.columns >= 0)[:, None, :]
        inputs = batch.kernel.sparsity.any(axis=0)
        inputs = getattr(batch.kernel, "curved_inputs", inputs)
        self.curved = structure[:, inputs].any(axis=1) & (self.columns >= 0)

    def values(self, x):
        """Outputs (n, n_out) at program variables x."""
        return self.batch.kernel.evaluate(
            x[self.batch.indices], self.batch.data
        )

    def jacobian(self, x):
        """Dense blocks (n, n_out, width) with respect to the unknowns."""
        J = self.batch.kernel.jacobian(x[self.batch.indices], self.batch.data)
        if self.local.ndim == 3:
            return J @ self.local
        if J.strides[0] == 0:
            return np.broadcast_to(
                J[0] @ self.local, (*J.shape[:2], self.local.shape[1])
            )
        # One large product is much faster than many small ones.
        flat = J.reshape(-1, J.shape[2]) @ self.local
        return flat.reshape(*J.shape[:2], -1)

    def curvature(self, x, weights):
        """sum_i weights_i d2 f_i/dy2, (n, width, width).

        By differences of the Jacobian where the kernel has no `curvature`.
        """
        kernel, data = self.batch.kernel, self.batch.data
        z = x[self.batch.indices]
        if hasattr(kernel, "curvature"):
            H = kernel.curvature(z, weights, data)
        else:
            n, n_in = z.shape
            H = np.zeros((n, n_in, n_in))
            for k in np.flatnonzero(kernel.sparsity.any(axis=0)):
                H[:, k] = _directional(kernel, z, data, weights, k)
            H = 0.5 * (H + H.transpose(0, 2, 1))
        return np.swapaxes(self.local, -1, -2) @ H @ self.local


def _directional(kernel, z, data, weights, k):
    """d/dz_k of weights^T J by central differences."""
    h = 1e-6 * np.maximum(1.0, np.abs(z[:, k]))
    up, down = z.copy(), z.copy()
    up[:, k] += h
    down[:, k] -= h
    J = kernel.jacobian(up, data) - kernel.jacobian(down, data)
    J /= (2.0 * h)[:, None, None]
    return np.einsum("no,noi->ni", weights, J)


def accumulate(g: np.ndarray, block: Block, local: np.ndarray) -> None:
    """Add a block's parts of a gradient (n, width) where they belong."""
    keep = block.columns >= 0
    g += np.bincount(block.columns[keep], local[keep], minlength=len(g))
