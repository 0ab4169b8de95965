"""Phases A and C of a real walk: both legs, toes hinged."""

from pathlib import Path

import numpy as np
import pytest

from drake_exo.calibration.audit import audit
from drake_exo.calibration.foot_ground import FootGroundCalibration
from drake_exo.calibration.problem import measured_feet
from drake_exo.calibration.scores import rmsd
from drake_exo.calibration.start import settled
from drake_exo.study import read_study

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def study(data_root):
    path = Path(__file__).parents[1] / "studies" / "opencap_walking.yaml"
    return read_study(path, data_root)


@pytest.fixture(scope="module")
def calibrated(study):
    trials = study.trials("calibration")
    return FootGroundCalibration(study.model, trials, study.foot_ground).solve()


def test_a_start_stands_on_its_feet(study):
    trials = study.trials()
    problem = FootGroundCalibration(study.model, trials, study.foot_ground)
    for movement, trial in zip(problem.movements, trials, strict=True):
        at = trial.sample(movement.grid.times)
        start = settled(problem, movement, at, problem.contact)
        for side, bodies in problem.feet.items():
            force = sum(start.ground[body] for body in bodies)
            off = force - at.feet[side].array
            assert np.sqrt(np.mean(off**2, axis=0)).max() < 50.0
            foot = measured_feet(movement, at)[f"foot_{side}"]
            tie = movement.ties[f"foot_{side}"]
            moved = tie.poses(start.q, start.v)[:, :3] - foot[:, :3]
            assert np.abs(moved[:, :2]).max() < 0.05


def test_both_feet_are_calibrated(calibrated):
    assert calibrated.success
    assert calibrated.solution.iterations <= 80
    found, measured = calibrated.trials[0], calibrated.problem.trials[0]
    off = rmsd(found, measured, loads=False)
    assert max(off["angles_deg"].values()) < 1.5
    for side in ("left", "right"):
        assert off["cop_mm"][side] < 7.0
        assert off["grf_n"][f"vertical {side}"] < 17.0
        assert off["grf_n"][f"horizontal {side}"] < 10.0


def test_it_simulates(calibrated):
    """LeafSystems under four segments, by an integrator of its own."""
    found = audit(calibrated)
    assert max(found.simulated_grf_n) < 1.0
    assert found.simulated_angles_deg < 0.05
