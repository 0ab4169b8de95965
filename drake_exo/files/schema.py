"""Read YAML files into frozen dataclasses, with types checked.

Every mistake is reported in one sentence with the file and the line: unknown
keys (with the nearest known one), duplicate and missing keys, wrong types,
numbers that are not finite or out of bounds.

A field's metadata holds its unit and bounds; these apply to the value or, in a
list, tuple or dict, to each element:

    mass_kg: float = quantity("kg", above=0.0)

The metadata "key" is the name in the file, if it is not the field's own.

A dataclass may check several fields together by raising `InputError` or
`ValueError` in `__post_init__`.
"""

import dataclasses
import re
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import yaml

from drake_exo.errors import (
    InputError,
    check_bounds,
    check_type,
    first_line,
    nearest,
)
from drake_exo.files.tables import read_bytes

T = TypeVar("T")

_TRUE, _FALSE = ("true", "yes", "on"), ("false", "no", "off")
_NOT_FINITE = ("nan", "inf", "infinity")
_LARGEST = 1e150  # its square does not overflow
_LONGEST = 40  # characters of a value in a message
# Not allowed in file names; a lone surrogate cannot even be written to a file.
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")


class _Values(yaml.SafeLoader):
    """Loader for values of type Any; a date stays text."""


_Values.add_constructor(
    "tag:yaml.org,2002:timestamp", yaml.SafeLoader.construct_scalar
)


def load(path: str | Path, cls: type[T]) -> T:
    """Read the YAML file `path` as an instance of the dataclass `cls`.

    Raises:
        InputError: the file cannot be read, or does not fit `cls`.
    """
    try:
        text = read_bytes(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not a text file; give a YAML file in UTF-8"
        ) from error
    return load_text(text, cls, str(path))


def load_text(text: str, cls: type[T], name: str = "<text>") -> T:
    """Read YAML `text` as an instance of `cls`; messages begin with `name`.

    Raises:
        InputError: as `load`.
    """
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark else ""
        raise InputError(
            f"{name}{line}: is not valid YAML ({error.problem})"
        ) from error
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError(f"{name}: is not valid YAML text") from error
    if node is None:
        node = yaml.MappingNode(
            "tag:yaml.org,2002:map", [], yaml.Mark(name, 0, 0, 0, None, None)
        )
    return _Reader(name).read(node, cls, "", {})


def check(settings: T, cls: type[T], name: str) -> T:
    """Copy of settings made in Python, checked like a file; dicts are groups.

    Raises:
        InputError: `settings` is not of `cls`, or has a value it forbids.
    """
    check_type(settings, cls, name)
    try:
        node = _Settings().represent_data(_plain(settings))
    except yaml.YAMLError as error:
        raise InputError(
            f"{name}: {first_line(str(error.args[-1]))}"
        ) from error
    return _Reader(name).read(node, type(settings), "", {})


def checked(given, cls: type, what: str, usual=None):
    """Given settings, checked as by `check`; or defaults if None.

    Args:
        given: an instance of `cls`, or None.
        cls: dataclass of the settings.
        what: name of the argument, for messages.
        usual: settings used if `given` is None; by default `cls()`.
    """
    if given is None:
        return usual or cls()
    return check(given, cls, what)


def dump_text(obj: Any) -> str:
    """YAML text of a dataclass instance; `load_text` reads it back."""
    return yaml.safe_dump(
        _plain(obj), sort_keys=False, allow_unicode=True, width=80
    )


def _plain(value: Any, hint: Any = None) -> Any:
    """Dataclasses, tuples, paths and arrays as YAML's dicts, lists and texts.

    Of an instance of a subclass, only the fields of the declared class.
    """
    if dataclasses.is_dataclass(value):
        known = dataclasses.is_dataclass(hint) and isinstance(value, hint)
        cls = hint if known else type(value)
        hints = typing.get_type_hints(cls)
        return {
            _key(f): _plain(getattr(value, f.name), hints[f.name])
            for f in dataclasses.fields(cls)
            if f.init
        }
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value


def paths_of(value: Any) -> list[Path]:
    """All paths in a dataclass, mapping or list and below, as written."""
    if dataclasses.is_dataclass(value):
        value = [getattr(value, f.name) for f in dataclasses.fields(value)]
    elif isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [path for item in value for path in paths_of(item)]
    return [value] if isinstance(value, Path) else []


class _Settings(yaml.representer.SafeRepresenter):
    """Turns Python values into the YAML nodes that a file would give."""

    def represent_str(self, data: str) -> yaml.Node:
        """Quote texts, so that none is read as a number."""
        return self.represent_scalar("tag:yaml.org,2002:str", data, style='"')


_Settings.add_representer(str, _Settings.represent_str)


class _Reader:
    """Turns YAML nodes into typed values; `name` is the file in messages."""

    def __init__(self, name: str):
        self.name = name

    def error(self, node: yaml.Node, message: str) -> InputError:
        mark = node.start_mark  # None for settings made in Python
        line = f":{mark.line + 1}" if mark else ""
        return InputError(f"{self.name}{line}: {message}")

    def read(
        self, node: yaml.Node, hint: Any, where: str, meta: Mapping
    ) -> Any:
        """The value of `node` as type `hint`; `where` is the dotted key."""
        origin = typing.get_origin(hint)
        if dataclasses.is_dataclass(hint):
            return self._dataclass(node, hint, where)
        if origin is typing.Union or origin is types.UnionType:
            return self._union(node, hint, where, meta)
        if origin is Literal:
            return self._literal(node, hint, where)
        if origin in (list, tuple):
            return self._sequence(node, hint, where, meta)
        if origin is dict:
            return self._dict(node, hint, where, meta)
        return self._scalar(node, hint, where, meta)

    def _mapping(self, node: yaml.Node, where: str) -> dict:
        """Key text -> (key node, value node), refusing duplicates."""
        if not isinstance(node, yaml.MappingNode):
            raise self.error(
                node,
                f"{where or 'the file'} must hold 'key: value' pairs, "
                f"but holds {_describe(node)}",
            )
        items: dict[str, tuple[yaml.Node, yaml.Node]] = {}
        for key, value in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise self.error(key, "a key must be a plain word")
            if key.value in items:
                first = items[key.value][0].start_mark.line + 1
                raise self.error(
                    key,
                    f"duplicate key {key.value!r}{_inside(where)}, already "
                    f"given in line {first}; keep one of them",
                )
            items[key.value] = (key, value)
        return items

    def _dataclass(self, node: yaml.Node, cls: type, where: str) -> Any:
        items, hints = self._mapping(node, where), keys(cls)
        fields = {_key(f): f for f in dataclasses.fields(cls) if f.init}
        for text, (key, _) in items.items():
            if text not in fields:
                known = f"; known keys are {', '.join(fields)}"
                hint = nearest(text, fields) or known
                raise self.error(
                    key, f"unknown key {text!r}{_inside(where)}{hint}"
                )
        values = {}
        for name, field in fields.items():
            if name in items:
                values[field.name] = self.read(
                    items[name][1],
                    hints[name],
                    f"{where}.{name}" if where else name,
                    field.metadata,
                )
            elif field.default is field.default_factory is dataclasses.MISSING:
                unit = field.metadata.get("unit")
                raise self.error(
                    node,
                    f"missing key {name!r}{_inside(where)}; add "
                    f"'{name}: ...'" + (f" [{unit}]" if unit else ""),
                )
        try:
            return cls(**values)
        except (InputError, ValueError) as error:
            # A message that begins with a key gets the line of that key.
            named = re.match(r"\w*", str(error)).group()
            raise self.error(
                items.get(named, [node])[0],
                f"{where + ': ' if where else ''}{error}",
            ) from error

    def _union(
        self, node: yaml.Node, hint: Any, where: str, meta: Mapping
    ) -> Any:
        options = typing.get_args(hint)
        if _is_null(node) and type(None) in options:
            return None
        options = [o for o in options if o is not type(None)]
        errors = []
        for option in options:
            try:
                return self.read(node, option, where, meta)
            except InputError as error:
                errors.append(error)
        # Report the error of the option that was meant: a dataclass if the
        # node is a mapping, a sequence if it is a list.
        fitting = [
            e
            for e, o in zip(errors, options, strict=True)
            if _same_shape(node, o)
        ]
        raise (fitting or errors)[0]

    def _literal(self, node: yaml.Node, hint: Any, where: str) -> Any:
        choices = typing.get_args(hint)
        text = node.value if isinstance(node, yaml.ScalarNode) else None
        for choice in choices:
            if text == str(choice):
                return choice
        names = ", ".join(str(c) for c in choices)
        raise self.error(
            node,
            f"{where} must be one of {names}, but is "
            f"{_describe(node)}{nearest(text, [str(c) for c in choices])}",
        )

    def _sequence(
        self, node: yaml.Node, hint: Any, where: str, meta: Mapping
    ) -> Any:
        kind, args = typing.get_origin(hint), typing.get_args(hint)
        if not isinstance(node, yaml.SequenceNode):
            raise self.error(
                node, f"{where} must be a list, but is {_describe(node)}"
            )
        count = len(node.value)
        if kind is list or args[-1] is Ellipsis:
            args = (args[0],) * count
        elif len(args) != count:
            raise self.error(
                node, f"{where} must hold {len(args)} values, not {count}"
            )
        values = [
            self.read(item, arg, f"{where}[{i}]", meta)
            for i, (item, arg) in enumerate(zip(node.value, args, strict=True))
        ]
        return kind(values)

    def _dict(
        self, node: yaml.Node, hint: Any, where: str, meta: Mapping
    ) -> dict:
        key_hint, value_hint = typing.get_args(hint)
        result = {}
        for text, (key, value) in self._mapping(node, where).items():
            name = self.read(key, key_hint, f"key {text!r} of {where}", {})
            result[name] = self.read(value, value_hint, f"{where}.{text}", meta)
        return result

    def _scalar(
        self, node: yaml.Node, hint: Any, where: str, meta: Mapping
    ) -> Any:
        if hint is Any:
            try:
                return _Values("").construct_object(node, deep=True)
            except (yaml.YAMLError, ValueError) as error:
                raise self.error(
                    node,
                    f"{where} is not a text, number, list or mapping; give one",
                ) from error
        if not isinstance(node, yaml.ScalarNode) or _is_null(node):
            raise self._wrong(node, hint, where, meta)
        text = node.value
        if hint in (str, Path):
            if _CONTROL.search(text):
                raise self.error(
                    node,
                    f"{where} is {_short(ascii(text))}, with a character that "
                    "cannot be printed; remove it",
                )
            return hint(text)
        if node.style is not None:  # quoted: meant as text
            raise self._wrong(node, hint, where, meta)
        if hint is bool:
            if text.lower() in _TRUE + _FALSE:
                return text.lower() in _TRUE
            raise self._wrong(node, hint, where, meta)
        if hint not in (int, float):
            raise TypeError(f"{where}: schema cannot read {hint}")
        return self._number(node, hint, where, meta)

    def _number(
        self, node: yaml.Node, hint: Any, where: str, meta: Mapping
    ) -> int | float:
        text = node.value
        if text.lstrip("+-.").lower() in _NOT_FINITE:
            raise self.error(
                node, f"{where} is {text}, but must be a finite number"
            )
        try:
            value = hint(text)
        except ValueError as error:
            raise self._wrong(node, hint, where, meta) from error
        if not abs(value) <= _LARGEST:
            raise self.error(
                node, f"{where} is {_short(text)}, which is too large"
            )
        try:
            check_bounds(where, value, meta, _short(text))
        except InputError as error:
            raise self.error(node, str(error)) from error
        return value

    def _wrong(
        self, node: yaml.Node, hint: Any, where: str, meta: Mapping
    ) -> InputError:
        words = {
            float: "a number",
            int: "a whole number",
            bool: "true or false",
            str: "text",
            Path: "a path",
        }
        unit = f" [{meta['unit']}]" if meta.get("unit") else ""
        return self.error(
            node,
            f"{where} must be {words[hint]}{unit}, but is {_describe(node)}",
        )


def quantity(
    unit: str | None, default: Any = dataclasses.MISSING, **bounds: float
) -> Any:
    """A dataclass field with unit, and bounds as of `errors.check_bounds`."""
    metadata = {"unit": unit, **bounds}
    return dataclasses.field(default=default, metadata=metadata)


def positive(unit: str, default=None) -> Any:
    """A dataclass field with unit, whose value must be above 0."""
    return quantity(unit, default, above=0.0)


def not_negative(unit: str, default: float) -> Any:
    """A dataclass field with unit, whose value must be at least 0."""
    return quantity(unit, default, minimum=0.0)


def keys(cls: type) -> dict[str, Any]:
    """Key in a file -> type, of a dataclass's fields."""
    hints = typing.get_type_hints(cls)
    return {_key(f): hints[f.name] for f in dataclasses.fields(cls) if f.init}


def exactly_one(block, names) -> None:
    """Refuse settings in which none or several of `names` are set."""
    given = [n for n in names if getattr(block, n) is not None]
    if len(given) != 1:
        raise InputError(
            f"give exactly one of {', '.join(names)}, not "
            f"{' and '.join(given) or 'none'}"
        )


def _key(field: dataclasses.Field) -> str:
    """A field's key in the file, which may be a word Python reserves."""
    return field.metadata.get("key", field.name)


def _is_null(node: yaml.Node) -> bool:
    return (
        isinstance(node, yaml.ScalarNode)
        and node.tag == "tag:yaml.org,2002:null"
    )


def _same_shape(node: yaml.Node, hint: Any) -> bool:
    kind = typing.get_origin(hint) or hint
    if isinstance(node, yaml.MappingNode):
        return dataclasses.is_dataclass(kind) or kind is dict
    if isinstance(node, yaml.SequenceNode):
        return kind in (list, tuple)
    return kind in (str, int, float, bool, Path)


def _describe(node: yaml.Node) -> str:
    if isinstance(node, yaml.MappingNode):
        return "a group of keys"
    if isinstance(node, yaml.SequenceNode):
        return "a list"
    return "empty" if _is_null(node) else repr(_short(node.value))


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."


def _inside(where: str) -> str:
    return f" in {where}" if where else ""
