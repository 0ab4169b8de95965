"""Bridge from a MathematicalProgram to IPOPT, for exoskeletons and soles."""

import signal
import threading
from contextlib import contextmanager


@contextmanager
def stop_on_interrupt(stop: threading.Event):
    """Turn the first Ctrl-C into a request to stop; the second raises.

    Python's own KeyboardInterrupt would be raised within IPOPT's C++, where
    the second one may be lost: then it is raised at the end.
    """
    again = threading.Event()

    def handle(number, frame):
        if stop.is_set():
            again.set()
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
    if again.is_set():
        raise KeyboardInterrupt
