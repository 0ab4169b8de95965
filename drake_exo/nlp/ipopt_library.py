"""IPOPT of the casadi wheel, called through its C interface.

The wheel brings IPOPT, MUMPS and their BLAS for Linux and macOS. casadi's own
interface would hide the iterations' errors and IPOPT's restoration, so the
library is called as IPOPT documents it (IpStdCInterface.h). A process that
forks while another thread solves may hang: MUMPS' lock is copied.
"""

import ctypes
import os
import sys
from collections.abc import Callable
from ctypes import CFUNCTYPE, POINTER, c_bool, c_char_p, c_double, c_int
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from numbers import Integral, Real
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError

# Of IPOPT's ApplicationReturnStatus.
SOLVED, INFEASIBLE = 0, 2
_HELD = 1e-8  # by which a constraint may be missed where nothing is free

_Data = ctypes.c_void_p  # user_data, or a problem
_Numbers, _Indices = POINTER(c_double), POINTER(c_int)
# The result, then n, x, whether x is new, and what the header lists.
_Cost = CFUNCTYPE(c_bool, c_int, _Numbers, c_bool, _Numbers, _Data)
_Gradient = _Cost
_Constraints = CFUNCTYPE(
    c_bool, c_int, _Numbers, c_bool, c_int, _Numbers, _Data
)
_Jacobian = CFUNCTYPE(
    c_bool, c_int, _Numbers, c_bool,
    c_int, c_int, _Indices, _Indices, _Numbers, _Data,
)  # fmt: skip
_Hessian = CFUNCTYPE(
    c_bool, c_int, _Numbers, c_bool,
    c_double, c_int, _Numbers, c_bool,
    c_int, _Indices, _Indices, _Numbers, _Data,
)  # fmt: skip
_Watch = CFUNCTYPE(c_bool, c_int, c_int, *[c_double] * 8, c_int, _Data)


@cache
def _library() -> ctypes.CDLL:
    ending = "dylib" if sys.platform == "darwin" else "so"
    casadi = find_spec("casadi")
    if casadi is None:
        raise ImportError("install casadi, whose wheel holds IPOPT")
    file = Path(casadi.origin).with_name(f"libipopt.{ending}")
    # Else a BLAS that another package loaded for all would take the place of
    # this one's: MUMPS then returns wrong factors.
    library = ctypes.CDLL(str(file), getattr(os, "RTLD_DEEPBIND", 0))
    library.CreateIpoptProblem.restype = _Data
    library.CreateIpoptProblem.argtypes = [
        *(c_int, _Numbers, _Numbers, c_int, _Numbers, _Numbers),
        *(c_int, c_int, c_int),
        *(_Cost, _Constraints, _Gradient, _Jacobian, _Hessian),
    ]
    for kind, number in (("Str", c_char_p), ("Num", c_double), ("Int", c_int)):
        add = getattr(library, f"AddIpopt{kind}Option")
        add.restype, add.argtypes = c_bool, [_Data, c_char_p, number]
    library.SetIntermediateCallback.restype = c_bool
    library.SetIntermediateCallback.argtypes = [_Data, _Watch]
    library.IpoptSolve.argtypes = [_Data, *[_Numbers] * 6, _Data]
    library.FreeIpoptProblem.restype = None
    library.FreeIpoptProblem.argtypes = [_Data]
    return library


@dataclass(frozen=True)
class Outcome:
    """What IPOPT ends with.

    Attributes:
        x: (n,) last point.
        cost: cost there.
        status: IPOPT's ApplicationReturnStatus.
        multipliers: (m,) of the constraints.
        at_bounds: (n,) each, of the lower and the upper bounds.
    """

    x: np.ndarray
    cost: float
    status: int
    multipliers: np.ndarray
    at_bounds: tuple[np.ndarray, np.ndarray]


def run_ipopt(
    x0: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    constraint_bounds: tuple[np.ndarray, np.ndarray],
    jacobian_structure: tuple[np.ndarray, np.ndarray],
    hessian_structure: tuple[np.ndarray, np.ndarray],
    cost: Callable,
    gradient: Callable,
    constraints: Callable,
    jacobian: Callable,
    hessian: Callable,
    watch: Callable,
    *,
    options: dict,
    multipliers: np.ndarray | None = None,
    at_bounds: tuple[np.ndarray, np.ndarray] | None = None,
) -> Outcome:
    """Minimise cost(x) within bounds on x (n,) and on constraints(x) (m,).

    Args:
        x0: where to start.
        bounds, constraint_bounds: lower and upper ones, infinite where none.
        jacobian_structure, hessian_structure: rows and columns of the entries,
            of the Hessian's in one triangle.
        cost, gradient, constraints, jacobian: functions of x; the last three
            return arrays.
        hessian: function of x, the constraints' multipliers (m,) and the cost's
            factor; returns the entries of the Lagrangian's Hessian.
        watch: called in each iteration with IPOPT's mode (1 in restoration),
            iteration, cost, primal and dual infeasibility, barrier parameter,
            length of the step, regularization, dual and primal share of the
            step and trials; ends the run if it returns False.
        options: IPOPT's, by name.
        multipliers, at_bounds: to start from if IPOPT's options say so.

    Raises:
        InputError: IPOPT has no such option, or refuses its value.
        BaseException: whatever a function raises ends the run.
    """
    n, m = len(x0), len(constraint_bounds[0])
    if n == 0:  # the C interface takes neither this ...
        return _nothing_to_find(x0, constraint_bounds, cost, constraints)
    if m and not len(jacobian_structure[0]):  # ... nor no entry at all
        jacobian_structure, jacobian = np.zeros((2, 1), int), lambda x: 0.0
    raised = []

    def guarded(function):
        """Keep errors out of C++; nothing is computed after the first one."""

        def call(*args):
            if raised:
                return False
            try:
                return function(*args)
            except BaseException as error:
                raised.append(error)
                return False

        return call

    def array(pointer, size=n):
        return np.ctypeslib.as_array(pointer, (size,)) if size else np.empty(0)

    def point(pointer, size=n):
        return array(pointer, size).copy()

    def value(_, x, new, out, data):
        out[0] = cost(point(x))
        return True

    def slope(_, x, new, out, data):
        array(out)[:] = gradient(point(x))
        return True

    def values(_, x, new, m, out, data):
        array(out, m)[:] = constraints(point(x))
        return True

    def first(_, x, new, m, size, rows, columns, out, data):
        if out:
            array(out, size)[:] = jacobian(point(x))
        else:  # IPOPT asks for the structure
            array(rows, size)[:], array(columns, size)[:] = jacobian_structure
        return True

    def second(_, x, new, factor, m, lam, newer, size, rows, columns, out, d):
        if out:
            given = point(x), point(lam, m), factor
            array(out, size)[:] = hessian(*given)
        else:
            array(rows, size)[:], array(columns, size)[:] = hessian_structure
        return True

    calls = (
        _Cost(guarded(value)),
        _Constraints(guarded(values)),
        _Gradient(guarded(slope)),
        _Jacobian(guarded(first)),
        _Hessian(guarded(second)),
    )
    follow = _Watch(guarded(lambda *told: bool(watch(*told[:-1]))))  # no data
    library = _library()
    sides = [_owned(side) for side in (*bounds, *constraint_bounds)]
    low, high, least, most = map(_pointer, sides)
    sizes = len(jacobian_structure[0]), len(hessian_structure[0])
    problem = library.CreateIpoptProblem(
        *(n, low, high, m, least, most, *sizes, 0), *calls
    )
    x, multipliers = _owned(x0), _owned(multipliers, m)
    at_bounds = tuple(_owned(side, n) for side in at_bounds or (None, None))
    found = np.full(1, np.nan)
    # No options of a file that lies in the working folder.
    options = {"option_file_name": "", **options}
    try:
        for name, given in options.items():
            _set(library, problem, name, given)
        library.SetIntermediateCallback(problem, follow)
        places = (x, None, found, multipliers, *at_bounds)
        status = library.IpoptSolve(problem, *map(_pointer, places), None)
    finally:
        library.FreeIpoptProblem(problem)
    if raised:
        raise raised[0]
    return Outcome(x, float(found[0]), status, multipliers, at_bounds)


def _nothing_to_find(x, constraint_bounds, cost, constraints) -> Outcome:
    """The outcome where all unknowns are fixed: whether constraints hold."""
    values, (low, high) = np.asarray(constraints(x)), constraint_bounds
    holds = np.all((values >= low - _HELD) & (values <= high + _HELD))
    status = SOLVED if holds else INFEASIBLE
    at_bounds = np.zeros(0), np.zeros(0)
    multipliers = np.zeros(len(values))
    return Outcome(x, float(cost(x)), status, multipliers, at_bounds)


def _set(library, problem, name, value) -> None:
    key, done = name.encode(), False
    if isinstance(value, str):
        done = library.AddIpoptStrOption(problem, key, value.encode())
    elif isinstance(value, Integral):
        if abs(value) < 2**31:
            done = library.AddIpoptIntOption(problem, key, int(value))
    elif isinstance(value, Real):
        done = library.AddIpoptNumOption(problem, key, float(value))
    if not done:
        raise InputError(
            f"IPOPT takes no option {name!r} of {value!r}; see its list of "
            "options, and write a real number with a decimal point"
        )


def _owned(values, size=0) -> np.ndarray:
    """A copy that C may write; zeros if there are no values."""
    return np.zeros(size) if values is None else np.array(values, float)


def _pointer(values):
    return None if values is None else values.ctypes.data_as(_Numbers)
