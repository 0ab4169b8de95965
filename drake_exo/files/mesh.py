"""Read mesh files: STL, OBJ, PLY, meshio's formats; refuse damaged ones."""

import codecs
import contextlib
import io
import re
import warnings
from pathlib import Path

import meshio
import numpy as np
from manifold3d import triangulate

from drake_exo.errors import InputError, reason
from drake_exo.files.output import read_bytes
from drake_exo.files.tables import kept

_STL = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")]
_VERTEX = re.compile(r"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_MARKS = (codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def _read_obj(path: Path) -> meshio.Mesh:
    """Read a Wavefront file's faces; polygons are cut into triangles.

    Normals, textures, groups, lines and free-form surfaces are skipped;
    meshio's reader fails on them.
    """
    places, faces = [], []
    text = re.sub(r"\\\r?\n", " ", path.read_bytes().decode("latin-1"))
    for line in re.split(r"[\r\n]", text):
        kind, *words = line.split("#")[0].split() or [""]
        if kind == "v":
            places.append(words[:3])
        elif kind == "f":
            face = [int(word.split("/")[0]) for word in words]
            # Counted from 1, or if negative back from the last vertex so far.
            faces.append([i + len(places) if i < 0 else i - 1 for i in face])
    if any(not 0 <= i < len(places) for face in faces for i in face):
        raise ValueError("a face names a node that is not there")
    nodes = np.array(places, float)
    triangles = []
    for count in {len(face) for face in faces} - {0, 1, 2}:
        face = np.array([face for face in faces if len(face) == count])
        fan = np.stack([face[:, :-2], face[:, 1:-1], face[:, 2:]], axis=2)
        fan[:, :, 0] = face[:, :1]
        a, b, c = np.moveaxis(nodes[fan], 2, 0)
        area = np.cross(b - a, c - a)
        normal = area.sum(axis=1)
        turned = (np.einsum("fti,fi->ft", area, normal) < 0).any(axis=1)
        triangles += fan[~turned].reshape(-1, 3).tolist()
        for i in np.flatnonzero(turned):
            away = int(np.abs(normal[i]).argmax())
            flat = np.roll(nodes[face[i]], -1 - away, axis=1)[:, :2]
            flat[:, 1] *= np.sign(normal[i, away])
            triangles += face[i, triangulate([flat])].tolist()
    return meshio.Mesh(nodes, [("triangle", triangles)] if triangles else [])


def _read_stl(path: Path) -> meshio.Mesh:
    """Read the triangles of an STL file, each with three nodes of its own.

    The file is binary if it is as long as its header says, even if that begins
    with "solid". (libigl's reader hangs on damaged text.)
    """
    whole = path.read_bytes()
    count = int.from_bytes(whole[80:84], "little")
    if 0 <= len(whole) - 84 - 50 * count < 50:
        corners = np.frombuffer(whole, _STL, count, 84)["corners"]
    else:
        corners = np.array(_VERTEX.findall(whole.decode("latin-1")), float)
        if len(whole) > 84 and not len(corners):
            raise ValueError(
                f"no STL of text, and {(len(whole) - 84) / 50:g} triangles "
                f"follow a header that says {count}"
            )
        if len(corners) % 3:
            raise ValueError("its last triangle is cut off")
    places = corners.reshape(-1, 3)
    triangles = np.arange(len(places)).reshape(-1, 3)
    return meshio.Mesh(places, [("triangle", triangles)])


def _read_nastran(path: Path) -> meshio.Mesh:
    """Read a Nastran file; meshio knows no words in lower case."""
    text = path.read_text("latin-1").upper()
    # Nor does it stop where a file is cut off after its first line of data.
    if "BEGIN BULK" in text and "\nENDDATA" not in text:
        raise ValueError("it does not end with ENDDATA")
    return meshio.nastran.read(io.StringIO(text))


class _Text(io.StringIO):
    """Text whose reader must stop at its end; meshio's would ask forever."""

    def readline(self, *size) -> str:
        line = super().readline(*size)
        if not line:
            raise EOFError("it is cut off")
        return line


def _read_tecplot(path: Path) -> meshio.Mesh:
    return meshio.tecplot.read(_Text(path.read_text("latin-1")))


def _read_su2(path: Path) -> meshio.Mesh:
    """Read an SU2 file; meshio takes fewer elements than are announced."""
    raw = meshio.su2.read(path)
    said = re.findall(rb"^NELEM=\s*(\d+)", path.read_bytes(), re.MULTILINE)
    # Cells of a lower dimension are of markers.
    top = max((block.dim for block in raw.cells), default=0)
    there = sum(len(block) for block in raw.cells if block.dim == top)
    if there < sum(map(int, said)):
        raise ValueError(f"it holds {there} of its elements, and is cut off")
    return raw


_READERS = {
    ".obj": _read_obj,
    ".stl": _read_stl,
    ".ply": meshio.ply.read,
    ".su2": _read_su2,
    **dict.fromkeys((".dat", ".tec"), _read_tecplot),
    **dict.fromkeys((".bdf", ".fem", ".nas"), _read_nastran),
}


@kept(8)
def read_cells(
    path: Path, cell_type: str, remedy: str
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Read a mesh's nodes and its cells of one type, as read-only arrays.

    Args:
        path: the file.
        cell_type: meshio's name, such as "triangle".
        remedy: advice that ends the message if the file is damaged.

    Returns:
        Nodes (n, 3), file's unit; node indices of the cells (c, k), c may be 0;
        data of the nodes by name, as the file has them.

    Raises:
        InputError: unreadable or damaged, nodes that are not finite, cells
            that refer to missing nodes, or further cells of that dimension.
    """
    start = read_bytes(path)
    read = _READERS.get(path.suffix.lower(), meshio.read)
    if start.startswith(_MARKS):
        raise InputError(
            f"{path}: begins with a byte order mark; save it as UTF-8 without "
            "one (BOM)"
        )
    try:
        _check_end(start)
        if re.search(rb"^\$MeshFormat\s+2\S*\s+0\s", start, re.MULTILINE):
            _check_gmsh(start)
        with _quiet():
            raw = read(path)
            cells, dims = raw.cells_dict, {b.type: b.dim for b in raw.cells}
            found = cells.pop(cell_type, np.zeros((0, 1)))
            nodes = np.asarray(raw.points, float)
    # meshio may exit the process; undecodable bytes mean a truncated file.
    except (SystemExit, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: is not a readable mesh (damaged or cut off); {remedy}"
        ) from error
    # A damaged file may raise anything in a parser.
    except Exception as error:
        raise InputError(
            f"{path}: is not a readable mesh ({reason(error)}); {remedy}"
        ) from error
    if nodes.size == 0:
        raise InputError(f"{path}: is empty or cut off; {remedy}")
    if nodes.ndim != 2 or nodes.shape[1] != 3 or len(nodes) == 0:
        raise InputError(f"{path}: its nodes lack x, y or z; {remedy}")
    if not (np.abs(nodes) < 1e9).all():
        raise InputError(
            f"{path}: places of nodes are missing or out of all bounds; "
            f"{remedy}"
        )
    for other in cells:
        if dims[other] == dims.get(cell_type):
            raise InputError(
                f"{path}: has {len(cells[other])} cells of type {other} beside "
                f"its {cell_type} cells, which alone are read; mesh all of it "
                f"in {cell_type} cells"
            )
    if found.size and (found.min() < 0 or found.max() >= len(nodes)):
        raise InputError(
            f"{path}: a {cell_type} names a node that is not there; {remedy}"
        )
    if not found.size:
        found = found[:0]
    found = found.astype(np.int64)
    for array in (nodes, found, *raw.point_data.values()):
        array.flags.writeable = False
    return nodes, found, raw.point_data


def _check_end(data: bytes) -> None:
    """Refuse a file whose end meshio would seek forever."""
    if data.startswith(b"ply") and b"end_header" not in data:
        raise ValueError("its header does not end")
    is_nodes_begun = re.search(rb"^\s*Begin Nodes", data, re.MULTILINE)
    if is_nodes_begun and b"End Nodes" not in data:  # Kratos
        raise ValueError("its nodes do not end")
    if data.startswith(b"("):  # Ansys
        is_open = data.isascii() and data.count(b"(") > data.count(b")")
        if is_open or not data.rstrip().endswith(b")"):
            raise ValueError("its last bracket does not close")
    if data.startswith(b"OFF") and not re.search(rb"^\s*\d", data, re.M):
        raise ValueError("its numbers of nodes and faces are missing")


def _check_gmsh(data: bytes) -> None:
    """Refuse Gmsh 2 text in which elements of one type differ in node count.

    meshio would take the last numbers of such a row for nodes, even tags.
    """
    text = data.partition(b"$Elements")[2].partition(b"$EndElements")[0]
    rows = [row.split() for row in text.splitlines() if row.strip()]
    counts = {
        (kind, len(more) - int(tags)) for _, kind, tags, *more in rows[1:]
    }
    if len(counts) > len(dict(counts)):
        raise ValueError("an element has fewer nodes than others, or more")


@contextlib.contextmanager
def _quiet():
    """Silence meshio, which prints errors before raising, and numpy."""
    with (
        warnings.catch_warnings(),
        np.errstate(all="ignore"),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        warnings.simplefilter("ignore")
        yield
