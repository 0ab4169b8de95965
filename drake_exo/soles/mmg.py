"""Mmg (Dapogny, Dobrzynski, Frey, J. Comput. Phys. 262, 2014) on arrays.

In a process of its own (`mmg_child.py`), since there are bodies that it runs
on without end about.
"""

import io
import subprocess
import sys
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from drake_exo.errors import InputError, first_line

_CHILD = Path(__file__).with_name("mmg_child.py")


class MmgError(InputError):
    """Mmg is not installed, fails, or takes too long."""


def run_mmg(
    body: dict[str, np.ndarray], seconds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and tetrahedra (e, 4) that Mmg makes of a body.

    Args:
        body: Its `nodes` (n, 3) and `tets` (e, 4), and either
            `level` (n,): cells are cut where it is zero;
            `size` (n,) [m]: of the new elements' edges, with `gradation`,
            the largest ratio of neighbouring ones.
        seconds: Of processor time.

    Raises:
        MmgError: There is no mesh.
    """
    whole = io.BytesIO()
    np.savez(whole, **body)
    run = subprocess.run(
        [sys.executable, str(_CHILD), str(seconds)],
        input=whole.getvalue(),
        capture_output=True,
        check=False,
    )
    if run.returncode != 0:
        said = first_line(run.stderr.decode(errors="replace"))
        raise MmgError(
            said if run.returncode == 1 and said
            else f"Mmg ended with code {run.returncode}"
        )  # fmt: skip
    try:
        with np.load(io.BytesIO(run.stdout)) as got:
            return got["nodes"], got["tets"]
    except (BadZipFile, ValueError, OSError, EOFError):
        raise MmgError("Mmg gave no mesh") from None
