"""The decoder against an independent one, and against files made by hand."""

import struct

import ezc3d
import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.laboratory.c3d_decoding import decode

_ORDER = {84: "<", 85: "<", 86: ">"}


@pytest.mark.parametrize(
    "name",
    [
        "ktk_walkingOptiTrack",
        "nimble_UpsideDown_trial2_type4",
        "opensim_walking5",
    ],
)
def test_agrees_with_another_decoder(name, data_root):
    path = data_root / "c3d" / f"{name}.c3d"
    found, other = decode(path), ezc3d.c3d(str(path))
    points = other["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(found.points, points)
    analogs = other["data"]["analogs"][0].T
    assert found.analogs.size == analogs.size
    np.testing.assert_array_equal(found.analogs.ravel(), analogs.ravel())
    assert found.rate_hz == other["header"]["points"]["frame_rate"]
    for group, values in found.parameters.items():
        for key, value in values.items():
            if isinstance(value, list) or key not in other["parameters"][group]:
                continue
            expected = other["parameters"][group][key]["value"]
            np.testing.assert_array_equal(np.ravel(value), np.ravel(expected))


def real(processor, value) -> bytes:
    if processor != 85:
        return struct.pack(_ORDER[processor] + "f", value)
    words = struct.pack("<f", 4.0 * value)  # VAX
    return words[2:] + words[:2]


def whole(processor, value) -> bytes:
    return struct.pack(_ORDER[processor] + "h", value)


def parameter(processor, number, name, kind, shape, data) -> bytes:
    body = struct.pack("bB", kind, len(shape)) + bytes(shape) + data + b"\0"
    offset = whole(processor, len(body) + 2)
    return struct.pack("bb", len(name), number) + name + offset + body


def group(processor, number, name) -> bytes:
    head = struct.pack("bb", len(name), -number) + name
    return head + whole(processor, 3) + b"\0"


def handmade(processor, is_real, frames=3, last=None, extra=b"") -> bytes:
    """Two points and one channel at two samples a frame, counting up."""
    scale, last = (-1.0 if is_real else 0.5), frames if last is None else last
    words = [whole(processor, w) for w in (2, 2, 1)]
    words += [struct.pack(_ORDER[processor] + "H", last), whole(processor, 10)]
    words += [real(processor, scale), whole(processor, 3), whole(processor, 2)]
    words += [real(processor, 50.0)]
    head = (bytes([2, 0x50]) + b"".join(words)).ljust(512, b"\0")
    chain = bytes([1, 0x50, 1, processor])
    chain += group(processor, 1, b"ANALOG") + group(processor, 2, b"POINT")
    chain += parameter(
        processor, 1, b"SCALE", 4, [1], real(processor, 2.0)
    ) + parameter(processor, 1, b"OFFSET", 2, [1], whole(processor, 3))
    chain += parameter(processor, 2, b"LABELS", -1, [4, 2], b"heeltoe ")
    chain += extra + b"\0\0"
    put = real if is_real else whole
    data = b""
    for i in range(frames):
        for k in range(2):
            data += b"".join(put(processor, v) for v in (i, k, 7, 0 - k * i))
        data += put(processor, 10 * i + 3) + put(processor, 10 * i + 4)
    return head + chain.ljust(512, b"\0") + data


@pytest.mark.parametrize("is_real", [True, False])
@pytest.mark.parametrize("processor", [84, 85, 86])
def test_every_processor_and_number_format(tmp_path, processor, is_real):
    path = tmp_path / "a.c3d"
    path.write_bytes(handmade(processor, is_real))
    found = decode(path)
    scale = 1.0 if is_real else 0.5
    np.testing.assert_array_equal(found.points[2, 0], [2 * scale, 0, 7 * scale])
    # The second point is seen in the first frame alone.
    assert np.isfinite(found.points[0]).all()
    assert np.isnan(found.points[1:, 1]).all()
    analogs = [[0.0], [2.0], [20.0], [22.0], [40.0], [42.0]]
    np.testing.assert_array_equal(found.analogs, analogs)
    assert (found.rate_hz, found.analog_rate_hz) == (50.0, 100.0)
    assert found.texts("POINT", "LABELS") == ["heel", "toe"]


def test_long_recordings_say_their_length_elsewhere(tmp_path):
    path = tmp_path / "a.c3d"
    path.write_bytes(handmade(84, True, last=0xFFFF))
    with pytest.raises(InputError, match="does not say how many frames"):
        decode(path)
    fields = group(84, 3, b"TRIAL")
    for name, value in ((b"START", 1), (b"END", 3)):
        words = whole(84, value) + whole(84, 0)
        name = b"ACTUAL_" + name + b"_FIELD"
        fields += parameter(84, 3, name, 2, [2], words)
    frames = parameter(84, 2, b"FRAMES", 2, [1], whole(84, 3))
    for extra in (fields, frames):
        path.write_bytes(handmade(84, True, last=0xFFFF, extra=extra))
        assert len(decode(path).points) == 3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d[:-1], "ends before its last frame"),
        (lambda d: d[:20] + b"\0\0\0\0" + d[24:], "no frame rate"),
        (lambda d: d[:515] + b"\7" + d[516:], "names no processor"),
        (lambda d: d[:4] + b"\3" + d[5:], "contradicts itself"),
        (lambda d: d[:6] + b"\x09" + d[7:], "before its first frame"),
        (lambda d: d[:16] + b"\1" + d[17:], "names no data"),
        (lambda d: b"\x09" + d[1:], "ends before"),
        (lambda d: b"", "not a C3D file"),
    ],
)
def test_refuses(tmp_path, change, words):
    path = tmp_path / "a.c3d"
    data = handmade(84, True).ljust(2048, b"\0")[: 1024 + 120]
    path.write_bytes(data)
    assert len(decode(path).points) == 3
    path.write_bytes(change(data))
    with pytest.raises(InputError, match=words):
        decode(path)
