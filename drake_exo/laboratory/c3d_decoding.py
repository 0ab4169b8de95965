"""The contents of a C3D file, decoded by ezc3d at arm's length."""

import io
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError, first_line, printable

_CHILD = Path(__file__).with_name("c3d_child.py")
_BLOCK = 512
_INTEL, _DEC, _MIPS = 84, 85, 86
_FARTHEST = 1e9  # of a marker, in any unit
_LONG = 0xFFFF  # header's last frame where there are more


@dataclass(frozen=True)
class C3dContents:
    """What the file says, without interpretation.

    Attributes:
        parameters: group -> name -> numbers (in the file's dimensions) or a
            list of texts.
        points: (N, M, 3) in the file's unit; NaN where not seen.
        rate_hz: of the points.
        analogs: (N k, C) scaled.
        analog_rate_hz: of the channels, k times the points'.
    """

    parameters: dict[str, dict[str, np.ndarray | list[str]]]
    points: np.ndarray
    rate_hz: float
    analogs: np.ndarray
    analog_rate_hz: float

    def numbers(self, group: str, name: str) -> np.ndarray | None:
        """A numeric parameter; None if it is absent, empty or text."""
        value = self.parameters.get(group, {}).get(name)
        if not isinstance(value, np.ndarray) or value.size == 0:
            return None
        return value.astype(float)

    def texts(self, group: str, name: str) -> list[str]:
        """Text entries of a parameter and its continuations (LABELS2, ...)."""
        found = []
        for suffix in ("", *range(2, 10)):
            value = self.parameters.get(group, {}).get(f"{name}{suffix}")
            found += value if isinstance(value, list) else []
        return found


def decode(path: Path) -> C3dContents:
    """Decode a file.

    Raises:
        InputError: it cannot be read, is no C3D file, is truncated, or is
            damaged.
    """
    _check_complete(path)
    with np.load(io.BytesIO(_arrays(path)), allow_pickle=False) as found:
        arrays = {name: found[name] for name in found.files}
    points = arrays["points"]
    if (np.abs(points) > _FARTHEST).any():
        raise _damaged(path, "a marker is out of all bounds")
    rate, analog_rate = arrays["rates"]
    if not 0.0 < rate < 1e6:
        raise InputError(f"{path}: says no frame rate; correct POINT:RATE")
    parameters: dict[str, dict] = {}
    for i, (group, name) in enumerate(json.loads(str(arrays["names"]))):
        value = arrays[f"parameter_{i}"]
        if value.dtype.kind == "U":
            value = [printable(text.strip()) for text in value.ravel()]
        parameters.setdefault(group, {})[name] = value
    return C3dContents(
        parameters, points, float(rate), arrays["analogs"], float(analog_rate)
    )


def _arrays(path: Path) -> bytes:
    """What the child process hands over."""
    done = subprocess.run(
        [sys.executable, str(_CHILD), str(path.absolute())],
        capture_output=True,
        check=False,
    )
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace")
        what = first_line(said) if done.returncode == 1 else ""
        raise _damaged(path, what or "its parts contradict each other")
    return done.stdout


def _check_complete(path: Path) -> None:
    """Refuse a file shorter than its header announces."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); check the path"
        ) from error
    if len(data) < 2 * _BLOCK or data[1] != 0x50:
        raise InputError(f"{path}: is not a C3D file; check the path")
    processor = data[max(data[0] - 1, 0) * _BLOCK + 3 :][:1]
    if not processor:
        raise _truncated(path)
    if processor[0] not in (_INTEL, _DEC, _MIPS):
        raise _damaged(path, "names no processor type")
    order = ">" if processor[0] == _MIPS else "<"
    words = np.frombuffer(data[:24], order + "u2").astype(int)
    points, analogs, first, last, start = words[[1, 2, 3, 4, 8]]
    if last == _LONG:
        return
    # The scale's sign: reals where it is negative.
    sign = words[7] if processor[0] == _INTEL else words[6]
    size = (4 * points + analogs) * (4 if sign >> 15 else 2)
    if len(data) < (start - 1) * _BLOCK + (last - first + 1) * size:
        raise _truncated(path)


def _truncated(path) -> InputError:
    return InputError(
        f"{path}: ends before its last frame; the file is truncated, copy or "
        "export it again"
    )


def _damaged(path, what: str) -> InputError:
    return InputError(f"{path}: is damaged ({what}); copy or export it again")
