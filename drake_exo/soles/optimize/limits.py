"""Limits on a design: scaled value, at least 0 where met, and derivative.

Limits that need a simulation return a value and a function that makes the
adjoint's input; `SurfaceLimits` are of the shape alone. Minima over samples
are soft and err on the safe side. The largest strain is measured by

    Φ = (Σ_q n_q Σ_e tr ε_qe^p)^(1/p), p even,

the p-norm of all principal strains over samples q and elements (or nodes) e:
never below the largest |principal strain|, and smooth without eigenvalues.
n_q is how many samples q stands for, so thinned samples give about Φ of all.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from drake_exo.soles.contact.newton import ContactSolver
from drake_exo.soles.elasticity import Sole, gradient_operators, pairs
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh, scatter
from drake_exo.soles.numerics import multiply, njit
from drake_exo.soles.optimize.adjoint import (
    Derivative,
    heavy,
    singular_terms,
    stability_terms,
    tilt_terms,
)
from drake_exo.soles.settings import Settings
from drake_exo.soles.simulation import StepHistory, stability

ORDER = 64  # p
_BATCH = 32  # samples at a time
# Strains (Frobenius) below this part of the largest principal one are left out:
# they add less than 1e-13.
_FAINT = 0.5


@dataclass
class StrainNorm:
    """Φ of a simulated design; sample q stands for counts[q] samples, (N,)."""

    sole: Sole
    history: StepHistory
    counts: np.ndarray

    def __post_init__(self):
        history = self.history
        f = np.einsum("qmi,qij->qmj", history.F, history.R)
        self._u = self.sole.displacement(f)
        self._collect()
        unit = np.sqrt((self._eps**2).sum(axis=(1, 2)).max())
        power = _powers(self._eps / unit, ORDER)
        total = np.trace(power, axis1=1, axis2=2) @ self.counts[self._q]
        self.value = float(unit * total ** (1 / ORDER))

    def _collect(self) -> None:
        """Find strains that matter: sample, element or node, H = ∂u/∂x."""
        mesh = self.sole.mesh
        operators = gradient_operators(mesh)
        if self.sole.element == "smoothed":
            self._nodes = self.sole.node_average
            operators = [self._nodes @ D for D in operators]
        found, largest = [], 0.0
        for first in range(0, len(self._u), _BATCH):
            u = self._u[first : first + _BATCH]
            flat = np.moveaxis(u, 0, -1).reshape(len(mesh.nodes), -1)
            H = np.stack(
                [(D @ flat).reshape(-1, 3, len(u)) for D in operators], axis=2
            )
            size = ((H + np.swapaxes(H, 1, 2)) ** 2).sum(axis=(1, 2)) / 4
            largest = max(largest, size.max())
            # The largest principal strain is at least largest / √3.
            e, q = np.nonzero(size > _FAINT**2 * largest / 3)
            found.append((q + first, e, H[e, :, :, q]))
        q, e, H = (np.concatenate(part) for part in zip(*found, strict=True))
        eps = 0.5 * (H + np.swapaxes(H, 1, 2))
        size = (eps**2).sum(axis=(1, 2))
        principal = np.abs(np.linalg.eigvalsh(eps[size.argmax()])).max()
        keep = size > (_FAINT * principal) ** 2
        self._q, self._e = q[keep], e[keep]
        self._H, self._eps = H[keep], eps[keep]

    def derivatives(self, factor: float = 1.0) -> Derivative:
        """The adjoint's input for factor · Φ: ∂/∂ nodal forces and nodes."""
        sole, mesh = self.sole, self.sole.mesh
        by_nodes = np.zeros_like(mesh.nodes)
        if sole.element == "linear":
            q, e, H, G = self._q, self._e, self._H, self._by_strain()
        else:
            q, e, H, G = self._elements_around(by_nodes)
        tets, g = mesh.tets[e], np.swapaxes(mesh.gradients[e], 1, 2)
        shape = self._u.shape
        pull = np.zeros((shape[0] * shape[1], 3))
        place = q[:, None] * shape[1] + tets
        scatter(pull, place, np.swapaxes(G @ g, 1, 2))
        pull = pull.reshape(shape)
        # Gradients of the shape functions change with the nodes.
        moved = np.swapaxes(H, 1, 2) @ G @ g
        scatter(by_nodes, tets, -np.swapaxes(moved, 1, 2))
        kept = heavy(pull)
        free = sole.free
        u = self._u[kept][:, free].reshape(len(kept), -1).T
        v = sole.factor.solve(pull[kept][:, free].reshape(len(kept), -1).T)
        by_force = {
            q: factor * column.reshape(-1, 3)
            for q, column in zip(kept, v[sole.contact_rows].T, strict=True)
        }
        fields, factors = pairs(v, u)
        return Derivative(
            by_force=by_force,
            by_nodes=factor * by_nodes,
            fields=(fields, factor * factors),
        )

    def _elements_around(self, by_nodes: np.ndarray):
        """For averaged strains: samples, elements, their H and ∂Φ/∂ε (k, 3, 3).

        The averages' weights move, too: their part is added to `by_nodes`.
        """
        mesh, A = self.sole.mesh, self._nodes
        counts = np.diff(A.indptr)[self._e]
        owner = np.repeat(np.arange(len(counts)), counts)
        first = np.repeat(
            A.indptr[self._e] - np.cumsum(counts) + counts, counts
        )
        entry = first + np.arange(len(owner))
        e, share, q = A.indices[entry], A.data[entry], self._q[owner]
        g = mesh.gradients[e]
        H = np.swapaxes(self._u[q[:, None], mesh.tets[e]], 1, 2) @ g
        G = share[:, None, None] * self._by_strain()[owner]
        # A weight is the element's volume over that of all around the node.
        gain = (G * (H - self._H[owner])).sum(axis=(1, 2))
        scatter(by_nodes, mesh.tets[e], gain[:, None, None] * g)
        return q, e, H, G

    def _by_strain(self) -> np.ndarray:
        """∂Φ/∂ε = n (ε/Φ)^(p−1), (k, 3, 3)."""
        out = _powers(self._eps / self.value, ORDER - 1)
        return out * self.counts[self._q][:, None, None]


@njit()
def _powers(matrices, order):
    """Powers of 3 × 3 matrices, by squaring."""
    out = np.empty_like(matrices)
    square, product = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(matrices)):
        square[:] = matrices[k]
        out[k] = np.eye(3)
        left = order
        while left:
            if left % 2:
                multiply(out[k], square, product)
                out[k] = product
            multiply(square, square, product)
            square[:] = product
            left //= 2
    return out


_SHARPNESS = 60.0  # ρ of the soft minimum over samples
_SURFACE_SHARPNESS = 500.0  # likewise over nodes or faces of the surface
_DOWNWARDS = 0.5  # normals with more than this downwards are the bottom's
_TILT_SCALE = 0.06  # 1 − cos 20°
_DRAFT_SCALE = 0.1  # rad
_UPRIGHT = 1e-3  # rad by which an edge may exceed a draft and count as at it
# Violation of a scaled limit that counts as none, and the share of a limit that
# final checks allow: it was met by the smoothed law.
FEASIBLE, ROUNDING = 5e-3, 0.01
_MET = 10.0  # value of samples without a limit: no share in a soft minimum


@dataclass
class Evaluation:
    """A simulated design with its c_tr [N/m] and c_rot [N·m/rad].

    Each simulated sample, with the force and ZMP in `load`, stands for
    `counts` samples, (N,).
    """

    sole: Sole
    solver: ContactSolver
    history: StepHistory
    c_tr: float
    c_rot: float
    counts: np.ndarray
    load: Load

    @cached_property
    def strain(self) -> StrainNorm:
        """The p-norm of its principal strains."""
        return StrainNorm(self.sole, self.history, self.counts)


# Each limit returns its scaled value and a function that makes a `Derivative`.


def limits_of(settings: Settings, load: Load) -> dict[str, float]:
    """The case's limits that are not switched off and hold for a load, by name.

    Largest volume [m³], strain (its p-norm), tilt_deg and height of the bare
    surface [m]; least `stability` (scaled eigenvalue) [N/m], c_rot [N·m/rad],
    depth of the bottom below the top plane [m] and draft_deg, angle of bare
    faces with the vertical, so that a mould that opens upwards lets go.
    """
    block, shape = settings.optimize, settings.optimize.shape
    density = settings.material.material().density_kg_per_m3
    # A pose that is prescribed does not tip, and no shape changes it.
    held = bool(load.is_measured.all())
    every = {
        "volume": settings.cost.mass_limit_kg / density,
        "stability": None if held else block.stability_n_per_m,
        "tilt_deg": None if held else block.tilt_deg,
        "strain": block.strain,
        "c_rot": block.c_rot_nm_per_rad,
        "depth": shape.least_depth_m,
        "height": shape.largest_height_m,
        "draft_deg": shape.draft_deg,
    }
    return {name: x for name, x in every.items() if x is not None}


def _stability(e: Evaluation, least: float, scale: float):
    """Least stability over samples above its limit, scaled; see `stability`."""
    K = e.history.K_c
    y, slope = _saturate((stability(K) - least) / scale)
    value, share = _least_free(e, y)
    return value, lambda: stability_terms(K, share * slope / scale)


def _tilt(e: Evaluation, largest_deg: float, up: np.ndarray):
    """Least cos(tilt) over samples less that of the largest tilt, scaled."""
    R = e.history.R
    margin = R[:, :, 2] @ up - np.cos(np.deg2rad(largest_deg))
    value, share = _least_free(e, margin / _TILT_SCALE)
    return value, lambda: tilt_terms(R, up, share / _TILT_SCALE)


def strain_limit(e: Evaluation, largest: float):
    """Limit on strain, 1 − Φ / largest."""
    return 1.0 - e.strain.value / largest, (
        lambda: e.strain.derivatives(-1.0 / largest)
    )


def rotation_limit(e: Evaluation, least: float, by_rot: np.ndarray):
    """Limit on c_rot, c_rot / least − 1; `by_rot` (N,) are its weights."""
    zero = np.zeros(len(by_rot))
    return e.c_rot / least - 1.0, (
        lambda: singular_terms(e.history.K_c, zero, by_rot / least)
    )


def _least_free(e: Evaluation, x: np.ndarray):
    """Soft minimum of x (N,) over samples with a free pose; derivatives (N,).

    A prescribed pose does not tip, and no shape changes it.
    """
    held = e.load.is_measured
    value, share = soft_minimum(np.where(held, _MET, x))
    return value, np.where(held, 0.0, share)


def active_limits(
    limits: dict[str, float], first: Evaluation, by_rot: np.ndarray, up
) -> dict[str, Callable]:
    """Functions of the limits that need a simulation, by name.

    The initial shape `first` gives their scales; `by_rot` (N,) are the samples'
    weights in c_rot, `up` (3,) is the ground's normal.
    """
    out = {}
    if least := limits.get("stability"):
        # If the initial shape is hardly stable, the limit itself is the scale.
        margin = stability(first.history.K_c)[~first.load.is_measured]
        scale = max(abs(float(margin.min())), least)
        out["stability"] = partial(_stability, least=least, scale=scale)
    if "tilt_deg" in limits:
        largest = limits["tilt_deg"]
        out["tilt_deg"] = partial(_tilt, largest_deg=largest, up=up)
    if "strain" in limits:
        out["strain"] = partial(strain_limit, largest=limits["strain"])
    if least := limits.get("c_rot"):
        out["c_rot"] = partial(rotation_limit, least=least, by_rot=by_rot)
    return out


@dataclass(frozen=True)
class SurfaceLimits:
    """Limits on the shape alone, soft minima over surface nodes or faces.

    Bottom and sides are told apart on the undeformed `mesh`. Only nodes that a
    design can move count: `moving`, (n,) bool.
    """

    limits: dict[str, float]
    mesh: TetMesh
    moving: np.ndarray

    def measures(self, mesh: TetMesh) -> dict[str, float]:
        """Least depth [m], largest height [m] and least draft [°].

        If no node of the bottom moves, the depth is over all contact nodes.
        """
        z = mesh.nodes[:, 2]
        up = _normals(mesh, self._sides)[1].max(initial=-1.0)
        bottom = self._bottom if self._bottom.size else self.mesh.contact
        return {
            "depth": float(-z[bottom].max()),
            "height": float(-z[self._bare].min()),
            "draft": -float(np.rad2deg(np.arcsin(np.clip(up, -1, 1)))),
        }

    @cached_property
    def _bare(self) -> np.ndarray:
        """Nodes of the bare surface that move."""
        return np.intersect1d(self.mesh.bare, np.flatnonzero(self.moving))

    @cached_property
    def _bottom(self) -> np.ndarray:
        """Those on faces that look downwards rather than sideways.

        Faces at the top's rim, such as a corner that coarse elements cut off,
        belong to the sides: no design gives them any depth.
        """
        faces = self.mesh.contact_faces
        down = _normals(self.mesh, faces)[1] < -_DOWNWARDS
        down &= ~np.isin(faces, self.mesh.fixed).any(axis=1)
        return np.intersect1d(faces[down], self._bare)

    @cached_property
    def _sides(self) -> np.ndarray:
        """Bare faces (f, 3) that move, without upward ones at the rim.

        A face has no more draft than any of its edges: one with an edge that
        is held and has too little is left out, too.
        """
        faces, nodes = self.mesh.contact_faces, self.mesh.nodes
        out = _normals(self.mesh, faces)[1] > _DOWNWARDS
        out &= np.isin(faces, self.mesh.fixed).any(axis=1)
        moving = self.moving[faces]
        steep = np.sin(np.deg2rad(self.limits.get("draft_deg", -90.0)))
        for k in range(3):
            edge = nodes[faces[:, k - 1]] - nodes[faces[:, k - 2]]
            level = np.hypot(edge[:, 0], edge[:, 1])
            held = ~moving[:, k - 1] & ~moving[:, k - 2]
            length = np.linalg.norm(edge, axis=1)
            out |= held & (level <= (steep + _UPRIGHT) * length)
        return faces[~out & moving.any(axis=1)]

    def evaluate(self, mesh: TetMesh) -> list[tuple[str, float, np.ndarray]]:
        """The limits: name, scaled value (>= 0 where met), ∂/∂nodes (n, 3)."""
        mine, out = self.limits, []
        z = mesh.nodes[:, 2]
        for name, nodes, sign, limit in (
            ("depth", self._bottom, -1.0, mine.get("depth")),
            ("height", self._bare, 1.0, mine.get("height")),
        ):
            if limit is not None and len(nodes):
                excess = sign * (z[nodes] / limit + 1.0)
                value, share = soft_minimum(excess, _SURFACE_SHARPNESS)
                by_nodes = np.zeros_like(mesh.nodes)
                by_nodes[nodes, 2] = sign * share / limit
                out.append((name, value, by_nodes))
        faces = self._sides
        if "draft_deg" in mine and len(faces):
            normal, up, size = _normals(mesh, faces)
            value, share = soft_minimum(
                -up - np.sin(np.deg2rad(mine["draft_deg"])), _SURFACE_SHARPNESS
            )
            # The final check is on the angle: no allowance of `FEASIBLE` here.
            value = value / _DRAFT_SCALE - FEASIBLE
            share = share / _DRAFT_SCALE
            # ∂(a_z/|a|)/∂a, and a = (p1 − p0) × (p2 − p0).
            pull = -normal * up[:, None]
            pull[:, 2] += 1.0
            pull *= (-share / size)[:, None]
            x, by_nodes = mesh.nodes[faces], np.zeros_like(mesh.nodes)
            for k in range(3):
                edge = x[:, (k + 2) % 3] - x[:, (k + 1) % 3]
                np.add.at(by_nodes, faces[:, k], np.cross(pull, edge))
            out.append(("draft_deg", value, by_nodes))
        return out


def _normals(mesh: TetMesh, faces: np.ndarray):
    """Outward normals (f, 3), their upward part (f,), 2 × area (f,)."""
    area, size = mesh.areas(faces)
    normal = area / size[:, None]
    return normal, normal[:, 2], size


def _saturate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x / √(1 + x²), so that no sample dominates, and its slope."""
    root = np.sqrt(1 + x**2)
    return x / root, root**-3


def soft_minimum(
    x: np.ndarray, sharpness: float = _SHARPNESS
) -> tuple[float, np.ndarray]:
    """−log Σ exp(−ρ x) / ρ, never above min x, and its derivatives."""
    low = x.min()
    e = np.exp(-sharpness * (x - low))
    return float(low - np.log(e.sum()) / sharpness), e / e.sum()
