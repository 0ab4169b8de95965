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
from collections.abc import Mapping, Sequence
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
from drake_exo.files.output import read_bytes

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
    return _Item(name, node).read(cls)


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
    return _Item(name, node).read(type(settings))


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


class _Item:
    """A YAML node that becomes a typed value, and what messages say of it.

    Args:
        file: name of the file.
        node: the node.
        where: dotted key; empty for the whole file.
        meta: metadata of the field that holds it.
    """

    def __init__(
        self,
        file: str,
        node: yaml.Node,
        where: str = "",
        meta: Mapping = types.MappingProxyType({}),
    ):
        self.file, self.node, self.where, self.meta = file, node, where, meta

    def error(self, message: str, node: yaml.Node | None = None) -> InputError:
        """An error in the line of this node, or of one below."""
        mark = (node or self.node).start_mark  # None for settings of Python
        line = f":{mark.line + 1}" if mark else ""
        return InputError(f"{self.file}{line}: {message}")

    def read(self, hint: Any) -> Any:
        """The value as type `hint`."""
        origin = typing.get_origin(hint)
        if dataclasses.is_dataclass(hint):
            return self._dataclass(hint)
        if origin is typing.Union or origin is types.UnionType:
            return self._union(typing.get_args(hint))
        if origin is Literal:
            return self._literal(typing.get_args(hint))
        if origin in (list, tuple):
            return self._sequence(origin, typing.get_args(hint))
        if origin is dict:
            return self._dict(*typing.get_args(hint))
        return self._scalar(hint)

    def _mapping(self) -> dict[str, tuple[yaml.Node, yaml.Node]]:
        """Key text -> (key node, value node), refusing duplicates."""
        if not isinstance(self.node, yaml.MappingNode):
            raise self.error(
                f"{self.where or 'the file'} must hold 'key: value' pairs, "
                f"but holds {_describe(self.node)}"
            )
        items: dict[str, tuple[yaml.Node, yaml.Node]] = {}
        for key, value in self.node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise self.error("a key must be a plain word", key)
            if self.node.flow_style and key.value.isdigit() and _is_null(value):
                raise self.error(
                    f"{self.where or 'the file'} has {key.value!r} after a "
                    "comma; write numbers with a point and without separators, "
                    "as 0.05 or 5000000",
                    key,
                )
            if key.value in items:
                first = items[key.value][0].start_mark.line + 1
                raise self.error(
                    f"duplicate key {key.value!r}{self._inside}, already given "
                    f"in line {first}; keep one of them",
                    key,
                )
            items[key.value] = (key, value)
        return items

    @property
    def _inside(self) -> str:
        return f" in {self.where}" if self.where else ""

    def _dataclass(self, cls: type) -> Any:
        items, hints = self._mapping(), keys(cls)
        fields = {_key(f): f for f in dataclasses.fields(cls) if f.init}
        for text, (key, _) in items.items():
            if text not in fields:
                known = f"; known keys are {', '.join(fields)}"
                hint = nearest(text, fields) or known
                raise self.error(
                    f"unknown key {text!r}{self._inside}{hint}", key
                )
        values = {}
        for name, field in fields.items():
            if name in items:
                where = f"{self.where}.{name}" if self.where else name
                item = _Item(self.file, items[name][1], where, field.metadata)
                values[field.name] = item.read(hints[name])
            elif field.default is field.default_factory is dataclasses.MISSING:
                unit = field.metadata.get("unit")
                raise self.error(
                    f"missing key {name!r}{self._inside}; add "
                    f"'{name}: ...'" + (f" [{unit}]" if unit else "")
                )
        try:
            return cls(**values)
        except (InputError, ValueError) as error:
            # A message that begins with a key gets the line of that key.
            named = re.match(r"\w*", str(error)).group()
            where = f"{self.where}: " if self.where else ""
            at = items.get(named, [None])[0]
            raise self.error(f"{where}{error}", at) from error

    def _union(self, of: Sequence) -> Any:
        if _is_null(self.node) and type(None) in of:
            return None
        options = [o for o in of if o is not type(None)]
        errors = []
        for option in options:
            try:
                return self.read(option)
            except InputError as error:
                errors.append(error)
        if len(options) < len(of) and self.node.value in ("none", "None"):
            raise self.error(f"{self.where} is {self.node.value!r}; write null")
        # Report the error of the option that was meant: a dataclass if the
        # node is a mapping, a sequence if it is a list, the first if empty.
        fitting = [
            e
            for e, o in zip(errors, options, strict=True)
            if _is_null(self.node) or _same_shape(self.node, o)
        ]
        raise (fitting or errors)[0]

    def _literal(self, choices: Sequence) -> Any:
        is_scalar = isinstance(self.node, yaml.ScalarNode)
        text = self.node.value if is_scalar else None
        named = {str(choice): choice for choice in choices}
        if text in named:
            return named[text]
        raise self.error(
            f"{self.where} must be one of {', '.join(named)}, but is "
            f"{_describe(self.node)}{nearest(text, named)}"
        )

    def _sequence(self, kind: type, args: Sequence) -> Any:
        where, items = self.where, self.node.value
        if not isinstance(self.node, yaml.SequenceNode):
            raise self.error(
                f"{where} must be a list, but is {_describe(self.node)}"
            )
        if kind is list or args[-1] is Ellipsis:
            args = (args[0],) * len(items)
        elif len(args) != len(items):
            raise self.error(
                f"{where} must hold {len(args)} values, not {len(items)}"
            )
        return kind(
            _Item(self.file, item, f"{where}[{i}]", self.meta).read(arg)
            for i, (item, arg) in enumerate(zip(items, args, strict=True))
        )

    def _dict(self, key_hint: Any, value_hint: Any) -> dict:
        found = {}
        for text, (key, value) in self._mapping().items():
            name = _Item(self.file, key, f"key {text!r} of {self.where}")
            item = _Item(self.file, value, f"{self.where}.{text}", self.meta)
            read = name.read(key_hint)
            found[read] = item.read(value_hint)
        return found

    def _scalar(self, hint: Any) -> Any:
        node, where = self.node, self.where
        if hint is Any:
            try:
                return _Values("").construct_object(node, deep=True)
            except (yaml.YAMLError, ValueError) as error:
                raise self.error(
                    f"{where} is not a text, number, list or mapping; give one"
                ) from error
        if not isinstance(node, yaml.ScalarNode) or _is_null(node):
            raise self._wrong(hint)
        text = node.value
        if hint in (str, Path):
            if _CONTROL.search(text):
                raise self.error(
                    f"{where} is {_short(ascii(text))}, with a character that "
                    "cannot be printed; remove it"
                )
            return hint(text)
        if node.style is not None:  # quoted: meant as text
            raise self._wrong(hint)
        if hint is bool:
            if text.lower() in _TRUE + _FALSE:
                return text.lower() in _TRUE
            raise self._wrong(hint)
        if hint not in (int, float):
            raise TypeError(f"{where}: schema cannot read {hint}")
        return self._number(hint, text)

    def _number(self, hint: type, text: str) -> int | float:
        if text.lstrip("+-.").lower() in _NOT_FINITE:
            raise self.error(
                f"{self.where} is {text}, but must be a finite number"
            )
        try:
            value = hint(text)
        except ValueError as error:
            raise self._wrong(hint) from error
        if not abs(value) <= _LARGEST:
            raise self.error(
                f"{self.where} is {_short(text)}, which is too large"
            )
        try:
            check_bounds(self.where, value, self.meta, _short(text))
        except InputError as error:
            raise self.error(str(error)) from error
        return value

    def _wrong(self, hint: type) -> InputError:
        words = {
            float: "a number",
            int: "a whole number",
            bool: "true or false",
            str: "text",
            Path: "a path",
        }
        unit = f" [{self.meta['unit']}]" if self.meta.get("unit") else ""
        return self.error(
            f"{self.where} must be {words[hint]}{unit}, but is "
            f"{_describe(self.node)}"
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


def has_key(cls: type, text: str) -> bool:
    """Whether a text begins with a key of a dataclass and one below it.

    So a key is told from a file of its name, such as standing.c3d.
    """
    names = re.match(r"(\w+)\.(\w+)", text)
    hint = keys(cls).get(names[1]) if names else None
    kinds = filter(dataclasses.is_dataclass, typing.get_args(hint) or [hint])
    return any(names[2] in keys(kind) for kind in kinds)


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
