"""Meshes the inside of one body anew with Mmg: `python mmg_child.py SECONDS`.

In a process of its own, since there are bodies that Mmg runs on without end
about. Reads an .npz from stdin: nodes, tets and the surface's triangles, which
are kept. Writes nodes and tets to stdout. Exit code 1 and a reason on stderr
where Mmg refuses.
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
    mesh.set_mesh_size(
        vertices=len(body["nodes"]),
        tetrahedra=len(body["tets"]),
        triangles=len(body["triangles"]),
    )
    mesh.set_vertices(body["nodes"], None)
    mesh.set_tetrahedra(body["tets"].astype(np.int32), None)
    mesh.set_triangles(body["triangles"].astype(np.int32), None)
    try:
        mesh.remesh(nosurf=1, optim=1, verbose=-1)
    except Exception as error:  # whatever Mmg makes of it
        sys.exit(f"Mmg: {error}")
    whole = io.BytesIO()
    np.savez(whole, nodes=mesh.get_vertices(), tets=mesh.get_tetrahedra())
    out.write(whole.getvalue())
    out.close()
