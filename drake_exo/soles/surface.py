"""Mesh a closed surface (STL, OBJ) with the tetrahedra of a sole.

Mmg cuts a grid at the zero level of the signed distance to the surface
(Dapogny, Dobrzynski, Frey, J. Comput. Phys. 262, 2014). The nodes of the inner
part are moved onto the surface and its sharp edges, which a level set cuts off.
This part is meshed anew with elements sized by the local thickness, and its
nodes are moved once more. A flat top is a face of the grid.

Mmg runs in a process of its own, since it never ends for some bodies.
"""

import resource
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import igl
import numpy as np
from manifold3d import Manifold, OpType
from scipy.spatial import cKDTree

from drake_exo.errors import InputError, first_line
from drake_exo.files.mesh import read_cells
from drake_exo.jobs.engine import ATTEMPTS, Job, Worker
from drake_exo.soles.mesh import (
    TetMesh,
    check_size,
    check_top,
    check_turned,
    checked_mesh,
    connected,
    corners_of,
    face_edges,
    grid_mesh,
    normals_of,
    solid,
)


class MmgError(InputError):
    """Mmg fails, or takes too long."""


def run_mmg(body: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and tetrahedra (e, 4) of Mmg's mesh of a body.

    Args:
        body: Its `nodes` (n, 3) and `tets` (e, 4), and either
            `level` (n,), at whose zero the cells, of size `step` [m], are
            cut; or
            `size` (n,), edge length of the new elements [m].

    Raises:
        MmgError: Mmg fails, or takes too long.
    """
    worker = Worker()
    try:
        job = Job("Mmg", f"{__name__}:_remeshed", {"body": body})
        worker.start(job, ATTEMPTS)  # a second attempt would end likewise
        ended = worker.end()
    finally:
        worker.close()
    if ended.state == "lost":
        raise MmgError(f"Mmg ended with code {worker.code}")
    if ended.state != "done":
        raise MmgError(ended.error)
    return ended.value


def _remeshed(body) -> tuple[np.ndarray, np.ndarray]:
    """Mmg's mesh of `run_mmg`'s body, computed in this process."""
    resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
    try:
        return _by_mmg(body)
    except Exception as error:  # whatever Mmg makes of it
        raise MmgError(f"Mmg: {first_line(str(error))}") from error


def _by_mmg(body) -> tuple[np.ndarray, np.ndarray]:
    from mmgpy import MmgMesh3D

    mesh = MmgMesh3D()
    counts = {"vertices": len(body["nodes"]), "tetrahedra": len(body["tets"])}
    mesh.set_mesh_size(**counts)
    mesh.set_vertices(body["nodes"], None)
    mesh.set_tetrahedra(body["tets"].astype(np.int32), None)
    if "level" in body:
        step = float(body["step"])
        mesh.remesh_levelset(
            body["level"][:, None],
            hmax=1.3 * step, hmin=0.5 * step, hausd=0.1 * step, verbose=-1,
        )  # fmt: skip
        # Mmg's reference of cells below zero.
        inside = mesh.get_tetrahedra_with_refs()[1] == 3
        return mesh.get_vertices(), mesh.get_tetrahedra()[inside]
    mesh.set_field("metric", body["size"][:, None])
    typical = float(np.median(body["size"]))
    mesh.remesh(hgrad=_GRADATION, hausd=0.1 * typical, verbose=-1)
    return mesh.get_vertices(), mesh.get_tetrahedra()


Unit = Literal["m", "cm", "mm", "inch"]
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
SUFFIXES = (".stl", ".obj")
_FOOT = (0.1, 0.45)  # longest side of a foot's sole [m]
_FLAT = 2e-3  # depth of a flat top's faces, over the longest side
_GRID = 0.5  # size of the grid's cells over that of an element
_SECONDS = 120  # of processor time for Mmg
_GRADATION = 1.3  # largest ratio of neighbouring elements' sizes
_FILL = 36.0  # tetrahedra that Mmg makes in the cube of an element's edge
_SHARP = 0.77  # cosine between the normals beside a sharp edge: 40 degrees
_PATCH = 4.0  # least area of a patch, in squares of a typical size
_LEAST_VOLUME = 1e-9  # over the cube of the longest side
_SAME_VOLUME = 0.05  # largest error of a mesh's volume
_SAMPLES = 20_000  # points of a surface at which it is compared with a mesh
_LEVEL = 0.02  # typical sizes that Mmg may leave nodes off a flat top
_THERE = 0.3  # typical sizes within which a node counts as on an edge
_LEAST_QUALITY = 0.3  # of elements after their nodes are moved
_SHORTER = 12  # trials of a move, each half as long where elements suffer


@dataclass(frozen=True)
class Surface:
    """A closed surface: outward triangles (t, 3, 3) [m], its file's name."""

    corners: np.ndarray
    name: str

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return float(np.linalg.det(self.corners).sum() / 6)


def read_surface(path: Path | str, unit: Unit | None = None) -> Surface:
    """Read a closed surface and turn its triangles outwards.

    Args:
        path: STL or OBJ file; neither knows units.
        unit: Unit of its lengths; by default told from the size.

    Raises:
        InputError: Unreadable, not closed, or of a size that is a foot's in
            neither metres nor millimetres.
    """
    path = Path(path)
    remedy = "export it again as STL or OBJ"
    nodes, faces, _ = read_cells(path, "triangle", remedy)
    if len(faces) == 0:
        raise InputError(f"{path}: holds no triangles; export a triangle mesh")
    longest = float(np.ptp(nodes[faces.ravel()], axis=0).max())
    nodes, faces = _merged(nodes * _scale(path, longest, unit), faces)
    if np.linalg.det(nodes[faces]).sum() < 0:
        faces = faces[:, ::-1]
    nodes, faces = _parted(path, nodes, faces)
    surface = Surface(_united(path, nodes, faces), str(path))
    if not surface.volume > _LEAST_VOLUME * np.ptp(nodes, axis=0).max() ** 3:
        raise InputError(
            f"{path}: encloses no volume; export a solid, not a sheet"
        )
    return surface


def _scale(path, longest: float, unit: Unit | None) -> float:
    if unit is not None:
        return UNITS[unit]
    # A shoe's size in centimetres and one in inches cannot be told apart.
    fits = [
        name
        for name in ("m", "mm")
        if _FOOT[0] < longest * UNITS[name] < _FOOT[1]
    ]
    if not fits:
        raise InputError(
            f"{path}: its longest side is {longest:g}, a foot's in neither "
            "metres nor millimetres; give mesh.unit (m, cm, mm or inch)"
        )
    return UNITS[fits[0]]


def _merged(nodes, faces) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and faces with coincident nodes merged, empty faces dropped."""
    first, which = _coincident(nodes)
    faces = which[faces]
    a, b, c = faces.T
    return nodes[first], faces[(a != b) & (b != c) & (c != a)]


def _coincident(places) -> tuple[np.ndarray, np.ndarray]:
    """Indices of distinct places, to 1e-6 of the extent; which one each is."""
    step = 1e-6 * np.ptp(places, axis=0).max()
    distinct, exact = np.unique(places, axis=0, return_inverse=True)
    pairs = cKDTree(distinct).query_pairs(step, output_type="ndarray")
    group = connected(len(distinct), *pairs.T)[1][exact.ravel()]
    _, first, which = np.unique(group, return_index=True, return_inverse=True)
    order = np.lexsort(np.round(places[first] / step).T[::-1])
    return first[order], np.argsort(order)[which.ravel()]


def _parted(path, nodes, faces) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and faces with parts that touch along edges separated.

    Of the triangles at an edge, two belong to one part if only its inside lies
    between them. Surfaces with holes are refused.
    """
    edges = face_edges(faces)
    key, which, count = _shared(edges)
    bad = np.flatnonzero(count % 2)
    if len(bad):
        x, y, z = nodes[key[bad[0]]].mean(axis=0)
        what = "open" if count[bad[0]] == 1 else "shared by several triangles"
        raise InputError(
            f"{path}: the surface is not closed: {len(bad)} edges are {what} "
            f"or worse, the first near ({x:.4f}, {y:.4f}, {z:.4f}) m; repair "
            "it (a mesh repair of any CAD or slicer)"
        )
    forth = edges[:, 0] < edges[:, 1]
    if (2 * np.bincount(which, forth) != count).any():
        raise InputError(
            f"{path}: neighbouring triangles are turned against each other; "
            "make their normals consistent"
        )
    if count.max(initial=2) == 2:
        return nodes, faces
    groups = np.split(np.lexsort((~forth, which)), np.cumsum(count)[:-1])
    pairs = [group for group in groups if len(group) == 2]
    beside = nodes[np.roll(faces, 1, axis=1).ravel()]
    for (start, end), group in zip(nodes[key], groups, strict=True):
        if len(group) > 2:
            apex = beside[group] - start
            along = (end - start) / np.linalg.norm(end - start)
            y = np.cross(along, apex[0])
            angle = np.arctan2(apex @ y, apex @ np.cross(y, along))
            ahead, back = np.split(angle, 2)
            # Angles grow outwards; coincident faces belong to two parts.
            between = (ahead[:, None] - back - 1e-6) % (2 * np.pi)
            while np.isfinite(between).any():
                i, j = np.unravel_index(between.argmin(), between.shape)
                between[i], between[:, j] = np.inf, np.inf
                pairs.append(group[[i, len(ahead) + j]])
    one, other = np.transpose(pairs)  # edges by first corner, opposite senses
    after = np.roll(np.arange(faces.size).reshape(-1, 3), -1, axis=1).ravel()
    links = (
        np.concatenate([one, after[one]]),
        np.concatenate([after[other], other]),
    )
    _, same = connected(faces.size, *links)
    _, first, corner = np.unique(same, return_index=True, return_inverse=True)
    return nodes[faces.ravel()[first]], corner.reshape(-1, 3)


def _shared(edges):
    """Distinct edges; index of each of the given (n,); triangles at each."""
    ends, which, count = np.unique(
        np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return ends, which.ravel(), count


def _united(path, nodes, faces) -> np.ndarray:
    """Corners (t, 3, 3) of the union of all parts, as a slicer makes it.

    A part turned inside out within one other is a hollow.
    """
    parts = solid(nodes, faces).decompose()
    if len(parts) < 2:
        return nodes[faces]
    hollows = []
    for part in parts:
        if part.volume() < 0:
            inner = corners_of(part)[:, ::-1].reshape(-1, 3)
            places, which = np.unique(inner, axis=0, return_inverse=True)
            hollows.append(solid(places, which.reshape(-1, 3)))
    parts = [part for part in parts if part.volume() > 0]
    for hollow in hollows:
        within = sum((hollow ^ part).volume() for part in parts)
        if abs(within / hollow.volume() - 1.0) > 1e-6:
            raise InputError(
                f"{path}: a part that is turned inside out is not a hollow "
                "within one other; turn its normals outwards, or leave it out"
            )
    body = Manifold.batch_boolean(parts, OpType.Add)
    return corners_of(body - Manifold.batch_boolean(hollows, OpType.Add))


def sole_from_surface(
    surface: Surface,
    tets: int = 5000,
    top_m: float | None = None,
    origin: tuple[float, float, float] | None = None,
) -> TetMesh:
    """Mesh a sole given by a closed surface with tetrahedra.

    Args:
        surface: The surface, z up; its flat top is fixed to the foot.
        tets: About how many tetrahedra to make.
        top_m: Height in the file's frame [m] above which faces that look
            upwards are fixed to the foot, for a top that is not flat.
        origin: Sole frame's origin in the file's frame [m]. By default the
            file's own origin if the top reaches up to z = 0, else the middle
            of the top, at its height.

    Raises:
        InputError: No flat top is found, or it cannot be meshed.
    """
    places, end = surface.corners.reshape(-1, 3), " by mesh.unit; correct that"
    check_size(places, surface.name, end)
    check_turned(places, surface.name)
    top = _top_faces(surface, top_m)
    if top_m is None:
        surface, top = _levelled(surface, top)
    if origin is None:
        extent = np.ptp(places, axis=0).max()
        origin = _guess_origin(surface.corners[top].reshape(-1, 3), extent)
    corners = surface.corners - np.asarray(origin)
    thickness = _Thickness(corners)
    if not thickness.values.any():
        raise InputError(
            f"{surface.name}: encloses nothing that is "
            f"{1e3 * thickness.step:.2g} mm wide, too narrow for a sole; draw "
            "it wider"
        )
    try:
        nodes, cells = _meshed(thickness, top, top_m is None, tets)
    except MmgError as error:
        raise InputError(
            f"{surface.name}: cannot be meshed ({error}); give another number "
            "of mesh.tets, or smooth the surface"
        ) from None
    fixed = _fixed_nodes(nodes, cells, corners, top, top_m is None)
    mesh = checked_mesh(nodes, cells, fixed, surface.name)
    enclosed = surface.volume
    if abs(mesh.volume - enclosed) > _SAME_VOLUME * enclosed:
        raise InputError(
            f"{surface.name}: encloses {1e6 * enclosed:.1f} cm³, of which "
            f"{1e6 * mesh.volume:.1f} cm³ were meshed: it overlaps itself, "
            "has parts that lie apart, or walls thinner than an element; "
            "mend it where it was drawn, or give more mesh.tets"
        )
    return replace(mesh, lost=_lost(corners, mesh))


def _lost(corners: np.ndarray, mesh: TetMesh) -> float:
    """Part of a surface's area that lies off its mesh.

    Off by over a quarter of an element's edge: at most 0.4 % without narrow
    grooves and ribs, 7 to 9 % with grooves that are lost.
    """
    rng = np.random.default_rng(0)
    area = np.linalg.norm(normals_of(corners), axis=1)
    faces = rng.choice(len(area), _SAMPLES, p=area / area.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), _SAMPLES)
    points = np.einsum("ni,nij->nj", weights, corners[faces])
    off = _nearest(mesh.nodes[mesh.boundary_faces], points)[2]
    return float(np.mean(off > 0.5 * np.cbrt(np.median(mesh.volumes))))


def _top_faces(surface: Surface, top_m: float | None) -> np.ndarray:
    """Triangles that are fixed to the foot, (t,) bool."""
    area, z = normals_of(surface.corners), surface.corners[:, :, 2]
    up = area[:, 2] > 0.3 * np.linalg.norm(area, axis=1)
    if top_m is not None:
        top = up & (z.min(axis=1) >= top_m)
        if not top.any() or top_m < z.min():
            raise InputError(
                f"{surface.name}: no face above {top_m:g} m looks upwards, or "
                f"all do; it reaches from {z.min():g} to {z.max():g} m: "
                "correct mesh.top_m"
            )
        return top
    longest = np.ptp(surface.corners, axis=(0, 1)).max()
    flat = z.min(axis=1) > z.max() - _FLAT * longest
    more = (
        ", or give mesh.top_m, the height above which faces that look "
        "upwards are fixed to the foot"
    )
    check_top(surface.corners, up & flat, surface.name, more)
    return up & flat


def _levelled(surface: Surface, top) -> tuple[Surface, np.ndarray]:
    """The surface with its top made one plane; the plane's faces, (t,) bool.

    Corners from the top's lowest one up are moved there: to z = 0, the frame's
    origin, if the top reaches it, else to the area's median height.
    """
    z, own = surface.corners[..., 2], surface.corners[top]
    heights, area = own[..., 2].ravel(), np.repeat(normals_of(own)[:, 2], 3)
    order = heights.argsort()
    part = area[order].cumsum()
    height = heights[order][np.searchsorted(part, 0.5 * part[-1])]
    if heights.min() <= 0 <= heights.max():
        height = 0.0
    level = z >= heights.min()
    xy, z = surface.corners[..., :2], np.where(level, height, z)
    return replace(surface, corners=np.dstack([xy, z])), level.all(axis=1)


def _meshed(thickness: "_Thickness", top, flat: bool, tets: int):
    """Nodes (n, 3) [m] and about `tets` cells (e, 4) inside the surface."""
    corners = thickness.corners
    points = corners.reshape(-1, 3)
    share = _share(thickness, tets)
    h = _GRID * share * thickness.usual
    low, high = points.min(axis=0) - 1.5 * h, points.max(axis=0) + 1.5 * h
    if flat:  # the top is a face of the grid
        high[2] = corners[top][:, :, 2].max()
    grid = grid_mesh(
        *(
            np.linspace(a, b, int(np.ceil((b - a) / h)) + 1)
            for a, b in zip(low, high, strict=True)
        )
    )
    away = _nearest(corners[~top] if flat else corners, grid.nodes)[2]
    inside = thickness.inside(grid.nodes, flat * 0.01 * h)
    level = np.where(inside, -away, away)
    body = {"nodes": grid.nodes, "tets": grid.tets, "level": level, "step": h}
    nodes, tets = run_mmg(body)
    used, cells = np.unique(tets, return_inverse=True)
    nodes, cells = _onto(nodes[used], cells.reshape(-1, 4), corners, top, flat)
    size = share * thickness.at(nodes)
    size = np.maximum(size, 0.3 * np.median(size))
    mesh = run_mmg({"nodes": nodes, "tets": cells, "size": size})
    return _onto(*mesh, corners, top, flat)


def _guess_origin(top: np.ndarray, extent: float) -> np.ndarray:
    low, high = top.min(axis=0), top.max(axis=0)
    if abs(high[2]) <= 1e-6 * extent:
        return np.zeros(3)
    return np.append(0.5 * (low + high)[:2], high[2])


def _share(thickness: "_Thickness", tets: int) -> float:
    """Size of elements over the thickness that gives about `tets` of them.

    A regular tetrahedron of edge h fills h³ / 8.5; Mmg's are about a quarter of
    that, since some at the surface have to be finer.
    """
    t = thickness.positive
    return float((_FILL * (thickness.cell * t / t**3).sum() / tets) ** (1 / 3))


class _Thickness:
    """Vertical thickness of a body [m], on a horizontal grid."""

    def __init__(self, corners: np.ndarray, count: int = 120):
        flat = corners[:, :, :2].reshape(-1, 2)
        low, size = flat.min(axis=0), np.ptp(flat, axis=0)
        self.step = float(size.max() / count)
        # Away from round numbers, on which edges of drawn shapes lie.
        self.low = low - 0.3183 * self.step
        shape = np.ceil(size / self.step).astype(int) + 2
        self.corners, self.cell = corners, self.step**2
        at = np.stack(np.indices(shape), axis=-1).reshape(-1, 2)
        places, total = at * self.step + self.low, np.zeros(len(at))
        for rows, z in crossings(self.corners, places):
            z = np.sort(z, axis=1)
            pairs = z[:, 1::2] - z[:, 0 : z.shape[1] // 2 * 2 : 2]
            total[rows] = pairs.sum(axis=1)
        self.values = total.reshape(shape)

    @property
    def positive(self) -> np.ndarray:
        """Thickness where above 0, at least a fifth of its median [m]."""
        t = self.values[self.values > 0]
        return np.maximum(t, 0.2 * np.median(t))

    @property
    def usual(self) -> float:
        """Median thickness [m]."""
        return float(np.median(self.positive))

    def at(self, nodes: np.ndarray) -> np.ndarray:
        """Thickness at points (n, 3) [m], (n,), from the nearest places."""
        at = np.argwhere(self.values > 0)
        tree = cKDTree(at * self.step + self.low)
        _, near = tree.query(nodes[:, :2], k=4)
        t = self.values[tuple(at[near].transpose(2, 0, 1))].mean(axis=1)
        return np.maximum(t, 0.2 * self.usual)

    def inside(self, nodes: np.ndarray, lower: float) -> np.ndarray:
        """Whether points (n, 3) [m], moved down by `lower`, are inside."""
        places = nodes - np.array([0.0, 0.0, lower])
        return igl.fast_winding_number(*_soup(self.corners), places) > 0.5


def crossings(corners: np.ndarray, places: np.ndarray):
    """Heights at which vertical lines at places (n, 2) meet triangles.

    Yields, for each number k of crossings, the indices of places that have it
    and their heights (rows, k).
    """
    low, high = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
    found = []
    for first in range(0, len(places), 256):
        batch = places[first : first + 256]
        left, right = batch[:, 0].min(), batch[:, 0].max()
        a, b, c = np.swapaxes(corners[(low <= right) & (high >= left)], 0, 1)
        e, f = (b - a)[:, :2], (c - a)[:, :2]
        det = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
        steep = np.abs(det) < 1e-16
        det = np.where(steep, 1.0, det)
        d = batch[:, None] - a[None, :, :2]
        u = (d[..., 0] * f[:, 1] - d[..., 1] * f[:, 0]) / det
        v = (e[:, 0] * d[..., 1] - e[:, 1] * d[..., 0]) / det
        hit = (u >= 0) & (v >= 0) & (u + v < 1) & ~steep
        row, t = np.nonzero(hit)
        z = a[t, 2] + u[hit] * (b - a)[t, 2] + v[hit] * (c - a)[t, 2]
        found.append((row + first, z))
    row, z = (np.concatenate(x) for x in zip(*found, strict=True))
    counts = np.bincount(row, minlength=len(places))
    starts = np.cumsum(counts) - counts
    for k in np.unique(counts[counts > 0]):
        rows = np.flatnonzero(counts == k)
        at = starts[rows, None] + np.arange(k)
        yield rows, z[at]


def _soup(corners) -> tuple[np.ndarray, np.ndarray]:
    """Points and index rows of triangles (t, 3, 3) or edges (t, 2, 3)."""
    places = corners.reshape(-1, 3)
    return places, np.arange(len(places)).reshape(len(corners), -1)


def _nearest(corners, points):
    """Nearest points to `points` (n, 3) on triangles or edges (t, 3 or 2, 3).

    Returns them (n, 3), the triangles they lie on (n,), the distances (n,).
    """
    far, on, best = igl.point_mesh_squared_distance(points, *_soup(corners))
    return best, on, np.sqrt(far)


def _onto(nodes, cells, corners, top, flat):
    """Move the mesh's surface nodes onto the triangles, if cells allow it."""
    mesh = TetMesh(nodes, cells, np.zeros(0, int))
    skin = np.unique(mesh.boundary_faces)
    aim = nodes.copy()
    size = np.cbrt(np.median(mesh.volumes))
    aim[skin], on, _ = _nearest(corners, nodes[skin])
    free = np.ones(len(skin), dtype=bool)
    if flat:
        height = corners[top][:, :, 2].max()
        up = skin[np.abs(nodes[skin, 2] - height) < _LEVEL * size]
        faces = mesh.boundary_faces
        rim = np.intersect1d(up, faces[~np.isin(faces, up).all(axis=1)])
        aim[up] = nodes[up]
        # A rim moves within the top, onto the sides' upper edge.
        sides = corners[~top]
        aim[rim, :2] = _nearest(sides, nodes[rim])[0][:, :2]
        aim[up, 2] = height
        free = ~np.isin(skin, up)
    edge = aim.copy()
    _onto_edges(edge, skin, np.where(free, on, -1), corners, size, mesh)
    # Each node goes as far as the elements around it allow, and again once its
    # neighbours have moved. First onto the surface, then along it to an edge,
    # so that nodes that stop short of the edge lie on the surface.
    floor = np.minimum(0.9 * mesh.quality(), _LEAST_QUALITY)
    for goal in (aim, aim, edge, edge):
        part = np.ones((len(nodes), 1))
        for _ in range(_SHORTER):
            new = nodes + part * (goal - nodes)
            worn = TetMesh(new, cells, mesh.fixed).quality() < floor
            if not worn.any():
                nodes = new
                break
            part[np.unique(cells[worn])] *= 0.5
    return nodes, cells


def _onto_edges(aim, skin, on, corners, size: float, mesh: TetMesh) -> None:
    """Set the goals `aim` of nodes near sharp edges and corners onto these.

    A level set cuts edges off: some of its faces have nodes on two smooth
    patches of the surface `corners` (t, 3, 3). Those on the larger patch are
    moved, the others stay, so that no face shrinks to nothing. `on` is the
    triangle of each node of the skin; -1: only corners may move it.
    """
    patch, ends, points = _sharp(corners, size)
    if not len(ends):
        return
    own, edge = np.full(len(aim), -1), aim.copy()
    own[skin[on >= 0]] = patch[on[on >= 0]]
    edge[skin] = _nearest(ends, aim[skin])[0]
    away = np.linalg.norm(edge - aim, axis=1)
    # Nodes on an edge already belong to both patches.
    there = (away < _THERE * size) & (own >= 0)
    aim[there], own[there] = edge[there], -1
    a, b = face_edges(mesh.boundary_faces).T
    a, b = np.where(own[a] <= own[b], [a, b], [b, a])
    across = (own[a] >= 0) & (own[a] < own[b])
    a, b = a[across], b[across]
    a = a[away[a] < np.linalg.norm(aim[b] - aim[a], axis=1)]
    aim[a] = edge[a]
    away, near = cKDTree(aim[skin]).query(points)
    aim[skin[near[away < size]]] = points[away < size]


def _sharp(corners, size: float):
    """Smooth patches of a surface (t, 3, 3), sharp edges and corners between.

    Patches smaller than a few squares of `size` [m] do not count. Returns the
    patch of each triangle (t,), numbered by falling area, -1 for none; ends of
    edges between two (k, 2, 3), and points where several meet (m, 3) [m].
    """
    places = corners.reshape(-1, 3)
    first, at = _coincident(places)
    edges, which, shared = _shared(face_edges(first[at].reshape(-1, 3)))
    order = np.argsort(which, kind="stable")
    pair = (order[shared[which[order]] == 2] // 3).reshape(-1, 2)
    ends = places[edges[shared == 2]]
    area = normals_of(corners)
    large = np.linalg.norm(area, axis=1)
    n = area / np.maximum(large, 1e-300)[:, None]
    joined = pair[(n[pair[:, 0]] * n[pair[:, 1]]).sum(axis=1) > _SHARP]
    number, patch = connected(len(corners), *joined.T)
    areas = 0.5 * np.bincount(patch, large, number)
    rank = np.empty(number, int)
    rank[np.argsort(-areas, kind="stable")] = np.arange(number)
    patch = np.where(areas < _PATCH * size**2, -1, rank)[patch]
    pair = np.sort(patch[pair], axis=1)
    sharp = (pair[:, 0] >= 0) & (pair[:, 0] < pair[:, 1])
    pair, ends = pair[sharp], ends[sharp]
    rows = np.column_stack([ends.reshape(-1, 3), np.repeat(pair, 2, axis=0)])
    points, count = np.unique(
        np.unique(rows, axis=0)[:, :3], axis=0, return_counts=True
    )
    return patch, ends, points[count > 1]


def _fixed_nodes(nodes, cells, corners, top, flat) -> np.ndarray:
    """Nodes of the surface that lie on the top."""
    mesh = TetMesh(nodes, cells, np.zeros(0, int))
    skin = np.unique(mesh.boundary_faces)
    size = np.cbrt(np.median(mesh.volumes))
    if flat:
        height = corners[top][:, :, 2].max()
        return skin[np.abs(nodes[skin, 2] - height) < _LEVEL * size]
    away = _nearest(corners[top], nodes[skin])[2]
    return skin[away < 0.1 * size]
