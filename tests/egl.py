"""Pictures that Drake draws need libEGL, which servers may lack."""

from ctypes.util import find_library

import pytest

draws = pytest.mark.skipif(
    find_library("EGL") is None, reason="Drake draws with libEGL, not there"
)


def drawn(path):
    """A script or notebook as a parameter, skipped where it cannot draw."""
    marks = [draws] if ".render(" in path.read_text("utf-8") else []
    return pytest.param(path, marks=marks, id=path.name)
