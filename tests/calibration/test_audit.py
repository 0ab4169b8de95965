"""The audit finds what was put wrong by a known amount, and nothing else."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from measured_trials import saying

from drake_exo.calibration import audit as module
from drake_exo.calibration.audit import Audit, audit, between_nodes, simulate
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce
from drake_exo.virtual_laboratory.forces import ground_wrench


def spoiled(result, **fields):
    """The same result with other signals in its only trial."""
    (trial,) = result.trials
    return saying(result, trials=[replace(trial, **fields)])


def missing(result):
    """Largest force and moment between nodes."""
    force, moment = between_nodes(result, 0)
    return float(force.max()), float(moment.max())


def shifted(trial, **components):
    """Its cuffs' forces with something added, by cuff."""
    return {
        cuff: CuffForce.of(force.components + components.get(cuff, 0.0))
        for cuff, force in trial.cuffs.items()
    }


@pytest.fixture(scope="module")
def base(predicted):
    """What a sound solution misses between its nodes: next to nothing."""
    found = missing(predicted)
    assert max(found) < 2.5
    return found


@pytest.mark.slow
def test_a_moment_too_much_is_missing_in_the_equations(predicted, base):
    (trial,) = predicted.trials
    moments = trial.moments.copy()
    moments[:, 4] += 40.0
    force, moment = missing(spoiled(predicted, moments=moments))
    assert moment == pytest.approx(40.0, abs=base[1] + 1e-6)
    assert force == pytest.approx(base[0], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("column", [0, 1])
def test_a_ground_reaction_too_much_is_missing_twice(predicted, base, column):
    """In the equations of motion, and in the law under the foot."""
    (trial,) = predicted.trials
    force = trial.ground.force.copy()
    force[:, column] -= 25.0
    ground = PlanarWrench(force, trial.ground.moment)
    found = missing(spoiled(predicted, ground=ground))
    assert found[0] == pytest.approx(25.0, abs=base[0] + 1e-6)


@pytest.mark.slow
def test_a_ground_moment_too_much_is_missing(predicted, base):
    (trial,) = predicted.trials
    ground = PlanarWrench(trial.ground.force, trial.ground.moment + 30.0)
    force, moment = missing(spoiled(predicted, ground=ground))
    assert moment == pytest.approx(30.0, abs=base[1] + 1e-6)
    assert force == pytest.approx(base[0], abs=1e-6)


@pytest.mark.parametrize(("component", "of"), [(0, 0), (1, 0), (2, 1)])
def test_a_cuff_that_is_not_as_its_law_says(predicted, base, component, of):
    (trial,) = predicted.trials
    added = np.zeros(3)
    added[component] = 60.0
    cuffs = shifted(trial, thigh=added)
    found = missing(spoiled(predicted, cuffs=cuffs))
    # The bushing's law misses it all, the equations what it does to joints.
    assert found[of] == pytest.approx(60.0, abs=base[of] + 0.5)


def test_a_law_that_differs_between_nodes_is_missed_there(predicted, base):
    """Twice the stiffness under the same motion: the spring's force again."""
    values = predicted.contact.values()
    name = "pelvis.normal_stiffness"
    other = predicted.contact.with_values({name: 2.0 * values[name]})
    (trial,) = predicted.trials
    spring = np.abs(trial.cuffs["pelvis"].normal).max()
    assert spring > 10.0
    force, moment = missing(saying(predicted, contact=other))
    # Damping has a small part in the force.
    assert force == pytest.approx(spring, rel=1e-3)
    assert moment == pytest.approx(base[1], abs=1e-6)


def test_another_foot_is_missed_between_nodes(predicted, base):
    """Under the same motion, against the law as the laboratory has it."""
    (trial,) = predicted.trials
    values = predicted.contact.values()
    stiffer = {
        name: 1.3 * value
        for name, value in values.items()
        if name in ("heel.stiffness", "toe.stiffness")
    }
    other = predicted.contact.with_values(stiffer)
    wrench = ground_wrench(
        predicted.problem.tree, other.ground, trial.q, trial.v
    )
    off = np.abs(wrench.array - trial.ground.array).max(axis=0)
    assert off[1] > 100.0 and off[2] > 5.0
    force, moment = missing(saying(predicted, contact=other))
    assert force == pytest.approx(off[:2].max(), rel=3e-4)
    assert moment == pytest.approx(off[2], rel=0.015)


def test_residuals_are_looked_for_between_nodes(predicted, base):
    """A control that is off at one node: half of it, and more, beside it."""
    (trial,) = predicted.trials
    moments = trial.moments.copy()
    moments[20, 5] += 40.0
    _, moment = missing(spoiled(predicted, moments=moments))
    assert 15.0 < moment < 36.0


@pytest.fixture
def resimulated(predicted, monkeypatch):
    """An audit whose simulation differs from the solution as it is told."""

    def run(**changes):
        (found,) = predicted.trials
        other = replace(found, **{k: f(found) for k, f in changes.items()})
        monkeypatch.setattr(module, "simulate", lambda *_: other)
        return audit(predicted)

    return run


def test_what_a_simulation_differs_by_is_named_by_signal(resimulated, base):
    def ground(trial):
        force = trial.ground.force + np.array([3.0, -7.0])
        return PlanarWrench(force, trial.times)

    def motion(trial):
        return trial.q + np.deg2rad([99.0, 99.0, 99.0, 1, 2, 3, 4, 6, 5])

    def cuffs(trial):
        return shifted(trial, thigh=[8.0, -2.0, 99.0], pelvis=[1.0, 5.0, 0.0])

    def moments(trial):
        return trial.moments + np.array([0.0, 1.0, 0.0, 0.0, -9.0, 2.0])

    found = resimulated(ground=ground, q=motion, cuffs=cuffs, moments=moments)
    assert found.trial == "rise1"
    assert (found.force_n, found.moment_nm) == base
    assert found.simulated_grf_n == pytest.approx((3.0, 7.0))
    assert found.simulated_angles_deg == pytest.approx(6.0)
    assert found.simulated_interaction_n == pytest.approx(8.0)
    assert found.simulated_moments_nm == pytest.approx(9.0)


def test_differences_of_a_simulation_are_root_mean_squares(
    resimulated, predicted
):
    def motion(trial):
        off = np.zeros(trial.q.shape)
        off[: len(off) // 4, 4] = 1.0
        return trial.q + off

    found = resimulated(q=motion)
    n = len(predicted.trials[0].times)
    expected = np.rad2deg(np.sqrt((n // 4) / n))
    assert found.simulated_angles_deg == pytest.approx(expected)


def test_without_cuffs_there_is_no_interaction(predicted, monkeypatch):
    (found,) = predicted.trials
    bare = replace(found, cuffs={})
    monkeypatch.setattr(module, "simulate", lambda *_: bare)
    monkeypatch.setattr(module, "between_nodes", lambda *_: np.ones((2, 5)))
    found = audit(saying(predicted, trials=[bare]))
    assert found.simulated_interaction_n is None
    assert found.intervals == 5


@pytest.mark.parametrize(
    ("force", "moment", "holds"),
    [(1.0, 0.5, True), (1.01, 0.1, False), (0.1, 0.51, False)],
)
def test_within_a_newton_and_half_a_newton_metre(force, moment, holds):
    found = Audit("a", force, moment, (0.9, 0.9), 0.09)
    assert found.holds is holds
    summary = found.summary()
    assert summary["holds"] is holds
    assert (summary["force_n"], summary["moment_nm"]) == (force, moment)


@pytest.mark.parametrize(
    ("grf", "angles", "interaction", "unit"),
    [
        ((0.9, 313.0), 0.0, None, "N"),
        ((1.1, 0.0), 0.0, 0.1, "N"),
        ((0.0, 0.0), 0.11, 0.1, "deg"),
        ((0.0, 0.0), 0.0, 1.1, "N"),
        ((0.0, np.nan), 0.0, None, "N"),
    ],
)
def test_a_simulation_that_differs_does_not_hold(
    grf, angles, interaction, unit
):
    found = Audit("a", 0.1, 0.1, grf, angles, interaction)
    (failing,) = (c for c in found.checks() if not c.holds)
    assert (failing.name, failing.unit, failing.where) == (
        "simulation",
        unit,
        "a",
    )
    assert not found.holds


def test_the_worst_of_each_interval_is_told(predicted):
    """One node that is off spoils the intervals around it, no other."""
    before = between_nodes(predicted, 0)[1]
    (trial,) = predicted.trials
    moments = trial.moments.copy()
    moments[20, 5] += 40.0
    after = between_nodes(spoiled(predicted, moments=moments), 0)[1]
    assert len(after) == len(trial.times) - 1
    worst = np.argsort(after - before)[-2:]
    assert set(worst) == {19, 20}


@pytest.mark.slow
def test_a_simulation_is_of_the_solution_and_its_contact(predicted):
    """It starts where the solution does and feels what the contact gives."""
    (found,) = predicted.trials
    again = simulate(predicted)
    assert again.source == "simulated"
    np.testing.assert_array_equal(again.times, found.times)
    np.testing.assert_allclose(again.q[0], found.q[0])
    np.testing.assert_allclose(again.v[0], found.v[0])
    assert np.abs(np.rad2deg(again.q - found.q)[:, 3:]).max() < 0.1
    assert np.abs(again.moments - found.moments).max() < 2.0
    off = again.ground.force - found.ground.force
    assert np.abs(off).mean() < 3.0
    assert np.abs(again.ground.moment - found.ground.moment).mean() < 1.0
    for cuff, force in found.cuffs.items():
        off = again.cuffs[cuff].components - force.components
        assert np.abs(off).max() < 1.0


def test_segments_of_a_foot_bear_what_the_foot_does():
    """What a trial says of it; the toes have what the solution gave them."""
    rng = np.random.default_rng(0)
    wrenches = rng.standard_normal((4, 4, 3))
    feet = rng.standard_normal((2, 4, 3))
    sides = {
        side: (f"foot_{side}", f"toes_{side}") for side in ("left", "right")
    }
    soles = [b for bodies in sides.values() for b in bodies]
    grounds = dict(zip(soles, wrenches, strict=True))
    found = SimpleNamespace(
        soles={
            side: SimpleNamespace(array=force)
            for side, force in zip(sides, feet, strict=True)
        }
    )
    problem = SimpleNamespace(feet=sides)
    result = SimpleNamespace(problem=problem, trials=[found], grounds=[grounds])
    parts = module._by_segment(result, 0)
    assert list(parts) == soles
    for (foot, toes), force in zip(sides.values(), feet, strict=True):
        np.testing.assert_allclose(parts[foot] + parts[toes], force)
        np.testing.assert_array_equal(parts[toes], grounds[toes])
