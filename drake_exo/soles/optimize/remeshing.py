"""New elements for a sole whose elements a design has worn out.

A coarse element inverts once s varies within it, though the map does not;
the element floor then stops the search, not the physics. Elements near the
floor also flatter a design: its cost on new ones is higher.

X' = s(p, θ, φ) X is radial and s depends on the direction alone, so that any
mesh of the deformed sole comes from one of the undeformed: X = X'/s. The
deformed sole is meshed anew by Mmg (Dapogny, Dobrzynski, Frey, J. Comput.
Phys. 262, 2014), pulled back, and the same coefficients go on with it.

The surface is kept where that gives sound elements; the volume is then the
same to rounding. Else the surface is meshed anew, too, with all corners and
sharp edges. Its nodes are put back on the undeformed surface along their
rays, so that they lie on the true shape s X and the fixed plane stays plane.

Poor elements are made better by moving the inner nodes of their patch:
towards the centre of its neighbours, or off the face opposite in its worst
element, as far as the worst gains most (constrained Laplacian and
optimisation-based smoothing; Freitag, AMD 220, 1997).
"""

import io
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from scipy.spatial import cKDTree

from drake_exo.errors import InputError, first_line
from drake_exo.soles.compiled import njit
from drake_exo.soles.mesh import FACES, TetMesh, checked_mesh
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.shape import SphericalSpline, onto_edges, pull_back, reach

_SWEEPS, _MOVES = 6, 4
_PARTS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)


def untangled(mesh: TetMesh, least: float) -> TetMesh:
    """The mesh with inner nodes of its poor elements moved.

    Args:
        mesh: Elements may be inverted; nodes of the surface stay.
        least: Quality below which an element is poor.
    """
    nodes = mesh.nodes.copy()
    inner = np.ones(len(nodes), dtype=bool)
    inner[np.unique(mesh.boundary_faces)] = False
    for _ in range(_SWEEPS):
        poor = np.flatnonzero(mesh.with_nodes(nodes).quality() < least)
        if not len(poor):
            break
        # Neighbours of poor elements make room for them.
        around = np.isin(mesh.tets, mesh.tets[poor]).any(axis=1)
        movable = np.unique(mesh.tets[around])
        for node in movable[inner[movable]]:
            star = mesh.tets[(mesh.tets == node).any(axis=1)]
            neighbours = np.setdiff1d(star, node)
            _relax(nodes, node, star, neighbours)
    return mesh.with_nodes(nodes)


@njit(error_model="numpy")
def _relax(nodes, node, star, neighbours) -> None:
    """Move one node where the worst of its elements gains most.

    Args:
        nodes: Of the mesh, (n, 3); changed.
        node: Which.
        star: Its elements, (k, 4).
        neighbours: Their other nodes, (j,).
    """
    here, start, place = nodes[node], np.empty(3), np.empty(3)
    ways = np.empty((2, 3))
    for _ in range(_MOVES):
        best, worst = _least_quality(nodes, star)
        _uprighting(nodes, star[worst], node, ways[1])
        for axis in range(3):
            start[axis] = place[axis] = here[axis]
            ways[0, axis] = -here[axis]
            for i in neighbours:
                ways[0, axis] += nodes[i, axis] / len(neighbours)
        moved = False
        for part in _PARTS:
            for way in ways:
                for axis in range(3):
                    here[axis] = start[axis] + part * way[axis]
                quality, _ = _least_quality(nodes, star)
                if quality > best:
                    best, moved = quality, True
                    for axis in range(3):
                        place[axis] = here[axis]
        for axis in range(3):
            here[axis] = place[axis]
        if not moved:
            break


@njit(error_model="numpy")
def _least_quality(nodes, star):
    """Least mean-ratio quality, as `TetMesh.quality`, and whose."""
    least, worst = np.inf, 0
    normal = np.empty(3)
    for k in range(len(star)):
        tet = star[k]
        l2, v = 0.0, 0.0
        _area(nodes, tet, normal)
        for axis in range(3):
            for a in range(4):
                for b in range(a):
                    l2 += (nodes[tet[a], axis] - nodes[tet[b], axis]) ** 2
            up = nodes[tet[3], axis] - nodes[tet[0], axis]
            v += normal[axis] * up / 3.0
        quality = 12.0 * np.sign(v) * (3.0 * abs(v)) ** (2 / 3) / l2
        if quality < least or quality != quality:  # once NaN, always NaN
            least, worst = quality, k
    return least, worst


@njit(error_model="numpy")
def _uprighting(nodes, tet, node, out):
    """Move of one of a tet's nodes that adds volume, half its extent long."""
    a = 0
    while tet[a] != node:
        a += 1
    _area(nodes, tet[FACES[a]], out)
    extent, area = 0.0, 0.0
    for axis in range(3):
        least, most = np.inf, -np.inf
        for i in tet:
            least = min(least, nodes[i, axis])
            most = max(most, nodes[i, axis])
        extent += (most - least) ** 2
        area += out[axis] ** 2
    for axis in range(3):
        out[axis] *= -0.5 * np.sqrt(extent / area)


@njit()
def _area(nodes, face, out):
    """Area vector of a face's first three nodes, into out (3,)."""
    i, j, k = face[0], face[1], face[2]
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        au, av = nodes[j, u] - nodes[i, u], nodes[j, v] - nodes[i, v]
        bu, bv = nodes[k, u] - nodes[i, u], nodes[k, v] - nodes[i, v]
        out[axis] = 0.5 * (au * bv - av * bu)


_CHILD = Path(__file__).with_name("mmg_child.py")
_MOST_SECONDS = 20  # of processor time; five thousand tets take one
_SOUND = 0.3  # least mean-ratio quality at which the surface is kept
_CARRIES = 0.1  # quality from which on elements of another number do
# Elements of another number: edges of the first try, of the next where those
# are poor, and elements aimed at where they are too few.
_TRIES, _FIRST, _SHORTER, _AIM = 6, 1.1, 0.94, 1.05
_UPRIGHT = 0.2  # least volume of a half, of that of plain halves
_SHARP_DEG = 30.0  # angle between faces' normals at a sharp edge
_FIXED, _BARE = 1, 2  # references of triangles in Mmg
_DISTANCE = 0.02  # from the surface, of the sole's length
_EDGES = np.stack(np.triu_indices(4, 1), axis=-1)  # of a tetrahedron
# A tetrahedron's corners 0-3 and middles 4-9 (of _EDGES) into eight.
_HALVES = np.array(
    [[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3],
     [4, 9, 5, 6], [4, 9, 6, 8], [4, 9, 8, 7], [4, 9, 7, 5]]
)  # fmt: skip


class RemeshError(InputError):
    """The sole could not be meshed anew."""


def remesh(
    mesh: TetMesh,
    spline: SphericalSpline,
    p: np.ndarray,
    usable: Callable[[TetMesh], bool] | None = None,
) -> TetMesh:
    """Mesh the sole of a design anew and pull the mesh back.

    Args:
        mesh: Undeformed sole whose elements are positive at p.
        spline, p: The design.
        usable: Asked of each mesh that would do; by default all are.

    Returns:
        The undeformed sole in other elements. Deformed by p they are sound;
        undeformed, some may be flat or inverted.

    Raises:
        RemeshError: The elements are inverted already, Mmg fails or is not
            installed, or what it gives is no better.
    """
    before = float(_at(mesh, spline, p).quality().min())
    if before <= 0:
        raise RemeshError("the sole's elements are inverted already")
    builds = (
        lambda: _with_surface(mesh, spline, p),
        lambda: _with_halves(mesh, spline, p),
        lambda: _with_sharp_edges(mesh, spline, p),
    )
    choice = _Choice(spline, p, before, usable)
    for build in builds:
        choice.take(build)
        if choice.sound:
            break
    return choice.best()


def remesh_with(
    mesh: TetMesh,
    spline: SphericalSpline,
    p: np.ndarray,
    tets: int,
    usable: Callable[[TetMesh], bool] | None = None,
) -> TetMesh:
    """As `remesh`, with at least `tets` elements and as few more as will do.

    A mesh of another number of elements may not carry the design; made from
    one that does, this one will.

    Args:
        mesh, spline, p, usable: As there.
        tets: Least number of elements.

    Raises:
        RemeshError: As there.
    """

    def enough(new: TetMesh) -> bool:
        return len(new.tets) >= tets and (usable is None or usable(new))

    choice = _Choice(spline, p, _CARRIES, enough, sound=_CARRIES)
    cut = in_eighths(mesh, spline, p)
    size = _FIRST * (len(mesh.tets) / tets) ** (1 / 3)
    for _ in range(_TRIES):
        new = choice.take(partial(_from_eighths, mesh, spline, p, cut, size))
        if choice.sound:
            break
        share = 1.0 if new is None else len(new.tets) / tets
        size *= _SHORTER if share >= 1.0 else (share / _AIM) ** (1 / 3)
    return choice.best()


class _Choice:
    """The best of several meshes for a design.

    Args:
        spline, p: The design.
        least: Quality that a mesh must be above.
        usable: Asked of each that is; by default all are.
        sound: Quality from which on no other need be made.
    """

    def __init__(self, spline, p, least: float, usable=None, sound=_SOUND):
        self._spline, self._p = spline, p
        self._quality, self._usable, self._sound = least, usable, sound
        self._found, self._reason = None, "no element is better for it"

    @property
    def sound(self) -> bool:
        """Whether the best is sound."""
        return self._found is not None and self._quality >= self._sound

    def take(self, build: Callable[[], TetMesh]) -> TetMesh | None:
        """Build another; what came of it, whether kept or not."""
        try:
            new = build()
        except InputError as error:
            self._reason = str(error)
            return None
        shaped = _at(new, self._spline, self._p)
        try:
            checked_mesh(shaped.nodes, shaped.tets, shaped.fixed, "Mmg")
        except InputError as error:
            self._reason = str(error)
            return new
        quality = float(shaped.quality().min())
        if quality > self._quality and (
            self._usable is None or self._usable(new)
        ):
            self._quality, self._found = quality, new
        return new

    def best(self) -> TetMesh:
        """The best of them; RemeshError where none is."""
        if self._found is None:
            raise RemeshError(self._reason)
        return self._found


def _at(mesh: TetMesh, spline, p) -> TetMesh:
    return mesh.with_nodes(spline.deform(mesh.nodes, p))


def _with_surface(mesh: TetMesh, spline, p) -> TetMesh:
    """Other elements inside, the surface as it is."""
    deformed = _at(mesh, spline, p)
    got = _mmg(deformed, sharp_edges(mesh), keep_surface=True)
    nodes, tets = got["nodes"], got["tets"]
    X = pull_back(nodes, spline, p)
    old = np.unique(mesh.boundary_faces)
    new = np.unique(TetMesh(nodes, tets, old).boundary_faces)
    away, which = cKDTree(deformed.nodes[old]).query(nodes[new])
    same = len(old) == len(new) == len(np.unique(which))
    if not same or away.max() > 1e-9 * np.ptp(nodes, axis=0).max():
        raise RemeshError("Mmg has moved nodes of a surface to be kept")
    X[new] = mesh.nodes[old[which]]
    fixed = new[np.isin(old[which], mesh.fixed)]
    return TetMesh(X, tets, np.sort(fixed))


def in_eighths(mesh: TetMesh, spline: SphericalSpline, p: np.ndarray):
    """The sole of a design with every element cut into eight, by itself.

    Args:
        mesh: Undeformed sole whose elements are positive at p.
        spline, p: The design.

    Returns:
        The deformed sole in upright elements, new nodes on the shape where
        that leaves them so; the undeformed one in as many; edge lengths.
    """
    deformed = _at(mesh, spline, p)
    fine, sizes = halved(mesh, edge_lengths(deformed))
    chords, _ = halved(deformed, sizes[: len(mesh.nodes)])
    nodes, least = spline.deform(fine.nodes, p), _UPRIGHT * chords.volumes
    # Middles that turn elements over stay on the chord: upright at last.
    for _ in range(len(nodes)):
        shaped = fine.with_nodes(nodes)
        bad = np.unique(fine.tets[shaped.volumes < least])
        if (nodes[bad] == chords.nodes[bad]).all():
            break
        nodes = nodes.copy()
        nodes[bad] = chords.nodes[bad]
    return shaped, fine, sizes


def _with_halves(mesh: TetMesh, spline, p) -> TetMesh:
    """Another surface, too, from elements that see more of the shape."""
    return _from_eighths(mesh, spline, p, in_eighths(mesh, spline, p), 1.0)


def _from_eighths(mesh: TetMesh, spline, p, cut, size: float) -> TetMesh:
    """Elements of `size` times the edges, from what `in_eighths` gave."""
    shaped, fine, sizes = cut
    got = _mmg(shaped, sharp_edges(fine), sizes=size * sizes)
    return _put_back(mesh, spline, p, got)


def _with_sharp_edges(mesh: TetMesh, spline, p) -> TetMesh:
    """Another surface, too, from the elements there are."""
    got = _mmg(_at(mesh, spline, p), sharp_edges(mesh))
    return _put_back(mesh, spline, p, got)


def _put_back(mesh: TetMesh, spline, p, got) -> TetMesh:
    """Pull back; the surface's nodes onto its own faces, edges and plane."""
    nodes, of = got["nodes"], got["references"]
    fixed = np.unique(got["triangles"][of == _FIXED])
    nodes[fixed, 2] = 0.0
    X = pull_back(nodes, spline, p)
    # Nodes inside follow those of the surface, by how far out they are.
    out = reach(X, X[got["triangles"][of == _BARE]])
    wanted = reach(X, mesh.nodes[mesh.contact_faces])
    there = np.isfinite(out) & np.isfinite(wanted)
    out, wanted = out[there], wanted[there]
    X[there] *= 1.0 + ((wanted / out - 1.0) / out)[:, None]
    sharp = got["sharp"]
    X[sharp] = onto_edges(X[sharp], mesh.nodes[sharp_edges(mesh)])
    X[fixed, 2] = 0.0
    new = TetMesh(X, got["tets"], fixed)
    # The surface has moved: some of the elements under it are poor now.
    shaped = _at(new, spline, p)
    better = untangled(shaped, _SOUND).nodes
    moved = (better != shaped.nodes).any(axis=1)
    if moved.any():
        X[moved] = pull_back(better[moved], spline, p)
    return new.with_nodes(X)


def sharp_edges(mesh: TetMesh) -> np.ndarray:
    """Edges (k, 2) where the undeformed surface bends, and the top's rim."""
    faces = mesh.boundary_faces
    a, b, c = mesh.nodes[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    fixed = np.isin(faces, mesh.fixed).all(axis=1)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    # On a closed surface every edge belongs to two faces.
    pair = np.lexsort(edges.T[::-1]).reshape(-1, 2)
    i, j = pair.T // 3
    bent = (normal[i] * normal[j]).sum(axis=1) < np.cos(np.deg2rad(_SHARP_DEG))
    return edges[pair[bent | (fixed[i] != fixed[j]), 0]]


def edge_lengths(mesh: TetMesh) -> np.ndarray:
    """Mean length of the edges at every node [m], (n,)."""
    ends = mesh.tets[:, _EDGES].reshape(-1, 2)
    length = np.linalg.norm(np.diff(mesh.nodes[ends], axis=1)[:, 0], axis=1)
    total = np.bincount(ends.ravel(), np.repeat(length, 2))
    return total / np.bincount(ends.ravel())


def halved(mesh: TetMesh, values: np.ndarray) -> tuple[TetMesh, np.ndarray]:
    """Every tetrahedron cut into eight; nodal values (n,) interpolated."""
    ends, middle = np.unique(
        np.sort(mesh.tets[:, _EDGES].reshape(-1, 2), axis=1),
        axis=0,
        return_inverse=True,
    )
    n = len(mesh.nodes)
    local = np.concatenate([mesh.tets, n + middle.reshape(-1, 6)], axis=1)
    fixed = np.isin(ends, mesh.fixed).all(axis=1)
    fine = TetMesh(
        np.concatenate([mesh.nodes, mesh.nodes[ends].mean(axis=1)]),
        local[:, _HALVES].reshape(-1, 4),
        np.concatenate([mesh.fixed, n + np.flatnonzero(fixed)]),
    )
    return fine, np.concatenate([values, values[ends].mean(axis=1)])


def _mmg(
    mesh: TetMesh, edges: np.ndarray, keep_surface: bool = False, sizes=()
) -> dict[str, np.ndarray]:
    """What mmg_child.py makes of a deformed mesh."""
    faces = mesh.boundary_faces
    fixed = np.isin(faces, mesh.fixed).all(axis=1)
    node, count = np.unique(edges, return_counts=True)
    whole = io.BytesIO()
    np.savez(
        whole,
        nodes=mesh.nodes,
        tets=mesh.tets,
        triangles=faces,
        references=np.where(fixed, _FIXED, _BARE),
        edges=edges,
        corners=node[count != 2],
        sizes=np.asarray(sizes, float),
        keep_surface=keep_surface,
        distance=_DISTANCE * np.ptp(mesh.nodes, axis=0).max(),
    )
    run = subprocess.run(
        [sys.executable, str(_CHILD), str(_MOST_SECONDS)],
        input=whole.getvalue(),
        capture_output=True,
        check=False,
    )
    if run.returncode != 0:
        said = first_line(run.stderr.decode(errors="replace"))
        raise RemeshError(
            said if run.returncode == 1 and said
            else f"Mmg ended with code {run.returncode}"
        )  # fmt: skip
    try:
        with np.load(io.BytesIO(run.stdout)) as got:
            return {key: got[key] for key in got.files}
    except (BadZipFile, ValueError, OSError, EOFError):
        raise RemeshError("Mmg gave no mesh") from None


_WORN = 0.02  # least volume ratio above the element floor


def is_worn(problem: ShapeProblem, p: np.ndarray) -> bool:
    """Whether a design's elements are at their floor."""
    return problem.margin(p) < _WORN


def with_new_elements(problem: ShapeProblem, p: np.ndarray) -> ShapeProblem:
    """The problem on new elements, on which the design can be simulated.

    Raises:
        RemeshError: There are none.
    """
    mesh = remesh(problem.mesh, problem.spline, p, _simulates(problem, p))
    return problem.with_mesh(mesh, p)


def carried(problem: ShapeProblem, before: TetMesh, p) -> ShapeProblem:
    """The problem on as many elements, made from others that carry a design.

    Args:
        problem: On elements that do not.
        before: Elements that do.
        p: The design.

    Raises:
        RemeshError: There are none.
    """
    usable = _simulates(problem, p)
    tets = len(problem.mesh.tets)
    mesh = remesh_with(before, problem.spline, p, tets, usable)
    return problem.with_mesh(mesh, p)


def _simulates(problem: ShapeProblem, p):
    return lambda mesh: problem.with_mesh(mesh, p).evaluate(p) is not None


def record(stage: int, iteration: int, before, after, p) -> dict:
    """What summary.json says of new elements.

    Args:
        stage, iteration: When; the first stage is 1.
        before, after: The problem on either mesh.
        p: The design.

    Returns:
        stage, iteration, tets, and before and after: least_quality, c_tr and
        c_rot by the stage's law and samples, null where not simulated.
    """
    row = {"stage": stage, "iteration": iteration, "tets": len(after.mesh.tets)}
    for name, problem in (("before", before), ("after", after)):
        e = problem.evaluate(p)
        row[name] = {
            "least_quality": float(problem.deformed(p).quality().min()),
            "c_tr": None if e is None else e.c_tr,
            "c_rot": None if e is None else e.c_rot,
        }
    return row
