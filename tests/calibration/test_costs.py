"""Every term of every phase's cost, by moving one signal by a known amount.

A signal that is d off at all nodes of a movement of T seconds costs
T (d/sigma)^2 / 2; nothing else changes with it. Energies are those of the
simulated cuffs, which are other code.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.calibration.error_model import NO_ERRORS, ErrorSizes
from drake_exo.calibration.phases import (
    FootGroundCalibration,
    InteractionCalibration,
    PredictionProblem,
)
from drake_exo.calibration.problem import (
    _against_the_foot,
    foot_turn,
    ground_terms,
    torque_terms,
    typical_jerk,
)
from drake_exo.calibration.settings import (
    FootGroundSettings,
    InteractionNoise,
    InteractionSettings,
    PredictionSettings,
    Solver,
    TrackingNoise,
)
from drake_exo.contact.parameters import TYPICAL_JERK
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.coordinates import Coordinates
from drake_exo.virtual_laboratory.forces import Cuff, interaction

DEGREE = np.pi / 180.0
SIGMAS = {
    "angle_deg": 0.5,
    "velocity_deg_s": 4.0,
    "exo_angle_deg": 0.2,
    "exo_velocity_deg_s": 2.0,
    "foot_m": 0.004,
    "foot_pitch_deg": 1.5,
    "foot_velocity_m_s": 0.05,
    "foot_pitch_rate_deg_s": 7.0,
    "force_n": 6.0,
    "cop_m": 0.002,
    "torque_nm": 3000.0,
    "jerk": 150.0,
}
MORE = {"moment_nm": 5.0, "exo_moment_nm": 0.7, "normal_force_n": 3.0}
# One sigma of each coordinate: foot x, z, pitch, human, device.
COUNTS = [2, 1, 3, 3]
SIGMA_Q = np.repeat([0.004, 1.5 * DEGREE, 0.5 * DEGREE, 0.2 * DEGREE], COUNTS)
SIGMA_V = np.repeat([0.05, 7.0 * DEGREE, 4.0 * DEGREE, 2.0 * DEGREE], COUNTS)
SIGMA_M = np.r_[[5.0] * 3, [0.7] * 3]
SOLVER = Solver(20.0)


class Cost:
    """The cost of a problem with one movement, and places of its signals."""

    def __init__(self, problem):
        self.problem = problem
        (self.movement,) = problem.movements
        self.costs = problem.program.prog.GetAllCosts()
        self.place = problem.program.indices
        grid = self.movement.grid
        self.T = grid.times[-1]
        self.at = at = problem.trials[0].sample(grid.times)
        self.x = problem.guess()
        signals = [(grid.q, at.q), (grid.v, at.v)]
        signals.append((self.movement.ground, at.ground.array))
        if at.moments is not None:
            signals.append((self.movement.torque, at.moments))
        for cuff, force in at.cuffs.items():
            if cuff in self.movement.cuffs:
                signals.append((self.movement.cuffs[cuff][:, 1], force.normal))
        for variables, values in signals:
            self.x[self.place(variables)] = values

    def __call__(self, *moved) -> float:
        """Total, with (variables, change) moved."""
        x = self.x.copy()
        for variables, change in moved:
            x[self.place(np.asarray(variables))] += change
        prog = self.problem.program.prog
        return sum(prog.EvalBinding(b, x)[0] for b in self.costs)

    def bend(self, variables, d) -> float:
        """Cost of d beyond what is linear in it; 0 at d = 0."""
        twice = self((variables, d)) + self((variables, -d)) - 2.0 * self()
        return 0.5 * twice

    def tilt(self, variables, d) -> float:
        """What is linear: 0 where the target is what was measured."""
        return 0.5 * (self((variables, d)) - self((variables, -d)))


@pytest.fixture(scope="module")
def trial(in_device):
    return in_device.trials[0]


@pytest.fixture(scope="module")
def phase_a(in_device, trial):
    settings = FootGroundSettings(noise=TrackingNoise(**SIGMAS), solver=SOLVER)
    return Cost(FootGroundCalibration(in_device.model, [trial], settings))


def interaction_cost(in_device, trial, energy, errors=NO_ERRORS):
    settings = InteractionSettings(
        noise=InteractionNoise(**SIGMAS, **MORE, energy_j=energy),
        solver=SOLVER,
        errors=errors,
    )
    made = in_device
    return Cost(
        InteractionCalibration(made.model, [trial], made.contact, settings)
    )


@pytest.fixture(scope="module")
def phase_b(in_device, trial):
    return interaction_cost(in_device, trial, 1e9)


def prediction_cost(in_device, trial, energy, errors=NO_ERRORS, **more):
    settings = PredictionSettings(
        noise=InteractionNoise(**SIGMAS, **MORE, energy_j=energy),
        solver=SOLVER,
        errors=errors,
        **more,
    )
    made = in_device
    return Cost(PredictionProblem(made.model, [trial], made.contact, settings))


@pytest.fixture(scope="module")
def phase_c(in_device, trial):
    return prediction_cost(in_device, trial, 1e9)


def tracked(cost, variables, sigma, d):
    """A term of its own: its size, and its target."""
    expected = 0.5 * cost.T * (d / sigma) ** 2
    assert cost.bend(variables, d) == pytest.approx(expected, rel=1e-6)
    assert abs(cost.tilt(variables, d)) < 1e-6 * expected


# Of the foot, the person and the device one each; the others take seconds.
@pytest.mark.slow
@pytest.mark.parametrize("phase", ["phase_a", "phase_b"])
@pytest.mark.parametrize(
    "k",
    [
        pytest.param(k, marks=[] if k in (0, 4, 8) else pytest.mark.slow)
        for k in range(9)
    ],
)
def test_coordinates_and_velocities_are_tracked(request, phase, k):
    cost = request.getfixturevalue(phase)
    grid = cost.movement.grid
    tracked(cost, grid.q[:, k], SIGMA_Q[k], 3.0 * SIGMA_Q[k])
    tracked(cost, grid.v[:, k], SIGMA_V[k], 3.0 * SIGMA_V[k])


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["phase_a", "phase_b", "phase_c"])
def test_ground_reaction_and_cop_are_tracked(request, phase):
    """The second by the moment about it, over the mean vertical force."""
    cost = request.getfixturevalue(phase)
    ground, F = cost.movement.ground, cost.at.ground.force
    tracked(cost, ground[:, 0], 6.0, 20.0)
    mean = F[:, 1].mean()
    tracked(cost, ground[:, 2], 0.002 * mean, 5.0)
    # A force F_z beside a moment that stays moves the point, too.
    x = cost.at.ground.cop_x
    expected = 0.5 * cost.T * (10.0 / 6.0) ** 2
    weights = np.full(len(x), cost.T / (len(x) - 1))
    weights[[0, -1]] *= 0.5
    expected += 0.5 * weights @ (10.0 * x / (0.002 * mean)) ** 2
    assert cost.bend(ground[:, 1], 10.0) == pytest.approx(expected, rel=1e-6)


def test_a_mean_force_is_over_time_wherever_the_grid_is_finer():
    """Noise of a foot's pressure and moments is what it is on an even grid."""
    names = Coordinates(("pelvis_x", "pelvis_z", "pelvis_pitch", "hip_left"))
    even = np.linspace(0.0, 1.0, 101)
    fine = np.unique(np.r_[even, np.linspace(0.0, 0.2, 161)])

    def spreads(t):
        q, none = np.zeros((len(t), 4)), 0.0 * t
        F_z = 100.0 + 600.0 * np.minimum(t / 0.2, 1.0)
        foot = PlanarWrench(np.column_stack([none, F_z]), -0.1 * F_z)
        at = Trial("walk", names, t, q, q, q, foot + foot, feet={"left": foot})
        at = replace(at, moments=q[:, 3:])
        movement = SimpleNamespace(
            coordinates=names,
            torque=q[:, 3:],
            grounds={"foot_left": np.zeros((len(t), 3))},
        )
        terms = [
            *ground_terms(movement, at, InteractionNoise()),
            *torque_terms(movement, at, InteractionNoise()),
        ]
        return [terms[1].sigma[-1, 0], terms[2].sigma[-1, 0]]

    np.testing.assert_allclose(spreads(fine), spreads(even), rtol=0.005)


def test_phase_a_minimises_torques(phase_a):
    torque = phase_a.movement.torque
    for k in range(6):
        expected = 0.5 * phase_a.T * (900.0 / 3000.0) ** 2
        found = phase_a.bend(torque[:, k], 900.0)
        assert found == pytest.approx(expected, rel=1e-6)
    still = [(torque, -phase_a.x[phase_a.place(torque)])]
    assert phase_a(*still) < phase_a(*still, (torque[:, 0], 1.0))
    assert phase_a(*still) < phase_a(*still, (torque[:, 0], -1.0))


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["phase_b", "phase_c"])
def test_joint_moments_are_tracked(request, phase):
    cost = request.getfixturevalue(phase)
    for k in range(6):
        tracked(cost, cost.movement.torque[:, k], SIGMA_M[k], 2.0 * SIGMA_M[k])


def test_moments_of_a_leg_are_known_the_better_the_less_it_bears():
    """Within 0.1 s of load; never better than to 3 %; none of toes."""
    joints = ("hip", "knee", "ankle", "toes")
    hinges = [f"{j}_{side}" for side in ("left", "right") for j in joints]
    names = Coordinates(("pelvis_x", "pelvis_z", "pelvis_pitch", *hinges))
    times = np.linspace(0.0, 1.0, 21)
    q, weight = np.zeros((21, len(names))), np.full(21, 700.0)
    left = np.where(times < 0.5, 0.25, 0.0) * weight
    wrenches = [
        PlanarWrench(np.column_stack([0.0 * f, f]), 0.1 * f)
        for f in (weight, left, weight - left)
    ]
    feet = dict(zip(("left", "right"), wrenches[1:], strict=True))
    at = Trial(
        *("walk", names, times, q, q, q, wrenches[0]),
        feet=feet,
        moments=q[:, 3:],
    )
    movement = SimpleNamespace(coordinates=names, torque=q[:, 3:])
    (term,) = torque_terms(movement, at, InteractionNoise(moment_nm=8.0))
    early, late = times < 0.54, times > 0.56
    for k, joint in enumerate(joints[:3]):
        own, other = term.sigma[:, k], term.sigma[:, 4 + k]
        np.testing.assert_allclose(own[early], 0.25 * 8.0, err_msg=joint)
        np.testing.assert_allclose(own[late], 0.03 * 8.0)
        np.testing.assert_allclose(other[times < 0.39], 0.75 * 8.0)
        np.testing.assert_allclose(other[times > 0.41], 8.0)
    assert np.isinf(term.sigma[:, [3, 7]]).all()
    # A device's joint is of the leg that it is beside, whatever its name.
    rows = (tuple(float(k == 4) for k in range(8)),)
    worn = Coordinates((*names.names[:4], "m_left", *hinges[1:]), ("m_left",))
    q = np.zeros((21, len(worn)))
    worn, q = replace(worn, coupling=rows), np.zeros((21, len(worn)))
    own = {"coordinates": worn, "q": q, "v": q, "a": q, "moments": q[:, 3:]}
    at = replace(at, **own)
    movement = SimpleNamespace(coordinates=worn, torque=q[:, 3:])
    (term,) = torque_terms(movement, at, InteractionNoise(exo_moment_nm=2.0))
    np.testing.assert_allclose(term.sigma[times > 0.41, 1], 2.0)


@pytest.mark.slow
def test_normal_forces_are_tracked_where_mats_are(phase_b, phase_c, trial):
    (seen,) = trial.cuffs
    tracked(phase_b, phase_b.movement.cuffs[seen][:, 1], 3.0, 8.0)
    for cost in (phase_b, phase_c):
        for cuff, forces in cost.movement.cuffs.items():
            for k in range(3):
                if cost is phase_b and (cuff, k) == (seen, 1):
                    continue
                assert cost.bend(forces[:, k], 9.0) == pytest.approx(0.0)


@pytest.mark.slow
def test_a_prediction_tracks_no_movement(phase_c):
    for variables in (phase_c.movement.grid.q, phase_c.movement.grid.v):
        for k in range(9):
            assert abs(phase_c.bend(variables[1:-1, k], 0.01)) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("phase", ["phase_a", "phase_b", "phase_c"])
def test_jerk_is_minimised(request, phase):
    cost = request.getfixturevalue(phase)
    jerk = cost.movement.grid.jerk
    expected = 0.5 * cost.T * (30.0 / 150.0) ** 2
    for k in range(9):
        assert cost.bend(jerk[:, k], 30.0) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_typical_jerk_is_that_of_what_calibrates(in_device, trial):
    """Of the human's joints; half in a prediction, and never its trial's."""
    a = np.zeros_like(trial.a)
    names = trial.coordinates
    for joint, size in (("knee", 3.0), ("hip", 4.0), ("exo_hip", 100.0)):
        a[:, names.index(joint)] = size * np.sin(20.0 * trial.times)
    moved = replace(trial, a=a)
    expected = 3.0 * 20.0 * np.sqrt((3.0**2 + 4.0**2) / 3.0 / 2.0)
    model, contact = in_device.model, in_device.contact
    for posed in (
        FootGroundCalibration(model, [moved]),
        InteractionCalibration(model, [moved], contact),
    ):
        assert posed.contact.jerk == pytest.approx(expected, rel=0.1)
        assert posed.jerk == posed.contact.jerk
    told = replace(contact, jerk=33.0)
    assert PredictionProblem(model, [moved], told).jerk == 16.5
    still = replace(trial, a=np.zeros_like(trial.a))
    assert typical_jerk([still]) == TYPICAL_JERK


def energies(in_device, cost) -> dict[str, np.ndarray]:
    """Of each cuff's components (n, 3) [J], from simulated cuffs at rest."""
    q = cost.x[cost.place(cost.movement.grid.q)]
    bushings = cost.problem.contact.bushings
    cuffs = {c: Cuff(b) for c, b in bushings.items()}
    forces = interaction(in_device.model.tree, cuffs, q, 0.0 * q)[0]
    return {
        c: f.components**2 / (2.0 * np.array(bushings[c].stiffness))
        for c, f in forces.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["b", "c", "comfort"])
def test_contact_energy_is_minimised(in_device, trial, kind):
    """Squared, of what no mat measures in Phase B, of all in Phase C."""
    make, more = prediction_cost, {}
    if kind == "b":
        make = interaction_cost
    if kind == "comfort":
        more = {"objective": "comfort"}
    small = make(in_device, trial, 0.02, **more)
    large = make(in_device, trial, 1e9, **more)
    large.x[:] = small.x
    weights = np.full(len(small.at.times), 1.0)
    weights *= small.T / (len(weights) - 1)
    weights[[0, -1]] *= 0.5
    expected = 0.0
    for cuff, E in energies(in_device, small).items():
        if kind == "b" and cuff in trial.cuffs:
            E = E[:, [0, 2]]
        expected += 0.5 * weights @ np.sum((E / 0.02) ** 2, axis=1)
    assert expected > 0.1
    assert small() - large() == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_comfort_minimises_torques_and_tracks_nothing(in_device, trial):
    cost = prediction_cost(in_device, trial, 1e9, objective="comfort")
    assert abs(cost.bend(cost.movement.ground, 10.0)) < 1e-9
    expected = 0.5 * cost.T * 6 * (900.0 / 3000.0) ** 2
    assert cost.bend(cost.movement.torque, 900.0) == pytest.approx(expected)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["b", "c"])
def test_errors_shift_what_was_measured(in_device, trial, kind):
    """And cost their own prior; what they do is tested elsewhere."""
    sizes = ErrorSizes(encoder_offset_deg=2.0, mat_offset_n=3.0)
    make = interaction_cost if kind == "b" else prediction_cost
    cost = make(in_device, trial, 1e9, sizes)
    errors = cost.problem.errors
    variables = cost.problem.error_variables
    by = errors.effects(cost.at)
    w = np.full(len(cost.at.times), cost.T / (len(cost.at.times) - 1))
    w[[0, -1]] *= 0.5
    kinematic = w
    if kind == "c":  # ends alone, each as a second
        kinematic = np.zeros(len(w))
        kinematic[[0, -1]] = 1.0
    for k, unknown in enumerate(errors.unknowns):
        d = unknown.sd
        expected = 0.5 * (d / unknown.sd) ** 2
        turn = foot_turn(in_device.model.tree)
        for effect, sigma, shared, weights in (
            (by.q, SIGMA_Q, turn * SIGMA_Q[2], kinematic),
            (by.v, SIGMA_V, turn * SIGMA_V[2], kinematic),
            (by.moments, SIGMA_M, 0.0 * SIGMA_M, w),
        ):
            off = d * effect[:, :, k]
            covariance = np.diag(sigma**2) + np.outer(shared, shared)
            square = np.sum(off * np.linalg.solve(covariance, off.T).T, axis=1)
            expected += 0.5 * weights @ square
        if kind == "b":
            for normal in by.normal.values():
                expected += 0.5 * w @ (d * normal[:, k] / 3.0) ** 2
        found = cost.bend(variables[[k]], d)
        assert found == pytest.approx(expected, rel=1e-6), unknown.name


def test_the_foot_alone_turns(in_device):
    tree = in_device.model.tree
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (1, len(tree.coordinates)))
    moved = q + 0.1 * foot_turn(tree)
    for link in tree.names:
        turned = tree.body_angles(moved, link) - tree.body_angles(q, link)
        on_foot = (
            tree.segment_of[tree.body_index(link)]
            == tree.segment_of[tree.body_index(tree.root)]
        )
        assert turned == pytest.approx(0.1 if on_foot else 0.0, abs=1e-12)


@pytest.mark.parametrize("huge", [1.0, 1e9, 1e60])
def test_a_noise_may_be_so_large_that_nothing_is_tracked(in_device, huge):
    """From 1e8 deg on, the sum of noises of all joints was no number."""
    tree = in_device.model.tree
    sigma = SIGMA_Q.copy()
    sigma[3:6] *= huge  # of the person's joints
    movement, none = SimpleNamespace(tree=tree), np.zeros((1, len(sigma)))
    term = _against_the_foot(
        movement, none, none, sigma, "position", none[..., None]
    )
    turn = foot_turn(tree) * sigma[2] / sigma
    weighed = term.rows[0] * (sigma / sigma[:, None])
    np.testing.assert_allclose(
        weighed.T @ weighed @ (np.eye(len(sigma)) + np.outer(turn, turn)),
        np.eye(len(sigma)),
        atol=1e-9,
    )


@pytest.mark.slow
def test_priors_of_cuffs_are_those_of_the_settings(in_device, trial):
    """Within a factor of 2, and within 15 mm, are two of three."""
    cost = interaction_cost(in_device, trial, 1e9)
    values = cost.problem.contact.values()
    for name, prior in (
        ("thigh.normal_stiffness", None),
        ("shank.origin_x", 0.015),
    ):
        variables = cost.problem.variables_of([name])
        start = {p.name: p.nominal for p in cost.problem.parameters}[name]
        assert values[name] is not None
        if prior is None:
            found = cost((variables, start)) - cost()  # twice as stiff
        else:
            found = cost((variables, prior)) - cost()
        assert found == pytest.approx(0.5)


def test_priors_of_a_foot_are_spans_over_the_root_of_their_weight(
    human, defaults
):
    for p in replace(defaults, prior_weight=0.04).parameters(human.spheres):
        assert p.prior_sd == pytest.approx(5.0 * p.span)


def test_a_phase_that_scales_cuffs_scales_damping_too(in_device):
    """C2: stiffness and damping alike, places and preload not."""
    scaled = in_device.contact.scaled(1.4)
    for name, usual in in_device.contact.bushings.items():
        for key, value in vars(usual).items():
            factor = 1.4 if key.endswith(("_stiffness", "_damping")) else 1.0
            found = getattr(scaled.bushings[name], key)
            assert found == pytest.approx(factor * value, abs=1e-12), key
    assert scaled.ground == in_device.contact.ground


@pytest.mark.parametrize("factor", [1.0, 1.4])
def test_the_law_of_a_prediction_has_the_scaled_damping(in_device, factor):
    """A rate alone gives the damper's force, in the program itself."""
    made = in_device
    contact = made.contact.scaled(factor)
    settings = PredictionSettings(solver=SOLVER, errors=NO_ERRORS)
    problem = PredictionProblem(made.model, made.trials[:1], contact, settings)
    tree = made.model.tree
    (q,), v = made.trials[0].q[:1], np.linspace(-1.0, 1.0, 9)
    cuffs = {
        c: Cuff(b) for c, b in made.contact.scaled(factor).bushings.items()
    }
    moving, still = (
        interaction(tree, cuffs, q[None], rate[None])[0] for rate in (v, 0 * v)
    )
    for cuff, law in problem.laws.items():
        bushing = contact.bushings[cuff]
        values = np.r_[bushing.origin, bushing.stiffness, bushing.slip]
        x = np.r_[q, v, np.zeros(3), values][None]
        rest = np.r_[q, 0.0 * v, np.zeros(3), values][None]
        units = np.array([10.0, 10.0, 1.0])
        found = units * (law.evaluate(rest, None) - law.evaluate(x, None))[0]
        expected = (moving[cuff].components - still[cuff].components)[0]
        assert np.abs(expected[:2]).max() > 1.0
        np.testing.assert_allclose(np.abs(found), np.abs(expected), rtol=1e-9)


def test_ends_are_near_what_was_measured(in_device, trial):
    """Joints near what was measured; the foot by 10 mm, 5 mm, 2 degrees."""
    cost = interaction_cost(in_device, trial, 1.0)
    grid, at = cost.movement.grid, cost.at
    prog = cost.problem.program.prog
    low, high = np.full((2, prog.num_vars()), np.inf) * [[-1.0], [1.0]]
    for b in prog.bounding_box_constraints():
        i = prog.FindDecisionVariableIndices(b.variables())
        low[i] = np.maximum(low[i], b.evaluator().lower_bound())
        high[i] = np.minimum(high[i], b.evaluator().upper_bound())
    foot = [0.01, 0.005, 2.0 * DEGREE]
    for node in (0, -1):
        reach = np.r_[foot, np.full(6, 0.3)]
        i = cost.place(grid.q[node])
        np.testing.assert_allclose(low[i], at.q[node] - reach, atol=1e-12)
        np.testing.assert_allclose(high[i], at.q[node] + reach, atol=1e-12)
        i = cost.place(grid.v[node])
        v = at.v[node, 3:]
        np.testing.assert_allclose(low[i[3:]], v - 0.3, atol=1e-12)
        np.testing.assert_allclose(high[i[3:]], v + 0.3, atol=1e-12)
        assert np.isinf(low[i[:3]]).all()
    middle = cost.place(grid.q[1:-1])
    assert np.isinf(low[middle]).all() and np.isinf(high[middle]).all()


def test_samples_that_hardly_load_have_no_cop(in_device, trial):
    F = trial.ground.force.copy()
    F[:20, 1] = 10.0
    ground = type(trial.ground)(F, 9.9 * F[:, 1])
    light = replace(trial, ground=ground)
    settings = FootGroundSettings(
        noise=TrackingNoise(**SIGMAS), solver=Solver(50.0)
    )
    cost = Cost(FootGroundCalibration(in_device.model, [light], settings))
    loaded = cost.at.ground.force[:, 1] >= 20.0
    moments = cost.movement.ground[:, 2]
    assert abs(cost.bend(moments[~loaded], 5.0)) < 1e-9
    weights = np.full(len(loaded), cost.T / (len(loaded) - 1))
    weights[[0, -1]] *= 0.5
    mean = cost.at.ground.force[loaded, 1].mean()
    expected = 0.5 * weights[loaded].sum() * (5.0 / (0.002 * mean)) ** 2
    assert cost.bend(moments, 5.0) == pytest.approx(expected, rel=1e-6)
