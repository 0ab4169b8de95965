"""Every reader with a small, sound file of its format.

`formats()` maps a name to a `Format`. Reading the sound file succeeds; reading
a damaged one may fail in one way only, by an InputError.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from laboratory_readers import laboratory, pressure, scans
from result_readers import results, studies
from sole_readers import soles


@dataclass(frozen=True)
class Format:
    """One kind of file.

    Attributes:
        name: of the file.
        kind: of damage, see `damage.damaged`.
        original: a sound file.
        read: reads it.
    """

    name: str
    kind: str
    original: bytes
    read: Callable[[Path], object]


def formats() -> dict[str, Format]:
    """All formats by name."""
    found = {}
    for group in (laboratory, pressure, scans, studies, results, soles):
        for key, (name, kind, original, read) in group().items():
            if isinstance(original, str):
                original = original.encode()
            found[key] = Format(name, kind, original, read)
    return found
