"""Elementary functions for every scalar type that a force law is used with.

The laws are written once and run on float and complex arrays of numpy (complex
for complex-step derivatives), on AutoDiffXd and on Expression. Numpy's ufuncs
take all of them except where a branch has to be decided: `np.minimum`,
`np.where` and `np.clip` fail on Expression, and compare complex numbers by
their imaginary part when the real parts tie. Branches therefore go through
`select_less`, which compares complex numbers by their real parts.

Object arrays may mix Python floats with Drake's scalars. Plain Python floats
go through `math`, which is many times as fast as numpy: a simulation evaluates
the laws sphere by sphere, ten thousand times per second of movement.
"""

import functools
import math
from dataclasses import is_dataclass

import numpy as np

_QUIET = {"invalid": "ignore", "over": "ignore"}


def any_scalar(function):
    """Decorates a function whose arguments may hold Drake's scalars.

    Two warnings of numpy are silenced where arguments hold objects. Drake
    keeps an Expression in a NaN-boxed double, and some of these look like the
    result of an invalid operation, depending on memory addresses. And the
    derivative of a saturated tanh, 1/cosh², overflows to its right value 0.
    """

    @functools.wraps(function)
    def quiet(*args, **kwargs):
        if _any_object(args) or _any_object(kwargs.values()):
            with np.errstate(**_QUIET):
                return function(*args, **kwargs)
        return function(*args, **kwargs)

    return quiet


# Types that hold no Drake scalar; the check must be fast in simulations.
_PLAIN = frozenset((float, int, complex, str, bool, type(None), np.float64))


def _any_object(values) -> bool:
    if _PLAIN.issuperset(map(type, values)):  # decides most calls, in C
        return False
    for value in values:
        if type(value) not in _PLAIN and _holds_object(value):
            return True
    return False


def _holds_object(value) -> bool:
    kind = type(value)
    if kind in _PLAIN:
        return False
    if kind is np.ndarray:
        return value.dtype.hasobject
    if issubclass(kind, (tuple, list)):
        return _any_object(value)
    if is_dataclass(kind):
        return _any_object(vars(value).values())
    return not issubclass(kind, np.generic)


def _unary(ufunc, scalar_function):
    def element(value):
        if isinstance(value, int | float):
            return scalar_function(value)
        return ufunc(value)

    on_objects = np.frompyfunc(element, 1, 1)

    def function(value):
        if type(value) is float:
            try:
                return scalar_function(value)
            except (ValueError, OverflowError):  # numpy knows inf and NaN
                return float(ufunc(value))
        if not _holds_object(value):
            return ufunc(value)
        with np.errstate(**_QUIET):
            return on_objects(value)

    function.__name__ = function.__qualname__ = ufunc.__name__
    function.__doc__ = f"Elementwise {ufunc.__name__} for any scalar type."
    return function


tanh = _unary(np.tanh, math.tanh)
sqrt = _unary(np.sqrt, math.sqrt)
exp = _unary(np.exp, math.exp)
cos = _unary(np.cos, math.cos)
sin = _unary(np.sin, math.sin)


def arctan2(y, x):
    """Elementwise angle of (x, y) in (−π, π]; not for complex numbers."""
    if type(y) is type(x) is float:
        return math.atan2(y, x)
    with np.errstate(**_QUIET):
        return np.arctan2(y, x)


def _select_element(a, b, if_less, otherwise):
    condition = a < b
    if isinstance(condition, bool | np.bool_):
        return if_less if condition else otherwise
    from pydrake.symbolic import if_then_else

    return if_then_else(condition, if_less, otherwise)


_select_objects = np.frompyfunc(_select_element, 4, 1)


def select_less(a, b, if_less, otherwise):
    """Returns `if_less` where a < b and `otherwise` elsewhere.

    Both values are evaluated, so neither may fail where it is not selected.
    Complex numbers compare by their real parts. All arguments broadcast.
    """
    if type(a) is type(b) is type(if_less) is type(otherwise) is float:
        return if_less if a < b else otherwise
    if _holds_object((a, b, if_less, otherwise)):
        with np.errstate(**_QUIET):
            return _select_objects(a, b, if_less, otherwise)
    return np.where(np.real(a) < np.real(b), if_less, otherwise)


def minimum(a, b):
    """Elementwise smaller of a and b, complex ones by the real part."""
    return select_less(a, b, a, b)


def maximum(a, b):
    """Elementwise larger of a and b, complex ones by the real part."""
    return select_less(a, b, b, a)
