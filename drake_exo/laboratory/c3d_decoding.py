"""The bytes of a C3D file: header, parameters, points, analog channels.

After The C3D File Format User Guide (Motion Lab Systems). Decoded here, with
every length checked against the file before it is believed: a damaged file
must end in a message, while general C3D libraries crash on some.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError

_BLOCK = 512
_INTEL, _DEC, _MIPS = 84, 85, 86
_MOST_DIMENSIONS = 7
_FARTHEST = 1e9  # of a marker, in any unit
_LONG = 0xFFFF  # header's last frame where there are more
_TEXT, _BYTE, _WHOLE, _REAL = -1, 1, 2, 4


@dataclass(frozen=True)
class C3dContents:
    """What the bytes say, without interpretation.

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
        InputError: it cannot be read, is no C3D file, is truncated, or
            contradicts itself.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); check the path"
        ) from error
    if len(data) < 2 * _BLOCK or data[1] != 0x50:
        raise InputError(f"{path}: is not a C3D file; check the path")
    return _Decoder(path, data).contents()


@dataclass(frozen=True)
class _Header:
    """The header: how many points, analog values a frame, frames, where."""

    points: int
    values: int
    first: int
    last: int
    block: int
    samples: int
    scale: float
    rate_hz: float


class _Decoder:
    """One file's bytes in its processor's number format."""

    def __init__(self, path: Path, data: bytes):
        self.path, self.data = path, data
        self.start = (data[0] - 1) * _BLOCK
        if self.start < 0 or len(data) < self.start + 4:
            raise self.truncated()
        self.processor = data[self.start + 3]
        if self.processor not in (_INTEL, _DEC, _MIPS):
            raise self.damaged("names no processor type")
        self.order = ">" if self.processor == _MIPS else "<"

    def truncated(self) -> InputError:
        return InputError(
            f"{self.path}: ends before its last frame; the file is "
            "truncated, copy or export it again"
        )

    def damaged(self, what: str) -> InputError:
        return InputError(
            f"{self.path}: is damaged ({what}); copy or export it again"
        )

    def whole(self, raw: bytes, signed: bool = True) -> np.ndarray:
        return np.frombuffer(raw, self.order + ("i2" if signed else "u2"))

    def real(self, raw: bytes) -> np.ndarray:
        scale = 1.0
        if self.processor == _DEC:  # words swapped, exponent two higher
            words = np.frombuffer(raw, "<u2").reshape(-1, 2)[:, ::-1]
            raw, scale = words.tobytes(), 0.25
        with np.errstate(invalid="ignore"):  # signalling NaN
            return scale * np.frombuffer(raw, self.order + "f4").astype(float)

    def contents(self) -> C3dContents:
        head = self._header()
        parameters = self._parameters()
        raw = self._frames(head, parameters)
        first_analog = 4 * head.points
        places = _points(raw[:, :first_analog], max(head.scale, 0.0) or 1.0)
        if (np.abs(places) > _FARTHEST).any():
            raise self.damaged("a marker is out of all bounds")
        analogs = raw[:, first_analog:].reshape(
            len(raw) * head.samples, head.values // head.samples
        )
        found = C3dContents(
            parameters, places, head.rate_hz, analogs,
            head.rate_hz * head.samples,
        )  # fmt: skip
        return _scaled(found)

    def _header(self) -> "_Header":
        words = self.whole(self.data[:24], signed=False)
        scale = float(self.real(self.data[12:16])[0])
        rate = float(self.real(self.data[20:24])[0])
        if not 0.0 < rate < 1e6:
            raise InputError(
                f"{self.path}: says no frame rate; correct POINT:RATE"
            )
        head = _Header(
            *(int(words[i]) for i in (1, 2, 3, 4, 8)),
            max(int(words[9]), 1), scale, rate,
        )  # fmt: skip
        if not np.isfinite(scale) or head.values % head.samples:
            raise self.damaged("its header contradicts itself")
        return head

    def _frames(self, head: "_Header", parameters) -> np.ndarray:
        """All numbers (frames, width) of the data section."""
        real, width = head.scale < 0.0, 4 * head.points + head.values
        size = 4 if real else 2
        start = (head.block - 1) * _BLOCK
        if start < _BLOCK:
            raise self.damaged("its header names no data")
        there = max(len(self.data) - start, 0) // max(size * width, 1)
        count = self._count(head, parameters) if width else 0
        if there < count:
            raise self.truncated()
        raw = self.data[start : start + count * width * size]
        if real:
            return self.real(raw).reshape(count, width)
        values = self.whole(raw).reshape(count, width).astype(float)
        if parameters.get("ANALOG", {}).get("FORMAT") == ["UNSIGNED"]:
            values[:, 4 * head.points :] %= 65536.0
        return values

    def _count(self, head: "_Header", parameters) -> int:
        """Number of frames, which the header alone cannot say beyond 65535."""
        first, last = head.first, head.last
        if last != _LONG:
            if last < first:
                raise self.damaged("it ends before its first frame")
            return last - first + 1
        long = parameters.get("POINT", {}).get("LONG_FRAMES")
        if isinstance(long, np.ndarray) and long.size:
            return max(int(min(long.flat[0], 2**31)), 0)
        field = parameters.get("TRIAL", {})
        ends = [field.get(f"ACTUAL_{name}_FIELD") for name in ("START", "END")]
        if all(isinstance(e, np.ndarray) and e.size == 2 for e in ends):
            first, last = (
                int(e.flat[0]) % 65536 + 65536 * (int(e.flat[1]) % 65536)
                for e in ends
            )
            if last >= first:
                return last - first + 1
        frames = parameters.get("POINT", {}).get("FRAMES")
        if isinstance(frames, np.ndarray) and frames.size:
            count = float(frames.flat[0])
            return int(count % 65536.0 if count < 0.0 else min(count, 2**31))
        raise self.damaged("it does not say how many frames there are")

    def _parameters(self) -> dict[str, dict]:
        """Groups by name; records are chained by their offsets."""
        groups: dict[int, str] = {}
        found: dict[int, dict] = {}
        at = self.start + 4
        while True:
            length, number = self._bytes(at, 2, "i1")
            if length == 0 or number == 0:
                break
            name = self._name(at + 2, abs(int(length)))
            step = at + 2 + abs(int(length))
            offset = int(self.whole(self._raw(step, 2))[0])
            if number < 0:
                groups[-int(number)] = name
            else:
                found.setdefault(int(number), {})[name] = self._value(step + 2)
            if offset <= 0:
                break
            at = step + offset
        return {groups[i]: v for i, v in found.items() if i in groups}

    def _raw(self, at: int, count: int) -> bytes:
        raw = self.data[at : at + count]
        if len(raw) != count:
            raise self.damaged("its parameters do not end")
        return raw

    def _bytes(self, at: int, count: int, kind: str) -> np.ndarray:
        return np.frombuffer(self._raw(at, count), kind)

    def _name(self, at: int, length: int) -> str:
        return _text(self._raw(at, length)).upper()

    def _value(self, at: int) -> np.ndarray | list[str]:
        kind, count = self._bytes(at, 2, "i1")
        if not 0 <= count <= _MOST_DIMENSIONS:
            raise self.damaged("a parameter has no sensible dimensions")
        shape = [int(n) for n in self._bytes(at + 2, int(count), "u1")]
        total = int(np.prod(shape, dtype=object)) if shape else 1
        at += 2 + len(shape)
        if kind not in (_TEXT, _BYTE, _WHOLE, _REAL):
            raise self.damaged("a parameter is of no known type")
        raw = self._raw(at, abs(int(kind)) * total)
        if kind == _TEXT:
            width = shape[0] if shape else 1
            ends = range(0, len(raw), max(width, 1))
            return [_text(raw[i : i + width]) for i in ends]
        if kind == _BYTE:
            values = np.frombuffer(raw, "i1")
        else:
            values = self.whole(raw) if kind == _WHOLE else self.real(raw)
        return values.reshape(shape or (1,), order="F")


def _text(raw: bytes) -> str:
    text = raw.decode("utf-8", errors="replace").replace("\0", " ").strip()
    return "".join(c if c.isprintable() else "?" for c in text)


def _points(raw: np.ndarray, scale: float) -> np.ndarray:
    """Places (N, M, 3), NaN where the fourth number is negative."""
    four = raw.reshape(len(raw), -1, 4)
    with np.errstate(all="ignore"):
        places = scale * four[:, :, :3]
    return np.where(four[:, :, 3:] < 0.0, np.nan, places)


def _scaled(c: C3dContents) -> C3dContents:
    """Analog channels in the units that the parameters name."""
    count = c.analogs.shape[1]
    general = c.numbers("ANALOG", "GEN_SCALE")
    scale, offset = np.ones(count), np.zeros(count)
    for name, target in (("SCALE", scale), ("OFFSET", offset)):
        given = c.numbers("ANALOG", name)
        if given is not None:
            target[: given.size] = given.ravel()[:count]
    if c.parameters.get("ANALOG", {}).get("FORMAT") == ["UNSIGNED"]:
        offset %= 65536.0
    factor = scale * (1.0 if general is None else general.flat[0])
    with np.errstate(all="ignore"):  # judged where they are used
        c.analogs[:] = (c.analogs - offset) * factor
    return c
