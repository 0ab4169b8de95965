"""Parts of the virtual laboratory against the laws they are made of."""

from pathlib import Path

import numpy as np
import pytest

from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.parameters import (
    ContactModel,
    ContactSphere,
    GroundContact,
    nominal_contact,
)
from drake_exo.measurement.mats import cell_directions
from drake_exo.measurement.settings import Mat, Scan
from drake_exo.model.plant import nominal_model
from drake_exo.virtual_laboratory.forces import (
    Cuff,
    Cuffs,
    Seat,
    applied,
    chair_wrench,
    cuff_force,
    ground_wrench,
    interaction,
    levelled,
    resting_foot,
)
from drake_exo.virtual_laboratory.instruments import (
    CELL_AREA_M2,
    CONFIGURATIONS,
    cell_pressures,
    cells,
    hide,
    marker_set,
    study_markers,
    write_scans,
)
from drake_exo.virtual_laboratory.plan import (
    DeviceController,
    Friction,
    Planner,
    RisePlan,
    SubjectController,
    controller,
)
from drake_exo.virtual_laboratory.simulation import equilibrium
from drake_exo.virtual_laboratory.truth import (
    STANDING_COP_M,
    TRUTH,
    draw_truth,
)

MODEL = nominal_model("coupled")
HUMAN = MODEL.human
RIGID = MODEL.rigid.tree
BUSHINGS = nominal_contact(MODEL).bushings
RICH = frozenset(TRUTH)


def random_state(rng):
    q = np.array([0.0, 0.06, 0.02, 0.3, 1.6, 1.4, 0.31, 1.65, 1.42])
    return q + rng.normal(0.0, 0.01, 9), rng.normal(0.0, 0.3, 9)


@pytest.mark.slow
def test_forces_of_the_diagram_are_those_of_the_record():
    """LeafSystems in a diagram and batches over samples: one set of laws."""
    rng = np.random.default_rng(1)
    truth = draw_truth(rng, RICH)
    tree, plant = truth.model.tree, truth.model.plant()
    seat = 0.48
    model = build_diagram(
        truth.model,
        ContactModel(truth.contact),
        forces=[Cuffs(plant, tree.cuffs, truth.cuffs), Seat(plant, seat)],
    )
    context = model.diagram.CreateDefaultContext()
    model.diagram.get_input_port(0).FixValue(context, np.zeros(6))
    for _ in range(3):
        q, v = random_state(rng)
        model.plant.SetPositionsAndVelocities(
            model.plant_context(context), np.r_[q, v]
        )
        slope = model.diagram.EvalTimeDerivatives(context).CopyToVector()
        q, v, a = (x[None] for x in (q, v, slope[9:]))
        loads = applied(tree, truth.contact, truth.cuffs, seat, q, v)
        assert chair_wrench(tree, seat, q, v).force[0, 1] > 10.0
        np.testing.assert_allclose(
            tree.inverse_dynamics(q, v, a), loads, rtol=1e-9, atol=1e-6
        )


def test_plain_cuffs_are_bushings():
    rng = np.random.default_rng(2)
    model = build_diagram(MODEL)
    context = model.diagram.CreateDefaultContext()
    q, v = random_state(rng)
    model.plant.SetPositionsAndVelocities(
        model.plant_context(context), np.r_[q, v]
    )
    port = model.diagram.GetOutputPort("interaction_forces")
    cuffs = {name: Cuff(bushing) for name, bushing in BUSHINGS.items()}
    found = interaction(MODEL.tree, cuffs, q[None], v[None])[0]
    found = np.hstack([force.components[0] for force in found.values()])
    np.testing.assert_allclose(found, port.Eval(context), rtol=1e-10)


def test_cuffs_stiffen_and_slip():
    bushing = BUSHINGS["thigh"]
    cuff = Cuff(bushing, progression=50.0, slip=1.0 / 25.0)
    d = np.linspace(-0.03, 0.03, 61)
    rest = (0.0 * d, 0.0 * d, 0.0 * d)
    normal = cuff_force(cuff, (0.0 * d, d, 0.0 * d), rest).normal
    stiffness = np.gradient(normal, d)
    assert stiffness[30] == pytest.approx(bushing.normal_stiffness, rel=1e-2)
    assert np.all(np.diff(stiffness[30:-1]) > 0.0)
    along = cuff_force(cuff, (d, 0.0 * d, 0.0 * d), rest).tangential
    assert np.all(np.diff(along) > 0.0)
    assert np.abs(along).max() < 25.0


@pytest.mark.parametrize("active", [frozenset(), RICH])
def test_standing_foot_is_level_and_bears_the_weight(active):
    truth = draw_truth(np.random.default_rng(3), active)
    load = np.array([0.5, 1.0]) * truth.model.tree.weight
    q = np.zeros((2, 6))
    q[:, :3] = resting_foot(RIGID, truth.contact, load, STANDING_COP_M)
    ground = ground_wrench(RIGID, truth.contact, q, 0.0 * q)
    np.testing.assert_allclose(ground.force[:, 1], load, rtol=1e-6)
    np.testing.assert_allclose(ground.cop_x, STANDING_COP_M, atol=1e-6)
    assert q[1, 1] == pytest.approx(truth.human.ankle_height_m, abs=1e-6)
    assert q[1, 2] == pytest.approx(0.0, abs=1e-6)


def test_levelling_keeps_the_shape_of_the_sole():
    places = {"heel": (-0.05, -0.03), "toe": (0.17, -0.04)}
    spheres = {
        name: ContactSphere(5e6, 2.0, *place, radius=0.03)
        for name, place in places.items()
    }
    sole = GroundContact("simbody", spheres).checked()
    flat = levelled(RIGID, sole, 800.0, 0.05, 0.07)

    def distance(contact):
        heel, toe = contact.spheres.values()
        return np.hypot(heel.x - toe.x, heel.z - toe.z)

    assert distance(flat) == pytest.approx(distance(sole), rel=1e-9)


@pytest.mark.slow
def test_truth_is_drawn_in_one_order():
    """Switching one thing off leaves the other numbers as they were."""
    all_of_it = draw_truth(np.random.default_rng(5), RICH)
    for name in TRUTH:
        less = draw_truth(np.random.default_rng(5), RICH - {name})
        if name not in ("progressive", "shear"):
            assert less.cuffs == all_of_it.cuffs
        if name != "segments":
            assert less.human == all_of_it.human
    assert all_of_it.human.mass_kg == pytest.approx(HUMAN.mass_kg)


@pytest.mark.slow
def test_seated_posture_is_in_balance():
    truth = draw_truth(np.random.default_rng(6), frozenset())
    tree = truth.model.tree
    planner, plan = Planner(RIGID, truth.contact), RisePlan()
    seat = planner.seat(plan)
    reference = planner.movement(plan, seat)
    cop = reference.ground.cop_x
    risen = reference.times > plan.quiet_s + plan.lean_s
    assert np.abs(cop[risen] - plan.cop_m).max() < 0.01
    assert reference.ground.force_z.min() > 100.0
    q = equilibrium(truth, seat, reference.q[0])[None]
    rest = np.zeros_like(q)
    left = tree.inverse_dynamics(q, rest, rest) - applied(
        tree, truth.contact, truth.cuffs, seat, q, rest
    )
    np.testing.assert_allclose(left[0, [0, 1, 2, 6, 7, 8]], 0.0, atol=1e-5)
    # Where the plan wanted to be, to what cuffs give.
    assert np.abs(q[0, :6] - reference.q[0]).max() < np.deg2rad(0.05)


def test_controllers_join_to_six_torques():
    truth = draw_truth(np.random.default_rng(7), frozenset())
    reference = Planner(RIGID, truth.contact).standing(1.0, STANDING_COP_M)
    friction = Friction((1.0, 1.0, 1.0), (2.0, 2.0, 2.0))
    device = DeviceController(truth.model, (0.0, 0.5, 0.5), friction)
    expected = device.help(
        reference.times,
        reference.q[:, 3:],
        reference.v[:, 3:],
        reference.ground.force_z,
    )
    subject = SubjectController(truth.model.coordinates, reference, expected)
    both = controller(truth.model.coordinates, subject, device)
    context = both.CreateDefaultContext()
    q = np.r_[reference.q[0], reference.q[0, 3:]]
    v = np.r_[np.zeros(6), 1.0, -1.0, 0.0]
    both.GetInputPort("state").FixValue(context, np.r_[q, v])
    ground = reference.ground.array[0]
    both.GetInputPort("ground_reaction").FixValue(context, ground)
    found = both.GetOutputPort("joint_torques").Eval(context)
    # On the plan, both together give what the plan needs.
    rubbing = np.array([-3.0, 3.0, 0.0])
    total = found[:3] + found[3:] - rubbing
    np.testing.assert_allclose(total, reference.moments[0], atol=1e-9)
    assert np.abs(expected[0]).max() > 1.0
    unloaded = device.torques(
        np.zeros(1), q[None, 6:], v[None, 6:], np.zeros(1)
    )
    np.testing.assert_allclose(unloaded[0], rubbing, atol=1e-9)


EVERY_MAT = [mat for mats in CONFIGURATIONS.values() for mat in mats]


@pytest.mark.slow
@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_mats_sum_to_the_cuff_force(configuration, tmp_path):
    q = np.zeros(9)
    q[1], q[3], q[6] = 0.07, 0.08, 0.08
    section = write_scans(tmp_path, MODEL, q, EVERY_MAT)
    force = np.array([-80.0, -5.0, 0.0, 40.0])
    total: dict[str, np.ndarray] = {}
    for mat in CONFIGURATIONS[configuration]:
        settings = dict(section[mat.name])
        scan = settings.pop("scan")
        scan |= {key: Path(scan[key]) for key in ("file", "cells")}
        inward, report = cell_directions(
            Mat(**settings, scan=Scan(**scan)), mat.name, tmp_path
        )
        assert report["cell_distance_mm"] == pytest.approx(14.14, rel=5e-3)
        pressure = cell_pressures(mat, MODEL, force)
        assert pressure.min() >= 0.0
        found = CELL_AREA_M2 * pressure @ inward
        total[mat.segment] = total.get(mat.segment, 0.0) + found
    for found in total.values():
        np.testing.assert_allclose(found[:, 0], force, atol=0.5)
        np.testing.assert_allclose(found[:, 1:], 0.0, atol=0.5)


def test_gaps_are_short_and_few():
    positions = np.ones((200, 56, 3))
    seen = hide(positions, np.random.default_rng(8))
    gone = np.isnan(seen).any(axis=2)
    assert 0 < gone.any(axis=0).sum() <= 6
    assert gone.sum(axis=0).max() <= 12
    assert not gone[[0, -1]].any()


def test_study_names_markers_that_exist():
    markers, said = marker_set(HUMAN), study_markers()
    assert len(markers) == 56
    named = [
        name
        for part in said.values()
        for sides in part.values()
        for names in sides.values()
        for name in names
    ]
    assert set(named) <= set(markers)


@pytest.mark.parametrize("mat", EVERY_MAT)
def test_cells_lie_about_the_middle_of_a_face(mat):
    """A pitch apart, as many before as behind, normals inwards."""
    centres, inward, around, along = cells(mat, MODEL)
    front = 1.0 if mat.face == "front" else -1.0
    assert (front * centres[:, 0] > 0.0).mean() > 0.6
    assert centres[:, 1].mean() == pytest.approx(0.0, abs=1e-9)
    assert around.mean() == pytest.approx(0.0, abs=1e-9)
    assert along.mean() == pytest.approx(0.0, abs=1e-12)
    cuff = HUMAN.cuff_m(mat.segment)[1]
    np.testing.assert_allclose(centres[:, 2], cuff + along)
    assert (np.sum(inward[:, :2] * centres[:, :2], axis=1) < 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(inward, axis=1), 1.0)
    steps = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    np.fill_diagonal(steps, np.inf)
    np.testing.assert_allclose(
        steps.min(axis=1), np.sqrt(CELL_AREA_M2), rtol=0.02
    )
    # An ellipse: the normal is its gradient.
    a, b = np.abs(centres[:, :2]).max(axis=0)
    assert a < 0.2 and b < 0.2


@pytest.mark.parametrize("segment", ["shank", "thigh", "pelvis"])
def test_straps_never_pull(segment):
    """Back less front is the force, their product the tension's square."""
    tension = {"shank": 40.0, "thigh": 50.0, "pelvis": 50.0}[segment]
    force = np.array([-300.0, 0.0, 100.0])
    sides = {}
    for mat in EVERY_MAT:
        if mat.segment == segment:
            pressure = cell_pressures(mat, MODEL, force)
            assert pressure.min() > 0.0
            inward = np.abs(cells(mat, MODEL)[1][:, 0])
            sides[mat.face] = CELL_AREA_M2 * pressure @ inward
    np.testing.assert_allclose(sides["back"] - sides["front"], force, atol=1e-9)
    product = sides["back"] * sides["front"]
    np.testing.assert_allclose(product, tension**2)
