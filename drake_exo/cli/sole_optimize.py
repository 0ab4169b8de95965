"""The command `drake-exo sole optimize`: the best shape for a case."""

import time
from pathlib import Path

from drake_exo.cli.sole_strain import judge_in_finite_strain
from drake_exo.files.output import Progress, prepare_output_folder, write_json
from drake_exo.soles.case import open_case
from drake_exo.soles.mesh import write_stl
from drake_exo.soles.mould import write_mould
from drake_exo.soles.optimize import design as designs
from drake_exo.soles.optimize import verification as judgement
from drake_exo.soles.optimize.checkpoint import read_checkpoint
from drake_exo.soles.optimize.design_folder import DESIGN


def run_optimize(args) -> int:
    """Optimise one case; 0 where the final design simulates throughout."""
    case, load, mesh, start = open_case(args.case, args.data_root, args.mesh)
    if args.mesh is not None:
        case = designs.finish_on_own_mesh(case)
    if args.limits == "none":
        case = designs.without_limits(case)
    case = designs.with_iterations(case, args.iterations)
    resume = read_checkpoint(args.resume) if args.resume else None
    with prepare_output_folder(args.out, args.force) as out:
        row = optimise_case(out, case, mesh, load, start, resume)
    print_row(row)
    print(f"{case.name}: results in {args.out}")
    return 1 if row["failed_steps"] else 0


def optimise_case(out: Path, case, mesh, load, start, resume=None) -> dict:
    """Optimise, judge and write one case into a folder; its summary."""
    began = time.perf_counter()
    progress = Progress(case.name, interval_seconds=2.0)
    design = designs.optimise(
        case, mesh, load, start, out, progress.update, resume
    )
    row = judgement.design_summary(case, design)
    row["finer"] = judgement.finer_check(case, mesh, load, start, design)
    row["seconds"] = round(time.perf_counter() - began, 2)
    row["stages_seconds"] = [round(s, 2) for s in design.seconds]
    write_design(out, case, load, design)
    row["finite_strain"] = judge_in_finite_strain(
        out, case, design.mesh, load, start
    )
    write_json(out / "summary.json", row)
    return row


def write_design(out: Path, case, load, design) -> None:
    """Coefficients, mesh, STL, pictures and animation of a design."""
    from drake_exo.cli import sole as command
    from drake_exo.papers import de_magistris_pictures as design_pictures
    from drake_exo.papers.de_magistris_pictures import (
        DrawnSole,
        radial_change,
        soles_figure,
    )
    from drake_exo.soles import results
    from drake_exo.soles.replay import FIRST_HISTORY, HISTORY

    spline = design.problem.spline
    write_json(
        out / DESIGN,
        {
            "intervals": spline.intervals,
            "fixed_top": spline.fixed_top,
            "coefficients": design.p,
            "stage": len(case.optimize.stages),
        },
    )
    write_stl(out / "sole.stl", design.mesh)
    write_mould(out / "mould.stl", design.mesh)
    _write_mesh(out / "sole.vtk", design.mesh)
    _write_mesh(out / "initial.vtk", design.first_sole.mesh)
    columns = results.step_table(load, design.history)
    results.write_csv(out / "steps.csv", columns)
    for name, sole, history in (
        (HISTORY, design.sole, design.history),
        (FIRST_HISTORY, design.first_sole, design.first_history),
    ):
        results.write_history(out / name, sole.mesh, load, history)
    before = results.step_table(load, design.first_history)
    results.write_csv(out / "initial_steps.csv", before)
    tables = {"initial": before, "optimised": columns}
    command.draw(out, case, design.sole, load, design.history, tables)
    caption = f"{1e6 * design.mesh.volume:.0f} cm³"
    drawn = DrawnSole(
        case.name, caption, design.first_sole.mesh, design.mesh,
        radial_change(design.mesh, spline, design.p),
    )  # fmt: skip
    soles_figure(out / "shape.png", [drawn])
    design_pictures.write_traces(out / "history.csv", design.optima)
    design_pictures.trace_figure(out / "history.png", design.optima)


def _write_mesh(path: Path, mesh) -> None:
    import meshio

    meshio.Mesh(mesh.nodes, [("tetra", mesh.tets)]).write(path)


def print_row(row: dict) -> None:
    """One line on a finished case."""
    print(
        f"{row['name']}: c_tr {row['c_tr']:.3g} (×{row['ratio_tr']:.3f}), "
        f"c_rot {row['c_rot']:.3g} (×{row['ratio_rot']:.3f}), "
        f"{row['volume_cm3']:.0f} cm³, "
        f"{'optimal' if row['optimal'] else row.get('status', '')}, "
        f"{'stable' if row['stable'] else 'unstable'}, largest strain "
        f"{row['max_strain']:.2f}, {row['seconds']:.0f} s"
    )
