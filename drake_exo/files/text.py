"""Text files of numbers, read so that every mistake is named by its line."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError, printable

# No measurement is larger in any unit; squares and sums stay numbers.
_LARGEST = 1e30
_SHOWN = 40  # characters of a cell in a message


def read_bytes(path: str | Path, remedy: str = "check the path") -> bytes:
    """What a file holds.

    Raises:
        InputError: it cannot be read; `remedy` ends the sentence.
    """
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); {remedy}"
        ) from error


def read_text(path: str | Path, remedy: str = "check the path") -> str:
    """Text of a file; bytes that are no UTF-8 become question marks.

    Raises:
        InputError: it cannot be read, or is no text.
    """
    data = read_bytes(path, remedy)
    if b"\0" in data:
        raise InputError(f"{path}: is a binary file, not text; check it")
    text = data.decode("utf-8-sig", errors="replace")
    # Names from damaged files end up in messages: one line, printable.
    return printable(text, keep="\t\r\n")


def shown(cell: str) -> str:
    """A cell as it may stand in a message: not endless."""
    cell = cell.strip()
    return cell if len(cell) <= _SHOWN else cell[:_SHOWN] + "..."


def number_rows(
    path: str | Path, rows: Iterable[tuple[int, list[str]]], width: int
) -> np.ndarray:
    """Rows of text cells as numbers (len(rows), width); empty cells are NaN.

    Args:
        path: for messages.
        rows: line number and cells of each.
        width: cells that each row must have.

    Raises:
        InputError: naming the line: another number of cells, a cell that is
            no number, or one that no measurement can be; or there are no
            rows.
    """
    rows = list(rows)
    if not rows:
        raise InputError(f"{path}: holds no data rows; export it again")
    for line, cells in rows:
        if len(cells) != width:
            raise InputError(
                f"{path}:{line}: has {len(cells)} values where {width} are "
                "named; the file is truncated or damaged"
            )
    texts = [[cell.strip() or "nan" for cell in cells] for _, cells in rows]
    try:
        values = np.array(texts, dtype=float)
    except ValueError:
        raise _not_a_number(path, rows, texts) from None
    large = np.abs(values) > _LARGEST
    if large.any():
        i, j = np.argwhere(large)[0]
        raise InputError(
            f"{path}:{rows[i][0]}: {shown(texts[i][j])!r} is larger than "
            "any measurement; the file is damaged"
        )
    return values


def frame_rate(path: str | Path, text: str | None, key: str) -> float:
    """Frames per second that a header names under `key`.

    Raises:
        InputError: it does not, or no camera is that slow or fast.
    """
    try:
        rate = float(text)
    except (TypeError, ValueError):
        rate = 0.0
    if not 0.0 < rate < 1e6:
        raise InputError(
            f"{path}: {key} in the header is {text and shown(text)!r}; write "
            "frames per second"
        )
    return rate


def _not_a_number(path, rows, texts) -> InputError:
    for (line, _), cells in zip(rows, texts, strict=True):
        for cell in cells:
            try:
                float(cell)
            except ValueError:
                return InputError(
                    f"{path}:{line}: holds text among numbers "
                    f"({shown(cell)!r}); correct it or export it again"
                )
    return InputError(f"{path}: holds text among numbers; export it again")
