"""`drake-exo calibrate`: from a study file to calibrated contact."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from drake_exo.laboratory.opensim_files import write_table
from drake_exo.laboratory.tables import Table
from drake_exo.nlp.ipopt import Iterate
from drake_exo.output import Progress, prepare_output_folder, write_json
from drake_exo.phases import audit
from drake_exo.phases.calibration_inputs import load_inputs
from drake_exo.phases.foot_ground import FootGroundProblem
from drake_exo.phases.measured import MeasuredMovement
from drake_exo.phases.problem import PhaseResult, Trajectory
from drake_exo.phases.scores import rmsd, spread
from drake_exo.plant import COUPLED_COORDINATES
from drake_exo.report.phase_a_figures import (
    front_figure,
    ground_reaction_figure,
    kinematics_figure,
)
from drake_exo.report.tables import format_table, rmsd_table

_CHECKPOINT_SECONDS = 5.0


def add_parser(subparsers) -> None:
    """Add `calibrate` to the command line."""
    parser = subparsers.add_parser(
        "calibrate",
        help="calibrate contact models from a study's recordings",
        description=__doc__,
    )
    parser.add_argument("study", type=Path, metavar="STUDY.yaml")
    parser.add_argument(
        "--phase", choices=["foot-ground"], default="foot-ground"
    )
    parser.add_argument(
        "--data-root",
        type=Path,
        help="folder that the study's relative paths start from; by default "
        "the study file's own",
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--force", action="store_true", help="replace results in --out"
    )
    parser.add_argument(
        "--no-front",
        action="store_true",
        help="skip the Pareto front of kinematics against forces",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate, audit, and write everything to --out."""
    inputs = load_inputs(args.study, args.data_root)
    trials = inputs.trials
    with prepare_output_folder(args.out, args.force) as out:
        for trial in inputs.loaded:
            trial.save(out / f"measured_{trial.name}")
        problem = inputs.problem()
        watch = SolveWatch("calibrate foot-ground", out / "checkpoint.npz")
        result = problem.solve(on_iterate=watch)
        summary = _summary(result, trials)
        _write_trajectories(out, result.trajectories)
        _write_parameters(out, result)
        print(_parameters_text(result))
        text = rmsd_table(summary["rmsd"], spread(trials))
        (out / "rmsd.txt").write_text(text + "\n", encoding="utf-8")
        print(text)
        ground_reaction_figure(
            out / "ground_reaction.png", result.trajectories, trials
        )
        kinematics_figure(out / "kinematics.png", result.trajectories, trials)
        if not result.solution.success:
            write_json(out / "summary.json", summary)
            return _failed(result)
        summary["audit"] = _audit(inputs, result)
        if not args.no_front and inputs.settings.front:
            summary["front"] = _front(out, inputs, result)
        write_json(out / "summary.json", summary)
        (out / "checkpoint.npz").unlink(missing_ok=True)
    print(f"results in {args.out}")
    return 0


class SolveWatch:
    """Progress lines and checkpoints of a solve.

    Args:
        title: begins every line.
        checkpoint: file that keeps the newest iterate.
    """

    def __init__(self, title: str, checkpoint: Path):
        self._progress = Progress(title)
        self._checkpoint = checkpoint
        self._saved = time.monotonic()

    def __call__(self, iterate: Iterate) -> None:
        """See `nlp.ipopt.solve`."""
        self._progress.update(
            f"iteration {iterate.iteration}, objective "
            f"{iterate.objective:.6g}, infeasibility "
            f"{iterate.infeasibility:.1e}"
        )
        now = time.monotonic()
        if iterate.x is None or now - self._saved < _CHECKPOINT_SECONDS:
            return
        self._saved = now
        draft = self._checkpoint.with_name("checkpoint.tmp.npz")
        np.savez(draft, x=iterate.x)
        draft.replace(self._checkpoint)


def _failed(result: PhaseResult) -> int:
    solution = result.solution
    print(
        f"not solved: {solution.status} after {solution.iterations} "
        f"iterations. {solution.explain()} What was reached so far is "
        "written, marked as failed."
    )
    return 130 if solution.status == "stopped by the user" else 1


def _summary(result: PhaseResult, trials: list[MeasuredMovement]) -> dict:
    solution = result.solution
    return {
        "phase": "foot-ground",
        "success": solution.success,
        "status": solution.status,
        "strategy": solution.strategy,
        "iterations": solution.iterations,
        "objective": solution.objective,
        "infeasibility": solution.infeasibility,
        "worst_constraints": solution.worst_constraints,
        "build_seconds": solution.seconds["build"],
        "solve_seconds": solution.seconds["solve"],
        "part_seconds": solution.seconds,
        "evaluations": solution.evaluations,
        "num_variables": solution.num_variables,
        "num_constraints": solution.num_constraints,
        "jacobian_nonzeros": solution.jacobian_nonzeros,
        "settings": asdict(result.settings),
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "value": p.nominal,
                "lower": p.lower,
                "upper": p.upper,
                "free": p.free,
                "at_bound": p.free and p.at_bound(p.nominal),
            }
            for p in result.parameters
        ],
        "rmsd": [
            rmsd(found, trial)
            for found, trial in zip(result.trajectories, trials, strict=True)
        ],
        "measured_sd": spread(trials),
    }


def _parameters_text(result: PhaseResult) -> str:
    rows = [
        [
            p.name,
            f"{p.nominal:.4g}",
            f"{p.lower:.3g}",
            f"{p.upper:.3g}",
            p.unit,
            ("at bound" if p.at_bound(p.nominal) else "")
            if p.free
            else "fixed",
        ]
        for p in result.parameters
    ]
    return format_table(
        ["parameter", "value", "lower", "upper", "unit", ""], rows
    )


def _write_parameters(out: Path, result: PhaseResult) -> None:
    write_json(
        out / "parameters.json",
        {
            "law": result.settings.law,
            "constants": asdict(result.settings.law_constants()),
            "parameters": {p.name: p.nominal for p in result.parameters},
            "units": {p.name: p.unit for p in result.parameters},
        },
    )


def _write_trajectories(out: Path, trajectories: list[Trajectory]) -> None:
    """Coordinates, ground reaction and torques as OpenSim reads them."""
    for t in trajectories:
        names = COUPLED_COORDINATES[: t.q.shape[1]]
        degrees = np.hstack([t.q[:, :2], np.rad2deg(t.q[:, 2:])])
        write_table(
            out / f"{t.name}_coordinates.sto",
            Table(t.times, names, degrees, in_degrees=True),
            "Coordinates",
        )
        cop = np.nan_to_num(t.cop_x)
        zero = np.zeros(len(t.times))
        force = np.column_stack(
            [t.ground[:, 0], t.ground[:, 1], zero, cop, *[zero] * 5]
        )
        columns = [f"ground_force_{k}{a}" for k in "vp" for a in "xyz"]
        columns += [f"ground_torque_{a}" for a in "xyz"]
        write_table(
            out / f"{t.name}_ground_reaction.sto",
            Table(t.times, tuple(columns), force, in_degrees=False),
            "Ground reaction",
        )
        write_table(
            out / f"{t.name}_torques.sto",
            Table(
                t.times,
                tuple(f"{n}_moment" for n in names[3:]),
                t.torque,
                in_degrees=False,
            ),
            "Joint moments",
        )


def _audit(inputs, result: PhaseResult) -> list[dict]:
    rows = []
    progress = Progress("simulate", total=len(result.trajectories))
    for i, found in enumerate(result.trajectories):
        residuals = audit.between_nodes(inputs.tree, result, found)
        simulated = audit.simulate(
            *inputs.model, inputs.study.gravity_m_s2, result, found
        )
        checked = audit.compare(found, simulated, residuals)
        progress.update(found.name, done=i + 1)
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
    ]
    print(
        format_table(
            header,
            [
                [
                    r["trial"],
                    r["force_n"],
                    r["moment_nm"],
                    *r["simulated_grf_n"],
                    r["simulated_angles_deg"],
                ]
                for r in rows
            ],
        )
    )
    return rows


def _front(out, inputs, result) -> list[dict]:
    """Kinematics against forces: the noise of forces scaled by factors."""
    settings = result.settings
    rows = []
    factors = sorted({1.0, *settings.front})
    progress = Progress("front", total=len(factors))
    for i, factor in enumerate(factors):
        found = result
        if factor != 1.0:
            noise = replace(
                settings.noise,
                force_n=factor * settings.noise.force_n,
                cop_m=factor * settings.noise.cop_m,
            )
            found = FootGroundProblem(
                inputs.tree,
                inputs.trials,
                inputs.parameters,
                replace(settings, noise=noise),
            ).solve()
        rows.append(_front_row(factor, found, inputs.trials))
        progress.update(f"factor {factor:g}", done=i + 1)
    header = [
        "noise of forces ×",
        "angles [deg]",
        "worst",
        "velocities [deg/s]",
        "worst",
        "GRF [N]",
        "worst",
        "CoP [mm]",
        "worst",
    ]
    keys = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")
    print("Pareto front of kinematics against forces")
    print(
        format_table(
            header,
            [
                [
                    f"{r['factor']:g}" + ("" if r["success"] else " (failed)"),
                    *(r[k + e] for k in keys for e in ("", "_worst")),
                ]
                for r in rows
            ],
        )
    )
    front_figure(out / "front.png", rows)
    return rows


def _front_row(factor, found, trials) -> dict:
    scores = [
        rmsd(t, trial)
        for t, trial in zip(found.trajectories, trials, strict=True)
    ]
    row = {"factor": factor, "success": found.solution.success}
    for key in ("angles_deg", "velocities_deg_s", "grf_n"):
        values = [v for s in scores for v in s[key].values()]
        row[key] = float(np.mean(values))
        row[key + "_worst"] = float(np.max(values))
    cop = [s["cop_mm"] for s in scores]
    row["cop_mm"], row["cop_mm_worst"] = float(np.mean(cop)), max(cop)
    return row
