import csv
import logging
import re
from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces
from pydrake.symbolic import MakeVectorVariable
from pydrake.systems.analysis import Simulator

from drake_exo.errors import InputError
from drake_exo.model.description import fit_exoskeleton, models_path
from drake_exo.model.plant import KINDS, Model, nominal_model
from drake_exo.model.segments import (
    ExoskeletonOverrides,
    HumanOverrides,
    SegmentOverrides,
    scale_human,
    with_overrides,
)

COUPLED = nominal_model("coupled").coordinates


def build_plant(kind, human=None, exoskeleton=None, plant=None, **gravity):
    human = human or scale_human(70.0, 1.75)
    if kind != "human":
        exoskeleton = exoskeleton or fit_exoskeleton(human)
    return Model(kind, human, exoskeleton, **gravity).plant(plant)


def aligned(body):
    """Coordinates of both chains from the human's six."""
    return COUPLED.aligned(np.array([body]))[0]


def points(plant, q, bodies):
    """Origins (x, z) of bodies in the world at positions q."""
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    return {
        name: plant.EvalBodyPoseInWorld(
            context, plant.GetBodyByName(name)
        ).translation()[[0, 2]]
        for name in bodies
    }


def frame_point(plant, q, name):
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    frame = plant.GetFrameByName(name)
    return frame.CalcPoseInWorld(context).translation()[[0, 2]]


def inverse_dynamics(plant, q, v, vdot):
    """Generalized forces M vdot + C v + G that no contact explains."""
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, forces)
    return plant.CalcInverseDynamics(context, vdot, forces)


@pytest.mark.parametrize("kind", KINDS)
def test_coordinates_come_in_the_stated_order(kind):
    plant = build_plant(kind)
    names = nominal_model(kind).coordinates.names
    assert plant.num_positions() == plant.num_velocities() == len(names)
    foot = plant.GetJointByName("foot")
    assert (foot.position_start(), foot.velocity_start()) == (0, 0)
    for index, name in enumerate(names[3:], start=3):
        joint = plant.GetJointByName(name)
        assert joint.position_start() == joint.velocity_start() == index


@pytest.mark.parametrize("kind", KINDS)
def test_foot_translates_along_x_and_z(kind):
    plant = build_plant(kind)
    q = np.zeros(plant.num_positions())
    q[:2] = 0.3, 0.07
    assert points(plant, q, ["foot"])["foot"] == pytest.approx([0.3, 0.07])


@pytest.mark.parametrize(
    ("coordinate", "link", "direction"),
    [
        # The next joint up moves forward (+1) or backward (-1) when the
        # coordinate grows, all below it standing still.
        ("foot_pitch", "shank", 0),
        ("ankle", "thigh", 1),
        ("knee", "pelvis", -1),
        ("exo_ankle", "exo_thigh", 1),
        ("exo_knee", "exo_pelvis", -1),
    ],
)
def test_flexion_moves_the_next_joint(coordinate, link, direction):
    plant = build_plant("coupled")
    q = np.zeros(9)
    still = points(plant, q, [link])[link]
    q[COUPLED.index(coordinate)] = 0.4
    moved = points(plant, q, [link])[link]
    assert np.sign(np.round(moved[0] - still[0], 12)) == direction


def test_pitch_lifts_the_toes_and_hip_flexion_bends_the_trunk_forward():
    plant = build_plant("coupled")
    q = np.zeros(9)
    assert frame_point(plant, q, "toe")[1] < 0
    lifted = q.copy()
    lifted[2] = 0.4
    assert (
        frame_point(plant, lifted, "toe")[1] > (frame_point(plant, q, "toe")[1])
    )
    assert (
        frame_point(plant, lifted, "heel")[1]
        < (frame_point(plant, q, "heel")[1])
    )
    bent = q.copy()
    bent[5] = 0.4
    assert frame_point(plant, bent, "vertex")[0] > 0.2


def test_seated_pose_by_trigonometry():
    human = scale_human(70.0, 1.75)
    plant = build_plant("coupled", human)
    ankle, knee, hip, pitch = 0.3, 1.5, 1.4, 0.1
    q = aligned([0.2, 0.1, pitch, ankle, knee, hip])
    shank = pitch - ankle  # counter-clockwise absolute angles
    thigh = shank + knee
    pelvis = thigh - hip
    p_knee = np.array([0.2, 0.1]) + human.shank.length_m * np.array(
        [-np.sin(shank), np.cos(shank)]
    )
    p_hip = p_knee + human.thigh.length_m * np.array(
        [-np.sin(thigh), np.cos(thigh)]
    )
    p_top = p_hip + human.pelvis.length_m * np.array(
        [-np.sin(pelvis), np.cos(pelvis)]
    )
    got = points(
        plant, q, ["thigh", "pelvis", "exo_thigh", "exo_pelvis", "exo_foot"]
    )
    assert got["thigh"] == pytest.approx(p_knee)
    assert got["pelvis"] == pytest.approx(p_hip)
    assert got["exo_thigh"] == pytest.approx(p_knee)
    assert got["exo_pelvis"] == pytest.approx(p_hip)
    assert got["exo_foot"] == pytest.approx([0.2, 0.1])
    assert frame_point(plant, q, "vertex") == pytest.approx(p_top)
    for name in ("shank_cuff", "thigh_cuff", "pelvis_cuff", "toe"):
        gap = frame_point(plant, q, f"exo_{name}") - frame_point(plant, q, name)
        depth = 0.0 if name.endswith("cuff") else 0.022
        assert np.linalg.norm(gap) == pytest.approx(depth, abs=1e-9)


def test_welded_plant_is_the_aligned_coupled_plant():
    """The rigid plant's forces are S^T of the coupled plant's."""
    rng = np.random.default_rng(1)
    human = scale_human(81.3, 1.83, "male")
    rigid, coupled = build_plant("rigid", human), build_plant("coupled", human)
    for _ in range(20):
        q, v, a = rng.normal(size=(3, 6))
        S = COUPLED.aligned(np.eye(6)).T
        expected = S.T @ inverse_dynamics(coupled, S @ q, S @ v, S @ a)
        assert inverse_dynamics(rigid, q, v, a) == pytest.approx(
            expected, rel=1e-11, abs=1e-10
        )


def test_exoskeleton_changes_the_rigid_plant():
    """Guards the comparison above against two plants without a device."""
    q = np.array([0, 0, 0, 0.2, 0.5, 0.4])
    zero = np.zeros(6)
    with_device = inverse_dynamics(build_plant("rigid"), q, zero, zero)
    without = inverse_dynamics(build_plant("human"), q, zero, zero)
    assert with_device[1] - without[1] == pytest.approx(15.0 * 9.81)


# Masses and lengths of the table computed with OpenSim 4.6 (its README).
OPENSIM_HUMAN = {
    "foot": (2.03, (0.06, -0.045), 0.03240757467, 0.26),
    "shank": (6.51, (0.0, 0.2440935), 0.1100376194, 0.4305),
    "thigh": (14.0, (0.0, 0.24310125), 0.2684981801, 0.42875),
    "pelvis": (47.46, (0.0, 0.315504), 2.965870332, 0.8),
}
OPENSIM_EXO = {
    "foot": (2.0, (0.05, -0.08), 0.01126666667, 0.26),
    "shank": (3.0, (0.02, 0.236775), 0.0463325625, 0.4305),
    "thigh": (4.0, (0.02, 0.214375), 0.06127552083, 0.42875),
    "pelvis": (6.0, (-0.06, 0.08), 0.06, 0.26),
}


def overrides(table):
    names = ("mass_kg", "com_m", "inertia_kg_m2", "length_m")
    return {
        segment: SegmentOverrides(**dict(zip(names, values, strict=True)))
        for segment, values in table.items()
    }


def opensim_plant():
    human = with_overrides(
        scale_human(70.0, 1.75),
        HumanOverrides(**overrides(OPENSIM_HUMAN)),
        "human",
    )
    exoskeleton = fit_exoskeleton(
        human,
        ExoskeletonOverrides(
            **overrides(OPENSIM_EXO),
            heel_m=(-0.045, -0.058),
            toe_m=(0.165, -0.055),
        ),
    )
    return build_plant("coupled", human, exoskeleton, gravity_m_s2=9.80665)


def contact_generalized_forces(plant, q, sphere, force, radius):
    """Generalized forces (9,) of a force at half the sphere's indentation."""
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    world = plant.world_frame()
    foot = plant.GetFrameByName("exo_foot")
    centre = plant.GetFrameByName(sphere).CalcPoseInWorld(context)
    indentation = radius - centre.translation()[2]
    p_WC = centre.translation() - [0.0, 0.0, radius - 0.5 * indentation]
    p_FC = foot.CalcPoseInWorld(context).inverse() @ p_WC
    jacobian = plant.CalcJacobianTranslationalVelocity(
        context, JacobianWrtVariable.kV, foot, p_FC, world, world
    )
    return jacobian.T @ [force[0], 0.0, force[1]]


def test_inverse_dynamics_equals_opensim(reference_root):
    path = reference_root / "opensim/planar9_inverse_dynamics.csv"
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 60
    plant = opensim_plant()
    # Order and signs: rz, tx, ty and counter-clockwise angles there.
    theirs = ("tx", "ty", "rz", "qa", "qk", "qh", "ea", "ek", "eh")
    sign = np.array([1, 1, 1, -1, 1, -1, -1, 1, -1])
    worst = 0.0
    for row in rows:

        def vector(prefix, row=row):
            return sign * [float(row[f"{prefix}_{name}"]) for name in theirs]

        q, v, vdot = vector("q"), vector("u"), vector("qdd")
        residual = inverse_dynamics(plant, q, v, vdot)
        for sphere in ("heel", "toe"):
            force = [float(row[f"{sphere}_F{axis}"]) for axis in "xy"]
            residual -= contact_generalized_forces(
                plant, q, f"exo_{sphere}", force, 0.032
            )
        expected = vector("tau_residual")
        error = np.abs(residual - expected).max() / np.abs(expected).max()
        worst = max(worst, error)
    assert worst < 1e-9, f"worst relative error {worst:.1e}"


@pytest.mark.parametrize("kind", ("coupled", "human"))
def test_energy_of_a_falling_tumbling_chain_is_kept(kind):
    plant = build_plant(kind)
    simulator = Simulator(plant)
    simulator.get_mutable_integrator().set_target_accuracy(1e-9)
    context = simulator.get_mutable_context()
    n = plant.num_positions()
    plant.SetPositions(context, np.linspace(0.2, 1.0, n))
    plant.SetVelocities(context, np.linspace(-2.0, 2.0, n))

    def energy():
        return plant.CalcPotentialEnergy(context) + (
            plant.CalcKineticEnergy(context)
        )

    before, kinetic = energy(), plant.CalcKineticEnergy(context)
    simulator.AdvanceTo(0.4)
    assert abs(plant.CalcKineticEnergy(context) - kinetic) > 1.0
    assert energy() == pytest.approx(before, abs=1e-5)


def test_centre_of_mass_falls_with_the_set_gravity():
    plant = build_plant("coupled", gravity_m_s2=1.62)
    context = plant.CreateDefaultContext()
    forces = plant.CalcGravityGeneralizedForces(context)
    assert forces[1] == pytest.approx(-85.0 * 1.62)
    assert forces[0] == 0.0


def test_total_mass_is_that_of_subject_and_device():
    human = scale_human(62.6, 1.68, "female")
    exoskeleton = fit_exoskeleton(human)
    for kind, mass in (
        ("human", 62.6),
        ("rigid", 62.6 + exoskeleton.mass_kg),
        ("coupled", 62.6 + exoskeleton.mass_kg),
    ):
        plant = build_plant(kind, human)
        total = plant.CalcTotalMass(plant.CreateDefaultContext())
        assert total == pytest.approx(mass, rel=1e-13)
    shown = repr(Model("coupled", human, exoskeleton)).split("; ")
    assert shown == [
        "Model('coupled', 62.6 kg, 1.68 m",
        "cuffs shank, thigh, pelvis)",
    ]
    assert repr(Model("human", human)) == "Model('human', 62.6 kg, 1.68 m)"


def test_plant_holds_the_parameters_exactly():
    human = scale_human(93.1, 1.91)
    plant = build_plant("human", human)
    context = plant.CreateDefaultContext()
    for name in ("foot", "shank", "thigh", "pelvis"):
        segment = getattr(human, name)
        M_B = plant.GetBodyByName(name).CalcSpatialInertiaInBodyFrame(context)
        assert M_B.get_mass() == segment.mass_kg
        x, z = segment.com_m
        np.testing.assert_array_equal(M_B.get_com(), [x, 0.0, z])
        central = M_B.Shift(M_B.get_com()).CalcRotationalInertia()
        assert central.get_moments()[1] == pytest.approx(
            segment.inertia_kg_m2, rel=1e-12
        )


def test_symbolic_equations_of_motion_are_free_of_rounding_litter():
    plant = build_plant("coupled").ToSymbolic()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, MakeVectorVariable(9, "q"))
    text = str(plant.CalcGravityGeneralizedForces(context)) + str(
        plant.CalcMassMatrixViaInverseDynamics(context)
    )
    assert "sin" in text
    assert not re.search(r"\de-1\d", text)


def test_plant_joins_a_diagram_with_scene_graph():
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    assert build_plant("coupled", plant=plant) is plant
    assert not plant.is_finalized()
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    for name in ("foot", "shank", "thigh", "pelvis"):
        for body in (name, f"exo_{name}"):
            frame = plant.GetBodyFrameIdIfExists(
                plant.GetBodyByName(body).index()
            )
            assert inspector.NumGeometriesForFrame(frame) > 0


@pytest.mark.parametrize("kind", KINDS)
def test_models_parse_without_warnings(kind, caplog):
    with caplog.at_level(logging.INFO):
        plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
        plant.RegisterAsSourceForSceneGraph(scene_graph)
        build_plant(kind, plant=plant).Finalize()
    assert caplog.records == []


def test_a_doubtful_model_file_would_be_noticed(caplog):
    text = (models_path() / "human.sdf").read_text()
    doubtful = text.replace(
        '<link name="foot">', '<link name="foot"><self_collide>1</self_collide>'
    )
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(doubtful, "sdf")
    assert "self_collide" in caplog.text


def test_model_files_are_found_by_package_url():
    plant = MultibodyPlant(0.0)
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(models_path() / "package.xml"))
    for name in ("human", "exoskeleton"):
        (model,) = parser.AddModelsFromUrl(f"package://drake_exo/{name}.sdf")
        assert plant.GetModelInstanceName(model) == name


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            {"kind": "hip.urdf"},
            "no model 'hip.urdf'; .* nominal_model takes a .yaml file",
        ),
        ({"kind": "rigid", "gravity_m_s2": -9.81}, "at least 0"),
    ],
)
def test_wrong_arguments_are_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        build_plant(**arguments)


@pytest.mark.parametrize(
    ("part", "change", "words"),
    [
        ("human", {"mass_kg": -5.0}, "human: thigh.mass_kg is -5.0, but must"),
        ("human", {"length_m": 424.0}, "human: thigh.length_m .* at most 3 m"),
        ("exoskeleton", {"inertia_kg_m2": 0.0}, "exoskeleton: thigh.inertia"),
    ],
)
def test_what_no_body_has_is_refused(part, change, words):
    """Drake only warns of it, and makes another mass of it."""
    model = nominal_model("coupled")
    whole = getattr(model, part)
    thigh = replace(whole.thigh, **change)
    with pytest.raises(InputError, match=words):
        replace(model, **{part: replace(whole, thigh=thigh)})


def test_human_plant_takes_no_exoskeleton():
    device = fit_exoskeleton(scale_human(70.0, 1.75))
    with pytest.raises(InputError, match="no exoskeleton"):
        build_plant("human", exoskeleton=device)


def test_a_person_of_other_size_wears_the_fitted_device():
    human = scale_human(62.6, 1.68, "female")
    model = nominal_model("coupled", 62.6, 1.68, "female")
    assert model == Model("coupled", human, fit_exoskeleton(human))
    with pytest.raises(InputError, match="give metres"):
        nominal_model("human", height_m=168.0)
