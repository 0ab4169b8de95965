import numpy as np
import pytest
from pydrake.autodiffutils import (
    AutoDiffXd,
    ExtractGradient,
    InitializeAutoDiff,
)
from pydrake.symbolic import Evaluate, Variable

from drake_exo.contact import scalars


def test_select_less_decides_complex_numbers_by_their_real_part():
    # numpy's own minimum would compare the imaginary parts of equal reals.
    a = np.array([1.0 + 1e-20j, 2.0 - 1e-20j, 3.0 + 1e-20j])
    b = np.array([1.0, 3.0, 2.0])
    np.testing.assert_array_equal(
        scalars.minimum(a, b), [1.0, 2.0 - 1e-20j, 2.0]
    )
    np.testing.assert_array_equal(
        scalars.maximum(a, b), [1.0 + 1e-20j, 3.0, 3.0 + 1e-20j]
    )


def test_select_less_is_strict():
    np.testing.assert_array_equal(
        scalars.select_less([0.0, 1.0, 2.0], 1.0, -1.0, 5.0), [-1.0, 5.0, 5.0]
    )


def test_autodiff_keeps_the_derivatives_of_the_selected_value():
    x = InitializeAutoDiff([[0.5], [2.0]]).ravel()
    smaller = scalars.minimum(3.0 * x, 2.0)
    np.testing.assert_array_equal(
        ExtractGradient(smaller.reshape(-1, 1)[:1]), [[3.0, 0.0]]
    )
    assert float(getattr(smaller[1], "value", lambda: smaller[1])()) == 2.0


def test_expression_selects_when_it_is_evaluated():
    x = Variable("x")
    expression = scalars.minimum(np.array([2.0 * x, x + 1.0]), 1.0)
    for value, expected in ((0.25, [0.5, 1.0]), (-2.0, [-4.0, -1.0])):
        np.testing.assert_allclose(
            Evaluate(expression, {x: value}).ravel(), expected
        )


@pytest.mark.parametrize("name", ["tanh", "sqrt", "exp", "cos", "sin"])
@pytest.mark.parametrize("value", [0.0, -0.3, 1.7, 800.0, np.inf, np.nan])
def test_a_float_by_itself_is_as_in_an_array(name, value):
    # Far off, an integrator's trial step must not raise.
    with np.errstate(all="ignore"):
        found = getattr(scalars, name)(float(value))
        expected = getattr(np, name)(value)
    assert type(found) is float
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_floats_by_themselves_are_selected_as_in_arrays():
    assert scalars.select_less(1.0, 2.0, 3.0, 4.0) == 3.0
    assert scalars.select_less(2.0, 2.0, 3.0, 4.0) == 4.0
    assert scalars.arctan2(1.0, -2.0) == np.arctan2(1.0, -2.0)


@pytest.mark.parametrize("name", ["tanh", "sqrt", "exp", "cos", "sin"])
def test_functions_agree_for_every_scalar_type(name):
    function, reference = getattr(scalars, name), getattr(np, name)
    values = np.array([0.2, 1.7])
    expected = reference(values)
    np.testing.assert_array_equal(function(values), expected)
    np.testing.assert_allclose(function(values + 0j).real, expected, rtol=1e-15)
    x = Variable("x")
    # An object array may hold plain floats beside Drake's scalars.
    mixed = function(np.array([0.2 + x, 1.7], dtype=object))
    np.testing.assert_allclose(
        [mixed[0].Evaluate({x: 0.0}), mixed[1]], expected, rtol=1e-15
    )
    autodiff = function(np.array([AutoDiffXd(0.2), 1.7], dtype=object))
    np.testing.assert_allclose(
        [autodiff[0].value(), autodiff[1]], expected, rtol=1e-15
    )


def test_arctan2_agrees_for_every_scalar_type():
    y, x = np.array([0.3, -0.2]), np.array([-1.0, 0.5])
    expected = np.arctan2(y, x)
    np.testing.assert_array_equal(scalars.arctan2(y, x), expected)
    zero = Variable("zero")
    symbolic = scalars.arctan2(np.array([v + zero for v in y]), x)
    np.testing.assert_allclose(
        Evaluate(symbolic, {zero: 0.0}).ravel(), expected
    )
    autodiff = scalars.arctan2(y + AutoDiffXd(0.0, [1.0]), x)
    np.testing.assert_allclose([a.value() for a in autodiff], expected)
