"""Functions that workers of the tests call."""

import errno
import os
import signal
import time
from pathlib import Path

from drake_exo.errors import InputError


def add(a, b):
    return a + b


def total(values, say):
    say(f"{len(values)} values")
    say(f"of {', '.join(values)}")
    return sum(values.values())


def sleep(seconds):
    time.sleep(seconds)
    return seconds


def refuse():
    raise InputError("a.yaml: wrong; mend it")


def fail():
    raise KeyError("ours")


def overfill():
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "a.csv")


def process():
    return os.getpid()


def die_until(place, times):
    """Kill its own process, that many times."""
    path = Path(place)
    count = len(path.read_text()) if path.exists() else 0
    path.write_text("x" * (count + 1))
    if count < times:
        os.kill(os.getpid(), signal.SIGKILL)
    return count


def fill(megabytes):
    return len(bytearray(megabytes * 2**20)) and megabytes


def exhaust():
    raise MemoryError


def find_no_room():
    """As the system says it of a file or a process."""
    raise OSError(errno.ENOMEM, "Cannot allocate memory")


def abort(saying="terminate called: std::bad_alloc"):
    """As C++ code does that finds no memory."""
    os.write(2, f"{saying}\n".encode())
    os.abort()


def spoil_streams():
    print("printed")
    os.write(1, b"as C++ code prints")
    return "answered"


def interrupted(path):
    """Write a file, and what there is once Ctrl-C comes."""
    path.write_text("begun")
    try:
        time.sleep(60.0)
    except KeyboardInterrupt:
        path.write_text("so far")
