"""From a MathematicalProgram to IPOPT: neutral ground for both halves."""

import ctypes
from functools import cache
from importlib import import_module
from importlib.metadata import files
from types import ModuleType


@cache
def load_ipyopt() -> ModuleType:
    """IPOPT's module; its MUMPS calls OpenBLAS.

    It calls the BLAS that the process met first. The reference one in ipyopt's
    wheel takes a third longer for a factorisation than OpenBLAS; that of the
    wheel of SCS (for Linux) has the usual names and one thread.
    """
    for stem in ("libgfortran", "libopenblas"):  # the one needs the other
        for file in files("scs") or ():
            if file.name.startswith(stem):
                ctypes.CDLL(str(file.locate()), ctypes.RTLD_GLOBAL)
    return import_module("ipyopt")
