"""Physics through the collocation alone, and the contact's two faces."""

import numpy as np
import pytest

from drake_exo.collocation.initial_guess import settle_foot
from drake_exo.collocation.kernels import FootGroundKernel
from drake_exo.collocation.trial_program import (
    ALTERNATING,
    Tracking,
    TrialProgram,
    add_parameters,
)
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.parameters import (
    ContactModel,
    ContactSphere,
    GroundContact,
    nominal_contact,
)
from drake_exo.model.plant import nominal_model
from drake_exo.nlp import ipopt
from drake_exo.nlp.program import BatchedProgram
from drake_exo.nlp.sparse import SparseProgram

_STANDING = np.array([0.0, 0.07, 0.0, 0.1, 0.1, 0.05])  # balanced


@pytest.fixture(scope="module")
def human():
    return nominal_model("human")


@pytest.mark.parametrize("law", ["paper", "simbody"])
def test_kernel_equals_the_diagrams_contact(human, law):
    stiffness = 1e4 if law == "paper" else 3e6
    spheres = {
        "heel": ContactSphere(1.3 * stiffness, 1.5, -0.04, -0.06, 0.035),
        "toe": ContactSphere(1.1 * stiffness, 0.0, 0.17, -0.055, 0.025),
    }
    contact = ContactModel(GroundContact(law, spheres))
    model = build_diagram(human, contact)
    kernel = FootGroundKernel(contact.ground)
    rng = np.random.default_rng(0)
    parameters = list(contact.values().values())
    largest = 0.0
    for _ in range(20):
        context = model.diagram.CreateDefaultContext()
        plant_context = model.plant_context(context)
        q, v = rng.uniform(-0.3, 0.3, (2, 6))
        q[1] = rng.uniform(0.03, 0.1)
        model.plant.SetPositions(plant_context, q)
        model.plant.SetVelocities(plant_context, v)
        port = model.diagram.GetOutputPort("ground_reaction")
        expected = port.Eval(context)
        x = np.r_[q[:3], v[:3], np.zeros(3), parameters][None]
        found = kernel.wrench(x)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)
        largest = max(largest, np.abs(expected).max())
    assert largest > 1e3


@pytest.mark.parametrize("parts", [1, [1, 1, 2, 4, 4, 2, 1, 1, 1, 1]])
def test_alternating_accelerations_cost_where_no_torque_is(human, parts):
    program = BatchedProgram()
    movement = TrialProgram(
        program, "step", human.tree, 0.5, 20.0, bodies=["pelvis"], parts=parts
    )
    movement.add_jerk_cost(100.0)
    movement.damp()
    prog, grid = program.prog, movement.grid
    n = len(grid.times)
    swing = (-1.0) ** np.arange(n)
    whole = 0.5 * grid.jerk_weights.sum() * (4.0 / 100.0) ** 2
    # Midway, of the allowed.
    missed = 0.5 * (grid.steps[1:] + grid.steps[:-1]) * 4.0 / 4.0 / ALTERNATING
    between = 0.5 * np.sum(0.5 * (grid.steps[1:] + grid.steps[:-1]) * missed**2)
    for column, expected in ((1, whole + between), (4, whole)):
        x = np.zeros(prog.num_vars())
        x[program.indices(grid.jerk[:, column])] = 4.0 * swing
        costs = prog.EvalBindings(prog.GetAllCosts(), x)
        assert costs.sum() == pytest.approx(expected, rel=1e-12)


def test_a_foot_on_the_ground_may_alternate(human):
    movement = TrialProgram(BatchedProgram(), "rise1", human.tree, 0.5, 20.0)
    movement.damp()
    variables, factors, times = movement.damped
    assert variables.shape == factors.shape
    assert len(variables) == len(times) == 0


def test_nothing_is_damped_where_nodes_determine_what_is_between(human):
    program = BatchedProgram()
    grid, bodies = "pseudospectral", ["pelvis"]
    movement = TrialProgram(
        program, "step", human.tree, 0.5, 20.0, grid, bodies=bodies
    )
    assert movement.may_alternate
    before = program.counts
    movement.damp()
    assert len(movement.damped[0]) == 0 and program.counts == before


def standing(human, law, transcription):
    """Joints held still; the foot goes where the contact carries it."""
    program = BatchedProgram()
    contact = nominal_contact(human, law)
    variables = add_parameters(
        program, [*contact.fixed("heel"), *contact.fixed("toe")]
    )
    movement = TrialProgram(
        program, "rise1", human.tree, 0.5, 20.0, transcription
    )
    kernel = FootGroundKernel(contact.ground)
    foot = [movement.poses["foot"], movement.grounds["foot"]]
    movement.add_law("foot-ground", kernel, foot, variables)
    n = len(movement.grid.times)
    still = np.zeros((n, 6))
    posture = np.tile(_STANDING, (n, 1))
    movement.add_tracking_cost(
        [
            Tracking(movement.grid.q, posture, [1e3] * 3 + [1e-2] * 3),
            Tracking(movement.grid.v, still, 0.1),
            Tracking(movement.grid.a, still, 1.0),
        ]
    )
    movement.add_jerk_cost(100.0)
    values = np.array(list(contact.values().values()))
    return program, movement, variables, values, kernel


def start(program, movement, variables, values, _):
    x = np.zeros(program.prog.num_vars())
    x[program.indices(variables)] = values
    q = program.indices(movement.grid.q)
    x[q] = _STANDING
    return x


@pytest.mark.parametrize("transcription", ["hermite_simpson", "pseudospectral"])
@pytest.mark.parametrize("law", ["paper", "simbody"])
def test_contact_settles_to_body_weight(human, law, transcription):
    tree = human.tree
    posed = standing(human, law, transcription)
    program, movement, _, values, kernel = posed
    problem = SparseProgram(program, (movement.grid.substitution(program),))
    x = start(*posed)
    if law == "paper":
        # Its friction has no slope at rest and its force none in the air, so
        # it must start on the ground, here at 0.7 of the weight.
        place = program.indices(movement.grid.q[:, :3])
        weight = 0.7 * tree.weight
        ground = np.tile([0.0, weight, -0.05 * weight], (len(place), 1))
        x[place], _ = settle_foot(
            kernel, values, movement.grid.times, x[place], ground
        )
    solution = ipopt.solve(problem, x)
    assert solution.success, solution.explain()
    ground = solution.values(program.indices(movement.ground))
    weight = tree.weight
    np.testing.assert_allclose(ground[:, 1], weight, rtol=1e-6)
    assert np.abs(ground[:, 0]).max() < 1e-6 * weight
    # The centre of pressure lies under the centre of mass.
    q = solution.values(program.indices(movement.grid.q))
    cop = -ground[:, 2] / ground[:, 1]
    com = tree.center_of_mass(q)[:, 0]
    np.testing.assert_allclose(cop, com, atol=1e-7)
    # It started in the air; now a sphere presses into the ground.
    lowest = [
        tree.point_positions(q, tree.root, point)[:, 1] - 0.032
        for point in human.spheres.values()
    ]
    assert np.min(lowest, axis=0).max() < -1e-3


def test_a_term_is_shown_that_is_in_no_cost_yet():
    zero = np.zeros((2, 1))
    assert "Tracking" in repr(Tracking(zero, zero, 1.0))


def test_worst_constraints_name_trial_node_and_row(human):
    posed = standing(human, "simbody", "hermite_simpson")
    program, movement, *_ = posed
    problem = SparseProgram(program, (movement.grid.substitution(program),))
    x = start(*posed)
    y = problem.restrict(x)
    names = [problem.rows.name(i) for i in range(problem.num_constraints)]
    assert "rise1 dynamics[10] row 3" in names
    assert "rise1 foot-ground[0] row 2" in names
    # In the air nothing carries the body: its weight is what is missing.
    (name, violation), *_ = problem.worst_constraints(y, 3)
    assert name.startswith("rise1 dynamics[")
    assert name.endswith("row 1")
    weight = human.tree.weight
    assert violation == pytest.approx(weight / 100.0)
