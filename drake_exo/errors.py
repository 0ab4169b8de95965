"""Errors that a user can act upon."""


class InputError(Exception):
    """Bad input, told in one sentence that names file, field and remedy.

    The command line prints the sentence and exits with code 2.
    """
