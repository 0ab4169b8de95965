"""From a MathematicalProgram to IPOPT: neutral ground for both halves."""

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


@contextmanager
def stop_on_interrupt(stop: threading.Event):
    """Turn the first Ctrl-C into a request to stop; the second raises.

    Python's own would surface within IPOPT's C++.
    """

    def handle(number, frame):
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    previous = None
    is_main = threading.current_thread() is threading.main_thread()
    # A job begun by `&` ignores it.
    if is_main and callable(signal.getsignal(signal.SIGINT)):
        previous = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        if previous is not None:
            signal.signal(signal.SIGINT, previous)
