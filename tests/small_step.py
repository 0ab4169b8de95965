"""A short step from heel to toe and a small sole that takes it, as files."""

from pathlib import Path

import numpy as np
import yaml

from drake_exo import cli


def write_step(
    path: Path, samples: int, step_s: float = 0.1, least_n: float = 200.0
) -> None:
    """Write force and ZMP: from the heel to the toe, pushed back, then on."""
    rows = ["time_s,force_x_n,force_y_n,force_z_n,zmp_x_m,zmp_y_m"]
    for k, s in enumerate(np.linspace(0, 1, samples)):
        rows.append(
            f"{step_s * k},{20 - 40 * s},0,{least_n + 300 * s * (1 - s)},"
            f"{-0.07 + 0.12 * s},0.02"
        )
    path.write_text("\n".join(rows))


def write_case(
    path: Path,
    name: str = "small",
    divisions: tuple = (4, 3, 2),
    element: str = "linear",
    **optimize,
) -> None:
    """Write the case of a neoprene brick; `load.csv` beside it is its step.

    `optimize` are the keys of the case's block of that name.
    """
    size = [0.23, 0.13, 0.03]
    case = {
        "name": name,
        "mesh": {
            "brick": {"size_m": size, "divisions": divisions},
            "element": element,
        },
        "material": {"name": "neoprene"},
        "load": {"csv": {"file": "load.csv"}},
        "optimize": {"starts": 1} | optimize,
    }
    path.write_text(yaml.safe_dump(case, sort_keys=False))


def stage(samples: int, layer_m: float, iterations: int) -> dict:
    """One stage of an optimisation, as `write_case` takes it."""
    return {
        "samples": samples,
        "layer_m": layer_m,
        "kappa": 0.2,
        "iterations": iterations,
    }


def optimize(case: Path, out: Path, *more) -> int:
    """`drake-exo sole optimize` with more arguments; its exit code."""
    return cli.main(
        ["sole", "optimize", str(case), "--out", str(out), *map(str, more)]
    )
