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
from drake_exo.soles.numerics import njit


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


@njit()
def smooth_plus(x, width):
    """max(x, 0) with a twice differentiable corner on [-width, width].

    Returns:
        Value and slope; x may be complex (complex-step derivatives).
    """
    if x.real <= -width:
        return 0.0 * x, 0.0 * x
    if not x.real < width:  # NaN, too
        return x, 1.0 + 0.0 * x
    t = x / width
    square = t * t  # a power of a complex number would lose the tiny step
    value = width * (t / 2 + 3 / 8 * square - square * square / 16 + 3 / 16)
    return value, 1 / 2 + 3 / 4 * t - square * t / 4


def project(tau: np.ndarray, law: ContactLaw) -> np.ndarray:
    """T(τ) at nodes, in the axes of their planes, (k, 3) -> (k, 3)."""
    return project_with_derivative(tau, law)[0]


def project_with_derivative(
    tau: np.ndarray, law: ContactLaw
) -> tuple[np.ndarray, np.ndarray]:
    """T(τ) and D = ∂T/∂τ at nodes: (k, 3), (k, 3, 3)."""
    tau = np.ascontiguousarray(tau)
    return _project(tau, law.friction, law.epsilon, law.kappa)


@njit()
def _project(tau, mu, epsilon, kappa):
    T = np.empty_like(tau)
    D = np.empty((len(tau), 3, 3), tau.dtype)
    for i in range(len(tau)):
        project_node(tau[i], mu, epsilon, kappa, T[i], D[i])
    return T, D


@njit()
def project_node(tau, mu, epsilon, kappa, T, D):
    """T(τ) and D at one node, into T (3,) and D (3, 3)."""
    p, dp = smooth_plus(tau[2], epsilon)
    g = mu * p
    T[:] = 0.0
    T[2] = p
    D[:, :] = 0.0
    D[2, 2] = dp
    if g.real <= 0.0:
        return
    rho = np.sqrt(tau[0] * tau[0] + tau[1] * tau[1])
    if rho.real <= (1.0 - kappa) * g.real:  # sticks
        T[0], T[1] = tau[0], tau[1]
        D[0, 0] = D[1, 1] = 1.0
        return
    # T_t = scale τ_t: derivatives along τ_t beyond scale, and by g.
    if rho.real >= (1.0 + kappa) * g.real:  # slips
        scale = g / rho
        radial, by_g = -scale, 1.0 + 0.0 * scale
    else:
        plus, slope = smooth_plus(rho / g - 1.0, kappa)
        s = 1.0 + plus
        scale = 1.0 / s
        share = rho / (g * s)
        radial, by_g = -slope * share / s, slope * share * share
    for a in range(2):
        T[a] = scale * tau[a]
        for b in range(2):
            D[a, b] = radial * (tau[a] / rho) * (tau[b] / rho)
        D[a, a] += scale
        D[a, 2] = by_g * mu * dp * tau[a] / rho


def firmly_sticking(tau: np.ndarray, law: ContactLaw) -> np.ndarray:
    """Nodes where T is the identity: pressed beyond ε, inside the cone."""
    rho = np.hypot(tau[:, 0], tau[:, 1])
    cone = (1 - law.kappa) * law.friction * tau[:, 2]
    return (tau[:, 2] > law.epsilon) & (rho <= cone)
