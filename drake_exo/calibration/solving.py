"""Solving a phase with progress, checkpoints and refinement of the grid."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drake_exo.calibration.audit import (
    FORCE_TOLERANCE,
    MOMENT_TOLERANCE,
    between_nodes,
)
from drake_exo.calibration.problem import PhaseProblem, PhaseResult
from drake_exo.errors import InputError, path_of
from drake_exo.files.output import Progress, read_arrays
from drake_exo.nlp.ipopt import Iterate, Solution

CHECKPOINT = "checkpoint.npz"
_AFRESH = "start afresh without resume (--resume)"
REFINEMENTS = 5  # at most, counting the damping of alternating jerk
_AT_ONCE = 4.0  # parts at most into which an interval is split at once
_AIM = 0.5  # share of the tolerance to aim at: residuals move on a finer grid
_CHECKPOINT_SECONDS = 2.0
_SAME = 1e-6  # tolerance for bounds and costs, scaled, of another machine


class SolveWatch:
    """Progress lines and checkpoints of a solve.

    Args:
        title: beginning of every line.
        checkpoint: file that keeps the newest iterate, if any.
        fingerprint: identifies the problem in it; see `SparseProgram`.
    """

    def __init__(
        self,
        title: str,
        checkpoint: Path | None = None,
        fingerprint: tuple[str, np.ndarray] | None = None,
    ):
        self._progress = Progress(title)
        self._checkpoint = checkpoint
        self._fingerprint = fingerprint
        self._saved = -np.inf
        self._newest = None

    def __call__(self, iterate: Iterate) -> None:
        """Print progress and save; see `on_iterate` of `nlp.ipopt.solve`."""
        self._progress.update(
            f"iteration {iterate.iteration} ({iterate.strategy}), objective "
            f"{iterate.objective:.6g}, infeasibility "
            f"{iterate.infeasibility:.1e}"
        )
        now = time.monotonic()
        if self._checkpoint is None or iterate.x is None:
            return
        self._newest = iterate.x
        if now - self._saved < _CHECKPOINT_SECONDS:
            return
        self._saved = now
        self.save(iterate.x)

    def end(self, result: PhaseResult) -> None:
        """Save the solution, or the last iterate of a failed solve."""
        x = result.values if result.success else self._newest
        if x is not None:
            self.save(x)

    def save(self, x: np.ndarray) -> None:
        """Save program variables x as the checkpoint."""
        draft = self._checkpoint.with_name("checkpoint.tmp.npz")
        structure, values = self._fingerprint
        np.savez(draft, x=x, structure=structure, values=values)
        draft.replace(self._checkpoint)


def solve(
    pose: Callable[..., PhaseProblem],
    title: str,
    folder: str | Path | None = None,
    resume: bool = False,
    near: PhaseResult | None = None,
) -> PhaseResult:
    """Solve with progress, refining the grid until the audit holds.

    If laws or equations of motion do not hold between a trial's nodes, as while
    a foot comes down or lifts, the trial is solved again on a finer grid from
    the solution, at most `REFINEMENTS` times; the audit tells what is left.
    Jerk that alternates from node to node is damped first, on the same grid
    (`TrialProgram.damp`), since it fails everywhere. Lengths of successive
    intervals differ by at most a factor of two: the smoother they change, the
    less the change of length disturbs the solution.

    Args:
        pose: makes the phase with a refinement of its grids, see `refined` of
            `PhaseProblem`.
        title: beginning of every line of progress.
        folder: where checkpoint.npz is written while solving; it stays there
            until `forget`, since audits come before results are written. None
            keeps nothing.
        resume: start from the checkpoint found there, if there is one.
        near: start instead from this solution of a similar problem, on its
            grid.

    Returns:
        The result on the last grid that could be solved; if stopped, also on a
        finer grid, the iterate at which the solve was stopped.

    Raises:
        InputError: the checkpoint belongs to another problem, or is damaged;
            `resume` without a folder; or see `infeasibility.check`.
    """
    problem = pose(refined=near.problem.refined if near else {})
    result = _solve_first(problem, title, folder, resume, near)
    for _ in range(REFINEMENTS):
        refined = finer(result) if result.success else None
        if not refined:
            break
        problem = pose(refined=refined)
        nodes = sum(len(m.grid.times) for m in problem.movements)
        again = problem.solve(
            on_iterate=SolveWatch(f"{title}, {nodes} nodes"), near=result
        )
        add_up(again.solution, result.solution)
        if again.solution.was_stopped:
            return again
        if not again.success:
            break  # the coarser solution stands, and its audit says so
        result = again
    return result


def forget(folder: str | Path) -> None:
    """Remove the checkpoint of a solve whose results are written."""
    (Path(folder) / CHECKPOINT).unlink(missing_ok=True)


def add_up(solution: Solution, before: Solution) -> None:
    """Add iterations and seconds of the solve that this one started from."""
    solution.iterations += before.iterations
    for part, seconds in before.seconds.items():
        solution.seconds[part] = solution.seconds.get(part, 0.0) + seconds


def finer(result: PhaseResult) -> dict[str, np.ndarray]:
    """Trial -> parts of each interval on the next grid, see `PhaseProblem`.

    Split are intervals with residuals above half of the audit's tolerance, and
    their neighbours, since residuals move when the motion follows them better.

    Returns:
        All trials; empty if the audit holds. The grid is left as it is if
        alternating jerk has to be damped first.
    """
    problem, found, fails = result.problem, {}, False
    undamped = not problem.refined and any(
        m.may_alternate and m.is_tracked for m in problem.movements
    )
    for i, (trial, movement) in enumerate(
        zip(problem.trials, problem.movements, strict=True)
    ):
        force, moment = between_nodes(result, i)
        missed = np.maximum(force / FORCE_TOLERANCE, moment / MOMENT_TOLERANCE)
        fails |= bool(missed.max() > 1.0)
        parts = movement.grid.parts
        found[trial.name] = parts if undamped else split(parts, missed)
    return found if fails else {}


def split(parts: np.ndarray, missed: np.ndarray) -> np.ndarray:
    """Number of parts (m,) of m intervals, more where residuals are large.

    Args:
        parts: (m,) present number of parts of each interval.
        missed: (parts.sum(),) residual in each part, in units of the tolerance.
            An interval's number doubles above one half, quadruples above one.
    """
    starts = np.r_[0, np.cumsum(parts)[:-1]]
    worst = np.maximum.reduceat(missed, starts)
    # Halving is assumed to halve a residual at least.
    halvings = np.ceil(np.log2(np.clip(worst / _AIM, 1.0, _AT_ONCE)))
    new = np.where(worst > _AIM, parts * 2.0**halvings, 1.0)
    beside = np.pad(new, 1, constant_values=1.0)
    wanted = np.max([parts, new, beside[:-2], beside[2:]], axis=0)
    for near in (wanted, wanted[::-1]):  # in place, from either end
        for k in range(1, len(near)):
            near[k] = max(near[k], 0.5 * near[k - 1])
    return wanted.astype(int)


def _solve_first(
    problem: PhaseProblem,
    title: str,
    folder: str | Path | None,
    resume: bool,
    near: PhaseResult | None,
) -> PhaseResult:
    """Solve on the settings' grid, with a checkpoint in `folder`."""
    if folder is None:
        if resume:
            raise InputError("resume goes on from folder; give that, too")
        return problem.solve(on_iterate=SolveWatch(title), near=near)
    folder = path_of(folder, "folder")
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / CHECKPOINT
    fingerprint = problem.compiled.fingerprint()
    guess = None
    if resume and checkpoint.is_file():
        size = problem.program.prog.num_vars()
        guess = read_checkpoint(checkpoint, fingerprint, size)
        print(f"{title}: resumed from {CHECKPOINT}")
        near = None
    watch = SolveWatch(title, checkpoint, fingerprint)
    found = problem.solve(guess, watch, near)
    watch.end(found)
    return found


def read_checkpoint(
    path: Path, fingerprint: tuple[str, np.ndarray], size: int
) -> np.ndarray:
    """The iterate (size,) saved by a run with the same fingerprint.

    Raises:
        InputError: it is damaged, or of another problem.
    """
    arrays = read_arrays(path, _AFRESH)
    structure, values = fingerprint
    own = arrays.get("values")
    if (
        str(arrays.get("structure")) != structure
        or own is None
        or own.dtype != float
        or own.shape != values.shape
        or not np.allclose(own, values, _SAME, _SAME)
    ):
        raise InputError(
            f"{path}: is of another study or other settings; {_AFRESH}"
        )
    x = arrays.get("x")
    if (
        x is None
        or x.dtype != float
        or x.shape != (size,)
        or not np.isfinite(x).all()
    ):
        raise InputError(
            f"{path}: holds no iterate of {size} numbers; {_AFRESH}"
        )
    return x
