"""What a person carries: wrenches, moments, the study's keys."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_recording import POINTS, write_recording
from synthetic_recording import load as load_study

from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.opensim import read_trc, write_trc
from drake_exo.measurement.kinematics import carried, inverse_dynamics
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import Load
from drake_exo.measurement.trial import Trial
from drake_exo.model.description import nominal_human
from drake_exo.model.segments import SegmentParameters
from drake_exo.study import StudyFile, read_study

KG, AT = 12.0, (0.25, 0.35)


def heavier(human):
    """The person with the mass as a part of the trunk."""
    trunk = human.pelvis
    mass = trunk.mass_kg + KG
    com = [
        (trunk.mass_kg * a + KG * b) / mass
        for a, b in zip(trunk.com_m, AT, strict=True)
    ]

    def off(p):
        return sum((a - b) ** 2 for a, b in zip(p, com, strict=True))

    inertia = trunk.inertia_kg_m2 + trunk.mass_kg * off(trunk.com_m)
    inertia += KG * off(AT)
    whole = SegmentParameters(mass, tuple(com), inertia, trunk.length_m)
    return replace(human, pelvis=whole)


def test_a_mass_on_the_trunk_is_a_heavier_trunk():
    from drake_exo.model.plant import Model

    human = nominal_human()
    bare, whole = (
        Model("human", human).tree,
        Model("human", heavier(human)).tree,
    )
    time = np.linspace(0.0, 1.0, 401)
    rng = np.random.default_rng(0)
    k, size = rng.uniform(2.0, 6.0, (2, 6)), rng.uniform(-0.4, 0.4, 6)
    q = size * np.sin(k[0] * time[:, None] + k[1])
    v = size * k[0] * np.cos(k[0] * time[:, None] + k[1])
    a = -(k[0] ** 2) * q
    place = bare.point_positions(q, "pelvis", AT)
    load = Load("pelvis", mass_kg=KG, at_m=AT)
    wrench = carried(load, time, place, bare.gravity)
    found = inverse_dynamics(bare, q, v, a, {"pelvis": wrench})
    expected = whole.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_mass_is_borne_from_when_it_is_lifted_until_it_is_put_down():
    load = Load("pelvis", mass_kg=KG, at_m=AT, from_s=1.0, to_s=2.0, over_s=0.4)
    time = np.linspace(0.0, 3.0, 301)
    place = np.tile([0.3, 1.1], (301, 1))
    wrench = carried(load, time, place, 9.81)
    weight = -wrench.force_z / (KG * 9.81)
    at = dict(zip(np.round(time, 2), weight, strict=True))
    for t in (0.9, 1.0, 2.4, 2.9):
        assert at[t] == pytest.approx(0.0, abs=1e-12)
    assert at[1.2] == pytest.approx(0.5)
    for t in (1.4, 2.0):
        assert at[t] == pytest.approx(1.0)
    assert at[2.2] == pytest.approx(0.5)
    # Weight ahead of the origin turns about +y: M_y = -x F_z.
    np.testing.assert_allclose(wrench.moment, -0.3 * wrench.force_z, atol=1e-9)


def check_impulse(tree, trial, place, rel):
    """The force changes the momentum of a mass at a place of the trunk."""
    J = tree.point_jacobian(trial.q, "pelvis", place)
    v = np.einsum("nij,nj->ni", J, trial.v)[:, 1]
    expected = KG * (v[-1] - v[0] + 9.81 * trial.duration)
    force = -trial.applied["pelvis"].force_z
    assert np.trapezoid(force, trial.times) == pytest.approx(expected, rel=rel)


def with_loads(folder, *loads):
    path = folder / "study.yaml"
    study = schema.yaml.safe_load(path.read_text())
    study["trials"] = [{**study["trials"][0], "loads": list(loads)}]
    text = schema.yaml.safe_dump(study, sort_keys=False)
    return schema.load_text(text, StudyFile)


@pytest.mark.slow
def test_loads_of_a_study(tmp_path):
    write_recording(tmp_path, nominal_human(), model="human")
    mass = {"body": "pelvis", "mass_kg": KG, "at_m": list(AT)}
    _, (plain,) = load_study(with_loads(tmp_path), tmp_path)
    subject, (trial,) = load_study(with_loads(tmp_path, mass), tmp_path)
    assert plain.applied == {}
    check_impulse(subject.model.tree, trial, AT, 1e-3)
    assert trial.provenance["loads"] == ["12 kg on the pelvis"]
    # Two of them on one segment are one of both.
    _, (twice,) = load_study(with_loads(tmp_path, mass, mass), tmp_path)
    np.testing.assert_allclose(
        twice.applied["pelvis"].array, 2.0 * trial.applied["pelvis"].array
    )
    trial.save(tmp_path / "t")
    again = Trial.load(tmp_path / "t")
    np.testing.assert_array_equal(
        again.applied["pelvis"].array, trial.applied["pelvis"].array
    )
    # The plates' file read as a pull on the thighs: each force to where it is.
    files = with_loads(tmp_path).trials[0]
    pull = {"body": "thigh", "forces": str(files.forces), "plate": 1}
    _, (pulled,) = load_study(with_loads(tmp_path, mass, pull), tmp_path)
    assert set(pulled.applied) == {"pelvis", "thigh"}
    assert pulled.applied["thigh"].force_z.max() > 50.0
    tree = subject.model.tree
    loads = pulled.loads(tree.root)
    assert set(loads) == {"foot", "pelvis", "thigh"}


@pytest.mark.slow
def test_markers_carry_the_mass(tmp_path):
    write_recording(tmp_path, nominal_human(), model="human")
    study = with_loads(tmp_path)
    marker = study.markers.segments.pelvis
    name = (*marker.left, *marker.right, *marker.middle)[0]
    load = {"body": "pelvis", "mass_kg": KG, "markers": [name]}
    subject, (trial,) = load_study(with_loads(tmp_path, load), tmp_path)
    place = POINTS["pelvis"][name.split("_")[-1]]
    check_impulse(subject.model.tree, trial, place, 0.01)
    # Whether it is seen matters in the used part, while it is carried.
    data = read_trc(tmp_path / "sts.trc")
    column = data.names.index(name)

    def hide(frames):
        data.positions[frames, column] = np.nan
        write_trc(tmp_path / "sts.trc", data)

    hide(slice(5, 45))
    (again,) = load_study(with_loads(tmp_path, load), tmp_path)[1]
    np.testing.assert_allclose(
        again.applied["pelvis"].force_z[-20:],
        trial.applied["pelvis"].force_z[-20:],
        atol=0.5,
    )
    hide(slice(145, 185))
    before = with_loads(tmp_path, load | {"to_s": 0.5})
    assert not load_study(before, tmp_path)[1][0].applied["pelvis"].force.any()
    with pytest.raises(InputError, match="marker without a value"):
        load_study(with_loads(tmp_path, load), tmp_path)
    wrong = {"body": "pelvis", "mass_kg": KG, "markers": ["box"]}
    with pytest.raises(InputError, match="has no marker 'box'"):
        load_study(with_loads(tmp_path, wrong), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "words"),
    [
        ({"body": "hand", "mass_kg": 1, "at_m": [0, 0]}, "no segment 'hand'"),
        ({"body": "pelvis", "mass_kg": 1}, "either markers on it or at_m"),
        ({"body": "pelvis"}, "either a mass_kg or a file of forces"),
        ({"body": "pelvis", "mass_kg": 0, "at_m": [0, 0]}, "above 0 kg"),
        ({"body": "pelvis", "mass_kg": 1, "at_m": [0, 300]}, "at most 3 m"),
        ({"body": "pelvis", "forces": "f.mot", "from_s": 1}, "leave markers, "),
        (
            {"body": "pelvis", "mass_kg": 1, "at_m": [0, 0], "plate": 2},
            "is a mass; leave plate out",
        ),
        (
            {
                "body": "pelvis",
                "mass_kg": 1,
                "at_m": [0, 0],
                "from_s": 2,
                "to_s": 1,
            },
            r"to_s \(1\) must be after from_s \(2\)",
        ),
    ],
)
def test_loads_that_cannot_be_are_refused(tmp_path, load, words):
    write_recording(tmp_path, nominal_human(), model="human")
    with pytest.raises(InputError, match=words):
        with_loads(tmp_path, load)


@pytest.mark.slow
@pytest.mark.parametrize("when", [{"from_s": 8750.0}, {"to_s": -0.1}])
def test_a_load_that_is_never_carried_is_refused(tmp_path, when):
    write_recording(tmp_path, nominal_human(), model="human")
    load = {"body": "pelvis", "mass_kg": KG, "at_m": list(AT)}
    with pytest.raises(InputError, match=r"sts\.trc: .* is never carried"):
        load_study(with_loads(tmp_path, load | when), tmp_path)


@pytest.mark.slow
def test_a_force_file_without_that_plate_is_refused(tmp_path):
    write_recording(tmp_path, nominal_human(), model="human")
    forces = str(with_loads(tmp_path).trials[0].forces)
    load = {"body": "pelvis", "forces": forces, "plate": 9}
    with pytest.raises(InputError, match="has no force plate 9"):
        load_study(with_loads(tmp_path, load), tmp_path)


def test_loads_add_to_a_segment_on_the_ground():
    one = PlanarWrench(np.ones((3, 2)), np.ones(3))
    from drake_exo.model.coordinates import Coordinates

    names = Coordinates(("foot_x", "foot_z", "foot_pitch", "ankle"))
    q = np.zeros((3, 4))
    trial = Trial(
        "a", names, np.arange(3.0), q, q, q, one, applied={"foot": one + one}
    )
    found = trial.loads("foot")["foot"]
    np.testing.assert_array_equal(found.array, 3.0 * one.array)
    assert trial.borne()[0][0] == {"foot": 1.0}


@pytest.mark.slow
def test_a_real_box_is_what_newton_missed(data_root, request):
    """Of the 98 N that the plates bear beyond the body, 18 N are left."""
    path = request.path.parents[1] / "studies" / "boxlifting_squat.yaml"
    study = read_study(path, data_root)
    (trial,) = study.trials()
    tree = study.model.rigid.tree
    motion = trial.q, trial.v, trial.a
    time = trial.start_s + trial.times
    held = (time >= 10.1) & (time <= 10.9)
    bare, loaded = (
        np.sqrt(
            np.mean(inverse_dynamics(tree, *motion, loads)[held, 1:3] ** 2, 0)
        )
        for loads in ({"foot": trial.ground}, trial.loads("foot"))
    )
    assert bare[0] > 90.0 and bare[1] > 80.0
    assert loaded[0] < 20.0 and loaded[1] < 30.0
