"""Errors in the user's input, and checks that raise them.

Imported at every start of the command, so it imports next to nothing.
"""

from collections.abc import Iterable, Mapping
from math import isfinite
from numbers import Integral
from pathlib import Path

_LONGEST = 120  # characters kept of another library's message
_USUAL = bytes(range(0x20, 0x7F))  # printable ASCII
_BOUNDS = (
    ("above", lambda value, bound: value > bound, "above"),
    ("below", lambda value, bound: value < bound, "below"),
    ("minimum", lambda value, bound: value >= bound, "at least"),
    ("maximum", lambda value, bound: value <= bound, "at most"),
)


class InputError(Exception):
    """Faulty input, with one sentence that names file, field and remedy.

    The command line prints the sentence and exits with code 2.

    >>> try:
    ...     check_bounds("mass_kg", -3.0, {"unit": "kg", "above": 0.0})
    ... except InputError as error:
    ...     print(error)
    mass_kg is -3, but must be above 0 kg
    """


def was_interrupted(error: BaseException) -> bool:
    """Whether Ctrl-C caused an error, directly or through others.

    Compiled code and extension modules that are loading raise others from it.
    """
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


def check_bounds(
    where: str, value: float, metadata: Mapping, text: str | None = None
) -> None:
    """Refuse a value that its field does not allow.

    Args:
        where: name of the field in the message.
        value: value in the field's unit.
        metadata: the dataclass field's, all optional: unit (for the message),
            above, below (exclusive), minimum, maximum (inclusive).
        text: the value as it was written, for the message.

    Raises:
        InputError: the value is no number, not finite, or out of bounds.
    """
    unit = metadata.get("unit")
    try:
        is_finite = None if isinstance(value, bool) else isfinite(value)
    except TypeError:
        is_finite = None
    if is_finite is None:
        kind = f"a number [{unit}]" if unit else "a number"
        raise InputError(f"{where} must be {kind}, but is {value!r}")
    found = text or f"{value:g}"
    if not is_finite:
        raise InputError(f"{where} is {found}, but must be a finite number")
    for key, holds, words in _BOUNDS:
        if key in metadata and not holds(value, metadata[key]):
            of = f" {unit}" if unit and unit != "1" else ""
            bound = f"{metadata[key]:g}{of}"
            raise InputError(f"{where} is {found}, but must be {words} {bound}")


def check_names(names: Iterable[str], known: Iterable[str]) -> None:
    """Refuse names that are not known.

    Raises:
        InputError: it names the first unknown one, and those known.
    """
    if isinstance(names, str):
        raise InputError(f"{names!r} is not a list of names; give a list")
    known = list(known)
    for name in names:
        if name not in known:
            raise InputError(
                f"there is no {name!r}; there are {', '.join(map(str, known))}"
                f"{nearest(name, known)}"
            )


def check_type(value: object, cls: type, what: str) -> None:
    """Refuse a value that is not of a class.

    Raises:
        InputError: it names the argument `what` and how the value begins.
    """
    if not isinstance(value, cls):
        begin = " ".join(repr(value).split())  # an array's has many lines
        raise InputError(f"{what} is {begin:.60}; give a {cls.__name__}")


def check_count(value: object, least: int, what: str) -> None:
    """Refuse a value that is no whole number, or is below `least`.

    Raises:
        InputError: it names the argument `what`.
    """
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or value < least:
        raise InputError(
            f"{what} is {value!r:.60}; give a whole number from {least} on"
        )


def path_of(given: object, what: str) -> Path:
    """The path given as text or as a path.

    Raises:
        InputError: `given` is neither; it names the argument `what`.
    """
    try:
        return Path(given)
    except TypeError as error:
        raise InputError(f"{what} is {given!r:.60}; give a path") from error


def check_fields(values: object, what: str) -> None:
    """Refuse a dataclass of numbers if one of them is out of bounds.

    Args:
        values: instance; each field's metadata as in `check_bounds`.
        what: name of the whole, such as "bushing 'shank'".

    Raises:
        InputError: it names the field.
    """
    for name, field in values.__dataclass_fields__.items():
        value = getattr(values, name)
        check_bounds(f"{what}: {name}", value, field.metadata)


def check_data_root(root: Path) -> None:
    """Refuse a root of relative paths that is not a folder.

    Raises:
        InputError: it names the path.
    """
    if not root.is_dir():
        raise InputError(
            f"{root}: is not a folder; check data_root (--data-root)"
        )


def check_file_name(where: str, name: str) -> None:
    """Refuse a name that cannot be part of a file's name.

    Args:
        where: name of the field in the message.
        name: its value.

    Raises:
        InputError: the name is empty, too long, or has characters other than
            letters, digits, spaces and ._-+().
    """
    allowed = all(c.isalnum() or c in " ._-+()" for c in name)
    if not (allowed and len(name.strip(" .")) > 0 and len(name) <= 100):
        raise InputError(
            f"{where} is {first_line(name)!r}, but names files; use letters, "
            "digits, spaces and ._-+() only, at most 100"
        )


def nearest(name: object, names: Iterable[object]) -> str:
    """The end of a sentence about a wrong name: "; did you mean 'hip'?".

    Empty if no name is similar. Case and a prefix before a colon, such as the
    subject's name before a marker's, are ignored. A name may be no text.

    >>> nearest("L_calc", ["r_calc", "S4:L_CALC"])
    "; did you mean 'S4:L_CALC'?"
    """
    from difflib import get_close_matches  # only once something is wrong

    plain = {str(n).casefold().rpartition(":")[2]: n for n in names}
    wanted = str(name or "").casefold().rpartition(":")[2]
    close = get_close_matches(wanted, plain, n=1)
    return f"; did you mean {plain[close[0]]!r}?" if close else ""


def printable(text: str, keep: str = "") -> str:
    """The text with question marks for characters that cannot be printed."""
    # Over the set of its characters, without the usual: recordings are long.
    unusual = text
    if text.isascii():
        unusual = text.encode("ascii").translate(None, _USUAL).decode("ascii")
    bad = [c for c in set(unusual) if not c.isprintable() and c not in keep]
    return text.translate(dict.fromkeys(map(ord, bad), "?")) if bad else text


def first_line(text: str) -> str:
    """The first line, short enough to stand in a sentence."""
    lines = text.strip().splitlines()
    line = printable(lines[0].strip()) if lines else ""
    return line if len(line) <= _LONGEST else line[:_LONGEST] + "..."


def reason(error: BaseException) -> str:
    """What an exception says, short enough to stand in a sentence."""
    return first_line(str(error)) or type(error).__name__
