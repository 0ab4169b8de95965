"""Descriptions of two legs, alone and in a device of the user's own."""

import pytest
import two_legs_device


@pytest.fixture
def alone(tmp_path):
    path = tmp_path / "alone.yaml"
    path.write_text("human: {legs: two}\n")
    return path


@pytest.fixture
def worn(tmp_path):
    return two_legs_device.write(tmp_path)
