"""Cartesian stiffness about the ZMP and the measures taken from it.

K_c relates wrench and pose increments, [dF; dΓ_Z] = K_c [dzO; dω]; its
physical stiffness is −K_c (N/m, N, N, N·m/rad).
"""

import numpy as np

# S: a length of 0.05 m makes the blocks of K_c comparable.
STABILITY_SCALE = np.array([1.0] * 3 + [1.0 / 0.05] * 3)


def sigma_max_translation(K_c: np.ndarray) -> np.ndarray:
    """Largest singular value of the translational block [N/m]."""
    return _singular_values(K_c[..., :3, :3])[..., 0]


def sigma_min_rotation(K_c: np.ndarray) -> np.ndarray:
    """Smallest singular value of the rotational block [N·m/rad]."""
    return _singular_values(K_c[..., 3:, 3:])[..., -1]


def _singular_values(K: np.ndarray) -> np.ndarray:
    """Singular values (..., 3), largest first; NaN where K is not finite."""
    fine = np.isfinite(K).all(axis=(-2, -1))
    safe = np.where(fine[..., None, None], K, 0.0)
    values = np.linalg.svd(safe, compute_uv=False)
    return np.where(fine[..., None], values, np.nan)


def stability(K_c: np.ndarray) -> np.ndarray:
    """Least eigenvalue of S sym(−K_c) S, S = diag(I, I/L) [N/m], (...).

    L = 0.05 m. Positive is enough for stability under a dead wrench (K_c is not
    symmetric).
    """
    sym = -0.5 * (K_c + np.swapaxes(K_c, -1, -2))
    fine = np.isfinite(sym).all(axis=(-2, -1))
    scaled = np.outer(STABILITY_SCALE, STABILITY_SCALE) * sym
    scaled = np.where(fine[..., None, None], scaled, 0.0)
    return np.where(fine, np.linalg.eigvalsh(scaled)[..., 0], np.nan)


def heel_strike_count(samples: int, fraction: float = 0.1) -> int:
    """Number of samples of heel strike: the first tenth, at least one."""
    return max(1, int(np.floor(fraction * samples)))


def sample_weights(
    load, fraction: float = 0.1
) -> tuple[np.ndarray, np.ndarray]:
    """Factors of the samples in c_tr and c_rot, (N,) each.

    Of one contact phase both are plain sums, over heel strike and over all;
    of several the weighted means of their sums.

    Args:
        load: The `Load`.
        fraction: Part of a phase's samples that is heel strike.
    """
    by_tr, by_rot = np.zeros((2, len(load.times)))
    for phase, share in zip(load.phases, load.shares, strict=True):
        count = heel_strike_count(phase.stop - phase.start, fraction)
        by_tr[phase.start : phase.start + count] = share
        by_rot[phase] = share
    return by_tr, by_rot
