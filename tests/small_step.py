"""A short step from heel to toe, as the file that holds a sole's load."""

from pathlib import Path

import numpy as np


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
