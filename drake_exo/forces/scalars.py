"""Elementary functions for every kind of number a force law meets.

The laws are written once and run on float and complex arrays of numpy (complex
for complex-step derivatives), on AutoDiffXd and on Expression. Numpy's ufuncs
take all of them except where a branch has to be decided: `np.minimum`,
`np.where` and `np.clip` fail on Expression, and compare complex numbers by
their imaginary part when the real parts tie. Branches therefore go through
`select_less`, which decides a complex one by its real part.

Object arrays may mix Python floats with Drake's scalars.
"""

import math

import numpy as np


def _is_object(*values) -> bool:
    return any(np.asarray(value).dtype == object for value in values)


def _unary(ufunc, scalar_function):
    def element(value):
        if isinstance(value, int | float):
            return scalar_function(value)
        return ufunc(value)

    on_objects = np.frompyfunc(element, 1, 1)

    def function(value):
        return on_objects(value) if _is_object(value) else ufunc(value)

    function.__name__ = function.__qualname__ = ufunc.__name__
    function.__doc__ = f"Elementwise {ufunc.__name__} for any scalar type."
    return function


tanh = _unary(np.tanh, math.tanh)
sqrt = _unary(np.sqrt, math.sqrt)
exp = _unary(np.exp, math.exp)
cos = _unary(np.cos, math.cos)
sin = _unary(np.sin, math.sin)


def _select_element(a, b, if_less, otherwise):
    condition = a < b
    if isinstance(condition, bool | np.bool_):
        return if_less if condition else otherwise
    from pydrake.symbolic import Expression, if_then_else

    return if_then_else(condition, Expression(if_less), Expression(otherwise))


_select_objects = np.frompyfunc(_select_element, 4, 1)


def select_less(a, b, if_less, otherwise):
    """Returns `if_less` where a < b and `otherwise` elsewhere.

    Both values are evaluated, so neither may fail where it is not selected.
    Complex numbers compare by their real parts. All arguments broadcast.
    """
    if _is_object(a, b, if_less, otherwise):
        return _select_objects(a, b, if_less, otherwise)
    return np.where(np.real(a) < np.real(b), if_less, otherwise)


def minimum(a, b):
    """Elementwise smaller of a and b, complex ones by the real part."""
    return select_less(a, b, a, b)


def maximum(a, b):
    """Elementwise larger of a and b, complex ones by the real part."""
    return select_less(a, b, b, a)
