"""Other values for keys of a study or a case."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from drake_exo.errors import InputError, nearest
from drake_exo.files import schema


def changed_text(path: Path, cls: type, changes: Mapping[str, Any]) -> str:
    """Text of a study or case with all its keys, some of them changed.

    Args:
        path: of the file.
        cls: its dataclass.
        changes: dotted key -> value.

    Raises:
        InputError: the file says something that is not allowed, or has no
            such key.
    """
    tree = yaml.safe_load(schema.dump_text(schema.load(path, cls)))
    for key, value in changes.items():
        place, (*parts, last) = tree, key.split(".")
        for part in parts:
            place = _step(path, key, place, part)
        _step(path, key, place, last)
        place[_index(place, last)] = value
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=80)


def _index(place, part: str):
    return int(part) if isinstance(place, list) and part.isdigit() else part


def _step(path: Path, key: str, place, part: str):
    """What `part` of a key leads to."""
    index = _index(place, part)
    if isinstance(place, dict) and index in place:
        return place[index]
    if isinstance(place, list) and isinstance(index, int):
        if index < len(place):
            return place[index]
        known = [str(k) for k in range(len(place))]
    else:
        known = list(map(str, place)) if isinstance(place, dict) else []
    raise InputError(
        f"{path}: has no key {key!r} to sweep: {part!r} is unknown"
        f"{nearest(part, known)}"
    )


def file_class(of_sole: bool) -> type:
    """The dataclass of a case file, or of a study file."""
    if of_sole:
        from drake_exo.soles.settings import Settings

        return Settings
    from drake_exo.study import StudyFile

    return StudyFile


def check_key(cls: type, key: str) -> None:
    """Refuse a key that no file of a kind can have.

    Raises:
        InputError: naming the part that is unknown.
    """
    hints: list[Any] = [cls]
    for part in key.split("."):
        known: set[str] = set()
        found: list[Any] = []
        for hint in hints:
            if dataclasses.is_dataclass(hint):
                own = typing.get_type_hints(hint)
                names = [f.name for f in dataclasses.fields(hint) if f.init]
                known |= set(names)
                found += [own[part]] if part in names else []
            elif typing.get_origin(hint) is dict or hint in (dict, Any):
                found.append((*typing.get_args(hint), Any)[-1])
            elif part.isdigit():
                found += [a for a in typing.get_args(hint) if a is not ...]
        if not found:
            raise InputError(
                f"sweep: {key!r} is no key: {part!r} is unknown"
                f"{nearest(part, sorted(known))}"
            )
        hints = [option for hint in found for option in _options(hint)]


def _options(hint) -> list:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return [o for o in typing.get_args(hint) if o is not type(None)]
    return [hint]
