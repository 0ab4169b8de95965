"""Results on disk: what one phase writes, the next one reads."""

import json
from dataclasses import replace

import numpy as np
import pytest

from drake_exo.calibration.audit import audit
from drake_exo.calibration.phases import PredictionProblem
from drake_exo.calibration.results import (
    Origin,
    read_calibration,
    read_contact,
    read_model,
    read_trial,
    write_contact,
    write_model,
    write_trial,
)
from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.contact.parameters import ContactModel, Posterior
from drake_exo.errors import InputError
from drake_exo.files.opensim import read_plates
from drake_exo.files.output import Check, Verdict, read_json
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial


@pytest.fixture
def read_back(in_device, tmp_path):
    """The contact after a round through a file."""
    write_contact(tmp_path, in_device.contact)
    return read_calibration(tmp_path).contact


def test_contact_survives_disk(in_device, read_back):
    contact = in_device.contact
    assert read_back == contact
    assert read_back.values() == contact.values()
    assert read_back.units() == contact.units()


def test_what_is_known_of_a_contact_survives_disk(in_device, tmp_path):
    names = ("thigh.normal_stiffness", "encoder.exo_hip")
    known = Posterior(names, np.array([5e3, 0.1]), np.diag([1.0, 1.0 / 3.0]))
    contact = replace(in_device.contact, posterior=known)
    write_contact(tmp_path, contact)
    assert read_calibration(tmp_path).contact == contact
    wider = replace(known, covariance=2.0 * known.covariance)
    assert replace(contact, posterior=wider) != contact != in_device.contact
    assert "covariance" not in repr(contact)


def test_preload_of_a_strap_survives_disk(in_device, tmp_path):
    bushings = dict(in_device.contact.bushings)
    bushings["thigh"] = replace(bushings["thigh"], preload_x=0.004)
    strapped = replace(in_device.contact, bushings=bushings)
    write_contact(tmp_path, strapped)
    assert read_calibration(tmp_path).contact == strapped


def test_a_cuff_that_cannot_be_is_told_with_its_file(in_device, tmp_path):
    """It was told only by the solve, which does not know the file."""
    bushings = dict(in_device.contact.bushings)
    bushings["thigh"] = replace(bushings["thigh"], normal_stiffness=-1.0)
    write_contact(tmp_path, replace(in_device.contact, bushings=bushings))
    with pytest.raises(InputError, match=r"\.json.*thigh: normal_stiffness"):
        read_calibration(tmp_path)


def test_ground_contact_alone_survives_disk(in_device, tmp_path):
    ground = ContactModel(in_device.contact.ground, jerk=21.0)
    write_contact(tmp_path, ground)
    assert read_calibration(tmp_path).contact == ground


@pytest.mark.slow
def test_cuffs_are_in_the_models_order(in_device, read_back, tmp_path):
    """The file's keys are sorted, the model's cuffs go up the leg."""
    names = list(read_json(tmp_path / "parameters.json", "")["parameters"])
    assert names == sorted(names)
    problem = in_device.prediction(
        PredictionSettings(), in_device.trials[0], read_back
    )
    model = list(in_device.model.cuffs)
    assert model != sorted(model)
    assert list(problem.contact.bushings) == model
    assert list(problem.movements[0].cuffs) == model


@pytest.mark.slow
def test_audit_simulates_the_prediction(in_device, read_back):
    """Also with the contact from a file, whose cuffs are in another order."""
    settings = PredictionSettings(solver=Solver(50.0))
    trial = in_device.trials[0]
    result = in_device.prediction(settings, trial, read_back).solve()
    assert result.success
    assert audit(result).simulated_interaction_n < 0.1


def sphere(contact, old, new):
    spheres = dict(contact.ground.spheres)
    spheres[new] = spheres.pop(old)
    return replace(contact, ground=replace(contact.ground, spheres=spheres))


def cuff(contact, old, new):
    bushings = dict(contact.bushings)
    bushings[new] = bushings.pop(old)
    return replace(contact, bushings=bushings)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: sphere(c, "toe", "midfoot"), "midfoot.*heel, toe"),
        (lambda c: sphere(c, "toe", "heel"), "only the sphere heel to roll"),
        (lambda c: cuff(c, "thigh", "trunk"), "trunk, not .* thigh; calib"),
        (lambda c: ContactModel(c.ground), "interaction parameters"),
    ],
)
def test_contact_of_another_model_is_refused(change, words, in_device):
    made = in_device
    with pytest.raises(InputError, match=words) as error:
        PredictionProblem(made.model, made.trials[:1], change(made.contact))
    assert "\n" not in str(error.value)


def test_model_and_trials_survive_disk(in_device, predicted, tmp_path):
    write_model(tmp_path, in_device.model)
    assert read_model(tmp_path) == in_device.model
    (found,) = predicted.trials
    write_trial(tmp_path, found)
    back = read_trial(tmp_path, found.name)
    assert (back.name, back.source) == (found.name, "solved")
    assert list(back.cuffs) == list(found.cuffs)
    for cuff, force in found.cuffs.items():
        np.testing.assert_array_equal(
            back.cuffs[cuff].components, force.components
        )
    for name in ("times", "q", "v", "a", "moments", "jerk"):
        np.testing.assert_array_equal(getattr(back, name), getattr(found, name))


def test_a_light_foots_moment_is_in_its_table(predicted, tmp_path):
    """Below 20 N there is no centre of pressure, but a free moment."""
    (found,) = predicted.trials
    loaded = found.ground.array
    for share in (1.0, 0.02):
        light = replace(found, ground=PlanarWrench.of(share * loaded))
        write_trial(tmp_path, light)
        path = tmp_path / f"{found.name}_ground_reaction.sto"
        _, plates = read_plates(path)
        (plate,) = plates.values()
        moment = -plate.moment_about_origin()[:, 2]
        np.testing.assert_allclose(moment, share * loaded[:, 2], atol=1e-6)
        np.testing.assert_allclose(
            plate.force[:, :2], share * loaded[:, :2], atol=1e-6
        )


_HELD = Verdict((Check("solved", True),))
_FAILED = Verdict((Check("solved", True), Check("audit", False, 2.0, 1.0)))


def _stored(in_device, folder, verdict=_HELD):
    origin = Origin.of("one", in_device.model, in_device.trials, verdict)
    write_contact(folder, in_device.contact, origin)
    return read_calibration(folder)


def _failing(found, in_device, subject="one", model=None, law="simbody", of=()):
    checks = found.checks(subject, model or in_device.model, law, of)
    return [c.name for c in checks if not c.holds]


def test_a_calibration_that_holds_is_used(in_device, tmp_path):
    found = _stored(in_device, tmp_path)
    assert _failing(found, in_device) == []
    assert read_contact(tmp_path) == in_device.contact


@pytest.mark.parametrize(
    "verdict", [_FAILED, Verdict((Check("solved", False),))]
)
def test_a_calibration_that_fails_is_refused(in_device, tmp_path, verdict):
    found = _stored(in_device, tmp_path, verdict)
    assert _failing(found, in_device) == ["provenance.calibration"]
    with pytest.raises(InputError, match=verdict.failing[0].name):
        read_contact(tmp_path)
    assert read_contact(tmp_path, ["provenance"]) == in_device.contact


def test_an_accepted_failure_stays_one(in_device, tmp_path):
    verdict = Verdict(_FAILED.checks, ("audit",))
    _stored(in_device, tmp_path, verdict)
    said = r"not hold \(audit\).*in Python \['provenance.calibration'\]"
    with pytest.raises(InputError, match=said):
        read_contact(tmp_path)


def test_parameters_of_unknown_origin_are_refused(in_device, tmp_path):
    write_contact(tmp_path, in_device.contact)
    found = read_calibration(tmp_path)
    assert _failing(found, in_device) == ["provenance.calibration"]
    with pytest.raises(InputError, match="not known"):
        read_contact(tmp_path)


def test_a_calibration_of_another_is_told(in_device, tmp_path):
    found = _stored(in_device, tmp_path)
    other = replace(
        in_device.model,
        human=replace(
            in_device.model.human,
            thigh=replace(
                in_device.model.human.thigh,
                mass_kg=1.01 * in_device.model.human.thigh.mass_kg,
            ),
        ),
    )
    assert _failing(found, in_device, subject="two") == ["provenance.subject"]
    assert _failing(found, in_device, model=other) == ["provenance.model"]
    assert _failing(found, in_device, law="paper") == ["provenance.law"]
    own = in_device.trials[:1]
    assert _failing(found, in_device, of=own) == ["provenance.unseen"]
    (note,) = (
        c
        for c in found.checks("one", in_device.model, "simbody", own)
        if not c.holds
    )
    assert note.level == "note"
    moved = replace(own[0], q=own[0].q + 0.01)
    assert _failing(found, in_device, of=[moved]) == []


def test_parameters_in_another_unit_are_refused(in_device, tmp_path):
    _stored(in_device, tmp_path)
    path = tmp_path / "parameters.json"
    found = json.loads(path.read_text())
    name = next(n for n, unit in found["units"].items() if unit == "N/m")
    found["units"][name] = "kN/m"
    path.write_text(json.dumps(found))
    with pytest.raises(
        InputError, match=rf"units: {name} is in 'kN/m', but is read in 'N/m'"
    ):
        read_calibration(tmp_path)


def test_recordings_read_in_another_way_are_told(in_device, tmp_path):
    found = _stored(in_device, tmp_path)

    def read(trial, lag_s=0.0, cutoff_hz=6.0, clocks=()):
        said = {"kind": "Butterworth, zero lag", "cutoff_hz": cutoff_hz}
        provenance = {"filter": said, "force_delay_s": lag_s}
        provenance["clocks"] = dict.fromkeys(clocks, "estimated")
        moved = replace(trial, q=trial.q + 0.01)
        ground = PlanarWrench.of(1.01 * trial.ground.array)
        return replace(moved, ground=ground, provenance=provenance)

    first, *_ = in_device.trials
    replace(first, provenance=read(first).provenance).save(
        tmp_path / f"measured_{first.name}"
    )
    for same in ({}, {"lag_s": 0.003, "clocks": ["forces"]}):
        assert _failing(found, in_device, of=[read(first, **same)]) == []
    unknown = replace(read(first), provenance={})
    assert _failing(found, in_device, of=[unknown]) == []
    (note,) = (
        c
        for c in found.checks(
            "one", in_device.model, "simbody", [read(first, 0.02, 10.0)]
        )
        if not c.holds
    )
    assert (note.name, note.level) == ("provenance.settings", "note")
    assert note.sentence == (
        "it was calibrated on recordings read with filter.cutoff_hz 6.0, "
        "laboratory.force_delay_s 0.0, but the study has filter.cutoff_hz "
        "10.0, laboratory.force_delay_s 0.02"
    )


def test_a_part_of_a_calibration_trial_is_not_unseen(in_device, tmp_path):
    """Cut elsewhere from one recording; what both see unloaded is no part."""
    found = _stored(in_device, tmp_path)
    seen = in_device.trials[0]
    part, other = (
        Trial(
            "part",
            seen.coordinates,
            seen.times[:-20],
            *(x[20:] for x in (seen.q, seen.v, seen.a)),
            PlanarWrench.of(force),
        )
        for force in (seen.ground.array[20:], 1.01 * seen.ground.array[20:])
    )
    assert _failing(found, in_device, of=[part]) == []  # as nobody can tell
    force = np.vstack([np.zeros((1, 3)), seen.ground.array[1:]])
    replace(seen, ground=PlanarWrench.of(force)).save(
        tmp_path / f"measured_{seen.name}"
    )
    assert _failing(found, in_device, of=[part]) == ["provenance.unseen"]
    idle = replace(other, ground=PlanarWrench.of(0.0 * other.ground.array))
    assert _failing(found, in_device, of=[other, idle]) == []
