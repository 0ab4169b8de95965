"""Pareto front of Phase A: kinematics against forces."""

from dataclasses import replace

import numpy as np

from drake_exo.calibration.foot_ground import FootGroundCalibration
from drake_exo.calibration.problem import PhaseResult
from drake_exo.calibration.scores import rmsd
from drake_exo.files.output import Progress

KINDS = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")


def pareto_front(result: PhaseResult) -> list[dict]:
    """Calibrate again with the noise of forces scaled by factors.

    Args:
        result: of Phase A with the settings as they stand, which name the
            factors.

    Returns:
        One row for each factor: factor, success, and of each of KINDS the
        mean and the worst RMSD.
    """
    problem = result.problem
    settings, noise = problem.settings, problem.settings.noise
    rows = []
    factors = sorted({1.0, *settings.front})
    progress = Progress("front", total=len(factors))
    for i, factor in enumerate(factors):
        found = result
        if factor != 1.0:
            scaled = replace(
                noise,
                force_n=factor * noise.force_n,
                cop_m=factor * noise.cop_m,
            )
            found = FootGroundCalibration(
                problem.model,
                problem.trials,
                replace(settings, noise=scaled),
                problem.parameters,
            ).solve()
        rows.append(_row(factor, found))
        progress.update(f"factor {factor:g}", done=i + 1)
    return rows


def _row(factor: float, found: PhaseResult) -> dict:
    scores = [
        rmsd(t, measured)
        for t, measured in zip(found.trials, found.problem.trials, strict=True)
    ]
    row = {"factor": factor, "success": found.success}
    for kind in KINDS:
        values = np.hstack(
            [
                list(s[kind].values()) if isinstance(s[kind], dict) else s[kind]
                for s in scores
            ]
        )
        row[kind] = float(np.mean(values))
        row[f"{kind}_worst"] = float(np.max(values))
    return row
