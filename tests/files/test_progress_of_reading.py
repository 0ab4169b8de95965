"""A lab that reads long recordings sees that the program works."""

import itertools

import numpy as np
import pytest

from drake_exo.files import c3d, output
from drake_exo.files.c3d import read_c3d, write_c3d
from drake_exo.files.opensim import (
    read_table,
    read_trc,
    write_table,
    write_trc,
)
from drake_exo.files.optitrack import read_markers_csv
from drake_exo.files.tables import (
    MarkerData,
    Table,
    read_csv_table,
    write_csv_table,
)

TIME = np.arange(500) / 100.0
MARKERS = MarkerData(TIME, ("a",), np.ones((500, 1, 3)), 100.0)
TABLE = Table(TIME, ("F",), np.ones((500, 1)), False)


def motive(path):
    head = (
        "Format Version,1.22,Export Frame Rate,100,Length Units,Meters\n"
        ",,Marker,Marker,Marker\n,,a,a,a\nFrame,Time,X,Y,Z\n"
    )
    rows = (f"{i},{t:.2f},1,1,1" for i, t in enumerate(TIME))
    path.write_text(head + "\n".join(rows))


@pytest.mark.parametrize(
    ("ending", "write", "read", "words"),
    [
        ("trc", lambda p: write_trc(p, MARKERS), read_trc, "500 rows"),
        ("mot", lambda p: write_table(p, TABLE), read_table, "500 rows"),
        (
            "csv",
            lambda p: write_csv_table(p, TABLE, ["N"]),
            read_csv_table,
            "500 rows",
        ),
        ("csv", motive, read_markers_csv, "504 lines"),
        ("c3d", lambda p: write_c3d(p, MARKERS), read_c3d, "decoding"),
    ],
    ids=["trc", "mot", "csv", "Motive", "c3d"],
)
def test_long_reading_shows_progress(
    tmp_path, capsys, monkeypatch, ending, write, read, words
):
    made, path = tmp_path / f"made.{ending}", tmp_path / f"long.{ending}"
    write(made)
    made.rename(path)
    # A C3D file is decoded by a process, which is too quick for a short one.
    slow = tmp_path / "slow_child.py"
    slow.write_text(
        "import runpy, time\ntime.sleep(0.5)\n"
        f"runpy.run_path({str(c3d._CHILD)!r}, run_name='__main__')\n"
    )
    monkeypatch.setattr(c3d, "_CHILD", slow)
    clock = itertools.count()
    monkeypatch.setattr(output.time, "monotonic", lambda: next(clock))
    read(path)
    lines = capsys.readouterr().out.splitlines()
    assert any(s.startswith(f"reading long.{ending}: {words}") for s in lines)


def test_short_reading_is_silent(tmp_path, capsys):
    write_trc(tmp_path / "short.trc", MARKERS)
    read_trc(tmp_path / "short.trc")
    assert capsys.readouterr().out == ""
