"""Physics through the collocation alone, and the contact's two faces."""

import numpy as np
import pytest

from drake_exo.collocation.initial_guess import settle_foot
from drake_exo.collocation.kernels import SPHERE_PARAMETERS, FootGroundKernel
from drake_exo.collocation.trial_program import (
    Movement,
    Tracking,
    add_parameters,
)
from drake_exo.contact.diagram import build_diagram
from drake_exo.contact.hunt_crossley import default_constants
from drake_exo.contact.parameters import (
    ContactParameter,
    ContactParameters,
    ContactSphere,
    nominal_contact,
)
from drake_exo.model.description import nominal_human
from drake_exo.model.planar_tree import PlanarTree
from drake_exo.model.plant import build_plant
from drake_exo.nlp import ipopt
from drake_exo.nlp.program import BatchedProgram
from drake_exo.nlp.sparse import SparseProgram

_UNITS = np.array([100.0, 100.0, 10.0])
_STANDING = np.array([0.0, 0.07, 0.0, 0.1, 0.1, 0.05])  # balanced


def parameters_of(contact: ContactParameters) -> np.ndarray:
    return np.array(
        [
            [s.stiffness, s.dissipation, s.x, s.z, s.radius]
            for s in contact.spheres.values()
        ]
    ).ravel()


def contact_of(law):
    human = nominal_human()
    return nominal_contact(law, human.heel_m, human.toe_m, 0.032)


@pytest.mark.parametrize("law", ["paper", "simbody"])
def test_kernel_equals_the_diagrams_contact(law):
    spheres = {
        "heel": ContactSphere(-0.04, -0.06, 0.035, 1.3e4, 1.5),
        "toe": ContactSphere(0.17, -0.055, 0.025, 1.1e4, 0.0),
    }
    contact = ContactParameters(law, spheres)
    if law == "simbody":
        for sphere in spheres.values():
            object.__setattr__(sphere, "stiffness", 300.0 * sphere.stiffness)
    model = build_diagram("human", contact=contact)
    kernel = FootGroundKernel(law, default_constants(law))
    rng = np.random.default_rng(0)
    parameters = parameters_of(contact)
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
        found = kernel.evaluate(x, None)[0] * _UNITS
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)
        largest = max(largest, np.abs(expected).max())
    assert largest > 1e3


def standing(tree, law, transcription):
    """Joints held still; the foot goes where the contact carries it."""
    program = BatchedProgram()
    contact = parameters_of(contact_of(law))
    names = [f"{s}.{n}" for s in ("heel", "toe") for n in SPHERE_PARAMETERS]
    variables = add_parameters(
        program,
        [
            ContactParameter(name, "", v, v - 1.0, v + 1.0, free=False)
            for name, v in zip(names, contact, strict=True)
        ],
        0.0,
    )
    movement = Movement(program, "rise1", tree, 0.5, 20.0, transcription)
    kernel = FootGroundKernel(law, default_constants(law))
    movement.stand_on(kernel, variables)
    n = len(movement.grid.times)
    still = np.zeros((n, 6))
    posture = np.tile(_STANDING, (n, 1))
    movement.track(
        [
            Tracking(movement.grid.q, posture, [1e3] * 3 + [1e-2] * 3),
            Tracking(movement.grid.v, still, 0.1),
            Tracking(movement.grid.a, still, 1.0),
        ]
    )
    movement.damp_jerk(100.0)
    return program, movement, variables, contact


def start(program, movement, variables, contact):
    x = np.zeros(program.prog.num_vars())
    x[program.indices(variables)] = contact
    q = program.indices(movement.grid.q)
    x[q] = _STANDING
    return x


@pytest.mark.parametrize("transcription", ["hermite_simpson", "pseudospectral"])
@pytest.mark.parametrize("law", ["paper", "simbody"])
def test_contact_settles_to_body_weight(law, transcription):
    tree = PlanarTree.from_plant(build_plant("human"))
    posed = standing(tree, law, transcription)
    program, movement, *_ = posed
    problem = SparseProgram(program, (movement.grid.substitution(program),))
    x = start(*posed)
    if law == "paper":
        # Its friction has no slope at rest and its force none in the air, so
        # it must start on the ground, here at 0.7 of the weight.
        place = program.indices(movement.grid.q[:, :3])
        weight = 0.7 * tree.mass * tree.gravity
        ground = np.tile([0.0, weight, -0.05 * weight], (len(place), 1))
        kernel = FootGroundKernel(law, default_constants(law))
        x[place], _ = settle_foot(
            kernel, posed[3], movement.grid.times, x[place], ground
        )
    solution = ipopt.solve(problem, x)
    assert solution.success, solution.explain()
    ground = solution.values(program.indices(movement.ground))
    weight = tree.mass * tree.gravity
    np.testing.assert_allclose(ground[:, 1], weight, rtol=1e-3)
    assert np.abs(ground[:, 0]).max() < 1e-3 * weight
    # The centre of pressure lies under the centre of mass.
    q = solution.values(program.indices(movement.grid.q))
    cop = -ground[:, 2] / ground[:, 1]
    com = tree.center_of_mass(q)[:, 0]
    np.testing.assert_allclose(cop, com, atol=1e-3)
    # It started in the air; now a sphere presses into the ground.
    heel, toe = nominal_human().heel_m, nominal_human().toe_m
    lowest = [
        tree.point_positions(q, "foot", point)[:, 1] - 0.032
        for point in (heel, toe)
    ]
    assert np.min(lowest, axis=0).max() < -1e-3


def test_worst_constraints_name_trial_node_and_row():
    tree = PlanarTree.from_plant(build_plant("human"))
    posed = standing(tree, "simbody", "hermite_simpson")
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
    weight = tree.mass * tree.gravity
    assert violation == pytest.approx(weight / 100.0, rel=1e-3)
