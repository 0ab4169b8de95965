"""An optimisation whose elements wear out goes on with new ones."""

import json
import shutil

import numpy as np
import pytest
from small_step import optimize, stage, write_case, write_step

from drake_exo import cli
from drake_exo.soles.case import Case
from drake_exo.soles.mesh import read_mesh
from drake_exo.soles.optimize import remeshing
from drake_exo.soles.optimize import search as designs
from drake_exo.soles.optimize.files import (
    Checkpoint,
    find_designs,
    read_checkpoint,
)
from drake_exo.soles.optimize.remeshing import RemeshError, with_new_elements

pytestmark = pytest.mark.slow


def _case(folder, remeshes=3, iterations=40):
    case = Case.read(folder / "case.yaml").with_iterations(iterations)
    return case.optimizing(remeshes=remeshes)


def _optimise(folder, out, resume=None, **kinds):
    case, lines = _case(folder, **kinds), []
    out.mkdir(exist_ok=True)
    return case.optimize(out, lines.append, resume), lines


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run by the command line; its first checkpoint on new elements."""
    place = tmp_path_factory.mktemp("worn")
    write_step(place / "load.csv", 10)
    write_case(
        place / "case.yaml", divisions=(6, 4, 2), intervals=[6, 6],
        stages=[stage(10, 1e-4, 40)], roughness=0.3,
        stability_n_per_m=None, tilt_deg=None, strain=None,
    )  # fmt: skip
    write = Checkpoint.write

    def spy(self, out):
        write(self, out)
        if self.mesh is not None and not (place / "first").exists():
            (place / "first").mkdir()
            shutil.copy(out / "checkpoint.json", place / "first")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Checkpoint, "write", spy)
        assert optimize(place / "case.yaml", place / "out") == 0
    return place


@pytest.fixture(scope="module")
def row(folder):
    return json.loads((folder / "out" / "summary.json").read_text())


@pytest.fixture(scope="module")
def without(folder):
    return _optimise(folder, folder / "without", remeshes=0)[0]


def test_the_floor_stops_the_search_without_new_elements(without):
    assert remeshing.is_worn(without.problem, without.coefficients)
    assert without.optima[-1].multipliers[1] < -0.05
    assert without.remeshed == ()


def test_with_new_elements_it_comes_to_no_higher_cost(folder, row, without):
    # Worn elements flatter: both are compared on sound ones.
    problem = with_new_elements(without.problem, without.coefficients)
    assert row["starts"][0]["cost"] <= problem.cost(without.coefficients)
    assert abs(row["multipliers"]["elements"]) < 0.02


def test_the_summary_says_when_and_what_it_did(row):
    entry, last = row["remeshed"][0], row["remeshed"][-1]
    assert entry["stage"] == 1
    assert 5 <= entry["iteration"] < 40
    assert last["tets"] == row["tets"]
    before, after = entry["before"], entry["after"]
    assert after["least_quality"] > 1.5 * before["least_quality"]
    assert after["c_tr"] == pytest.approx(before["c_tr"], rel=0.3)
    assert after["c_tr"] != before["c_tr"]


def test_a_resumed_run_goes_the_same_way(folder, row):
    at = read_checkpoint(folder / "first")
    assert at.iteration > 0
    design, _ = _optimise(folder, folder / "resumed", at)
    first = json.loads((folder / "out" / "design.json").read_text())
    np.testing.assert_array_equal(design.coefficients, first["coefficients"])
    mesh = read_mesh(folder / "out" / "sole.vtk")
    np.testing.assert_array_equal(design.mesh.nodes, mesh.nodes)
    np.testing.assert_array_equal(design.mesh.tets, mesh.tets)
    assert len(design.remeshed) == len(row["remeshed"])


def test_the_folder_is_that_of_any_design(folder, row):
    (stored,) = find_designs(folder / "out")
    assert len(stored.setup.mesh.tets) == row["tets"] != 6 * 6 * 4 * 2
    brick = read_mesh(folder / "out" / "initial.vtk")
    assert len(brick.tets) == 6 * 6 * 4 * 2
    spline, p = stored.shape()
    np.testing.assert_allclose(
        spline.stretch(stored.setup.mesh.nodes[stored.setup.mesh.contact], p),
        spline.stretch(
            0.5 * stored.setup.mesh.nodes[stored.setup.mesh.contact], p
        ),
    )
    code = cli.main(["sole", "report", str(folder / "out"), "--force"])
    assert code == 0


def test_interrupted_on_new_elements_the_best_is_on_disk(
    folder, tmp_path, monkeypatch
):
    at = read_checkpoint(folder / "first")
    simulate, left = designs.ShapeProblem._simulate, [12]

    def impatient(problem, p):
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        return simulate(problem, p)

    monkeypatch.setattr(designs.ShapeProblem, "_simulate", impatient)
    with pytest.raises(KeyboardInterrupt):
        _optimise(folder, tmp_path, at)
    monkeypatch.undo()
    after = read_checkpoint(tmp_path)
    assert after.iteration > at.iteration
    np.testing.assert_array_equal(after.mesh.nodes, at.mesh.nodes)
    np.testing.assert_array_equal(after.meshed_at, at.meshed_at)
    design, _ = _optimise(
        folder, tmp_path, after, iterations=after.iteration + 1
    )
    assert len(design.remeshed) == 1
    assert np.isfinite(design.smoothed).all()


def test_where_the_remesher_fails_the_search_stops_and_says_so(
    folder, monkeypatch
):
    def fail(problem, p):
        raise RemeshError("no memory")

    monkeypatch.setattr(designs, "with_new_elements", fail)
    design, lines = _optimise(folder, folder / "failed")
    told = [line for line in lines if "no memory" in line]
    assert told == ["stage 1: no new elements: no memory"]
    assert design.optima[-1].status == "elements worn out; no memory"
    assert design.optima[-1].trace[-1][0] < 40
    assert design.remeshed == ()


def test_a_damaged_mesh_in_a_checkpoint_is_refused(folder, tmp_path):
    text = (folder / "first" / "checkpoint.json").read_text()
    data = json.loads(text)
    data["mesh"]["tets"][0][0] = 10**6
    (tmp_path / "checkpoint.json").write_text(json.dumps(data))
    with pytest.raises(designs.InputError, match="not a checkpoint"):
        read_checkpoint(tmp_path)
