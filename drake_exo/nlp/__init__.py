"""Bridge from a MathematicalProgram to IPOPT, for exoskeletons and soles."""

import ctypes
import signal
import threading
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.metadata import files
from types import ModuleType


@cache
def load_ipyopt() -> ModuleType:
    """The module ipyopt, with OpenBLAS loaded first for its MUMPS.

    MUMPS calls the BLAS that the process loaded first. The reference BLAS in
    ipyopt's wheel takes a third longer for a factorisation than OpenBLAS; the
    one in the SCS wheel (Linux) has the usual names and one thread.
    """
    for stem in ("libgfortran", "libopenblas"):  # the one needs the other
        for file in files("scs") or ():
            if file.name.startswith(stem):
                ctypes.CDLL(str(file.locate()), ctypes.RTLD_GLOBAL)
    return import_module("ipyopt")


@contextmanager
def stop_on_interrupt(stop: threading.Event):
    """Turn the first Ctrl-C into a request to stop; the second raises.

    Python's own KeyboardInterrupt would be raised within IPOPT's C++.
    """

    def handle(number, frame):
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    previous = None
    is_main = threading.current_thread() is threading.main_thread()
    # A job started with `&` ignores SIGINT: then leave it so.
    if is_main and callable(signal.getsignal(signal.SIGINT)):
        previous = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        if previous is not None:
            signal.signal(signal.SIGINT, previous)
