"""Results on disk: what one phase writes, the next one reads."""

from dataclasses import replace

import numpy as np
import pytest

from drake_exo.calibration.audit import audit
from drake_exo.calibration.prediction import PredictionProblem
from drake_exo.calibration.results import (
    read_contact,
    read_model,
    read_trial,
    write_contact,
    write_model,
    write_trial,
)
from drake_exo.calibration.settings import PredictionSettings, Solver
from drake_exo.contact.parameters import ContactModel
from drake_exo.errors import InputError
from drake_exo.files.output import read_json


@pytest.fixture
def read_back(in_device, tmp_path):
    """The contact after a round through a file."""
    write_contact(tmp_path, in_device.contact)
    return read_contact(tmp_path)


def test_contact_survives_disk(in_device, read_back):
    contact = in_device.contact
    assert read_back == contact
    assert read_back.values() == contact.values()
    assert read_back.units() == contact.units()


def test_preload_of_a_strap_survives_disk(in_device, tmp_path):
    bushings = dict(in_device.contact.bushings)
    bushings["thigh"] = replace(bushings["thigh"], preload_x=0.004)
    strapped = replace(in_device.contact, bushings=bushings)
    write_contact(tmp_path, strapped)
    assert read_contact(tmp_path) == strapped


def test_ground_contact_alone_survives_disk(in_device, tmp_path):
    ground = ContactModel(in_device.contact.ground)
    write_contact(tmp_path, ground)
    assert read_contact(tmp_path) == ground


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
        (lambda c: cuff(c, "thigh", "trunk"), "interaction parameters"),
        (lambda c: ContactModel(c.ground), "interaction parameters"),
    ],
)
def test_contact_of_another_model_is_refused(change, words, in_device):
    made = in_device
    with pytest.raises(InputError, match=words) as error:
        PredictionProblem(made.model, made.trials[:1], change(made.contact))
    assert "\n" not in str(error.value)


def test_cuffs_are_refused_where_there_is_no_device(human, in_device):
    trial = in_device.trials[0]
    with pytest.raises(InputError) as error:
        PredictionProblem(human, [trial], in_device.contact)
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
