"""Limits on a design that take a simulation: value and what the adjoint needs.

Every limit is scaled and at least 0 where met. Minima over samples are soft
and err on the safe side.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_exo.soles import stiffness
from drake_exo.soles.adjoint import (
    singular_terms,
    stability_terms,
    tilt_terms,
)
from drake_exo.soles.contact import ContactSolver
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.simulation import StepHistory
from drake_exo.soles.strain_norm import StrainNorm

_SHARPNESS = 60.0  # of the soft minimum over samples
_TILT_SCALE = 0.06  # 1 − cos 20°


@dataclass(frozen=True)
class Limits:
    """Constraints; None switches one off.

    Attributes:
        volume: v_max [m³].
        stability: Least scaled eigenvalue [N/m], with its margin.
        tilt_deg: Largest tilt [°].
        strain: Largest p-norm of the principal strains.
        c_rot: Least c_rot [N·m/rad], for the front of c_tr against c_rot.
    """

    volume: float
    stability: float | None = None
    tilt_deg: float | None = None
    strain: float | None = None
    c_rot: float | None = None


@dataclass
class Evaluation:
    """A design simulated: sole, history and measures.

    `counts` says how many samples each simulated one stands for.
    """

    p: np.ndarray
    sole: Sole
    solver: ContactSolver
    history: StepHistory
    c_tr: float
    c_rot: float
    counts: np.ndarray

    @cached_property
    def strain(self) -> StrainNorm:
        """The p-norm of its principal strains."""
        return StrainNorm(self.sole, self.history, self.counts)


@dataclass(frozen=True)
class StabilityLimit:
    """Least scaled eigenvalue of −sym K_c; `scale` is the brick's [N/m]."""

    least: float
    scale: float
    name = "stability"

    def _excess(self, e: Evaluation):
        x = stiffness.stability(e.history.K_c) - self.least
        return _saturate(x / self.scale)

    def value(self, e: Evaluation) -> float:
        """Scaled excess, soft minimum over samples."""
        return soft_minimum(self._excess(e)[0])[0]

    def derivative(self, e: Evaluation):
        """Terms for the adjoint, direct derivative by the nodes."""
        y, slope = self._excess(e)
        share = slope * soft_minimum(y)[1] / self.scale
        return stability_terms(
            e.history.K_c, share, stiffness.STABILITY_LENGTH
        ), 0.0


@dataclass(frozen=True)
class TiltLimit:
    """Largest angle between the sole's and the world's vertical."""

    largest_deg: float
    name = "tilt_deg"

    def _excess(self, e: Evaluation):
        room = e.history.R[:, 2, 2] - np.cos(np.deg2rad(self.largest_deg))
        return soft_minimum(room / _TILT_SCALE)

    def value(self, e: Evaluation) -> float:
        """Scaled difference of cosines, soft minimum over samples."""
        return self._excess(e)[0]

    def derivative(self, e: Evaluation):
        """Terms for the adjoint, direct derivative by the nodes."""
        share = self._excess(e)[1] / _TILT_SCALE
        return tilt_terms(e.history.R, share), 0.0


@dataclass(frozen=True)
class StrainLimit:
    """Largest p-norm of the principal strains over elements and samples."""

    largest: float
    name = "strain"

    def value(self, e: Evaluation) -> float:
        """1 − Φ / limit."""
        return 1.0 - e.strain.value / self.largest

    def derivative(self, e: Evaluation):
        """Terms for the adjoint, direct derivative by the nodes."""
        terms, by_nodes = e.strain.derivatives()
        scale = -1.0 / self.largest
        terms = [[term.times(scale) for term in row] for row in terms]
        return terms, scale * by_nodes


@dataclass(frozen=True)
class RotationLimit:
    """Least c_rot [N·m/rad]; `by_rot` are the samples' factors."""

    least: float
    by_rot: np.ndarray
    name = "c_rot"

    def value(self, e: Evaluation) -> float:
        """c_rot / limit − 1."""
        return e.c_rot / self.least - 1.0

    def derivative(self, e: Evaluation):
        """Terms for the adjoint, direct derivative by the nodes."""
        K = e.history.K_c
        return singular_terms(K, np.zeros(len(K)), self.by_rot / self.least), 0


def active_limits(limits: Limits, first: Evaluation, by_rot: np.ndarray):
    """The limits switched on that need a simulation.

    Args:
        limits: What is limited.
        first: The brick, for scales.
        by_rot: Factors of the samples in c_rot.
    """
    out = []
    if limits.stability is not None:
        scale = float(np.min(stiffness.stability(first.history.K_c)))
        out.append(StabilityLimit(limits.stability, scale))
    if limits.tilt_deg is not None:
        out.append(TiltLimit(limits.tilt_deg))
    if limits.strain is not None:
        out.append(StrainLimit(limits.strain))
    if limits.c_rot is not None:
        out.append(RotationLimit(limits.c_rot, by_rot))
    return out


def _saturate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give x / √(1 + x²) and its slope: no wild sample rules the search."""
    root = np.sqrt(1 + x**2)
    return x / root, root**-3


def soft_minimum(
    x: np.ndarray, sharpness: float = _SHARPNESS
) -> tuple[float, np.ndarray]:
    """−log Σ exp(−ρ x) / ρ, never above min x, and its derivatives."""
    low = x.min()
    e = np.exp(-sharpness * (x - low))
    return float(low - np.log(e.sum()) / sharpness), e / e.sum()
