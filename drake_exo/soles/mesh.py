"""Tetrahedral meshes of soles: bricks, files, checks, STL, shape splines.

Sole frame: x forward, y left, z up, origin at the centre of the top plane
(the surface fixed to the rigid foot); the sole lies below, at z <= 0. Shapes
follow (4) and (5) of the paper.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import meshio
import numpy as np
from manifold3d import Manifold, Mesh64
from scipy.interpolate import BSpline
from scipy.sparse import coo_array, csr_matrix
from scipy.sparse.csgraph import connected_components

from drake_exo.errors import InputError
from drake_exo.files.mesh import read_cells

# Of a mesh: numbers, and how many in a row.
_ARRAYS = {"nodes": (float, (3,)), "tets": (int, (4,)), "fixed": (int, ())}

# The four faces of a tetrahedron, wound so that normals point outwards.
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])

# Bounds of a sole's longest side [m], wide enough for any foot.
_LEAST_LENGTH, _LARGEST_LENGTH = 0.01, 2.0
_LONG = 0.6  # least extent along x, over the largest
_FIXED = "fixed"  # point data of a file: 1 where glued to the foot
_DOWNWARDS = 1e-3  # least downward part of a normal: beyond rounding
UPWARDS = 0.0175  # sine of 1°: meshed vertical sides do not count as upward
_MOST_TETS = 1_000_000  # 20 GB of memory
_RECTANGLE = 0.99  # least part of its bounding box that a rectangle fills
_UNFELT = 1e-17  # shares below this part of the largest are left out
_LEAST_TOP = 0.3  # least part of the area seen from above that is a flat top
_AT_FRAME = 1e-6  # metres: an underside this near is at the frame's origin


@dataclass(frozen=True, eq=False)
class TetMesh:
    """A sole as a mesh of four-node tetrahedra, with its surfaces.

    >>> import drake_exo as dx
    >>> mesh = dx.soles.Case.from_text(dx.soles.EXAMPLE).mesh
    >>> mesh.tets.shape, mesh.contact.shape, mesh.contact_areas.shape
    ((144, 4), (20,), (20,))
    >>> print(f"{1e6 * mesh.volume:.0f} cm³")
    897 cm³

    Attributes:
        nodes: Positions in the sole frame [m], (n, 3).
        tets: Node indices of the tetrahedra, positively oriented, (e, 4).
        fixed: Sorted indices of the nodes that move with the foot.
        lost: Part of the area of an STL or OBJ that the mesh does not follow;
            None if the mesh was not made from such a file.

    Arrays are copies that cannot be written to.

    Raises:
        InputError: An array has another shape, other numbers, or holds indices
            of nodes that do not exist.
    """

    nodes: np.ndarray
    tets: np.ndarray
    fixed: np.ndarray
    lost: float | None = None

    def __post_init__(self):
        for name, (kind, columns) in _ARRAYS.items():
            given = np.asarray(getattr(self, name))
            of_kind = np.can_cast(given.dtype, kind, "same_kind")
            shape = (*given.shape[:1], *columns)
            if given.dtype == bool or not of_kind or given.shape != shape:
                raise InputError(
                    f"mesh: {name} is an array of {given.dtype}, "
                    f"{given.shape}; give {kind.__name__} of the shape "
                    f"{('n', *columns)}".replace("'", "")
                )
            values = np.array(given, kind)
            if not columns:  # fixed: in whatever order it was given
                values.sort()
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        for name in ("tets", "fixed"):
            nodes = getattr(self, name)
            if nodes.size and not 0 <= nodes.min() <= nodes.max() < len(
                self.nodes
            ):
                raise InputError(
                    f"mesh: {name} holds {nodes.min()} to {nodes.max()}; give "
                    f"indices of its {len(self.nodes)} nodes"
                )

    def __repr__(self) -> str:
        return f"TetMesh({len(self.nodes)} nodes, {len(self.tets)} tets)"

    def with_nodes(self, nodes: np.ndarray) -> "TetMesh":
        """The same elements with their nodes at other positions."""
        out = replace(self, nodes=nodes)
        # The boundary does not depend on positions, and the nodes that may
        # touch stay the same ones.
        for name in ("boundary_faces", "contact"):
            out.__dict__[name] = getattr(self, name)
        return out

    @cached_property
    def boundary_faces(self) -> np.ndarray:
        """Outward triangles of the whole surface, (f, 3)."""
        index, count = self.faces_shared
        faces = self.tets[:, FACES].reshape(-1, 3)
        return faces[np.sort(index[count == 1])]

    @cached_property
    def faces_shared(self) -> tuple[np.ndarray, np.ndarray]:
        """Index of each distinct triangle, and how many tets share it, (t,)."""
        _, index, count = np.unique(
            np.sort(self.tets[:, FACES].reshape(-1, 3), axis=1),
            axis=0,
            return_index=True,
            return_counts=True,
        )
        return index, count

    @cached_property
    def is_top(self) -> np.ndarray:
        """Which boundary faces lie wholly on the fixed surface, (f,)."""
        return np.isin(self.boundary_faces, self.fixed).all(axis=1)

    @property
    def top_faces(self) -> np.ndarray:
        """The boundary faces that lie wholly on the fixed surface, (f, 3)."""
        return self.boundary_faces[self.is_top]

    @cached_property
    def bare(self) -> np.ndarray:
        """Sorted nodes of the surface that are not fixed."""
        return np.setdiff1d(np.unique(self.boundary_faces), self.fixed)

    @cached_property
    def contact(self) -> np.ndarray:
        """Sorted nodes that may touch the ground: of bare faces that look down.

        Other nodes reach the ground only if a sole rolls far or bulges; see
        `touching_everywhere`.
        """
        down = self.contact_faces[self._looks_down]
        return np.setdiff1d(down, self.fixed)

    @cached_property
    def _looks_down(self) -> np.ndarray:
        """Which of `contact_faces` look downwards, (f,) bool."""
        area, size = self.areas(self.contact_faces)
        return area[:, 2] < -_DOWNWARDS * size

    def touching_everywhere(self) -> "TetMesh":
        """The same mesh with all bare nodes as nodes that may touch."""
        return self.with_contact(self.bare)

    def with_contact(self, nodes: np.ndarray) -> "TetMesh":
        """The same mesh with these (sorted) nodes as those that may touch."""
        out = self.with_nodes(self.nodes)
        out.__dict__["contact"] = nodes
        return out

    @cached_property
    def contact_faces(self) -> np.ndarray:
        """Bare faces (f, 3): those not wholly on the fixed surface."""
        return self.boundary_faces[~self.is_top]

    @cached_property
    def contact_areas(self) -> np.ndarray:
        """Area at rest around each node that may touch [m²], (m,).

        It is of the faces that look down, as those touch; at a node without
        any, of all bare faces.
        """
        _, twice = self.areas(self.contact_faces)

        def around(size: np.ndarray) -> np.ndarray:
            faces, part = self.contact_faces.ravel(), np.repeat(size / 6.0, 3)
            total = np.bincount(faces, part, minlength=len(self.nodes))
            return total[self.contact]

        below = around(twice * self._looks_down)
        return np.where(below > 0.0, below, around(twice))

    def areas(self, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normals (f, 3) of triangles, and their lengths (f,).

        The length is twice the triangle's area [m²].
        """
        area = normals_of(self.nodes[faces])
        return area, np.linalg.norm(area, axis=1)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Signed element volumes [m³], (e,)."""
        a, b, c = self._spans()
        return np.einsum("ei,ei->e", a, np.cross(b, c)) / 6.0

    @property
    def is_block(self) -> bool:
        """Whether the sole fills its bounding box, as a brick does."""
        box = np.prod(np.ptp(self.nodes, axis=0))
        return bool(abs(self.volume / box - 1) < 1e-6)

    @property
    def volume(self) -> float:
        """Volume of the sole [m³]."""
        return float(self.volumes.sum())

    @cached_property
    def gradients(self) -> np.ndarray:
        """Gradients g_a of the shape functions [1/m], (e, 4, 3)."""
        a, b, c = self._spans()
        g = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
        g = np.stack([-(g[0] + g[1] + g[2]), *g], axis=1)
        return g / (6.0 * self.volumes[:, None, None])

    @property
    def undercut(self) -> float:
        """Part of the bare surface that faces upwards by over 1°, 0 to 1.

        A mould that opens upwards does not let go of such a surface.
        """
        area, size = self.areas(self.contact_faces)
        up = area[:, 2] > UPWARDS * size
        return float(size[up].sum() / size.sum())

    @property
    def hollows(self) -> int:
        """Number of closed hollows inside the sole."""
        a, b = face_edges(self.boundary_faces).T
        _, part = connected(len(self.nodes), a, b)
        return len(np.unique(part[a])) - 1

    def volume_gradient(self) -> np.ndarray:
        """∂volume/∂nodes [m²], (n, 3): Σ_e V_e g_a."""
        out = np.zeros_like(self.nodes)
        scatter(out, self.tets, self.volumes[:, None, None] * self.gradients)
        return out

    def quality(self) -> np.ndarray:
        """Mean-ratio quality, 1 for a regular tet, <= 0 if inverted, (e,).

        12 (3 V)^(2/3) / Σ l² (Liu and Joe, BIT 34, 1994), where the sum is four
        times that of the corners' squared distances from their middle.
        """
        V, x = self.volumes, self._from_middles()
        away = np.einsum("eai,eai->e", x, x)
        return 3.0 * np.sign(V) * (3.0 * np.abs(V)) ** (2 / 3) / away

    def quality_gradient(self, share: np.ndarray) -> np.ndarray:
        """∂(Σ share · quality)/∂nodes [1/m], (n, 3); no volume may be 0."""
        # Most elements have no share in a soft minimum.
        felt = np.abs(share) > _UNFELT * np.abs(share).max()
        part = replace(self, tets=self.tets[felt])
        out = np.zeros_like(self.nodes)
        x = part._from_middles()
        away = np.einsum("eai,eai->e", x, x)[:, None, None]
        size = (part.quality() * share[felt])[:, None, None]
        scatter(
            out, part.tets, size * (2 / 3 * part.gradients - 2.0 * x / away)
        )
        return out

    def _from_middles(self) -> np.ndarray:
        """Places of the corners from the middle of their tet [m], (e, 4, 3)."""
        x = self.nodes[self.tets]
        return x - 0.25 * np.einsum("eai->ei", x)[:, None]

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of each edge, lower first, (k, 2); each tet's edges, (e, 6)."""
        pairs = np.sort(self.tets[:, EDGES], axis=-1).reshape(-1, 2)
        n = len(self.nodes)
        code, owner = np.unique(pairs @ [n, 1], return_inverse=True)
        return np.column_stack(divmod(code, n)), owner.reshape(-1, 6)

    def _spans(self) -> np.ndarray:
        """Places of the last three corners from the first [m], (3, e, 3)."""
        x = self.nodes[self.tets.T]
        return x[1:] - x[:1]


def normals_of(corners: np.ndarray) -> np.ndarray:
    """Normals of triangles (f, 3, 3), twice their areas long, (f, 3)."""
    a, b, c = np.swapaxes(corners, 0, 1)
    return np.cross(b - a, c - a)


def face_edges(faces: np.ndarray) -> np.ndarray:
    """Edges of triangles (f, 3) in the order they go round, (3f, 2)."""
    return faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def connected(count: int, i, j) -> tuple[int, np.ndarray]:
    """Number of connected parts of `count` items linked i–j; part of each."""
    links = coo_array((np.ones(len(i)), (i, j)), shape=(count, count))
    return connected_components(links, directed=False)


def scatter(out: np.ndarray, place: np.ndarray, rows: np.ndarray) -> None:
    """Add rows (k, 4, 3) to out (n, 3) at places (k, 4)."""
    for axis in range(3):
        out[:, axis] += np.bincount(
            place.ravel(), rows[:, :, axis].ravel(), minlength=len(out)
        )


def brick(
    size: tuple[float, float, float], divisions: tuple[int, int, int]
) -> TetMesh:
    """A brick of size (x, y, z) [m] cut into nx·ny·nz cells of six tets.

    Neighbouring cells mirror each other (Kuhn cells by parity).

    Raises:
        InputError: Too many divisions for any memory.
    """
    if (count := 6 * math.prod(divisions)) > _MOST_TETS:
        raise InputError(
            f"brick: divisions {tuple(divisions)} make {count} tets, more than "
            f"{_MOST_TETS}; give fewer cells"
        )
    axes = [
        np.linspace(-0.5, 0.5, divisions[0] + 1) * size[0],
        np.linspace(-0.5, 0.5, divisions[1] + 1) * size[1],
        np.linspace(-1.0, 0.0, divisions[2] + 1) * size[2],
    ]
    return grid_mesh(*axes)


def grid_mesh(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> TetMesh:
    """A block over increasing grid lines [m]; the last z is fixed."""
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    nodes = grid.reshape(-1, 3)
    divisions = tuple(n - 1 for n in grid.shape[:3])
    _, ny, nz = divisions
    cell = np.stack(
        np.meshgrid(*map(np.arange, divisions), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    parity = cell % 2
    stride = np.array([(ny + 1) * (nz + 1), nz + 1, 1])
    tets = []
    for axis_order in ((0, 1, 2), (0, 2, 1), (1, 0, 2),
                       (1, 2, 0), (2, 0, 1), (2, 1, 0)):  # fmt: skip
        corner = np.zeros((4, 3), dtype=int)
        for k, axis in enumerate(axis_order):
            corner[k + 1 :, axis] = 1
        # Mirror the cell along every axis in which its index is odd.
        local = np.abs(corner[None] - parity[:, None, :])
        tets.append(((cell[:, None, :] + local) * stride).sum(axis=2))
    top = np.flatnonzero(nodes[:, 2] == z[-1])
    return checked_mesh(nodes, _oriented(nodes, tets), top, "brick")


def _oriented(nodes: np.ndarray, tets: list[np.ndarray]) -> np.ndarray:
    """Join arrays of tets (k, 4) into one, inverted tets reversed."""
    out = np.concatenate(tets)
    negative = np.linalg.det(nodes[out[:, 1:]] - nodes[out[:, :1]]) < 0
    out[negative] = out[negative][:, [0, 2, 1, 3]]
    return out


def halved(mesh: TetMesh) -> TetMesh:
    """The same body with each element split into eight of half the size.

    Four at the corners and four around the shortest diagonal of the
    octahedron between them (Bey, Computing 55, 1995).
    """
    edges, which = mesh.edges()
    n = len(mesh.nodes)
    nodes = np.concatenate([mesh.nodes, mesh.nodes[edges].mean(axis=1)])
    middle = n + which
    tets = [
        np.column_stack([corner, middle[:, (k == EDGES).any(axis=1)]])
        for k, corner in enumerate(mesh.tets.T)
    ]
    # The opposite of edge k is 5 - k.
    across = nodes[middle[:, :3]] - nodes[middle[:, :2:-1]]
    shortest = np.linalg.norm(across, axis=2).argmin(axis=1)
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        inner = middle[shortest == k]
        ring = (i, j, 5 - i, 5 - j, i)
        tets += [inner[:, [k, 5 - k, *ring[q : q + 2]]] for q in range(4)]
    first, second = np.sort(face_edges(mesh.top_faces), axis=1).T
    held = np.isin(edges @ [n, 1], n * first + second)
    fixed = np.concatenate([mesh.fixed, n + np.flatnonzero(held)])
    return TetMesh(nodes, _oriented(nodes, tets), fixed)


def read_mesh(
    path: Path | str, origin: tuple[float, float, float] | None = None
) -> TetMesh:
    """Read linear tetrahedra from Gmsh or another format of meshio.

    The fixed surface is the plane of the highest nodes, or nodes with 1 in
    point data `fixed`.

    Args:
        path: Mesh file in metres.
        origin: Sole frame's origin in the file's frame [m]. By default the
            file's own origin where its top is at z = 0 or no plane, else the
            middle of the top's bounding box, where the top is a rectangle.

    Raises:
        InputError: Unreadable file, no tetrahedra, inverted or unconnected
            elements, nothing glued to the foot, not in metres, not long along
            x, or a top that needs an origin.
    """
    path = Path(path)
    remedy = (
        "give a surface (.stl, .obj) or tetrahedra (Gmsh .msh, .vtk, .vtu or "
        "another format known to meshio)"
    )
    nodes, tets, said = read_cells(path, "tetra", remedy)
    if len(tets) == 0:
        raise InputError(
            f"{path}: no linear tetrahedra in this mesh; export 4-node tets"
        )
    fixed = np.ravel(said.get(_FIXED, []))
    is_told = len(fixed) > 0  # a file of `write_vtk`
    if is_told and len(fixed) != len(nodes):
        raise InputError(
            f"{path}: point data {_FIXED!r} holds {len(fixed)} numbers for "
            f"{len(nodes)} nodes; give one for each, 1 where it is glued to "
            "the foot"
        )
    used, tets = np.unique(tets, return_inverse=True)
    nodes, tets = nodes[used], tets.reshape(-1, 4)
    extent = np.ptp(nodes, axis=0).max()
    if is_told:
        top = np.flatnonzero(fixed[used] > 0)
    else:
        top = np.flatnonzero(nodes[:, 2] > nodes[:, 2].max() - 1e-7 * extent)
    if (TetMesh(nodes, tets, top).volumes < 0).all():  # as after mirroring
        tets = _oriented(nodes, [tets])
    if origin is None:
        origin = _guess_origin(TetMesh(nodes, tets, top), extent, path)
    mesh = checked_mesh(nodes - np.asarray(origin), tets, top, str(path))
    if not is_told:
        check_turned(nodes, path)
        more = f", or mark the nodes glued to it by 1 in point data {_FIXED!r}"
        check_top(mesh.nodes[mesh.boundary_faces], mesh.is_top, path, more)
    return mesh


def check_top(corners: np.ndarray, top: np.ndarray, name, more="") -> None:
    """Refuse a surface whose highest plane is no flat top.

    Args:
        corners: Corners of the outward triangles [m], (f, 3, 3).
        top: Which of them lie in that plane, (f,).
        name: Name of the file.
        more: Another remedy, which ends the message.
    """
    up = normals_of(corners)[:, 2]
    part = up[top].sum() / up[up > 0].sum()
    if part < _LEAST_TOP:
        raise InputError(
            f"{name}: its highest plane is not a flat top ({part:.0%} of what "
            "is seen from above); turn the sole so that the surface glued to "
            f"the foot is on top{more}"
        )


def _guess_origin(mesh: TetMesh, extent: float, path) -> np.ndarray:
    top = mesh.nodes[mesh.fixed]
    z, near = top[:, 2].mean() if len(top) else 0.0, 1e-7 * extent
    # A curved top has no one height to put the origin at; a footbed (a hollow
    # top) may have its rim at z = 0.
    at_zero = min(abs(z), abs(mesh.nodes[:, 2].max())) <= near
    if at_zero or np.ptp(top[:, 2]) > near:
        return np.zeros(3)
    low, high = top[:, :2].min(axis=0), top[:, :2].max(axis=0)
    area = 0.5 * mesh.areas(mesh.top_faces)[0][:, 2].sum()
    if 0 < area < _RECTANGLE * np.prod(high - low):
        raise InputError(
            f"{path}: the top is not a rectangle, and lies at z = {z:g} m, so "
            "that the place of the foot's frame cannot be guessed; give "
            "mesh.origin_m, or put the frame's origin at 0 in the file"
        )
    return np.array([*(0.5 * (low + high)), z])


def check_size(places: np.ndarray, name: str, end: str) -> None:
    """Refuse a sole that is smaller or larger than any.

    Args:
        places: Points of the sole [m], (k, 3).
        name: Name of its file.
        end: Cause and remedy, which end the message.
    """
    size = np.ptp(places, axis=0)
    if not _LEAST_LENGTH < size.max() < _LARGEST_LENGTH:
        numbers = " x ".join(f"{x:g}" for x in size)
        raise InputError(f"{name}: the sole is {numbers} m large{end}")


def check_turned(places: np.ndarray, name) -> None:
    """Refuse a sole that is not long along x.

    Args:
        places: Points of the sole [m], (k, 3).
        name: Name of its file.
    """
    size = np.ptp(places, axis=0)
    if size[0] < _LONG * size.max():
        numbers = " x ".join(f"{1e3 * x:.0f}" for x in size)
        raise InputError(
            f"{name}: its x, y and z reach over {numbers} mm, but a sole is "
            "long along x (forward) and its top looks along z; turn it"
        )


def checked_mesh(nodes, tets, fixed, name: str) -> TetMesh:
    """A mesh of these arrays that can be simulated; see `check_mesh`."""
    mesh = TetMesh(nodes, tets, fixed)
    check_mesh(mesh, name)
    return mesh


def check_mesh(mesh: TetMesh, name: str) -> None:
    """Refuse what cannot be simulated.

    Raises:
        InputError: Inverted, flat or repeated elements, a wrong size,
            unconnected parts, no top or no underside.
    """
    nodes, tets = mesh.nodes, mesh.tets
    floor = 1e-9 * np.median(np.abs(mesh.volumes))
    bad = np.flatnonzero(mesh.volumes <= floor)
    if len(bad):
        raise InputError(
            f"{name}: {len(bad)} of {len(tets)} tetrahedra are inverted or "
            f"flat (first: element {bad[0]}); remesh"
        )
    _, shared = mesh.faces_shared
    if (crowded := int((shared > 2).sum())) > 0:
        raise InputError(
            f"{name}: {crowded} faces belong to more than two tetrahedra, "
            "which are there twice or overlap; export each once (Gmsh's MSH 2 "
            "repeats those of several physical groups)"
        )
    i, j = tets[:, [0, 0, 0]].ravel(), tets[:, 1:].ravel()
    check_size(
        nodes, name, ", and lengths are in metres; scale it (millimetres by "
        "0.001)",
    )  # fmt: skip
    parts, _ = connected(len(nodes), i, j)
    if parts > 1:
        raise InputError(
            f"{name}: the mesh falls into {parts} unconnected parts; merge "
            "coincident nodes or remove the loose parts"
        )
    if len(mesh.top_faces) == 0:
        raise InputError(
            f"{name}: no face is glued to the foot, since none lies in the "
            "top plane (highest z), or has three nodes with 1 in point data "
            f"{_FIXED!r}; turn the mesh so that its flat top is highest, or "
            "mark the nodes glued to the foot"
        )
    below = nodes[mesh.contact, :2]
    if np.linalg.matrix_rank(below - below[:1], 1e-9) < 2:
        raise InputError(
            f"{name}: the nodes of faces that look downwards lie in a line; "
            "give a sole that has an underside, free of nodes glued to the "
            "foot"
        )


def check_frame(mesh: TetMesh, name) -> None:
    """Refuse a frame whose origin is not above the sole, or far off it.

    Raises:
        InputError: Says where the underside lies in the frame.
    """
    z = float(mesh.nodes[mesh.contact, 2].min())
    if not -_LARGEST_LENGTH < z < -_AT_FRAME:
        raise InputError(
            f"{name}: the underside of the sole lies at z = {z:g} m in its "
            "frame, whose origin belongs in its top; give mesh.origin_m there, "
            "in metres, or put the frame's origin there in the file"
        )


def write_vtk(path: Path | str, mesh: TetMesh) -> None:
    """Write the tetrahedra in metres, as `read_mesh` reads them.

    Fixed nodes are marked, since a top may be curved.
    """
    fixed = np.zeros(len(mesh.nodes), np.int32)
    fixed[mesh.fixed] = 1
    cells = [("tetra", mesh.tets)]
    meshio.Mesh(mesh.nodes, cells, {_FIXED: fixed}).write(path)


def write_triangles(path: Path | str, corners: np.ndarray) -> None:
    """Write outward triangles (f, 3, 3) [m] as binary STL in millimetres."""
    cells = np.arange(3 * len(corners)).reshape(-1, 3)
    mesh = meshio.Mesh(1e3 * corners.reshape(-1, 3), [("triangle", cells)])
    mesh.write(path, "stl", binary=True)


def is_watertight(corners: np.ndarray) -> bool:
    """Whether outward triangles (f, 3, 3) [m] close around a volume.

    A slicer's test of an STL, in its single precision: every edge is shared by
    two triangles that go along it in opposite directions.
    """
    points = np.float32(1e3 * corners).reshape(-1, 3)
    index = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1, 3)
    edges = face_edges(index)
    there, count = np.unique(edges, axis=0, return_counts=True)
    back = np.unique(edges[:, ::-1], axis=0)
    closed = np.array_equal(there, back) and (count == 1).all()
    return bool(closed and np.linalg.det(corners).sum() > 0)


WALL = 0.01  # metres of mould around and below the sole
_SAME = 1e-7  # metres: closer corners of a mould are merged


def mould_triangles(mesh: TetMesh) -> np.ndarray:
    """Outward triangles of the mould's closed surface [m], (f, 3, 3).

    The mould is a block less the sole, open above its top; it is empty if the
    sole's own surface is not closed.
    """
    # The cavity: the sole, and what is above its top.
    n, loops = len(mesh.nodes), rings(mesh.top_faces)
    lift = np.array([0.0, 0.0, WALL + np.ptp(mesh.nodes[:, 2])])
    a = np.concatenate(loops)
    b = np.concatenate([np.roll(loop, -1) for loop in loops])
    faces = [mesh.contact_faces, mesh.top_faces + n]
    faces += [np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)]
    nodes = np.concatenate([mesh.nodes, mesh.nodes + lift])
    cavity = solid(nodes, np.concatenate(faces))
    if cavity.is_empty():
        return corners_of(cavity)
    low, high = mesh.nodes.min(axis=0) - WALL, mesh.nodes.max(axis=0) + WALL
    high[2] = mesh.nodes[mesh.fixed, 2].max()
    block = Manifold.cube(high - low).translate(low)
    return corners_of((block - cavity).simplify(_SAME))


def solid(nodes: np.ndarray, faces: np.ndarray) -> Manifold:
    """Body inside outward triangles `faces`; empty if they are not closed."""
    return Manifold(Mesh64(nodes, faces.astype(np.uint64)))


def corners_of(body: Manifold) -> np.ndarray:
    """Outward triangles of a body's surface, (f, 3, 3)."""
    mesh = body.to_mesh64()
    return mesh.vert_properties[:, :3][mesh.tri_verts.astype(int)]


def rings(faces: np.ndarray) -> list[np.ndarray]:
    """Closed borders of triangles (f, 3): each one's nodes, in their sense."""
    there = set(map(tuple, face_edges(faces).tolist()))
    after, found = {}, []
    for a, b in sorted(there):
        if (b, a) not in there:
            after.setdefault(a, []).append(b)
    while after:
        ring, node = [], min(after)
        while node in after:  # a node is left as often as entered: it closes
            ring.append(node)
            node = after[node].pop()
            if not after[ring[-1]]:
                del after[ring[-1]]
        found.append(np.array(ring))
    return found


_DEGREE = 2


@dataclass(frozen=True)
class SphericalSpline:
    """A spline over directions that scales a sole: X' = s(θ, φ) X.

    >>> import numpy as np
    >>> import drake_exo as dx
    >>> spline = dx.soles.SphericalSpline((4, 4))
    >>> spline.deform(np.array([[0.1, 0.0, -0.02]]), np.full(spline.count, 1.5))
    array([[ 0.15,  0.  , -0.03]])

    There are (n_θ + 2)(n_φ + 2) coefficients. All those of a pole are tied into
    one, which leaves (n_θ + 2) n_φ + 2 free ones (122 at the paper's spacing
    π/10). With the top surface fixed, the first and last θ rows and the poles
    are held at 1, which leaves n_θ n_φ free ones (100).

    Attributes:
        intervals: Number of knot intervals over [-π/2, π/2] in θ and φ.
        fixed_top: Keep the top surface as it is (the paper's case 5).
        symmetric: Whether left and right are alike: s(−θ, φ) = s(θ, φ).
        kept: θ-major indices of further coefficients that are held at 1.
    """

    intervals: tuple[int, int] = (10, 10)
    fixed_top: bool = False
    symmetric: bool = False
    kept: tuple[int, ...] = ()

    def __post_init__(self):
        if min(self.intervals) < 1:
            raise InputError(
                f"spline: intervals {self.intervals} must be at least 1"
            )

    @property
    def count(self) -> int:
        """Number of free coefficients."""
        return int(self._column.max()) + 1

    @cached_property
    def _column(self) -> np.ndarray:
        """Index of the free coefficient of each of all (θ-major); -1: held."""
        shape = n_theta, n_phi = tuple(n + 2 for n in self.intervals)
        index = np.arange(n_theta * n_phi).reshape(shape)
        tied = index.copy()
        # Each pole has one coefficient, numbered after all others.
        tied[:, 0], tied[:, -1] = index.size, index.size + 1
        if self.symmetric:
            tied = np.minimum(tied, tied[::-1])
        held = np.zeros(shape, dtype=bool)
        if self.fixed_top:
            held[[0, -1]] = held[:, [0, -1]] = True
        held.ravel()[list(self.kept)] = True
        held = np.isin(tied, tied[held])  # and those tied to them
        if held.all():
            raise InputError(
                "optimize.shape: no part of the sole is left to change; give "
                "smaller fixed patches, more intervals, or a frame whose "
                "origin lies in a top that is fixed (mesh.origin_m)"
            )
        out = np.full(shape, -1)
        out[~held] = np.unique(tied[~held], return_inverse=True)[1]
        return out.ravel()

    def free_map(self) -> tuple[csr_matrix, np.ndarray]:
        """T and p0 with all coefficients (θ-major) = T · free ones + p0."""
        column = self._column
        rows = np.flatnonzero(column >= 0)
        T = csr_matrix(
            (np.ones(len(rows)), (rows, column[rows])),
            shape=(column.size, self.count),
        )
        return T, (column < 0).astype(float)

    def around(self, points: np.ndarray) -> tuple[int, ...]:
        """θ-major indices of free coefficients that move any point (n, 3)."""
        felt = self._full(points).any(axis=0) & (self._column >= 0)
        return tuple(np.flatnonzero(felt).tolist())

    def _full(self, points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        # 0.0 - z, not -z: atan2(0, -0.0) = π on the top plane.
        angles = np.arctan2(y, 0.0 - z), np.arctan2(x, np.hypot(y, z))
        N_theta, N_phi = map(_basis_matrix, angles, self.intervals)
        return np.einsum("nj,nk->njk", N_theta, N_phi).reshape(len(points), -1)

    def basis(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """M (n, count) and s0 (n,) of the scale s = M p + s0 at the nodes."""
        full = self._full(nodes)
        T, p0 = self.free_map()
        return full @ T, full @ p0

    def stretch(self, nodes: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Factor s (n,) in the directions of points, deformed or not."""
        M, s0 = self.basis(nodes)
        return M @ p + s0

    def deform(self, nodes: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Positions X' (n, 3) of nodes in the shape of free coefficients p."""
        return self.stretch(nodes, p)[:, None] * nodes


def _basis_matrix(angle: np.ndarray, intervals: int) -> np.ndarray:
    knots = np.linspace(-np.pi / 2, np.pi / 2, intervals + 1)
    inside = np.clip(angle, knots[0], knots[-1])
    t = np.pad(knots, _DEGREE, mode="edge")
    return BSpline.design_matrix(inside, t, _DEGREE).toarray()
