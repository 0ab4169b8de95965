"""Every disturbance of an instrument is as large as it is said to be.

What the laboratory hands to its files is caught before it is written and
compared with what happened, one disturbance at a time.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from angles import in_radians

from drake_exo.files.c3d import read_c3d
from drake_exo.files.opensim import read_plates, read_table, read_trc
from drake_exo.files.pressure import read_novel_asc
from drake_exo.files.tables import plate_axes, read_csv_table
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.plant import nominal_model
from drake_exo.virtual_laboratory import instruments
from drake_exo.virtual_laboratory.instruments import (
    PLATES,
    Clocks,
    Faults,
    Laboratory,
    Marker,
    Skin,
    _corners,
    draw_faults,
    draw_skin,
    empty_plate_levels,
    marker_positions,
    marker_set,
    plate_recording,
    slides,
    soft_tissue,
    turned_skin,
)
from drake_exo.virtual_laboratory.truth import WIDE

MODEL = nominal_model("coupled")
TREE = MODEL.tree
NAMES = MODEL.coordinates
MARKERS = marker_set(MODEL.human)


def happened(duration=2.0) -> Trial:
    """A slow bow at 1000 Hz; every signal has its own size."""
    t = np.arange(round(duration * 1000) + 1) / 1000.0
    s = t / duration
    q = np.zeros((len(t), 9))
    q[:, 1] = 0.07
    q[:, 3:6] = np.outer(s, [0.3, 1.2, 0.9])
    q[:, 6:] = np.outer(s, [0.28, 1.25, 0.8])
    force = np.column_stack([15.0 * s, 400.0 + 400.0 * s])
    seat = np.column_stack([2.0 + 0.0 * s, 300.0 * (1.0 - s)])
    return Trial(
        "bow",
        NAMES,
        t,
        q,
        np.gradient(q, t, axis=0),
        0.0 * q,
        PlanarWrench(force, -0.05 * force[:, 1]),
        moments=np.outer(1.0 + s, [10.0, 20.0, 30.0, 1.0, 2.0, 3.0]),
        cuffs={
            "pelvis": CuffForce(40.0 * s - 20.0),
            "thigh": CuffForce(30.0 * s),
            "shank": CuffForce(10.0 - 20.0 * s),
        },
        chair=PlanarWrench(seat, 0.4 * seat[:, 1]),
    )


@dataclass(frozen=True)
class Caught(Laboratory):
    """A laboratory whose files are what it would have written."""

    written: dict = field(default_factory=dict)

    def _write(self, name, positions, plates):
        self.written.update(positions=positions, plates=plates)

    def _write_device(self, name, what, table, unit):
        self.written[what] = table, unit


def laboratory(tmp_path, *active, **faults) -> Caught:
    offsets = {p: np.array([1.0, -3.0, 0.4]) * n for p, n in PLATES.items()}
    return Caught(
        tmp_path,
        MODEL,
        "c3d",
        MARKERS,
        slides(MARKERS, np.random.default_rng(0)),
        offsets,
        frozenset(active),
        Faults(**faults),
    )


def recorded(tmp_path, *active, seed=1, **faults) -> dict:
    made = laboratory(tmp_path, *active, **faults)
    made.record_motion(happened(), np.random.default_rng(seed))
    return made.written


def wrench(plate) -> np.ndarray:
    """F_x, F_z, M_y about the origin by the definition of a plate (N, 3)."""
    moment = np.cross(plate.point, plate.force) + plate.torque
    return np.column_stack(
        [plate.force[:, 0], plate.force[:, 1], -moment[:, 2]]
    )


def test_markers_are_where_the_links_are(tmp_path):
    found = recorded(tmp_path)["positions"]
    trial, plant = happened(), MODEL.plant()
    assert len(found) == 201  # 100 Hz
    context = plant.CreateDefaultContext()
    for frame in (0, 120, 200):
        plant.SetPositions(context, trial.q[10 * frame])
        for i, m in enumerate(MARKERS.values()):
            X_WB = plant.EvalBodyPoseInWorld(
                context, plant.GetBodyByName(m.body)
            )
            x, _, z = X_WB @ np.array([m.x_m, 0.0, m.z_m])
            np.testing.assert_allclose(
                found[frame, i], [x, z, -m.y_m], atol=1e-12
            )


def test_marker_noise_is_white_and_of_03_mm(tmp_path):
    clean = recorded(tmp_path)["positions"]
    off = recorded(tmp_path, "marker_noise")["positions"] - clean
    assert off.std() == pytest.approx(3e-4, rel=0.03)
    assert abs(off.mean()) < 1e-5
    beside = np.mean(off[1:] * off[:-1]) / off.var()
    assert abs(beside) < 0.03


def test_gaps_are_only_where_asked_for(tmp_path):
    assert np.isfinite(recorded(tmp_path)["positions"]).all()
    gone = np.isnan(recorded(tmp_path, "gaps")["positions"])
    assert 0 < gone.any(axis=(0, 2)).sum() <= 6
    made = laboratory(tmp_path, "gaps")
    made.record_motion(happened(), np.random.default_rng(0), hidden=False)
    assert np.isfinite(made.written["positions"]).all()


def test_skin_slides_in_proportion_to_flexion(tmp_path):
    """Millimetres a radian, along and across the link, none on the foot."""
    q = happened().q[::10]
    joint = {"foot": 3, "shank": 4, "thigh": 4, "pelvis": 5}
    slide = np.random.default_rng(3).normal(size=(len(MARKERS), 2))
    off = soft_tissue(TREE, q, MARKERS, slide)
    assert (off[:, :, 2] == 0.0).all()
    for i, m in enumerate(MARKERS.values()):
        moved = np.hypot(off[:, i, 0], off[:, i, 1])
        size = np.hypot(*slide[i]) * q[:, joint[m.body]]
        np.testing.assert_allclose(moved, size, atol=1e-12)
        # As if the marker sat elsewhere on its link.
        at = 150
        shift = slide[i] * q[at, joint[m.body]]
        other = replace(m, x_m=m.x_m + shift[0], z_m=m.z_m + shift[1])
        where = marker_positions(TREE, q[[at]], {"a": m, "b": other})[0]
        np.testing.assert_allclose(off[at, i], where[1] - where[0], atol=1e-12)
    # How far: 4 to 6 mm a radian, by segment.
    many = {
        str(k): Marker(b, 0, 0, 0) for k, b in enumerate(4000 * list(joint))
    }
    drawn = slides(many, np.random.default_rng(4)).reshape(4000, 4, 2)
    np.testing.assert_allclose(
        drawn.std(axis=(0, 2)), [0.0, 0.004, 0.006, 0.004], rtol=0.03
    )
    clean = recorded(tmp_path)["positions"]
    shown = recorded(tmp_path, "soft_tissue")["positions"] - clean
    own = laboratory(tmp_path).slide
    np.testing.assert_allclose(
        shown, soft_tissue(TREE, q, MARKERS, own), atol=1e-12
    )


SKIN = Skin({"knee": 0.75, "hip": 0.25}, 0.04, -0.02, 0.05)


def test_skin_turns_with_flexion_squared_and_late():
    q = happened().q[::10]
    # 0.05 s before, at 100 Hz five frames.
    f = 0.75 * q[:, 4] + 0.25 * q[:, 5]
    before = np.r_[np.full(5, f[0]), f[:-5]]
    expected = 0.04 * before - 0.02 * before**2
    np.testing.assert_allclose(SKIN.turn(TREE, q, 100.0), expected, atol=1e-12)


def test_markers_of_a_segment_turn_about_their_middle(tmp_path):
    q = happened().q[::10]
    faults = {"skin": {"thigh": SKIN}}
    clean = recorded(tmp_path)["positions"]
    off = turned_skin(TREE, q, 100.0, MARKERS, faults["skin"])
    on = [i for i, m in enumerate(MARKERS.values()) if m.body == "thigh"]
    rest = [i for i in range(len(MARKERS)) if i not in on]
    assert (off[:, rest] == 0.0).all() and (off[:, :, 2] == 0.0).all()
    np.testing.assert_allclose(off[:, on].mean(axis=1), 0.0, atol=1e-12)
    angle = SKIN.turn(TREE, q, 100.0)
    x = clean[:, on, 0] + 1j * clean[:, on, 1]
    arm = x - x.mean(axis=1, keepdims=True)
    moved = off[:, on, 0] + 1j * off[:, on, 1]
    turned = np.exp(1j * angle)[:, None] * arm
    np.testing.assert_allclose(arm + moved, turned, atol=1e-12)
    # With what slides, where the laboratory has skin at all.
    both = recorded(tmp_path, "soft_tissue", **faults)["positions"]
    slid = recorded(tmp_path, "soft_tissue")["positions"]
    np.testing.assert_allclose(both - slid, off, atol=1e-12)
    none = recorded(tmp_path, **faults)["positions"]
    np.testing.assert_array_equal(none, clean)


def test_skin_is_drawn_between_its_limits():
    every = [draw_skin(np.random.default_rng(k)) for k in range(200)]
    assert set(every[0]) == {"shank", "thigh", "pelvis"}
    for name, joints in (
        ("shank", ["ankle", "knee"]),
        ("thigh", ["knee", "hip"]),
        ("pelvis", ["hip"]),
    ):
        found = [skin[name] for skin in every]
        assert all(list(s.shares) == joints for s in found)
        assert all(sum(s.shares.values()) == pytest.approx(1.0) for s in found)
        linear = np.array([s.linear for s in found])
        assert 0.02 <= np.abs(linear).min() < 0.022
        assert 0.058 < np.abs(linear).max() <= 0.06
        assert 60 < (linear > 0.0).sum() < 140
        for of, low, high in (
            ("quadratic", -0.02, 0.02),
            ("lag_s", 0.02, 0.06),
        ):
            values = np.array([getattr(s, of) for s in found])
            reach = high - low
            assert low <= values.min() < low + 0.05 * reach
            assert high - 0.05 * reach < values.max() <= high


@pytest.mark.slow
def test_feet_share_what_the_ground_bears(tmp_path):
    trial = happened()
    left, right, chair = (wrench(p) for p in recorded(tmp_path)["plates"])
    np.testing.assert_allclose(left, 0.5 * trial.ground.array, atol=1e-9)
    np.testing.assert_allclose(right, left, atol=1e-9)
    np.testing.assert_allclose(chair, trial.chair.array, atol=1e-9)
    shares = []
    for seed in range(20):
        plates = recorded(tmp_path, "variation", seed=seed)["plates"]
        left, right, _ = (wrench(p) for p in plates)
        np.testing.assert_allclose(left + right, trial.ground.array, atol=1e-9)
        shares.append(left[5, 1] / trial.ground.force[5, 1])
    assert 0.46 <= min(shares) < 0.48 and 0.52 < max(shares) <= 0.54
    left, right, _ = map(wrench, recorded(tmp_path, left_share=0.47)["plates"])
    np.testing.assert_allclose(left, 0.47 * trial.ground.array, atol=1e-9)
    np.testing.assert_allclose(right, 0.53 * trial.ground.array, atol=1e-9)


def test_plate_noise_is_half_a_newton(tmp_path):
    for plate, clean in zip(
        recorded(tmp_path, "plate_noise")["plates"],
        recorded(tmp_path)["plates"],
        strict=True,
    ):
        off = wrench(plate) - wrench(clean)
        np.testing.assert_allclose(off.std(axis=0), [0.5, 0.5, 0.2], rtol=0.06)
        assert np.abs(off.mean(axis=0)).max() < 0.05


@pytest.mark.slow
def test_plates_have_an_offset_that_drifts(tmp_path):
    reach = (2.0, 5.0, 0.5)
    slopes = []
    for seed in range(30):
        drifting = recorded(
            tmp_path, "plate_drift", seed=seed, plate_drift=reach
        )
        plates = zip(
            drifting["plates"], recorded(tmp_path)["plates"], strict=True
        )
        for number, (plate, clean) in enumerate(plates, 1):
            off = wrench(plate) - wrench(clean)
            level = np.array([1.0, -3.0, 0.4]) * number
            np.testing.assert_allclose(off[0], level, atol=1e-9)
            # Straight.
            np.testing.assert_allclose(
                off[1000] - off[0], off[2000] - off[1000], atol=1e-9
            )
            slopes.append(off[-1] - off[0])
    largest = np.abs(slopes).max(axis=0)
    assert (largest <= reach).all() and (largest > 0.9 * np.array(reach)).all()
    usual = Faults().plate_drift
    assert usual == (0.5, 1.5, 0.2)


def test_empty_plates_show_the_offset_without_drift(tmp_path):
    made = laboratory(tmp_path, "plate_drift")
    # The copy that writes shares the dictionary of what was written.
    made.record_empty(np.random.default_rng(0))
    for number, plate in enumerate(made.written["plates"], 1):
        shown = wrench(plate)
        assert shown.shape == (2001, 3)  # two seconds
        level = np.array([1.0, -3.0, 0.4]) * number
        np.testing.assert_allclose(shown, np.tile(level, (2001, 1)), atol=1e-9)
    assert made.written["positions"].shape == (201, 1, 3)
    levels = [empty_plate_levels(np.random.default_rng(k)) for k in range(300)]
    largest = np.abs(levels).max(axis=0)
    assert (largest <= [2.0, 4.0, 0.5]).all()
    assert (largest > [1.9, 3.8, 0.47]).all()


def device(tmp_path, *active, clocks=None, moments=True, **faults):
    made = laboratory(tmp_path, *active, **faults)
    rng = np.random.default_rng(2)
    made.record_device(happened(), clocks or Clocks(), moments, rng)
    return made.written


def test_encoders_and_moments_at_200_hz(tmp_path):
    found, trial = device(tmp_path), happened()
    (angles, unit), (moments, other) = found["encoders"], found["moments"]
    assert (unit, other) == ("deg", "Nm")
    np.testing.assert_allclose(angles.time, np.arange(400) / 200.0)
    assert angles.names == ("exo_ankle", "exo_knee", "exo_hip")
    assert moments.names == tuple(f"{n}_moment" for n in angles.names)
    np.testing.assert_allclose(angles.values, trial.q[:2000:5, 6:], atol=1e-12)
    expected = trial.moments[:2000:5, 3:]
    np.testing.assert_allclose(moments.values, expected, atol=1e-12)
    assert "moments" not in device(tmp_path, moments=False)


@pytest.mark.parametrize("lag", [0.03, -0.04])
def test_the_devices_clock_lags(tmp_path, lag):
    """What happened at t stands at t + lag; ends are held."""
    late = device(tmp_path, clocks=Clocks(device=lag, mats=9.0))
    on_time = device(tmp_path)
    k = round(lag * 200)
    for what in ("encoders", "moments"):
        shown, true = late[what][0].values, on_time[what][0].values
        if k > 0:
            np.testing.assert_allclose(shown[k:], true[:-k], atol=1e-9)
            np.testing.assert_allclose(
                shown[:k], np.tile(true[0], (k, 1)), atol=1e-9
            )
        else:
            np.testing.assert_allclose(shown[:k], true[-k:], atol=1e-9)


def test_encoders_have_an_offset_each(tmp_path):
    offset = (0.01, -0.02, 0.03)
    shifted = device(tmp_path, encoder_offset_rad=offset)
    off = shifted["encoders"][0].values - device(tmp_path)["encoders"][0].values
    np.testing.assert_allclose(off, np.tile(offset, (400, 1)), atol=1e-12)


def test_encoder_noise_and_steps(tmp_path):
    noisy, clean = device(tmp_path, "encoder_noise"), device(tmp_path)
    angles = np.rad2deg(noisy["encoders"][0].values)
    np.testing.assert_allclose(
        100.0 * angles, np.round(100.0 * angles), atol=1e-6
    )
    off = angles - np.rad2deg(clean["encoders"][0].values)
    # Noise of 0.02 degrees, and steps of 0.01.
    expected = np.hypot(0.02, 0.01 / np.sqrt(12.0))
    assert off.std() == pytest.approx(expected, rel=0.06)
    more = noisy["moments"][0].values - clean["moments"][0].values
    assert more.std() == pytest.approx(0.1, rel=0.06)
    # Each of the six has its own.
    alike = np.corrcoef(np.hstack([off, more]).T) - np.eye(6)
    assert np.abs(alike).max() < 0.2


@pytest.fixture
def pressed(tmp_path, monkeypatch):
    """Pressure (N, cells) and times that the laboratory would write."""
    caught = {}

    def keep(path, time, pressure, mats):
        caught.update(time=time, pressure=pressure, mats=mats)

    monkeypatch.setattr(instruments, "_write_asc", keep)

    def record(configuration="pelvis", lag=0.0, steps=False, **faults):
        active = ["pressure_steps"] if steps else []
        laboratory(tmp_path, *active, **faults).record_pressure(
            happened(), instruments.CONFIGURATIONS[configuration], lag
        )
        return caught["time"], caught["pressure"].copy()

    return record


def normal_force(pressure, configuration="pelvis"):
    """Of both faces of each segment (N, segments), by summing the cells."""
    found, first = {}, 0
    for mat in instruments.CONFIGURATIONS[configuration]:
        cells = mat.rows * mat.columns
        _, inward, _, _ = instruments.cells(mat, MODEL)
        part = 2e-4 * pressure[:, first : first + cells] @ inward[:, 0]
        found[mat.segment] = found.get(mat.segment, 0.0) + part
        first += cells
    return found


def test_mats_show_the_cuffs_force_at_50_hz(pressed):
    time, pressure = pressed()
    np.testing.assert_allclose(time, np.arange(1, 100) / 50.0)
    shown = normal_force(pressure)["pelvis"]
    np.testing.assert_allclose(shown, 20.0 * time - 20.0, atol=1e-6)
    time, pressure = pressed("legs")
    shown = normal_force(pressure, "legs")
    # On the left leg alone.
    np.testing.assert_allclose(shown["thigh"], 0.5 * 15.0 * time, atol=1e-6)
    expected = 0.5 * (10.0 - 10.0 * time)
    np.testing.assert_allclose(shown["shank"], expected, atol=1e-6)


def test_the_mats_clock_lags(pressed):
    _, on_time = pressed()
    _, late = pressed(lag=0.04)
    np.testing.assert_allclose(late[2:], on_time[:-2], rtol=1e-9)


def test_mats_see_their_share(pressed):
    _, whole = pressed("legs")
    _, part = pressed("legs", left_share=0.4, mat_share={"thigh": 0.9})
    ratio = normal_force(part, "legs")
    full = normal_force(whole, "legs")
    for segment, share in (("thigh", 0.72), ("shank", 0.8)):
        expected = share * full[segment]
        np.testing.assert_allclose(ratio[segment], expected, atol=1e-9)
    _, pelvis = pressed(left_share=0.4, mat_share={"pelvis": 0.85})
    _, all_of_it = pressed()
    np.testing.assert_allclose(pelvis, 0.85 * all_of_it, rtol=1e-9)


def test_pressure_comes_in_steps_of_2500_pascal(pressed, monkeypatch):
    _, fine = pressed()
    _, coarse = pressed(steps=True)
    steps = coarse / 2500.0
    np.testing.assert_array_equal(steps, np.round(steps))
    assert np.abs(coarse - fine).max() <= 1250.0
    assert len(np.unique(steps)) > 3
    high = {"pelvis": 3000.0}
    monkeypatch.setattr(instruments, "_TENSION_N", high)
    _, pressed_hard = pressed(steps=True)
    assert pressed_hard.max() == 30000.0
    _, beyond = pressed()
    assert beyond.max() > 40000.0


def test_pressure_files_are_in_kilopascal(tmp_path):
    mats = instruments.CONFIGURATIONS["pelvis"]
    made = laboratory(tmp_path, "pressure_steps")
    made.record_pressure(happened(), mats, 0.0)
    found = read_novel_asc(tmp_path / "bow.asc")
    assert found.time[0] == pytest.approx(0.02)
    assert found.time[-1] == pytest.approx(1.98)
    names = ("pelvis_front", "pelvis_back")
    total = np.hstack([found.pressure[:, found.groups[n]] for n in names])
    shown = normal_force(total)["pelvis"]
    np.testing.assert_allclose(shown, 20.0 * found.time - 20.0, atol=8.0)
    assert np.ptp(shown) > 25.0


def test_faults_of_a_wide_truth_by_name():
    names = {*WIDE, "soft_tissue", "plate_drift"}
    none = draw_faults(np.random.default_rng(0), frozenset(), ["thigh"])
    assert none == Faults()
    every = [
        draw_faults(np.random.default_rng(k), frozenset(names), ["thigh"])
        for k in range(200)
    ]
    limits = {
        "left_share": (0.475, 0.525),
        "encoder_offset_rad": (-np.deg2rad(3.0), np.deg2rad(3.0)),
        "friction_share": (0.5, 1.5),
    }
    for name, (low, high) in limits.items():
        values = np.array([getattr(f, name) for f in every])
        reach = high - low
        assert low <= values.min() < low + 0.05 * reach
        assert high - 0.05 * reach < values.max() <= high
    seen = np.array([f.mat_share["thigh"] for f in every])
    assert 0.85 <= seen.min() < 0.86 and 0.99 < seen.max() <= 1.0
    assert all(f.plate_drift == (2.0, 5.0, 0.5) for f in every)
    assert all(f.noisy_windows for f in every)
    for name in names - {"body"}:
        (alone,) = [
            draw_faults(np.random.default_rng(3), frozenset([name]), ["thigh"])
        ]
        other = {
            key: value
            for key, value in vars(alone).items()
            if value != getattr(Faults(), key)
        }
        assert len(other) == 1, name
        (key,) = other
        assert other[key] == getattr(every[3], key)


def test_plates_lie_under_feet_and_chair():
    """Left is left of right, the chair behind; z of each points down."""
    middles = {}
    for place in PLATES:
        corners = _corners(place)
        middles[place] = corners.mean(axis=0)
        axes = plate_axes(corners)
        np.testing.assert_allclose(axes[:, 2], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(middles["left"], [0.06, 0.09, 0.0])
    np.testing.assert_allclose(middles["right"], [0.06, -0.09, 0.0])
    np.testing.assert_allclose(middles["chair"], [-0.45, 0.0, 0.0])
    assert np.ptp(_corners("chair"), axis=0)[:2] == pytest.approx([0.48, 0.5])
    assert np.ptp(_corners("left"), axis=0)[:2] == pytest.approx([0.5, 0.17])
    # For walks they go further, forward.
    for place in PLATES:
        (short, long) = (_corners(place, more) for more in (0.0, 3.0))
        more = [0.0, 0.0] if place == "chair" else [0.0, 3.0]
        ends = [np.array([x.min(), x.max()]) for x in (short[:, 0], long[:, 0])]
        np.testing.assert_allclose(ends[1] - ends[0], more, atol=1e-12)
        np.testing.assert_allclose(long[:, 1:], short[:, 1:])


def test_a_plates_point_is_the_centre_of_pressure():
    loaded = PlanarWrench(np.array([[5.0, 400.0]]), np.array([-60.0]))
    plate = plate_recording(2, loaded, "right")
    np.testing.assert_allclose(plate.point, [[0.15, 0.0, 0.09]])
    np.testing.assert_allclose(plate.torque, 0.0, atol=1e-12)
    light = PlanarWrench(np.array([[0.0, 10.0]]), np.array([-1.5]))
    plate = plate_recording(1, light, "left")
    np.testing.assert_allclose(plate.point, [[0.06, 0.0, -0.09]])
    np.testing.assert_allclose(plate.torque, [[0.0, 0.0, 0.9]])


def test_scanned_surfaces_lie_where_their_segment_does():
    q = np.linspace(0.1, 0.9, len(NAMES))
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, 0.3, 0.4]])
    for segment in ("shank", "thigh", "pelvis"):
        found = instruments._placed(TREE, q, segment)(points)
        for p, (x, y, z) in zip(points, found, strict=True):
            (expected,) = TREE.point_positions(q[None], segment, (p[0], p[2]))
            np.testing.assert_allclose((x, z), expected)
            assert y == p[1]


def written_files(tmp_path, files):
    """Markers, plates at their times and both signals of the device."""
    folder = tmp_path / files
    folder.mkdir()
    made = replace(laboratory(folder), files=files)
    made = Laboratory(
        **{
            name: getattr(made, name)
            for name in Laboratory.__dataclass_fields__
        }
    )
    trial = happened(0.505)
    made.record_motion(trial, np.random.default_rng(1))
    made.record_device(trial, Clocks(0.0, 0.0), True, np.random.default_rng(1))
    paths = made.motion_files("bow")
    device = [
        folder / made.device_file("bow", w) for w in ("encoders", "moments")
    ]
    if files == "c3d":
        found = read_c3d(folder / paths["markers"])
        signals = [read_csv_table(path) for path in device]
        plates = list(found.plates.values())
        return found.markers, found.plate_time, plates, signals
    markers = read_trc(folder / paths["markers"])
    time, plates = read_plates(folder / paths["forces"])
    signals = [in_radians(read_table(device[0])), read_table(device[1])]
    return markers, time, list(plates.values()), signals


@pytest.mark.slow
def test_files_of_both_kinds_hold_what_happened(tmp_path):
    """In OpenSim's axes, or with z up; 100, 1000 and 200 Hz."""
    trial = happened(0.505)
    for files in ("opensim", "c3d"):
        markers, time, plates, signals = written_files(tmp_path, files)
        assert markers.names == tuple(MARKERS) and markers.rate_hz == 100.0
        np.testing.assert_allclose(markers.time, np.arange(51) / 100.0)
        p = markers.positions
        if files == "c3d":  # x, left, up to x, up, right
            p = np.stack([p[..., 0], p[..., 2], -p[..., 1]], axis=-1)
        expected = marker_positions(TREE, trial.q[::10], MARKERS)
        np.testing.assert_allclose(p, expected, atol=2e-6)
        assert [plate.number for plate in plates] == list(PLATES.values())
        count = len(time)
        np.testing.assert_allclose(time, np.arange(count) / 1000.0, atol=1e-9)
        assert count == (510 if files == "c3d" else 506)
        last = np.minimum(np.arange(count), 505)
        total = 0.0
        for plate in plates[:2]:
            F = plate.force
            M = plate.moment_about_origin()
            if files == "c3d":
                F, M = (x[:, [0, 2, 1]] * [1.0, 1.0, -1.0] for x in (F, M))
            total = total + np.column_stack([F[:, 0], F[:, 1], -M[:, 2]])
        np.testing.assert_allclose(total, trial.ground.array[last], atol=0.02)
        encoders, moments = signals
        np.testing.assert_allclose(encoders.time, np.arange(101) / 200.0)
        np.testing.assert_allclose(
            encoders.values, trial.q[:505:5, 6:], atol=1e-6
        )
        np.testing.assert_allclose(
            moments.values, trial.moments[:505:5, 3:], atol=1e-5
        )
        assert encoders.names == NAMES.device


def test_markers_lie_on_a_body_that_is_the_same_on_both_sides():
    """Outside of the bones they name, in the order of their height."""
    human = MODEL.human
    for name, marker in MARKERS.items():
        if name.startswith("L_"):
            other = MARKERS[f"R_{name[2:]}"]
            assert (other.body, other.x_m, other.z_m) == (
                marker.body, marker.x_m, marker.z_m,
            )  # fmt: skip
            assert other.y_m == -marker.y_m > -0.3
            assert marker.y_m > 0.03
    at = {name: m for name, m in MARKERS.items() if not name.startswith("R_")}
    q = np.zeros((1, len(NAMES)))
    q[0, 1] = human.ankle_height_m
    # Standing: forward, up, left of each.
    p = marker_positions(TREE, q, MARKERS)[0]
    stands = dict(zip(MARKERS, p, strict=True))
    height = {n: stands[n][1] for n in at}
    order = ["L_TOE", "L_MMAL", "L_SHK1", "L_SHK2", "L_SHK3", "L_SHK4",
             "L_MKNE", "L_THI1", "L_THI2", "L_THI3", "L_THI4", "L_TROC",
             "SACR", "L1", "T10", "T4", "C7", "L_FHD", "VERT"]  # fmt: skip
    assert (np.diff([height[name] for name in order]) > 0.0).all()
    assert 0.0 < min(height.values()) < 0.06
    assert human.height_m - 0.1 < height["VERT"] < human.height_m + 0.1
    x = {n: stands[n][0] for n in at}
    for before, behind in (
        ("L_TOE", "L_CAL"), ("L_ASI", "L_PSI"), ("CLAV", "C7"),
        ("STRN", "T10"), ("L_FHD", "L_BHD"), ("L_MT1", "L_CAL"),
    ):  # fmt: skip
        assert x[before] > x[behind] + 0.05
    assert max(map(abs, x.values())) < 0.3
    # Either side of the joints that they mark; the knee's own is half way.
    for joint, outer, inner in (("shank", "LMAL", "MMAL"),
                                ("thigh", "LKNE", "MKNE")):  # fmt: skip
        a, b = at[f"L_{outer}"], at[f"L_{inner}"]
        assert a.body == b.body == joint
        assert (a.x_m + b.x_m, a.z_m + b.z_m) == pytest.approx((0.0, 0.0))
        assert a.y_m - b.y_m in (pytest.approx(0.08), pytest.approx(0.11))


def test_a_scan_is_a_fine_closed_tube(tmp_path):
    """Elliptic, as long as the segment, of triangles of a centimetre."""
    path = tmp_path / "scan.obj"
    instruments._write_surface(path, 0.06, 0.05, 0.4, lambda p: p)
    rows = [line.split() for line in path.read_text().splitlines()]
    v = 1e-3 * np.array([r[1:] for r in rows if r[0] == "v"], float)
    f = np.array([r[1:] for r in rows if r[0] == "f"], int) - 1
    np.testing.assert_allclose(
        (v[:, 0] / 0.06) ** 2 + (v[:, 1] / 0.05) ** 2, 1.0, atol=6e-6
    )
    assert (v[:, 2].min(), v[:, 2].max()) == (0.0, 0.4)
    a, b, c = v[f].transpose(1, 0, 2)
    sides = [np.linalg.norm(x - y, axis=1) for x, y in ((a, b), (b, c), (c, a))]
    assert np.max(sides) < 0.02
    # By Gauss: half of x n_x + y n_y over the tube is its volume.
    n = 0.5 * np.cross(b - a, c - a)
    middle = (a + b + c) / 3.0
    volume = 0.5 * np.sum(middle[:, :2] * n[:, :2])
    assert volume == pytest.approx(np.pi * 0.06 * 0.05 * 0.4, rel=2e-3)
