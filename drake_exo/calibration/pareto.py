"""Pareto front of Phase A: kinematics against forces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drake_exo.calibration.foot_ground import FootGroundProblem
from drake_exo.calibration.problem import PhaseResult
from drake_exo.calibration.scores import rmsd
from drake_exo.files.output import Progress
from drake_exo.report.figures import front_figure
from drake_exo.report.tables import format_table


def pareto_front(out: Path, inputs, result: PhaseResult) -> list[dict]:
    """Calibrate again with the noise of forces scaled by factors.

    Prints a table, draws `front.png`.

    Args:
        out: folder for the figure.
        inputs: CalibrationInputs.
        result: of the settings as they stand.

    Returns:
        One row for each factor: mean and worst RMSD of each kind.
    """
    settings = result.settings
    rows = []
    factors = sorted({1.0, *settings.front})
    progress = Progress("front", total=len(factors))
    for i, factor in enumerate(factors):
        found = result
        if factor != 1.0:
            noise = replace(
                settings.noise,
                force_n=factor * settings.noise.force_n,
                cop_m=factor * settings.noise.cop_m,
            )
            found = FootGroundProblem(
                inputs.tree,
                inputs.trials,
                inputs.parameters,
                replace(settings, noise=noise),
            ).solve()
        rows.append(_front_row(factor, found, inputs.trials))
        progress.update(f"factor {factor:g}", done=i + 1)
    header = [
        "noise of forces ×",
        "angles [deg]",
        "worst",
        "velocities [deg/s]",
        "worst",
        "GRF [N]",
        "worst",
        "CoP [mm]",
        "worst",
    ]
    keys = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")
    print("Pareto front of kinematics against forces")
    print(
        format_table(
            header,
            [
                [
                    f"{r['factor']:g}" + ("" if r["success"] else " (failed)"),
                    *(r[k + e] for k in keys for e in ("", "_worst")),
                ]
                for r in rows
            ],
        )
    )
    front_figure(out / "front.png", rows)
    return rows


def _front_row(factor, found, trials) -> dict:
    scores = [
        rmsd(t, trial)
        for t, trial in zip(found.trajectories, trials, strict=True)
    ]
    row = {"factor": factor, "success": found.solution.success}
    for key in ("angles_deg", "velocities_deg_s", "grf_n"):
        values = [v for s in scores for v in s[key].values()]
        row[key] = float(np.mean(values))
        row[key + "_worst"] = float(np.max(values))
    cop = [s["cop_mm"] for s in scores]
    row["cop_mm"], row["cop_mm_worst"] = float(np.mean(cop)), max(cop)
    return row
