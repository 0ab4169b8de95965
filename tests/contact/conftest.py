"""Checks of derivatives shared by the force tests."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest


def _complex_step(
    function: Callable, arguments: Sequence, index: int
) -> np.ndarray:
    step = 1e-30 * max(np.max(np.abs(arguments[index])), 1.0)
    stepped = list(arguments)
    stepped[index] = stepped[index] + 1j * step
    return np.imag(function(*stepped)) / step


def _check(
    function: Callable,
    arguments: Sequence,
    derivatives: np.ndarray,
    tolerance: float = 1e-11,
) -> None:
    """Compare derivatives with complex steps, relative to each one's scale.

    Args:
        function: of `arguments`, returns an array (outputs, ...).
        arguments: values of each input.
        derivatives: (outputs, inputs, ...).
        tolerance: of the difference over the largest derivative of a pair.
    """
    assert derivatives.shape[1] == len(arguments) > 0
    for index in range(len(arguments)):
        expected = _complex_step(function, arguments, index)
        error = np.abs(derivatives[:, index] - expected)
        scale = np.max(np.abs(expected)) or 1.0
        worst = np.max(error) / scale
        assert worst < tolerance, f"input {index}: relative error {worst:.1e}"


@pytest.fixture
def check_derivatives() -> Callable:
    """The checker, after it has caught a planted wrong derivative."""

    def square(a, b):
        return np.array([a * a * b])

    a, b = np.array([1.0, 2.0, 3.0]), np.array([2.0, 5.0, 7.0])
    right = np.array([[2.0 * a * b, a * a]])
    _check(square, (a, b), right)
    for wrong in (right * (1.0 + 1e-9), right[:, ::-1], -right):
        with pytest.raises(AssertionError, match="relative error"):
            _check(square, (a, b), wrong)
    return _check
