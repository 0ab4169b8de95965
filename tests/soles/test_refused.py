"""What is asked for in vain is refused, and what is the user's stays so."""

import json
import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
from small_step import stage, write_case, write_step

import drake_exo as dx
from drake_exo.cli import main
from drake_exo.cli import sole as command
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.soles.contact.law import Ground
from drake_exo.soles.load_blocks import Constant, OneFoot
from drake_exo.soles.loads import read_csv
from drake_exo.soles.mesh import brick, read_mesh
from drake_exo.soles.optimize import search
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.settings import (
    Brick,
    ContactBlock,
    MaterialBlock,
    MeshBlock,
    OptimizeBlock,
    ShapeBlock,
    Stage,
    StartBlock,
)
from drake_exo.soles.walking_pattern import Robot

HEAD = "time_s,force_x_n,force_y_n,force_z_n,zmp_x_m,zmp_y_m"


@pytest.fixture
def case(tmp_path):
    """A folder with a case and its step."""
    write_step(tmp_path / "load.csv", 4)
    write_case(tmp_path / "case.yaml", stages=[stage(4, 1e-4, 1)] * 2)
    return tmp_path


@pytest.mark.parametrize(
    ("further", "rows", "words"),
    [
        ("force_z_n", "9", "two columns are named 'force_z_n'"),
        ("free_moment", "1", "'free_moment' would not be read; name it"),
        ("Free_Moment_Nm", "1", "name it free_moment_nm, in N·m"),
        ("Load", "0 1", "'Load' would not be read; name it load$"),
        ("load,WEIGHT", "0,1 1,2", "'WEIGHT' would not be read; name it"),
        ("weight", "1 2", "'weight' is of several loads and would not be"),
        ("load,weight", "1,1 0,1", "'load' has to count from 0 on"),
        ("load,weight", "0,1 1,1 0,1", "'load' has to count from 0 on"),
        ("load,weight", "0,1 1,0", "'weight' has to be above 0"),
        ("load,weight", "0,1 0,2", "and the same in all rows of a load"),
    ],
)
def test_columns_of_loads(tmp_path, further, rows, words):
    path = tmp_path / "l.csv"
    lines = [f"{k},0,0,300,0,0,{row}" for k, row in enumerate(rows.split())]
    path.write_text("\n".join([f"{HEAD},{further}", *lines]))
    with pytest.raises(InputError, match=words):
        read_csv(path)


def test_numbers_in_place_of_a_header_are_no_repeated_names(tmp_path):
    path = tmp_path / "l.csv"
    path.write_text("0,0,0,300,0,0\n")
    with pytest.raises(InputError, match="the header must name time_s"):
        read_csv(path)


def test_loads_without_weights_weigh_the_same(tmp_path):
    path = tmp_path / "l.csv"
    lines = [f"{k},0,0,300,0,0,{k // 2}" for k in range(4)]
    path.write_text("\n".join([f"{HEAD},load", *lines]))
    found = read_csv(path)
    assert found.begins == (0, 2) and found.weights == (1.0, 1.0)


def test_loads_with_clocks_of_their_own_follow_one_another(tmp_path):
    """The second begins 0.2 s after the first; each runs forwards."""
    path = tmp_path / "l.csv"
    rows = [f"{t},0,0,300,0,0,{n}" for n in (0, 1) for t in (0, 0.1, 0.3)]
    path.write_text("\n".join([f"{HEAD},load", *rows]))
    times = read_csv(path).times
    np.testing.assert_allclose(times, [0, 0.1, 0.3, 0.5, 0.6, 0.8])
    path.write_text("\n".join([f"{HEAD},load", *rows[:3], *rows[:2:-1]]))
    with pytest.raises(InputError, match="time runs backwards"):
        read_csv(path)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"zmp": [[0.2, 0.0]] * 5}, "outside the sole by 85.0 mm at 0 s"),
        ({"force": [[390.0, 0, 400]] * 5}, "asks for a friction of 0.975"),
        (
            {"force": [[10.0, 0, 4.0e4]] * 4 + [[0.0, 0, 4.1e4]]},
            r"at 0\.02 s; 4\.02e\+04 N would press the whole sole flat",
        ),
    ],
)
def test_a_load_given_in_python_is_checked_as_a_file_s(changed, words):
    case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    case = replace(case, load=replace(case.load, **changed))
    for run in (case.simulate, case.optimize):
        with pytest.raises(InputError, match=words):
            run()


def test_free_moments_given_in_python_are_cut_as_a_file_s():
    case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    most = (0.8 * 400 - 10) * 0.13 / 4
    load = replace(case.load, free_moment=[50.0, 1.0, 0.0, -1.0, -50.0])
    step = replace(case, load=load).simulate()
    found = step.setup.load
    assert found.free_moment == pytest.approx([most, 1, 0, -1, -most])
    assert (found.moments_cut, step.failed_steps) == (2, 0)
    # Once: of a design those stay that its initial shape's width bears.
    kept = replace(found, free_moment=1.1 * found.free_moment)
    again = replace(case, load=kept).bearable_load
    assert again is kept and again.moments_cut == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: {"nodes": 1e3 * m.nodes}, "lengths are in metres"),
        (lambda m: {"tets": m.tets[:, [1, 0, 2, 3]]}, "inverted or flat"),
        (lambda m: {"nodes": [*m.nodes, [0, 0, -0.01]]}, "2 unconnected"),
        (lambda m: {"tets": 1.0 * m.tets}, r"float64.* give int .*\(n, 4\)"),
        (lambda m: {"tets": m.tets + 1}, "1 to 60; give indices of its 60"),
        (lambda m: {"fixed": m.nodes[:, 2] == 0.0}, r"array of bool, \(60,\)"),
    ],
)
def test_a_mesh_made_in_python_is_checked_as_a_file_s(change, words):
    case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    for run in (dx.soles.Case.simulate, dx.soles.Case.optimize):
        with pytest.raises(InputError, match=f"mesh: .*{words}"):
            run(replace(case, mesh=replace(case.mesh, **change(case.mesh))))
    mesh = replace(case.mesh, tets=case.mesh.tets.tolist())
    assert replace(case, mesh=mesh).simulate().summary() == (
        case.simulate().summary()
    )
    with pytest.raises(ValueError, match="read-only"):
        mesh.tets[0] = 0


def test_parts_of_another_type_in_python():
    case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    with pytest.raises(InputError, match=r"load is array.* give a Load"):
        replace(case, load=np.zeros((3, 6))).simulate()
    step = case.simulate()
    with pytest.raises(InputError, match="other is 3; give a Step"):
        step.plot(other=3)
    with pytest.raises(InputError, match=r"setup is Step\(.* give a Setup"):
        dx.soles.compare_strains(step)
    with pytest.raises(InputError, match=r"source is Case\(.* give a path"):
        dx.soles.sole_samples(case)
    with pytest.raises(InputError, match=r"setup is .* give a Setup"):
        dx.soles.pareto_front("c.yaml", [0.9])
    for floors in (0.9, [float("nan")]):
        with pytest.raises(InputError, match=r"floors are .* give a list"):
            dx.soles.pareto_front(case, floors)


def test_a_smoothed_law_that_is_too_thick_for_a_stiff_sole(monkeypatch):
    """Of 1 GPa, say: the case itself is simulated by the exact law."""
    monkeypatch.setattr(ShapeProblem, "evaluate", lambda *given: None)
    case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    words = (
        "simulate the case, .*; if it holds, give optimize.stages a smaller l"
    )
    with pytest.raises(InputError, match=words):
        case.optimize()


@pytest.mark.slow
def test_a_front_whose_first_design_is_none_names_what_made_it(monkeypatch):
    """A mass limit of a few grams, say, leaves a sheet."""
    case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    monkeypatch.setattr(search, "nearest_allowed", lambda *said: 0 * said[2])
    stages = case.settings.optimize.stages * 2
    with pytest.raises(InputError, match=r"cost\.mass_limit_kg, optimize\.sha"):
        dx.soles.pareto_front(case, [0.9], stages=stages)


@pytest.mark.parametrize("skipped", [(4, 0), (1, 3), (0, 6)])
def test_rows_that_are_all_left_out(tmp_path, skipped):
    """More than there are would be counted from the other end."""
    rows = [f"{k} 0 0 0 0 0 0 300" for k in range(4)]
    (tmp_path / "step.txt").write_text("\n".join(["names", *rows]))
    file = OneFoot("step.txt", (0.0, 0.0), *skipped)
    with pytest.raises(InputError, match="leave none of its 4 rows"):
        file.load(tmp_path)
    file = OneFoot("step.txt", (0.0, 0.0), 1, 2)
    assert file.load(tmp_path).times.tolist() == [1.0]


def test_a_pattern_without_samples():
    for robot in (Robot(first_s=9.0), Robot(period_s=9.0)):
        with pytest.raises(InputError, match="smaller period_s or first_s"):
            robot.load()


def test_a_cloud_of_points_is_no_ground():
    """Refused before the grid of all its lines, here of 72 MB, is made."""
    x = 1e-4 * np.arange(3000)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="3000 points are not a grid"):
            Ground.of_table({"x_m": x, "y_m": x, "z_m": 0.0 * x}, "g.csv")
        assert tracemalloc.get_traced_memory()[1] < 10e6
    finally:
        tracemalloc.stop()


def test_ground_in_millimetres():
    x, y = (v.ravel() for v in np.meshgrid(*[50.0 * np.arange(5)] * 2))
    table = {"x_m": x, "y_m": y, "z_m": 0.0 * x}
    with pytest.raises(InputError, match="lie up to 50 m apart"):
        Ground.of_table(table, "g.csv")
    Ground.of_table(table | {"x_m": x / 1e3, "y_m": y / 1e3}, "g.csv")


def test_lengths_and_keys_of_a_case():
    with pytest.raises(
        InputError, match=r"unit is for a file, not for a brick"
    ):
        MeshBlock(brick=object(), unit="mm")
    text = "size_m: [0.13, 0.23, 0.03]\ndivisions: [3, 4, 2]"
    with pytest.raises(InputError, match=r":1: size_m: .* 130 x 230 x 30 mm"):
        schema.load_text(text, Brick)
    made = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    start = replace(made.settings.start, point_in_sole_m=(-115.0, 0.0, -30.0))
    off = replace(made.settings, start=start)
    with pytest.raises(InputError, match=r"point_in_sole_m: 114\.\d+ m off"):
        off.start_pose(made.mesh)
    text = "least_depth_m: 25"
    with pytest.raises(InputError, match="least_depth_m is 25, but must be be"):
        schema.load_text(text, ShapeBlock)
    for bound, refused in {
        "most": (
            ("step_time_s: 900", Robot),
            ("step_length_m: 200", Robot),
            ("step_width_m: 162", Robot),
            ("friction: 80", ContactBlock),
            ("ankle_m: [0, 11]", Robot),
            ("front_m: 100", Robot),
            ("first_s: 900", Robot),
            ("gravity_m_per_s2: 9810", Robot),
            ("intervals: [10, 1_000]", OptimizeBlock),
            ("starts: 1000000", OptimizeBlock),
            ("iterations: 3000000000", Stage),
            ("name: neoprene\ndensity_kg_per_m3: 1.23e6", MaterialBlock),
            ("point_in_world_m: [115, 0]", StartBlock),
        ),
        "least": (
            ("com_height_m: 1.0e-9", Robot),
            ("gravity_m_per_s2: 1.0e-9", Robot),
            ("intervals: [0, 9]", OptimizeBlock),
            ("c_rot_nm_per_rad: 1.0e-9", OptimizeBlock),
        ),
    }.items():
        for text, block in refused:
            with pytest.raises(InputError, match=f"but must be at {bound}"):
                schema.load_text(text, block)
    # A walk may end far from the room's origin.
    start = schema.load_text("point_in_world_m: [40, -40]", StartBlock)
    assert start.point_in_world_m == (40.0, -40.0)
    with pytest.raises(InputError, match="tilt_deg is 100, but must be"):
        schema.load_text("tilt_deg: 100", OptimizeBlock)
    text = "fixed_m: [[[-115, -65, -30], [0, 65, 0]]]"
    with pytest.raises(InputError, match=r"fixed_m\[0\]\[0\]\[0\] is -115"):
        schema.load_text(text, ShapeBlock)
    text = "force_n: [0, 0, 9]\nzmp_m: [0, 0]\nsamples: 1000000000"
    with pytest.raises(InputError, match="samples is 1000000000, but must be"):
        schema.load_text(text, Constant)


@pytest.mark.parametrize("above", [2e-5, 0.02])
def test_a_frame_below_the_top(tmp_path, above):
    """Where left and right have no directions of the spline between them."""
    mesh = brick((0.23, 0.13, 0.03), (4, 3, 1))
    cells = [("tetra", mesh.tets)]
    meshio.Mesh(mesh.nodes, cells).write(tmp_path / "sole.vtk")
    text = dx.soles.EXAMPLE
    mesh = text[text.index("mesh:") : text.index("material:")]
    given = f"mesh: {{file: sole.vtk, origin_m: [0, 0, {-above}]}}\n"
    text = text.replace(mesh, given)
    found = dx.soles.Case.from_text(text, tmp_path)
    assert found.mesh.nodes[:, 2].max() == pytest.approx(above)
    stage = found.settings.optimize.stages[0]
    if above < 1e-3:
        assert ShapeProblem(found, stage).first is not None
        return
    with pytest.raises(InputError, match=r"20\.0 mm above its frame"):
        found.optimize()


@pytest.mark.parametrize("z", [-0.03, -0.05, 30.0])
def test_a_frame_at_the_underside_or_far_off(tmp_path, z):
    """Laid flat, a sole would stand on its frame's origin."""
    made = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    mesh = made.mesh
    cells = [("tetra", mesh.tets)]
    meshio.Mesh(mesh.nodes, cells).write(tmp_path / "sole.vtk")
    block = MeshBlock("sole.vtk", origin_m=(0.0, 0.0, z))
    words = rf"z = {-0.03 - z:g} m in its frame.* give mesh\.origin_m"
    with pytest.raises(InputError, match=f"sole.vtk: .*{words}"):
        replace(made.settings, mesh=block).read_mesh(tmp_path)
    there = mesh.with_nodes(mesh.nodes - [0.0, 0.0, z])
    with pytest.raises(InputError, match=f"mesh: .*{words}"):
        replace(made, mesh=there).simulate()
    # A frame in the ankle is not far off.
    block = replace(block, origin_m=(0.0, 0.0, 0.1))
    replace(made.settings, mesh=block).read_mesh(tmp_path)


def test_a_footbed_below_its_rim_keeps_its_frame(tmp_path):
    """A cup's: the rim is at z = 0, what is glued below it."""
    mesh = brick((0.24, 0.12, 0.03), (6, 4, 3))
    middle = np.abs(mesh.nodes[mesh.tets].mean(axis=1))
    hollow = (middle[:, 0] < 0.08) & (middle[:, 1] < 0.03)
    tets = mesh.tets[~(hollow & (middle[:, 2] < 0.01))]
    inside = (np.abs(mesh.nodes[:, 0]) < 0.081) & (
        np.abs(mesh.nodes[:, 1]) < 0.031
    )
    bed = inside & np.isclose(mesh.nodes[:, 2], -0.01)
    told = {"fixed": bed.astype(float)}
    path = tmp_path / "cup.vtk"
    meshio.Mesh(mesh.nodes, [("tetra", tets)], point_data=told).write(path)
    found = read_mesh(path)
    assert found.nodes[found.fixed, 2] == pytest.approx(-0.01)
    assert found.nodes[:, 0].min() == pytest.approx(-0.12)


def test_an_empty_surface(case):
    (case / "sole.stl").write_text("")
    words = ["sole", "simulate", str(case / "case.yaml"), "--out"]
    words += [str(case / "out"), "--mesh", str(case / "sole.stl")]
    assert main(words) == 2


def test_a_case_is_never_replaced(case, capsys):
    before = (case / "case.yaml").read_bytes()
    words = ["sole", "optimize", str(case / "case.yaml"), "--out", str(case)]
    assert main([*words, "--force"]) == 2
    assert "case.yaml, which is read" in capsys.readouterr().err
    assert (case / "case.yaml").read_bytes() == before


@pytest.mark.slow
def test_a_load_is_never_replaced(case, capsys):
    """An earlier run's table is one, too."""
    file, folder = case / "case.yaml", case / "step"
    words = ["sole", "simulate", str(file), "--out", str(folder)]
    assert main([*words, "--accept", "all"]) == 0
    before = (folder / "steps.csv").read_bytes()
    file.write_text(file.read_text().replace("load.csv", "step/steps.csv"))
    assert main([*words, "--force"]) == 2
    assert "steps.csv, which is read" in capsys.readouterr().err
    assert (folder / "steps.csv").read_bytes() == before


def test_a_data_root_that_is_none(case, capsys):
    words = ["sole", "simulate", str(case / "case.yaml"), "--out"]
    assert main([*words, str(case / "out"), "--data-root", "gone"]) == 2
    assert "gone: is not a folder; check data_root" in capsys.readouterr().err


def test_no_process_does_no_work(case, capsys):
    words = ["sole", "optimize", str(case / "case.yaml"), "--jobs", "0"]
    with pytest.raises(SystemExit):
        main([*words, "--out", str(case / "out")])
    assert "--jobs: 0 does no work" in capsys.readouterr().err
    assert not (case / "out").exists()


@pytest.mark.slow
def test_points_of_a_front_survive_ctrl_c(case, monkeypatch, capsys):
    point = {"case": "small", "floor": 0.9, "c_tr": 1.0, "c_rot": 2.0,
             "ratio_tr": 0.5, "ratio_rot": 0.9, "optimality_error": 0.1,
             "violation": 0.0, "failed_steps": 0,
             "coefficients": [1.0]}  # fmt: skip

    def stopped(setup, floors, say, points):
        points.append(point)
        raise KeyboardInterrupt

    monkeypatch.setattr(command.soles, "pareto_front", stopped, raising=False)
    words = ["sole", "front", str(case / "case.yaml"), "--out"]
    assert main([*words, str(case / "out")]) == 130
    assert "stopped by the user after 1 points" in capsys.readouterr().out
    told = json.loads((case / "out" / "summary.json").read_text())
    assert told["front"] == [point]
    # What misses its floor by the exact law is told.
    assert told["verdict"] == "holds"
    point["ratio_rot"] = 0.899
    assert main([*words, str(case / "out"), "--force"]) == 130
    said = capsys.readouterr().out
    assert "bounds.c_rot (small, floor 0.900, 0.899, limit 0.9)" in said
    # Outside of the case's limits nothing holds, unless that is accepted.
    point["violation"] = 0.0101
    again = [*words, str(case / "out"), "--force"]
    for accepted, begins in ((), "FAILS"), (["bounds.limits"], "accepted"):
        options = [word for name in accepted for word in ("--accept", name)]
        assert main([*again, *options]) == 130
        where = "bounds.limits (small, floor 0.900, 0.0101, limit 0.01)"
        assert f"  {begins}  {where}" in capsys.readouterr().out


def test_ctrl_c_says_how_an_optimisation_goes_on(case, monkeypatch, capsys):
    out, begun = case / "out", []

    def stopped(*given):
        for _ in begun:
            (out / "checkpoint.json").write_text("{}")
        raise KeyboardInterrupt

    monkeypatch.setattr(dx.soles.Case, "optimize", stopped)
    words = ["sole", "optimize", str(case / "case.yaml"), "--out", str(out)]
    assert main(words) == 130
    assert "before the first checkpoint" in capsys.readouterr().out
    begun.append(1)
    assert main([*words, "--force"]) == 130
    assert f"go on with --resume {out}" in capsys.readouterr().out
    # Also while the results of a search that has ended are written.
    (out / "checkpoint.json").unlink()
    ended = SimpleNamespace(write=stopped)
    monkeypatch.setattr(dx.soles.Case, "optimize", lambda *given: ended)
    assert main([*words, "--force"]) == 130
    assert f"go on with --resume {out}" in capsys.readouterr().out


@pytest.mark.slow
def test_a_step_without_any_solution_replaces_none(case, capsys):
    """As for the commands on movements: its results go beside."""
    out = case / "out"
    words = ["sole", "simulate", str(case / "case.yaml"), "--out", str(out)]
    assert main(words) == 0
    before = (out / "summary.json").read_bytes()
    (case / "load.csv").write_text(f"{HEAD}\n0,0,0,800,-0.1149,0.0649\n")
    capsys.readouterr()
    assert main([*words, "--force"]) == 1
    assert (out / "summary.json").read_bytes() == before
    beside = out.with_name("out.partial")
    assert f"results in {beside}\n" in capsys.readouterr().out
    told = json.loads((beside / "summary.json").read_text())
    assert told["verdict"] == "not solved"


@pytest.mark.slow
def test_a_step_without_any_solution_is_told(case):
    """Pressed at the very edge; and a name that is no formula."""
    write_case(case / "case.yaml", name=r"sole $\foo{$")
    (case / "load.csv").write_text(f"{HEAD}\n0,0,0,800,-0.1149,0.0649\n")
    out = case / "out"
    words = ["sole", "simulate", str(case / "case.yaml"), "--out", str(out)]
    assert main(words) == 1
    told = json.loads((out / "summary.json").read_text())
    assert told["verdict"] == "not solved"
    assert (out / "stiffness.png").is_file()
