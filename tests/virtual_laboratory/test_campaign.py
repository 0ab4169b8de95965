"""A campaign is reproducible, obeys mechanics, and reads back as its truth."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import drake_exo
from drake_exo.cli import main
from drake_exo.errors import InputError
from drake_exo.laboratory.inverse_dynamics import inverse_dynamics
from drake_exo.laboratory.loading import load_trials
from drake_exo.laboratory.opensim_files import read_table
from drake_exo.laboratory.sagittal import PlanarWrench
from drake_exo.planar_tree import PlanarTree
from drake_exo.plant import build_plant
from drake_exo.study import load_study
from drake_exo.virtual_laboratory.campaign import write_campaign
from drake_exo.virtual_laboratory.instruments import plate_recording

SEED = 4


def written(folder: Path) -> dict[str, bytes]:
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    write_campaign(folder, SEED, disturbances=(), trials=1)
    return folder


@pytest.fixture(scope="module")
def truth(undisturbed):
    return read_table(undisturbed / "truth" / "rise1.sto")


@pytest.fixture(scope="module")
def read_back(undisturbed, tmp_path_factory):
    """The campaign as a calibration gets it: without its truth."""
    folder = tmp_path_factory.mktemp("handed_over")
    shutil.copytree(undisturbed, folder, dirs_exist_ok=True)
    shutil.rmtree(folder / "truth")
    study, root = load_study(folder / "study.yaml")
    subject, (trial,) = load_trials(study, root)
    return study, subject, trial


def at(truth, trial):
    return np.round((trial.time - truth.time[0]) * 100).astype(int)


def test_same_seed_same_bytes_through_the_command(tmp_path):
    for name in ("a", "b"):
        assert (
            main(
                [
                    "lab",
                    "--seed",
                    str(SEED),
                    "--trials",
                    "1",
                    "--out",
                    str(tmp_path / name),
                ]
            )
            == 0
        )
    first, second = (written(tmp_path / name) for name in ("a", "b"))
    assert first == second
    assert {"study.yaml", "truth/truth.json", "rise1.trc"} <= set(first)


def test_results_are_not_overwritten(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["lab", "--out", str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"disturbances": ["marker_nois"]}, "marker_noise"),
        ({"seed": -1}, "seed is -1"),
        ({"trials": 0}, "trials is 0"),
    ],
)
def test_bad_requests_are_refused(tmp_path, arguments, message):
    with pytest.raises(InputError, match=message):
        write_campaign(tmp_path, **{"seed": 0, **arguments})
    assert not list(tmp_path.iterdir())


def test_angles_and_places_are_read_back(read_back, truth):
    _, _, trial = read_back
    i = at(truth, trial)
    q = truth.columns(trial.coordinates)[i]
    error = np.sqrt(np.mean((trial.q - q) ** 2, axis=0))
    assert np.rad2deg(error[2:]).max() < 0.1
    assert error[:2].max() < 1e-4
    speeds = truth.columns([f"{c}_speed" for c in trial.coordinates])[i]
    error = np.sqrt(np.mean((trial.v - speeds) ** 2, axis=0))
    assert np.rad2deg(error[2:]).max() < 2.0
    # A rise, not a twitch.
    assert np.rad2deg(np.ptp(q[:, 4])) > 80.0


def test_forces_are_read_back(read_back, truth):
    _, _, trial = read_back
    i = at(truth, trial)
    names = ("ground_force_x", "ground_force_z", "ground_moment_y")
    ground = truth.columns(names)[i]
    error = np.sqrt(np.mean((trial.grf - ground[:, :2]) ** 2, axis=0))
    assert error.max() < 2.0
    cop = -ground[:, 2] / ground[:, 1]
    assert np.sqrt(np.mean((trial.cop_x - cop) ** 2)) < 5e-4


def test_joint_moments_are_read_back(read_back, truth):
    _, subject, trial = read_back
    i = at(truth, trial)
    torque = truth.columns([f"{c}_torque" for c in trial.coordinates[3:]])[i]
    human, device = torque[:, :3], torque[:, 3:]
    found = inverse_dynamics(
        subject.rigid,
        trial.q[:, :6],
        trial.v[:, :6],
        trial.a[:, :6],
        {"foot": PlanarWrench(trial.grf, trial.moment_y)},
    )
    error = found[:, 3:] - human - device
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 5.0
    assert np.abs(human).max() > 50.0


def test_forces_balance_the_motion(undisturbed, truth):
    """Newton for the whole body, from finely sampled velocities."""
    _, subject = _subject(undisturbed)
    tree = PlanarTree.from_plant(
        build_plant("coupled", subject.human, subject.exoskeleton)
    )
    nq = tree.num_positions
    q, v, a = truth.values[:, : 3 * nq].reshape(-1, 3, nq).swapaxes(0, 1)
    needed = tree.inverse_dynamics(q, v, a)[:, :2]
    given = truth.columns(["ground_force_x", "ground_force_z"])
    given = given + truth.columns(["chair_force_x", "chair_force_z"])
    assert np.abs(needed - given).max() < 0.5
    # Accelerations are those of the motion, and velocities likewise.
    step = truth.time[1] - truth.time[0]
    for values, rate in ((q, v), (v, a)):
        change = np.diff(values, axis=0)[:, 3:6]
        mean = step * 0.5 * (rate[1:] + rate[:-1])[:, 3:6]
        drift = np.cumsum(change - mean, axis=0)
        assert np.abs(drift).max() < 0.02 * np.ptp(values[:, 3:6])


def _subject(folder):
    study, root = load_study(folder / "study.yaml")
    return study, load_trials(study, root)[0]


def test_the_chair_bears_until_seat_off(read_back, truth):
    _, _, trial = read_back
    chair = truth.column("chair_force_z")
    weight = 85.0 * 9.81
    assert 0.4 * weight < chair[0] < 0.8 * weight
    assert chair[0] + truth.column("ground_force_z")[0] == pytest.approx(
        weight, rel=1e-3
    )
    assert chair[at(truth, trial)].max() < 1.0


def test_standing_settles_to_body_weight(undisturbed):
    standing = read_table(undisturbed / "truth" / "standing.sto")
    force = standing.column("ground_force_z")
    assert force[-1] == pytest.approx(85.0 * 9.81, rel=1e-3)
    assert np.abs(force / force[-1] - 1.0).max() < 0.01
    foot, hip = standing.columns(["foot_pitch", "hip"])[-1]
    ankle, knee = standing.columns(["ankle", "knee"])[-1]
    assert np.rad2deg(abs(foot)) < 0.2
    assert np.rad2deg(abs(foot - ankle + knee - hip)) < 0.2


def test_plates_keep_the_wrench_without_load():
    rng = np.random.default_rng(0)
    wrench = PlanarWrench(rng.normal(0.0, 20.0, (50, 2)), rng.normal(size=50))
    assert (wrench.force[:, 1] < 20.0).any()
    plate = plate_recording(1, wrench, "chair")
    moment = plate.moment_about_origin()
    np.testing.assert_allclose(-moment[:, 2], wrench.moment, atol=1e-12)


def test_calibration_never_looks_at_the_truth():
    """Only the command line and the demo know of the virtual laboratory."""
    package = Path(drake_exo.__file__).parent
    allowed = {"cli.py", "demo.py"}
    for path in package.rglob("*.py"):
        if "virtual_laboratory" in path.parts or path.name in allowed:
            continue
        text = path.read_text(encoding="utf-8")
        assert "virtual_laboratory" not in text, path
        assert "truth/" not in text, path
        assert "truth.json" not in text, path
