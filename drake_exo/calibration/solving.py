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
from drake_exo.calibration.problem import PhaseProblem, PhaseResult
from drake_exo.errors import InputError
from drake_exo.files.output import Progress, read_arrays
from drake_exo.nlp.ipopt import Iterate, Solution

CHECKPOINT = "checkpoint.npz"
REFINEMENTS = 2
_CHECKPOINT_SECONDS = 2.0


class SolveWatch:
    """Progress lines and checkpoints of a solve.

    Args:
        title: begins every line.
        checkpoint: file that keeps the newest iterate, if any.
        fingerprint: of the problem, kept with it.
    """

    def __init__(
        self,
        title: str,
        checkpoint: Path | None = None,
        fingerprint: str = "",
    ):
        self._progress = Progress(title)
        self._checkpoint = checkpoint
        self._fingerprint = fingerprint
        self._saved = -np.inf

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
        if now - self._saved < _CHECKPOINT_SECONDS:
            return
        self._saved = now
        draft = self._checkpoint.with_name("checkpoint.tmp.npz")
        np.savez(draft, x=iterate.x, fingerprint=self._fingerprint)
        draft.replace(self._checkpoint)


def solve(
    pose: Callable[[Mapping[str, int]], PhaseProblem],
    title: str,
    folder: str | Path | None = None,
    resume: bool = False,
    near: PhaseResult | None = None,
) -> PhaseResult:
    """Solve with progress, on a grid on which the audit holds.

    A trial whose laws or equations of motion do not hold between its nodes
    gets a grid twice as fine, started from the solution, `REFINEMENTS` times
    at most; what then does not hold, the audit says. Its whole grid, because
    a step that changes within a trial sets off an oscillation from node to
    node that a quartic spline does not damp.

    Args:
        pose: makes the phase with grids as fine as it is told, see
            `PhaseProblem`.
        title: begins every line of progress.
        folder: where checkpoint.npz is written while solving; it stays there
            if the solve does not succeed. None keeps nothing.
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
        names = ", ".join(refined)
        again = pose(refined).solve(
            on_iterate=SolveWatch(f"{title}, finer grid for {names}"),
            near=result,
        )
        _add_up(again.solution, result.solution)
        if again.solution.was_stopped:
            return again
        if not again.success:
            break  # the coarser solution stands, and its audit says so
        result = again
    if folder is not None and result.success:
        (Path(folder) / CHECKPOINT).unlink(missing_ok=True)
    return result


def _add_up(solution: Solution, before: Solution) -> None:
    """Iterations and seconds of a solve and of the one it started from."""
    solution.iterations += before.iterations
    for part, seconds in before.seconds.items():
        solution.seconds[part] = solution.seconds.get(part, 0.0) + seconds


def finer(result: PhaseResult) -> dict[str, int]:
    """How fine each trial's grid is to be; empty where the audit holds."""
    refined, fails = dict(result.problem.refined), False
    for i, trial in enumerate(result.problem.trials):
        force, moment = between_nodes(result, i)
        if force.max() > FORCE_TOLERANCE or moment.max() > MOMENT_TOLERANCE:
            refined[trial.name] = 2 * refined.get(trial.name, 1)
            fails = True
    return refined if fails else {}


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
    folder = Path(folder)
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
    return problem.solve(guess, watch, near)


def read_checkpoint(path: Path, fingerprint: str, size: int) -> np.ndarray:
    """The iterate (size,) that a run with the same fingerprint left.

    Raises:
        InputError: it is damaged, or of another problem.
    """
    arrays = read_arrays(path, "leave out --resume to start afresh")
    if str(arrays.get("fingerprint")) != fingerprint:
        raise InputError(
            f"{path}: is of another study or other settings; leave out "
            "--resume to start afresh"
        )
    x = arrays.get("x")
    if (
        x is None
        or x.dtype != float
        or x.shape != (size,)
        or not np.isfinite(x).all()
    ):
        raise InputError(
            f"{path}: holds no iterate of {size} numbers; leave out --resume "
            "to start afresh"
        )
    return x
