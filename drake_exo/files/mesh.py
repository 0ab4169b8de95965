"""Mesh files of any format that meshio knows, damaged ones refused."""

import codecs
import contextlib
import io
import warnings
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np

from drake_exo.errors import InputError, reason
from drake_exo.files.tables import read_bytes

_MARKS = (codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_cells(
    path: Path,
    cell_type: str,
    remedy: str,
    read: Callable[[Path], meshio.Mesh] = meshio.read,
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells of one type.

    Args:
        path: the file.
        cell_type: meshio's name, such as "triangle".
        remedy: ends the message where the file cannot be understood.
        read: meshio's reader.

    Returns:
        Nodes (n, 3) and node indices of the cells (c, k); c may be 0.

    Raises:
        InputError: unreadable or damaged, nodes that are not finite, cells
            with nodes that are not there.
    """
    start = read_bytes(path)
    if start.startswith(_MARKS):
        raise InputError(
            f"{path}: begins with a byte order mark; save it as UTF-8 without "
            "one (BOM)"
        )
    try:
        # meshio would look for the end of a .ply's header for ever.
        if start.startswith(b"ply") and b"end_header" not in start:
            raise ValueError("its header does not end")
        with _quiet():
            raw = read(path)
            cells = [b.data for b in raw.cells if b.type == cell_type]
            found = np.concatenate(cells) if cells else np.zeros((0, 1))
            nodes = np.asarray(raw.points, float)
    # meshio exits; bytes that are no text are those of a file cut off.
    except (SystemExit, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: is not a readable mesh (damaged or cut off); {remedy}"
        ) from error
    # Whatever a damaged file makes of the parser.
    except Exception as error:
        raise InputError(
            f"{path}: is not a readable mesh ({reason(error)}); {remedy}"
        ) from error
    if nodes.size == 0:
        raise InputError(f"{path}: is empty or cut off; {remedy}")
    if nodes.ndim != 2 or nodes.shape[1] != 3 or len(nodes) == 0:
        raise InputError(f"{path}: its nodes are not in space; {remedy}")
    if not (np.abs(nodes) < 1e9).all():
        raise InputError(
            f"{path}: places of nodes are missing or out of all bounds; "
            f"{remedy}"
        )
    if found.size and (found.min() < 0 or found.max() >= len(nodes)):
        raise InputError(
            f"{path}: a {cell_type} names a node that is not there; {remedy}"
        )
    if not found.size:
        found = found[:0]
    return nodes, found.astype(np.int64)


@contextlib.contextmanager
def _quiet():
    """Silence: meshio prints what it will raise, and numpy warns of it."""
    with (
        warnings.catch_warnings(),
        np.errstate(all="ignore"),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
    ):
        warnings.simplefilter("ignore")
        yield
