"""Ways in which files come to be damaged, each drawn from a seeded generator.

`damaged(kind, data, rng)` gives bytes that differ from the original's: cut
off, with flipped bits, with other values, types, columns or encodings.
"""

import io
import json
import re

import numpy as np

_VALUES = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "1e-320", "0", "-1",
    "99999999999999999999", "0x10", "1_000", "", "abc", "1,5", "--", "٣",
    "null", "[1, 2]", "{a: 1}", "yes", "2026-01-01", "~", "!!binary aGk=",
    "&a [*a]", "'", '"', "\\x00", "-0.0", "1e5000", "é",
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def damaged(kind: str, data: bytes, rng: np.random.Generator) -> bytes:
    """A damaged copy of a file.

    Args:
        kind: "text", "json", "npz" or "binary".
        data: the whole file.
        rng: decides everything.
    """
    ways = list(_ANY)
    if kind in ("text", "json"):
        ways += _TEXT * 2
    if kind == "json":
        ways += [_json_value] * 20
    if kind == "npz":
        ways += [_array] * 15
    found = data
    while found == data:
        for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
            found = ways[rng.integers(len(ways))](found, rng)
    return found


def _place(data, rng) -> int:
    return int(rng.integers(len(data) + 1))


def _cut(data, rng):
    return data[: _place(data, rng)]


def _cut_start(data, rng):
    return data[_place(data, rng) :]


def _flip_bits(data, rng):
    found = bytearray(data)
    for _ in range(int(rng.choice([1, 2, 8, 64])) if found else 0):
        # Headers are where damage matters: half of the flips go there.
        end = min(len(found), 1024) if rng.random() < 0.5 else len(found)
        found[rng.integers(end)] ^= 1 << int(rng.integers(8))
    return bytes(found)


def _overwrite(data, rng):
    found = bytearray(data)
    at, n = _place(data, rng), int(rng.choice([1, 2, 4, 16, 512]))
    filling = (b"\x00", b"\xff", b"\x7f", rng.bytes(1))[rng.integers(4)]
    found[at : at + n] = filling * len(found[at : at + n])
    return bytes(found)


def _insert(data, rng):
    at = _place(data, rng)
    return data[:at] + rng.bytes(int(rng.integers(1, 64))) + data[at:]


def _remove(data, rng):
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 200)) :]


def _repeat(data, rng):
    at = _place(data, rng)
    return data[:at] + data[max(0, at - 300) :]


def _noise(data, rng):
    return rng.bytes(int(rng.integers(0, 3000)))


def _empty(data, rng):
    return b""


def _replace_number(data, rng):
    """Another value, or none, where a number was."""
    found = list(_NUMBER.finditer(data))
    if not found:
        return data
    one = found[rng.integers(len(found))]
    value = _VALUES[rng.integers(len(_VALUES))].encode()
    return data[: one.start()] + value + data[one.end() :]


def _replace_word(data, rng):
    found = list(re.finditer(rb"[A-Za-z_]\w*", data))
    if not found:
        return data
    one = found[rng.integers(len(found))]
    other = found[rng.integers(len(found))][0]
    value = (_VALUES[rng.integers(len(_VALUES))].encode(), other)
    return data[: one.start()] + value[rng.integers(2)] + data[one.end() :]


def _lines(change):
    def way(data, rng):
        lines = data.splitlines(keepends=True)
        if len(lines) < 2:
            return data
        i, j = (int(k) for k in rng.integers(len(lines), size=2))
        change(lines, i, j)
        return b"".join(lines)

    return way


def _drop_line(lines, i, j):
    del lines[i]


def _double_line(lines, i, j):
    lines.insert(j, lines[i])


def _swap_lines(lines, i, j):
    lines[i], lines[j] = lines[j], lines[i]


def _columns(data, rng):
    """Two columns swapped, or one removed, in all lines or in one."""
    separator = b"," if data.count(b",") > data.count(b"\t") else b"\t"
    rows = [line.split(separator) for line in data.split(b"\n")]
    width = max(len(row) for row in rows)
    i, j = (int(k) for k in rng.integers(width, size=2))
    remove, only = rng.random() < 0.3, rng.integers(len(rows))
    some = rng.random() < 0.3
    for k, row in enumerate(rows):
        if some and k != only:
            continue
        if remove and i < len(row):
            del row[i]
        elif max(i, j) < len(row):
            row[i], row[j] = row[j], row[i]
    return b"\n".join(separator.join(row) for row in rows)


def _encoding(data, rng):
    text = data.decode("utf-8", errors="replace")
    name = ("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "cp037")
    return text.encode(name[rng.integers(len(name))], errors="replace")


def _line_ends(data, rng):
    ends = (b"\r", b"\r\n", b"\n\n", b"\x0b", b" ", b"\x85")
    return data.replace(b"\n", ends[rng.integers(len(ends))])


def _separators(data, rng):
    pairs = ((b",", b";"), (b"\t", b" "), (b".", b","), (b":", b"="))
    return data.replace(*pairs[rng.integers(len(pairs))])


_ANY = (
    _cut, _cut, _cut_start, _flip_bits, _flip_bits, _flip_bits, _overwrite,
    _overwrite, _insert, _remove, _repeat, _noise, _empty,
)  # fmt: skip
_TEXT = [
    _replace_number, _replace_number, _replace_number, _replace_word,
    _replace_word, _lines(_drop_line), _lines(_double_line),
    _lines(_swap_lines), _columns, _encoding, _line_ends, _separators,
]  # fmt: skip

_JSON = (
    None, True, 0, -1, 1.5, 1e308, float("nan"), float("inf"), "", "abc", [],
    {}, [[]], [1, "a"], {"a": {}}, 10**30, "heel",
)  # fmt: skip


def _json_value(data, rng):
    """One value of another type, or one key removed or renamed."""
    try:
        tree = json.loads(data)
    except ValueError:
        return data
    places = list(_places(tree)) if isinstance(tree, dict | list) else []
    if not places:
        return data
    parent, key = places[rng.integers(len(places))]
    way = rng.random()
    if way < 0.2:
        del parent[key]
    elif way < 0.3 and isinstance(parent, dict):
        parent[key + "x"] = parent.pop(key)
    else:
        parent[key] = _JSON[rng.integers(len(_JSON))]
    return json.dumps(tree).encode()


def _places(tree):
    keys = tree if isinstance(tree, dict) else range(len(tree))
    for key in list(keys):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _places(tree[key])


def _array(data, rng):
    """One array of another shape, type or content, or none."""
    try:
        with np.load(io.BytesIO(data)) as file:
            arrays = {name: file[name] for name in file.files}
    except Exception:  # damaged before
        return data
    if not arrays:
        return data
    name = list(arrays)[rng.integers(len(arrays))]
    x = arrays.pop(name)
    others = {
        "none": None,
        "nan": np.full(x.shape, np.nan),
        "huge": np.full(x.shape, 1e308),
        "text": np.full(x.shape, "abc"),
        "object": np.full(x.shape, None, object),
        "complex": np.full(x.shape, 1j),
        "flat": np.ravel(x),
        "short": x[:-1] if x.ndim else x,
        "deep": x[None],
        "empty": np.zeros(0),
        "scalar": np.array(1.0),
        "bool": np.zeros(x.shape, bool),
    }
    way = list(others)[rng.integers(len(others))]
    if others[way] is not None:
        arrays[name + "x" if rng.random() < 0.1 else name] = others[way]
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()
