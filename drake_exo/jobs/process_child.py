"""Main program of the process in which `engine.Worker` runs jobs.

Jobs arrive as pickles on standard input, one at a time; answers go back on what
was standard output. What a job prints goes to standard error.
"""

import errno
import importlib
import os
import pickle
import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable

from drake_exo.errors import InputError, reason


def bound_memory(megabytes: int) -> None:
    """Limit this process's memory; the system refuses more (Linux)."""
    import resource

    limit = megabytes * 2**20
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def function_of(name: str) -> Callable:
    """Import the function that "module:name" names."""
    module, _, name = name.partition(":")
    return getattr(importlib.import_module(module), name)


def call(function: str, arguments: dict) -> dict:
    """Run a job; its answer: state, value or error and trace, seconds."""
    start = time.perf_counter()
    answer = {"state": "failed"}
    try:
        value = function_of(function)(**arguments)
        answer |= {"state": "done", "value": value}
    except InputError as error:
        answer["error"] = str(error)
    except Exception as error:
        no_memory = getattr(error, "errno", None) == errno.ENOMEM
        if no_memory or isinstance(error, MemoryError):
            answer["state"] = "memory"
        else:
            answer["error"] = f"{type(error).__name__}: {reason(error)}"
            answer["trace"] = traceback.format_exc()
            answer["raised"] = error if isinstance(error, OSError) else None
    answer["seconds"] = time.perf_counter() - start
    return answer


def _read(inbox, jobs: queue.SimpleQueue) -> None:
    """Queue jobs from the input; exit, even at work, when the parent has."""
    try:
        while True:
            jobs.put(pickle.load(inbox))
    except EOFError:
        os._exit(1)
    except BaseException:  # arguments that cannot be read here
        traceback.print_exc()
        os._exit(1)


def main() -> None:
    """Run jobs from standard input until it ends."""
    outbox = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    if len(sys.argv) > 1:
        bound_memory(int(sys.argv[1]))
    jobs: queue.SimpleQueue = queue.SimpleQueue()
    inbox = sys.stdin.buffer
    threading.Thread(target=_read, args=(inbox, jobs), daemon=True).start()
    while True:
        answer = call(*jobs.get())
        pickle.dump(answer, outbox)
        outbox.flush()


if __name__ == "__main__":
    main()
