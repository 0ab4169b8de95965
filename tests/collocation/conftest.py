"""The model of the kernels' tests."""

import pytest


@pytest.fixture(scope="module")
def plant(nominal):
    return nominal("coupled").plant()


@pytest.fixture(scope="module")
def tree(nominal):
    return nominal("coupled").tree
