"""What a search keeps on disk and reads again; grounds and their words."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.papers import de_magistris
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact.law import COLUMNS, FLAT, Ground
from drake_exo.soles.load_blocks import LoadBlock
from drake_exo.soles.mesh import SphericalSpline, write_vtk
from drake_exo.soles.numerics import angles_xyz, rotations_xyz
from drake_exo.soles.optimize.files import (
    Checkpoint,
    StoredDesign,
    find_designs,
    read_checkpoint,
    read_summary,
    start_folder,
    write_case,
)
from drake_exo.soles.optimize.optimizer import Optimum
from drake_exo.soles.results import write_csv
from drake_exo.soles.simulation import HISTORY

# Of a start whose design has no simulation.
_FAILED = {"cost": np.inf, "violation": np.inf}


def _checkpoint(shift=0.0):
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    return Checkpoint(
        2, 7, rng.standard_normal(4) + shift, rng.standard_normal(4),
        rng.standard_normal(3), 1e-5, root @ root.T, 0.875,
        ({"cost": -0.5, "violation": 0.25}, _FAILED), case="1-Ref",
    )  # fmt: skip


def _assert_same(a, b):
    assert (a.stage, a.iteration, a.barrier) == (
        b.stage,
        b.iteration,
        b.barrier,
    )
    assert (a.starts, a.strain_scale) == (b.starts, b.strain_scale)
    assert a.case == b.case
    for name in ("p", "latest", "multipliers", "curvature"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name))


def test_a_checkpoint_is_read_as_it_was_written(tmp_path):
    """Of its curvature one triangle is kept."""
    at = _checkpoint()
    at.write(tmp_path)
    kept = json.loads((tmp_path / "checkpoint.json").read_text())
    assert len(kept["curvature"]) == 10
    for path in (tmp_path, tmp_path / "checkpoint.json"):
        _assert_same(read_checkpoint(path), at)
    bare = replace(at, multipliers=None, barrier=None)
    bare.write(tmp_path)
    found = read_checkpoint(tmp_path)
    assert found.multipliers is None and found.barrier is None


def test_starts_that_were_interrupted_are_found_by_their_number(tmp_path):
    assert start_folder(None, 1) is None
    for number in (0, 2, 11):
        folder = start_folder(tmp_path, number)
        folder.mkdir()
        _checkpoint(number).write(folder)
    start_folder(tmp_path, 5).mkdir()
    # Somebody's own.
    (tmp_path / "start_old").mkdir()
    _checkpoint().write(tmp_path / "start_old")
    found = read_checkpoint(tmp_path)
    assert found.p is None and len(found.begun) == 12 and found.case == "1-Ref"
    there = [k for k, at in enumerate(found.begun) if at is not None]
    assert there == [0, 2, 11]
    for number in there:
        _assert_same(found.begun[number], _checkpoint(number))
    # Of the best of them nothing is begun, of the sole alone its walks are.
    at = _checkpoint()
    for alone, count in ((None, 0), (at.p, 12), (at.p[1:], 0)):
        replace(at, alone=alone).write(tmp_path)
        for path in (tmp_path, tmp_path / "checkpoint.json"):
            assert len(read_checkpoint(path).begun) == count


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("stage", -1), ("iteration", -1), ("strain_scale", -1)),
        *(("coefficients", [1e31] * 4), ("coefficients", [[1.0]] * 4)),
        *(("latest", [1.0] * 3), ("multipliers", 1.0)),
        *(("starts", "x"), ("starts", [{"cost": "x", "violation": 0.0}])),
    ],
)
def test_numbers_that_no_run_writes_are_refused(tmp_path, name, value):
    _checkpoint().write(tmp_path)
    path = tmp_path / "checkpoint.json"
    kept = json.loads(path.read_text())
    kept[name] = value
    path.write_text(json.dumps(kept))
    with pytest.raises(InputError, match="not a checkpoint"):
        read_checkpoint(tmp_path)


def test_a_checkpoint_of_a_running_stage():
    curvature = 3.0 * np.eye(4)
    best = Optimum(np.ones(4))
    before = _checkpoint()
    at = before.after(1, 5, best, curvature)
    assert (at.stage, at.iteration, at.barrier) == (1, 5, None)
    assert at.latest is best.p and at.starts == before.starts
    assert at.strain_scale == 0.875
    best.latest = np.zeros(4), np.arange(3.0), 1e-3
    at = before.after(1, 5, best, curvature)
    np.testing.assert_array_equal(at.latest, np.zeros(4))
    assert at.curvature is curvature and at.begun == ()
    np.testing.assert_array_equal(at.multipliers, np.arange(3.0))
    assert at.barrier == 1e-3 and at.p is best.p


def test_another_case_s_checkpoint_is_told_by_its_sizes():
    at = _checkpoint()

    def fits(count, names):
        at.check_fits(
            SimpleNamespace(undeformed=np.ones(count), names=lambda: names)
        )

    fits(4, ["a", "b", "c"])
    with pytest.raises(InputError, match="4 coefficients, but the case has 5"):
        fits(5, ["a", "b", "c"])
    with pytest.raises(
        InputError, match=r"3 limits, but the case has 2 \(a, b\)"
    ):
        fits(4, ["a", "b"])


@pytest.fixture
def stored(tmp_path):
    """A design's folder, written by hand."""
    case = Case.from_text(EXAMPLE)
    folder = tmp_path / "design"
    folder.mkdir()
    write_case(folder, case.settings, case.start)
    write_vtk(folder / "sole.vtk", case.mesh)
    angles = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, 30.0]])
    head = ("time_s,force_x_n,force_y_n,force_z_n,zmp_x_m,zmp_y_m,roll_deg,"
            "pitch_deg,yaw_deg")  # fmt: skip
    rows = [f"{k},1,2,300,0.01,0.02,{','.join(map(str, row))}"
            for k, row in enumerate(angles)]  # fmt: skip
    (folder / "steps.csv").write_text("\n".join([head, *rows]))
    return folder, case, angles


def test_a_design_is_read_from_its_folder(stored, tmp_path):
    folder, case, _ = stored
    (found,) = find_designs(folder)
    assert found.name == "example" and found.setup.load.rotation is None
    assert repr(found) == f"StoredDesign('example', {str(folder)!r})"
    np.testing.assert_allclose(found.setup.mesh.nodes, case.mesh.nodes)
    np.testing.assert_allclose(found.setup.start.point_L, case.start.point_L)
    np.testing.assert_allclose(found.setup.start.point_W, case.start.point_W)
    np.testing.assert_array_equal(found.setup.load.force, 2 * [[1, 2, 300]])
    (tmp_path / "summary.json").write_text(
        json.dumps({"cases": [{"name": "design"}, {"name": "gone"}]})
    )
    assert [d.folder for d in find_designs(tmp_path)] == [folder]
    for rows in (7, ["design"], [{"name": 7}]):
        (tmp_path / "summary.json").write_text(json.dumps({"cases": rows}))
        with pytest.raises(
            InputError, match=r"summary\.json: is not a summary"
        ):
            find_designs(tmp_path)
    (folder / "summary.json").write_text(json.dumps({"c_tr": 1, "c": "x"}))
    with pytest.raises(InputError, match="c_rot is missing, or no number"):
        found.summary()
    (folder / "history.csv").write_text("iteration,cost\n1,2\n")
    with pytest.raises(InputError, match="column 'stage' is missing"):
        found.history()
    (folder / "history.csv").unlink()
    with pytest.raises(InputError, match=r"history\.csv: is missing; optim"):
        found.history()
    (folder / "sole.vtk").unlink()
    with pytest.raises(InputError, match=r"sole\.vtk: is missing"):
        find_designs(folder)


def test_the_ground_of_a_design_is_in_its_history(stored):
    folder, case, _ = stored
    ground = _ground(lambda x, y: 0.05 + 0.1 * x)
    np.savez(folder / HISTORY, **ground.arrays(), other=1)
    path = folder / "case.yaml"
    lines = [x for x in path.read_text().splitlines() if x[:7] != "ground:"]
    path.write_text("\n".join([*lines, "ground: {heights: gone.csv}"]))
    (found,) = find_designs(folder)
    np.testing.assert_array_equal(found.setup.ground.z, ground.z)
    # Set down on it, not on the plane z = 0.
    height = 0.05 + 0.1 * case.start.point_W[0]
    assert found.setup.start.point_W[2] == pytest.approx(height)


def test_a_pose_that_was_measured_is_kept_in_degrees(stored):
    folder, _, angles = stored
    text = (folder / "case.yaml").read_text()
    load = text[text.index("load:") :].splitlines()
    end = next(k for k, line in enumerate(load[1:], 1) if line[:1] != " ")
    measured = ["load:", "  recording: there.yaml", "  trial: walk",
                "  foot: left", "  pose: measured"]  # fmt: skip
    lines = text[: text.index("load:")].splitlines() + measured + load[end:]
    (folder / "case.yaml").write_text("\n".join(lines))
    (found,) = find_designs(folder)
    R = found.setup.load.rotation
    np.testing.assert_allclose(np.degrees(angles_xyz(R)), angles)
    np.testing.assert_allclose(R, rotations_xyz(np.deg2rad(angles)))
    # Beside the ZMP that came of it stands what was recorded.
    path = folder / "steps.csv"
    head, *rows = path.read_text().splitlines()
    recorded = "recorded_zmp_x_m", "recorded_zmp_y_m", "recorded_free_moment_nm"
    more = [f"{row},0.3,0.4,0.5" for row in rows]
    path.write_text("\n".join([",".join([head, *recorded]), *more]))
    load = find_designs(folder)[0].setup.load
    np.testing.assert_array_equal(load.zmp, [[0.3, 0.4]] * 2)
    np.testing.assert_array_equal(load.free_moment, [0.5] * 2)


def test_a_measured_pose_beside_a_file_of_several_phases_is_kept(stored):
    """Which of them belong to a block, its weight tells."""
    folder, case, _ = stored
    given = case.settings.load
    walk = LoadBlock(recording="there.yaml", trial="w", foot="left",
                     pose="measured", weight=2.0)  # fmt: skip
    blocks = (given, walk, replace(given, weight=0.1))
    settings = replace(case.settings, load=None, loads=blocks)
    write_case(folder, settings, case.start)
    path = folder / "steps.csv"
    head, row, _ = path.read_text().splitlines()
    weights = 0.3333, 0.6667, 2.0, 0.1
    rows = [f"{k}{row[1:]},{k},{w}" for k, w in enumerate(weights)]
    path.write_text("\n".join([f"{head},load,weight", *rows]))
    (found,) = find_designs(folder)
    measured = [False, False, True, False]
    assert found.setup.load.is_measured.tolist() == measured


def test_a_design_whose_sample_did_not_converge_is_read(stored):
    """Its stiffness is a gap; a gap in its load is none that a run writes."""
    folder, case, _ = stored
    step = case.simulate()
    step.history.K_c[2] = np.nan
    lost = replace(step.history.reports[2], converged=False, message="lost")
    step.history.reports[2] = lost
    assert step.failed_steps == 1
    write_csv(folder / "steps.csv", step.table())
    (found,) = find_designs(folder)
    np.testing.assert_allclose(found.setup.load.force, case.load.force)
    write_csv(folder / "initial_steps.csv", step.table())
    figure = de_magistris._stiffness([found])
    (line,) = (x for x in figure.axes[0].lines if x.get_label() == "optimised")
    np.testing.assert_allclose(
        line.get_ydata(), 1e-3 * step.sigma_max_translation
    )
    gap = {"force_x_n": np.full(5, np.nan)}
    write_csv(folder / "steps.csv", step.table() | gap)
    with pytest.raises(InputError, match="a number is missing or NaN"):
        find_designs(folder)


def test_a_spline_is_read_from_its_folder(tmp_path):
    spline = SphericalSpline((3, 4), False, True, (7, 8))
    p = np.linspace(0.8, 1.2, spline.count)
    told = {
        "intervals": [3, 4], "fixed_top": False, "symmetric": True,
        "kept": [7, 8], "coefficients": p.tolist(),
    }  # fmt: skip
    path = tmp_path / "design.json"
    path.write_text(json.dumps(told))
    found, again = StoredDesign(tmp_path, None).shape()
    assert found == spline
    np.testing.assert_array_equal(again, p)
    for change, words in (
        ({"coefficients": p[1:].tolist()}, "do not fit"),
        ({"coefficients": [None, *p[1:].tolist()]}, "do not fit"),
        ({"intervals": [3]}, "holds no design"),
        ({"intervals": [3, 1e300]}, "holds no design"),
    ):
        path.write_text(json.dumps(told | change))
        with pytest.raises(InputError, match=words):
            StoredDesign(tmp_path, None).shape()


def test_costs_that_are_none_are_no_number(tmp_path):
    (tmp_path / "summary.json").write_text('{"c": null, "c_tr": 2, "x": null}')
    found = read_summary(tmp_path)
    assert np.isnan(found["c"]) and found["c_tr"] == 2 and found["x"] is None
    (tmp_path / "summary.json").write_text("[1]")
    with pytest.raises(InputError, match="is not a summary"):
        read_summary(tmp_path)


# Grounds


def _ground(height, x=(-0.3, 0.3), y=(-0.2, 0.2)):
    X, Y = np.meshgrid(np.linspace(*x, 7), np.linspace(*y, 9), indexing="ij")
    columns = (X.ravel(), Y.ravel(), height(X, Y).ravel())
    order = np.random.default_rng(0).permutation(len(columns[0]))
    table = dict(zip(COLUMNS, (c[order] for c in columns), strict=True))
    return Ground.of_table(table, "it")


def test_a_grid_is_read_in_any_order_and_told():
    ground = _ground(lambda x, y: 0.1 * x - 0.2 * y)
    places = np.array([[0.0, 0.0], [0.1, 0.05], [-0.2, 0.1]])
    np.testing.assert_allclose(ground.height(places), [0.0, 0.0, -0.04],
                               atol=1e-12)  # fmt: skip
    told = ground.summary(places)
    assert told["relief_m"] == pytest.approx(0.04)
    wanted = np.degrees(np.arctan(np.hypot(0.1, 0.2)))
    assert told["steepest_deg"] == pytest.approx(wanted)
    n = ground.normal(places)
    np.testing.assert_allclose(n, np.array([-0.1, 0.2, 1]) / np.sqrt(1.05))
    again = Ground.of_arrays(ground.arrays() | {"other": 1})
    np.testing.assert_array_equal(again.z, ground.z)
    assert FLAT.arrays() == {} and Ground.of_arrays({}) is FLAT
    assert FLAT.summary(places) == {"relief_m": 0.0, "steepest_deg": 0.0}


def test_steepest_is_the_largest_slope_of_places():
    bumps = _ground(lambda x, y: 0.5 * x**2)
    told = bumps.summary(np.array([[0.1, 0.0], [-0.2, 0.1]]))
    assert told["steepest_deg"] == pytest.approx(np.degrees(np.arctan(0.2)))


def test_what_is_steeper_than_half_a_right_angle_is_named():
    with pytest.raises(InputError, match=r"x -0\.3 m, y 0\.2 m .* as steep as"):
        _ground(lambda x, y: np.where((x < -0.25) & (y > 0.19), 0.3, 0.0))
    _ground(lambda x, y: 0.99 * x)
    with pytest.raises(InputError, match=r"as steep as 1\.01"):
        _ground(lambda x, y: 1.01 * y)


def test_a_grid_must_reach_below_the_sole():
    ground = _ground(lambda x, y: 0 * x)
    inside = np.array([[-0.3, -0.2], [0.3, 0.2]])
    ground.check_below(inside, "it")
    FLAT.check_below(99 * inside, "it")
    for off in ([-0.01, 0], [0.01, 0], [0, -0.01], [0, 0.01]):
        with pytest.raises(InputError) as caught:
            ground.check_below(inside + off, "it")
        low, high = inside + off
        said = str(caught.value)
        assert "spans x -0.3 to 0.3 m and y -0.2 to 0.2 m" in said
        assert f"x {low[0]:g} to {high[0]:g} m and y {low[1]:g} to" in said
