"""Phase D: better cuffs for wearers of known truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse
from worn import FREEDOM, each, norm_of

from drake_exo.calibration import design as posed
from drake_exo.calibration.design import DesignProblem, works
from drake_exo.calibration.design_variables import GAINS, design_variables
from drake_exo.calibration.error_model import NO_ERRORS
from drake_exo.calibration.settings import (
    CuffFreedom,
    DesignLimits,
    DesignSettings,
    DriveLimits,
    Population,
    PredictionSettings,
    Solver,
)
from drake_exo.calibration.wearers import (
    OwnMovement,
    Wearer,
    answer,
    assisted,
    check_population,
    sized,
)
from drake_exo.contact.bushing import BushingKinematics
from drake_exo.contact.parameters import Posterior
from drake_exo.contact.strap import Assistance, CuffDesign, Design, JointDesign
from drake_exo.designed import Designed
from drake_exo.designing import fewer
from drake_exo.errors import InputError
from drake_exo.measurement.settings import Device, JointDrive

pytestmark = pytest.mark.slow

SOLVER = Solver(20.0, tolerance=1e-6)
SETTINGS = DesignSettings(
    draws=0, points=1, solver=SOLVER, limits=DesignLimits(migration_mm=10.0)
)
EVERYTHING = replace(SETTINGS, **FREEDOM)
_DRIVE_NM = {"exo_knee": -20.0, "exo_hip": -12.0}


def phase():
    return PredictionSettings(solver=SOLVER, guess="data", errors=NO_ERRORS)


@pytest.fixture(scope="module")
def driven(in_device):
    """The first rise with a device that bears a part of it."""
    trial = in_device.trials[0]
    names, moments = trial.coordinates, trial.moments.copy()
    s = np.sin(np.pi * trial.times / trial.duration) ** 2
    for joint, nm in _DRIVE_NM.items():
        moments[:, names.joint(joint)] += nm * s
        moments[:, names.joint(names.follows(joint))] -= nm * s
    return replace(trial, moments=moments)


def moved(in_device, trial, contact=None):
    posed = OwnMovement(
        in_device.model, [trial], contact or in_device.contact, phase()
    )
    result = posed.solve()
    assert result.success
    return result.trials[0]


@pytest.fixture(scope="module")
def wearer(in_device, driven):
    return Wearer(
        "somebody",
        in_device.model,
        in_device.contact,
        (moved(in_device, driven),),
    )


@pytest.fixture(scope="module")
def today(wearer):
    result = DesignProblem.of_today([wearer], SETTINGS).solve()
    assert result.solution.success
    return result


@pytest.fixture(scope="module")
def found(wearer, today):
    result = DesignProblem([wearer], SETTINGS, today=today).solve()
    assert result.solution.success
    return result


def test_a_passive_device_moves_as_it_did(in_device):
    """Own movement on the true cuffs gives back the forces of the data."""
    trial = in_device.trials[0]
    found = moved(in_device, trial)
    for cuff, force in trial.cuffs.items():
        own = force.normal - found.sample(trial.times).cuffs[cuff].normal
        assert np.abs(own).max() < 1.5


def test_today_is_the_own_movement(today, wearer):
    (own,), (again,) = wearer.trials, today.wearers["somebody"].trials
    for cuff, force in own.cuffs.items():
        np.testing.assert_allclose(
            again.cuffs[cuff].normal, force.normal, atol=0.1
        )


def test_a_cuff_that_is_left_out_is_one_without_springs(in_device, driven):
    """In the own movement, and in the program of a design."""
    contact = in_device.contact.scaled(4.0)  # two of them hold the device
    none = dict.fromkeys(
        (
            f"{what}_{kind}"
            for what in ("tangential", "normal", "rotational")
            for kind in ("stiffness", "damping")
        ),
        0.0,
    )
    bushings = dict(contact.bushings)
    bushings["shank"] = replace(bushings["shank"], **none)
    slack = moved(in_device, driven, replace(contact, bushings=bushings))
    less = Design({"shank": CuffDesign(removed=True)})
    gone = moved(
        replace(in_device, model=less.model(in_device.model)),
        assisted(driven, less),
        less.contact(contact),
    )
    was = moved(in_device, driven, contact)
    # A movement on a cuff without springs is one without the cuff.
    wearer = Wearer("somebody", in_device.model, contact, (slack,))
    light = replace(SETTINGS, weight=1e-6)
    posed = DesignProblem([wearer], light, held=True, without=("shank",))
    found = posed.solve()
    assert found.solution.success
    (held,) = found.wearers["somebody"].trials
    assert "shank" not in gone.cuffs and "shank" not in held.cuffs
    assert np.abs(slack.cuffs["shank"].components).max() < 1e-6
    for cuff in ("thigh", "pelvis"):
        expected = slack.cuffs[cuff].normal
        np.testing.assert_allclose(gone.cuffs[cuff].normal, expected, atol=0.02)
        np.testing.assert_allclose(held.cuffs[cuff].normal, expected, atol=0.1)
    assert found.design.removed == ("shank",)
    # Others bear what the shank's cuff bore.
    change = gone.cuffs["thigh"].normal - was.cuffs["thigh"].normal
    assert np.abs(change).max() > 5.0
    # The norm has as many terms as with every cuff.
    alone = norm_of([held], SETTINGS).newton
    share = (2.0 / 3.0) ** (1.0 / SETTINGS.exponent)
    assert found.norm_n == pytest.approx(share * alone)


def test_what_mats_show_is_what_is_minimised(wearer, found, today):
    """A force that they show twice is spared, at the others' expense."""
    seen = replace(wearer, differ={"thigh": 2.0, "shank": 0.5})
    own = DesignProblem.of_today([seen], SETTINGS).solve()
    other = DesignProblem([seen], SETTINGS, today=own).solve()
    assert other.solution.success
    peaks, before = (
        {
            c: f[1]
            for c, f in each(r.wearers["somebody"], "largest_force").items()
        }
        for r in (other, found)
    )
    assert peaks["thigh"] < 0.95 * before["thigh"]
    assert peaks["shank"] > 1.05 * before["shank"]
    (trial,) = other.wearers["somebody"].trials
    total = sum(
        np.trapezoid(
            (
                factor**2
                * (
                    trial.cuffs[cuff].normal ** 2
                    + SETTINGS.shear_weight * trial.cuffs[cuff].tangential ** 2
                )
            )
            ** 4,
            trial.times,
        )
        for cuff, factor in (("shank", 0.5), ("thigh", 2.0), ("pelvis", 1.0))
    )
    expected = (total / (3.0 * trial.duration)) ** (1.0 / 8.0)
    assert other.norm_n == pytest.approx(expected)
    # A limit is on what they show, too.
    felt = {c: f * seen.differ.get(c, 1.0) for c, f in peaks.items()}
    most = 0.97 * max(felt.values())
    limits = replace(SETTINGS.limits, normal_n=most)
    within = DesignProblem(
        [seen], replace(SETTINGS, limits=limits), today=own
    ).solve()
    assert within.solution.success
    forces = each(within.wearers["somebody"], "largest_force")
    felt = [f[1] * seen.differ.get(c, 1.0) for c, f in forces.items()]
    assert max(felt) == pytest.approx(most, rel=1e-3)


def test_a_cuff_is_left_out_where_that_is_less_and_may_be(
    wearer, today, monkeypatch
):
    """Each in turn; what holds the hip alone cannot go."""
    loose = DesignLimits(
        migration_mm=None, moment_factor=None, effort_factor=None
    )
    settings = replace(
        SETTINGS,
        limits=loose,
        cuffs=dict.fromkeys(
            ("thigh", "pelvis"),
            CuffFreedom(along_m=(-0.01, 0.01), removable=True),
        ),
    )
    whole = DesignProblem([wearer], settings, today=today).solve()
    assert whole.solution.success
    monkeypatch.setattr(Designed, "held", SimpleNamespace(stiffness=1.0))
    monkeypatch.setattr(
        Designed, "forecast_n", property(lambda made: made.found.norm_n)
    )
    made = Designed(settings, today, whole, {}, {})
    made = fewer(made, lambda found: {})
    best, tried = made.found, made.tried
    told = {t.without: t for t in tried}
    assert "nothing holds the device beyond exo_hip" in (
        told["pelvis",].why_not
    )
    least = min((t for t in tried if t.norm_n), key=lambda t: t.norm_n)
    assert set(best.problem.without) == set(least.without)
    assert best.norm_n == least.norm_n and best.design == least.design
    assert told["thigh",].norm_n is not None
    with pytest.raises(InputError, match="turn freely"):
        DesignProblem([wearer], settings, without=("pelvis",))
    unknown = replace(settings, cuffs={"tigh": CuffFreedom(removable=True)})
    with pytest.raises(InputError, match=r"design\.cuffs\.tigh"):
        DesignProblem([wearer], unknown)


def test_a_design_lowers_the_norm_and_keeps_its_limits(found, today):
    assert found.norm_n < 0.9 * today.norm_n
    before, after = (
        each(r.wearers["somebody"], "largest_force") for r in (today, found)
    )
    for cuff, force in after.items():
        assert force[2] <= before[cuff][2] * (1.0 + 1e-4)
    work = [works(r)["somebody"] for r in (today, found)]
    assert work[1] == pytest.approx(work[0], rel=0.006)
    for v in found.problem.design:
        assert v.lower <= found.values[v.name] <= v.upper


def test_the_forecast_is_what_the_design_promised(found, in_device, driven):
    """The same person on the built cuffs, without the design's objective."""
    design = found.design
    again = moved(
        in_device,
        assisted(driven, design),
        design.contact(in_device.contact),
    )
    (promised,) = found.wearers["somebody"].trials
    assert norm_of([again], SETTINGS).newton == pytest.approx(
        found.norm_n, rel=0.05
    )
    assert again.device_work == pytest.approx(promised.device_work, rel=0.02)


@pytest.mark.parametrize(
    ("name", "value", "step"),
    [
        ("thigh.along_m", 0.02, 2e-3),
        ("shank.strap_normal_n_m", 1e-4, 1e-5),
        ("exo_knee.factor_at_0_deg", 1.05, 5e-3),
        ("thigh.preload_across_m", 2e-3, 2e-4),
        ("shank.preload_along_m", -2e-3, 2e-4),
        ("pelvis.area", 1.1, 1e-2),
        ("thigh.slide", 0.2, 1e-2),
        ("thigh.hinge", 0.5, 1e-2),
        ("exo_knee.across_m", 2e-3, 2e-4),
        ("exo_hip.along_m", -2e-3, 2e-4),
        ("exo_knee.factor_at_2_of_4", 1.05, 5e-3),
        ("exo_hip.stiffness_nm_rad", 2.0, 0.1),
    ],
)
def test_slope_is_that_of_problems_solved_again(
    wearer, name, value, step, today
):
    """Gradient of the optimum by a variable, to 1 %."""
    over = "movement" if "_of_" in name else "angle"
    over = "gains" if name.partition(".")[2] in GAINS else over
    free = replace(
        SETTINGS,
        assistance_over=over,
        points=4 if over == "movement" else 1,
        limits=DesignLimits(
            migration_mm=None,
            moment_factor=None,
            effort_factor=None,
            support=None,
        ),
    )

    everything = design_variables([wearer], free)

    def solved(at):
        held = {v.name: v.today for v in everything} | {name: at}
        result = DesignProblem([wearer], free, held=held).solve()
        assert result.solution.success
        return result

    slope = solved(value).slopes()[name]
    up, down = (solved(value + s * step) for s in (1.0, -1.0))
    expected = up.solution.objective - down.solution.objective
    assert slope == pytest.approx(expected / (2.0 * step), rel=0.01)


def test_slopes_come_from_a_system_that_is_banded_in_time(today, monkeypatch):
    """What cuffs are built as touches all nodes: it is solved for apart."""
    fill = []

    def noted(system, **options):
        found = factorise(system, **options)
        fill.append(found.nnz / system.nnz)
        return found

    factorise = sparse.linalg.splu
    monkeypatch.setattr(sparse.linalg, "splu", noted)
    assert today.slopes()
    assert len(fill) == 1 and fill[0] < 7.0


def test_torques_over_the_movement_keep_the_support(wearer, today):
    """A spline for each joint: less is felt, at the same work."""
    settings = replace(SETTINGS, assistance_over="movement", points=5)
    names = [v.name for v in design_variables([wearer], settings)]
    assert "exo_hip.factor_at_5_of_5" in names
    result = DesignProblem([wearer], settings, today=today).solve()
    assert result.solution.success
    assert result.norm_n < 0.9 * today.norm_n
    work = [works(r)["somebody"] for r in (today, result)]
    assert work[1] == pytest.approx(work[0], rel=0.006)
    spline = result.design.assistance["exo_knee"]
    assert spline.over == "movement" and len(spline.factor) == 5
    (found,) = result.wearers["somebody"].trials
    share = found.times / found.duration
    own = wearer.trials[0].sample(found.times)
    expected = own.moment("exo_knee")
    np.testing.assert_allclose(
        found.moment("exo_knee"),
        spline.torque(expected, None, None, share),
        atol=0.05,
    )


def test_gains_of_a_controller_keep_the_support(wearer, today, in_device):
    """Less is felt at the same work; and the forecast agrees."""
    settings = replace(SETTINGS, assistance_over="gains")
    result = DesignProblem([wearer], settings, today=today).solve()
    assert result.solution.success
    assert result.norm_n < 0.9 * today.norm_n
    work = [works(r)["somebody"] for r in (today, result)]
    assert work[1] == pytest.approx(work[0], rel=0.006)
    assert not result.design.assistance
    gains = result.design.gains
    assert set(gains) == set(_DRIVE_NM)
    (found,) = result.wearers["somebody"].trials
    own = wearer.trials[0].sample(found.times)
    for joint, own_gains in gains.items():
        angle, rate = own.coordinate(joint), own.velocity(joint)
        expected = (
            own_gains.support * own.moment(joint)
            + own_gains.constant_nm
            - own_gains.stiffness_nm_rad * angle
            - own_gains.damping_nm_s_rad * rate
        )
        np.testing.assert_allclose(found.moment(joint), expected, atol=0.05)
    design, trial = result.design, wearer.trials[0]
    again = moved(
        in_device, assisted(trial, design), design.contact(in_device.contact)
    )
    norm = norm_of([again], SETTINGS).newton
    assert norm == pytest.approx(result.norm_n, rel=0.05)


def test_moved_joints_are_those_of_the_model_that_is_built(wearer):
    """Statics of the kernel against a device with its joints moved."""
    design = Design(
        joints={
            "exo_knee": JointDesign(0.012, -0.008),
            "exo_hip": JointDesign(-0.015, 0.02),
        }
    )
    built = design.model(wearer.model).tree
    (part,) = DesignProblem([wearer], EVERYTHING, held=True).parts
    (movement,) = part.movements
    places = [0.0, 0.25, 0.0, 0.0, -0.008, 0.012, 0.02, -0.015]
    shank, thigh = places[:4], places[:6]
    rng = np.random.default_rng(2)
    q = rng.uniform(-0.6, 0.6, (5, 9))
    rest = np.zeros((5, 18 + 6 + 3))
    force = np.zeros((5, 9))
    where = np.tile([*shank, *thigh, *places], (5, 1))
    x = np.hstack([q, rest, force, where])
    found = movement.dynamics.evaluate(x, None)
    expected = built.inverse_dynamics(q, 0.0 * q, 0.0 * q)
    np.testing.assert_allclose(100.0 * found, expected, atol=1e-9)
    bushing = part.bushings["pelvis"]
    own = BushingKinematics(built, "pelvis")
    at = np.tile(places, (5, 1))
    np.testing.assert_allclose(
        bushing.deflection(q, bushing.terms(q, at)),
        own.deflection(q, own.terms(q, at[:, :2])),
        atol=1e-12,
    )


def test_all_that_may_change_is_forecast(wearer, today, in_device, driven):
    """The built model, moved joints and all, does what was promised."""
    result = DesignProblem([wearer], EVERYTHING, today=today).solve()
    assert result.solution.success
    design = result.design
    assert result.norm_n < 0.8 * today.norm_n
    again = OwnMovement(
        design.model(in_device.model),
        [assisted(driven, design)],
        design.contact(in_device.contact),
        phase(),
    ).solve()
    assert again.success
    norm = norm_of(again.trials, EVERYTHING, design).newton
    assert norm == pytest.approx(result.norm_n, rel=0.1)


def test_pressure_keeps_its_limit(wearer, today):
    """Less than today's, by a larger cuff or a smaller force."""
    peak = {
        c: f[1]
        for c, f in each(today.wearers["somebody"], "largest_force").items()
    }
    most = 0.7 * max(peak.values()) / 10.0  # kPa on 100 cm^2
    limits = replace(SETTINGS.limits, pressure_kpa=most)
    settings = replace(EVERYTHING, limits=limits)
    result = DesignProblem([wearer], settings, today=today).solve()
    assert result.solution.success
    after = each(result.wearers["somebody"], "largest_force")
    pressures = [0.1 * after[c][1] / result.design.cuffs[c].area for c in after]
    assert max(pressures) <= most * 1.001


def test_mean_and_rate_of_forces_keep_their_limits(wearer, today):
    """Less than today's by a tenth, and never where nothing limits them."""
    before = today.wearers["somebody"]
    loose = DesignProblem([wearer], EVERYTHING, today=today).solve()
    mean, rate = (
        0.9 * max(each(loose.wearers["somebody"], key).values())
        for key in ("mean_force", "largest_rate")
    )
    assert mean < max(each(before, "mean_force").values())
    for limits, key, most in (
        ({"mean_n": mean}, "mean_force", mean),
        ({"rate_n_s": rate}, "largest_rate", rate),
    ):
        limits = replace(SETTINGS.limits, **limits)
        settings = replace(EVERYTHING, limits=limits)
        result = DesignProblem([wearer], settings, today=today).solve()
        assert result.solution.success
        after = each(result.wearers["somebody"], key)
        assert max(after.values()) <= most * 1.005


def test_drives_keep_their_limits(wearer, today):
    """The knee's power and torque; the hip's speed is as it moves."""
    own = today.wearers["somebody"]
    trial = own.trials[0]
    names = trial.coordinates
    torque = wearer.drive(trial)[:, names.device.index("exo_knee")]
    power = torque * trial.velocity("exo_knee")
    limits = {
        "exo_knee": DriveLimits(
            torque_nm=0.95 * np.abs(torque).max(),
            power_w=0.9 * np.abs(power).max(),
        )
    }
    settings = replace(
        SETTINGS,
        points=3,
        limits=replace(SETTINGS.limits, drives=limits, support=0.1),
    )
    result = DesignProblem([wearer], settings, today=today).solve()
    assert result.solution.success
    (after,) = result.wearers["somebody"].trials
    given = wearer.drive(after)[:, names.device.index("exo_knee")]
    assert np.abs(given).max() <= limits["exo_knee"].torque_nm * 1.001
    made = given * after.velocity("exo_knee")
    assert np.abs(made).max() <= limits["exo_knee"].power_w * 1.001
    # Faster than its drive turns nobody rises.
    slow = {"exo_hip": DriveLimits(speed_deg_s=5.0)}
    settings = replace(SETTINGS, limits=replace(SETTINGS.limits, drives=slow))
    solution = DesignProblem([wearer], settings, today=today).solve().solution
    assert not solution.success
    assert "exo_hip" in solution.explain() and "deg/s" in solution.explain()


def test_hinges_in_cuffs_bear_less_moment(wearer, today):
    """A fifth of today's; dampers of a hinge bear some of it."""
    limits = replace(SETTINGS.limits, moment_factor=0.2)
    hinged = CuffFreedom(hinge=(0.0, 1.0), strap_nm_rad=None)
    cuffs = dict.fromkeys(wearer.model.cuffs, hinged)
    settings = replace(SETTINGS, cuffs=cuffs, limits=limits)
    before = each(today.wearers["somebody"], "largest_force")
    result = DesignProblem([wearer], settings, today=today).solve()
    assert result.solution.success
    for cuff, force in each(
        result.wearers["somebody"], "largest_force"
    ).items():
        assert force[2] <= 0.2 * before[cuff][2] * (1.0 + 1e-4)
        own = result.design.cuffs[cuff]
        assert own.hinge > 0.5 and own.strap_rotational_nm_rad is None
        built = own.built(wearer.contact.bushings[cuff])
        share = built.rotational_stiffness / (
            wearer.contact.bushings[cuff].rotational_stiffness
        )
        assert share == pytest.approx(1.0 - own.hinge)
    free = result.problem.design
    assert not [v for v in free if v.name.endswith("hinge") and v.at_bound(1.0)]


def test_more_freedom_is_never_worse(wearer, today, found):
    held = {
        v.name: v.today
        for v in today.problem.design
        if not v.name.endswith("along_m")
    }
    places = DesignProblem([wearer], SETTINGS, today=today, held=held).solve()
    assert places.solution.success
    assert found.solution.objective <= places.solution.objective * 1.001
    assert places.norm_n <= today.norm_n


def test_a_tight_limit_is_no_contradiction(wearer, today):
    """A tenth of what is felt today; dynamics without curvature gave up."""
    peaks = each(today.wearers["somebody"], "largest_force").values()
    most = 0.1 * max(normal for _, normal, *_ in peaks)
    limits = replace(SETTINGS.limits, normal_n=most)
    result = DesignProblem(
        [wearer], replace(SETTINGS, limits=limits), today=today
    ).solve()
    assert result.solution.success
    peaks = each(result.wearers["somebody"], "largest_force").values()
    assert max(normal for _, normal, *_ in peaks) <= 1.005 * most


def test_limits_that_contradict_each_other_are_named(wearer, today):
    limits = replace(SETTINGS.limits, normal_n=1.0)
    solution = (
        DesignProblem([wearer], replace(SETTINGS, limits=limits), today=today)
        .solve()
        .solution
    )
    assert not solution.success
    assert solution.binding
    text = solution.explain()
    assert "normal force" in text and "its bound is" in text and " N" in text


def test_one_who_answers_freely_feels_less(wearer, today, found):
    free = replace(SETTINGS, response="free", effort_nm=200.0)
    result = DesignProblem([wearer], free, today=today).solve()
    assert result.solution.success
    assert result.norm_n < found.norm_n


def test_a_design_for_a_population(wearer):
    """Small and large bodies wear it, too; they feel less than today."""
    height, mass = wearer.model.human.height_m, wearer.model.human.mass_kg
    people = Population((height, 0.07), (mass, 10.0), (5.0, 95.0))
    wearer = replace(wearer, differ={"thigh": 1.2})
    others = sized(wearer, people, phase())
    assert all(w.differ == wearer.differ for w in others)
    assert [w.name.rpartition(", ")[2] for w in others] == [
        "5th percentile",
        "95th percentile",
    ]
    assert all(w.is_drawn for w in others)
    small, large = (w.model.human for w in others)
    assert large.height_m - small.height_m == pytest.approx(2 * 1.644854 * 0.07)
    weights = [w.trials[0].ground.force_z.mean() for w in others]
    trees = [w.model.tree.weight for w in others]
    assert weights == pytest.approx(trees, rel=0.03)
    everybody = [wearer, *others]
    before = DesignProblem.of_today(everybody, SETTINGS).solve()
    after = DesignProblem(everybody, SETTINGS, today=before).solve()
    assert after.solution.success
    for w in everybody:
        norms = [r.norm(r.wearers[w.name]).newton for r in (before, after)]
        assert norms[1] < norms[0]
    loaded = replace(wearer.model, kind="human", exoskeleton=None)
    with pytest.raises(InputError, match="needs the shipped device"):
        check_population(replace(wearer, model=loaded))


def benched(contact, **errors):
    """A contact whose calibration has found these errors, and no others."""
    names = tuple(f"{k}.exo_knee" for k in errors)
    values = np.array(list(errors.values()))
    known = Posterior(names, values, 1e-4 * np.eye(len(names)))
    return replace(contact, posterior=known)


def test_friction_is_what_bench_and_calibration_say(in_device, driven):
    """A measured moment has it all: what a bench tells too much comes off."""
    knee = JointDrive(viscous_nm_s=0.5, coulomb_nm=2.0, coulomb_speed_rad_s=0.1)
    device = Device(knee=knee)
    model, contact = in_device.model, in_device.contact
    rate = driven.v[:, driven.coordinates.index("exo_knee")]
    by_bench = -0.5 * rate - 2.0 * np.tanh(rate / 0.1)
    column = list(driven.coordinates.device).index("exo_knee")
    for found, share in ((contact, 1.0), (benched(contact, friction=0.3), 0.7)):
        friction = Wearer("", model, found, (), device=device).passive(driven)
        np.testing.assert_allclose(friction[:, column], share * by_bench)
        assert np.abs(np.delete(friction, column, axis=1)).max() == 0.0
    assert not Wearer("", model, contact, ()).passive(driven).any()


def test_a_factor_is_on_drives_at_true_angles(in_device, driven):
    """Neither friction nor what an encoder is off by changes with it."""
    design = Design(
        assistance={"exo_knee": Assistance((20.0, 80.0), (0.8, 1.4))}
    )
    names, off = driven.coordinates, np.deg2rad(3.0)
    seen = driven.q.copy()
    seen[:, names.index("exo_knee")] += off
    friction = np.zeros((len(driven.times), len(names.device)))
    column = list(names.device).index("exo_knee")
    friction[:, column] = 2.0 * np.cos(driven.times)
    changed = assisted(
        replace(driven, q=seen),
        design,
        benched(in_device.contact, encoder=off),
        friction,
    )
    angle = np.rad2deg(driven.coordinate("exo_knee"))
    factor = np.interp(angle, (20.0, 80.0), (0.8, 1.4))
    drive = driven.moment("exo_knee") - friction[:, column]
    np.testing.assert_allclose(
        changed.moment("exo_knee"), factor * drive + friction[:, column]
    )


def test_work_is_that_of_new_drives_and_old_friction(wearer, today):
    rubbing = replace(wearer, device=Device(knee=JointDrive(viscous_nm_s=3.0)))
    held = {v.name: v.today for v in today.problem.design}
    held["exo_knee.factor_at_0_deg"] = 1.2
    (trial,), works_of = wearer.trials, {}
    for who in (wearer, rubbing):
        result = DesignProblem([who], SETTINGS, held=held).solve()
        assert result.solution.success
        works_of[who.device is None] = works(result)["somebody"]
        (own,) = result.wearers["somebody"].trials
        at = trial.sample(own.times)
        column = list(at.coordinates.device).index("exo_knee")
        friction = who.passive(at)[:, column]
        expected = 1.2 * (at.moment("exo_knee") - friction) + friction
        np.testing.assert_allclose(own.moment("exo_knee"), expected, atol=0.02)
    rate = trial.v[:, trial.coordinates.index("exo_knee")]
    lost = np.trapezoid(3.0 * rate**2, trial.times)
    more = works_of[False] - works_of[True]
    assert more == pytest.approx(0.2 * lost, rel=0.02)


@pytest.mark.parametrize("factor", [1.2, None])
def test_a_spring_answers_to_where_the_device_goes(wearer, factor):
    """Whatever its joint's drive gives, and where it has none."""
    device = Device(knee=JointDrive(stiffness_nm_rad=60.0, rest_deg=20.0))
    (trial,) = wearer.trials
    if factor is None:
        said = {"moments": {"exoskeleton": "device model"}}
        trial = replace(trial, provenance=said)
    who = replace(wearer, device=device, trials=(trial,))
    problem = DesignProblem([who], SETTINGS)
    held = {v.name: v.today for v in problem.design}
    assert ("exo_knee.factor_at_0_deg" in held) is (factor is not None)
    held["thigh.across_m"] = 0.03
    if factor is not None:
        held["exo_knee.factor_at_0_deg"] = factor
    result = DesignProblem([who], SETTINGS, held=held).solve()
    assert result.solution.success
    (own,) = result.wearers["somebody"].trials
    at = trial.sample(own.times)
    column = list(at.coordinates.device).index("exo_knee")
    passive = who.passive(at)[:, column]
    drive = at.moment("exo_knee") - passive
    angle = at.coordinate("exo_knee")
    np.testing.assert_allclose(passive, -60.0 * (angle - np.deg2rad(20.0)))
    off = own.coordinate("exo_knee") - angle
    assert np.abs(60.0 * off).max() > 0.5
    expected = (factor or 1.0) * drive + passive - 60.0 * off
    np.testing.assert_allclose(own.moment("exo_knee"), expected, atol=0.02)
    # The forecast has it, too.
    more = answer(trial, who, trial, Design()).given(own, own.times)
    np.testing.assert_allclose(more[:, column], -60.0 * off, atol=0.02)
    assert not np.delete(more, column, axis=1).any()


def test_migration_comes_to_its_limit_or_as_near_as_it_can(
    wearer, today, monkeypatch
):
    """Beyond it today: what is asked for first of all, before any force."""
    before = each(today.wearers["somebody"], "largest_deflection")
    cuff = max(before, key=lambda c: before[c][0])
    most = 1e3 * before[cuff][0]

    def reached(limit_mm):
        limits = replace(SETTINGS.limits, migration_mm=limit_mm)
        settings = replace(SETTINGS, limits=limits)
        result = DesignProblem([wearer], settings, today=today).solve()
        assert result.solution.success
        after = each(result.wearers["somebody"], "largest_deflection")
        return result, {c: 1e3 * d[0] for c, d in after.items()}

    result, after = reached(0.9 * most)
    assert after[cuff] <= 0.9 * most * (1.0 + 1e-3)
    assert result.norm_n < today.norm_n
    result, nearer = reached(0.3 * most)
    assert 0.3 * most < nearer[cuff] < 0.9 * most
    # What a millimetre may cost decides how near.
    monkeypatch.setattr(posed, "_BEYOND", 100.0 * posed._BEYOND)
    _, again = reached(0.3 * most)
    assert 0.3 * most < again[cuff] < nearer[cuff] - 0.5


def test_wearers_that_do_not_fit_are_refused(wearer):
    with pytest.raises(InputError, match="no wearers"):
        DesignProblem([])
    (own,) = wearer.trials
    passive = replace(wearer, trials=(replace(own, moments=None),))
    free = Design({"thigh": CuffDesign(slide=1.0)}).contact(wearer.contact)
    with pytest.raises(InputError, match="thigh cuff has no stiffness"):
        DesignProblem([replace(wearer, contact=free)])
    with pytest.raises(InputError, match="torques are not known"):
        DesignProblem([passive])


def test_one_design_for_two_wearers(wearer, in_device, driven):
    """Shared variables, a tissue of one's own."""
    soft = in_device.contact.scaled(0.7)
    other = replace(
        wearer,
        name="somebody else",
        contact=soft,
        trials=(moved(in_device, driven, soft),),
    )
    both = [wearer, other]
    before = DesignProblem.of_today(both, SETTINGS).solve()
    after = DesignProblem(both, SETTINGS, today=before).solve()
    assert after.solution.success
    assert after.norm_n < 0.95 * before.norm_n
    for own in both:
        (trial,) = after.wearers[own.name].trials
        built = after.design.contact(own.contact)
        assert after.wearers[own.name].contact.bushings == built.bushings
        tree = after.wearers[own.name].model.tree
        at = built.bushings["thigh"]
        kinematics = BushingKinematics(tree, "thigh", at.preload)
        origin = np.broadcast_to(at.origin, (len(trial.q), 2))
        terms = kinematics.terms(trial.q, origin)
        d = kinematics.deflection(trial.q, terms)[:, 1]
        rate = kinematics.deflection_jacobian(terms)[:, 1]
        rate = np.sum(rate * trial.v, axis=1)
        expected = at.normal_stiffness * d + at.normal_damping * rate
        np.testing.assert_allclose(
            trial.cuffs["thigh"].normal, expected, atol=0.1
        )
