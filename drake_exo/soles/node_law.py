"""Signorini and Coulomb at a node, exact or smoothed, as one projection.

Residual φ = F − T(F − r δ). With τ = F − r δ (force of the ground on the
sole F, place relative to its reference δ):

    p = plus_ε(τ_n),  g = μ p,  T = (τ_t / s, p),  s = 1 + plus_κ(|τ_t|/g − 1)

ε = r ℓ (layer thickness ℓ) and κ smooth the corners twice differentiably;
ε = κ = 0 is the exact law, at whose solution φ = 0 is the same as
Alart–Curnier's. With D = ∂T/∂τ the derivatives are ∂φ/∂F = I − D and
∂φ/∂δ = r D: a firmly sticking node has D = I.
"""

from dataclasses import dataclass

import numpy as np

from drake_exo.errors import InputError


@dataclass(frozen=True)
class ContactLaw:
    """Parameters of the contact law.

    Attributes:
        friction: Coulomb's coefficient μ.
        penalty: r [N/m], positive; scales the residual, frozen over designs.
        layer: Thickness ℓ of the smoothed normal law [m]; 0 is exact.
        kappa: Width κ of the smoothed stick-slip corner; 0 is exact.
    """

    friction: float
    penalty: float
    layer: float = 0.0
    kappa: float = 0.0

    def __post_init__(self):
        if not self.friction >= 0:
            raise InputError(
                f"contact: friction {self.friction} must not be negative"
            )
        if min(self.layer, self.kappa) < 0 or not self.penalty > 0:
            raise InputError(
                "contact: layer and kappa must not be negative and the "
                "penalty must be positive"
            )

    @property
    def epsilon(self) -> float:
        """ε = r ℓ [N]."""
        return self.penalty * self.layer


def smooth_plus(x, width: float):
    """max(x, 0) with a twice differentiable corner on [-width, width].

    Returns:
        Value and slope; x may be complex (complex-step derivatives).
    """
    real = np.real(x)
    if width == 0.0:
        on = (real > 0).astype(float)
        return x * on, on + 0.0 * x
    t = x / width
    value = width * (t / 2 + 3 / 8 * t**2 - t**4 / 16 + 3 / 16)
    slope = 1 / 2 + 3 / 4 * t - t**3 / 4
    value = np.where(real > width, x, np.where(real < -width, 0.0, value))
    slope = np.where(real > width, 1.0, np.where(real < -width, 0.0, slope))
    return value, slope


def project(tau: np.ndarray, law: ContactLaw) -> np.ndarray:
    """T(τ) at nodes, (k, 3) -> (k, 3)."""
    return _project(tau, law, derivative=False)[0]


def project_with_derivative(
    tau: np.ndarray, law: ContactLaw
) -> tuple[np.ndarray, np.ndarray]:
    """T(τ) and D = ∂T/∂τ at nodes: (k, 3), (k, 3, 3)."""
    return _project(tau, law, derivative=True)


def _project(tau, law, derivative):
    p, dp = smooth_plus(tau[:, 2], law.epsilon)
    g = law.friction * p
    t = tau[:, :2]
    rho = np.sqrt(t[:, 0] ** 2 + t[:, 1] ** 2)
    # Where g or rho vanish the branches below do not use the quotient.
    g_safe = np.where(np.real(g) > 0, g, 1.0)
    rho_safe = np.where(np.real(rho) > 0, rho, 1.0)
    ratio = np.real(rho) / np.real(g_safe)
    stick = (ratio <= 1 - law.kappa) & (np.real(g) > 0)
    slip = ~stick & (ratio >= 1 + law.kappa) | (np.real(g) <= 0)
    plus, slope = smooth_plus(
        np.where(stick | slip, 0.0, rho / g_safe - 1), law.kappa
    )
    s = np.where(stick, 1.0, np.where(slip, rho_safe / g_safe, 1 + plus))
    scale = np.where(slip, g / rho_safe, 1 / s)
    T = np.concatenate([t * scale[:, None], p[:, None]], axis=1)
    if not derivative:
        return T, None
    # ds = a dρ + b dg over the three branches (slip handled by limits).
    a = np.where(stick | slip, 0.0, slope / g_safe)
    b = np.where(stick | slip, 0.0, -slope * rho / g_safe**2)
    n = t / rho_safe[:, None]
    # T_t = scale τ_t: radial derivative and derivative by g.
    radial = np.where(stick, 0.0, np.where(slip, -scale, -rho * a / s**2))
    by_g = np.where(stick, 0.0, np.where(slip, 1.0, -rho * b / s**2))
    D = np.zeros((len(tau), 3, 3), dtype=T.dtype)
    D[:, :2, :2] = radial[:, None, None] * n[:, :, None] * n[:, None, :]
    D[:, 0, 0] += scale
    D[:, 1, 1] += scale
    D[:, :2, 2] = n * (by_g * law.friction * dp)[:, None]
    D[:, 2, 2] = dp
    return T, D


def firmly_sticking(tau: np.ndarray, law: ContactLaw) -> np.ndarray:
    """Nodes where T is the identity: pressed beyond ε, inside the cone."""
    rho = np.hypot(tau[:, 0], tau[:, 1])
    cone = (1 - law.kappa) * law.friction * tau[:, 2]
    return (tau[:, 2] > law.epsilon) & (rho <= cone)
