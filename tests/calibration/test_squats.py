"""The study of real squats, on a coarse grid: calibrated, and predicted."""

from dataclasses import replace
from pathlib import Path

import pytest

from drake_exo.calibration.audit import rmsd
from drake_exo.calibration.phases import (
    FootGroundCalibration,
    PredictionProblem,
)
from drake_exo.study import read_study

pytestmark = pytest.mark.slow


def coarse(settings):
    return replace(
        settings, solver=replace(settings.solver, nodes_per_second=20.0)
    )


def test_one_squat_predicts_the_next(data_root):
    path = Path(__file__).parents[1] / "studies" / "opencap_squats1.yaml"
    study = read_study(path, data_root)
    calibrated = FootGroundCalibration(
        study.model, study.trials("calibration"), coarse(study.foot_ground)
    ).solve()
    predicted = PredictionProblem(
        study.model,
        study.trials("prediction"),
        calibrated.contact,
        coarse(study.prediction),
    ).solve()
    # Squats are slow: what is allowed of a walk is seldom used.
    for result, angle, vertical, horizontal, cop in (
        (calibrated, 2.0, 6.0, 3.0, 1.0),
        (predicted, 4.0, 0.05 * study.model.tree.weight, 6.0, 3.0),
    ):
        assert result.success
        off = rmsd(result.trials[0], result.problem.trials[0], loads=False)
        assert max(off["angles_deg"].values()) < angle
        for side in ("left", "right"):
            assert off["grf_n"][f"vertical {side}"] < vertical
            assert off["grf_n"][f"horizontal {side}"] < horizontal
            assert off["cop_mm"][side] < cop
