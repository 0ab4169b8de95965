"""Solving a phase as a command does: progress, checkpoints, resuming."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from drake_exo.calibration.audit import (
    FORCE_TOLERANCE,
    MOMENT_TOLERANCE,
    between_nodes,
)
from drake_exo.calibration.problem import Parts, PhaseProblem, PhaseResult
from drake_exo.errors import InputError, path_of
from drake_exo.files.output import Progress, read_arrays
from drake_exo.nlp.ipopt import Iterate, Solution

CHECKPOINT = "checkpoint.npz"
_AFRESH = "start afresh without resume (--resume)"
REFINEMENTS = 5  # with the damping of what alternates
_AT_ONCE = 4.0  # parts of an interval
_AIM = 0.5  # of what is allowed: a finer grid misses elsewhere
_CHECKPOINT_SECONDS = 2.0
_SAME = 1e-6  # of bounds and costs, scaled: another machine, the same study


class SolveWatch:
    """Progress lines and checkpoints of a solve.

    Args:
        title: begins every line.
        checkpoint: file that keeps the newest iterate, if any.
        fingerprint: of the problem, kept with it; see `SparseProgram`.
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
        """See `nlp.ipopt.solve`."""
        self._progress.update(
            f"{iterate.strategy} iteration {iterate.iteration}, objective "
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
        """Keep what was found, or where a solve without success ended."""
        x = result.values if result.success else self._newest
        if x is not None:
            self.save(x)

    def save(self, x: np.ndarray) -> None:
        """Keep program variables as the checkpoint."""
        draft = self._checkpoint.with_name("checkpoint.tmp.npz")
        structure, values = self._fingerprint
        np.savez(draft, x=x, structure=structure, values=values)
        draft.replace(self._checkpoint)


def solve(
    pose: Callable[[Mapping[str, Parts]], PhaseProblem],
    title: str,
    folder: str | Path | None = None,
    resume: bool = False,
    near: PhaseResult | None = None,
) -> PhaseResult:
    """Solve with progress, on a grid on which the audit holds.

    Where a trial's laws or equations of motion do not hold between its nodes,
    as while a foot comes down or lifts, it gets a finer grid, started from the
    solution, `REFINEMENTS` times at most; what then does not hold, the audit
    says. What alternates from node to node is damped before, on the same grid
    (`TrialProgram.damp`): it would fail everywhere. From interval to interval
    lengths change by a factor of two at most, since what a step that changes
    sets off is the smaller the smoother it changes.

    Args:
        pose: makes the phase with grids as fine as it is told, see
            `PhaseProblem`.
        title: begins every line of progress.
        folder: where checkpoint.npz is written while solving; it stays there
            until `forget`, since audits come before results are written. None
            keeps nothing.
        resume: start from the checkpoint found there, if there is one.
        near: start from this solution of a problem like it instead, on its
            grid.

    Returns:
        What was found; of a stopped solve, also on a finer grid, what it was
        stopped at.

    Raises:
        InputError: the checkpoint belongs to another problem, or is damaged;
            or from the pre-flight check.
    """
    problem = pose(near.problem.refined if near else {})
    result = _solve_first(problem, title, folder, resume, near)
    for _ in range(REFINEMENTS):
        refined = finer(result) if result.success else None
        if not refined:
            break
        problem = pose(refined)
        nodes = sum(len(m.grid.times) for m in problem.movements)
        again = problem.solve(
            on_iterate=SolveWatch(f"{title}, {nodes} nodes"), near=result
        )
        _add_up(again.solution, result.solution)
        if again.solution.was_stopped:
            return again
        if not again.success:
            break  # the coarser solution stands, and its audit says so
        result = again
    return result


def forget(folder: str | Path) -> None:
    """Remove the checkpoint of a solve whose results are written."""
    (Path(folder) / CHECKPOINT).unlink(missing_ok=True)


def _add_up(solution: Solution, before: Solution) -> None:
    """Iterations and seconds of a solve and of the one it started from."""
    solution.iterations += before.iterations
    for part, seconds in before.seconds.items():
        solution.seconds[part] = solution.seconds.get(part, 0.0) + seconds


def finer(result: PhaseResult) -> dict[str, np.ndarray]:
    """Into how many parts intervals are to be split, see `PhaseProblem`.

    Those that miss more than half of what the audit allows, and their
    neighbours, since what sets them off moves as it is followed.

    Returns:
        Of every trial; empty where the audit holds. All 1 for what is damped
        first.
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
    """Finer parts (m,) of m intervals where too much is missed.

    Args:
        parts: (m,) that each has now.
        missed: (parts.sum(),) by these, in units of what is allowed. An
            interval that misses more than half is halved until it should not.
    """
    starts = np.r_[0, np.cumsum(parts)[:-1]]
    worst = np.maximum.reduceat(missed, starts)
    # What is halved misses half at least.
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
    """On the grid of the settings; the newest iterate is kept in `folder`."""
    if folder is None:
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
    """The iterate (size,) that a run with the same fingerprint left.

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
