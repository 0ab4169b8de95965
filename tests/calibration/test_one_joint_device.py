"""Phases B and C with a device that has one joint and one cuff."""

from dataclasses import replace
from pathlib import Path

import pytest

from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.model.assembly import Assembly, CuffLinks, DeviceFile
from drake_exo.model.description import models_path, nominal_human
from drake_exo.model.device_file import with_text
from drake_exo.model.plant import Model
from drake_exo.virtual_laboratory.synthetic import rises_in_device

HIP = Assembly(
    device=DeviceFile({"belt": "pelvis"}, Path("hip_only.urdf")),
    cuffs={"strap": CuffLinks("thigh", "bar")},
)


@pytest.mark.slow
def test_a_hip_belt_is_calibrated_and_predicted():
    model = Model(with_text(HIP, models_path()), nominal_human())
    made = rises_in_device(2, 50.0, model=model)
    assert [list(trial.cuffs) for trial in made.trials] == [["strap"]] * 2
    found = made.calibration(made.exact_settings()).solve()
    assert found.success
    true = made.contact.values()
    for p in found.parameters:
        if p.name == "strap.normal_stiffness":
            assert p.nominal == pytest.approx(true[p.name], rel=0.05)
    # A light bar tells little of the others, but not their force.
    force = found.trials[0].cuff("strap").normal
    measured = made.trials[0].sample(found.trials[0].times).cuff("strap")
    assert abs(force - measured.normal).max() < 0.1
    # Where a light bar goes, jerk must not decide.
    noise = replace(PredictionSettings().noise, jerk=200.0)
    settings = PredictionSettings(noise=noise, solver=Solver(50.0))
    problem = made.prediction(settings, made.trials[1], found.contact)
    predicted = problem.solve()
    assert predicted.success
    moved = predicted.trials[0].coordinate("motor")
    true = made.trials[1].sample(predicted.trials[0].times).coordinate("motor")
    assert abs(moved - true).max() < 0.01
