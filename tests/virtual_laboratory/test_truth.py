"""What is drawn, planned and told: numbers against those that docs name."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from test_instruments import happened

from drake_exo.contact.parameters import nominal_contact
from drake_exo.files.output import read_json
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import nominal_model
from drake_exo.model.segments import CONTACT_RADIUS_M, SEGMENTS
from drake_exo.virtual_laboratory import campaign, truth
from drake_exo.virtual_laboratory.forces import (
    BUTTOCKS,
    Cuff,
    cuff_force,
    seat_depth,
    seat_wrench,
)
from drake_exo.virtual_laboratory.instruments import (
    CONFIGURATIONS,
    Faults,
    Laboratory,
)
from drake_exo.virtual_laboratory.plan import (
    DeviceController,
    Friction,
    Posture,
    RisePlan,
    SubjectController,
)
from drake_exo.virtual_laboratory.truth import (
    STANDING_COP_M,
    TRUTH,
    WIDE,
    draw_truth,
    truth_table,
    write_parameters,
)

MODEL = nominal_model("coupled")
USUAL = nominal_contact(MODEL)
DRAWS = 60


@pytest.fixture(scope="module")
def drawn():
    """Truths of many seeds, by kind and disturbances; soles not levelled."""

    def several(kind, *active, count=DRAWS):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(truth, "levelled", lambda tree, contact, *_: contact)
            patch.setattr(truth, "nominal_model", lambda kind: MODEL)
            patch.setattr(truth, "fit_exoskeleton", lambda _: MODEL.exoskeleton)
            return [
                draw_truth(np.random.default_rng(k), frozenset(active), kind)
                for k in range(count)
            ]

    return several


def within(values, low, high, share=0.15):
    """All between two limits, and nearly up to both."""
    reach = high - low
    values = np.ravel(values)
    assert low - 1e-9 <= values.min() < low + share * reach
    assert high - share * reach < values.max() <= high + 1e-9


def test_friction_is_viscous_and_dry_against_the_motion():
    friction = Friction((0.3, 0.5, 0.7), (0.8, 1.2, 1.5), 0.05)
    rates = np.array([[0.0, 10.0, -10.0], [0.05, -0.05, 0.0]])
    expected = [
        [0.0, -5.0 - 1.2, 7.0 + 1.5],
        [-0.015 - 0.8 * np.tanh(1.0), 0.025 + 1.2 * np.tanh(1.0), 0.0],
    ]
    np.testing.assert_allclose(friction.torques(rates), expected)
    assert DeviceController(MODEL, (0.0, 0.0, 0.0), friction).torques(
        np.zeros(2), rates, rates, np.zeros(2)
    ) == pytest.approx(np.array(expected))


def test_a_cuff_stiffens_and_slips_by_the_formula():
    bushing = USUAL.bushings["thigh"]
    cuff = Cuff(bushing, progression=1.0 / 0.02, slip=1.0 / 25.0)
    rest = (0.0, 0.0, 0.0)
    k = bushing.normal_stiffness
    # At 20 mm the spring is twice as stiff as at rest.
    force = cuff_force(cuff, (0.0, 0.02, 0.3), rest)
    plain = cuff_force(Cuff(bushing), (0.0, 0.02, 0.3), rest)
    sign = np.sign(plain.normal)
    assert abs(plain.normal) == pytest.approx(0.02 * k)
    assert force.normal == pytest.approx(sign * 2.0 * 0.02 * k)
    assert force.rotation == pytest.approx(plain.rotation)
    along = cuff_force(replace(cuff, slip=0.0), (0.01, 0.0, 0.0), rest)
    linear = cuff_force(Cuff(bushing), (0.01, 0.0, 0.0), rest).tangential
    assert along.tangential == pytest.approx(1.25 * linear)
    slipping = cuff_force(cuff, (0.01, 0.0, 0.0), rest).tangential
    F = along.tangential
    assert slipping == pytest.approx(F / np.sqrt(1.0 + (F / 25.0) ** 2))
    # Damping acts on top, whatever the spring does.
    moving = cuff_force(cuff, (0.0, 0.02, 0.0), (0.0, 0.1, 0.0)).normal
    still = cuff_force(cuff, (0.0, 0.02, 0.0), rest).normal
    slow = cuff_force(Cuff(bushing), (0.0, 0.0, 0.0), (0.0, 0.1, 0.0)).normal
    assert moving - still == pytest.approx(slow)
    assert abs(slow) == pytest.approx(0.1 * bushing.normal_damping)


def test_a_seat_bears_its_load_at_the_static_depth():
    depth = seat_depth(500.0)
    # The sphere's lowest point that far below the seat.
    z = 0.45 - depth + BUTTOCKS.radius - BUTTOCKS.z
    w = seat_wrench(0.45, (0.2, z), (1.0, 0.0), (0.0, 0.0, 0.0))
    assert w.force_z == pytest.approx(500.0, rel=0.05)  # smoothed
    assert w.force_x == pytest.approx(0.0, abs=1e-9)
    # Simbody's point, half the depth below the surfaces' middle.
    assert w.point_x == pytest.approx(0.2 + BUTTOCKS.x, abs=1e-6)
    assert w.point_z == pytest.approx(0.45, abs=depth)


def test_spheres_of_a_simple_truth_are_near_nominal_ones(drawn):
    truths = drawn("near")
    for name, usual in USUAL.ground.spheres.items():
        found = [t.contact.spheres[name] for t in truths]
        for key in ("stiffness", "dissipation"):
            ratio = [getattr(s, key) / getattr(usual, key) for s in found]
            within(np.log(ratio), np.log(0.74), np.log(1.35))
        assert all(s.radius == usual.radius for s in found)
        within([s.x - usual.x for s in found], -0.012, 0.012)
        assert all(s.z == usual.z for s in found)


@pytest.mark.parametrize(
    ("kind", "shares", "damping", "origin"),
    [
        ("near", (0.74, 1.35), None, (-0.015, 0.015)),
        ("wide", (1.3 / 3.3, 1.3 * 3.3), (1.3 / 3.3, 4.29), (-0.022, 0.038)),
    ],
)
def test_cuffs_are_drawn_about_nominal_ones(
    drawn, kind, shares, damping, origin
):
    cuffs = [t.cuffs for t in drawn(kind)]
    for key in vars(USUAL.bushings["thigh"]):
        pairs = [
            (getattr(c[name].bushing, key), getattr(usual, key))
            for c in cuffs
            for name, usual in USUAL.bushings.items()
        ]
        if key.startswith("origin"):
            within([a - b for a, b in pairs], *origin)
        elif key.endswith("_stiffness"):
            within(np.log([a / b for a, b in pairs]), *np.log(shares))
        elif key.endswith("_damping") and damping:
            within(np.log([a / b for a, b in pairs]), *np.log(damping))
        else:
            assert all(a == b for a, b in pairs)
    assert all(
        c.progression == c.slip == 0.0 for d in cuffs for c in d.values()
    )


def test_names_switch_on_what_they_say(drawn):
    (rich,) = drawn("near", *TRUTH, count=1)
    cuff = rich.cuffs["pelvis"]
    assert cuff.progression == pytest.approx(50.0)
    assert cuff.slip == pytest.approx(0.04)
    assert rich.friction == Friction((0.3, 0.5, 0.5), (0.8, 1.2, 1.5))
    assert len(rich.contact.spheres) == 5
    (plain,) = drawn("near", count=1)
    assert plain.friction == Friction()
    assert len(plain.contact.spheres) == 2
    assert plain.model == MODEL


def test_five_spheres_lie_from_heel_to_toe(drawn):
    device = MODEL.exoskeleton
    heel, toe = device.heel_m, device.toe_m
    length = toe[0] - heel[0]
    spheres = [t.contact.spheres for t in drawn("near", "contact")]
    shares = {
        "calcaneus_back": (-0.08, 0.025, 0.45),
        "calcaneus_front": (0.10, 0.030, 0.50),
        "midfoot": (0.42, 0.035, 0.15),
        "metatarsals": (0.80, 0.030, 0.60),
        "toes": (1.08, 0.022, 0.40),
    }
    assert list(spheres[0]) == list(shares)
    nominal = USUAL.ground.spheres["heel"]
    for name, (at, radius, share) in shares.items():
        found = [s[name] for s in spheres]
        x = np.array([s.x for s in found]) - heel[0] - at * length
        within(x, -0.006, 0.006)
        assert all(s.radius == radius for s in found)
        stiffness = [s.stiffness / nominal.stiffness for s in found]
        within(np.log(np.array(stiffness) / share), *np.log([0.74, 1.35]))
        ratio = [s.dissipation / nominal.dissipation for s in found]
        within(np.log(ratio), *np.log([0.74, 1.35]))
    # Lowest points of a sole that is level but for a millimetre each.
    low = np.array([[v.z - v.radius for v in s.values()] for s in spheres])
    within(low - heel[1] + CONTACT_RADIUS_M, -0.001, 0.001)


def test_masses_are_shared_out_in_another_way(drawn):
    usual = MODEL.human
    truths = drawn("near", "segments")
    for name in SEGMENTS:
        parts = [getattr(t.human, name) for t in truths]
        own = getattr(usual, name)
        ratio = np.array([p.mass_kg / own.mass_kg for p in parts])
        if name != "pelvis":
            within(ratio, 0.97, 1.03)
        inertia = [p.inertia_kg_m2 / own.inertia_kg_m2 for p in parts]
        np.testing.assert_allclose(inertia, ratio)
        assert all(p.length_m == own.length_m for p in parts)
    for made in truths:
        assert made.human.mass_kg == pytest.approx(usual.mass_kg)


@pytest.mark.slow
def test_a_body_of_other_lengths(drawn):
    usual = MODEL.human
    truths = drawn("wide", "body")
    for name in SEGMENTS:
        own = getattr(usual, name)
        parts = [getattr(t.human, name) for t in truths]
        ratio = np.array([p.length_m / own.length_m for p in parts])
        x, z = np.array([p.com_m for p in parts]).T
        if name == "foot":
            assert set(ratio) == {1.0}
            assert set(zip(x, z, strict=True)) == {own.com_m}
            continue
        within(ratio, 0.96, 1.04)
        within(x - own.com_m[0], -0.008, 0.008)
        within((z - ratio * own.com_m[1]) / own.length_m, -0.03, 0.03)
        inertia = [p.inertia_kg_m2 / own.inertia_kg_m2 for p in parts]
        np.testing.assert_allclose(inertia, ratio**2)
        assert all(p.mass_kg == own.mass_kg for p in parts)
    (other,) = drawn("wide", count=1)
    assert other.model == MODEL


def test_a_plan_varies_within_its_limits():
    usual = RisePlan()
    plans = [campaign.vary(usual, np.random.default_rng(k)) for k in range(200)]
    for posture, spread in (("seated", (2, 2, 3)), ("leant", (2, 2, 4))):
        for angle, reach in zip(
            ("shank", "knee", "trunk"), spread, strict=True
        ):
            middle = getattr(getattr(usual, posture), angle)
            values = [getattr(getattr(p, posture), angle) for p in plans]
            within(values, middle - reach, middle + reach)
    within([p.lean_s / usual.lean_s for p in plans], 0.9, 1.15)
    within([p.rise_s for p in plans], 1.2, 1.7)
    within([p.cop_m - usual.cop_m for p in plans], -0.01, 0.01)
    assert all(p.standing == usual.standing for p in plans)


def test_joints_of_a_posture_add_up_to_the_trunk():
    angles = Posture(shank=10.0, knee=90.0, trunk=30.0).joints(
        np.deg2rad([0.0, 5.0])
    )
    # A trunk leans by shank - knee + hip.
    np.testing.assert_allclose(
        np.rad2deg(angles), [[10.0, 90.0, 110.0], [15.0, 90.0, 110.0]]
    )


def test_a_window_begins_when_the_chair_is_felt_no_more():
    trial = happened()
    F = trial.chair.force.copy()
    F[:, 1] = np.interp(trial.times, [0.0, 1.0, 1.0101], [300.0, 202.0, 0.0])
    trial = replace(trial, chair=type(trial.chair)(F, 0.0 * trial.times))
    plan = replace(RisePlan(), quiet_s=0.2, lean_s=0.3, rise_s=0.7, stand_s=0.5)
    # 2 N are passed at 1.01 s; both in frames of 10 ms.
    assert campaign._window(trial, plan, None) == (1.09, 1.3)
    cut = [
        campaign._window(trial, plan, np.random.default_rng(k))
        for k in range(80)
    ]
    starts, ends = np.array(cut).T
    within(ends, 1.25, 1.35)
    # Smoothed, above 10 N with an offset of up to 5 N: later, and spread.
    assert starts.min() >= 1.09 and starts.max() < 1.25 and np.ptp(starts) > 0
    np.testing.assert_allclose(np.round(100.0 * starts), 100.0 * starts)


@pytest.mark.slow
def test_clocks_are_up_to_40_ms_apart_and_told(tmp_path, monkeypatch):
    """The files' clocks are those that truth tells, to the millisecond."""
    told, given = [], []

    class Instruments:
        folder = tmp_path

        def record_motion(self, *_):
            pass

        def record_device(self, trial, clocks, moments, rng):
            given.append((clocks, moments))

        def record_pressure(self, trial, mats, lag):
            pressed.append((mats, lag))

    job = campaign.Campaign.__new__(campaign.Campaign)
    job.truth = draw_truth(np.random.default_rng(0), frozenset())
    job.laboratory, pressed = Instruments(), []
    job.mats = [mat for mats in CONFIGURATIONS.values() for mat in mats]
    job.planner = SimpleNamespace(seat=lambda _: None, movement=lambda *_: None)
    monkeypatch.setattr(campaign, "simulate", lambda *_: happened())
    monkeypatch.setattr(campaign, "_window", lambda *_: (0.0, 1.0))
    monkeypatch.setattr(campaign.Campaign, "entry", lambda *_: {})
    (tmp_path / "truth").mkdir()
    movement = campaign.Repetition("assisted", "legs", 3)
    job.laboratory.faults = Faults()
    job.laboratory.disturbances = frozenset(["clocks"])
    for seed in range(40):
        job.seed = seed
        job.record(movement)
        told.append(read_json(tmp_path / "truth" / "bow_clocks.json", ""))
    lags = np.array([(c.device, c.mats) for c, _ in given])
    within(lags, -0.04, 0.04)
    np.testing.assert_allclose(1e3 * lags, np.round(1e3 * lags))
    assert told == [{"device": d, "mats": m} for d, m in lags.tolist()]
    assert all(moments for _, moments in given)
    assert pressed[-1] == (list(CONFIGURATIONS["legs"]), lags[-1, 1])
    job.laboratory.disturbances = frozenset()
    job.record(campaign.Repetition("passive", "legs", 3))
    assert vars(given[-1][0]) == {"device": 0.0, "mats": 0.0}
    assert given[-1][1] is False


def test_truth_is_written_in_si_units(tmp_path):
    trial = happened()
    table = truth_table(trial, 10)
    np.testing.assert_array_equal(table.time, trial.times[::10])
    names = trial.coordinates
    for suffix, values in (("", trial.q), ("_speed", trial.v)):
        for k, name in enumerate(names.names):
            np.testing.assert_array_equal(
                table.column(name + suffix), values[::10, k]
            )
    for k, name in enumerate(names.joints):
        np.testing.assert_array_equal(
            table.column(f"{name}_torque"), trial.moments[::10, k]
        )
    for k, part in enumerate(("force_x", "force_z", "moment_y")):
        for place in ("ground", "chair"):
            np.testing.assert_array_equal(
                table.column(f"{place}_{part}"),
                getattr(trial, place).array[::10, k],
            )
    for cuff, force in trial.cuffs.items():
        np.testing.assert_array_equal(
            table.column(f"{cuff}_normal"), force.normal[::10]
        )
    made = draw_truth(np.random.default_rng(0), frozenset(TRUTH))
    write_parameters(tmp_path, made, {"seed": 7})
    told = read_json(tmp_path / "interaction.json", "")
    assert told["seed"] == 7
    for cuff, own in made.cuffs.items():
        assert own.slip > 0.0
        for key, value in (vars(own.bushing) | {"slip": own.slip}).items():
            assert told["parameters"][f"{cuff}.{key}"] == value
    told = read_json(tmp_path / "foot_ground.json", "")["parameters"]
    for name, sphere in made.contact.spheres.items():
        assert told[f"{name}.stiffness"] == sphere.stiffness


def written_study(tmp_path, active, files="c3d", **faults):
    made = draw_truth(np.random.default_rng(0), frozenset(["friction"]))
    laboratory = Laboratory(
        tmp_path,
        made.model,
        files,
        {},
        np.zeros((0, 2)),
        {},
        frozenset(active),
        Faults(**faults),
    )
    job = campaign.Campaign.__new__(campaign.Campaign)
    job.truth, job.laboratory = made, laboratory
    entries = [
        job.entry(movement, CONFIGURATIONS[movement.configuration], *window)
        for movement, window in (
            (campaign.Repetition("passive", "pelvis", 4), (1.25, 2.5)),
            (campaign.Repetition("assisted", "legs", 3), (1.0, 2.0)),
        )
    ]
    path = tmp_path / "study.yaml"
    campaign.write_yaml(path, "", job.study({}, entries))
    return made, yaml.safe_load(path.read_text())


@pytest.mark.slow
def test_the_study_tells_what_a_laboratory_knows(tmp_path):
    made, study = written_study(
        tmp_path,
        ["gaps", "plate_drift", "clocks"],
        friction_share=(0.5, 1.0, 1.5),
    )
    assert study["subject"]["mass_kg"] == round(made.human.mass_kg, 3)
    assert study["subject"]["height_m"] == round(made.human.height_m, 4)
    assert study["gravity_m_s2"] == made.model.gravity_m_s2
    assert study["filter"] == {"cutoff_hz": 6.0, "order": 4}
    section = study["laboratory"]
    assert section["remove_plate_drift"] and section["fill_gaps_s"] == 0.2
    assert section["estimate_encoder_delay"]
    for k, (joint, viscous, coulomb) in enumerate(
        [("ankle", 0.3, 0.8), ("knee", 0.5, 1.2), ("hip", 0.5, 1.5)]
    ):
        share = (0.5, 1.0, 1.5)[k]
        own = study["device"][joint]
        assert own["viscous_nm_s"] == pytest.approx(share * viscous)
        assert own["coulomb_nm"] == pytest.approx(share * coulomb)
        assert own["coulomb_speed_rad_s"] == 0.05
    one, two = study["trials"]
    assert (one["start_s"], one["end_s"]) == (1.25, 2.5)
    assert (one["use"], two["use"]) == ("calibration", "prediction")
    assert "exo_moments" not in one
    assert two["exo_moments"] == "assisted_legs_3_3_moments.csv"
    assert one["pressure"][0]["mats"] == ["pelvis_front", "pelvis_back"]
    assert two["plates"] == {"left": 1, "right": 2, "chair": 3}
    noise = {p: study[p]["noise"] for p in ("foot_ground", "interaction")}
    assert noise["foot_ground"]["force_n"] == 3.0
    assert noise["interaction"]["exo_angle_deg"] == 0.1
    for phase in ("interaction", "prediction"):
        assert study[phase]["noise"]["energy_j"] == 1.0
    assert study["foot_ground"]["solver"] == {"nodes_per_second": 100.0}
    _, plain = written_study(tmp_path, [], "opensim")
    assert plain["laboratory"] == {}
    assert "empty_plates" not in plain["trials"][0]
    assert plain["trials"][1]["exo_moments"] == "assisted_legs_3_3_moments.mot"


def reference() -> Trial:
    """A plan that moves linearly, with torques and load of its own."""
    times = np.linspace(0.0, 1.0, 11)
    q = np.zeros((11, 6))
    q[:, 3:] = np.outer(times, [0.3, 0.6, 0.9])
    q[:, 2] = 0.1 * times
    v = np.tile([0.0, 0.0, 0.1, 0.3, 0.6, 0.9], (11, 1))
    torque = np.tile([10.0, 20.0, 30.0], (11, 1))
    load = np.tile([0.0, 800.0, -40.0], (11, 1))
    return Trial(
        *("plan", MODEL.rigid.coordinates, times, q, v, 0.0 * v),
        PlanarWrench.of(load),
        moments=torque,
    )


def test_the_subject_holds_its_plan_by_stiffness_and_damping():
    """The ankle against the vertical: its angle less the foot's pitch."""
    help_expected = np.tile([1.0, 2.0, 3.0], (11, 1))
    subject = SubjectController(MODEL.coordinates, reference(), help_expected)
    q = np.zeros(9)
    q[2:6] = 0.05, 0.15, 0.3, 0.45  # on the plan at 0.5 s
    v = np.zeros(9)
    v[2:6] = 0.1, 0.3, 0.6, 0.9
    time = np.array(0.5)
    np.testing.assert_allclose(subject.torques(time, q, v), [9.0, 18.0, 27.0])
    off, late = q.copy(), v.copy()
    off[3:6] -= 0.01
    late[3:6] -= 0.1
    np.testing.assert_allclose(
        subject.torques(time, off, v), [9.0 + 30.0, 18.0 + 20.0, 27.0 + 20.0]
    )
    np.testing.assert_allclose(
        subject.torques(time, q, late), [9.0 + 25.0, 18.0 + 12.0, 27.0 + 12.0]
    )
    tipped = q.copy()
    tipped[2] += 0.01
    np.testing.assert_allclose(
        subject.torques(time, tipped, v), [9.0 + 30.0, 18.0, 27.0]
    )
    # Before and after, its ends.
    q[2:6] = 0.1, 0.3, 0.6, 0.9
    np.testing.assert_allclose(
        subject.torques(np.array(5.0), q, v), [9.0, 18.0, 27.0]
    )


def test_the_device_helps_as_the_feet_are_loaded():
    """A share of gravity's torque; none below half the weight."""
    share = np.array([0.1, 0.2, 0.3])
    device = DeviceController(MODEL, tuple(share), Friction())
    tree = MODEL.rigid.tree
    angles = np.tile([0.2, 1.0, 0.8], (4, 1))
    load = tree.weight * np.array([0.5, 0.7, 0.9, 1.2])
    q = np.zeros((1, 6))
    q[0, 3:] = angles[0]
    plant = nominal_model("rigid").plant()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q[0])
    gravity = -plant.CalcGravityGeneralizedForces(context)[3:]
    expected = np.outer([0.0, 0.5, 1.0, 1.0], share * gravity)
    found = device.help(np.zeros(4), angles, 0.0 * angles, load)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_standing_is_over_the_named_centre_of_pressure():
    assert STANDING_COP_M == 0.045
    assert set(WIDE) >= {"legs", "body", "bench", "mat_share"}
