"""What the recordings of a module's own laboratory share."""

import shutil

import pytest


@pytest.fixture
def files(tmp_path, made):
    """A copy that a test may damage."""
    folder, _, study = made
    for path in folder.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path, study
