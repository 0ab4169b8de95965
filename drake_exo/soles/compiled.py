"""numba's compiler with a cache on disk that no edited source survives."""

from collections.abc import Callable

import numba
from numba.core.dispatcher import Dispatcher


def njit(**options) -> Callable[[Callable], Dispatcher]:
    """A decorator as `numba.njit(cache=True)`.

    numba compiles anew when a function's own file has changed. What it calls
    from other modules is compiled into it, so that their files count here,
    too: all whose compiled functions the function's module has imported.

    Args:
        options: of `numba.njit`.

    Returns:
        Makes a compiled function of a Python function. Decorate only in
        modules on disk: numba knows of no other place for its cache.
    """

    def compiled(function: Callable) -> Dispatcher:
        found = numba.njit(cache=True, **options)(function)
        imported = [
            value
            for value in function.__globals__.values()
            if isinstance(value, Dispatcher)
            and value.__module__ != function.__module__
        ]
        # What the cache on disk must have been made of.
        index = found._cache._cache_file
        index._source_stamp = (
            index._source_stamp,
            *(other._cache._cache_file._source_stamp for other in imported),
        )
        return found

    return compiled
