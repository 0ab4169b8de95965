"""Studies whose person is a scaled OpenSim model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_osim import small_osim
from synthetic_recording import load

from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.opensim import read_table, read_trc, write_trc
from drake_exo.files.osim import read_osim
from drake_exo.files.tables import MarkerData
from drake_exo.measurement.kinematics import coordinates, solve_poses
from drake_exo.measurement.quality import assess, text_of
from drake_exo.measurement.sagittal import Axes
from drake_exo.measurement.subject import fit_subject
from drake_exo.study import RecordedStudy, StudyFile, read_study

STUDY = """
subject: {name: small, height_m: 1.75}
model: {human: {osim: m.osim, legs: two, toes: hinged}}
standing: {markers: standing.trc}
trials:
  - {name: a, markers: a.trc, forces: a.mot, plates: {left: 1, right: 2}}
"""
ANKLE = 0.11  # height in standing [m]


def recorded(osim, q, n, drop=()):
    """Markers of the OpenSim model in space, as a laboratory sees them."""
    poses = osim.poses(q, n)
    names = tuple(name for name in osim.markers if name not in drop)
    p = [
        R @ osim.markers[name][1] + x
        for name in names
        for R, x in [poses[osim.markers[name][0]]]
    ]
    time = np.arange(n) / 100.0
    return MarkerData(time, names, np.stack(p, axis=1), 100.0, "a.trc")


@pytest.fixture
def folder(tmp_path):
    """The model, and it standing with its toes up by 3 degrees."""
    (tmp_path / "m.osim").write_text(small_osim())
    osim = read_osim(tmp_path / "m.osim")
    tilt = np.deg2rad(3.0)
    q = {"pelvis_tilt": np.full(20, tilt), "pelvis_ty": np.zeros(20)}
    height = ANKLE - osim.poses(q, 20)["talus_r"][1][:, 1]
    standing = recorded(osim, {**q, "pelvis_ty": height}, 20, ("toe2_l",))
    write_trc(tmp_path / "standing.trc", standing)
    return tmp_path


def fitted(folder, *changes):
    text = STUDY
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    settings = schema.load_text(text, StudyFile)
    return settings, fit_subject(settings, folder)


def test_angles_are_the_models_own(folder):
    _, subject = fitted(folder)
    assert subject.mass_kg == pytest.approx(65.0)
    assert subject.report["osim"]["not_seen"] == ["toe2_l"]
    osim = read_osim(folder / "m.osim")
    rng = np.random.default_rng(5)
    q = {
        name: rng.uniform(-0.4, 0.4, 7)
        for joint in osim.joints
        for name in joint.coordinates
    }
    seen = recorded(osim, q, 7)
    points = Axes().points(seen.of(subject.markers.names))
    poses = solve_poses(subject.markers, points)
    assert np.abs(poses.residuals).max() < 1e-9
    found = coordinates(subject.model, subject.markers, poses)
    names = subject.model.coordinates

    def of(name):
        return found[:, names.index(name)]

    for side in ("left", "right"):
        s = side[0]
        # Straight lines between joints lean a little against OpenSim's axes.
        lean = np.angle(0.40 - 0.004j) - np.angle(0.42 + 0.002j)
        knee = -q[f"knee_angle_{s}"]
        np.testing.assert_allclose(of(f"knee_{side}") - knee, lean, atol=1e-6)
        np.testing.assert_allclose(
            of(f"toes_{side}"), q[f"mtp_angle_{s}"], atol=1e-6
        )
    tilt = q["pelvis_tilt"]
    np.testing.assert_allclose(of("pelvis_pitch"), tilt, atol=1e-6)
    hip = (-0.06 - 0.07j) * np.exp(1j * tilt)
    np.testing.assert_allclose(of("pelvis_x"), q["pelvis_tx"] + hip.real)
    np.testing.assert_allclose(of("pelvis_z"), q["pelvis_ty"] + hip.imag)


def test_spheres_lie_on_the_floor_of_standing(folder):
    _, subject = fitted(folder)
    human, tree = subject.model.human, subject.model.tree
    assert human.ankle_height_m == pytest.approx(ANKLE, abs=1e-6)
    pitch = np.zeros((1, tree.num_positions))
    pitch[0, subject.model.coordinates.index("pelvis_pitch")] = np.deg2rad(3)
    ankle = tree.point_positions(pitch, "foot_left", (0.0, 0.0))[0, 1]
    for point in (human.heel_m, human.toe_m):
        z = tree.point_positions(pitch, "foot_left", point)[0, 1]
        assert z - ankle + ANKLE == pytest.approx(0.032, abs=1e-6)


def test_a_subject_before_the_names_is_no_other_marker(folder):
    """Vicon and Motive write LASI as Sub:LASI."""
    standing = read_trc(folder / "standing.trc")
    named = tuple(f"Sub:{name}" for name in standing.names)
    write_trc(folder / "standing.trc", replace(standing, names=named))
    _, subject = fitted(folder)
    assert subject.model.human.ankle_height_m == pytest.approx(ANKLE, abs=1e-6)
    assert subject.report["osim"]["not_seen"] == ["toe2_l"]
    # Of two subjects, either may be meant.
    twice = named + tuple(f"Other:{name}" for name in standing.names)
    p = np.concatenate([standing.positions, standing.positions], axis=1)
    both = replace(standing, names=twice, positions=p)
    write_trc(folder / "standing.trc", both)
    with pytest.raises(InputError, match="has no marker that"):
        fitted(folder)


def test_short_gaps_of_standing_are_filled(folder):
    standing = read_trc(folder / "standing.trc")
    standing.positions[8:11, standing.names.index("knee_l")] = np.nan
    write_trc(folder / "standing.trc", standing)
    filled = "laboratory: {fill_gaps_s: 0.1}\nstanding:"
    _, subject = fitted(folder, ("standing:", filled))
    assert subject.model.human.ankle_height_m == pytest.approx(ANKLE, abs=1e-6)


@pytest.mark.slow
def test_a_stated_mass_scales_the_models(folder):
    _, own = fitted(folder)
    _, heavy = fitted(folder, ("height_m: 1.75", "height_m: 1.75, mass_kg: 78"))
    for name in ("foot", "thigh", "pelvis", "toes"):
        a, b = (getattr(s.model.human, name) for s in (own, heavy))
        assert b.mass_kg == pytest.approx(1.2 * a.mass_kg)
        assert b.inertia_kg_m2 == pytest.approx(1.2 * a.inertia_kg_m2)
        assert b.com_m == a.com_m
    assert heavy.model.tree.mass == pytest.approx(78.0)
    assert heavy.report["mass_from"] == "study"
    assert own.report["mass_from"] == "OpenSim model"
    said = text_of(assess(heavy, ()))
    assert "model: m.osim, 65.0 kg, scaled to 78.0 kg" in said
    assert "markers of the model that standing lacks: toe2_l" in said
    assert "scaled" not in text_of(assess(own, ()))


def test_stiff_toes_carry_no_markers(folder):
    _, subject = fitted(folder, ("toes: hinged", "toes: rigid"))
    assert "toe1_l" not in subject.markers.names
    assert "heel_l" in subject.markers.names


def test_a_study_without_markers_and_model_is_refused(folder):
    with pytest.raises(InputError, match=r"markers is missing; list them, or"):
        fitted(folder, ("osim: m.osim, ", ""))
    with pytest.raises(InputError, match=r"none.osim: cannot be read"):
        fitted(folder, ("m.osim", "none.osim"))


@pytest.mark.slow
def test_a_recording_of_other_markers_is_refused(folder):
    thigh = [f"{n}_{s}" for n in ("thigh1", "thigh2", "knee") for s in "lr"]
    standing = recorded(read_osim(folder / "m.osim"), {}, 20, thigh)
    write_trc(folder / "standing.trc", standing)
    with pytest.raises(InputError, match=r"no marker that .* has on the thigh"):
        fitted(folder)


@pytest.fixture(scope="module")
def opencap(data_root, request):
    path = request.path.parents[1] / "studies" / "opencap_osim.yaml"
    study = read_study(path, data_root)
    return study, load(study.file, study.root)


@pytest.mark.slow
def test_a_real_model_follows_its_markers(opencap):
    """About as near as the list of markers that opencap_sts1.yaml writes."""
    study, (subject, trials) = opencap
    quality = study.quality()
    assert subject.model.human.mass_kg == pytest.approx(60.0)
    for trial in trials:
        assert trial.provenance["markers_absent"] == [
            "L_mknee",
            "L_mankle",
            "r_mknee",
            "r_mankle",
        ]
    for found in quality.trials:
        assert found.marker_rms_all_m < 0.02
        assert max(found.residual_n) < 40.0
    assert any("'walker_knee_r' slides" in note for note in quality.notes)


@pytest.mark.slow
def test_markers_that_lack_and_hide_at_once_are_told(opencap, tmp_path):
    """Two of a foot's three are not there, the third is hidden."""
    study, _ = opencap
    first = study.file.trials[0]
    seen = read_trc(study.root / first.markers)
    keep = [i for i, n in enumerate(seen.names) if n not in ("L_toe", "L_calc")]
    names = tuple(seen.names[i] for i in keep)
    p = seen.positions[:, keep]
    p[50:200, names.index("L_5meta")] = np.nan
    write_trc(tmp_path / "m.trc", replace(seen, names=names, positions=p))
    trials = (replace(first, markers=tmp_path / "m.trc"),)
    study = RecordedStudy(replace(study.file, trials=trials), study.root)
    with pytest.raises(InputError, match="too few others are left on the foot"):
        study.trials()


@pytest.mark.slow
def test_inverse_kinematics_stands_for_markers(data_root, request):
    """OpenSim's own, of a real rise: the knee is as it has it."""
    path = request.path.parents[1] / "studies" / "opencap_osim.yaml"
    study = read_study(path, data_root)
    ik = Path("opencap_subject4/IK")
    trial = replace(study.file.trials[0], markers=ik / "STS1_ik.mot")
    standing = replace(study.file.standing, markers=ik / "static1_ik.mot")
    file = replace(study.file, standing=standing, trials=(trial,))
    (found,) = RecordedStudy(file, study.root).trials()
    table = read_table(data_root / trial.markers)
    knee = table.columns(["knee_angle_l", "knee_angle_r"]).mean(axis=1)
    at = np.interp(found.start_s + found.times, table.time, knee)
    off = np.rad2deg(found.coordinate("knee") - at)
    assert np.sqrt((off**2).mean()) < 1.0
