"""What is told of a design, against what its sole and its step say."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.soles import settings
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.mesh import brick, halved
from drake_exo.soles.optimize import design as module
from drake_exo.soles.optimize.files import Checkpoint
from drake_exo.soles.optimize.limits import FEASIBLE
from drake_exo.soles.optimize.optimizer import ITERATION_LIMIT, Optimum
from drake_exo.soles.results import Step


@pytest.fixture(scope="module")
def design():
    """Of one sample: nodes that touch carry on, whatever the rounding."""
    text = EXAMPLE.replace("samples: 5", "samples: 1")
    stage = "{divisions: [4, 3, 2], layer_m: 1.0e-4, kappa: 0.2, iterations: 4}"
    text = text.replace("{layer_m: 1.0e-4, kappa: 0.2, iterations: 5}", stage)
    assert stage in text
    return Case.from_text(text).optimize()


@pytest.mark.slow
def test_a_design_is_beside_its_initial_shape(design):
    told, w = design.summary(), design.setup.settings.cost.weight
    first = Case.from_text(
        EXAMPLE.replace("samples: 5", "samples: 1")
    ).simulate()
    assert told["c_initial"] == pytest.approx(first.c, rel=1e-6)
    assert told["c_tr_initial"] == pytest.approx(first.c_tr, rel=1e-6)
    assert told["c_rot_initial"] == pytest.approx(first.c_rot, rel=1e-6)
    again = replace(design.setup, mesh=design.mesh).simulate()
    assert told["c"] == pytest.approx(again.c, rel=1e-6)
    assert told["ratio_tr"] == pytest.approx(again.c_tr / first.c_tr, rel=1e-6)
    ratio = again.c_rot / first.c_rot
    assert told["ratio_rot"] == pytest.approx(ratio, rel=1e-6)
    (load,) = told["loads"]
    assert load["c_initial"] == pytest.approx(first.c, rel=1e-6)
    assert load["ratio"] == pytest.approx(again.c / first.c, rel=1e-6)
    # The mesh is the spline's, its c by the smoothed law near the exact.
    nodes = design.shape.deform(design.setup.mesh.nodes, design.coefficients)
    np.testing.assert_allclose(design.mesh.nodes, nodes, atol=1e-15)
    e = design.problem.evaluate(design.coefficients)
    smoothed = e.c_tr - w * e.c_rot
    assert told["c_smoothed"] == pytest.approx(smoothed)
    assert told["exact_change"] == pytest.approx(told["c"] / smoothed - 1)
    assert 0 < abs(told["exact_change"]) < 0.1
    (best,) = design.optima
    assert told["iterations"] == [len(best.trace) - 1] == [4]
    assert told["simulations"] == best.simulations
    assert told["violation"] == best.violation
    assert told["optimality_error"] == best.error
    assert told["status"] == best.status and told["optimal"] is best.optimal
    assert list(told["multipliers"].values()) == list(best.multipliers)


@pytest.mark.slow
def test_a_load_s_c_is_over_the_size_of_the_first_one(design):
    weighty = copy(design)
    cost = replace(design.setup.settings.cost, weight=1e6)  # c < 0
    settings = replace(design.setup.settings, cost=cost)
    setup = replace(design.setup, settings=settings)
    weighty.first = replace(design.first, setup=setup)
    weighty.step = replace(design.step, setup=setup)
    (load,) = weighty.summary()["loads"]
    assert load["c_initial"] < 0
    assert load["ratio"] == pytest.approx(load["c"] / -load["c_initial"])


@pytest.mark.slow
def test_all_stages_count(design):
    """Two of them: what was iterated in each, all simulations, the last.

    They were the second and third of a run that went on.
    """
    rows = [(3, 1.0, 2.0, 3.0), (4, 0.5, 0.1, 0.2), (5, 0.4, 0.1, 0.1)]
    first = Optimum(np.ones(1), simulations=7, trace=rows, stage=1)
    last = replace(design.optima[0], stage=2)
    two = replace(design, optima=[first, last])
    told = two.summary()
    assert told["iterations"] == [2, 4]
    assert told["simulations"] == 7 + last.simulations
    assert told["status"] == last.status
    history = two.history
    count = len(last.trace)
    assert history["stage"].tolist() == [2.0] * 3 + [3.0] * count
    assert history["iteration"].tolist() == [3.0, 4.0, 5.0, *range(count)]
    for k, name in enumerate(("cost", "violation", "dual_infeasibility"), 1):
        wanted = [row[k] for row in (*rows, *last.trace)]
        np.testing.assert_array_equal(history[name], wanted)
    nothing = replace(design, optima=[])
    assert nothing.history["cost"].shape == (0,)
    assert not nothing.summary()["optimal"]


def test_the_spread_is_that_of_feasible_starts(design):
    def spread(*rows):
        names = ("cost", "violation", "stage")
        starts = tuple(dict(zip(names, r, strict=False)) for r in rows)
        return replace(design, starts=starts).spread

    assert spread() is None and spread((-0.5, 0.0)) is None
    assert spread((-0.5, 0.0), (-0.9, 2 * FEASIBLE)) is None
    found = spread((-0.5, 0.0), (-0.4, FEASIBLE), (-0.1, 0.0), (-2.0, 1.0))
    assert found == pytest.approx(0.4 / 0.5)
    # Costs of other stages, which are rougher, do not count.
    found = spread((-0.4, 0.0, 2), (-0.5, 0.0, 2), (-0.1, 0.0, 1))
    assert found == pytest.approx(0.1 / 0.5)


def _values(design):
    """Of every limit: its value, unit's factor, and the side that holds."""
    nodes, mesh = design.mesh.nodes, design.mesh
    step = design.step
    bare = design.setup.mesh.bare
    bottom = np.isclose(design.setup.mesh.nodes[:, 2], -0.03)
    area = np.cross(
        *np.swapaxes(
            nodes[mesh.contact_faces][:, 1:] - nodes[mesh.contact_faces][:, :1],
            0, 1,
        )
    )  # fmt: skip
    up = area[:, 2] / np.linalg.norm(area, axis=1)
    return {
        "volume": ("volume", mesh.volumes.sum(), 1e6, 1),
        "strain": ("strain", step.largest_strain, 1, 1),
        "tilt": ("tilt_deg", step.tilt_deg.max(), 1, 1),
        "stability": ("stability", step.stability.min(), 1, -1),
        "c_rot": ("c_rot", step.c_rot, 1, -1),
        "depth": ("depth", -nodes[bottom, 2].max(), 1, -1),
        "height": ("height", -nodes[bare, 2].min(), 1, 1),
        "draft": ("draft_deg", -np.rad2deg(np.arcsin(up.max())), 1, -1),
    }


@pytest.mark.parametrize(
    "name",
    ["volume", "strain", "tilt", "stability", "c_rot", "depth", "height",
     "draft"],
)  # fmt: skip
def test_a_limit_is_held_to_a_hundredth(design, name):
    key, value, factor, sign = _values(design)[name]
    for part, holds in ((1.02, False), (1.005, True), (0.9, True)):
        # A limit that the value passes by so much of it.
        limit = value / part if sign > 0 else value / (2 - part)
        if value < 0:
            limit = value / (2 - part) if sign > 0 else value / part
        given = {"volume": 1.0} | {key: limit}
        problem = SimpleNamespace(limits=given, surface=design.problem.surface)
        checks = replace(design, problem=problem, optima=[]).verdict().checks
        mine = {c.name: c for c in checks if c.name.startswith("bounds.")}
        assert set(mine) == {"bounds.volume", f"bounds.{name}"}
        check = mine[f"bounds.{name}"]
        assert check.value == pytest.approx(factor * value)
        assert check.limit == pytest.approx(factor * limit)
        more = "some percent more" in check.sentence
        assert more is (name == "c_rot" and not holds)
        said = "begin with a shape" in check.sentence
        of_shape = name in ("depth", "height", "draft")
        assert said is (of_shape and not check.holds)
        if value > 0:  # a hundredth of a limit below 0 is the other way round
            assert check.holds is holds


@pytest.mark.parametrize(
    ("status", "remedy"),
    [("tired", "more starts"), (ITERATION_LIMIT, "more iterations")],
)
def test_an_optimum_that_is_none_is_told(design, status, remedy):
    for optimal in (True, False):
        last = Optimum(np.ones(1), optimal=optimal, status=status)
        given = replace(design, optima=[Optimum(np.ones(1)), last])
        (check,) = [c for c in given.verdict().checks if c.name == "optimum"]
        assert check.holds is optimal and check.level == "note"
        assert (status in check.sentence) is not optimal
        assert (remedy in check.sentence) is not optimal


@pytest.mark.parametrize("change", [-0.06, -0.04, 0.04, 0.06])
def test_a_search_by_a_law_that_is_far_off_is_told(design, change):
    problem, w = copy(design.problem), design.setup.settings.cost.weight
    c = design.step.c / (1 + change)
    problem.evaluate = lambda p: SimpleNamespace(c_tr=c + 7.0 * w, c_rot=7.0)
    checks = replace(design, problem=problem).verdict().checks
    (check,) = [k for k in checks if k.name == "plausibility.law"]
    assert check.value == pytest.approx(change)
    assert check.holds is (abs(change) < 0.05) and check.level == "note"
    assert ("layer_m" in check.sentence) is not check.holds


@pytest.mark.parametrize(
    ("divisions", "by_hand"),
    [((1, 1, 1), (1, 1, 2)), ((4, 3, 2), (5, 4, 3)),
     ((10, 6, 3), (12, 8, 4)), ((18, 12, 4), (22, 15, 6))],
)  # fmt: skip
def test_a_finer_mesh_has_twice_the_cells_and_few_more(divisions, by_hand):
    """1.26 times as many along each axis, or one less where that will do."""
    found = settings._at_least_twice(divisions)
    assert tuple(found) == by_hand
    wanted = 2 * np.prod(divisions)
    assert wanted <= np.prod(found) <= 1.3 * wanted


@pytest.mark.slow
def test_the_finer_check_is_a_simulation_on_a_finer_brick(design):
    said = []
    finer = design.check_finer(said.append)
    samples = len(design.setup.load.times)
    every = [
        f"finer mesh, {q + 1} of {samples} samples" for q in range(samples)
    ]
    assert said == 2 * every
    divisions = settings._at_least_twice((4, 3, 2))
    assert finer["tets"] == 6 * np.prod(divisions)
    base = brick((0.23, 0.13, 0.03), divisions)
    shaped = base.with_nodes(
        design.shape.deform(base.nodes, design.coefficients)
    )
    setup = design.setup
    for mesh, key, change, before in (
        (base, "brick", "brick_change", design.first),
        (shaped, "design", "change", design.step),
    ):
        found = replace(setup, mesh=mesh).simulate()
        assert finer[key]["c"] == pytest.approx(found.c, rel=1e-6)
        assert finer[key]["c_tr"] == pytest.approx(found.c_tr, rel=1e-6)
        assert finer[key]["c_rot"] == pytest.approx(found.c_rot, rel=1e-6)
        wanted = found.c / before.c - 1
        assert finer[change] == pytest.approx(wanted, rel=1e-4)
    words = {}
    for change in (0.031, 0.029, -0.031, -0.029):
        check = design.verdict(finer={"change": change}).checks[-1]
        words[change] = check.holds
    assert list(words.values()) == [False, True, False, True]
    # Turned over on the finer mesh: no number, and told.
    shape = SimpleNamespace(
        deform=lambda nodes, p: nodes * [1, 1, -1], symmetric=False, kept=(),
        count=design.shape.count,
    )  # fmt: skip
    turned = replace(
        design,
        problem=SimpleNamespace(spline=shape, limits=design.problem.limits),
    )
    found = turned.check_finer()
    assert found["design"] is None and np.isnan(found["change"])
    assert found["brick_change"] == finer["brick_change"]


def test_an_own_mesh_is_checked_in_elements_of_half_the_size(
    design, monkeypatch
):
    stages = design.setup.settings.optimize.stages
    own = design.setup.optimizing(
        stages=tuple(replace(s, divisions=None) for s in stages)
    )
    given = replace(design, setup=own)
    finer, mesh = given.check_finer(), own.mesh
    assert finer["tets"] == 8 * len(mesh.tets)
    found = replace(own, mesh=halved(mesh)).simulate()
    assert finer["brick"]["c"] == pytest.approx(found.c, rel=1e-6)
    wanted = finer["design"]["c"] / given.step.c - 1
    assert finer["change"] == pytest.approx(wanted, rel=1e-9)
    monkeypatch.setattr(settings, "_MOST", 8 * len(mesh.tets) - 1)
    assert given.check_finer() is None


def test_limits_up_to_a_hundredth_hold_the_design(design):
    """So do those that it is outside of."""
    names = design.problem.names()
    values = np.array([0.0099, 0.0101, -0.0099, -0.5, 0.0])[: len(names)]
    problem = SimpleNamespace(
        constraints=lambda p: values,
        names=lambda: names,
        spline=SimpleNamespace(symmetric=True, kept=(3, 4)),
    )
    found = replace(design, problem=problem).active()
    assert found == [
        names[0], *names[2:5], "symmetric",
        "2 coefficients fixed",
    ]  # fmt: skip


def test_what_is_printed_is_measured_in_millimetres(design, tmp_path):
    told = design._write_stl(tmp_path)
    values = {key: value for key, (_, value, *_) in _values(design).items()}
    sole = told["sole.stl"]
    assert sole["least_depth_mm"] == pytest.approx(1e3 * values["depth"])
    assert sole["height_mm"] == pytest.approx(1e3 * values["height"])
    assert sole["least_draft_deg"] == pytest.approx(values["draft"])
    assert sole["undercut"] == design.mesh.undercut
    assert sole["watertight"] is True
    assert told["mould.stl"] == {"watertight": True, "least_wall_mm": 10.0}
    # What limits leave out, since it stays as it was given, is there, too.
    heel = design.problem.mesh.nodes[:, 0] < 0
    surface = replace(design.problem.surface, moving=~heel)
    held = copy(design.problem)
    held.surface = surface
    held = replace(design, problem=held)
    assert held._write_stl(tmp_path)["sole.stl"] == sole


def test_the_last_design_is_verified_by_the_exact_law(design):
    p = np.full(len(design.coefficients), 0.95)
    at = Checkpoint(p=p, starts=({"cost": 1.0, "violation": 0.0},))
    found = module.verified(design.setup, design.problem, at, design.optima)
    np.testing.assert_allclose(
        found.mesh.nodes, 0.95 * design.setup.mesh.nodes, atol=1e-15
    )
    assert found.step.law.layer == 0 and found.first.law.layer == 0
    assert found.first.c == pytest.approx(design.first.c, rel=1e-9)
    assert found.optima == design.optima
    assert found.starts == at.starts and found.variables is p


def test_seconds_and_figures_are_of_the_run(design, tmp_path, monkeypatch):
    """A clock that is turned by hand; nothing drawn."""
    clock = [100.0]

    def later(*_, **__):
        clock[0] += 2.5

    monkeypatch.setattr(
        module, "time", SimpleNamespace(perf_counter=lambda: clock[0])
    )
    monkeypatch.setattr(Step, "draw", later)
    monkeypatch.setattr(type(design), "_draw", later)
    monkeypatch.setattr(type(design), "check_finer", lambda *_: later() or None)
    monkeypatch.setattr(
        module, "compare_strains", lambda *_: later() or {"kind": "none"}
    )
    monkeypatch.setattr(module, "write_table", lambda *_: "")
    optima = [replace(design.optima[0], seconds=s) for s in (1.234, 5.678)]
    given = replace(design, seconds=40.0, optima=optima)
    row = given.write(tmp_path)
    assert row["seconds"] == 42.5
    assert row["stages_seconds"] == [1.23, 5.68]
    assert row["finite_strain"]["solve_seconds"] == 2.5
