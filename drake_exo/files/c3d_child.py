"""Decode one C3D file with ezc3d: `python c3d_child.py FILE`.

Runs in a process of its own, since damaged files make ezc3d crash, hang or
exhaust the memory. Writes an .npz to stdout: points, analogs, rates, each
parameter as `parameter_i`, and `names`, JSON of each one's group and name.
If ezc3d refuses the file, exits with code 1 and the reason on stderr.
"""

import io
import json
import os
import resource
import sys

_MOST_MEMORY = 4 << 30  # bytes
_MOST_SECONDS = 3  # of processor time, plus as many per megabyte

if __name__ == "__main__":
    # Whatever libraries print goes to stderr: stdout holds the arrays alone.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    longest = _MOST_SECONDS * (1 + (os.path.getsize(sys.argv[1]) >> 20))
    if sys.platform == "linux":  # macOS refuses such a bound
        resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (longest, longest))

    import ezc3d
    import numpy as np

    try:
        file = ezc3d.c3d(sys.argv[1])
    except Exception as error:  # damage may raise anything
        sys.exit(f"{error}")
    names, arrays = [], {}
    for group, entries in file["parameters"].items():
        for name, entry in entries.items():
            if isinstance(entry, dict) and "value" in entry:
                arrays[f"parameter_{len(names)}"] = np.array(entry["value"])
                names.append([group, name])
    head = file["header"]
    rates = [head[kind]["frame_rate"] for kind in ("points", "analogs")]
    whole = io.BytesIO()
    np.savez(
        whole,
        names=json.dumps(names),
        points=file["data"]["points"][:3].transpose(2, 1, 0),
        analogs=file["data"]["analogs"][0].T,
        rates=np.array(rates, float),
        **arrays,
    )
    out.write(whole.getvalue())
    out.close()
