"""Steps of the search for a shape and for a front, each by its numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.jobs.engine import Here
from drake_exo.soles import settings
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.mesh import brick
from drake_exo.soles.optimize import search
from drake_exo.soles.optimize.files import Checkpoint, read_checkpoint
from drake_exo.soles.optimize.limits import limits_of
from drake_exo.soles.optimize.optimizer import Optimum
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.optimize.search import (
    first_design,
    settle,
    stage_mesh,
    start_design,
)
from drake_exo.soles.results import Step
from drake_exo.soles.settings import Stage

BOUNDS = (0.3, 1.4)


@pytest.fixture(scope="module")
def case():
    return Case.from_text(EXAMPLE)


@pytest.fixture(scope="module")
def problem(case):
    return ShapeProblem(case, case.settings.optimize.stages[0])


def test_limits_are_those_of_the_case(case):
    """0.8 kg: 1 kg of neoprene is 813 cm³."""
    block = replace(
        case.settings.optimize, stability_n_per_m=7.0, tilt_deg=8.0,
        strain=0.09, c_rot_nm_per_rad=10.0,
    )  # fmt: skip
    shape = replace(
        block.shape, least_depth_m=0.011, largest_height_m=0.12, draft_deg=1.3
    )
    cost = replace(case.settings.cost, mass_limit_kg=0.8)
    settings = replace(
        case.settings, optimize=replace(block, shape=shape), cost=cost
    )
    limits = limits_of(settings, case.load)
    assert limits.pop("volume") == pytest.approx(0.8 / 1230.0)
    assert limits == {
        "stability": 7.0, "tilt_deg": 8.0, "strain": 0.09, "c_rot": 10.0,
        "depth": 0.011, "height": 0.12, "draft_deg": 1.3,
    }  # fmt: skip


def test_a_pose_that_is_held_has_no_limit_on_tilt_and_stability(case):
    """Whether the load is a recording's or put into the case in Python."""
    rotation = np.tile(np.eye(3), (len(case.load.times), 1, 1))
    held = replace(case.load, rotation=rotation)
    assert {"tilt_deg", "stability"} <= set(limits_of(case.settings, case.load))
    problem = ShapeProblem(
        replace(case, load=held), case.settings.optimize.stages[0]
    )
    assert not {"tilt_deg", "stability"} & set(problem.names())


def test_stages_are_bricks_in_the_own_box(case):
    stage = replace(case.settings.optimize.stages[0], divisions=(5, 2, 4))
    found = stage_mesh(case.mesh, stage)
    size = (0.23, 0.13, 0.03)
    np.testing.assert_allclose(found.nodes, brick(size, (5, 2, 4)).nodes)
    assert stage_mesh(case.mesh, replace(stage, divisions=None)) is case.mesh
    nodes = case.mesh.nodes.copy()
    nodes[0] *= 0.9999  # 8e-6 of the volume
    holed = case.mesh.with_nodes(nodes)
    with pytest.raises(InputError, match="divisions need a brick"):
        stage_mesh(holed, stage)


def test_a_stage_lies_where_the_block_lies(case):
    own = case.mesh.with_nodes(case.mesh.nodes + np.array([0.04, -0.01, 0.002]))
    stage = replace(case.settings.optimize.stages[0], divisions=(5, 2, 4))
    found = stage_mesh(own, stage)
    for ends in (np.min, np.max):
        np.testing.assert_allclose(
            ends(found.nodes, axis=0), ends(own.nodes, axis=0), atol=1e-15
        )


def test_keys_that_a_file_may_not_say_are_refused(case):
    with pytest.raises(InputError, match=r"strain is \.nan, but"):
        case.optimizing(strain=float("nan"))
    with pytest.raises(InputError, match="optimize: starts is 0"):
        case.optimizing(starts=0)


def test_on_its_own_mesh_a_brick_may_begin_on_coarser_ones(case):
    """Other shapes have no brick to begin on."""
    coarse = replace(case.settings.optimize.stages[0], divisions=(2, 2, 1))
    setup = case.optimizing(stages=(coarse, coarse))
    shrunk = case.mesh.with_nodes(
        case.mesh.nodes * np.where(case.mesh.nodes[:, :1] > 0.1, 0.999, 1.0)
    )
    for mesh, first in ((case.mesh, (2, 2, 1)), (shrunk, None)):
        own = replace(setup, mesh=mesh).on_own_mesh()
        found = [stage.divisions for stage in own.settings.optimize.stages]
        assert found == [first, None]


def test_the_first_design_is_shrunk_until_it_is_light_enough(problem):
    """To 0.99 of the limit, by hundredths: the least number of them."""
    p = first_design(problem, BOUNDS)
    limit = 0.99 * problem.limits["volume"]
    number = np.ceil(np.log(limit / 897e-6) / np.log(0.99) / 3)
    np.testing.assert_allclose(p, 0.99**number)
    assert problem.deformed(p).volume <= limit
    assert problem.deformed(p / 0.99).volume > limit
    thin = np.full(problem.spline.count, 0.5)
    thin[3] = 0.1
    np.testing.assert_array_equal(
        first_design(problem, BOUNDS, thin), np.clip(thin, 0.3, 1.4)
    )


@pytest.mark.slow
def test_starts_are_smooth_bends_within_the_limits(problem):
    """Other ones each; about 3 % of cosines with up to three half waves."""
    found = [start_design(problem, BOUNDS, k) for k in range(4)]
    np.testing.assert_array_equal(found[0], first_design(problem, BOUNDS))
    for k, p in enumerate(found[1:], 1):
        values = problem.constraints(p)
        assert values[:2].min() >= 0
        np.testing.assert_array_equal(p, start_design(problem, BOUNDS, k))
        for other in found[:k]:
            assert np.abs(p - other).max() > 0.02
        # 16 waves of about 0.03: a field of about 0.06 (RMS 0.03 times 2).
        assert 0.02 < np.std(p / p.mean()) < 0.15


def test_bends_have_few_waves_along_each_axis():
    """Of a spline whose coefficients are all free, by its cosine transform."""

    class Free:
        intervals, count = (9, 13), 11 * 15

        @staticmethod
        def free_map():
            from scipy.sparse import identity

            return identity(11 * 15, format="csr"), 0.25 * np.ones(11 * 15)

    kept = []

    def constraints(p):
        kept.append(p)
        return np.array([0.0, 0.0, -1.0])

    fake = SimpleNamespace(
        spline=Free,
        deformed=lambda p: SimpleNamespace(volume=0.5),
        limits={"volume": 1.0},
        constraints=constraints,
    )
    p = start_design(fake, (-9.0, 9.0), 5)
    assert len(kept) == 1
    field = (p + 0.25).reshape(11, 15) - 1.0
    waves = [
        np.cos(np.outer(np.linspace(0, np.pi, n), np.arange(4)))
        for n in (11, 15)
    ]
    amounts = np.linalg.pinv(waves[0]) @ field @ np.linalg.pinv(waves[1]).T
    np.testing.assert_allclose(waves[0] @ amounts @ waves[1].T, field)
    wanted = np.random.default_rng(5).standard_normal((4, 4))
    np.testing.assert_allclose(amounts, 0.03 * wanted)


def test_a_bend_that_cannot_be_simulated_is_drawn_again(problem, monkeypatch):
    first = start_design(problem, BOUNDS, 1)
    plain, asked = type(problem).constraints, []

    def constraints(self, p):
        asked.append(p)
        values = plain(self, p)
        if len(asked) == 1:
            values[0] = np.nan
        if len(asked) == 2:
            values[0] = -1e-9
        if len(asked) == 3:
            values[1] = -1e-9
        return values

    monkeypatch.setattr(type(problem), "constraints", constraints)
    again = start_design(problem, BOUNDS, 1)
    assert len(asked) == 4
    np.testing.assert_array_equal(asked[0], first)
    np.testing.assert_array_equal(asked[3], again)


def test_bends_get_smaller_where_none_can_be_simulated(problem, monkeypatch):
    asked = []

    def constraints(self, p):
        asked.append(np.std(p / p.mean()))
        return np.full(3, np.nan)

    monkeypatch.setattr(type(problem), "constraints", constraints)
    found = start_design(problem, BOUNDS, 1)
    np.testing.assert_array_equal(found, first_design(problem, BOUNDS))
    means = np.mean(np.reshape(asked, (3, 20)), axis=1)
    np.testing.assert_allclose(means / means[0], [1, 0.5, 0.25], rtol=0.2)


def test_settling_is_a_step_of_the_heat_equation(monkeypatch):
    """The least amount that the mesh carries; ones stay as they are.

    It carries what an optimum on it may miss: a stage begins with that.
    """
    rng = np.random.default_rng(1)
    root = rng.standard_normal((5, 5))
    root -= root.mean(axis=1, keepdims=True)
    H, p = 2 * root.T @ root, 1 + rng.standard_normal(5)
    for good, amount in enumerate(
        (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, None)
    ):
        asked = []

        def constraints(trial, asked=asked, good=good):
            asked.append(trial)
            if len(asked) <= good:
                return np.array([np.nan, 0, 0] if good % 2 else [1, -0.0051, 0])
            return np.array([-1.0, -0.0049, -1.0])

        fake = SimpleNamespace(
            regularization=lambda p: (0, 0, H), constraints=constraints
        )
        found = settle(fake, p)
        if amount is None:
            np.testing.assert_array_equal(found, p)
            continue
        # (1 + amount H / max|H|) (x − 1) = p − 1
        left = found - 1 + amount * H @ (found - 1) / np.abs(H).max()
        np.testing.assert_allclose(left, p - 1, atol=1e-12)
    fake = SimpleNamespace(regularization=lambda p: (0, 0, 0 * H))
    assert settle(fake, p) is p


def test_a_stage_goes_on_where_it_stands(case, monkeypatch):
    """Iterations that are left; numbers that go on; what is kept of it."""
    block = case.settings.optimize
    stages = (block.stages[0], replace(block.stages[0], iterations=9))
    setup = case.optimizing(stages=stages)
    given, kept, said = {}, [], []
    n = 17
    monkeypatch.setattr(search, "settle", lambda problem, p: p)
    monkeypatch.setattr(Checkpoint, "write", lambda at, out: kept.append(at))

    def minimise(problem, p, bounds, iterations, tolerance, note, **more):
        given.update(more, p=p, bounds=bounds, left=iterations, tol=tolerance,
                     problem=problem)  # fmt: skip
        best = Optimum(p + 1, -0.5, multipliers=np.arange(5.0))
        for k in range(5):
            best.trace.append((k, -0.5 - k, 0.25, 0.125))
            best.latest = (p, np.arange(5.0), 1e-4)
            note(k, best)
        return best

    monkeypatch.setattr(search, "minimise", minimise)
    p = np.linspace(0.8, 1.0, n)
    at = Checkpoint(1, 4, p, p, np.ones(5), 1e-3, np.eye(n))
    best, new = search._run_stage(setup, 1, at, "out", said.append)
    assert (given["left"], given["tol"]) == (5, block.tolerance)
    np.testing.assert_array_equal(np.transpose(given["bounds"]), n * [BOUNDS])
    assert given["refining"] and tuple(block.bounds) == BOUNDS
    np.testing.assert_array_equal(given["p"], p)
    np.testing.assert_array_equal(
        given["hessian_approximation"].matrix, np.eye(n)
    )
    assert given["warm"].barrier == 1e-3
    assert given["problem"].law.layer == 1e-4
    assert [row[0] for row in best.trace] == [4, 5, 6, 7, 8]
    assert best.trace[2][1:] == (-2.5, 0.25, 0.125)
    assert best.stage == 1
    # Every third iteration is kept; in the end, the last stage to go on with.
    assert [(c.stage, c.iteration) for c in kept] == [(1, 7)]
    assert (new.stage, new.iteration, new.barrier) == (1, 0, 1e-7)
    np.testing.assert_array_equal(new.latest, p + 1)
    assert said[2].startswith("stage 2/2, iteration 6: cost -2.5000, viol")
    assert "violation 2.5e-01, error 1.2e-01" in said[2]
    _, new = search._run_stage(setup, 0, Checkpoint(p=p, latest=p), None, str)
    assert (new.stage, given["left"], given["refining"]) == (1, 5, False)
    assert given["warm"] is None


_LOADS = """loads:
  - constant: {force_n: [10, 0, 400], zmp_m: [0.08, 0.01], samples: 2}
  - constant: {force_n: [0, 0, 300], zmp_m: [-0.08, -0.03], samples: 2}
    weight: 3
"""


def _for_the_worst(*iterations):
    """The example with two loads, and a stage for each of the iterations."""
    stages = [
        f"{{layer_m: 1.0e-4, kappa: 0.2, iterations: {n}}}" for n in iterations
    ]
    first, last = EXAMPLE.index("load:"), EXAMPLE.index("optimize:")
    block = EXAMPLE[last : EXAMPLE.index("[{layer_m")]
    return Case.from_text(
        f"{EXAMPLE[:first]}{_LOADS}cost: {{of: worst}}\n{block}"
        f"[{', '.join(stages)}]\n"
    )


@pytest.mark.slow
def test_a_search_for_the_worst_load_begins_with_the_mean(monkeypatch):
    """In the first of several stages, also where that was interrupted.

    The worst knows no weights, and that mean has none.
    """
    of = []

    def minimise(problem, p, *_, **more):
        of.append((problem.stage.iterations, problem.settings.cost.of))
        weight = {"mean": 1.0, "worst": 3.0}[problem.settings.cost.of]
        assert problem.load.weights == (1.0, weight)
        return Optimum(p, 1.0, multipliers=np.zeros(5), trace=[(0, 1, 0, 0)])

    monkeypatch.setattr(search, "minimise", minimise)
    setup = _for_the_worst(3, 4, 5)
    p = np.ones(setup.spline().count)
    begun = Checkpoint(0, 1, p, p, np.zeros(5), 1e-3, np.eye(len(p)))
    search.optimise(setup, None, str)
    search.optimise(setup, None, str, resume=begun)
    assert of == 2 * [(3, "mean"), (4, "worst"), (5, "worst")]
    assert setup.settings.cost.of == "worst"
    of.clear()
    search.optimise(_for_the_worst(3), None, str)
    assert of == [(3, "worst")]
    of.clear()
    stages = setup.settings.optimize.stages[:2]
    search.pareto_front(setup, [0.6], None, stages)
    assert of[:2] == [(3, "mean"), (4, "worst")]


@pytest.mark.slow
def test_a_stage_limits_the_largest_strain_itself(case, monkeypatch):
    """The norm times what an exact run says; kept while the stage lasts."""
    stage = case.settings.optimize.stages[0]
    setup = case.optimizing(strain=0.2, stages=(stage, stage))
    given = []

    def minimise(problem, p, *rest, **more):
        given.append((problem, p))
        return Optimum(p, -0.5, trace=[(0, -0.5, 0.0, 0.1)])

    monkeypatch.setattr(search, "minimise", minimise)
    plain = ShapeProblem(setup, stage)
    p = first_design(plain, BOUNDS)
    step = Step.of(setup, setup.sole(plain.deformed(p)), plain.law.penalty)
    local = step.history.F @ step.history.R
    largest = max(
        np.abs(np.linalg.eigvalsh(step.sole.strain(u))).max()
        for u in step.sole.displacement(local)
    )
    search._run_stage(setup, 1, Checkpoint(1, 0, p, p), None, str)
    index = plain.names().index("strain")
    (problem, began), norm = given[0], plain.evaluate(p).strain.value
    assert largest < 0.99 * norm
    value = problem.constraints(began)[index]
    assert value == pytest.approx(1.0 - largest / (0.98 * 0.2), rel=1e-9)
    monkeypatch.setattr(search, "strain_scale", None)
    at = Checkpoint(1, 2, p, p, strain_scale=0.5)
    search._run_stage(setup, 1, at, None, str)
    problem, _ = given[-1]
    largest = problem.limited["strain"].keywords["largest"]
    assert largest == pytest.approx(0.98 * 0.2 / 0.5)
    assert problem.limits["strain"] == 0.2
    search._run_stage(setup, 0, Checkpoint(0, 0, p, p), None, str)
    assert given[-1][0].limited["strain"].keywords["largest"] == 0.2


def test_what_cannot_be_simulated_scales_nothing(problem, monkeypatch):
    p = first_design(problem, BOUNDS)
    failed = SimpleNamespace(failed_steps=1, largest_strain=9.0)
    monkeypatch.setattr(problem, "step", lambda p: failed)
    assert search.strain_scale(problem, p) == 1.0


def _fake_run(number, p, cost, violation=0.0):
    best = Optimum(
        p, cost, violation=violation, seconds=10.0 + number, stage=number - 1
    )
    row = ({"cost": cost, "violation": violation},)
    return best, Checkpoint(number, 0, p, starts=row)


@pytest.mark.slow
def test_starts_are_compared_on_a_finer_mesh(case):
    """Of at least twice the tets; what turns over there has no cost."""
    stage = replace(case.settings.optimize.stages[0], divisions=(4, 3, 2))
    problem = ShapeProblem(case, stage)
    p = start_design(problem, BOUNDS, 1)
    finer = ShapeProblem(case, replace(stage, divisions=(5, 4, 3)))
    own = finer.cost(p) - finer.regularization(p)[0]
    own *= finer.scales[0] / problem.scales[0]
    found = problem.cost_on_finer(p) - problem.regularization(p)[0]
    assert found == pytest.approx(own, rel=1e-9)
    assert problem.cost_on_finer(-p) is None
    # It stays itself.
    again = ShapeProblem(case, stage)
    assert problem.cost(p) == again.cost(p) != problem.cost_on_finer(p)
    # Feasible first, then by that, one without behind the others.
    rows = [(2.0, 0.0, 1.1), (1.0, 0.0, 1.2), (0.5, 0.0, None), (0.1, 0.5, 0.1)]
    optima = [
        Optimum("p", cost, violation=violation, cost_finer=finer)
        for cost, violation, finer in rows
    ]
    assert sorted(optima[::-1], key=lambda best: best.rank) == optima


def test_a_mesh_too_large_for_a_finer_one_is_not_compared(case, monkeypatch):
    stage = replace(case.settings.optimize.stages[0], divisions=None)
    most = 8 * len(case.mesh.tets)
    for limit, has_cost in ((most, True), (most - 1, False)):
        monkeypatch.setattr(settings, "_MOST", limit)
        problem = ShapeProblem(case, stage)
        found = problem.cost_on_finer(first_design(problem, BOUNDS))
        assert (found is not None) is has_cost


def test_a_start_that_went_further_is_ahead():
    runs = [_fake_run(1, "q", 5.0), _fake_run(2, "q", 4.0)]
    none = search.Found([], None)
    near = none.after(*_fake_run(1, "p", 1.0))
    lost = replace(none, start=2).after(*runs[0])
    far = replace(none, start=1).after(*runs[0]).after(*runs[1])
    assert far.at is runs[1][1] and far.seconds == 11.0 + 12.0
    order = sorted([near, lost, far], key=lambda racer: racer.rank)
    assert [racer.start for racer in order] == [1, 0, 2]


def test_the_best_start_goes_through_the_stages(case, monkeypatch):
    """Feasible before cheap; starts that were interrupted go on first."""
    block = case.settings.optimize
    setup = case.optimizing(stages=4 * block.stages, starts=4)
    made, said, clock = [], [], [1000.0]
    rows = [(5.0, 0.0), (1.0, 0.5), (4.0, 0.0), (6.0, 0.0)]

    def from_start(setup, start, number, at, out, say):
        said.append(say("it goes"))
        made.append((start, number, at and at.p))
        cost, violation = rows[start]
        return _fake_run(number + 1, f"p{start}", cost - number, violation)

    def run_stage(setup, number, at, out, say):
        made.append((number, at.p, [row["cost"] for row in at.starts]))
        best, new = _fake_run(number + 1, at.p + "'", 3.0)
        return best, replace(new, starts=at.starts)

    def scale(problem, at):
        problem.scaled = at.p

    def verified(setup, problem, at, optima):
        clock[0] += 7.0
        made.append(((problem.stage, problem.scaled), at.p,
                     [(o.cost, o.seconds) for o in optima]))  # fmt: skip
        return SimpleNamespace(starts=at.starts)

    monkeypatch.setattr(search, "from_start", from_start)
    monkeypatch.setattr(search, "_run_stage", run_stage)
    monkeypatch.setattr(search, "verified", verified)
    monkeypatch.setattr(search, "_scale", scale)
    monkeypatch.setattr(
        search, "ShapeProblem",
        lambda setup, stage: SimpleNamespace(stage=stage, scaled=None),
    )  # fmt: skip
    monkeypatch.setattr(search, "time", SimpleNamespace(
        perf_counter=lambda: clock[0]))  # fmt: skip
    begun = (Checkpoint(iteration=3, p="q"), None)
    last = setup.settings.optimize.stages[-1], "p2'"
    found = search.optimise(setup, None, str, Checkpoint(begun=begun))
    assert made == [
        (0, 0, "q"), (1, 0, None), (2, 0, None), (3, 0, None),
        (2, 1, "p2"), (0, 1, "p0"),  # the better half
        (2, 2, "p2"),
        (3, "p2", [4.0, 1.0, 2.0, 6.0]),
        (last, "p2'", [(4.0, 11.0), (3.0, 12.0), (2.0, 13.0), (3.0, 14.0)]),
    ]  # fmt: skip
    assert found.seconds == 7.0
    places = [1, 2, 3, 4, 3, 1, 3]
    assert said == [f"start {k}/4, it goes" for k in places]
    # Others than the first shapes, none of them the brick.
    made.clear()
    search.optimise(setup, None, str, bends=(3, 2, 1, 0))
    assert [row[0] for row in made[:6]] == [3, 2, 1, 0, 2, 0]
    # One that was finished is verified on its last stage's problem.
    made.clear()
    last = replace(block.stages[0], layer_m=2e-4)
    setup = case.optimizing(stages=(*block.stages, last))
    # Alone it takes no other process.
    monkeypatch.setattr(search, "Processes", None)
    search.optimise(setup, None, str, Checkpoint(stage=2, p="p"), at_once=2)
    assert made == [((last, "p"), "p", [])]
    # What a study tells: the stages of all starts, and the rest.
    setup = case.optimizing(stages=2 * block.stages, starts=2)
    with Here() as pool:
        jobs = [j.told(say=str) for j in search.search_jobs(setup, None)]
        ended = search.run_jobs(jobs, pool)
    names = ["1/stage 1", "2/stage 1", "last stage"]
    assert [job.name for job in jobs] == names
    whole = ended["last stage"].value
    assert whole.seconds == 11.0 + 11.0 + 12.0
    assert search.finished(setup, whole).seconds == 34.0 + 7.0


@pytest.mark.slow
def test_a_start_goes_on_or_is_taken_as_it_ended(case, monkeypatch):
    asked, said = [], []

    def run_stage(setup, number, at, out, say, problem):
        say("it goes")
        asked.append(at)
        assert problem.stage is setup.settings.optimize.stages[number]
        best, new = _fake_run(
            number + 1, np.zeros(17), 2.0 - number, 0.5 * number
        )
        return best, replace(new, starts=at.starts)

    monkeypatch.setattr(search, "_run_stage", run_stage)
    stages = 2 * case.settings.optimize.stages
    setup = case.optimizing(stages=stages, starts=3)
    _, at = search.from_start(setup, 2, 0, None, None, said.append)
    problem = ShapeProblem(case, case.settings.optimize.stages[0])
    bounds = tuple(case.settings.optimize.bounds)
    wanted = start_design(problem, bounds, 2)
    np.testing.assert_array_equal(asked[0].p, wanted)
    np.testing.assert_array_equal(asked[0].latest, wanted)
    assert said == ["it goes", "stage 1/2, on a finer mesh"]
    row = {"stage": 1, "cost": 2.0, "violation": 0.0, "cost_finer": None}
    assert at.starts == (row,)
    again, _ = search.from_start(setup, 2, 0, at, None, said.append)
    assert (again.cost, again.violation) == (2.0, 0.0)
    assert len(asked) == 1 and again.seconds == 0.0
    _, further = search.from_start(setup, 2, 1, at, None, said.append)
    assert asked[1] is at
    row = row | {"stage": 2, "cost": 1.0, "violation": 0.5}
    assert further.starts == (*at.starts, row)
    # Outside of its limits it is not compared by its cost.
    assert said[2:] == ["it goes"]


def test_a_resumed_run_takes_its_checkpoints_along(case, tmp_path, monkeypatch):
    """It may be interrupted before there is another."""

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(search, "search_jobs", stopped)
    own = Checkpoint(1, 2, np.ones(2), np.ones(2), curvature=np.eye(2))
    for at in (Checkpoint(begun=(None, own)), own):
        with pytest.raises(KeyboardInterrupt):
            search.optimise(case, tmp_path, str, at)
        kept = read_checkpoint(tmp_path)
        kept = kept if at is own else kept.begun[1]
        assert (kept.stage, kept.iteration) == (1, 2)


# Walk and sole


def _walking(free, optimize=""):
    text = EXAMPLE[: EXAMPLE.index("load:")]
    return Case.from_text(
        f"{text}load: {{pattern: {{free: {free}}}}}\n{optimize}"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("c", "holds", "is_alone"),
    [(4.0, True, True), (6.0, True, False), (6.0, False, False),
     (4.0, False, False), (np.nan, False, False)],
)  # fmt: skip
def test_the_better_of_a_sole_with_its_walk_and_alone(
    c, holds, is_alone, monkeypatch
):
    """Told beside c of the sole that was found for the case's own walk."""
    setup, asked = _walking("[step_length, step_time]"), []
    problem = ShapeProblem(setup, setup.settings.optimize.stages[0])
    x = setup.gait.start + np.array([0.0, -0.2])
    coefficients = np.full(problem.spline.count, 0.9)

    def design(c, holds, walk):
        there = walk if len(walk) else setup.gait.start
        return SimpleNamespace(
            problem=problem, walk=walk,
            setup=replace(setup, load=setup.gait.load(there)),
            step=SimpleNamespace(c=c, c_tr=c + 1, c_rot=1.0),
            verdict=lambda: SimpleNamespace(holds=holds),
        )  # fmt: skip

    def alone(own, own_problem, at, optima):
        # Its own limits, none of the walk's; how its search ended.
        assert own.gait is None and type(own_problem) is search.ShapeProblem
        assert (at.starts, at.strain_scale) == (({"stage": 2},), 0.5)
        assert optima == ended
        shape, walk = np.split(at.p, [problem.spline.count])
        asked.append(shape)
        return design(c, holds, walk)

    monkeypatch.setattr(search, "verified", alone)
    ended = [Optimum(coefficients, 1.0)]
    before = search.Found(ended, Checkpoint(strain_scale=0.5))
    at = Checkpoint(alone=coefficients, starts=({"stage": 2},))
    found = search.Found([], at, alone=before)
    best = search._with_walk(setup, design(5.0, True, x), found)
    np.testing.assert_array_equal(asked, [coefficients])
    assert best.step.c == (4.0 if is_alone else 5.0)
    length, time = best.gait["walk"].values()
    assert length == [0.2633, pytest.approx(0.2633)]
    assert time == [1.0, pytest.approx(1.0 if is_alone else 0.9)]
    bears = best.gait["contact_s"]
    assert bears[0] - bears[1] == pytest.approx(time[0] - time[1])
    np.testing.assert_equal(best.gait["c_tr_sole_alone"], c + 1)
    assert best.gait["c_rot_sole_alone"] == 1.0
    limits = setup.gait.limits(setup.gait.start if is_alone else x)
    assert best.gait["least_limit"] == min(v.min() for v in limits.values())
    pattern = best.setup.settings.load.pattern
    assert not pattern.free and pattern.step_time_s == time[1]
    # What is written has the samples that were simulated.
    for name in ("times", "force", "zmp"):
        written, own = (
            getattr(x, name) for x in (pattern.load(), best.setup.load)
        )
        np.testing.assert_allclose(written, own, atol=1e-9)
    # Outside of its limits itself, what holds is before it.
    best = search._with_walk(setup, design(1.0, False, x), found)
    assert best.step.c == (c if holds else 1.0)


@pytest.mark.slow
def test_walks_begin_with_the_sole_for_the_case_s_own(monkeypatch):
    """All starts in that; then several walks, the best through the last."""
    stage = "{samples: 9, iterations: 3}"
    setup = _walking(
        "[step_time]",
        f"optimize: {{starts: 2, stages: [{stage}, {stage}, {stage}]}}\n",
    )
    stages, own = setup.settings.optimize.stages, setup.gait.start
    given, told, chosen = [], [], setup.gait.walk(5)

    def told_of(*row):
        told.append(row)
        return row[1]

    def fake(problem, p, bounds, *_, **__):
        shape, walk = np.split(p, [problem.spline.count])
        place = [s is problem.stage for s in stages].index(True)
        given.append((place, p, bounds))
        cost = np.abs(walk - chosen).sum()
        best = Optimum(np.append(shape - 0.01, walk), cost, violation=0.0)
        best.trace = [(0, 1.0, 0.0, 0.0)]
        return best

    def done(setup, problem, at, optima):
        row = {"p": at.p, "at": at, "stages": [o.stage for o in optima]}
        return SimpleNamespace(**row)

    monkeypatch.setattr(search, "minimise", fake)
    monkeypatch.setattr(search, "strain_scale", lambda *_: 1.0)
    monkeypatch.setattr(search, "settle", lambda problem, p: p)
    monkeypatch.setattr(search, "verified", done)
    monkeypatch.setattr(search, "_with_walk", told_of)
    monkeypatch.setattr(
        search.ShapeProblem, "cost_on_finer", lambda self, p: None
    )
    said = []
    design = search.optimise(setup, None, said.append)
    assert [row[0] for row in given] == [0, 0, 1, 2, *[1] * 8, 2]
    alone = given[3][1] - 0.01  # what its last stage found
    assert len({len(row[1]) for row in given[:4]}) == 1
    for number, (_, p, bounds) in enumerate(given[4:12]):
        walk = setup.gait.walk(number)
        np.testing.assert_array_equal(p, np.append(alone, walk))
        np.testing.assert_array_equal(bounds[:, -1], [0.0, 1.0])
        np.testing.assert_array_equal(bounds[:, 0], BOUNDS)
    wanted = np.append(alone - 0.01, chosen)
    np.testing.assert_allclose(given[12][1], wanted)
    np.testing.assert_allclose(design.p, np.append(alone - 0.02, chosen))
    assert design.stages == [1, 2] and len(design.at.starts) == 8
    np.testing.assert_array_equal(design.at.alone, alone)
    ((*_, told_found),) = told
    assert told == [(setup, design, told_found)]
    assert [best.stage for best in told_found.alone.optima] == [0, 1, 2]
    assert told_found.at is design.at
    assert sum("walk 6/8, stage 2/3" in line for line in said) == 1
    # One that has come to its walk goes on there; before, with the sole.
    given.clear()
    setup.optimize(resume=design.at)
    ((place, p, _),) = given
    assert place == 2 and p is design.p
    still = search.in_own_walk(setup)
    at = Checkpoint(stage=2, p=alone, latest=alone, key=still.key)
    assert still.gait is None and still.load is setup.load
    assert still.key != setup.key
    given.clear()
    setup.optimize(resume=at)
    assert [row[0] for row in given] == [2, *[1] * 8, 2]
    np.testing.assert_array_equal(given[0][1], alone)
    # What the sole alone has ended with is not sought again.
    given.clear()
    setup.optimize(resume=replace(at, alone=alone))
    assert [row[0] for row in given] == [*[1] * 8, 2]
    np.testing.assert_array_equal(given[0][1], np.append(alone, own))
    # Nor are walks that have ended; one that was interrupted goes on.
    given.clear()
    at = replace(at, alone=alone)
    row = {"stage": 2, "cost": -1.0, "violation": 0.0}
    p = np.append(alone, own)
    begun = [
        Checkpoint(1, 2, p + 0.01 * k, p + 0.01 * k, alone=alone, starts=rows)
        for k, rows in enumerate([(row,), ()])
    ]
    setup.optimize(resume=replace(at, begun=(begun[0], None, begun[1])))
    assert [row[0] for row in given] == [*[1] * 7, 2]
    np.testing.assert_array_equal(given[0][1][-1:], setup.gait.walk(1))
    np.testing.assert_array_equal(given[1][1], begun[1].p)
    np.testing.assert_array_equal(given[-1][1], p)  # the best of all
    with pytest.raises(InputError, match=f"{len(alone) - 1} coefficients"):
        setup.optimize(resume=replace(design.at, alone=alone[1:]))
    with pytest.raises(InputError, match="of other settings"):
        still.optimize(resume=design.at)
    assert len(own) == 1


# The front


@pytest.mark.slow
def test_each_floor_starts_from_the_one_below(monkeypatch):
    """c_rot above 1.01 of it, c_tr alone; ratios to the brick's."""
    # One sample: of a load that stays, nodes on the cone may stick or slip.
    case = Case.from_text(EXAMPLE.replace("samples: 5", "samples: 1"))
    calls, floors, ends = [], [], [0.99, 0.99, 1.01]
    stages = (
        Stage((4, 3, 2), 5, 1e-4, 0.2, 3),
        Stage((3, 2, 1), 4, 5e-5, 0.2, 4),
    )

    def minimise(problem, p, bounds, iterations, tolerance, note, **more):
        number = len(calls)
        calls.append((problem, p, iterations, more["hessian_approximation"]))
        if "c_rot" in problem.limited:
            floors.append(problem.limited["c_rot"].keywords["least"])
        end = ends[number] if number < len(ends) else 1.0
        return Optimum(p * end, error=0.25, violation=0.125)

    monkeypatch.setattr(search, "minimise", minimise)
    points = search.pareto_front(case, [0.86, 0.6], None, stages)
    assert [point["floor"] for point in points] == [0.6, 0.86]
    own, low, high = calls
    assert (own[2], low[2], high[2]) == (3, 4, 4)
    assert own[3] is not low[3] and low[3] is high[3]
    np.testing.assert_allclose(low[1], own[1] * 0.99)
    np.testing.assert_allclose(high[1], own[1] * 0.99**2)
    assert own[0].weight == case.settings.cost.weight
    assert low[0].weight == high[0].weight == 0.0
    c_rot = low[0].first.c_rot
    np.testing.assert_allclose(floors, [0.606 * c_rot, 0.8686 * c_rot])
    assert len(own[0].mesh.tets) == 144 and len(low[0].mesh.tets) == 36
    # By the exact law, on the mesh of the points.
    for point, factor in zip(points, (0.99, 0.99 * 1.01), strict=True):
        p = own[1] * 0.99 * factor
        np.testing.assert_allclose(point["coefficients"], p)
        mesh = low[0].deformed(p)
        step = replace(case, mesh=mesh)
        found = step.simulate()
        base = replace(case, mesh=low[0].mesh).simulate()
        assert point["c_tr"] == pytest.approx(found.c_tr, rel=1e-6)
        assert point["c_rot"] == pytest.approx(found.c_rot, rel=1e-6)
        ratio = found.c_tr / base.c_tr
        assert point["ratio_tr"] == pytest.approx(ratio, rel=1e-6)
        ratio = found.c_rot / base.c_rot
        assert point["ratio_rot"] == pytest.approx(ratio, rel=1e-6)
        assert point["optimality_error"] == 0.25
        assert (point["violation"], point["failed_steps"]) == (0.0, 0)
    # A thinner one is softer: where it keeps its floor, the lower one as well.
    calls.clear()
    ends[2] = 0.98
    below, above = search.pareto_front(case, [0.6, 0.7], None, stages)
    assert (below["floor"], above["floor"]) == (0.6, 0.7)
    assert below["coefficients"] is above["coefficients"]
    # Floors that are not kept are sought again from large c_rot downwards, and
    # the design of largest c_rot stands for what nothing keeps.
    for grown, again in ((1.0, [3.0]), (1.05, [3.0, 0.6])):
        calls.clear()
        floors.clear()
        ends[1:] = [grown] * 2  # by 5 % it is too heavy, which keeps nothing
        below, above = search.pareto_front(case, [0.6, 3.0], None, stages)
        sought = np.array([0.6, 3.0, *again])
        np.testing.assert_allclose(floors, 1.01 * c_rot * sought)
        large, first = calls[3:5]
        assert large[0].weight == 1000.0 and large[2] == 3
        np.testing.assert_array_equal(large[1], own[1])
        np.testing.assert_array_equal(first[1], large[1])
        assert first[3] is not calls[1][3] and first[0].weight == 0.0
        assert above["floor"] == 3.0
        np.testing.assert_array_equal(above["coefficients"], own[1])
        assert (below["coefficients"] is above["coefficients"]) is (grown > 1)


def test_no_point_of_a_front_is_behind_another():
    """Neither one that keeps its floor, nor one that misses it or fails."""
    lines = [
        (0.6, 0.5, 0.9, 0.0, 1),  # floor, c_tr, c_rot, violation, which one
        (0.7, 0.4, 0.75, 0.0, 1),  # stands for it
        (0.8, 0.6, 0.82, 0.0, 0),
        (0.85, 0.1, np.nan, 0.0, 0),
        (0.9, 0.3, 0.95, 0.1, 0),  # violates another limit
        (1.4, 0.9, 1.2, 0.0, 6),  # misses its floor, as does the better next
        (1.5, 0.8, 1.3, 0.0, 6),
        (1.6, 0.8, 1.7, 0.1, 6),
        (2.0, np.nan, np.nan, 0.0, 6),
    ]
    found = [
        {
            "floor": floor, "ratio_tr": tr, "ratio_rot": rot,
            "violation": violation, "number": k,
        }
        for k, (floor, tr, rot, violation, _) in enumerate(lines)
    ]  # fmt: skip
    wanted = [found[line[-1]] | {"floor": line[0]} for line in lines]
    assert search._best(found) == wanted
