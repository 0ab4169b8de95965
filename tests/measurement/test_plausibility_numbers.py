"""Values of the checks, of recordings whose arrays are made up by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import g

from drake_exo.files.tables import MarkerData
from drake_exo.measurement import plausibility
from drake_exo.measurement.filters import MarkerFault, leaps, standstills
from drake_exo.measurement.plausibility import Evidence
from drake_exo.measurement.recording import FootForces
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.settings import Load
from drake_exo.measurement.trial import Trial

WEIGHT = 700.0
N = 50
TIME = 1.0 + np.arange(200) / 100.0  # of the recording; from 1.5 s on is used
INSIDE = slice(50, 100)


class Cut(SimpleNamespace):
    """What checks read of a trial."""

    body = Trial.body


def made(**motion) -> Evidence:
    """A trial of 0.49 s out of a recording of 2 s."""
    motion = {"time": TIME, "feet": {}, "legs": {}, "ankles": {}} | motion
    sides = motion.pop("sides", ())
    named = "ankle", "knee", "hip"
    trial = Cut(
        name="one",
        start_s=1.5,
        duration=0.49,
        times=np.arange(N) / 100.0,
        coordinates=SimpleNamespace(
            human=named,
            device=tuple(f"exo_{joint}" for joint in named),
            turned_by=np.eye(3),
            body_columns=np.arange(6),
            device_columns=np.arange(6, 9),
            follows=lambda name: name.removeprefix("exo_"),
        ),
    )
    model = SimpleNamespace(
        rigid=SimpleNamespace(tree=SimpleNamespace(weight=WEIGHT)),
        human=SimpleNamespace(foot=SimpleNamespace(length_m=0.25)),
        assembly=SimpleNamespace(human=SimpleNamespace(sides=sides)),
    )
    files = SimpleNamespace(
        markers="m.trc", forces="f.mot", encoders="e.csv", loads=()
    )
    recording = SimpleNamespace(motion=SimpleNamespace(**motion))
    subject = SimpleNamespace(model=model)
    e = Evidence(trial, model, files, recording, subject)
    assert e.inside.sum() == N
    return e


def known(e: Evidence, **values) -> Evidence:
    """With some of what it would otherwise compute."""
    vars(e).update(values)
    return e


def told(checks, *names):
    """Value, limit and verdict of checks by name, in their order."""
    checks = checks if isinstance(checks, list) else [checks]
    found = {}
    for c in checks:
        found.setdefault(c.name.removeprefix("plausibility."), []).append(
            (pytest.approx(c.value, abs=1e-9), c.limit, c.holds)
        )
    return [x for name in names for x in found[name]]


def standing(worn_kg=0.0, **said):
    """Checks of a standing trial of a person of 60 kg."""
    report = {
        "stated_mass_kg": 60.0,
        "standing_angles_deg": [0, 5, -40, 12],
        "lengths_m": {"shank": 0.4, "thigh": 0.42},
        "ankle_height_m": 0.08,
        "table_leg_m": 0.9,
    }
    subject = SimpleNamespace(
        report=report | said,
        mass_kg=60.0,
        model=SimpleNamespace(
            tree=SimpleNamespace(mass=60.0 + worn_kg),
            coordinates=SimpleNamespace(human=("ankle", "knee", "hip")),
        ),
    )
    files = SimpleNamespace(forces="s.mot", markers="s.trc")
    return list(plausibility.standing_checks(subject, files))


def test_what_a_standing_trial_says():
    found = standing(standing_mass_kg=62.4)
    assert told(found, "mass") == [(4.0, 5.0, True)]
    assert told(found, "standing_posture") == [(40.0, 35.0, False)]
    assert "knee at -40 deg" in found[1].sentence
    found = standing(standing_mass_kg=54.0)
    assert told(found, "mass") == [(10.0, 5.0, False)]
    assert found[0].sentence.endswith("correct the mass or standing.plates")
    # A tenth of all that is worn: 6.6 of 66 kg, of which 6 are the device.
    found = standing(6.0, standing_mass_kg=0.6)
    assert "forces look like kgf or daN" in found[0].sentence
    assert "beyond the device in" in found[0].sentence
    assert told(found, "stature") == [(0.0, 10.0, True)]
    (tall,) = [
        c for c in standing(table_leg_m=1.01) if c.name.endswith("stature")
    ]
    assert (tall.value, tall.holds) == (pytest.approx(1100 / 101), False)
    assert tall.level == "note" and "0.90 m above the floor" in tall.sentence
    # A floor that is not at zero makes the legs longer, too.
    assert "at z = 0 in the files (ankles are 80 mm above)" in tall.sentence
    cop = {"standing_cop_x_m": 0.03, "standing_com_x_m": -0.04}
    assert told(standing(**cop), "standing_balance") == [(0.07, 0.1, True)]
    cop["trunk_com_shift_m"] = -0.11
    assert told(standing(**cop), "standing_balance") == [(0.11, 0.1, False)]


@pytest.mark.parametrize(
    ("bends", "value", "limit", "holds"),
    [
        ((10.0, 100.0), 10.0, -20.0, True),
        ((90.0, 150.0), 150.0, 165.0, True),
        ((10.0, 170.0), 170.0, 165.0, False),
        ((-30.0, 100.0), -30.0, -20.0, False),
        ((-25.0, 175.0), 175.0, 165.0, False),
        ((-35.0, 175.0), -35.0, -20.0, False),
    ],
)
def test_ranges_are_told_by_the_worse_end(bends, value, limit, holds):
    angles = np.zeros((200, 3))
    angles[INSIDE, 1] = np.deg2rad(np.linspace(*bends, N))
    angles[:40, 1] = 3.0  # before the used part
    found = list(plausibility._ranges(made(legs={"left": angles})))
    assert told(found, "knee_range") == [(value, limit, holds)]
    assert "left knee" in found[1].sentence or holds
    assert ("backwards" in found[1].sentence) == (value < -20.0)
    assert told(found, "ankle_range") == [(0.0, -50.0, True)]
    assert told(found, "hip_range") == [(0.0, -45.0, True)]


def test_markers_are_told_by_their_mean_square():
    """In the used part: one that is exchanged later does no harm."""
    off = {"heel": 0.03, "toe": 0.06, "knee": 0.02}
    off = {name: np.full(200, x) for name, x in off.items()}
    off["toe"][120:], off["heel"][60:70] = 0.5, np.nan
    check = plausibility._markers(made(residuals_m=off))
    mean = np.sqrt((0.03**2 + 0.06**2 + 0.02**2) / 3)
    assert told(check, "markers") == [(mean, 0.05, True)]
    off["toe"][:] = 0.09
    assert (
        "most toe (90 mm)"
        in plausibility._markers(made(residuals_m=off)).sentence
    )


def test_newton_and_euler_by_hand():
    """10 N along, 30 N up and 60 N m about an ankle at (0.2, 0.1) too few."""
    e = made(legs={"left": np.zeros((200, 3))})
    e.recording.forces = SimpleNamespace(is_one_leg=False)
    turn = np.linspace(0.0, 4.0 * np.pi, N)
    shear = 50.0 * np.sin(turn)
    measured = np.column_stack([shear, np.full(N, 600.0), np.full(N, 5.0)])
    lost = np.array([10.0, 30.0, 0.1 * 10.0 - 0.2 * 30.0 + 60.0])
    q = np.zeros((N, 6))
    q[:, 0], q[:, 1] = 0.2, 0.1
    e.trial.q = e.trial.v = e.trial.a = q
    across = {"left": -15.0, "right": 40.0}
    plates = {k: np.full((N, 1), x) * np.eye(6)[1] for k, x in across.items()}
    known(e, needed=measured + lost, measured=measured, plates=plates)
    found = list(plausibility._dynamics(e))
    assert told(found, "newton", "euler", "mean_forward") == [
        (30.0, 105.0, True),
        (60.0, 70.0, True),
        (10.0, 21.0, True),
    ]
    assert told(found, "mean_sideways", "mean_weight") == [
        (25.0, 21.0, False),
        (100.0 * 30.0 / 630.0, pytest.approx(7.0), True),
    ]
    assert "+25 N sideways" in found[3].sentence
    # From the left foot to the right one in 0.49 s, at 0.15 m/s and back.
    for side, stands in ("left", slice(30)), ("right", slice(20, None)):
        plates[side][stands, 2] = 400.0
    known(e, needed=measured, plates=plates)
    (check,) = told(list(plausibility._dynamics(e)), "mean_sideways")
    assert check == (25.0, pytest.approx(21.0 + 700.0 * 0.3 / g / 0.49), True)
    # On one foot alone, past which the other one swings, likewise.
    for side, force in ("left", 400.0), ("right", 0.0):
        plates[side][:, 2] = force
    swing, stay = np.zeros((2, 200, 2))
    swing[INSIDE, 0] = np.linspace(-0.3, 0.3, N)
    for path, limit in ((swing, check[1]), (0.3 * swing, 21.0)):
        e.recording.motion.ankles = {"left": stay, "right": path}
        (found,) = told(list(plausibility._dynamics(e)), "mean_sideways")
        assert found[1] == pytest.approx(limit)
    e.recording.motion.ankles = {}
    known(e, needed=measured + 2.2 * lost)
    found = list(plausibility._dynamics(e))
    assert "N m RMS about the ankle" in found[1].sentence
    e.subject.model.assembly.human.sides = "left", "right"
    assert "RMS about the hips" in list(plausibility._dynamics(e))[1].sentence
    assert [(c.holds, c.sentence[7:39]) for c in found[2::2]] == [
        (False, "plates bear -22 N forward on ave"),
        (False, "plates bear 90 % of what the mot"),
    ]
    # One foot on a plate says nothing of the other's push.
    e.recording.forces.is_one_leg = True
    names = [c.name for c in plausibility._dynamics(e)]
    assert "plausibility.mean_sideways" not in names
    # Turned: F_x and M_y change their signs.
    known(e, needed=np.array([[10.0, 600.0, -20.0]] * N))
    known(e, measured=np.array([[-10.0, 600.0, 20.0]] * N))
    assert e.pitch_error(turned=True) == pytest.approx(0.0)
    assert e.pitch_error() == pytest.approx(40.0 + 0.1 * 20.0)


def sheared(plates, left, right, one_leg=False):
    """A trial whose motion asks for a swing of 50 N, half on each plate.

    Args:
        plates: of the study.
        left, right: share of its half that the plate shows.
    """
    e = made()
    e.files.plates = plates
    e.recording.forces = SimpleNamespace(is_one_leg=one_leg)
    swing = 50.0 * np.sin(np.linspace(0.0, 4.0 * np.pi, N, endpoint=False))
    own = {"left": left * swing / 2.0, "right": right * swing / 2.0}
    own = {k: np.outer(x, np.eye(6)[0]) for k, x in own.items()}
    needed = np.outer(swing, [1.0, 0.0, 0.0])
    if one_leg:
        del own["right"]
    measured = (2.0 if one_leg else 1.0) * sum(own.values())[:, :3] + 7.0
    return known(e, needed=needed, measured=measured, plates=own)


def test_signs_of_fore_aft_forces_are_told_by_all_trials_together():
    """Of shares that are shown, misfits of what is asked for follow."""
    (found,) = plausibility.shear_checks(
        [sheared("a", 1.2, 0.6), sheared("a", 0.2, 1.0)]
    )
    # Missed 0.1 and 0.4; the left one turned, 1.3 and 0.6.
    ratio = np.hypot(0.1, 0.4) / np.hypot(1.3, 0.6)
    assert told(found, "shear_sign") == [(ratio, 1.1, True)]
    found = list(
        plausibility.shear_checks(
            [sheared("a", -1.2, 0.6), sheared("b", -0.8, -0.8)]
        )
    )
    assert told(found, "shear_sign") == [
        (1.3 / 0.1, 1.1, False),
        (1.8 / 0.2, 1.1, False),
    ]
    assert "of plate 'left' fits the motion 13 times" in found[0].sentence
    assert "of plate 'left' and 'right' fits" in found[1].sentence
    found = plausibility.shear_checks([sheared("a", -0.9, 0.0, one_leg=True)])
    assert told(list(found), "shear_sign") == [(1.9 / 0.1, 1.1, False)]


@pytest.mark.parametrize(("swing", "holds"), [(0.5, True), (5.0, False)])
def test_the_sign_of_next_to_no_fore_aft_force_is_not_judged(swing, holds):
    """A slow squat's; what a device does on its cuffs is as large."""
    e = sheared("a", 1.0, 1.0)
    e.measured[:, 0] = swing * np.cos(np.linspace(0.0, 12.0, N))
    e.needed[:, 0] = 0.0
    e.plates["left"][:, 0] = e.plates["right"][:, 0] = e.measured[:, 0] / 2.0
    (found,) = plausibility.shear_checks([e])
    assert found.holds == holds


@pytest.mark.parametrize(
    ("share", "unit"),
    [(1.1e-3, "kN"), (0.8e-3, None), (0.21, "lbf"), (0.105, "kgf"),
     (0.5, None), (0.13, None)],
)  # fmt: skip
def test_units_are_guessed_within_15_percent(share, unit):
    found = plausibility._unit_of(share)
    assert (unit is None and found is None) or unit in found


def test_a_recording_that_ends_in_the_rise():
    """0.3 m/s in its last frame; only where the used part ends there."""
    e = made(hip_z=0.3 * TIME)
    assert told(plausibility._end(e), "end") == [(0.0, 0.15, True)]
    vars(e)["inside"] = TIME >= 2.5
    assert told(plausibility._end(e), "end") == [(0.3, 0.15, False)]
    vars(e)["inside"] = (TIME >= 2.5) & (TIME < 2.985)
    assert told(plausibility._end(e), "end") == [(0.3, 0.15, False)]
    vars(e)["inside"] = (TIME >= 2.5) & (TIME < 2.975)
    assert told(plausibility._end(e), "end") == [(0.0, 0.15, True)]


@pytest.mark.parametrize("side", [0, -1])
def test_a_recording_of_two_legs_that_ends_in_a_step(side):
    """The knee turns at 40 deg/s; 83 ms are half a period of 6 Hz."""
    angles = np.zeros((200, 3))
    angles[:, 1] = np.deg2rad(40.0) * TIME
    e = made(legs={"left": 0.0 * angles, "right": angles})
    e.trial.provenance = {"filter": {"cutoff_hz": 6.0}}
    assert told(plausibility._end_joints(e), "end_joints") == [(0, 30.0, True)]
    for gap, value in ((0.07, 40.0), (0.09, 0.0)):
        near = TIME <= 2.5 if side else TIME >= 1.5
        away = np.abs(TIME - TIME[side]) > gap - 1e-6
        vars(e)["inside"] = away & ~near
        check = plausibility._end_joints(e)
        assert told(check, "end_joints") == [(value, 30.0, value == 0.0)]
        word = "ends at 2.99 s" if side else "starts at 1 s"
        assert value == 0.0 or word in check.sentence
    # Who stands still by then is as sound as ever.
    angles[-20:] = angles[-20]
    vars(e)["inside"] = TIME >= 1.5
    assert plausibility._end_joints(e).holds


def test_legs_against_each_other():
    """18 degrees at the knee, 80 mm, 70 % on the right, one foot up."""
    left, right = np.zeros((2, 200, 3))
    right[INSIDE, 1] = np.deg2rad(18.0)
    right[INSIDE, 2] = np.deg2rad(10.0)
    ankles = {
        "left": np.column_stack([TIME, TIME]),
        "right": np.column_stack([TIME - 0.08, TIME]),
    }
    feet = dict.fromkeys(("left", "right"), np.zeros((200, 2, 3)))
    e = made(legs={"left": left, "right": right}, ankles=ankles, feet=feet)
    bear = np.zeros((2, N, 6))
    bear[0, :, 2], bear[1, :, 2] = 210.0, 490.0
    known(e, plates={"left": bear[0], "right": bear[1]})
    found = list(plausibility._legs(e))
    assert "right knee" in found[0].sentence
    names = "leg_angles", "feet_apart", "leg_share", "lifted_foot"
    assert told(found, *names) == [
        (18.0, 15.0, False),
        (0.08, 0.1, True),
        (70.0, 65.0, False),
        (0.0, 5.0, True),
    ]
    # Ten frames: less than 35 N on one foot, more than 210 N on the other.
    bear[0, :10, 2], bear[1, :10, 2] = 30.0, 220.0
    bear[0, 10:20, 2], bear[1, 10:20, 2] = 40.0, 220.0
    bear[0, 20:30, 2], bear[1, 20:30, 2] = 30.0, 200.0
    bear[0, 30:35, 2], bear[1, 30:35, 2] = 500.0, 0.0
    (found,) = told(list(plausibility._legs(e)), "lifted_foot")
    assert found == (30.0, 5.0, False)


def test_a_foot_stays_if_one_of_its_markers_does():
    """The heel rises; the other foot moves by 25 mm, 30 with its heel."""
    feet = np.zeros((2, 200, 2, 3))
    feet[0, INSIDE, 0, 0] = np.linspace(0.0, 0.04, N)
    feet[1, INSIDE, :, 0] = np.linspace(0.0, (0.03, 0.025), N)
    feet[:, :, :, 2] = TIME[:, None]
    e = made(feet={"left": feet[0], "right": feet[1]})
    found = plausibility._slides(e)
    assert told([found], "foot_slides") == [(0.025, 0.02, False)]
    assert found.level == "note" and "the right foot" in found.sentence
    e = made(feet={"left": feet[0]})
    assert told([plausibility._slides(e)], "foot_slides") == [(0.0, 0.02, True)]


def test_a_foot_that_bears_shows_the_belts_speed():
    """-0.9 m/s while it bears half of the body."""
    feet = {}
    for side, speed in (("left", -0.9), ("right", -0.9)):
        x = np.where(TIME < 1.7, speed * TIME, speed * 1.7 + 2.0 * TIME)
        if side == "right":
            x = x[::-1]
        feet[side] = np.stack([x, x], axis=1)[..., None] * [1.0, 0.0, 0.0]
    e = made(feet=feet, sides=("left", "right"))
    e.recording.belt_speed_m_s = 0.1
    bears = np.where(np.arange(N) < 15, 400.0, 300.0)
    e.trial.feet = {
        "left": SimpleNamespace(force_z=bears),
        "right": SimpleNamespace(force_z=np.zeros(N)),
    }
    check = plausibility._belt(e)
    assert told(check, "belt") == [(0.9, 0.3, False)]
    assert "belt_speed_m_s: 1.00" in check.sentence


def pressed(n=N, **at):
    """A plate (n, 6) whose force acts at a point (x, y) of the floor."""
    x, y = at["x"], at["y"]
    force = np.zeros((n, 6))
    force[:, 2] = at.get("force", 400.0)
    # r × F of a vertical force.
    force[:, 3], force[:, 4] = y * force[:, 2], -x * force[:, 2]
    return force


def shod(**places):
    """Two markers a foot: heel and toe, 2 cm right and 3 cm left of y."""
    found = {}
    for side, (x, y) in places.items():
        p = np.zeros((200, 2, 3))
        p[:, 0, :2], p[:, 1, :2] = (x, y - 0.02), (x + 0.2, y + 0.03)
        found[side] = p
    return found


def test_pressure_is_measured_from_the_foots_edges():
    e = made(feet=shod(left=(0.1, 0.1), right=(0.1, -0.1)))
    left = pressed(x=0.41, y=0.15)
    left[0] *= 0.1  # bears too little to be judged
    right = pressed(x=0.02, y=-0.2)
    known(e, plates={"left": left, "right": right})
    np.testing.assert_allclose(e.cop("left"), [[0.41, 0.15]] * (N - 1))
    np.testing.assert_allclose(
        e.cop("left", turned=True, scale=1e-3), [[-41e-5, -15e-5]] * (N - 1)
    )
    # 3 cm behind the heel; 28 cm before that, markers end at 20.
    np.testing.assert_allclose(
        e.sole("left"), [[0.07, 0.38, 0.08, 0.13]] * (N - 1)
    )
    np.testing.assert_allclose(e.sole("right")[0], [0.07, 0.38, -0.12, -0.07])
    np.testing.assert_allclose(e.sole("both", "right")[0, 2:], [-0.12, 0.13])
    np.testing.assert_allclose(e.outside("left"), [0.03, 0.02])
    np.testing.assert_allclose(e.outside("right"), [0.05, 0.08])
    # Nearer to the own foot than to the other: |0.15 + 0.095| - |0.15 - 0.105|.
    near = (0.245 - 0.045, 0.305 - 0.105)
    assert e.off_side() == pytest.approx(np.mean(near))
    still = {"left": np.zeros((200, 3))}
    feet = shod(left=(0.1, -0.1), right=(0.1, 0.1))
    far = made(feet=feet, legs=still)
    far.trial.q = far.trial.v = far.trial.a = np.zeros((N, 6))
    nothing = np.zeros((N, 3))
    known(far, plates=e.plates, needed=nothing, measured=nothing)
    assert told(plausibility._sides(far), "plate_sides") == [(-0.2, 0.0, False)]
    one = made(feet=shod(left=(0.1, 0.1)))
    known(one, plates={"both": left})
    assert np.isnan(one.sole("both")[:, 2:]).all()
    assert one.outside("both")[0] == pytest.approx(0.03)
    long = made(feet=shod(left=(0.1, 0.1)))
    long.recording.motion.feet["left"][:, 1, 0] = 0.45
    known(long, plates={"left": left})
    np.testing.assert_allclose(long.sole("left")[:, 1], 0.45)
    # Of toes alone the heel is a foot's length behind the foremost.
    toes = made(feet=shod(left=(0.25, 0.1)))
    toes.recording.motion.feet["left"][:, 1, 0] = 0.3
    known(toes, plates={"left": left})
    np.testing.assert_allclose(toes.sole("left")[:, 0], 0.02)
    # One frame of fifty that is far off does not decide.
    left[30] = pressed(1, x=2.0, y=0.1)
    assert e.outside("left")[0] == pytest.approx(0.03)


def test_points_that_stray_where_little_is_borne_are_told():
    """As they are used: held at small forces there is nothing to tell."""
    feet = shod(left=(0.1, 0.1), right=(0.1, -0.1))
    e = made(feet=feet, legs={"left": np.zeros((200, 3))})
    on = {"left": pressed(x=0.2, y=0.1), "right": pressed(x=0.2, y=-0.1)}
    known(e, plates=on)
    # Frames of over 50 N begin with 60 N and end with 75 N.
    at = [1.5, 1.6, 1.9, 1.98, 1.985]
    force = np.interp(TIME, at, [0.0, 600.0, 600.0, 75.0, 0.0])

    def swinging(m_n):
        x = 0.2 + m_n * np.maximum(150.0 - force, 0.0)
        return PlanarWrench.of(np.column_stack([0 * x, force, -x * force]))

    for m_n, most, borne in ((0.0025, 0.045, 0.0), (0.004, 0.18, 75.0)):
        e.recording.forces = FootForces(TIME, {"left": swinging(m_n)}, "f.mot")
        assert e.astray("left") == pytest.approx((most, borne))
        found = list(plausibility._pressure(e, "left"))
        (check,) = (c for c in found if c.level == "note")
        assert told(check, "cop_light") == [(most, 0.05, borne == 0.0)]
    assert "while up to 75 N are borne" in check.sentence
    assert "hold_cop_below_n to about 150" in check.sentence
    e.recording.forces.wrenches["left"] = swinging(0.004).held(160.0)
    assert e.astray("left") == pytest.approx((0.07 - 0.2, 0.0))
    assert np.isnan(made(feet={}).astray("left")[0])


def test_a_pressure_far_away_is_told_with_its_unit():
    feet = shod(left=(0.1, 0.1), right=(0.1, -0.1))
    e = made(feet=feet, legs={"left": np.zeros((200, 3))})
    on = {"left": (0.2, 0.1), "right": (0.2, -0.1)}
    wrong = {s: pressed(x=1e3 * x, y=1e3 * y) for s, (x, y) in on.items()}
    known(e, plates=wrong)
    found = list(plausibility._pressure(e, "left"))
    assert "look like millimetres" in found[0].sentence
    assert told(found, "cop_along", "cop_across", "cop_unit") == [
        (200.0 - 0.38, 0.03, False),
        (100.0 - 0.13, 0.05, False),
        (200.0 - 0.38, 2.0, False),
    ]
    wrong = {s: pressed(x=1e2 * x, y=1e2 * y) for s, (x, y) in on.items()}
    known(e, plates=wrong)
    assert plausibility.likely_cause(e).endswith("look like centimetres")
    known(e, plates={s: pressed(x=x, y=y) for s, (x, y) in on.items()})
    assert plausibility.likely_cause(e) is None
    assert e.outside("left")[0] < 0.0


def test_a_foot_far_from_the_origin_is_far_from_no_limit():
    e = made(feet=shod(left=(3.0, 0.1)), legs={"left": np.zeros((200, 3))})
    known(e, plates={"left": pressed(x=3.1, y=0.1)})
    known(e, astray=lambda foot: (-0.1, 0.0))
    *_, found = plausibility._pressure(e, "left")
    assert found.holds and found.value < 0.0


def forced(F_z, needed_z, rate_hz=1000.0):
    e = made()
    time = 1.0 + np.arange(len(F_z)) / rate_hz
    e.recording.forces = SimpleNamespace(time=time, rate_hz=rate_hz)
    return known(e, needed_z=np.interp(TIME, time, needed_z))


def test_plates_that_repeat_themselves():
    """400 of 1500 samples at one value while another force is needed."""
    rng = np.random.default_rng(0)
    F_z = 300.0 + rng.normal(size=2000)
    F_z[:500] = 19.0  # not loaded
    F_z[600:1001] = 300.0  # its first sample repeats nothing
    F_z[1200:1240] = 290.0  # 40 ms are too short
    e = forced(F_z, np.linspace(300.0, 800.0, 2000))
    check, _ = plausibility._stuck(e, "left", F_z)
    share = 100.0 * 400 / 1500
    assert told(check, "flat_channel") == [(share, 25.0, False)]
    assert "at exactly 300 N for 0.4 s" in check.sentence
    still = forced(F_z, np.linspace(300.0, 340.0, 2000))  # 8 N meanwhile
    check, _ = plausibility._stuck(still, "left", F_z)
    assert told(check, "flat_channel") == [(0.0, 25.0, True)]
    _, check = plausibility._stuck(e, "left", F_z)
    assert told(check, "saturated_channel") == [(0.0, 0.0, True)]
    F_z[1300:1401] = 350.0
    _, check = plausibility._stuck(e, "left", F_z)
    assert told(check, "saturated_channel") == [(0.1, 0.0, False)]
    # At a slow rate five samples count, however long they are.
    slow = 300.0 + rng.normal(size=40)
    slow[10:15] = 301.0
    e = forced(slow, np.linspace(300.0, 900.0, 40), 20.0)
    assert plausibility._repeats(e, slow) == []
    slow[15] = 301.0
    assert plausibility._repeats(e, slow) == [(11, 16)]


def test_feet_and_chair_bear_the_body_together():
    e = made(known=TIME < 2.0)
    e.recording.forces = SimpleNamespace(total=lambda feet: PlanarWrench(
        np.tile([0.0, 400.0], (200, 1)), np.zeros(200)).force_z)  # fmt: skip
    e.recording.feet = ("left", "right")
    chair = np.where(TIME < 2.0, 250.0, 0.0)
    e.recording.chair = SimpleNamespace(force_z=chair)
    known(e, needed_z=np.full(200, 700.0))
    assert told(plausibility._chair(e), "chair") == [(50.0, 105.0, True)]


def worn(device_angles, human_angles, lag=0.0):
    """Encoders at 500 Hz over the recording, angles by time [deg]."""
    time = 0.8 + np.arange(1200) / 500.0
    of = [
        np.deg2rad(np.column_stack([a(t) for a in angles]))
        for angles, t in (
            (human_angles, TIME),
            (device_angles, time - lag),
            (human_angles, TIME[INSIDE]),
            (device_angles, TIME[INSIDE]),
        )
    ]
    e = made(q=np.column_stack([np.zeros((200, 3)), of[0]]))
    e.recording.angles = SimpleNamespace(time=time, values=of[1])
    e.trial.q = np.column_stack([np.zeros((N, 3)), of[2], of[3]])
    rate = np.gradient(of[0], TIME, axis=0)[INSIDE]
    e.trial.v = np.column_stack([np.zeros((N, 3)), rate, np.zeros((N, 3))])
    e.trial.a = 0.0 * e.trial.v
    return e


def bends(most, end=2.0):
    """From straight at 1.5 s to `most` degrees at the end of the part."""
    return lambda t: most * np.clip((t - 1.5) / (end - 1.5), -0.5, 1.0)


def test_encoders_against_the_person_by_hand():
    """80 % of the knee with 3 degrees more, half of the hip turned round."""
    e = worn(
        [lambda t: 0.0 * t, lambda t: 0.8 * bends(40.0)(t) + 3.0,
         lambda t: -0.5 * bends(60.0)(t) - 4.0],
        [lambda t: 0.0 * t, bends(40.0), bends(60.0)],
    )  # fmt: skip
    found = list(plausibility.device_checks(e))
    assert told(found, "encoder_sign") == [(1.0, 0.5, True), (-1.0, 0.5, False)]
    assert "its sign looks flipped" in " ".join(c.sentence for c in found)
    assert told(found, "encoder_unit") == [(0.8, 0.4, True), (0.5, 0.4, True)]
    # Before the used part the person stood upright.
    assert told(found, "encoder_offset") == [
        (0.0, 9.0, True),
        (3.0, 9.0, True),
        (4.0, 9.0, True),
    ]
    # Speeds: a fifth of the knee's and one and a half of the hip's miss.
    miss = np.hypot(0.2 * 40, 1.5 * 60) / np.hypot(40, 60)
    (found,) = told(found, "encoder_motion")
    assert found[1:] == (35.0, False)
    assert found[0].expected == pytest.approx(100.0 * miss, rel=0.03)


def test_a_marker_that_leaps_near_the_used_part():
    """0.25 s around it at most; by less than 8 m/s, it is only told."""

    def leapt(*times, size=20.0):
        found = [MarkerFault("KNEE", t, size + k) for k, t in enumerate(times)]
        return plausibility._leap(made(leaps=tuple(found)))

    for times, value, limit in (
        ((), 0.0, 4.0), ((1.2, 2.3), 0.0, 4.0), ((1.3,), 20.0, 8.0),
        ((2.2,), 20.0, 8.0), ((1.6, 1.7), 21.0, 8.0),
    ):  # fmt: skip
        check = leapt(*times)
        assert told(check, "marker_leap") == [(value, limit, limit == 4.0)]
    assert check.level == "fail"
    assert "'KNEE' leaps at 1.7 s (by 21 m/s from" in check.sentence
    check = leapt(1.6, size=7.9)
    assert told(check, "marker_leap") == [(7.9, 4.0, False)]
    assert check.level == "note"


def test_leaps_are_between_frames_that_are_seen():
    """0.16 m in a hundredth of a second; hidden frames say nothing.

    A marker that moves on as fast leaps where it starts, and stops.
    """
    p = np.zeros((40, 2, 3))
    p[10:, 0, 1] = np.minimum(0.16 * np.arange(1, 31), 0.8)
    p[20:, 0, 0] = 0.14
    p[30, 1] = np.nan
    p[31:, 1] = 1.0
    data = MarkerData(np.arange(40) / 100.0, ("A", "B"), p, 100.0)
    found = leaps(data, ("B", "A"), 15.0)
    assert found == tuple(
        MarkerFault("A", t, pytest.approx(16.0)) for t in (0.1, 0.15)
    )


def test_markers_that_stand_still_beside_others_that_move():
    """Ten frames in one place, while the next marker moves by 0.1 m."""
    p = np.zeros((40, 3, 3))
    p[:, :, 0] = 0.01 * np.arange(40)[:, None]
    p[10:21, 0] = p[10, 0]
    p[30:34, 1] = p[30, 1]  # too few to tell
    p[15, 2] = np.nan
    data = MarkerData(np.arange(40) / 100.0, ("A", "B", "C"), p, 100.0)
    fault = MarkerFault("A", 0.1, pytest.approx(0.1))
    assert standstills(data, [["B", "A"], ["C"]]) == (fault,)
    assert standstills(data, [["C", "A"]]) == ()  # C is hidden meanwhile
    e = made(standstills=(MarkerFault("A", 1.6, 0.019),))
    assert told(plausibility._standstill(e), "marker_frozen") == [
        (0.019, 0.02, True)
    ]
    e.recording.motion.standstills += (MarkerFault("B", 1.7, 0.1),)
    check = plausibility._standstill(e)
    assert "'B' stays in exactly one place from 1.7 s" in check.sentence
    assert not check.holds


def test_feet_are_as_high_as_in_standing_while_they_bear():
    """Flat for a quarter of the time, 4 and 6 mm low; else a heel lifts."""
    feet = np.zeros((200, 2, 3))
    feet[..., 2] = [0.05, 0.02]
    feet[INSIDE, :, 2] += np.where(np.arange(N) < 15, -0.005, 0.03)[:, None]
    feet[INSIDE, 0, 2] += 0.001
    feet[INSIDE, 1, 2] -= 0.001
    e = made(feet={"left": feet}, without=("X",), absent=())
    e.subject.markers = SimpleNamespace(
        without=lambda names: SimpleNamespace(
            foot_heights_m=lambda side: np.array([0.05, 0.02])
        )
    )
    bears = np.outer(np.where(np.arange(N) < 40, 300.0, 0.0), np.eye(6)[2])
    known(e, plates={"left": bears})
    assert told(list(plausibility._floor(e)), "floor") == [(0.005, 0.015, True)]
    feet[..., 2] += 0.03
    (check,) = plausibility._floor(e)
    assert told(check, "floor") == [(0.025, 0.015, False)]
    assert "left foot are 25 mm higher than in standing" in check.sentence
    # A foot that rolls on its toes all the time is on the same floor.
    for rolls in ([0.18, 0.037], [0.09, 0.025]):
        feet[INSIDE, :, 2] = rolls
        assert list(plausibility._floor(e)) == []
    feet[..., 2] += 0.03
    (check,) = plausibility._floor(e)
    assert told(check, "floor") == [(0.0525, 0.015, False)]
    # A flat foot on another floor does not, though a marker is nearly as high.
    for up in ([0.022, 0.014], [-0.03, -0.01]):
        feet[INSIDE, :, 2] = np.array([0.05, 0.02]) + up
        (check,) = plausibility._floor(e)
        assert told(check, "floor") == [(abs(np.mean(up)), 0.015, False)]
    # Nor is it one dip of a marker that makes it roll.
    feet[INSIDE, :, 2] = np.array([0.05, 0.02]) + 0.05
    feet[INSIDE.start, 1, 2] -= 0.04
    (check,) = plausibility._floor(e)
    assert told(check, "floor") == [(0.05, 0.015, False)]
    # Where nothing is borne, a foot may be anywhere.
    assert list(plausibility._floor(known(e, plates={"left": 0 * bears}))) == []


def test_names_of_left_and_right_exchanged():
    feet = {
        side: np.full((200, 2, 3), y)
        for side, y in (("left", -0.1), ("right", 0.09))
    }
    for knee, cause in (
        (0.5, "names of left and right markers"),
        (-0.5, "marker_axes look turned round"),
    ):
        legs = {"left": np.full((200, 3), knee)}
        check = plausibility._foot_sides(made(feet=feet, legs=legs))
        assert told(check, "foot_sides") == [(-0.19, 0.0, False)]
        assert "0.19 m right of the other's" in check.sentence
        assert cause in check.sentence
    feet = {"left": feet["right"], "right": feet["left"]}
    check = plausibility._foot_sides(made(feet=feet, legs=legs))
    assert told(check, "foot_sides") == [(0.19, 0.0, True)]


def test_mats_on_one_side_alone_are_told():
    def judged(**shares):
        mats = [
            SimpleNamespace(
                name=name, segment="thigh", report={"forward_share": share}
            )
            for name, share in shares.items()
        ]
        return plausibility._one_sided(made(), mats, "a.asc")

    found = judged(thigh_front=-0.8, thigh_back=0.7)
    assert told(found, "mat_sides") == [(0.1 / 1.5, 0.9, True)]
    found = judged(thigh_front=-0.8)
    assert told(found, "mat_sides") == [(1.0, 0.9, False)]
    assert "(thigh_front) all press from the front" in found.sentence
    assert found.level == "note"
    # One that is wrapped around presses from all sides.
    assert told(judged(thigh_all=0.02), "mat_sides")[0][2]


def borne(name, force, late_s=0.0, seconds=2.4):
    """A trial whose motion asks for a swing, and plates that bear `force`."""
    e = made()
    e.trial.name, e.files.forces = name, f"{name}.mot"
    time = np.arange(-0.4, seconds, 0.01)
    seen = force(time - late_s)
    e.recording.forces = SimpleNamespace(
        time=time,
        recorded={
            side: np.outer(0.5 * seen + 10.0, np.eye(6)[2])
            for side in ("both", "chair")
        },
    )
    return known(e, needed_z=600.0 + 90.0 * np.sin(9.0 * TIME))


def swing(amount, rate=9.0):
    return lambda t: 590.0 + amount * np.sin(rate * t)


def test_force_misfit_by_hand():
    """The spread of what is missed; whether it is recorded at all."""
    own = borne("a", swing(60.0))
    wanted = np.std(30.0 * np.sin(9.0 * TIME[own.inside]))
    assert plausibility.force_misfit(own, own) == pytest.approx(wanted)
    late = borne("b", swing(90.0), 0.05)
    assert plausibility.force_misfit(own, late, 0.05) < 1e-9
    assert plausibility.force_misfit(own, late, -0.05) > 30.0
    short = borne("c", swing(90.0), seconds=1.9)
    assert np.isinf(plausibility.force_misfit(own, short))
    assert np.isfinite(plausibility.force_misfit(own, short, -0.1))


def test_what_an_own_lag_leaves_out_at_an_end_does_not_count():
    """A trial used to its end, its plates' clock set by some milliseconds."""
    used = TIME[borne("a", swing(60.0)).inside]
    whole = borne("a", swing(60.0), seconds=used[-1] - 0.015)
    assert np.isfinite(plausibility.force_misfit(whole, whole))
    other = borne("b", swing(60.0))
    *_, check, _ = plausibility.force_checks([whole, other])
    assert check.name.endswith("force_file") and check.holds
    # Nothing can be said where most of it was not recorded.
    half = borne("a", swing(60.0), seconds=used[0] + 0.4)
    for check in plausibility.force_checks([half, other]):
        assert check.value == 0.0 or check.where != "a.mot"


def test_one_foot_on_a_plate_counts_twice():
    both = borne("a", swing(90.0))
    alone = borne("a", swing(90.0))
    recorded = alone.recording.forces.recorded
    recorded["left"] = 0.5 * recorded.pop("both")
    own = plausibility.force_misfit(alone, alone)
    assert own == pytest.approx(plausibility.force_misfit(both, both))


def test_plates_with_another_clock():
    for late, holds in ((0.0, True), (0.02, True), (0.06, False)):
        (found,) = told(
            list(plausibility.force_checks([borne("a", swing(90.0), late)])),
            "force_clock",
        )
        assert found == (pytest.approx(1e3 * late), 25.0, holds)
    # A lag that gains little is none.
    noise = np.random.default_rng(1).normal(size=280)

    def noisy(t):
        return swing(90.0)(t) + 200.0 * noise[: len(t)]

    (found,) = told(
        list(plausibility.force_checks([borne("a", noisy, 0.06)])),
        "force_clock",
    )
    assert found == (0.0, 25.0, True)


def test_a_late_force_may_be_a_load_that_is_lifted_at_another_time():
    late = borne("a", swing(90.0), 0.06)
    box = Load("pelvis", mass_kg=10.5, at_m=(0.3, 0.2))
    for load, told in ((box, False), (replace(box, from_s=1.0), True)):
        late.files.loads = (load,)
        (check,) = plausibility.force_checks([late])
        assert ("not carried from from_s to to_s" in check.sentence) == told


def test_plates_of_another_trial():
    own = borne("a", swing(90.0))
    near, far = borne("b", swing(60.0)), borne("c", swing(90.0, 14.0))
    checks = list(plausibility.force_checks([own, near, far]))
    ratios = told(checks, "force_file")
    assert [holds for *_, holds in ratios] == [True, False, False]
    assert "forces of trial a fit this motion" in checks[5].sentence
    assert all(limit == 1.25 for _, limit, _ in ratios)
    far.files.forces = near.files.forces = own.files.forces  # parts of one
    assert len(list(plausibility.force_checks([own, near, far]))) == 4


def test_forces_of_a_movement_that_is_nearly_the_same():
    """Both files fit to a few newtons: which one does better tells nothing."""
    own, near = borne("a", swing(86.0)), borne("b", swing(90.0))
    few = plausibility.force_misfit(own, own)
    assert plausibility.force_misfit(own, near) < few < 0.01 * own.weight
    checks = list(plausibility.force_checks([own, near]))
    least = pytest.approx(few / (0.01 * own.weight), abs=1e-9)
    assert told(checks, "force_file")[0] == (least, 1.25, True)
    assert told(checks, "force_swap")[0][2]


def test_force_files_of_two_like_movements_exchanged():
    """Each fits well enough; that both fit better exchanged tells."""
    first, second = borne("a", swing(88.0)), borne("b", swing(92.0))
    known(first, needed_z=swing(92.0)(TIME))
    known(second, needed_z=swing(88.0)(TIME))
    checks = list(plausibility.force_checks([first, second]))
    assert all(holds for *_, holds in told(checks, "force_file"))
    assert not any(holds for *_, holds in told(checks, "force_swap"))
    assert checks[3].level == "note"  # alike movements may be sound
    assert "b fit" in checks[3].sentence and "forces" in checks[3].sentence


def test_a_clock_that_is_late_in_all_trials():
    """Of one trial 20 ms may be skin that slides; of all they are a clock."""

    def judged(*late):
        trials = [borne(str(t), swing(90.0, 7 + t), t) for t in late]
        for i, e in enumerate(trials):
            known(e, needed_z=600 + 90 * np.sin((7 + late[i]) * TIME))
        return list(plausibility.force_checks(trials))

    found = judged(0.02, 0.02)
    assert told(found, "force_clock")[0] == (20.0, 12.0, False)
    assert found[0].level == "note"
    assert "forces of all 2 trials fit" in found[0].sentence
    assert "times better if they are taken as +20 ms late;" in found[0].sentence
    assert told(found, "force_clock")[1:] == [(20.0, 25.0, True)] * 2
    assert told(judged(0.02, -0.02), "force_clock")[0] == (0.0, 12.0, True)
    assert told(judged(0.06, 0.06), "force_clock")[0] == (0.0, 12.0, True)
    assert len(told(judged(0.02), "force_clock")) == 1


def loaded(normal, moment):
    """Mats of the shank, and moments of the device's knee."""
    e = made()
    e.files.pressure = (SimpleNamespace(file="a.asc", mats=["mat"]),)
    e.files.exo_moments = None
    e.trial.cuffs = {"shank": SimpleNamespace(normal=np.array(normal))}
    e.recording.mats = [
        SimpleNamespace(
            name="mat", segment="shank", source="a.asc",
            report={"forward_share": 0.0},
        )
    ]  # fmt: skip
    e.trial.moments = np.zeros((2, 6))
    e.trial.moments[1, 4] = moment
    e.trial.device_moments = e.trial.moments[:, 3:]
    return list(plausibility.load_checks(e))


def test_mats_that_stand_still():
    for normal, holds in (((0, 0), False), ((30, 30), False), ((0, 2), True)):
        (found,) = told(loaded(normal, 0.0), "mat_still")
        assert found == (np.ptp(normal), 1.0, holds)


def test_a_devices_moment_is_that_of_a_device():
    """Half a metre of the body's weight; no knee's in N mm."""
    for moment, holds in ((0.4 * WEIGHT, True), (-0.6 * WEIGHT, False)):
        found = told(loaded((0, 9), moment), "device_moment")
        assert found[1] == (abs(moment), 0.5 * WEIGHT, holds)
        assert found[0] == found[2] == (0.0, 0.5 * WEIGHT, True)


def test_encoders_of_each_others_joints():
    e = worn(
        [lambda t: 0.0 * t, bends(60.0), bends(40.0)],
        [lambda t: 0.0 * t, bends(40.0), bends(60.0)],
    )
    (found,) = told(list(plausibility.device_checks(e)), "encoder_joints")
    assert found[1:] == (1.1, False) and found[0].expected > 1e6
    half = worn(
        [lambda t: 0.0 * t, bends(44.0), bends(56.0)],
        [lambda t: 0.0 * t, bends(40.0), bends(60.0)],
    )
    (found,) = told(list(plausibility.device_checks(half)), "encoder_joints")
    assert found == (4.0 / 16.0, 1.1, True)


def test_offsets_of_two_encoders_are_no_exchange():
    """As they read, the columns are half as far off exchanged."""
    e = worn(
        [
            lambda t: 0.0 * t,
            lambda t: bends(50.0)(t) - 6.0,
            lambda t: bends(40.0)(t) + 6.0,
        ],
        [lambda t: 0.0 * t, bends(50.0), bends(40.0)],
    )
    human, device = e.trial.q[:, 4:6], e.trial.q[:, 7:9]
    exchanged = np.linalg.norm(device[:, ::-1] - human)
    assert np.linalg.norm(device - human) > 1.5 * exchanged
    (found,) = told(list(plausibility.device_checks(e)), "encoder_joints")
    assert found[0].expected == pytest.approx(0.0, abs=1e-9)
    assert found[1:] == (1.1, True)


def test_a_flipped_encoder_is_no_exchange():
    e = worn(
        [lambda t: 0.0 * t, lambda t: -bends(60.0)(t), bends(40.0)],
        [lambda t: 0.0 * t, bends(60.0), bends(40.0)],
    )
    (found,) = told(list(plausibility.device_checks(e)), "encoder_joints")
    assert found[0].expected == pytest.approx(0.0, abs=1e-9)
    assert found[1:] == (1.1, True)


def test_an_encoder_that_is_frozen_for_a_while():
    """For 0.2 s in which the knee turns by 16 degrees."""

    def sticks(t):
        return bends(40.0)(np.where((t > 1.6) & (t < 1.8), 1.6, t))

    zero = lambda t: 0.0 * t  # noqa: E731
    e = worn([zero, sticks, zero], [zero, bends(40.0), zero])
    check = plausibility._frozen(e, 1)
    assert check.value == pytest.approx(16.0, abs=0.6)
    assert (check.limit, check.holds) == (5.0, False)

    # The same for less than a tenth of a second.
    def shortly(t):
        return bends(40.0)(np.where((t > 1.6) & (t < 1.69), 1.6, t))

    # Or before the used part, which begins at 1.5 s.
    def wakes(t):
        return bends(40.0)(np.maximum(t, 1.45))

    for own in (shortly, wakes):
        e = worn([zero, own, zero], [zero, bends(40.0), zero])
        assert plausibility._frozen(e, 1).holds


@pytest.mark.parametrize("lag", [0.05, -0.03, 0.08])
def test_the_lag_of_encoders_is_found_within_60_ms(lag, monkeypatch):
    def swings(t):
        return 50.0 * np.sin(4.0 * t)

    zero = lambda t: 0.0 * t  # noqa: E731
    e = worn([zero, swings, zero], [zero, swings, zero], lag)
    share, found = plausibility.misfit(e, e)
    if abs(lag) < 0.06:
        assert share < 1e-3 and found == pytest.approx(lag)
    else:
        assert share > 0.05 and found == pytest.approx(0.06)
    # Encoders that end a tenth of a second before the movement do not count.
    monkeypatch.setattr(plausibility, "_REACH_S", 0.0)
    angles = e.recording.angles
    for early, ends in ((1.25, True), (1.35, False)):  # of 3.2 s; needed: 2 s
        angles.time = 0.8 - early + np.arange(1200) / 500.0
        assert np.isfinite(plausibility.misfit(e, e)[0]) == ends
    angles.time = angles.time + 2.2
    assert plausibility.misfit(e, e)[0] == np.inf
    small = worn([zero] * 3, [zero, lambda t: 0.5 * swings(t) / 50.0, zero])
    assert plausibility.misfit(small, small) == (np.inf, 0.0)


def fitted(monkeypatch, fits):
    """Trials a, b, ... whose movements miss so much of each file."""

    def trial(name):
        return SimpleNamespace(
            recording=SimpleNamespace(
                angles=SimpleNamespace(values=np.full((2, 3), ord(name)))
            ),
            files=SimpleNamespace(markers=f"{name}.trc", encoders="e"),
            trial=SimpleNamespace(name=name),
            check=lambda check, value, _, holds=None, level="fail": (
                *(name, check, value, plausibility.LIMITS[check][0]),
                holds,
            ),
        )

    def fit(e, other):
        return fits[e.trial.name + other.trial.name], 0.0

    monkeypatch.setattr(plausibility, "misfit", fit)
    return [trial(name) for name in sorted({pair[0] for pair in fits})]


def test_files_of_two_trials_by_how_they_fit(monkeypatch):
    """Of each movement with each file."""
    fits = {"aa": 0.3, "ab": 0.15, "ba": 0.25, "bb": 0.4}
    a, b = fitted(monkeypatch, fits)
    found = list(plausibility.between_trials([a, b]))
    approx = pytest.approx
    assert found[0] == ("a", "encoder_file", approx(1.2), 1.5, True)
    assert found[2] == ("b", "encoder_file", approx(4 / 1.5), 1.5, False)
    swap = np.hypot(0.3, 0.4) / np.hypot(0.15, 0.25)
    assert [f[:4] for f in found[1::2]] == [
        (name, "encoder_swap", approx(swap), 1.25) for name in "ab"
    ]
    fits["ba"] = 0.1
    first, *_ = plausibility.between_trials([a, b])
    assert first == ("a", "encoder_file", approx(3.0), 1.5, False)
    fits["ba"] = 0.6
    b.recording.angles.values = a.recording.angles.values
    first, *_ = plausibility.between_trials([a, b])
    assert first == ("a", "encoder_file", approx(0.5), 1.5, False)
    b.files.markers = a.files.markers  # parts of one recording
    assert list(plausibility.between_trials([a, b])) == []


def test_a_file_that_fits_as_well_as_others_is_its_own_trials(monkeypatch):
    """However well another movement happens to fit it."""
    approx = pytest.approx
    fits = {x + y: 0.05 if x == y else 0.3 for x in "abc" for y in "abc"}
    fits["ba"] = 0.03
    trials = fitted(monkeypatch, fits)
    first, *_ = plausibility.between_trials(trials)
    assert first == ("a", "encoder_file", approx(1.0), 1.5, True)
    fits["aa"] = 0.09  # cuffs hide less from the others
    first, *_ = plausibility.between_trials(trials)
    assert first == ("a", "encoder_file", approx(1.8), 1.5, False)
    fits["aa"] = fits["ba"] = fits["ca"] = np.inf  # ends too early
    first, *_ = plausibility.between_trials(trials)
    assert first == ("a", "encoder_file", 0.0, 1.5, True)
    assert list(plausibility.between_trials([])) == []


def test_a_lone_foot_is_judged_along_alone():
    """Across, the other foot may bear anywhere: nothing is said."""
    feet = shod(left=(0.1, 0.1))
    e = made(feet=feet, legs={"left": np.zeros((200, 3))})
    e.recording.forces = SimpleNamespace(recorded={})
    e.recording.chair = None
    known(e, plates={"both": pressed(x=0.5, y=0.9)})
    found = list(plausibility.plate_checks(e))
    assert told(found, "cop_along") == [(0.5 - 0.38, 0.03, False)]
    names = [c.name.removeprefix("plausibility.") for c in found]
    assert names == ["cop_along", "cop_unit"]
    known(e, plates={"right": pressed(x=0.5, y=0.9)})
    assert list(plausibility.plate_checks(e)) == []  # no markers, no judgement


def test_the_most_upright_twentieth_lies_around_where_least_is_bent():
    human = np.abs(np.arange(400.0) - 250.0)[:, None] * [1.0, -1.0, 0.5]
    found = np.flatnonzero(plausibility._most_upright(human))
    assert (found[0], found[-1]) == (240, 260)
    few = np.flatnonzero(plausibility._most_upright(human[200:260]))
    assert few.tolist() == [48, 49, 50, 51, 52]


def test_the_used_part_holds_the_frames_at_its_ends():
    """However times are rounded."""
    e = made()
    vars(e).pop("inside")
    e.trial.start_s = np.nextafter(1.5, 2.0)
    assert e.inside.sum() == N
    vars(e).pop("inside")
    e.trial.start_s, e.trial.duration = 1.5, np.nextafter(0.49, 0.0) - 1e-15
    assert e.inside.sum() == N


def test_trials_with_time_in_common():
    parts = []
    for name, start, duration in (
        ("a", 0.4, 2.0),
        ("b", 0.4 + 2.0, 1.0),
        ("c", 2.1, 1.0),
    ):
        e = made()
        e.trial.name, e.trial.start_s, e.trial.duration = name, start, duration
        e.files.markers = "squats.trc"
        parts.append(e)
    found = list(plausibility.overlap_checks(parts))
    assert [c.where for c in found] == ["c", "c"]
    assert told(found, "overlap") == [(0.3, 0.0, False), (0.7, 0.0, False)]
    assert all(c.level == "note" for c in found)
    assert "overlaps with a," in found[0].sentence
    parts[2].files.markers = "another.trc"
    assert list(plausibility.overlap_checks(parts)) == []


@pytest.mark.parametrize("turned", [0.0, 30.0, -80.0])
def test_who_moves_in_no_direction_faces_in_none(turned):
    """Sway in standing is nearly as fast across as along."""
    turn = np.exp(1j * np.deg2rad(turned))
    swing = np.sin(40.0 * TIME)
    rates = {}
    for across in (0.1, 0.6):
        place = turn * 0.01 * (swing + 1j * across * np.roll(swing, 4))
        plan = np.stack([place.real, place.imag], axis=1)[:, None]
        plan = np.concatenate([plan, plan + 0.1, plan * np.nan], axis=1)
        e = made(ground_plan=plan, legs={"left": np.zeros((len(TIME), 3))})
        rates[across] = list(plausibility._facing(e))
    assert rates[0.6] == []
    (check,) = rates[0.1]
    assert check.value == pytest.approx(abs(turned), abs=6.0)
    assert check.holds == (turned == 0.0)
