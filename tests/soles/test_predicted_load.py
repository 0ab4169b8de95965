"""From a prediction of the exoskeleton half to a simulated sole."""

import json

import numpy as np
import pytest

from drake_exo import cli
from drake_exo.calibration.results import write_trial
from drake_exo.errors import InputError
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.coordinates import Coordinates
from drake_exo.soles.load_blocks import Prediction

CASE = """
name: rise
mesh:
  brick: {size_m: [0.26, 0.11, 0.03], divisions: [6, 4, 2]}
material: {name: neoprene}
load:
  prediction:
    file: rise_ground_reaction.sto
    origin_m: [0.07, 0.0]
    least_force_n: 50.0
"""
COUNT = 40


@pytest.fixture
def folder(tmp_path):
    """What `drake-exo predict` leaves of a rise that ends in the air."""
    write_rise(tmp_path, np.linspace(0.0, 1.5, COUNT))
    (tmp_path / "case.yaml").write_text(CASE)
    return tmp_path


def write_rise(folder, t):
    up = 600 + 100 * np.sin(4 * t)
    up[-5:] = [90, 60, 20, 5, 0]  # both feet
    cop = 0.05 + 0.03 * t
    names = Coordinates(("foot_x", "foot_z", "foot_pitch", "ankle"))
    still, ground = np.zeros((len(t), 4)), np.column_stack([0.05 * up, up])
    wrench = PlanarWrench(ground, -cop * up)
    moments = np.zeros((len(t), 1))
    write_trial(
        folder,
        Trial("rise", names, t, still, still, still, wrench, moments=moments),
    )


def _read(folder, name, **more):
    return Prediction(name, (0.0, 0.0), **more).load(folder)


def test_half_the_ground_reaction_bears_on_one_foot(folder):
    load = _read(folder, "rise_ground_reaction.sto")
    assert len(load.times) == COUNT - 3  # below 20 N on one foot left out
    np.testing.assert_allclose(load.force[0], [15.0, 0.0, 300.0], rtol=1e-6)
    np.testing.assert_allclose(
        load.zmp[:, 0], 0.05 + 0.03 * load.times, rtol=1e-6
    )
    assert np.abs(load.zmp[:, 1]).max() == 0.0
    assert np.abs(load.force[:, 1]).max() == 0.0


def test_a_grid_that_is_finer_in_places_is_sampled_evenly(folder):
    t = np.linspace(0.0, 1.5, COUNT)
    write_rise(folder, np.sort([*t, *0.5 * (t[9:20] + t[10:21])]))
    load = _read(folder, "rise_ground_reaction.sto")
    np.testing.assert_allclose(np.diff(load.times), 1.5 / 39, rtol=1e-6)
    up = 600 + 100 * np.sin(4 * load.times)
    np.testing.assert_allclose(load.force[:30, 2], 0.5 * up[:30], rtol=1e-6)
    path = folder / "rise_ground_reaction.sto"
    write_rise(folder, np.array([*(1e-6 * t), 9.0]))  # one time is damaged
    with pytest.raises(InputError, match="s apart over 9 s, more than"):
        _read(folder, path.name)
    head = path.read_text().splitlines()
    rows = head.index("endheader") + 3
    text = "\n".join(x for x in head[:rows] if "nRows" not in x)
    path.write_text(text)
    with pytest.raises(InputError, match="holds one row"):
        _read(folder, path.name)


@pytest.mark.slow
def test_a_sole_is_simulated_under_a_prediction(folder):
    out = folder / "out"
    code = cli.main(
        ["sole", "simulate", str(folder / "case.yaml"), "--out", str(out)]
    )
    assert code == 0
    numbers = json.loads((out / "summary.json").read_text())
    assert numbers["steps"] == COUNT - 5  # 45 N on one foot are below 50 N
    assert numbers["failed_steps"] == 0
    with np.load(out / "history.npz") as history:
        F, P = history["force_W"], history["place_W"]
    np.testing.assert_allclose(F.sum(axis=1)[0], [15.0, 0.0, 300.0], atol=1e-6)
    centre = (F[:, :, 2] * P[:, :, 0]).sum(axis=1) / F[:, :, 2].sum(axis=1)
    load = _read(folder, "rise_ground_reaction.sto", least_force_n=50.0)
    np.testing.assert_allclose(centre, load.zmp[:, 0] - 0.07, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.sto", "x\ntime a\n0 1\n", "endheader"),
        ("a.sto", "x\nendheader\ntime a\n0 1\n", "ground_force_vx"),
    ],
)
def test_other_tables_are_refused(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        _read(tmp_path, name)


def test_an_unloaded_foot_is_refused(folder):
    with pytest.raises(InputError, match="never carries 900"):
        _read(folder, "rise_ground_reaction.sto", least_force_n=900.0)
