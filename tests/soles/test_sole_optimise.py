"""The command `sole optimize` and the five cases."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from small_step import optimize, stage, write_case, write_step

from drake_exo.errors import InputError
from drake_exo.papers.de_magistris import TABLE_2, five_cases, table
from drake_exo.soles.case import Case
from drake_exo.soles.contact.law import Ground
from drake_exo.soles.load_blocks import LoadBlock
from drake_exo.soles.mesh import SphericalSpline, brick, read_mesh
from drake_exo.soles.optimize.files import read_checkpoint
from drake_exo.soles.optimize.optimizer import minimise
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.optimize.search import first_design
from drake_exo.soles.settings import Settings
from drake_exo.soles.walking_pattern import Robot

pytestmark = pytest.mark.slow


def _write_case(path, intervals=5, layer_m=5e-5, iterations=3, **optimize):
    write_case(
        path, divisions=(5, 4, 2), intervals=[intervals, intervals],
        stages=[stage(6, layer_m, iterations)], **optimize,
    )  # fmt: skip


def _smooth_case(folder, place):
    """A case whose optimum is reached."""
    _write_case(place / "case.yaml", 3, 1e-3, 200, roughness=30.0)
    return Case.read(place / "case.yaml", folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("optimise")
    _write_case(place / "case.yaml")
    write_step(place / "load.csv", 10)
    assert optimize(place / "case.yaml", place / "out") == 0
    return place


def test_a_better_sole_comes_out(folder):
    row = json.loads((folder / "out" / "summary.json").read_text())
    assert row["c"] < row["c_initial"]
    assert row["volume_cm3"] <= 813.1
    case = Case.read(folder / "case.yaml")
    density = case.settings.material.material().density_kg_per_m3
    assert row["mass_kg"] == pytest.approx(1e-6 * row["volume_cm3"] * density)
    for key in ("c_tr", "c_rot", "c_tr_initial", "c_rot_initial", "optimal",
                "stable", "max_strain", "seconds"):  # fmt: skip
        assert key in row
    for name in ("shape.png", "history.png", "sole.stl", "animation.html"):
        assert (folder / "out" / name).stat().st_size > 1000


def test_the_mesh_written_is_the_design(folder):
    row = json.loads((folder / "out" / "summary.json").read_text())
    mesh = read_mesh(folder / "out" / "sole.vtk")
    assert 1e6 * mesh.volume == pytest.approx(row["volume_cm3"], rel=1e-6)
    stl = meshio.read(folder / "out" / "sole.stl")
    corners = stl.points[stl.cells_dict["triangle"]]
    volume = 1e-3 * np.linalg.det(corners).sum() / 6
    assert volume == pytest.approx(row["volume_cm3"], rel=1e-3)


def test_a_run_goes_on_from_its_checkpoint(folder):
    more = folder / "more"
    options = ("--resume", folder / "out", "--iterations", 6)
    assert optimize(folder / "case.yaml", more, *options) == 0
    first, then = (
        json.loads((folder / name / "summary.json").read_text())
        for name in ("out", "more")
    )
    assert then["c"] <= first["c"] * 1.01
    assert first["iterations"] == [3]
    assert then["iterations"] == [6]


def test_a_number_of_iterations_that_is_none_is_refused(folder, capsys):
    never = folder / "never"
    with pytest.raises(SystemExit) as ended:
        optimize(folder / "case.yaml", never, "--iterations", "-3")
    assert ended.value.code == 2
    assert "'-3' is not a whole number from 0 on" in capsys.readouterr().err


def test_interrupted_three_times_the_optimum_is_the_same(
    folder, tmp_path, monkeypatch
):
    case = _smooth_case(folder, tmp_path)
    simulate = ShapeProblem._simulate
    rng = np.random.default_rng(0)
    left = [0]

    def impatient(problem, p):
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        return simulate(problem, p)

    def run(resume, patience):
        left[0] = patience
        return case.optimize(tmp_path, resume=resume)

    monkeypatch.setattr(ShapeProblem, "_simulate", impatient)
    whole = run(None, -1)
    third = whole.optima[-1].simulations // 3
    resume = None
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            run(resume, int(rng.integers(2 * third // 3, third)))
        resume = read_checkpoint(tmp_path)
        assert resume.iteration > 0
    after = run(resume, -1)
    assert whole.optima[-1].optimal
    assert after.optima[-1].optimal
    assert after.optima[-1].cost == pytest.approx(
        whole.optima[-1].cost, rel=5e-3
    )


def test_a_start_whose_process_is_killed_is_told(folder, tmp_path):
    _write_case(tmp_path / "case.yaml", 3, 1e-3, 400, starts=2)
    case = Case.read(tmp_path / "case.yaml", folder)

    def kill(line):
        threads = Path("/proc/self/task").iterdir()
        for child in " ".join(
            (thread / "children").read_text() for thread in threads
        ).split():
            os.kill(int(child), signal.SIGKILL)

    with pytest.raises(InputError, match="process of a start was killed"):
        case.optimize(tmp_path, kill, at_once=2)


def test_of_several_starts_the_best_goes_on(folder, tmp_path, monkeypatch):
    _write_case(tmp_path / "case.yaml", 3, 1e-3, 4, roughness=10.0, starts=3)
    case = Case.read(tmp_path / "case.yaml", folder)
    lines = []
    found = case.optimize(tmp_path, lines.append, at_once=2)
    assert {line[:9] for line in lines} == {f"start {k}/3" for k in (1, 2, 3)}
    costs = [row["cost"] for row in found.starts]
    assert len(set(costs)) == 3
    first = min(found.starts, key=lambda row: row["cost_finer"])
    assert found.optima[0].cost == first["cost"]
    row = found.summary()
    assert row["starts"] == found.starts
    wanted = (max(costs) - min(costs)) / abs(min(costs))
    assert row["spread"] == pytest.approx(wanted)
    assert not list(tmp_path.glob("start_*"))
    assert read_checkpoint(tmp_path).starts == found.starts
    # One after the other, interrupted in the second: the same.
    simulate = ShapeProblem._simulate
    once = tmp_path / "once"
    once.mkdir()

    def impatient(problem, p):
        second = once / "start_1" / "checkpoint.json"
        if second.exists():
            raise KeyboardInterrupt
        return simulate(problem, p)

    monkeypatch.setattr(ShapeProblem, "_simulate", impatient)
    with pytest.raises(KeyboardInterrupt):
        case.optimize(once)
    monkeypatch.undo()
    at = read_checkpoint(once)
    assert [x is not None for x in at.begun] == [True, True]
    assert at.begun[1].iteration > 0
    again = case.optimize(once, resume=once)
    assert again.starts[0] == found.starts[0]
    assert again.starts[2] == found.starts[2]
    best = again.optima[0].cost
    assert best == pytest.approx(found.optima[0].cost, rel=0.05)


def test_multipliers_and_complementarity_are_those_of_an_optimum(
    folder, tmp_path
):
    case = _smooth_case(folder, tmp_path)
    problem = ShapeProblem(case, case.settings.optimize.stages[0])
    p = first_design(problem, (0.3, 1.4))
    best = minimise(problem, p, (0.3, 1.4), 200)
    assert best.optimal
    assert best.error <= 1e-4
    gradient, jacobian = problem.derivatives(best.p)
    low, high = best.at_bounds
    gradient = gradient + problem.regularization(best.p)[1]
    dual = gradient + jacobian.T @ best.multipliers - low + high
    assert np.abs(dual).max() <= 1e-4
    # IPOPT's sign: constraints at least 0 have multipliers at most 0.
    assert (best.multipliers <= 1e-9).all()
    assert best.multipliers.min() < -1e-3


@pytest.mark.parametrize("divisions", [(5, 4, 2), (6, 5, 3)])
def test_elements_stay_above_their_floor(folder, divisions):
    """Those of the design's mesh and of the finer one."""
    design = json.loads((folder / "out" / "design.json").read_text())
    mesh = brick((0.23, 0.13, 0.03), divisions)
    spline = SphericalSpline(tuple(design["intervals"]))
    p = np.array(design["coefficients"])
    shaped = mesh.with_nodes(spline.deform(mesh.nodes, p))
    assert (shaped.quality() / mesh.quality()).min() > 0.35


def test_a_wrong_checkpoint_is_exit_code_2(folder, capsys):
    never = folder / "never"
    assert optimize(folder / "case.yaml", never, "--resume", folder) == 2
    assert "checkpoint.json: cannot be read" in capsys.readouterr().err


def test_a_resumed_run_does_not_replace_what_it_resumes(folder, capsys):
    out = folder / "out"
    case, options = folder / "case.yaml", ("--resume", out, "--force")
    assert optimize(case, out, *options) == 2
    assert f"would replace {out}, which is read" in capsys.readouterr().err


def test_a_checkpoint_of_another_case_is_exit_code_2(folder, capsys):
    _write_case(folder / "other.yaml", intervals=4)
    out, never = folder / "out", folder / "never"
    assert optimize(folder / "other.yaml", never, "--resume", out) == 2
    assert "of other settings" in capsys.readouterr().err
    text = (folder / "case.yaml").read_text()
    # As many coefficients, but a way to other ones.
    _write_case(folder / "bounded.yaml", bounds=[0.9, 1.1])
    assert optimize(folder / "bounded.yaml", never, "--resume", out) == 2
    said = capsys.readouterr().err
    assert "resume: the" in said and "--resume" not in said
    assert "only iterations may change" in said
    (folder / "named.yaml").write_text(
        "name: another\n" + text[text.index("\n") :]
    )
    assert optimize(folder / "named.yaml", never, "--resume", out) == 2
    assert "this one is 'another'" in capsys.readouterr().err


def test_all_that_a_search_is_of_is_in_its_key(folder):
    case = Case.read(folder / "case.yaml")
    line, load = np.linspace(-1.0, 1.0, 4), case.load
    n = len(load.times)
    turned = np.tile(np.eye(3), (n, 1, 1))
    others = [
        replace(case, ground=Ground(line, line, np.full((4, 4), 0.01))),
        replace(case, start=replace(case.start, yaw=0.3)),
        *(
            replace(case, load=replace(load, **other))
            for other in (
                {"force": 1.01 * load.force},
                {"free_moment": np.ones(n)},
                {"rotation": turned},
            )
        ),
    ]
    assert len({case.key, *(other.key for other in others)}) == 6
    named = replace(case, load=replace(load, name="elsewhere.csv"))
    assert named.key == case.key


def test_without_limits_stability_tilt_and_strain_are_free():
    settings = five_cases(LoadBlock(pattern=Robot()), coarse=True)[0]
    free = Case.open(settings).without_limits().settings.optimize
    assert (free.strain, free.tilt_deg, free.stability_n_per_m) == (None,) * 3


def test_case_files_are_the_studys_cases():
    cases = Path(__file__).parents[1] / "cases"
    for case in five_cases(LoadBlock(pattern=Robot()), coarse=False):
        name = f"sole_{case.name.lower().replace('-', '_')}.yaml"
        read = Settings.read(cases / name)
        assert read.optimize == case.optimize
        assert read.mesh == case.mesh
        assert read.cost == case.cost
        assert read.material == case.material
        assert read.load.straight == case.load.straight


def test_table_holds_the_papers_rows():
    rows = [
        {"name": name, "weight": 1.0, "c_tr_initial": v[0], "c_tr": v[1],
         "c_rot_initial": v[2], "c_rot": v[3]}
        for name, v in TABLE_2.items()
    ]  # fmt: skip
    text = table(rows)
    assert "paper" in text
    assert "3.88e+06  8.06e+05  0.208" in text
    assert text.count("ours") == 5
