"""The shape problem: cost, constraints and their gradients at a design.

Design variables are the free coefficients of the spline. Every evaluation
simulates the step from its first contact (nothing is carried over from
other designs); a failed simulation gives NaN, which the solver takes as a
rejected step.
"""

from dataclasses import dataclass, field

import numpy as np

from drake_exo.soles import stiffness
from drake_exo.soles.adjoint import (
    shape_gradients,
    singular_terms,
    stability_terms,
    tilt_terms,
)
from drake_exo.soles.contact import ContactSolver, Start
from drake_exo.soles.elasticity import Element, Material, Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.node_law import ContactLaw
from drake_exo.soles.shape import SphericalSpline
from drake_exo.soles.simulation import StepHistory, simulate

_SHARPNESS = 60.0  # of the soft minimum over samples
_ELEMENT_SHARPNESS = 200.0
_LEAST_VOLUME = 0.06  # of an element's own volume in the reference mesh


@dataclass(frozen=True)
class Limits:
    """Constraints; None switches one off.

    Attributes:
        volume: v_max [m³].
        stability: Least scaled eigenvalue [N/m], with its margin.
        tilt_deg: Largest tilt [°].
        c_rot: Least c_rot [N·m/rad], for the front of c_tr against c_rot.
    """

    volume: float
    stability: float | None = None
    tilt_deg: float | None = None
    c_rot: float | None = None


@dataclass
class Evaluation:
    """A design simulated: sole, history and measures."""

    p: np.ndarray
    sole: Sole
    solver: ContactSolver
    history: StepHistory
    c_tr: float
    c_rot: float


@dataclass
class ShapeProblem:
    """Minimise c_tr − w c_rot over shapes.

    Attributes:
        mesh: Reference mesh (s = 1).
        spline: Parametrisation.
        material, element: Of the sole.
        law: Smoothed contact law, r frozen.
        load: All samples; `picked` are simulated and weighted so that sums
            stand for all.
        start: Just before contact.
        weight: w.
        limits: Constraints.
        roughness: Factor of the regulariser, mean squared second difference
            of the coefficients.
        fraction: Heel strike's part of the samples.
        samples: How many samples to simulate.
    """

    mesh: TetMesh
    spline: SphericalSpline
    material: Material
    law: ContactLaw
    load: Load
    start: Start
    weight: float
    limits: Limits
    element: Element = "linear"
    roughness: float = 0.0
    fraction: float = 0.1
    samples: int | None = None
    use_tr: float = 1.0
    evaluations: int = 0
    failures: int = 0
    _cache: dict = field(default_factory=dict)

    def __post_init__(self):
        self.M, self.s0 = self.spline.basis(self.mesh.nodes)
        self.picked, self.by_tr, self.by_rot = sample_weights(
            len(self.load.times), self.samples, self.fraction
        )
        self._rough = second_differences(self.spline)
        first = self.evaluate(np.ones(self.spline.count))
        if first is None:
            raise RuntimeError("the initial shape cannot be simulated")
        self.scale = abs(self.use_tr * first.c_tr - self.weight * first.c_rot)
        self.first = first
        self.stability_scale = float(
            np.min(stiffness.stability(first.history.K_c))
        )

    def evaluate(self, p: np.ndarray) -> Evaluation | None:
        """Simulate a design; None if it cannot be simulated."""
        key = p.tobytes()
        if key not in self._cache:
            try:
                self._cache = {key: self._simulate(p.copy())}
            except np.linalg.LinAlgError:  # a shape that cannot carry load
                self._cache = {key: None}
            self.evaluations += 1
            self.failures += self._cache[key] is None
        return self._cache[key]

    def _simulate(self, p):
        s = self.M @ p + self.s0
        mesh = self.mesh.with_nodes(s[:, None] * self.mesh.nodes)
        if s.min() <= 0 or mesh.volumes.min() <= 0:
            return None
        sole = Sole(mesh, self.material, self.element)
        solver = ContactSolver(
            sole.compliance, sole.positions, self.law, tolerance=1e-12
        )
        force, zmp = self.load.force[self.picked], self.load.zmp[self.picked]
        history = simulate(
            sole.compliance,
            sole.positions,
            self.law,
            force,
            zmp,
            self.start,
            solver=solver,
            stop_at_failure=True,
        )
        if history.failed_steps:
            return None
        return Evaluation(
            p,
            sole,
            solver,
            history,
            float(self.by_tr @ stiffness.sigma_max_translation(history.K_c)),
            float(self.by_rot @ stiffness.sigma_min_rotation(history.K_c)),
        )

    def cost(self, p: np.ndarray) -> float:
        """Scaled c plus roughness; NaN where the simulation fails."""
        e = self.evaluate(p)
        if e is None:
            return np.nan
        c = self.use_tr * e.c_tr - self.weight * e.c_rot
        return c / self.scale + self.roughness * self._roughness(p)[0]

    def _roughness(self, p):
        d, d0 = self._rough
        bend = d @ p + d0
        return float(bend @ bend) / len(bend), 2 * (d.T @ bend) / len(bend)

    def names(self) -> list[str]:
        """Names of the constraints, each to be at least 0."""
        names = ["volume", "elements"]
        for name in ("stability", "tilt_deg", "c_rot"):
            if getattr(self.limits, name) is not None:
                names.append(name)
        return names

    def constraints(self, p: np.ndarray) -> np.ndarray:
        """Scaled constraint values, feasible where >= 0."""
        e = self.evaluate(p)
        if e is None:
            return np.full(len(self.names()), np.nan)
        limits = self.limits
        values = [
            1.0 - e.sole.mesh.volume / limits.volume,
            self._elements(e.sole.mesh)[0],
        ]
        if limits.stability is not None:
            x = stiffness.stability(e.history.K_c) - limits.stability
            values.append(
                soft_minimum(_saturate(x / self.stability_scale)[0])[0]
            )
        if limits.tilt_deg is not None:
            x = e.history.R[:, 2, 2] - np.cos(np.deg2rad(limits.tilt_deg))
            values.append(soft_minimum(x / 0.06)[0])
        if limits.c_rot is not None:
            values.append(e.c_rot / limits.c_rot - 1.0)
        return np.array(values)

    def derivatives(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the cost (P,) and Jacobian of the constraints."""
        e = self.evaluate(p)
        if e is None:
            raise RuntimeError("no derivatives where the simulation failed")
        K, limits = e.history.K_c, self.limits
        functionals = [
            singular_terms(
                K,
                self.use_tr * self.by_tr / self.scale,
                -self.weight * self.by_rot / self.scale,
            )
        ]
        if limits.stability is not None:
            x = stiffness.stability(K) - limits.stability
            y, slope = _saturate(x / self.stability_scale)
            share = slope * soft_minimum(y)[1]
            functionals.append(
                stability_terms(
                    K,
                    share / self.stability_scale,
                    stiffness.STABILITY_LENGTH,
                )
            )
        if limits.tilt_deg is not None:
            x = e.history.R[:, 2, 2] - np.cos(np.deg2rad(limits.tilt_deg))
            share = soft_minimum(x / 0.06)[1]
            functionals.append(tilt_terms(e.history.R, share / 0.06))
        if limits.c_rot is not None:
            functionals.append(
                singular_terms(K, np.zeros(len(K)), self.by_rot / limits.c_rot)
            )
        X = shape_gradients(
            e.sole,
            e.solver,
            self.load.force[self.picked],
            self.load.zmp[self.picked],
            self.start,
            e.history,
            functionals,
        )
        rows = [self.by_coefficients(x) for x in X]
        gradient = rows[0] + self.roughness * self._roughness(p)[1]
        volume = -self.by_coefficients(e.sole.mesh.volume_gradient())
        elements = self.by_coefficients(self._elements(e.sole.mesh)[1])
        return gradient, np.array([volume / limits.volume, elements, *rows[1:]])

    def _elements(self, mesh: TetMesh) -> tuple[float, np.ndarray]:
        """Least volume ratio of the elements above its floor; ∂/∂nodes.

        The continuous map never inverts; discretised, an element does once
        s varies within it. The search stays away from there.
        """
        rest = self.mesh.volumes
        value, share = soft_minimum(
            mesh.volumes / rest - _LEAST_VOLUME, _ELEMENT_SHARPNESS
        )
        out = np.zeros_like(mesh.nodes)
        local = (share * mesh.volumes / rest)[:, None, None] * mesh.gradients
        np.add.at(out, mesh.tets.ravel(), local.reshape(-1, 3))
        return value, out

    def by_coefficients(self, X: np.ndarray) -> np.ndarray:
        """Chain rule from node positions (n, 3) to coefficients (P,)."""
        return self.M.T @ (X * self.mesh.nodes).sum(axis=1)


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


def sample_weights(total: int, samples: int | None, fraction: float):
    """Which samples to simulate and what each counts in the sums.

    Heel strike and the rest are thinned alike, at least four samples of
    heel strike stay; weights make the sums those of all samples.

    Returns:
        picked (k,), weights in c_tr (k,), weights in c_rot (k,).
    """
    strike = stiffness.heel_strike_count(total, fraction)
    if samples is None or samples >= total:
        picked = np.arange(total)
    else:
        first = min(strike, max(4, round(samples * fraction)))
        rest = max(2, samples - first)
        picked = np.concatenate(
            [
                np.linspace(0, strike - 1, first).round().astype(int),
                np.linspace(strike, total - 1, rest).round().astype(int),
            ]
        )
        picked = np.unique(picked)
    early = picked < strike
    by_tr = np.where(early, strike / max(early.sum(), 1), 0.0)
    late = (total - strike) / max((~early).sum(), 1)
    return picked, by_tr, np.where(early, by_tr, late)


def second_differences(spline: SphericalSpline):
    """Matrix and offset of the coefficients' second differences."""
    n_theta, n_phi = (n + 2 for n in spline.intervals)
    index = np.arange(n_theta * n_phi).reshape(n_theta, n_phi)
    triples = np.concatenate(
        [
            np.stack([index[:-2], index[1:-1], index[2:]], -1).reshape(-1, 3),
            np.stack([index[:, :-2], index[:, 1:-1], index[:, 2:]], -1).reshape(
                -1, 3
            ),
        ]
    )
    D = np.zeros((len(triples), index.size))
    row = np.arange(len(triples))
    D[row, triples[:, 0]] = D[row, triples[:, 2]] = 1.0
    D[row, triples[:, 1]] = -2.0
    T, p0 = spline.free_map()
    return D @ T, D @ p0
