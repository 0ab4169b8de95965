"""A neo-Hookean sole through the first samples of a contact phase."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from drake_exo.soles.contact.finite_strain import (
    FiniteState,
    FiniteStrainSolver,
)
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
)
from drake_exo.soles.contact.node_law import ContactLaw
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.elasticity.neo_hookean import NeoHookeanBody
from drake_exo.soles.step.first_contact import first_step

# Parts of the first sample's load at which to enter from small strain.
_ENTRIES = (1.0, 0.5, 0.25, 0.1, 0.04)
_LEAST_STEP = 1.0 / 256.0


@dataclass
class FiniteHistory:
    """States over the samples; a failed one keeps what was reached.

    Attributes:
        states: State of every sample, None where there was none.
        K_c: Cartesian stiffness about the ZMP, NaN where failed, (N, 6, 6).
        reports: Convergence of every sample.
        reached: Part of the way from the sample before to this one's load
            that found an equilibrium, (N,); 1 where converged.
    """

    states: list[FiniteState | None] = field(default_factory=list)
    K_c: np.ndarray = field(default_factory=lambda: np.zeros((0, 6, 6)))
    reports: list[Convergence] = field(default_factory=list)
    reached: list[float] = field(default_factory=list)

    @property
    def converged(self) -> np.ndarray:
        """Which samples converged, (N,)."""
        return np.array([r.converged for r in self.reports], dtype=bool)


def follow(
    sole: Sole,
    law: ContactLaw,
    force: np.ndarray,
    zmp: np.ndarray,
    start: Start,
    entry: State | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FiniteHistory:
    """Follow force and ZMP sample by sample, with the contact's history.

    The first sample is entered from the small-strain solution, at a part of
    its load where need be; the others from the sample before. Where Newton
    fails the load's way is bisected. Without an equilibrium the contact's
    history ends: the samples that follow are left out.

    Args:
        sole: Mesh and material.
        law: Contact law, as in small strain.
        force: Desired force of the ground, world [N], (N, 3).
        zmp: Desired ZMP on the ground, world [m], (N, 2).
        start: How the sole is held just before contact.
        entry: Small-strain solution of the first sample, if known.
        progress: Called with samples done and samples in all.
    """
    solver = FiniteStrainSolver(NeoHookeanBody(sole.mesh, sole.material), law)
    history = FiniteHistory(K_c=np.full((len(force), 6, 6), np.nan))
    for q in range(len(force)):
        if q == 0:
            target = Target(force[q], zmp[q], start)
            largest = float(np.linalg.norm(force, axis=1).max())
            state, report, reached = _enter(
                sole, solver, target, largest, entry
            )
        else:
            reference = solver.places(state)[:, :2]
            target = Target(force[q], zmp[q], reference)
            before = Target(force[q - 1], zmp[q - 1], reference)
            state, report, reached = lead(solver, state, before, target)
        history.states.append(state)
        history.reports.append(report)
        history.reached.append(reached)
        if not report.converged:
            _leave_out(history, len(force) - q - 1)
            break
        history.K_c[q] = solver.cartesian_stiffness(state, target)
        if progress is not None:
            progress(q + 1, len(force))
    return history


def _leave_out(history: FiniteHistory, count: int) -> None:
    rest = Convergence(False, 0, np.inf, "left out after a failure")
    history.states += [None] * count
    history.reports += [rest] * count
    history.reached += [0.0] * count


def lead(solver, state, before: Target, target: Target):
    """From equilibrium at `before` to `target`, bisecting the way.

    Returns:
        Last equilibrium, report at the target, part of the way reached.
    """
    done, step, total = 0.0, 1.0, 0
    while True:
        aim = min(1.0, done + step)
        trial, report = solver.solve(state, target.partway(before, aim))
        total += report.iterations
        if report.converged:
            state, done, step = trial, aim, 2.0 * step
        else:
            step *= 0.5
        if done >= 1.0 or step < _LEAST_STEP:
            break
    report.iterations = total
    report.converged = done >= 1.0
    if not report.converged:
        report.message += f"; no equilibrium found beyond {done:.3f} of the way"
    return state, report, done


def _enter(sole, solver, target: Target, largest: float, known: State | None):
    """First sample: small strain at a part of the load, then all of it."""
    small = ContactSolver.of(sole, solver.law)
    best = None
    for part in _ENTRIES:
        aim = replace(target, force=part * target.force)
        guess = known if part == 1.0 else None
        if guess is None:
            guess, report = first_step(small, aim, part * largest)
            if not report.converged:
                best = best or (None, report, 0.0)
                continue
        u = sole.displacement(guess.F @ guess.R)
        state = FiniteState(guess.F, u, guess.O, guess.R)
        state, report = solver.solve(state, aim)
        if not report.converged:
            best = best or (None, report, 0.0)
            continue
        entry = report.iterations
        state, report, way = lead(solver, state, aim, target)
        report.iterations += entry
        reached = part + way * (1.0 - part)
        if report.converged:
            return state, report, 1.0
        if best is None or reached > best[2]:
            best = (state, report, reached)
    return best
