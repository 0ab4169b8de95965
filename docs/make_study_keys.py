"""Writes docs/study_keys.md from the dataclasses that read a study file.

Units come from a field's metadata, else from the end of its name; meanings
from the class's "Attributes:". A key without either is an error, so the page
cannot fall behind the program: a test makes it anew and compares.
"""

import dataclasses
import inspect
import re
import sys
import types
import typing
from pathlib import Path
from typing import Any, Literal

from drake_exo.calibration.settings import Range
from drake_exo.contact.hunt_crossley import PaperConstants, SimbodyConstants
from drake_exo.model import segments
from drake_exo.study import StudyFile

# Values that a study gives replace scaled ones, whose classes describe them.
_SAME_KEYS = {
    segments.HumanOverrides: segments.HumanParameters,
    segments.ExoskeletonOverrides: segments.ExoskeletonParameters,
    segments.SegmentOverrides: segments.SegmentParameters,
}
PAGE = Path(__file__).with_name("study_keys.md")
HEAD = """\
# Every key of a study file

Made by `python docs/make_study_keys.py`; how to write a study is in
[your own data](your_data.md). A dash as default means that the key must be
given. Values that concern both legs are sums over them.
"""

# Longest first: a name ends in the first of these that fits.
_SUFFIXES = {
    "_nm_s_rad": "N m s/rad", "_rad_s": "rad/s", "_deg_s": "deg/s",
    "_n_m2": "N/m²", "_n_s_m": "N s/m", "_nm_rad": "N m/rad", "_n_m": "N/m",
    "_kg_m2": "kg m²", "_nm_s": "N m s", "_m_s2": "m/s²", "_m_s": "m/s",
    "_s_m": "s/m", "_nm": "N m", "_kg": "kg", "_deg": "deg", "_hz": "Hz",
    "_m2": "m²", "_m": "m", "_n": "N", "_s": "s", "_j": "J",
}  # fmt: skip
_NUMBER = (int, float)


def page() -> str:
    """Text of the page."""
    found: dict[type, str] = {}
    _collect(StudyFile, "", found)
    parts = [HEAD]
    for cls, where in found.items():
        parts.append(_section(cls, where, found))
    for law, cls in (("simbody", SimbodyConstants), ("paper", PaperConstants)):
        parts.append(_constants(law, cls))
    return "\n".join(parts)


def _collect(cls: type, where: str, found: dict[type, str]) -> None:
    """Add a class and those below it to `found`, with its first dotted key."""
    if cls in found:
        return
    found[cls] = where
    for name, hint in typing.get_type_hints(cls).items():
        for inner in _classes(hint):
            _collect(inner, f"{where}.{name}".strip("."), found)


def _classes(hint: Any):
    if dataclasses.is_dataclass(hint):
        yield hint
    for inner in typing.get_args(hint):
        yield from _classes(inner)


def _section(cls: type, where: str, found) -> str:
    title = f"`{where}`" if where else "Top level"
    meanings = attributes(cls)
    hints = typing.get_type_hints(cls)
    rows = [
        _row(cls, f, hints[f.name], meanings.get(f.name, ""), found)
        for f in dataclasses.fields(cls)
        if f.init
    ]
    return "\n".join(
        [
            f"## {title}",
            "",
            _first_sentence(cls),
            "",
            "| key | value | unit | default | meaning |",
            "| --- | --- | --- | --- | --- |",
            *rows,
            "",
        ]
    )


def _constants(law: str, cls: type) -> str:
    """Section on what `foot_ground.constants` may hold with one law."""
    rows = [
        f"| `{f.name}` | {f.metadata['unit']} | {f.default:g} |"
        for f in dataclasses.fields(cls)
    ]
    return "\n".join(
        [
            f"## `foot_ground.constants`, law `{law}`",
            "",
            "What they do is in [method and equations]"
            "(method.md#foot-and-ground).",
            "",
            "| name | unit | default |",
            "| --- | --- | --- |",
            *rows,
            "",
        ]
    )


def _row(cls, field, hint, meaning: str, found) -> str:
    nested = list(_classes(hint))
    if nested and not meaning:
        meaning = _first_sentence(nested[0])
    if not meaning and not _tells_itself(field.name):
        raise ValueError(f"{cls.__name__}.{field.name}: say what it means")
    cells = [
        f"`{field.metadata.get('key', field.name)}`", _value(hint, found),
        _unit(cls, field, hint),
        _default(field), meaning,
    ]  # fmt: skip
    return "| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |"


def _tells_itself(name: str) -> bool:
    return name in ("name", "file", "left", "right", "middle", "markers",
                    "ankle", "knee", "hip", "foot", "shank", "thigh", "pelvis",
                    "sex", "height_m", "plates", "forces")  # fmt: skip


def _value(hint: Any, found) -> str:
    """The type in words, with a link for a group of keys."""
    if dataclasses.is_dataclass(hint):
        place = found[hint]
        return f"[{place}](#{place.replace('.', '').lower()})"
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        inner = [_value(a, found) for a in args if a is not type(None)]
        return " or ".join(dict.fromkeys(inner))
    if origin is Literal:
        return ", ".join(f"`{a}`" for a in args)
    if origin is tuple and args[-1] is Ellipsis:
        return f"list of {_value(args[0], found)}"
    if origin is tuple:
        return f"{len(args)} × {_value(args[0], found)}"
    if origin is dict:
        return f"name: {_value(args[1], found)}"
    words = {float: "number", int: "whole number", bool: "true, false",
             str: "text", Path: "path"}  # fmt: skip
    return words[hint]


def _is_number(hint: Any) -> bool:
    args = typing.get_args(hint)
    if typing.get_origin(hint) is Literal:
        return False
    return hint in _NUMBER or any(_is_number(a) for a in args)


def _unit(cls, field, hint) -> str:
    if cls is Range:
        return "of its key" if hint is float else ""
    if not _is_number(hint) and Range not in (hint, *typing.get_args(hint)):
        return ""
    unit = field.metadata.get("unit")
    if unit is None:
        unit = next(
            (u for end, u in _SUFFIXES.items() if field.name.endswith(end)), "–"
        )
    return unit.replace("^2", "²").replace("^3", "³")


def _default(field) -> str:
    if field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
        return "" if value else "none"
    value = field.default
    if value is dataclasses.MISSING:
        return "–"
    if dataclasses.is_dataclass(value):
        return _in_flow_style(value)
    if isinstance(value, bool):
        return str(value).lower()
    if value is None or value == ():
        return "none"
    if isinstance(value, tuple):
        return ", ".join(f"{v:g}" for v in value)
    return f"`{value}`" if isinstance(value, str) else f"{value:g}"


def _in_flow_style(value) -> str:
    """A small group of numbers as one would write it; nothing for others."""
    items = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if not all(isinstance(v, int | float) for v in items.values()):
        return ""
    if len(items) > 4:
        return ""
    texts = (
        f"{k}: {str(v).lower() if isinstance(v, bool) else format(v, 'g')}"
        for k, v in items.items()
    )
    return "`{" + ", ".join(texts) + "}`"


def _first_sentence(cls: type) -> str:
    text = re.split(r"\n\s*\n", cls.__doc__.strip())[0]
    return " ".join(text.split())


def attributes(cls: type) -> dict[str, str]:
    """Field name -> meaning, of a class and what it inherits from."""
    found: dict[str, str] = {}
    if cls in _SAME_KEYS:
        found |= attributes(_SAME_KEYS[cls])
    for base in reversed(cls.__mro__):
        # Python 3.13 takes the indentation out, those before leave it in.
        doc = inspect.cleandoc(base.__dict__.get("__doc__") or "")
        match = re.search(r"Attributes:\n(.*?)(?:\n\s*\n|\Z)", doc, re.DOTALL)
        if match:
            found |= _entries(match[1])
    return found


def _entries(text: str) -> dict[str, str]:
    found: dict[str, str] = {}
    parts = re.split(r"^ {4}(?=\w)", text, flags=re.MULTILINE)
    for part in (p for p in parts if p.strip()):
        names, _, meaning = part.partition(":")
        for name in names.split(","):
            found[name.split("[")[0].strip()] = " ".join(meaning.split())
    return found


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.exit(0)
