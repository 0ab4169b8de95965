"""The command `drake-exo sole`: simulate a sole through a step."""

import os
import time
from pathlib import Path

# Before numpy loads its BLAS: matrices here are small, and two threads are
# slower than one wherever the cores have other work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drake_exo.cli import sole_strain as strain_command
from drake_exo.cli.sole_arguments import (
    add_common_arguments,
    add_iterations_argument,
    add_limits_argument,
)
from drake_exo.files.output import Progress, prepare_output_folder, write_json
from drake_exo.papers import de_magistris_report as study_report
from drake_exo.soles import results
from drake_exo.soles.case import open_case
from drake_exo.soles.contact.newton import ContactSolver
from drake_exo.soles.step.simulation import simulate
from drake_exo.soles.step.stiffness import heel_strike_count


def add_parser(subparsers) -> None:
    """Offer `sole simulate` to the command line."""
    sole = subparsers.add_parser(
        "sole", help="simulate and optimise compliant soles"
    )
    jobs = sole.add_subparsers(dest="job", required=True)
    parser = jobs.add_parser(
        "simulate", help="simulate a sole through one contact phase"
    )
    parser.add_argument("case", type=Path, metavar="CASE.yaml")
    add_common_arguments(parser)
    parser.set_defaults(run=run_simulate)
    parser = jobs.add_parser("optimize", help="find the best shape for a case")
    parser.add_argument("case", type=Path, metavar="CASE.yaml")
    add_common_arguments(parser)
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="DIR",
        help="go on from the checkpoint in this folder of an earlier run",
    )
    add_limits_argument(parser, ("all", "none"))
    add_iterations_argument(parser)
    parser.set_defaults(run=_run_optimize)
    parser = jobs.add_parser("study", help="the paper's five cases (Table 2)")
    parser.add_argument(
        "--coarse", action="store_true", help="two coarse stages, two minutes"
    )
    add_limits_argument(parser, ("all", "none", "both"))
    add_iterations_argument(parser)
    parser.add_argument(
        "--front",
        action="store_true",
        help="also the front of c_tr against c_rot, coarse",
    )
    parser.add_argument(
        "--jobs", type=int, default=2, help="processes at a time (default: 2)"
    )
    add_common_arguments(parser)
    parser.set_defaults(run=_run_study)
    parser = jobs.add_parser("front", help="front of c_tr against c_rot")
    parser.add_argument("case", type=Path, metavar="CASE.yaml")
    add_limits_argument(parser, ("all", "none"))
    add_common_arguments(parser)
    parser.set_defaults(run=_run_front)
    for job in (strain_command, study_report):
        job.add_parser(jobs)


def _run_optimize(args) -> int:
    from drake_exo.cli.sole_optimize import run_optimize

    return run_optimize(args)


def _run_study(args) -> int:
    from drake_exo.papers.de_magistris import run_study

    return run_study(args)


def _run_front(args) -> int:
    from drake_exo.soles.optimize.pareto import run_front

    return run_front(args)


def run_simulate(args) -> int:
    """Simulate one case; 0 if every step converged, else 1."""
    clock = _Clock()
    case, load, mesh, start = open_case(args.case, args.data_root, args.mesh)
    clock.lap("mesh")
    folder = prepare_output_folder(args.out, args.force)
    sole = case.sole(mesh)
    sole.compliance  # noqa: B018 - computed here, so that it is timed apart
    law = case.law(sole)
    clock.lap("condensation")
    with folder as out:
        history = run_history(case, sole, law, start, load)
        clock.lap("simulation")
        write_results(out, case, sole, law, start, load, history, clock)
    return report(case.name, args.out, history, case)


def run_history(case, sole, law, start, load):
    """Simulate with progress on the terminal."""
    solver = ContactSolver(sole.compliance, sole.positions, law)
    if case.contact.method == "gauss_seidel":
        from drake_exo.soles.contact.gauss_seidel import GaussSeidelSolver

        solver = GaussSeidelSolver(sole.compliance, sole.positions, law)
    progress = Progress(case.name, len(load.times), interval_seconds=2.0)
    return simulate(
        solver,
        load.force,
        load.zmp,
        start,
        progress=lambda done, _: progress.update("samples", done),
    )


def write_results(
    out: Path, case, sole, law, start, load, history, clock
) -> None:
    """Tables, arrays, pictures, animation and, last, summary.json."""
    numbers = results.summary(case, sole, history)
    numbers["complementarity"] = results.complementarity(
        history, law, start, sole.positions
    )
    if load.free_moment is not None:
        numbers["measured_free_moment_nm"] = {
            "mean": float(load.free_moment.mean()),
            "largest": float(np.abs(load.free_moment).max()),
            "simulated": 0.0,
        }
    columns = results.step_table(load, history)
    results.write_csv(out / "steps.csv", columns)
    results.write_history(out / "history.npz", sole.mesh, load, history)
    clock.lap("tables")
    draw(out, case, sole, load, history, {case.name: columns})
    clock.lap("pictures")
    numbers.update(clock.seconds)
    write_json(out / "summary.json", numbers)


def draw(out: Path, case, sole, load, history, tables: dict) -> None:
    """All pictures and the animation of one simulation.

    Args:
        tables: Label -> step table of the soles whose stiffness is drawn;
            the last is this simulation's.
    """
    # Imported here: matplotlib and meshcat are of no use to a failing case.
    from drake_exo.soles import pictures
    from drake_exo.soles.animation import SoleMotion, write_animation

    mesh, areas = sole.mesh, results.nodal_areas(sole.mesh)
    count = heel_strike_count(len(load.times), case.cost.heel_strike_fraction)
    pictures.load_figure(out / "load.png", load, mesh)
    curves = {
        label: (
            load.times,
            table["sigma_max_tr_n_per_m"],
            table["sigma_min_rot_nm_per_rad"],
        )
        for label, table in tables.items()
    }
    pictures.stiffness_figure(
        out / "stiffness.png", curves, load.times[count - 1]
    )
    pictures.pose_figure(out / "pose.png", list(tables.values())[-1])
    pictures.pressure_figure(out / "pressure.png", mesh, load, history, areas)
    motion = SoleMotion.of(case.name, mesh, load, history)
    if motion is not None:
        write_animation(out / "animation.html", [motion], case.name)


def report(name: str, out: Path, history, case) -> int:
    """Print the outcome; the exit code."""
    cost = case.cost
    c_tr, c_rot, c = history.costs(cost.weight, cost.heel_strike_fraction)
    print(
        f"{name}: c_tr {c_tr:.4g} N/m, c_rot {c_rot:.4g} N·m/rad, "
        f"c {c:.4g}, {len(history.reports)} steps"
    )
    bad = np.flatnonzero(~history.converged)
    for q in bad[:5]:
        print(f"{name}: step {q} failed: {history.reports[q].message}")
    if len(bad):
        print(f"{name}: {len(bad)} steps failed")
    print(f"{name}: results in {out}")
    return 1 if len(bad) else 0


class _Clock:
    """Seconds of each part of a run."""

    def __init__(self):
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, part: str) -> None:
        """Seconds since the last lap belong to `part`."""
        now = time.perf_counter()
        self.seconds[f"{part}_seconds"] = round(now - self._last, 4)
        self._last = now
