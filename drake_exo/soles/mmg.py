"""Mmg (Dapogny, Dobrzynski, Frey, J. Comput. Phys. 262, 2014) on arrays.

In a process of its own, this module run as a script, since there are bodies
that it runs on without end about. Arrays go through stdin and stdout as .npz.
"""

import io
import subprocess
import sys
from zipfile import BadZipFile

import numpy as np

from drake_exo.errors import InputError, first_line


class MmgError(InputError):
    """Mmg is not installed, fails, or takes too long."""


def run_mmg(
    body: dict[str, np.ndarray], seconds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and tetrahedra (e, 4) that Mmg makes of a body.

    Args:
        body: Its `nodes` (n, 3) and `tets` (e, 4), and either
            `level` (n,): cells are cut where it is zero, with `step` [m],
            their size;
            `size` (n,) [m]: of the new elements' edges, with `gradation`,
            the largest ratio of neighbouring ones.
        seconds: Of processor time.

    Raises:
        MmgError: There is no mesh.
    """
    whole = io.BytesIO()
    np.savez(whole, **body)
    run = subprocess.run(
        [sys.executable, "-m", __name__, str(seconds)],
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


def _remeshed(body) -> dict[str, np.ndarray]:
    """What Mmg itself makes of `run_mmg`'s body."""
    from mmgpy import MmgMesh3D

    mesh = MmgMesh3D()
    counts = {"vertices": len(body["nodes"]), "tetrahedra": len(body["tets"])}
    mesh.set_mesh_size(**counts)
    mesh.set_vertices(body["nodes"], None)
    mesh.set_tetrahedra(body["tets"].astype(np.int32), None)
    if "level" in body:
        step = float(body["step"])
        mesh.remesh_levelset(
            body["level"][:, None],
            hmax=1.3 * step, hmin=0.5 * step, hausd=0.1 * step, verbose=-1,
        )  # fmt: skip
        # Mmg's reference of cells below zero.
        inside = mesh.get_tetrahedra_with_refs()[1] == 3
        return {"nodes": mesh.get_vertices(),
                "tets": mesh.get_tetrahedra()[inside]}  # fmt: skip
    mesh.set_field("metric", body["size"][:, None])
    typical = float(np.median(body["size"]))
    gradation = float(body["gradation"])
    mesh.remesh(hgrad=gradation, hausd=0.1 * typical, verbose=-1)
    return {"nodes": mesh.get_vertices(), "tets": mesh.get_tetrahedra()}


if __name__ == "__main__":
    import os
    import resource

    # What libraries print must not get between the arrays.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    longest = int(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_CPU, (longest, longest))
    try:
        found = _remeshed(np.load(io.BytesIO(sys.stdin.buffer.read())))
    except ImportError:
        sys.exit("mmgpy is not installed (pip install mmgpy)")
    except Exception as error:  # whatever Mmg makes of it
        sys.exit(f"Mmg: {error}")
    whole = io.BytesIO()
    np.savez(whole, **found)
    out.write(whole.getvalue())
    out.close()
