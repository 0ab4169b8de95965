"""Joint angles from markers: weighted least squares over all frames at once.

Each leg is followed on its own; the planar model's leg is their mean, since
feet that stand apart fore and aft give the legs different angles.
"""

from dataclasses import dataclass

import numpy as np

from drake_exo.errors import InputError
from drake_exo.laboratory.marker_model import MarkerModel
from drake_exo.output import Progress

_MAX_ITERATIONS = 50
_CONVERGED = 1e-10  # largest step [m or rad]


@dataclass(frozen=True)
class Poses:
    """Pose of the marker model in every frame.

    Attributes:
        hip: (N,) complex x + i z, middle of the hips [m].
        angles: (N, S) absolute segment angles [rad].
        residuals: (N, M) complex, measured minus model [m].
    """

    hip: np.ndarray
    angles: np.ndarray
    residuals: np.ndarray


def solve_poses(
    model: MarkerModel,
    points: np.ndarray,
    source: str = "markers",
    progress: Progress | None = None,
) -> Poses:
    """Fit the marker model to measured points by Gauss-Newton.

    Args:
        model: M markers on S segments.
        points: (N, M, 2) x and z of the markers in the order of `model.names`
            [m], without gaps.
        source: file name, for messages.
        progress: told of every iteration.

    Raises:
        InputError: the markers do not fit the model.
    """
    p = points[..., 0] + 1j * points[..., 1]
    phi = _first_guess(model, p)
    hip = np.mean(p - np.exp(1j * phi) @ model.levers.T, axis=1)
    W = np.sqrt(model.weights)
    for iteration in range(_MAX_ITERATIONS):
        w = np.exp(1j * phi)
        r = p - hip[:, None] - w @ model.levers.T
        J = np.empty((*p.shape, phi.shape[1] + 2), complex)
        J[..., 0], J[..., 1] = 1.0, 1j
        J[..., 2:] = 1j * w[:, None, :] * model.levers
        J *= W[:, None]
        A = np.concatenate([J.real, J.imag], axis=1)
        b = np.concatenate([(r * W).real, (r * W).imag], axis=1)
        normal = np.einsum("nmi,nmj->nij", A, A, optimize=True)
        step = np.linalg.solve(
            normal, np.einsum("nmi,nm->ni", A, b)[..., None]
        )[..., 0]
        # Half a radian at most: from any first guess it stays on the way.
        step[:, 2:] = np.clip(step[:, 2:], -0.5, 0.5)
        hip = hip + step[:, 0] + 1j * step[:, 1]
        phi = phi + step[:, 2:]
        largest = np.abs(step).max()
        if progress:
            progress.update(f"iteration {iteration + 1}, step {largest:.1e}")
        if largest < _CONVERGED:
            break
    else:
        raise InputError(
            f"{source}: inverse kinematics does not converge; check that "
            "the markers are named as in the standing trial"
        )
    phi = np.unwrap(phi, axis=0)
    r = p - hip[:, None] - np.exp(1j * phi) @ model.levers.T
    return Poses(hip, phi, r)


def _first_guess(model: MarkerModel, p: np.ndarray) -> np.ndarray:
    """Turn of each segment's own markers since standing (N, S)."""
    phi = np.tile(model.standing_angles, (len(p), 1))
    standing = model.levers @ np.exp(1j * model.standing_angles)
    for k in range(phi.shape[1]):
        of = model.segment_of == k
        s = standing[of] - standing[of].mean()
        if np.abs(s).max() > 0.01:
            c = p[:, of] - p[:, of].mean(axis=1, keepdims=True)
            phi[:, k] += np.angle(c @ np.conj(s))
    return phi


def merge_legs(
    model: MarkerModel, poses: Poses
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Coordinates of the planar model, both legs averaged.

    Returns:
        q (N, 6): foot_x, foot_z (the ankle's centre) [m], foot_pitch, ankle,
        knee, hip [rad]; and each side's ankle (N, 2) [m].
    """
    w = np.exp(1j * poses.angles)
    ankles = {
        side: poses.hip + w @ lever for side, lever in model.ankles.items()
    }
    ankle = np.mean(list(ankles.values()), axis=0)
    foot, shank, thigh = (
        np.mean(
            [poses.angles[:, model.index(s, side)] for side in model.sides],
            axis=0,
        )
        for s in ("foot", "shank", "thigh")
    )
    pelvis = poses.angles[:, 0]
    q = np.column_stack(
        [
            ankle.real,
            ankle.imag,
            foot,
            foot - shank,
            thigh - shank,
            thigh - pelvis,
        ]
    )
    points = {s: np.column_stack([a.real, a.imag]) for s, a in ankles.items()}
    return q, points


def residual_rms(model: MarkerModel, poses: Poses) -> dict[str, float]:
    """Root mean square distance of each marker from the model [m].

    A marker on two segments has one entry, its mean over both.
    """
    square = np.mean(np.abs(poses.residuals) ** 2, axis=0)
    return {
        name: float(
            np.sqrt(
                np.mean(
                    [
                        s
                        for s, n in zip(square, model.names, strict=True)
                        if n == name
                    ]
                )
            )
        )
        for name in dict.fromkeys(model.names)
    }
