"""What a reader may take for a sound result though it is none."""

import json

from PIL import Image

from drake_exo.files.output import MANIFEST

# Numbers for programs; a reader meets them beside a marked summary.json.
_DATA = {".npz", ".vtk", ".stl", ".csv", ".yaml", ".sdf"}
_WORDS = ("DOES NOT HOLD", "NOT SOLVED")


def unmarked(folder, tables=()) -> list[str]:
    """Files below the folder of a result that does not hold without its mark.

    Every figure, page, text and .sto table is looked at, and summary.json; a
    file of a kind not known here counts as unmarked.

    Args:
        folder: of the results.
        tables: names of CSV files that are for readers, too.
    """
    return sorted(
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file() and not _is_marked(path, path.name in tables)
    )


def _is_marked(path, is_table) -> bool:
    kind = path.suffix
    if path.name == MANIFEST or (kind in _DATA and not is_table):
        return True
    if kind == ".json":
        verdict = json.loads(path.read_text("utf-8"))
        if path.name != "summary.json":
            return True
        return verdict["verdict"].upper() in _WORDS
    if kind == ".png" and path.read_bytes()[:4] == b"\x89PNG":
        with Image.open(path) as picture:
            return picture.text.get("Description", "").startswith(_WORDS)
    text = path.read_text("utf-8")  # of figures that were not drawn, too
    if kind in (".sto", ".mot"):
        text = text.splitlines()[0]
    return any(word in text for word in _WORDS)
