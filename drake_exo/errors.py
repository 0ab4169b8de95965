"""Errors that a user can act upon."""

_LONGEST = 120  # characters of another library's message


class InputError(Exception):
    """Bad input, told in one sentence that names file, field and remedy.

    The command line prints the sentence and exits with code 2.
    """


def printable(text: str, keep: str = "") -> str:
    """The text with question marks for what cannot be printed."""
    return "".join(c if c.isprintable() or c in keep else "?" for c in text)


def first_line(text: str) -> str:
    """The first line, short enough to stand in a sentence."""
    lines = text.strip().splitlines()
    line = printable(lines[0].strip()) if lines else ""
    return line if len(line) <= _LONGEST else line[:_LONGEST] + "..."


def reason(error: BaseException) -> str:
    """What an exception says, short enough to stand in a sentence."""
    return first_line(str(error)) or type(error).__name__
