import json

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import RIGID_COORDINATES


@pytest.fixture
def trial():
    t = 1.0 + np.arange(51) / 100.0
    phase = np.arange(6) / 3.0
    angle = 2.0 * np.pi * t[:, None] + phase
    F_z = 300.0 + 290.0 * np.cos(2.0 * np.pi * t)
    return Trial(
        "rise1",
        RIGID_COORDINATES,
        t,
        np.sin(angle),
        2.0 * np.pi * np.cos(angle),
        -((2.0 * np.pi) ** 2) * np.sin(angle),
        np.column_stack([0.1 * F_z, F_z]),
        -0.1 * F_z,
        60.0,
        {"markers": "a.trc", "filter": {"cutoff_hz": 6.0}, "x": [1.5, None]},
    )


def test_survives_saving_without_loss(trial, tmp_path):
    trial.save(tmp_path / "rise1")
    found = Trial.load(tmp_path / "rise1")
    for name in ("time", "q", "v", "a", "grf", "moment_y"):
        np.testing.assert_array_equal(
            getattr(found, name), getattr(trial, name)
        )
    assert found.name == trial.name
    assert found.coordinates == trial.coordinates
    assert found.mass_kg == trial.mass_kg
    assert found.provenance == trial.provenance


def test_damaged_files_are_refused(trial, tmp_path):
    trial.save(tmp_path / "rise1")
    with pytest.raises(InputError, match=r"rise2\.npz: cannot be read"):
        Trial.load(tmp_path / "rise2")
    place = tmp_path / "rise1.npz"
    place.write_bytes(place.read_bytes()[:200])
    with pytest.raises(InputError, match=r"rise1\.npz: is damaged; save it"):
        Trial.load(tmp_path / "rise1")
    trial.save(tmp_path / "rise1")
    place = tmp_path / "rise1.json"
    place.write_text(json.dumps({"name": "rise1"}))
    with pytest.raises(InputError, match="holds no trial"):
        Trial.load(tmp_path / "rise1")


def test_saving_twice_gives_the_same_bytes(trial, tmp_path):
    for name in ("a", "b"):
        trial.save(tmp_path / name)
    for kind in ("npz", "json"):
        first, second = (tmp_path / f"{n}.{kind}" for n in "ab")
        assert first.read_bytes() == second.read_bytes()


def test_cop(trial):
    cop = trial.cop_x
    unloaded = trial.grf[:, 1] <= 20.0
    assert unloaded.any() and np.isnan(cop[unloaded]).all()
    np.testing.assert_allclose(cop[~unloaded], 0.1)


def test_window(trial):
    part = trial.window(1.1, 1.2)
    assert len(part.time) == 11
    assert part.time[[0, -1]] == pytest.approx([1.1, 1.2])
    np.testing.assert_array_equal(part.q, trial.q[10:21])
    np.testing.assert_array_equal(part.grf, trial.grf[10:21])
    with pytest.raises(InputError, match=r"rise1.*outside"):
        trial.window(3.0, 4.0)


def test_resampling_keeps_ends_and_shape(trial):
    fine = trial.resample(200.0)
    assert len(fine.time) == 101
    assert fine.time[[0, -1]] == pytest.approx(trial.time[[0, -1]])
    np.testing.assert_allclose(np.diff(fine.time), 0.005)
    np.testing.assert_allclose(fine.q[::2], trial.q, atol=1e-12)
    angle = 2.0 * np.pi * fine.time[:, None] + np.arange(6) / 3.0
    np.testing.assert_allclose(fine.q, np.sin(angle), atol=2e-6)
    np.testing.assert_allclose(fine.v, 2.0 * np.pi * np.cos(angle), atol=2e-5)
    assert trial.resample(1.0).time == pytest.approx([1.0, 1.5])


def test_shapes_are_checked(trial):
    with pytest.raises(ValueError, match="grf has shape"):
        Trial(
            "x",
            trial.coordinates,
            trial.time,
            trial.q,
            trial.v,
            trial.a,
            trial.grf[:, 0],
            trial.moment_y,
            60.0,
        )
