"""A sound file as bytes."""

import tempfile
from pathlib import Path


def written(write, name="a") -> bytes:
    """What `write(path)` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()
