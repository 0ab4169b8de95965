"""Checks of a step by their limits; what a step tells of odd samples."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.soles import results
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact.law import COLUMNS, FLAT, Ground
from drake_exo.soles.contact.newton import Convergence
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import rotations_xyz
from drake_exo.soles.results import Step, sole_samples, step_checks
from drake_exo.soles.settings import StartBlock
from drake_exo.soles.simulation import (
    HISTORY,
    touches_elsewhere,
    write_history,
)


def _told(**changes):
    """Checks of a step whose figures are made up, by name."""
    made = {
        "converged": np.array([True, True, False]),
        "largest_strain": 0.1,
        "tilt_deg": np.array([5.0, 7.0, 80.0]),
        "stability": np.array([900.0, 800.0, np.nan]),
        "zmp_error": 0.01,
        "undercut": 0.001,
        "hollows": 0,
        "lost": 0.001,
        "friction_used": 0.5,
        "worst": 1e-9,
        "measured": np.array([False, False, False]),
        "force_z": [100.0, 300.0, 200.0],
        "times": [0.0, 0.1, 0.25],
        "pressed": 0.1,
        "phases": [slice(0, 3)],
        "cut": 0,
        "free_moment": None,
    } | changes
    step = SimpleNamespace(
        setup=SimpleNamespace(
            name="it", friction_used=made["friction_used"],
            load=SimpleNamespace(
                is_measured=made["measured"],
                force=np.transpose([[0.0] * 3, [0.0] * 3, made["force_z"]]),
                times=np.array(made["times"]), phases=made["phases"],
                moments_cut=made["cut"], free_moment=made["free_moment"],
            ),
        ),
        law=SimpleNamespace(friction=0.8),
        sole=SimpleNamespace(
            mesh=SimpleNamespace(
                **{key: made[key] for key in ("undercut", "lost", "hollows")}
            )
        ),
        times=np.array([0.0, 0.1, 0.25]),
        history=SimpleNamespace(
            reports=[SimpleNamespace(message=m) for m in ("", "", "lost")]
        ),
        complementarity=lambda: made["worst"],
        **{k: made[k] for k in ("converged", "largest_strain", "tilt_deg",
                                "stability", "zmp_error", "pressed")},
    )  # fmt: skip
    return {check.name: check for check in step_checks(step)}


def test_a_sample_that_failed_is_named_by_its_time():
    check = _told()["solved"]
    assert not check.holds and check.value == 1
    assert "sample 3 at 0.25 s: lost" in check.sentence
    two = _told(phases=[slice(0, 1), slice(1, 3)])["solved"].sentence
    assert "sample 3 at 0.25 s (sample 2 of loads[1]): lost" in two
    assert _told(converged=np.ones(3, bool))["solved"].holds
    assert list(_told(converged=np.zeros(3, bool))) == ["solved"]
    assert "youngs_modulus_pa" not in check.sentence
    assert "by some 1300% of its thick" in _told(pressed=13)["solved"].sentence


@pytest.mark.slow
def test_a_heel_too_near_the_edge_is_told_to_begin_later():
    text = EXAMPLE.replace("[10, 0, 400]", "[0, 0, 200]")
    case = Case.from_text(text.replace("[0.02, 0.01]", "[-0.1145, 0.06]"))
    (check, *_) = step_checks(case.simulate())
    assert check.name == "solved" and not check.holds
    assert "no start from" in check.sentence
    assert "near the sole's edge, begin later (from," in check.sentence


def test_a_block_is_pressed_by_force_over_modulus_and_area():
    case = Case.from_text(EXAMPLE)  # 400 N on 0.23 x 0.13 m of 1 MPa
    step = SimpleNamespace(setup=case, sole=case.sole())
    assert Step.pressed.fget(step) == pytest.approx(400 / 0.0299e6)


@pytest.mark.parametrize(
    ("name", "key", "limit", "level"),
    [
        ("plausibility.strain", "largest_strain", 0.3, "note"),
        ("plausibility.undercut", "undercut", 0.01, "note"),
        ("plausibility.friction", "friction_used", 0.76, "note"),
        ("plausibility.surface", "lost", 0.01, "note"),
        ("contact", "worst", 1e-6, "fail"),
    ],
)
def test_a_check_holds_up_to_its_limit(name, key, limit, level):
    for factor, holds in ((0.99, True), (1.01, False)):
        check = _told(**{key: factor * limit})[name]
        assert check.holds is holds and check.level == level
        assert check.value == pytest.approx(factor * limit)
        assert check.limit == pytest.approx(limit)
        assert bool(check.sentence) is not holds


def test_free_moments_beyond_friction_are_told():
    assert "plausibility.free_moment" not in _told()
    for cut, holds in ((0, True), (1, False)):
        told = _told(free_moment=np.ones(3), cut=cut)
        check = told["plausibility.free_moment"]
        assert (check.holds, check.level) == (holds, "note")
        assert check.value == pytest.approx(cut / 3)
    assert "not N·mm" in check.sentence


def test_a_sole_on_its_head_is_told():
    for share, told in ((0.3, False), (0.4, True)):
        check = _told(undercut=share)["plausibility.undercut"]
        assert check.sentence.endswith("stand on its head") is told


def test_a_closed_hollow_is_told():
    assert "plausibility.hollow" not in _told()
    check = _told(hollows=2)["plausibility.hollow"]
    assert (check.holds, check.value, check.level) == (False, 2.0, "note")
    assert "cores" in check.sentence


def test_strains_beyond_one_mean_nothing():
    for strain, level in ((0.99, "note"), (1.01, "fail")):
        check = _told(largest_strain=strain)["plausibility.strain"]
        assert (check.level, check.holds) == (level, False)
        assert ("inside out" in check.sentence) is (level == "fail")


def test_pose_and_stability_are_of_what_converged_and_is_free():
    free = _told()
    tilt = free["plausibility.tilt"]
    assert tilt.holds and (tilt.value, tilt.limit) == (7.0, 20.0)
    margin = free["plausibility.stability"]
    assert margin.holds and margin.value == 800.0
    assert "plausibility.zmp" not in free
    lean = _told(tilt_deg=np.array([20.1, 1.0, 0.0]))["plausibility.tilt"]
    assert not lean.holds and lean.value == 20.1
    assert "leans" in lean.sentence
    over = _told(tilt_deg=np.array([178.0, 1.0, 0.0]))["plausibility.tilt"]
    assert not over.holds and "turned over" in over.sentence
    assert (lean.level, over.level) == ("note", "fail")
    loose = _told(stability=np.array([-5.0, 0.0, np.nan]))
    check = loose["plausibility.stability"]
    assert not check.holds and check.value == -5.0
    assert check.sentence.startswith("samples not shown to be stable: 2;")
    both = _told(measured=np.array([False, True, True]), zmp_error=0.021)
    assert both["plausibility.tilt"].value == 5.0
    assert not both["plausibility.zmp"].holds
    assert both["plausibility.zmp"].limit == 0.02
    held = _told(measured=np.ones(3, bool), zmp_error=0.019)
    assert held["plausibility.zmp"].holds
    assert "plausibility.tilt" not in held


def test_forces_in_kilonewtons_and_times_in_milliseconds_are_told():
    sound = _told()
    for name, value, limit in (
        ("load_force", 300.0, 5.0),
        ("load_time", 0.25, 20.0),
    ):
        check = sound[f"plausibility.{name}"]
        assert check.holds and (check.value, check.limit) == (value, limit)
    light = _told(force_z=[0.1, 0.7, 0.3])["plausibility.load_force"]
    assert not light.holds and light.level == "note"
    assert light.sentence.startswith("no vertical force is above 0.7 N")
    late = _told(times=[0.0, 100.0, 250.0])["plausibility.load_time"]
    assert not late.holds and "250 s" in late.sentence


def test_rows_that_are_missing_are_told():
    check = _told()["plausibility.load_spacing"]
    assert check.holds and check.value == pytest.approx(0.15 / 0.125 - 1)
    assert _told(times=[3.0])["plausibility.load_spacing"].value == 0.0
    times = np.delete(0.005 * np.arange(40), 7)
    check = _told(times=times, phases=[slice(0, 39)])[
        "plausibility.load_spacing"
    ]
    assert not check.holds and check.level == "note"
    assert check.value == pytest.approx(1.0) and check.limit == 0.5
    assert "up to 2 times as far apart as usual" in check.sentence
    assert "in the air, give each contact a load" in check.sentence
    # Several loads: what lies between them is no gap.
    both = np.append(times[8:], 9.0 + 0.001 * np.arange(5))
    phases = [slice(0, 31), slice(31, 36)]
    told = _told(times=both, phases=phases)["plausibility.load_spacing"]
    assert told.holds and told.value == pytest.approx(0.0, abs=1e-9)


def _step(F, P, converged=None, ground=FLAT, zmp=None, measured=True):
    """A step of made-up forces (N, m, 3) at places."""
    count = len(F)
    zmp = np.zeros((count, 2)) if zmp is None else np.asarray(zmp, float)
    load = SimpleNamespace(zmp=zmp, is_measured=np.full(count, measured))
    setup = SimpleNamespace(load=load, ground=ground)
    good = np.ones(count, bool) if converged is None else converged
    history = SimpleNamespace(
        F=np.asarray(F, float), P=np.asarray(P, float), converged=good
    )
    return Step(setup, None, None, history)


def test_the_zmp_of_forces_at_heights():
    """Where on the ground there is no moment along it."""
    rng = np.random.default_rng(0)
    F = rng.uniform(1, 2, (3, 5, 3)) * [1, -1, 30]
    P = rng.uniform(-0.1, 0.1, (3, 5, 3))
    # Slopes, and forces, of up to 45°; its height is that of where it is.
    F[1, :, 0] = 25.0
    x = np.linspace(-0.5, 0.5, 41)
    bumps = 0.3 + 0.5 * x[:, None] + 0.02 * np.sin(20 * x)
    for ground in (FLAT, Ground(x, x, bumps)):
        step = _step(F, P, ground=ground)
        for q in range(3):
            height = ground.height(step.zmp[q : q + 1])
            arm = P[q] - [*step.zmp[q], *height]
            moment = np.cross(arm, F[q]).sum(axis=0)
            np.testing.assert_allclose(moment[:2], 0.0, atol=1e-12)
            assert step.free_moment[q] == pytest.approx(moment[2])
    none = _step(0 * F, P)
    assert np.isnan(none.zmp).all()


def test_the_zmp_s_error_is_the_rms_of_prescribed_poses_that_converged():
    up = np.tile([0, 0, 10.0], (4, 1, 1))
    P = np.array(
        [[[0.03, 0.04, 0]], [[0.0, 0.01, 0]], [[9.0, 9, 0]], [[0] * 3]]
    )
    good, measured = np.array([[1, 1, 0, 1], [1, 1, 1, 0]], bool)
    step = _step(up, P, good, measured=measured)
    wanted = np.sqrt((0.05**2 + 0.01**2) / 2)
    assert step.zmp_error == pytest.approx(wanted)
    assert _step(up, P, np.zeros(4, bool)).zmp_error == 0.0


@pytest.fixture(scope="module")
def two():
    """Two loads of the example, the second twice as heavy in the cost."""
    text = EXAMPLE.replace("samples: 5", "samples: 20")
    load = text[text.index("load:") : text.index("optimize:")]
    inner = load[load.index("constant") :].strip()
    harder = inner.replace("400", "600").replace("samples: 20", "samples: 10")
    loads = f"loads:\n  - {inner}\n  - {harder}\n    weight: 3\n"
    return Case.from_text(text.replace(load, loads)).simulate()


def test_several_loads_stand_in_table_and_summary(two):
    table, told = two.table(), two.summary()
    assert table["load"].tolist() == [0] * 20 + [1] * 10
    assert table["weight"].tolist() == [1.0] * 20 + [3.0] * 10
    one, other = told["loads"]
    for key in ("c_tr_mean_n_per_m", "c_rot_mean_nm_per_rad"):
        assert told[key] == pytest.approx(0.25 * one[key] + 0.75 * other[key])
    tr, rot = two.sigma_max_translation, two.sigma_min_rotation
    assert one["c_tr"] == pytest.approx(tr[:2].sum())
    assert other["c_tr"] == pytest.approx(tr[20])
    assert one["c_rot"] == pytest.approx(rot[:20].sum())
    assert other["c_rot"] == pytest.approx(rot[20:].sum())
    assert told["c_tr"] == pytest.approx(
        0.25 * one["c_tr"] + 0.75 * other["c_tr"]
    )
    assert two.heel_strike == 2


def test_failures_are_told_with_time_and_reason(two):
    reports = [replace(r) for r in two.history.reports]
    reports[3] = Convergence(False, 9, 1.0, "stuck")
    reports[5] = replace(reports[5], parts=4)
    reports[6] = replace(reports[6], parts=2)
    K = two.history.K_c.copy()
    K[3] = np.nan
    history = replace(two.history, reports=reports, K_c=K)
    R = two.rotation.copy()
    R[3] = np.diag([1.0, -1.0, -1.0])
    told = replace(two, history=replace(history, R=R)).summary()
    rest = np.delete(two.tilt_deg, 3)
    assert told["tilt_max_deg"] == pytest.approx(rest.max())
    assert told["failures"] == [
        {"step": 3, "time_s": pytest.approx(0.015), "message": "stuck"}
    ]
    assert told["failed_steps"] == 1 and told["stable"] is False
    assert told["steps_refined_in_time"] == 2


def test_strain_is_the_largest_of_any_batch(two, monkeypatch):
    """Whatever number of samples is computed at a time."""
    whole = two.largest_strain
    for together in (1, 4, 100):
        monkeypatch.setattr(results, "_TOGETHER", together)
        found = replace(two).largest_strain
        assert found == pytest.approx(whole, rel=1e-12)
    scaled = replace(two.history, F=two.history.F * 2.0)
    found = replace(two, history=scaled).largest_strain
    assert found == pytest.approx(2 * whole)


def test_what_is_drawn_is_the_step_s(two, tmp_path, monkeypatch):
    from drake_exo.soles import pictures

    made = {}
    for name in ("drawing", "load", "stiffness", "pose", "pressure"):
        monkeypatch.setattr(
            pictures, f"{name}_figure",
            lambda *given, name=name: made.setdefault(name, given),
        )  # fmt: skip
    monkeypatch.setattr(results, "save_figure", lambda *_: None)
    monkeypatch.setattr(Step, "write_animation", lambda *_: None)
    two.draw(tmp_path, "", "mine", first=two)
    peak = two.pressure.max(axis=0)
    np.testing.assert_array_equal(made["drawing"][2], peak)
    ((curves,), strike) = made["stiffness"][0].values(), made["stiffness"][1]
    assert list(curves) == ["first", "mine"] and strike == [(0, 2), (20, 21)]
    names = ("time_s", *pictures.STIFFNESS)
    times, tr, rot = (curves["mine"][name] for name in names)
    np.testing.assert_array_equal(times, two.times)
    np.testing.assert_array_equal(tr, two.sigma_max_translation)
    np.testing.assert_array_equal(rot, two.sigma_min_rotation)


def test_the_mark_is_on_the_step_s_own_motion(two, tmp_path, monkeypatch):
    """Not on those beside it; what never moved is not shown."""
    from drake_exo.soles import animation

    told = []
    monkeypatch.setattr(
        animation, "write_animation",
        lambda path, shown, title: told.append((title, shown)),
    )  # fmt: skip
    lost = [replace(r, converged=False) for r in two.history.reports]
    K = np.nan * two.history.K_c
    still = replace(two, history=replace(two.history, reports=lost, K_c=K))
    two.write_animation(tmp_path / "p.html", "mark", first=two, none=still)
    still.write_animation(tmp_path / "p.html", "mark", first=two)
    still.write_animation(tmp_path / "p.html", "mark")
    marks = [
        (title, [(motion.title, motion.mark) for motion in shown])
        for title, shown in told
    ]
    assert marks == [
        ("example", [("example", "mark"), ("first", "")]),
        ("example", [("first", "")]),
    ]


def test_seconds_are_of_their_part(two, tmp_path, monkeypatch):
    """By a clock that each part turns on by a known time."""
    clock = [50.0]
    monkeypatch.setattr(
        results, "time", SimpleNamespace(perf_counter=lambda: clock[0])
    )

    def turned(by, plain=lambda *_: None):
        def call(*given, **more):
            clock[0] += by
            return plain(*given, **more)

        return call

    monkeypatch.setattr(results, "write_csv", turned(2.0))
    monkeypatch.setattr(Step, "draw", turned(3.0))
    two.write(tmp_path, {"more": 1.0})
    told = json.loads((tmp_path / "summary.json").read_text())
    assert (told["tables_seconds"], told["pictures_seconds"]) == (2.0, 3.0)
    case = two.setup
    sole = type(case).sole
    monkeypatch.setattr(type(case), "sole", turned(4.0, sole))
    monkeypatch.setattr(results, "simulate", turned(5.0, results.simulate))
    again = Step.of(case)
    assert again.seconds == {
        "condensation_seconds": 4.0, "simulation_seconds": 5.0,
    }  # fmt: skip


def test_a_free_moment_is_summed_up(two, tmp_path, monkeypatch):
    monkeypatch.setattr(Step, "draw", lambda *_: None)
    moment = np.zeros(30)
    moment[:3] = [0.6, -0.9, 0.0]
    load = replace(two.setup.load, free_moment=moment, moment_cut=moment > 0)
    given = replace(two, setup=replace(two.setup, load=load))
    given.write(tmp_path)
    told = json.loads((tmp_path / "summary.json").read_text())
    assert told["free_moment_nm"] == {
        "mean": pytest.approx(-0.01), "largest": 0.9, "cut_samples": 1,
    }  # fmt: skip
    np.testing.assert_array_equal(given.table()["free_moment_nm"], moment)


def test_a_sole_as_a_whole_is_read_from_its_history(two, tmp_path):
    K = two.history.K_c.copy()
    K[4] = np.nan
    history = replace(two.history, K_c=K)
    write_history(tmp_path / HISTORY, two.sole.mesh, two.times, history)
    told = sole_samples(tmp_path)
    O, R, force, cop, size, middle, mu, arm = told  # noqa: E741
    assert told.cop is cop and told.friction is mu
    good = np.delete(np.arange(30), 4)
    np.testing.assert_array_equal(O, two.origin[good])
    np.testing.assert_array_equal(R, two.rotation[good])
    F, P = two.history.F[good], two.history.P[good]
    np.testing.assert_allclose(force, F[:, :, 2].sum(axis=1))
    weighed = (F[:, :, 2:] * P[:, :, :2]).sum(axis=1)
    np.testing.assert_allclose(cop * force[:, None], weighed)
    away = np.hypot(*(P[:, :, :2] - cop[:, None]).transpose(2, 0, 1))
    turns = (F[:, :, 2] * away).sum(axis=1)
    np.testing.assert_allclose(arm * force, turns)
    np.testing.assert_allclose(size, [0.23, 0.13, 0.03])
    np.testing.assert_allclose(middle, 0.0, atol=1e-12)
    assert mu == two.law.friction
    unsaid = replace(history, friction=None)  # as of an earlier version
    write_history(tmp_path / HISTORY, two.sole.mesh, two.times, unsaid)
    with pytest.raises(InputError, match="does not say the friction; simul"):
        sole_samples(tmp_path)
    damaged = replace(history, friction=np.nan)
    write_history(tmp_path / HISTORY, two.sole.mesh, two.times, damaged)
    with pytest.raises(InputError, match="holds gaps; simulate"):
        sole_samples(tmp_path)
    K[:] = np.nan
    write_history(tmp_path / HISTORY, two.sole.mesh, two.times, history)
    with pytest.raises(InputError, match="no sample converged"):
        sole_samples(tmp_path)


def _rolled(sole, angle, gap, count=1):
    """A foot rolled about x, its lowest node so far above the ground."""
    R = rotations_xyz(np.array([angle, 0.0, 0.0]))
    nodes = sole.mesh.nodes[sole.mesh.bare] @ R.T
    O = np.array([0.0, 0.0, gap - nodes[:, 2].min()])  # noqa: E741
    m = len(sole.mesh.contact)
    return SimpleNamespace(
        converged=np.ones(count, bool), F=np.zeros((count, m, 3)),
        R=np.tile(R, (count, 1, 1)), O=np.tile(O, (count, 1)),
    )  # fmt: skip


def test_a_side_that_reaches_the_ground_is_noticed(two):
    """Rolled beyond a right angle the side's upper edge is lowest."""
    sole, law = two.sole, replace(two.law, layer=1e-3)
    for gap, touches in ((0.9e-3, True), (1.1e-3, False)):
        history = _rolled(sole, np.deg2rad(100), gap)
        assert touches_elsewhere(sole, law, history) is touches
        history = _rolled(sole, np.deg2rad(100), gap, 70)
        history.O[:69, 2] += 1.0  # the last of several batches
        assert touches_elsewhere(sole, law, history) is touches
        history.converged[69] = False
        assert not touches_elsewhere(sole, law, history)
    x, y = np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)
    X, Y = np.meshgrid(x, y, indexing="ij")
    columns = (X.ravel(), Y.ravel(), 0 * X.ravel() + 0.2)
    high = Ground.of_table(dict(zip(COLUMNS, columns, strict=True)), "it")
    history = _rolled(sole, np.deg2rad(100), 0.2 + 0.9e-3)
    assert touches_elsewhere(sole, law, history, high)
    history.O[:, 2] += 3e-4
    assert not touches_elsewhere(sole, law, history, high)


def test_a_case_is_read_with_the_ground_that_it_names(tmp_path):
    rows = [f"{x},{y},{0.01 + 0.1 * x}" for x in np.linspace(-0.2, 0.2, 5)
            for y in np.linspace(-0.2, 0.2, 5)]  # fmt: skip
    (tmp_path / "ground.csv").write_text("\n".join(["x_m,y_m,z_m", *rows]))
    text = EXAMPLE + "ground: {heights: ground.csv}\n"
    (tmp_path / "case.yaml").write_text(text)
    case = Case.read(tmp_path / "case.yaml")
    assert case.start.point_W[2] == pytest.approx(0.01 - 0.1 * 0.115)
    told = case.ground_told["ground"]
    assert told["relief_m"] == pytest.approx(0.1 * 0.23)
    # 10 N and 400 N, on a slope of a tenth.
    wanted = (10 + 0.1 * 400) / (400 - 0.1 * 10)
    assert case.friction_used == pytest.approx(wanted)


def test_a_sole_is_held_at_its_lower_back_edge():
    settings = Case.from_text(EXAMPLE).settings
    mesh = brick((0.2, 0.1, 0.03), (3, 2, 1))
    mesh = mesh.with_nodes(mesh.nodes + np.array([0.01, 0.02, -0.005]))
    start = settings.start_pose(mesh)
    np.testing.assert_allclose(start.point_L, [-0.09, 0.02, -0.035])
    np.testing.assert_allclose(start.point_W, [-0.09, 0.02, 0.0])
    block = StartBlock((0.05, 0.01, -0.02), (0.3, 0.4), 0.7)
    start = replace(settings, start=block).start_pose(mesh)
    np.testing.assert_allclose(start.point_L, [0.05, 0.01, -0.02])
    np.testing.assert_allclose(start.point_W, [0.3, 0.4, 0.0])
    assert start.yaw == 0.7
