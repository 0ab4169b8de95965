"""Meshes one body anew with Mmg: `python mmg_child.py SECONDS`.

In a process of its own, since there are bodies that Mmg runs on without end
about. Reads an .npz from stdin: nodes, tets, triangles and their references,
sharp edges, corners, sizes at the nodes (none for the sizes there are),
whether to keep the surface, the distance from it that is allowed. Writes
nodes, tets, triangles, references and the nodes on sharp edges to stdout.
Exit code 1 and a reason on stderr where Mmg refuses.
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
        edges=len(body["edges"]),
    )
    mesh.set_vertices(body["nodes"], None)
    mesh.set_tetrahedra(body["tets"].astype(np.int32), None)
    mesh.set_triangles(body["triangles"].astype(np.int32), body["references"])
    sharp = np.arange(len(body["edges"]), dtype=np.int32)
    mesh.set_edges(body["edges"].astype(np.int32), np.ones(len(sharp), int))
    mesh.set_ridge_edges(sharp)
    corners = body["corners"].astype(np.int32)
    mesh.set_corners(corners)
    mesh.set_required_vertices(corners)
    # angle=0: no sharp edges but those given.
    options = {"angle": 0, "verbose": -1, "hausd": float(body["distance"])}
    if len(body["sizes"]):
        mesh["metric"] = body["sizes"][:, None]
    else:
        options["optim"] = 1
    if body["keep_surface"]:
        options["nosurf"] = 1
    try:
        mesh.remesh(**options)
    except Exception as error:  # whatever Mmg makes of it
        sys.exit(f"Mmg: {error}")
    triangles, references = mesh.get_triangles_with_refs()
    edges, kind = mesh.get_edges_with_refs()
    whole = io.BytesIO()
    np.savez(
        whole,
        nodes=mesh.get_vertices(),
        tets=mesh.get_tetrahedra(),
        triangles=triangles,
        references=references,
        sharp=np.unique(edges[kind == 1]),
    )
    out.write(whole.getvalue())
    out.close()
