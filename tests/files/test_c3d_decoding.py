"""C3D files are decoded at arm's length: nothing in them harms the reader."""

import struct

import ezc3d
import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files import c3d as c3d_decoding
from drake_exo.files.c3d import decode


@pytest.mark.parametrize(
    "name",
    [
        "ktk_walkingOptiTrack",
        "nimble_UpsideDown_trial2_type4",
        "opensim_walking5",
    ],
)
def test_hands_over_what_ezc3d_reads(name, data_root):
    path = data_root / "c3d" / f"{name}.c3d"
    found, other = decode(path), ezc3d.c3d(str(path))
    points = other["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(found.points, points)
    analogs = other["data"]["analogs"][0].T
    np.testing.assert_array_equal(found.analogs, analogs)
    assert found.rate_hz == other["header"]["points"]["frame_rate"]
    for group, values in found.parameters.items():
        for key, value in values.items():
            if isinstance(value, list):
                continue
            expected = other["parameters"][group][key]["value"]
            np.testing.assert_array_equal(np.ravel(value), np.ravel(expected))


def header(processor=84, frames=3, is_real=True) -> bytes:
    """Two points, no channels, and no parameters but the processor."""
    order = ">" if processor == 86 else "<"
    words = struct.pack(order + "5H", 2, 0, 1, frames, 10)
    scale = struct.pack(order + "f", -1.0 if is_real else 1.0)
    if processor == 85:  # VAX: words swapped
        scale = scale[2:] + scale[:2]
    block = bytes([2, 0x50]) + words + scale + struct.pack(order + "H", 3)
    parameters = bytes([1, 0x50, 1, processor])
    return block.ljust(512, b"\0") + parameters.ljust(512, b"\0")


@pytest.mark.parametrize(("is_real", "size"), [(True, 4), (False, 2)])
@pytest.mark.parametrize("processor", [84, 85, 86])
def test_truncated_files_are_told_by_their_header(
    tmp_path, processor, is_real, size
):
    path = tmp_path / "a.c3d"
    whole = header(processor, is_real=is_real) + bytes(3 * 2 * 4 * size)
    path.write_bytes(whole[:-1])
    with pytest.raises(InputError, match="ends before its last frame"):
        decode(path)
    path.write_bytes(whole)  # complete, though without parameters
    with pytest.raises(InputError, match=r"damaged|no frame rate"):
        decode(path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a C3D file"),
        (b"\x09" + header()[1:], "ends before"),
        (header(7), "names no processor"),
    ],
)
def test_refuses(tmp_path, data, words):
    path = tmp_path / "a.c3d"
    path.write_bytes(data)
    with pytest.raises(InputError, match=words):
        decode(path)


@pytest.mark.parametrize(
    ("does", "words"),
    [
        ("import os; os.abort()", "contradict each other"),
        ("import sys; sys.exit('no such group\\nat all')", "no such group"),
    ],
)
def test_survives_what_happens_to_the_library(
    tmp_path, monkeypatch, does, words
):
    child = tmp_path / "child.py"
    child.write_text(does)
    monkeypatch.setattr(c3d_decoding, "_CHILD", child)
    path = tmp_path / "a.c3d"
    path.write_bytes(header() + bytes(96))
    with pytest.raises(InputError, match=words):
        decode(path)
