"""Audit of all trials of a command, as a table and for summary.json."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from drake_exo.output import Progress
from drake_exo.phases import audit
from drake_exo.phases.problem import PhaseProblem, PhaseResult
from drake_exo.report.tables import format_table


def audit_trials(
    model: tuple,
    gravity: float,
    solved: Sequence[tuple[PhaseProblem, PhaseResult]],
) -> list[dict]:
    """Look between the nodes and simulate; prints a table.

    Args:
        model: kind, human, exoskeleton.
        gravity: [m/s^2].
        solved: problems with their results, one or more trials each.

    Returns:
        One row for each trial, see `audit.Audit`.
    """
    pairs = [
        (problem, result, i)
        for problem, result in solved
        for i in range(len(result.trajectories))
    ]
    rows = []
    progress = Progress("simulate", total=len(pairs))
    for k, (problem, result, i) in enumerate(pairs):
        found = result.trajectories[i]
        residuals = audit.between_nodes(problem, result, i)
        simulated = audit.simulate(*model, gravity, problem, result, i)
        checked = audit.compare(found, simulated, residuals)
        progress.update(found.name, done=k + 1)
        rows.append(
            {"trial": found.name, "holds": checked.holds, **asdict(checked)}
        )
    header = [
        "audit",
        "between nodes [N]",
        "[N m]",
        "simulated F_x [N]",
        "F_z [N]",
        "angles [deg]",
        "interaction [N]",
    ]
    table = [
        [
            r["trial"],
            r["force_n"],
            r["moment_nm"],
            *r["simulated_grf_n"],
            r["simulated_angles_deg"],
            r["simulated_interaction_n"],
        ]
        for r in rows
    ]
    print(format_table(header, table))
    return rows
