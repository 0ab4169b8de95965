"""Checks of a kernel's derivatives, each against differences."""

import numpy as np


def differences(function, x):
    """Derivatives (n, ..., n_in) of a function of x (n, n_in)."""
    columns = []
    for k in range(x.shape[1]):
        step = np.zeros(x.shape[1])
        step[k] = 1e-6 * max(1.0, np.abs(x[:, k]).max())
        change = function(x + step) - function(x - step)
        columns.append(change / (2.0 * step[k]))
    return np.stack(columns, axis=-1)


def check_jacobian(kernel, x, data=None):
    """First derivatives, and that the pattern misses none."""
    J = kernel.jacobian(x, data)
    expected = differences(lambda x: kernel.evaluate(x, data), x)
    scale = np.abs(expected).max(axis=(0, 1)) + 1e-3
    error = np.abs(J - expected).max(axis=(0, 1)) / scale
    assert error.max() < 1e-6, f"input {error.argmax()}: {error.max():.1e}"
    assert np.abs(J[:, ~kernel.sparsity]).max(initial=0.0) == 0.0
    assert (np.abs(J) > 0).any(axis=0)[kernel.sparsity].mean() > 0.5


def check_curvature(kernel, x, weights, data=None, rtol=1e-5):
    """Second derivatives of the weighted outputs, and what is curved.

    Entry by entry, against the largest of its row.
    """
    found = kernel.curvature(x, weights, data)
    expected = differences(
        lambda x: np.einsum("no,noi->ni", weights, kernel.jacobian(x, data)), x
    )
    size = np.abs(expected).max(axis=0)
    scale = np.sqrt(np.outer(size.max(axis=0), size.max(axis=1))) + 1e-12
    off = (np.abs(found - expected) / scale).max(axis=0)
    # Differences of a difference of large numbers are no better.
    noise = 1e-9 * np.abs(expected).max() / scale
    wrong = np.argwhere(off > rtol + noise)
    assert not len(wrong), (wrong[:5], off.max())
    np.testing.assert_allclose(
        found, found.transpose(0, 2, 1), rtol=1e-12, atol=1e-12
    )
    curved = getattr(kernel, "curved_inputs", None)
    if curved is not None:
        assert curved.shape == (x.shape[1],)
        assert not found[:, ~curved].any()
    # The solver leaves no room for pairs that no output depends on.
    together = kernel.sparsity.T.astype(int) @ kernel.sparsity > 0
    assert not found[:, ~together].any()
    assert np.abs(expected).max() > 0.0
