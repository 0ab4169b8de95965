"""Quasi-static simulation of a sole through one contact phase."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
)
from drake_exo.soles.step import stiffness
from drake_exo.soles.step.first_contact import first_step, follow_load

_PATIENCE = 3  # times the Newton steps of a neighbouring design


@dataclass
class StepHistory:
    """States of a sole over the samples of a contact phase.

    A failed sample holds the last attempt's state and NaN in K_c.

    Attributes:
        F: Forces of the ground on the contact nodes, world [N], (N, m, 3).
        O: Place of the sole frame's origin, world [m], (N, 3).
        R: Orientation, (N, 3, 3).
        P: Places of the contact nodes, world [m], (N, m, 3).
        K_c: Cartesian stiffness about the ZMP, (N, 6, 6).
        reports: Convergence of every sample.
    """

    F: np.ndarray
    O: np.ndarray  # noqa: E741
    R: np.ndarray
    P: np.ndarray
    K_c: np.ndarray
    reports: list[Convergence] = field(default_factory=list)

    @property
    def converged(self) -> np.ndarray:
        """Which samples converged, (N,)."""
        return np.array([r.converged for r in self.reports], dtype=bool)

    @property
    def failed_steps(self) -> int:
        """Number of samples without a solution."""
        return int((~self.converged).sum())

    def state(self, q: int) -> State:
        """State at sample q (counted from 0)."""
        return State(self.F[q], self.O[q], self.R[q])

    def costs(self, weight: float = 1.0, fraction: float = 0.1):
        """c_tr, c_rot and c over the samples (NaN where one failed)."""
        return stiffness.costs(self.K_c, weight, fraction)


def simulate(
    solver: ContactSolver,
    force: np.ndarray,
    zmp: np.ndarray,
    start: Start,
    *,
    stop_at_failure: bool = False,
    near: StepHistory | None = None,
    largest_force: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> StepHistory:
    """Follow the desired force and ZMP sample by sample.

    Args:
        solver: Of the sole and its contact law.
        force: Desired force of the ground, world [N], (N, 3).
        zmp: Desired ZMP on the ground, world [m], (N, 2).
        start: How the sole is held just before contact.
        stop_at_failure: Leave the remaining samples out after a failure.
        near: History of a neighbouring design: a start on another branch
            fails, so does a step that takes far more Newton steps, and its
            increments from sample to sample are the first guess of this
            one's. None: any branch will do.
        largest_force: Largest |F| of the phase [N], by which the first
            contact is found; of the samples given where None.
        progress: Called with samples done and samples in all.
    """
    steps, m = len(force), len(solver.lP)
    history = StepHistory(
        np.zeros((steps, m, 3)),
        np.zeros((steps, 3)),
        np.tile(np.eye(3), (steps, 1, 1)),
        np.zeros((steps, m, 3)),
        np.full((steps, 6, 6), np.nan),
    )
    largest = largest_force or float(np.linalg.norm(force, axis=1).max())
    good = None  # (sample, state, places) of the last success
    left = 0 if near else np.inf  # Newton steps that may still be taken
    for q in range(steps):
        reference = start if good is None else good[2][:, :2]
        target = Target(force[q], zmp[q], reference)
        if near is not None:
            left += _PATIENCE * (10 + near.reports[q].iterations)
        if good is None:
            first = near.state(0) if near else None
            state, report = first_step(solver, target, largest, first, left)
        else:
            before = Target(force[good[0]], zmp[good[0]], reference)
            guess = _alike(near, good[0], q, good[1]) if near else None
            state, report = follow_load(solver, good[1], before, target, guess)
        if state is not None:
            history.F[q], history.O[q], history.R[q] = (
                state.F,
                state.O,
                state.R,
            )
            history.P[q] = solver.deformed(state.F, state.R) + state.O
        left -= report.iterations
        if left < 0:
            report.converged = False
            report.message = "takes far longer than a neighbouring design"
        history.reports.append(report)
        if report.converged:
            K = solver.linearise(state, target).cartesian_stiffness()
            history.K_c[q] = K
            good = (q, state, history.P[q])
        elif stop_at_failure:
            rest = Convergence(False, 0, np.inf, "left out after a failure")
            history.reports += [rest] * (steps - q - 1)
            break
        if progress is not None:
            progress(q + 1, steps)
    return history


def _alike(near: StepHistory, before: int, now: int, state: State) -> State:
    """The state changed as a neighbour's is from one sample to another."""
    old, new = near.state(before), near.state(now)
    # Rounding would grow from design to design without the projection.
    U, _, Vt = np.linalg.svd(new.R @ old.R.T @ state.R)
    return State(state.F + new.F - old.F, state.O + new.O - old.O, U @ Vt)
