"""Mmg on one body: `python mmg_child.py SECONDS`.

Reads what `mmg.run_mmg` takes as an .npz from stdin; writes nodes and tets to
stdout. Exit code 1 and a reason on stderr where Mmg refuses.
"""

import io
import os
import resource
import sys

if __name__ == "__main__":
    # What libraries print must not get between the arrays.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    longest = int(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_CPU, (longest, longest))

    import numpy as np

    try:
        from mmgpy import MmgMesh3D
    except ImportError:
        sys.exit("mmgpy is not installed (pip install mmgpy)")
    body = np.load(io.BytesIO(sys.stdin.buffer.read()))
    mesh = MmgMesh3D()
    counts = {"vertices": len(body["nodes"]), "tetrahedra": len(body["tets"])}
    mesh.set_mesh_size(**counts)
    mesh.set_vertices(body["nodes"], None)
    mesh.set_tetrahedra(body["tets"].astype(np.int32), None)
    try:
        if "level" in body:
            step = float(body["step"])
            mesh.remesh_levelset(
                body["level"][:, None],
                hmax=1.3 * step, hmin=0.5 * step, hausd=0.1 * step, verbose=-1,
            )  # fmt: skip
        else:
            mesh.set_field("metric", body["size"][:, None])
            typical = float(np.median(body["size"]))
            mesh.remesh(
                hgrad=float(body["gradation"]), hausd=0.1 * typical,
                verbose=-1,
            )  # fmt: skip
    except Exception as error:  # whatever Mmg makes of it
        sys.exit(f"Mmg: {error}")
    whole = io.BytesIO()
    tets = mesh.get_tetrahedra()
    if "level" in body:
        # Mmg's reference of cells below zero.
        tets = tets[mesh.get_tetrahedra_with_refs()[1] == 3]
    np.savez(whole, nodes=mesh.get_vertices(), tets=tets)
    out.write(whole.getvalue())
    out.close()
