"""The shape problem: cost, constraints and their gradients at a design.

Design variables are the spline's free coefficients and, if a walk is sought
with the sole, the walk's numbers. Simulations take first guesses from the last
accepted design's history. A simulation that fails, or whose first contact is on
another branch of poses, gives NaN, which IPOPT takes as a rejected step.
"""

from copy import copy
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix, diags, identity

from drake_exo.errors import InputError
from drake_exo.soles.contact.newton import ContactSolver
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import SphericalSpline, TetMesh, face_edges
from drake_exo.soles.optimize.adjoint import gradients, singular_terms
from drake_exo.soles.optimize.limits import (
    Evaluation,
    SurfaceLimits,
    active_limits,
    limits_of,
    soft_minimum,
)
from drake_exo.soles.results import Step
from drake_exo.soles.settings import Setup, Stage, finer_mesh, stage_mesh
from drake_exo.soles.simulation import (
    sample_weights,
    sigma_max_translation,
    sigma_min_rotation,
    simulate,
    touches_elsewhere,
)

_ELEMENT_SHARPNESS = 200.0
_WORST_SHARPNESS = 40.0  # of the soft maximum of the loads' costs
_WALK_SHARPNESS = 200.0  # of a walk's largest acceleration, sway and slip
_ROUGHEST = 20.0  # extra weight of the roughest change, in `metric`
_LEAST_QUALITY = 0.35  # of an element, over that of its undeformed shape
# Part of a sole's length: above z = 0 the spline's angles are clipped, which
# would tear left and right apart.
_ABOVE = 1e-3
_BEND = 0.1  # a node's difference from its neighbours that costs 1


class ShapeProblem:
    """Minimise c_tr − w c_rot over shapes, or shape and walk, in one stage.

    A design p (P,) is the spline's k free coefficients, then the walk's G
    numbers, each from 0 to 1 in its range (none if the step stays), P = k + G.

    Attributes:
        setup: The initial shape, its step, cost and limits.
        stage: Mesh of the undeformed shape, number of samples and smoothed law
            (its r is frozen). Only the `picked` samples are simulated, weighted
            so that sums stand for all.
        finer: A finer mesh; None if it would have too many elements.
        gait: What of the walk is sought as well; None if the step stays.
        branch: History of the last accepted design, for first guesses.
        first: The initial shape, simulated; it gives the scales.
    """

    def __init__(self, setup: Setup, stage: Stage):
        above = setup.mesh.nodes[:, 2].max()
        if above > _ABOVE * np.ptp(setup.mesh.nodes, axis=0).max():
            raise InputError(
                f"mesh: the sole reaches {1e3 * above:.1f} mm above its frame, "
                "but its shape is sought at z <= 0; give mesh.origin_m in its "
                "top"
            )
        self.setup, self.settings = setup, setup.settings
        self.spline, self.stage = setup.spline(), stage
        mesh = stage_mesh(setup.mesh, stage)
        self.finer = finer_mesh(setup.mesh, stage)
        self.load = setup.load
        self.limits = limits_of(setup.settings, setup.load)
        self.gait = setup.gait
        self._own_walk = self.gait.start if self.gait else np.zeros(0)
        block, cost = self.settings.optimize, self.settings.cost
        self.weight = cost.weight
        self.roughness = block.roughness * stage.roughness
        self.branch, self.evaluations, self._cache = None, 0, {}
        grids = [m for m in (mesh, self.finer) if m is not None]
        self._grids = [_Grid(m, self.spline) for m in grids]
        self._grid = grid = self._grids[0]  # of the mesh that is simulated
        self._sole = setup.sole(mesh)
        self.law = replace(
            setup.law(self._sole), layer=stage.layer_m, kappa=stage.kappa
        )
        self.picked, self.counts, self.by_tr, self.by_rot = sample_weights(
            self.load, cost.heel_strike_fraction, stage.samples
        )
        self.thinned = self.load.at(self.picked)
        bend = bends(mesh) / _BEND
        self._bends = bend @ grid.M, bend @ grid.s0
        moving = (grid.M != 0).any(axis=1)
        self.surface = SurfaceLimits(self.limits, mesh, moving)
        self.first = self.evaluate(self.undeformed)
        if self.first is None:
            raise InputError(
                "the initial shape cannot be simulated; simulate the case, "
                "which tells why, and change its load, material or mesh; if "
                "it holds, give optimize.stages a smaller layer_m (sole front "
                "keeps its own)"
            )
        self.scales = np.abs(self._costs(self.first))
        self.limited = active_limits(
            self.limits, self.first, self.by_rot, setup.up
        )

    @property
    def mesh(self) -> TetMesh:
        """Mesh of the undeformed shape."""
        return self._sole.mesh

    @property
    def undeformed(self) -> np.ndarray:
        """The design of the initial shape in the case's own walk, (P,)."""
        return np.append(np.ones(self.spline.count), self._own_walk)

    def within(self, bounds: tuple[float, float]) -> np.ndarray:
        """Lower and upper bounds of a design, (2, P), from a coefficient's."""
        shape = np.outer(bounds, np.ones(self.spline.count))
        walk = np.outer((0.0, 1.0), np.ones(len(self._own_walk)))
        return np.hstack([shape, walk])

    def _split(self, p) -> tuple[np.ndarray, np.ndarray]:
        return np.split(p, [self.spline.count])

    def load_of(self, p: np.ndarray) -> Load:
        """All samples of a design's step.

        Raises:
            InputError: No ZMP inside its bounds carries the design's walk.
        """
        return self.gait.load(self._split(p)[1]) if self.gait else self.load

    def deformed(self, p: np.ndarray) -> TetMesh:
        """The mesh of a design; elements may be inverted."""
        return self.mesh.with_nodes(self._grid.places(self._split(p)[0]))

    def step(self, p: np.ndarray) -> Step:
        """Simulate all samples by the exact law, from a cold start."""
        setup = replace(self.setup, load=self.load_of(p))
        sole = setup.sole(self.deformed(p))
        return Step.of(setup, sole, self.law.penalty)

    def evaluate(self, p: np.ndarray) -> Evaluation | None:
        """Simulate a design; None if it cannot be simulated."""
        key = p.tobytes()
        if key not in self._cache:
            try:
                self._cache = {key: self._simulate(p.copy())}
            except np.linalg.LinAlgError:  # a shape that cannot carry load
                self._cache = {key: None}
            self.evaluations += 1
        return self._cache[key]

    def _simulate(self, p):
        nodes = self._grid.places(self._split(p)[0])
        sole = self._sole.with_nodes(nodes)
        if sole.mesh.volumes.min() <= 0:
            return None
        solver = ContactSolver.of(
            sole, self.law, tolerance=1e-12, ground=self.setup.ground
        )
        try:
            load = self.load_of(p).at(self.picked)
        except InputError:  # there is no such walk
            return None
        history = simulate(
            solver,
            load,
            self.setup.start,
            stop_at_failure=True,
            near=self.branch,
            keep=True,
        )
        if history.failed_steps:
            return None
        if touches_elsewhere(sole, self.law, history, self.setup.ground):
            # A node not meant to touch did: from now on all bare nodes may.
            everywhere = self.mesh.touching_everywhere()
            self._sole = replace(self._sole, mesh=everywhere)
            self.branch = None
            return self._simulate(p)
        return Evaluation(
            sole,
            solver,
            history,
            float(self.by_tr @ sigma_max_translation(history.K_c)),
            float(self.by_rot @ sigma_min_rotation(history.K_c)),
            self.counts,
            load,
        )

    def _costs(self, e: Evaluation) -> np.ndarray:
        """Cost c of every contact phase, times its share, (K,)."""
        K = e.history.K_c
        c = self.by_tr * sigma_max_translation(K)
        c = c - self.weight * self.by_rot * sigma_min_rotation(K)
        return np.add.reduceat(c, self.thinned.begins)

    def _combined(self, e: Evaluation) -> tuple[float, np.ndarray]:
        """Mean or soft maximum of c / |c̄| over phases; its derivatives (K,).

        c̄ is the initial shape's; the derivatives are by the phases' c.
        """
        ratios, shares = self._costs(e) / self.scales, self.load.shares
        if self.settings.cost.of == "mean":
            return float(shares @ ratios), shares / self.scales
        value, share = soft_minimum(-ratios, _WORST_SHARPNESS)
        return -value, share / self.scales

    def cost(self, p: np.ndarray) -> float:
        """Scaled c plus the regularization; NaN where the simulation fails."""
        e = self.evaluate(p)
        if e is None:
            return np.nan
        return self._combined(e)[0] + self.regularization(p)[0]

    def cost_on_finer(self, p: np.ndarray) -> float | None:
        """The design's cost on the finer mesh.

        None if there is no such mesh or the simulation fails there.
        """
        if self.finer is None:
            return None
        there = copy(self)
        there._grid, there.branch, there._cache = self._grids[1], None, {}
        there._sole = self.setup.sole(self.finer)
        there.law = replace(self.law, penalty=there._sole.penalty)
        cost = there.cost(p)
        return cost if np.isfinite(cost) else None

    def names(self) -> list[str]:
        """Names of the constraints, each to be at least 0."""
        rigid = [
            name for name, *_ in self.shape_limits(self.undeformed, self.mesh)
        ]
        walk = self.gait.limits(self._own_walk) if self.gait else ()
        return [*rigid, *self.limited, *walk]

    def shape_limits(
        self, p: np.ndarray, mesh: TetMesh
    ) -> list[tuple[str, float, np.ndarray]]:
        """Limits on the shape alone, of a design p and its deformed mesh.

        Name, scaled value and its derivatives (k,) by the coefficients, each.
        """
        full, by = self.limits["volume"], self.by_coefficients
        left, slope = 1 - mesh.volume / full, by(mesh.volume_gradient()) / full
        others = self.surface.evaluate(mesh)
        return [
            ("volume", left, -slope),
            ("elements", *self._elements(self._split(p)[0])),
            *((name, value, by(X)) for name, value, X in others),
        ]

    def constraints(self, p: np.ndarray) -> np.ndarray:
        """Scaled constraint values, feasible where >= 0."""
        e = self.evaluate(p)
        if e is None:
            return np.full(len(self.names()), np.nan)
        values = [value for _, value, _ in self.shape_limits(p, e.sole.mesh)]
        values += [limit(e)[0] for limit in self.limited.values()]
        if self.gait:
            values += self._worst(self.gait.limits(self._split(p)[1]))[0]
        return np.array(values)

    def _worst(self, limits: dict[str, np.ndarray]):
        """Soft minimum of each of the walk's limits; the samples' shares."""
        pairs = [soft_minimum(x, _WALK_SHARPNESS) for x in limits.values()]
        return tuple(map(list, zip(*pairs, strict=True)))

    def accept(self, p: np.ndarray) -> None:
        """Accept a design: later ones stay on its branch of poses."""
        self.branch = replace(self.evaluate(p).history, linear=[])

    def leave_branch(self) -> None:
        """Forget the accepted design: the next one may be on any branch."""
        self.branch, self._cache = None, {}

    def derivatives(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the cost (P,) and Jacobian of the constraints (m, P).

        Without the regularization, see `regularization`. Derivatives by the
        walk chain the adjoint's, by force and ZMP, with those of the plan.
        """
        gradient, rows, by_load = self._derivatives(p)
        if not self.gait:
            return gradient, rows
        walk = self._split(p)[1]
        loads, limits = self.gait.slopes(walk)
        _, shares = self._worst(self.gait.limits(walk))
        own = np.array(list(map(np.matmul, shares, limits.values())))
        by_walk = np.einsum("fnk,gnk->fg", by_load, loads[:, self.picked])
        others = np.zeros((len(rows) + 1 - len(by_walk), len(walk)))
        shape = np.zeros((len(own), self.spline.count))
        return np.concatenate([gradient, by_walk[0]]), np.block(
            [[rows, np.concatenate([others, by_walk[1:]])], [shape, own]]
        )

    def _derivatives(self, p) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `derivatives`, by the shape alone; those by the load (f, N, 5)."""
        e = self.evaluate(p)
        if e is None:
            raise RuntimeError("no derivatives where the simulation failed")
        by_c = self._combined(e)[1][self.thinned.phase]
        cost = singular_terms(
            e.history.K_c, self.by_tr * by_c, -self.weight * self.by_rot * by_c
        )
        parts = [cost, *(limit(e)[1]() for limit in self.limited.values())]
        by_nodes, by_load = gradients(
            e.sole, e.solver, e.load, self.setup.start, e.history, parts
        )
        cost, *rows = map(self.by_coefficients, by_nodes)
        shape = [row for *_, row in self.shape_limits(p, e.sole.mesh)]
        return cost, np.array([*shape, *rows]), by_load

    def regularization(self, p: np.ndarray):
        """Roughness cost of the shape: value, gradient (P,), Hessian (P, P)."""
        d, d0 = self._bends
        shape, walk = self._split(p)
        bend, factor = d @ shape + d0, self.roughness / len(d)
        return (
            factor * float(bend @ bend),
            np.pad(2 * factor * (d.T @ bend), (0, len(walk))),
            np.pad(2 * factor * (d.T @ d), (0, len(walk))),
        )

    @property
    def metric(self) -> np.ndarray:
        """Sobolev H² metric of designs, (P, P): smooth changes count less.

        As first Hessian it makes a search bend the shape before it wrinkles it,
        and find smoother optima. A walk's number counts like a coefficient.
        """
        bends = self._bends[0].T @ self._bends[0]
        largest = np.linalg.eigvalsh(bends)[-1]
        shape = np.eye(len(bends)) + _ROUGHEST * bends / largest
        return block_diag(shape, np.eye(len(self._own_walk)))

    def _elements(self, coefficients) -> tuple[float, np.ndarray]:
        """Soft minimum of the elements' quality less its floor; slope (k,).

        The continuous map never inverts, but an element in which s varies may.
        The limit keeps to designs that these elements, and finer ones, resolve.
        """
        meshes = [
            grid.mesh.with_nodes(grid.places(coefficients))
            for grid in self._grids
        ]
        parts = [
            mesh.quality() / grid.rest
            for mesh, grid in zip(meshes, self._grids, strict=True)
        ]
        value, share = soft_minimum(
            np.concatenate(parts) - _LEAST_QUALITY, _ELEMENT_SHARPNESS
        )
        shares = np.split(share, np.cumsum([len(q) for q in parts])[:-1])
        slopes = [
            grid.by_coefficients(mesh.quality_gradient(share / grid.rest))
            for mesh, grid, share in zip(
                meshes, self._grids, shares, strict=True
            )
        ]
        return value, sum(slopes)

    def by_coefficients(self, X: np.ndarray) -> np.ndarray:
        """Chain rule from node positions (n, 3) to coefficients (k,)."""
        return self._grid.by_coefficients(X)


class _Grid:
    """A mesh of the undeformed sole, its nodes moved by coefficients (k,).

    `rest` is the quality of its elements at rest, (e,).
    """

    def __init__(self, mesh: TetMesh, spline: SphericalSpline):
        self.mesh, self.rest = mesh, mesh.quality()
        self.M, self.s0 = spline.basis(mesh.nodes)

    def places(self, coefficients: np.ndarray) -> np.ndarray:
        """Places of the nodes in a shape [m], (n, 3)."""
        return (self.M @ coefficients + self.s0)[:, None] * self.mesh.nodes

    def by_coefficients(self, X: np.ndarray) -> np.ndarray:
        """Chain rule from node positions (n, 3) to coefficients (k,)."""
        return self.M.T @ (X * self.mesh.nodes).sum(axis=1)


def bends(mesh: TetMesh) -> csr_matrix:
    """Matrix (k, n): at bare nodes a field's mean over neighbours less its own.

    This is h²/4 to 3 h²/8 of its surface Laplacian, h the elements' size, so it
    counts what the elements do not resolve, however fine the spline. Nodes at
    the rim of the fixed surface have no row.
    """
    faces = mesh.contact_faces
    edges = face_edges(faces)
    n, both = len(mesh.nodes), np.concatenate([edges, edges[:, ::-1]])
    near = csr_matrix((np.ones(len(both)), both.T), shape=(n, n))
    near.data[:] = 1.0  # an edge is met once from either side
    inside = np.setdiff1d(np.unique(faces), mesh.fixed)
    mean = diags(1.0 / near.sum(axis=1).A1[inside]) @ near[inside]
    return mean - identity(n, format="csr")[inside]
