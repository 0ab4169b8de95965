"""A design's program, posed at once and not solved: what stands in it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from program_bounds import bounds
from program_derivatives import check_derivatives
from worn import FORCES, FREEDOM, TORQUES_NM, as_guessed, each, norm_of
from worn import wearer as worn

from drake_exo.calibration.design import (
    DesignProblem,
    Norm,
    joint_norm,
    works,
)
from drake_exo.calibration.design_variables import (
    Variable,
    _along,
    assistance_of,
    design_of,
    design_variables,
)
from drake_exo.calibration.settings import (
    CuffFreedom,
    DesignLimits,
    DesignSettings,
    DriveLimits,
    GainFreedom,
    JointFreedom,
    Solver,
)
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.strap import (
    Assistance,
    CuffDesign,
    Design,
    Gains,
    weight_above,
)
from drake_exo.errors import InputError
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.model.plant import nominal_model

CUFFS = ("shank", "thigh", "pelvis")
KNEE = DriveLimits(torque_nm=25.0, speed_deg_s=300.0, power_w=60.0)
DRIVES = {"drives": {"exo_knee": KNEE}}
SETTINGS = DesignSettings(points=1, solver=Solver(10.0, tolerance=1e-6))
EVERYTHING = replace(SETTINGS, points=2, **FREEDOM)


@pytest.fixture(scope="module")
def model():
    return nominal_model("coupled")


@pytest.fixture(scope="module")
def wearer(model):
    return worn(model)


@pytest.fixture(scope="module")
def today(wearer):
    return as_guessed(DesignProblem([wearer], SETTINGS, held=True))


def values_of(problem, x, variables):
    return x[problem.program.indices(variables)]


def objective(problem, guess=None):
    x = problem.guess() if guess is None else guess
    return problem.compiled.objective(problem.compiled.restrict(x))


def test_a_trial_is_read_as_it_was_filled_in(wearer, today):
    """Motion and moments as they are; a cuff's forces are its springs'."""
    (own,), (found,) = wearer.trials, today.wearers["somebody"].trials
    at = own.sample(found.times)
    for what in ("q", "v", "a", "moments"):
        np.testing.assert_allclose(
            getattr(found, what), getattr(at, what), atol=1e-9
        )
    np.testing.assert_allclose(found.ground.array, at.ground.array, atol=1e-9)
    assert found.name == "rise"
    for cuff, (segment, link) in wearer.model.tree.cuffs.items():
        bushing = wearer.contact.bushings[cuff]
        tree = wearer.model.tree
        place = np.array(bushing.origin)
        # Where both halves are, in the plane; across the limb is its x.
        ends = [
            tree.point_positions(found.q, body, tuple(at))
            for body, at in (
                (segment, place),
                (link, place + np.array(bushing.preload[:2])),
            )
        ]
        size = np.hypot(*(ends[1] - ends[0]).T)
        force = found.cuffs[cuff]
        bent = np.hypot(
            force.normal / bushing.normal_stiffness,
            force.tangential / bushing.tangential_stiffness,
        )
        np.testing.assert_allclose(bent, size, atol=1e-9)


@pytest.mark.slow
def test_the_norm_is_a_cost_over_time_cuffs_and_wearers(model, wearer):
    """By hand from the forces, at today's design; two movements, two people."""
    other = worn(model, "else", duration_s=2.0)
    differ = {"thigh": 1.5}
    both = [replace(wearer, differ=differ), other]
    costs = []
    for weight in (2.0, 5.0):
        settings = replace(SETTINGS, weight=weight)
        problem = DesignProblem(both, settings, held=True)
        costs.append(objective(problem))
    x = problem.guess()
    total = duration = today = 0.0
    for part, person in zip(problem.parts, both, strict=True):
        (movement,) = part.movements
        for cuff, force in movement.cuffs.items():
            f = values_of(problem, x, force)
            factor = person.shown(cuff)
            felt = factor * np.sqrt(f[:, 1] ** 2 + 0.25 * f[:, 0] ** 2)
            total += movement.grid.quadrature @ felt**8
            # The scale is of the forces that the wearer comes with.
            (own,) = person.trials
            given = own.cuffs[cuff]
            felt = factor * np.hypot(given.normal, 0.5 * given.tangential)
            today += np.trapezoid(felt**8, own.times)
            duration += own.duration
    scale = (today / duration) ** (1.0 / 8.0)
    expected = 0.5 * 3.0 * total / duration / scale**8
    assert costs[1] - costs[0] == pytest.approx(expected)
    assert scale > 5.0


def test_effort_is_of_the_person_alone(wearer):
    """Half the mean square of each joint's moment by what is typical."""
    costs = [
        objective(
            DesignProblem(
                [wearer],
                # Forces hardly count: their cost would hide the last digits.
                replace(SETTINGS, effort_nm=nm, response="free", weight=1e-3),
                held=True,
            )
        )
        for nm in (100.0, 200.0)
    ]
    problem = DesignProblem([wearer], SETTINGS, held=True)
    (movement,) = problem.parts[0].movements
    torque = values_of(problem, problem.guess(), movement.torque)
    names = wearer.model.coordinates
    human = [names.joint(j) for j in ("ankle", "knee", "hip")]
    square = movement.grid.quadrature @ (torque[:, human] ** 2)
    expected = 0.5 * square.sum() * (1.0 / 100.0**2 - 1.0 / 200.0**2)
    assert costs[0] - costs[1] == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_what_changes_nothing_hardly_costs(wearer):
    """Half a thousandth by a variable's typical size."""
    # Of a movement that is tracked the cost would hide the last digits.
    problem = DesignProblem(
        [wearer], replace(SETTINGS, response="free", weight=1e-3)
    )
    base = objective(problem)
    for name, step in (("exo_knee.factor_at_0_deg", 0.2),):
        x = problem.guess()
        (v,) = (v for v in problem.design if v.name == name)
        x[problem.program.indices(np.array([problem.variables[name]]))] += step
        off = objective(problem, x) - base
        assert off == pytest.approx(0.5e-3 * (step / v.size) ** 2, rel=1e-6)


def test_the_own_movement_is_kept_by_angles_and_feet(wearer):
    """One standard deviation off at a node costs half of the node's time."""
    settings = replace(SETTINGS, own_angle_deg=0.5)
    problem = DesignProblem([wearer], settings, held=True)
    (movement,) = problem.parts[0].movements
    grid, x = movement.grid, problem.guess()
    Q, b, _ = problem.program.quadratic_cost()
    k = 7
    for what, column, size in (
        (grid.q, "hip", np.deg2rad(0.5)),
        (grid.q, "foot_pitch", np.deg2rad(0.5)),
        (grid.q, "foot_x", 1e-4),
        (grid.v, "knee", np.deg2rad(5.0)),
    ):
        i = what[[k], wearer.model.coordinates.index(column)]
        step = np.zeros(len(x))
        step[problem.program.indices(i)] = size
        cost = [
            0.5 * (x + s * step) @ (Q @ (x + s * step)) + b @ (x + s * step)
            for s in (-1.0, 0.0, 1.0)
        ]
        curved = cost[0] + cost[2] - 2.0 * cost[1]
        assert curved == pytest.approx(grid.quadrature[k], rel=1e-6), column
        # Least at the own movement.
        assert cost[2] - cost[0] == pytest.approx(0.0, abs=1e-6 * curved)


def test_what_is_tracked_costs_half_its_square(wearer):
    """Summed by hand over nodes and signals; at its target it is nothing."""
    problem = DesignProblem([wearer], SETTINGS, held=True)
    (movement,) = problem.parts[0].movements
    x = problem.guess()
    assert not values_of(problem, x, movement.grid.jerk).any()
    Q, b, c = problem.program.quadratic_cost()
    expected = 0.0
    for term in movement.tracked:
        z = values_of(problem, x, term.variables)
        for k, weight in enumerate(movement.grid.quadrature):
            off = (term.rows[k] @ z[k] - term.target[k]) / term.sigma[k]
            expected += 0.5 * weight * np.sum(off**2)
    found = 0.5 * x @ (Q @ x) + b @ x + c
    # Large squares of targets and signals cancel.
    large = abs(c) + abs(b @ x)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-13 * large)
    assert large > 10.0 * abs(expected)


def test_a_program_s_constraints_hold_today(wearer, today):
    """But for the grid's: the drawn movement is no solution of it."""
    problem = DesignProblem(
        [wearer],
        replace(EVERYTHING, limits=DesignLimits(pressure_kpa=5.0, **DRIVES)),
        today=today,
    )
    x = problem.guess()
    checked = set()
    for batch in problem.program.constraints:
        kinds = ("as designed", "assistance", "migration", "pressure", "power")
        if batch.name.endswith(kinds):
            values = batch.kernel.evaluate(x[batch.indices], batch.data)
            np.testing.assert_allclose(values, 0.0, atol=1e-9)
            checked.add(batch.name.split()[-1])
    wanted = {"designed", "assistance", "migration", "pressure", "power"}
    assert checked == wanted


@pytest.mark.slow
def test_derivatives_of_the_program(wearer, today):
    limits = replace(
        SETTINGS.limits, pressure_kpa=3.0, mean_n=9.0, rate_n_s=50.0, **DRIVES
    )
    problem = DesignProblem(
        [wearer], replace(EVERYTHING, limits=limits), today=today
    )
    compiled = problem.compiled
    y = compiled.restrict(problem.guess())
    off = 1e-3 * np.random.default_rng(1).standard_normal(len(y))
    check_derivatives(compiled, y + off, tolerance=1e-4)


def test_torques_over_the_movement_are_a_spline_s(wearer):
    """As a design gives them that is made of the same values."""
    over = replace(SETTINGS, assistance_over="movement", points=5)
    problem = DesignProblem([wearer], over)
    (part,) = problem.parts
    (movement,) = part.movements
    values = {
        f"{joint}.factor_at_{k + 1}_of_5": factor
        for joint in ("exo_knee", "exo_hip")
        for k, factor in enumerate((1.0, 1.3, 0.8, 1.1, 0.7))
    }
    x = problem.guess(values)
    design = design_of(values)
    (own,) = wearer.trials
    at = own.sample(movement.grid.times)
    device = wearer.model.coordinates.device_columns
    torques = design.torques(
        wearer.model.coordinates.device,
        at.moments[:, wearer.model.coordinates.is_device_joint],
        at.q[:, device],
        at.v[:, device],
        movement.grid.times / 1.5,
    )
    for i, joint in enumerate(wearer.model.coordinates.device):
        j = wearer.model.coordinates.joint(joint)
        x[problem.program.indices(movement.torque[:, j])] = torques[:, i]
    found = [
        b for b in problem.program.constraints if b.name.endswith("assistance")
    ]
    assert len(found) == 2
    for batch in found:
        off = batch.kernel.evaluate(x[batch.indices], batch.data)
        np.testing.assert_allclose(off, 0.0, atol=1e-9)
    # Friction is as it was.
    ankle = movement.torque[:, wearer.model.coordinates.joint("exo_ankle")]
    lower, upper = bounds(problem, ankle)
    np.testing.assert_allclose(lower, at.moment("exo_ankle"))
    np.testing.assert_allclose(upper, at.moment("exo_ankle"))
    problem.compiled  # noqa: B018
    assert 0.0 < problem.build_seconds < 60.0


def test_limits_are_on_what_is_felt(wearer, today):
    """By factor on today's, or in N; across the limb as mats show it."""
    limits = DesignLimits(
        normal_n=40.0,
        shear_n=30.0,
        moment_nm=3.0,
        moment_factor=1.2,
        shear_factor=0.9,
        effort_factor=1.1,
        migration_mm=4.0,
        pressure_kpa=6.0,
    )
    freedom = dict.fromkeys(CUFFS, CuffFreedom(area_m2=0.012))
    settings = replace(SETTINGS, limits=limits, cuffs=freedom)
    seen = replace(wearer, differ={"thigh": 2.0})
    problem = DesignProblem([seen], settings, today=today)
    (part,) = problem.parts
    (movement,) = part.movements
    before = each(today.wearers["somebody"], "largest_force")
    slid = each(today.wearers["somebody"], "largest_deflection")
    for cuff, force in movement.cuffs.items():
        factor = seen.shown(cuff)
        along, _, moment = before[cuff]
        most = [min(30.0, 0.9 * along), 40.0 / factor, min(3.0, 1.2 * moment)]
        lower, upper = bounds(problem, force)
        np.testing.assert_allclose(upper, np.tile(most, (len(force), 1)))
        np.testing.assert_allclose(lower, -upper)
        far = max(4e-3, slid[cuff][0])
        lower, upper = bounds(
            problem, part._limited["migration", cuff, movement.name]
        )
        np.testing.assert_allclose(
            (lower, upper), (0 * upper - far, 0 * upper + far)
        )
        lower, upper = bounds(
            problem, part._limited["pressure", cuff, movement.name]
        )
        np.testing.assert_allclose(upper, 6.0 / factor)
        np.testing.assert_allclose(lower, -6.0 / factor)
    names = wearer.model.coordinates
    for joint in ("ankle", "knee", "hip"):
        lower, upper = bounds(problem, movement.torque[:, names.joint(joint)])
        (own,) = today.wearers["somebody"].trials
        most = 1.1 * np.abs(own.moment(joint)).max()
        np.testing.assert_allclose(
            (lower, upper), (0 * upper - most, 0 * upper + most)
        )


def test_one_who_is_drawn_need_not_feel_less_than_today(wearer, today):
    limits = DesignLimits(normal_n=0.1, pressure_kpa=0.01, moment_factor=0.5)
    seen = replace(wearer, is_drawn=True)
    problem = DesignProblem(
        [seen], replace(SETTINGS, limits=limits), today=today
    )
    (part,) = problem.parts
    (movement,) = part.movements
    for cuff, most in each(today.wearers["somebody"], "largest_force").items():
        _, upper = bounds(problem, movement.cuffs[cuff])
        np.testing.assert_allclose(
            upper[:, 1:], np.tile(most[1:], (len(upper), 1))
        )
        _, upper = bounds(
            problem, part._limited["pressure", cuff, movement.name]
        )
        # N on 100 cm^2 to kPa.
        np.testing.assert_allclose(upper, 0.1 * most[1])


def test_pressure_and_migration_are_filled_in(wearer, today):
    """kPa on the cuff's area, and how far it slides [m]."""
    cuffs = dict.fromkeys(CUFFS, CuffFreedom(area=(0.5, 2.0), area_m2=0.02))
    limits = DesignLimits(pressure_kpa=5.0)
    settings = replace(SETTINGS, cuffs=cuffs, limits=limits)
    problem = DesignProblem([wearer], settings, today=today)
    x = problem.guess({"thigh.area": 1.6})
    (part,) = problem.parts
    (movement,) = part.movements
    for cuff, share in (("thigh", 1.6), ("shank", 1.0)):
        f = values_of(problem, x, movement.cuffs[cuff])
        p = values_of(
            problem, x, part._limited["pressure", cuff, movement.name]
        )
        np.testing.assert_allclose(p[:, 0], 1e-3 * f[:, 1] / (0.02 * share))
        d = values_of(
            problem, x, part._limited["migration", cuff, movement.name]
        )
        k = share * wearer.contact.bushings[cuff].tangential_stiffness
        np.testing.assert_allclose(d[:, 0], f[:, 0] / k, atol=1e-12)


def least_room(problem, x, ending):
    """Of the linear rows whose name ends so, within their bounds."""
    prog = problem.program.prog
    rooms = []
    for c in (*prog.linear_constraints(), *prog.linear_equality_constraints()):
        law = c.evaluator()
        if law.get_description().endswith(ending):
            values = law.GetDenseA() @ values_of(problem, x, c.variables())
            rooms += [values - law.lower_bound(), law.upper_bound() - values]
    return np.concatenate(rooms).min()


@pytest.mark.slow
def test_mean_and_rate_of_a_cuff_s_force_have_limits(wearer, today):
    """As mats would show them; over trials of any length, each once."""
    first = replace(wearer.trials[0], name="first")
    more = worn(wearer.model, duration_s=3.0).trials[0]
    both = replace(
        wearer,
        trials=(first, replace(more, name="second")),
        differ={"thigh": 2.0},
    )
    before = as_guessed(DesignProblem([both], SETTINGS, held=True))
    limits = DesignLimits(mean_n=12.0, rate_n_s=40.0)
    settings = replace(SETTINGS, limits=limits)
    for drawn in (False, True):
        who = replace(both, is_drawn=drawn)
        problem = DesignProblem([who], settings, today=before)
        (part,) = problem.parts
        x = problem.guess()
        own = before.wearers["somebody"]
        for cuff in CUFFS:
            most = np.array([12.0, 40.0]) / both.shown(cuff)
            means, rates = [], []
            for trial, movement in zip(own.trials, part.movements, strict=True):
                at = trial.sample(movement.grid.times)
                force = at.cuffs[cuff].normal
                rates.append(np.diff(force) / np.diff(at.times))
                rate = part._limited[
                    "rate of normal force", cuff, movement.name
                ]
                found = values_of(problem, x, rate)[:, 0]
                np.testing.assert_allclose(found, rates[-1], atol=1e-9)
                w = movement.grid.quadrature
                means.append(w @ np.abs(force) / trial.duration)
            mean = part._means[cuff]
            assert values_of(problem, x, mean) == pytest.approx(np.mean(means))
            largest = max(np.abs(r).max() for r in rates)
            if drawn:
                most = np.maximum(most, [own.mean_force(cuff), largest])
                assert own.largest_rate(cuff) == pytest.approx(largest)
            np.testing.assert_allclose(
                np.ravel(bounds(problem, mean)), [0.0, most[0]]
            )
            lower, upper = bounds(problem, rate)
            np.testing.assert_allclose(upper, most[1], rtol=1e-9)
            np.testing.assert_allclose(lower, -upper)
        # What stands in the rows is what was filled in.
        for ending in ("rate of normal force", "mean normal force", "size"):
            assert least_room(problem, x, ending) > -1e-9
        # A size is no less than its force, which pulls or pushes.
        for cuff in CUFFS:
            for movement in part.movements:
                size = part._limited["size", cuff, movement.name]
                x[problem.program.indices(size)] *= 0.99
            assert least_room(problem, x, f"{cuff} size") < -0.01


def test_a_drive_has_limits_and_friction_is_not_the_drive_s(wearer, today):
    device = Device(knee=JointDrive(coulomb_nm=2.0))
    with_friction = replace(wearer, device=device)
    settings = replace(SETTINGS, limits=DesignLimits(**DRIVES))
    problem = DesignProblem([with_friction], settings, today=today)
    (part,) = problem.parts
    (movement,) = part.movements
    at = wearer.trials[0].sample(movement.grid.times)
    names = wearer.model.coordinates
    place = names.device.index("exo_knee")
    friction = with_friction.passive(at)[:, place]
    assert np.abs(friction).max() > 1.0
    lower, upper = bounds(problem, movement.torque[:, names.joint("exo_knee")])
    np.testing.assert_allclose(lower, friction - 25.0)
    np.testing.assert_allclose(upper, friction + 25.0)
    rate = movement.grid.v[:, names.index("exo_knee")]
    _, upper = bounds(problem, rate)
    np.testing.assert_allclose(upper, np.deg2rad(300.0))
    power = part._limited["power", "exo_knee", movement.name]
    lower, upper = bounds(problem, power)
    np.testing.assert_allclose((lower, upper), (0 * upper - 60, 0 * upper + 60))
    x = problem.guess()
    torque = values_of(problem, x, movement.torque[:, names.joint("exo_knee")])
    np.testing.assert_allclose(
        values_of(problem, x, power)[:, 0],
        (torque - friction) * values_of(problem, x, rate),
        atol=1e-12,
    )


def test_limits_on_drives_that_cannot_be_are_refused(wearer, today):
    for limits, said in (
        ({"knee": KNEE}, "device has no such joint; it has exo_ankle"),
        ({"exo_ankle": DriveLimits(0.1)}, "up to 0.495 N m, which the design"),
    ):
        settings = replace(SETTINGS, limits=DesignLimits(drives=limits))
        with pytest.raises(InputError, match=said):
            DesignProblem([wearer], settings, today=today)


def test_the_device_does_the_work_that_it_is_told_to(wearer, today):
    """Its torques on the way of today; within the limit."""
    settings = replace(SETTINGS, limits=DesignLimits(support=0.02))
    problem = DesignProblem([wearer], settings, today=today, support=0.8)
    (part,) = problem.parts
    (movement,) = part.movements
    (own,) = wearer.trials
    job = {}
    for joint in TORQUES_NM:
        at = own.sample(movement.grid.times)
        power = at.moment(joint) * at.velocity(joint)
        job[joint] = movement.grid.quadrature @ power
    assert part.work([own]) == pytest.approx(sum(job.values()))
    more = own.moments.copy()
    more[:, own.coordinates.joint("exo_knee")] *= 1.2
    # Where the device goes instead is no support.
    strayed = replace(own, moments=more, v=2.0 * own.v)
    assert part.work([strayed]) - sum(job.values()) == pytest.approx(
        0.2 * job["exo_knee"]
    )
    (lower,), (upper,) = bounds(problem, part._total)
    whole = sum(job.values())
    assert (lower, upper) == pytest.approx(
        (0.8 * whole - 0.02 * abs(whole), 0.8 * whole + 0.02 * abs(whole))
    )
    x = problem.guess({"exo_knee.factor_at_0_deg": 1.2})
    total = values_of(problem, x, part._total)[0]
    assert total == pytest.approx(whole + 0.2 * job["exo_knee"])
    (binding,) = (
        b
        for b in problem.program.prog.linear_equality_constraints()
        if b.evaluator().get_description() == "somebody work"
    )
    A, e = binding.evaluator().GetDenseA(), binding.evaluator()
    i = problem.program.indices(np.asarray(binding.variables()))
    np.testing.assert_allclose(A @ x[i], e.upper_bound())
    # By the trapezoid rule it is nearly the same.
    assert own.device_work == pytest.approx(whole, rel=6e-6)
    assert works(today)["somebody"] == pytest.approx(whole)


def test_ends_are_the_person_s_alone(wearer):
    """Where the person answers freely, both ends are given."""
    free = replace(SETTINGS, response="free")
    problem = DesignProblem([wearer], free, held=True)
    (movement,) = problem.parts[0].movements
    (own,) = wearer.trials
    at = own.sample(movement.grid.times)
    names = wearer.model.coordinates
    for variables, values in ((movement.grid.q, at.q), (movement.grid.v, at.v)):
        for name in ("ankle", "knee", "hip"):
            i = names.index(name)
            lower, upper = bounds(problem, variables[:, i])
            for k in (0, -1):
                expected = values[k, i]
                assert (lower[k], upper[k]) == pytest.approx((expected,) * 2)
            assert np.isinf(upper[1:-1]).all() or (upper[5] > lower[5])


def test_cuffs_move_with_joints_below_them(wearer, model):
    """A joint of the device that moves carries every cuff above it."""
    problem = DesignProblem([wearer], EVERYTHING, held=True)
    (part,) = problem.parts
    x = problem.guess()
    q = wearer.trials[0].q[::20]
    off = {"exo_knee.across_m": 0.01, "exo_hip.along_m": -0.02}
    for cuff in CUFFS:
        kinematics = part.bushings[cuff]
        names = [str(v.get_name()) for v in part.places(cuff)]
        places = np.array(
            [values_of(problem, x, np.array([v]))[0] for v in part.places(cuff)]
        )
        moved = places.copy()
        for name, value in off.items():
            if name in names:
                moved[names.index(name)] += value

        def deflection(places, kinematics=kinematics):
            rows = np.broadcast_to(places, (len(q), len(places)))
            return kinematics.deflection(q, kinematics.terms(q, rows))

        change = deflection(moved)[:, :2] - deflection(places)[:, :2]
        # By hand: turned as the link in which each joint is placed.
        expected = np.zeros(len(q), complex)
        tree = model.tree
        for name, value in off.items():
            if name not in names:
                continue
            joint, _, what = name.partition(".")
            link = tree.joints[joint][0]
            origin = tree.point_positions(q, link, (0.0, 0.0))
            tip = tree.point_positions(
                q, link, (value, 0.0) if what == "across_m" else (0.0, value)
            )
            expected += (tip - origin) @ [1.0, 1j]
        np.testing.assert_allclose(
            np.hypot(*change.T), np.abs(expected), atol=1e-12
        )


@pytest.mark.slow
def test_what_a_moved_joint_carries_weighs_where_it_is(wearer, model):
    """Residual forces change by the slope of the weight's potential."""
    problem = DesignProblem([wearer], EVERYTHING, held=True)
    (part,) = problem.parts
    (movement,) = part.movements
    device, g = model.exoskeleton, 9.81
    weights = {
        "exo_hip": g * device.pelvis.mass_kg,
        "exo_knee": g * (device.pelvis.mass_kg + device.thigh.mass_kg),
    }
    for joint, weight in weights.items():
        assert weight_above(model, joint) == pytest.approx(weight)
    (dynamics,) = (
        b
        for b in problem.program.constraints
        if b.name == "somebody rise dynamics"
    )
    x = problem.guess()
    for force in movement.cuffs.values():
        x[problem.program.indices(force)] = 0.0

    def residual(values):
        moved = x.copy()
        for name, value in values.items():
            v = np.array([problem.variables[name]])
            moved[problem.program.indices(v)] = value
        return dynamics.kernel.evaluate(moved[dynamics.indices], dynamics.data)

    q, tree, h = x[problem.program.indices(movement.grid.q)], model.tree, 1e-6
    for joint, what, place in (
        ("exo_hip", "across_m", (0.01, 0.0)),
        ("exo_hip", "along_m", (0.0, 0.02)),
        ("exo_knee", "across_m", (0.01, 0.0)),
        ("exo_knee", "along_m", (0.0, 0.02)),
    ):
        link = tree.joints[joint][0]

        def height(q, link=link, place=place):
            ends = (
                tree.point_positions(q, link, p) for p in (place, (0.0, 0.0))
            )
            return np.subtract(*ends)[:, 1]

        name = f"{joint}.{what}"
        change = residual({name: sum(place)}) - residual({})
        slope = np.column_stack(
            [
                (height(q + h * e) - height(q - h * e)) / (2.0 * h)
                for e in np.eye(q.shape[1])
            ]
        )
        np.testing.assert_allclose(
            100.0 * change, weights[joint] * slope, atol=1e-6
        )


def test_the_norm_by_hand():
    """Of constant forces it is the force, whatever the order."""
    t = np.linspace(0.0, 2.0, 5)

    def trial(duration, **cuffs):
        return SimpleNamespace(
            times=t * duration / 2.0,
            duration=duration,
            cuffs={
                c: SimpleNamespace(
                    normal=np.full(5, across), tangential=np.full(5, along)
                )
                for c, (along, across) in cuffs.items()
            },
        )

    settings = replace(SETTINGS, shear_weight=0.25, order=6.0)
    one = trial(2.0, thigh=(6.0, -4.0))
    assert norm_of([one], settings).newton == pytest.approx(5.0)
    design = Design({"thigh": CuffDesign(area=2.0)})
    assert norm_of([one], settings, design).newton == pytest.approx(2.5)
    shown = norm_of([one], settings, differ={"thigh": 3.0})
    assert shown.newton == pytest.approx(15.0)
    gone = Design({"shank": CuffDesign(removed=True)})
    half = norm_of([one], settings, gone)
    assert half == pytest.approx(Norm(2.0 * 5.0**6, 4.0, 6.0))
    two = norm_of([one, trial(3.0, thigh=(0.0, 2.0))], settings)
    assert two == pytest.approx(Norm(2.0 * 5.0**6 + 3.0 * 2.0**6, 5.0, 6.0))
    assert joint_norm([half, two]) == pytest.approx(
        ((4.0 * 5.0**6 + 3.0 * 2.0**6) / 9.0) ** (1.0 / 6.0)
    )
    mean = replace(settings, objective="mean")
    assert norm_of([one], mean) == pytest.approx(Norm(50.0, 2.0, 2.0))


def test_peaks_and_work_of_a_trial(wearer, today):
    (own,) = wearer.trials

    def peaks(*trials):
        worn = replace(today.wearers["somebody"], trials=list(trials))
        return each(worn, "largest_force")

    # Where all is largest lies between two samples.
    top = np.sin(np.pi * own.times / own.duration).max() ** 2
    for cuff, force in FORCES.items():
        expected = top * np.abs(force)
        np.testing.assert_allclose(peaks(own)[cuff], expected)
        twice = replace(own.cuff(cuff), normal=2.0 * own.cuff(cuff).normal)
        more = replace(own, cuffs=own.cuffs | {cuff: twice})
        np.testing.assert_allclose(
            peaks(own, more)[cuff], expected * [1.0, 2.0, 1.0]
        )
    work = sum(
        np.trapezoid(own.moment(j) * own.velocity(j), own.times)
        for j in TORQUES_NM
    )
    assert own.device_work == pytest.approx(work)


def test_largest_deflections_and_moments(wearer, today):
    """Forces over stiffness, and the person's own moments."""
    (found,) = today.wearers["somebody"].trials
    for cuff, far in each(
        today.wearers["somebody"], "largest_deflection"
    ).items():
        k = np.array(wearer.contact.bushings[cuff].stiffness)
        expected = np.abs(found.cuffs[cuff].components / k).max(axis=0)
        np.testing.assert_allclose(far, expected, rtol=1e-6, atol=1e-12)
    expected = [np.abs(found.moment(j)).max() for j in ("ankle", "knee", "hip")]
    np.testing.assert_allclose(
        today.wearers["somebody"].largest_moments, expected
    )


def test_variables_of_a_design(wearer):
    """Bounds as the settings say, sizes, and what is today."""
    freedom = CuffFreedom(
        along_m=(-0.5, 0.5),
        across_m=(-0.01, 0.02),
        preload_along_m=(-0.003, 0.004),
        area=(0.7, 1.4),
        hinge=(0.0, 0.6),
        strap_n_m=2000.0,
        strap_nm_rad=None,
    )
    joints = {"exo_hip": JointFreedom((-0.02, 0.03), (0.0, 0.01))}
    settings = replace(SETTINGS, cuffs={"thigh": freedom}, joints=joints)
    found = {v.name: v for v in design_variables([wearer], settings)}
    length = wearer.model.human.thigh.length_m
    place = wearer.contact.bushings["thigh"].origin_z
    expected = [
        # At least 5 cm from the joints at the limb's ends.
        ("thigh.along_m", "m", 0.05 - place, length - 0.05 - place, 0.0, 0.01),
        ("thigh.across_m", "m", -0.01, 0.02, 0.0, 0.01),
        ("thigh.preload_along_m", "m", -0.003, 0.004, 0.0, 0.005),
        ("thigh.preload_across_m", "m", 0.0, 0.0, 0.0, 0.005),
        ("thigh.area", "1", 0.7, 1.4, 1.0, 0.1),
        ("thigh.hinge", "1", 0.0, 0.6, 0.0, 0.1),
        ("thigh.slide", "1", 0.0, 0.0, 0.0, 0.1),
        ("thigh.strap_normal_n_m", "m/N", 0.0, 1.0 / 2000.0, 0.0, 1e-4),
        ("thigh.strap_tangential_n_m", "m/N", 0.0, 5e-4, 0.0, 1e-4),
        ("thigh.strap_rotational_nm_rad", "rad/(N m)", 0.0, 0.0, 0.0, 0.01),
        ("exo_hip.along_m", "m", -0.02, 0.03, 0.0, 0.005),
        ("exo_hip.across_m", "m", 0.0, 0.01, 0.0, 0.005),
        ("exo_knee.along_m", "m", 0.0, 0.0, 0.0, 0.005),
        ("exo_knee.factor_at_0_deg", "1", 0.7, 1.3, 1.0, 0.1),
    ]
    for name, unit, *numbers in expected:
        v = found[name]
        own = (v.lower, v.upper, v.today, v.size)
        assert (v.name, v.unit) == (name, unit)
        assert own == pytest.approx(numbers), name
    # 0.5 N m of 20 are friction.
    assert not any(n.startswith("exo_ankle.factor") for n in found)
    assert {"shank.along_m", "exo_hip.factor_at_0_deg"} <= set(found)
    # Cuffs that are near a joint's end today may stay there.
    near = replace(freedom, along_m=(0.0, 0.0))
    held = replace(settings, cuffs={"thigh": near})
    (v,) = (
        v for v in design_variables([wearer], held) if v.name == "thigh.along_m"
    )
    assert (v.lower, v.upper) == (0.0, 0.0) and not v.free


def test_a_limit_by_the_smallest_of_all_wearers(wearer):
    """A cuff that sits within 5 cm of a joint goes away from it alone."""
    cuff = wearer.contact.bushings["shank"]
    low = replace(cuff, origin_z=0.03)
    contact = replace(
        wearer.contact, bushings={**wearer.contact.bushings, "shank": low}
    )
    other = replace(wearer, name="other", contact=contact)
    (v,) = (
        v
        for v in design_variables([wearer, other], SETTINGS)
        if v.name == "shank.along_m"
    )
    length = wearer.model.human.shank.length_m
    assert v.lower == pytest.approx(0.0)
    assert v.upper == pytest.approx(min(0.1, length - 0.05 - cuff.origin_z))


def test_factors_are_over_the_range_that_a_joint_moves_in(wearer):
    (own,) = wearer.trials
    settings = replace(SETTINGS, points=3)
    names = [v.name for v in design_variables([wearer], settings)]
    knee = np.rad2deg(own.coordinate("exo_knee"))
    places = np.round(np.linspace(knee.min(), knee.max(), 3))
    for angle in places:
        assert f"exo_knee.factor_at_{angle:g}_deg" in names
    over = replace(settings, assistance_over="movement")
    names = [v.name for v in design_variables([wearer], over)]
    assert [n for n in names if n.startswith("exo_hip.factor")] == [
        f"exo_hip.factor_at_{k}_of_3" for k in (1, 2, 3)
    ]


def test_a_factor_a_little_below_zero_is_at_zero(wearer):
    (own,) = wearer.trials
    q = own.q.copy()
    knee = own.coordinates.index("exo_knee")
    q[:, knee] -= q[:, knee].min() + np.deg2rad(0.3)
    bent = replace(wearer, trials=(replace(own, q=q),))
    settings = replace(SETTINGS, points=3)
    names = [v.name for v in design_variables([bent], settings)]
    assert "exo_knee.factor_at_0_deg" in names


def test_what_no_drive_gives_has_no_factor(wearer):
    """Friction as recorded; springs and friction of a passive device."""
    (own,) = wearer.trials
    device = Device(hip=JointDrive(viscous_nm_s=20.0))
    rubs = replace(wearer, device=device)
    hip = [n.startswith("exo_hip.factor") for n in _factors(rubs)]
    assert any(hip) and not all(hip)
    moments = own.moments.copy()
    joint = own.coordinates.joint("exo_hip")
    moments[:, joint] = rubs.passive(own)[:, -1]
    assert np.abs(moments[:, joint]).max() > 10.0
    rubs = replace(rubs, trials=(replace(own, moments=moments),))
    assert {n.partition(".")[0] for n in _factors(rubs)} == {"exo_knee"}
    said = {"moments": {"exoskeleton": "device model"}}
    passive = replace(rubs, trials=(replace(own, provenance=said),))
    assert not _factors(passive)
    assert _factors(replace(passive, device=Device(carries_itself=1.0)))


def _factors(wearer):
    names = [v.name for v in design_variables([wearer], SETTINGS)]
    return [n for n in names if ".factor" in n]


def test_gains_have_their_bounds(wearer):
    free = GainFreedom((-7.0, 8.0), 15.0, 3.0)
    settings = replace(SETTINGS, assistance_over="gains", gains=free)
    found = {v.name: v for v in design_variables([wearer], settings)}
    for name, *expected in (
        ("support", 0.7, 1.3, 1.0, 0.1),
        ("constant_nm", -7.0, 8.0, 0.0, 1.0),
        ("stiffness_nm_rad", 0.0, 15.0, 0.0, 2.0),
        ("damping_nm_s_rad", 0.0, 3.0, 0.0, 0.5),
    ):
        v = found[f"exo_knee.{name}"]
        assert [v.lower, v.upper, v.today, v.size] == expected


@pytest.mark.slow
def test_a_spring_takes_work_by_the_angle_on_the_way(wearer):
    settings = replace(SETTINGS, assistance_over="gains")
    held = as_guessed(DesignProblem([wearer], settings, held=True))
    problem = DesignProblem([wearer], settings, today=held)
    (part,) = problem.parts
    (movement,) = part.movements
    (own,) = wearer.trials
    at = own.sample(movement.grid.times)
    way = movement.grid.quadrature * at.velocity("exo_knee")
    today, more = (
        values_of(problem, problem.guess(values), part._total)[0]
        for values in ({}, {"exo_knee.stiffness_nm_rad": 4.0})
    )
    assert more - today == pytest.approx(-4.0 * way @ at.coordinate("exo_knee"))


def test_a_variable_at_its_bound():
    """Within 0.5 % of the range; what cannot be less than none is at none."""

    def at_bound(name, value, lower=-0.1, upper=0.1, today=0.0):
        return Variable(name, "m", lower, upper, today, 0.01).at_bound(value)

    assert at_bound("thigh.along_m", 0.0991)
    assert at_bound("thigh.along_m", -0.0991)
    assert not at_bound("thigh.along_m", 0.0989)
    assert not at_bound("thigh.along_m", -0.0989)
    assert not at_bound("thigh.along_m", 0.0, 0.0, 0.0)  # held
    strap = "thigh.strap_normal_n_m"
    assert not at_bound(strap, 0.0, 0.0, 1e-3)
    assert at_bound(strap, 1e-3, 0.0, 1e-3)
    assert not at_bound("thigh.hinge", 0.0, 0.0, 1.0)
    assert not at_bound("thigh.hinge", 1.0, 0.0, 1.0)
    assert at_bound("thigh.hinge", 0.6, 0.0, 0.6)
    assert not at_bound("exo_hip.damping_nm_s_rad", 0.0, 0.0, 5.0)
    assert at_bound("exo_hip.damping_nm_s_rad", 5.0, 0.0, 5.0)


def test_a_design_of_values_of_all_kinds():
    values = {
        "thigh.along_m": 0.02,
        "thigh.strap_normal_n_m": 1e-4,
        "thigh.strap_tangential_n_m": 0.0,
        "thigh.area": 1.2,
        "exo_strap.area": 1.1,
        "exo_hip.across_m": 0.01,
        "exo_hip.factor_at_-20_deg": 0.9,
        "exo_hip.factor_at_30_deg": 1.1,
        "exo_knee.factor_at_1_of_2": 0.8,
        "exo_knee.factor_at_2_of_2": 1.0,
        "exo_ankle.support": 0.7,
        "exo_ankle.stiffness_nm_rad": 4.0,
    }
    found = design_of(values, ("pelvis",))
    thigh = found.cuffs["thigh"]
    assert (thigh.along_m, thigh.area) == (0.02, 1.2)
    assert thigh.strap_normal_n_m == pytest.approx(1e4)
    assert thigh.strap_tangential_n_m is None
    assert found.cuffs["exo_strap"].area == 1.1  # of an own device
    assert found.removed == ("pelvis",)
    assert found.joints["exo_hip"].across_m == 0.01
    assert found.assistance == {
        "exo_hip": Assistance((-20.0, 30.0), (0.9, 1.1)),
        "exo_knee": Assistance((), (0.8, 1.0), "movement"),
    }
    assert found.gains == {"exo_ankle": Gains(0.7, stiffness_nm_rad=4.0)}
    assert assistance_of({"factor_at_0_deg": 1.0}) == Assistance()


def test_nothing_changed_is_no_design(wearer):
    values = {v.name: v.today for v in design_variables([wearer], SETTINGS)}
    design = design_of(values)
    contact = wearer.contact
    assert design.contact(contact).values() == contact.values()
    assert design.assistance["exo_knee"].factor == (1.0,)


def test_a_cuff_of_one_of_two_legs_stays_on_its_limb(model, wearer):
    both = SimpleNamespace(
        model=SimpleNamespace(
            human=model.human,
            tree=SimpleNamespace(cuffs={"left": ("thigh_left", "bar")}),
        ),
        contact=SimpleNamespace(
            bushings={"left": wearer.contact.bushings["thigh"]}
        ),
    )
    wanted = (-1.0, 1.0)
    assert _along("left", [both], wanted) == _along("thigh", [wearer], wanted)
    # A foot lies across: its strap stays between sole and ankle.
    both.model.tree.cuffs["left"] = ("foot_left", "plate")
    strap = BushingParameters(origin_z=-0.04)
    both.contact.bushings["left"] = strap
    lower, upper = _along("left", [both], wanted)
    assert lower == pytest.approx(0.04 - model.human.ankle_height_m)
    assert upper == pytest.approx(0.04)
