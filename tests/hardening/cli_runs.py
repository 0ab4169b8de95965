"""Commands as a user runs them: in a process of their own."""

import subprocess
import sys


def normal_use(*command) -> str:
    """What a command prints; it succeeds, and warns of nothing."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "drake_exo.cli", *command],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stderr == ""
    return done.stdout
