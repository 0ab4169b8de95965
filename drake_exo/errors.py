"""Errors that a user can act upon."""

_LONGEST = 120  # characters of another library's message


class InputError(Exception):
    """Bad input, told in one sentence that names file, field and remedy.

    The command line prints the sentence and exits with code 2.
    """


def reason(error: BaseException) -> str:
    """What an exception says, short enough to stand in a sentence."""
    lines = str(error).strip().splitlines()
    text = lines[0].strip() if lines else ""
    text = "".join(c if c.isprintable() else "?" for c in text)
    if len(text) > _LONGEST:
        text = text[:_LONGEST] + "..."
    return text or type(error).__name__
