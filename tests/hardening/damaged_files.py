"""Reads damaged files by the thousand: `damaged_files.py TRIES [FORMAT ...]`.

Prints one JSON line for each failure and each finished format. Meant to run
in a process of its own, with a limit on its memory, so that a crash of a
library's parser is seen and told from a hang. `--at FORMAT SEED` repeats one
try with its traceback.
"""

import json
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
import zlib
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from damage import damaged
from readers import formats

from drake_exo.errors import InputError

LONGEST_S = 60  # a hang, however busy the machine is
LARGEST_BYTES = 6 << 30


class TooSlowError(Exception):
    """A reader took longer than LONGEST_S."""


def _too_slow(*_):
    raise TooSlowError


def attempt(one, seed: int, folder: Path) -> str | None:
    """Read one damaged file; what went wrong, None if nothing."""
    rng = np.random.default_rng([seed, zlib.crc32(one.name.encode())])
    data = damaged(one.kind, one.original, rng)
    for old in folder.iterdir():
        old.unlink()
    path = folder / one.name
    path.write_bytes(data)
    signal.alarm(LONGEST_S)
    try:
        one.read(path)
    except InputError as error:
        return _judge(str(error), folder, one)
    except BaseException as error:
        return f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)
    return None


def _judge(sentence: str, folder, one) -> str | None:
    """A message must be one line, not endless, and name the file."""
    if "\n" in sentence or len(sentence) > 600:
        return f"message of {len(sentence)} characters: {sentence[:900]!r}"
    if str(folder) not in sentence and one.name not in sentence:
        return f"message names no file: {sentence}"
    return None


def main(argv) -> None:
    """Run; see the module."""
    warnings.simplefilter("error")
    resource.setrlimit(resource.RLIMIT_AS, (LARGEST_BYTES, LARGEST_BYTES))
    signal.signal(signal.SIGALRM, _too_slow)
    every = formats()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if argv[0] == "--at":
            one = every[argv[1]]
            print(attempt(one, int(argv[2]), folder))
            print((folder / one.name).read_bytes()[:4000])
            try:
                one.read(folder / one.name)
            except Exception:
                traceback.print_exc()
            return
        start = int(os.environ.get("START", "0"))
        for name in argv[1:] or every:
            one = every[name]
            sound = folder / one.name
            sound.write_bytes(one.original)
            one.read(sound)
            for seed in range(start, start + int(argv[0])):
                print(json.dumps({"trying": [name, seed]}), flush=True)
                wrong = attempt(one, seed, folder)
                if wrong:
                    text = {"format": name, "seed": seed, "wrong": wrong}
                    print(json.dumps(text), flush=True)
            print(json.dumps({"finished": name}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
