"""The command `drake-exo sole strain`: designs in finite strain."""

import time
from pathlib import Path

from drake_exo.cli.sole_arguments import (
    add_case_arguments,
    add_source_arguments,
    prepare_out_or_source,
)
from drake_exo.errors import InputError
from drake_exo.files.output import Progress, write_json
from drake_exo.soles.case import Case, open_case
from drake_exo.soles.contact.newton import Start
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.optimize.design_folder import (
    SUMMARY,
    StoredDesign,
    find_designs,
    read_summary,
    write_case,
)
from drake_exo.soles.step import strain_report

KEY = "finite_strain"


def add_parser(jobs) -> None:
    """Add `strain` to the jobs of `drake-exo sole`."""
    parser = jobs.add_parser(
        "strain",
        help="heel strike of designs in finite strain, beside small strain",
    )
    add_source_arguments(
        parser, "folder of 'sole optimize' or 'sole study', or a case file"
    )
    add_case_arguments(parser)
    parser.set_defaults(run=run_strain)


def run_strain(args) -> int:
    """Write and print the table; 1 where some sample has no equilibrium."""
    if args.source.is_dir():
        designs = find_designs(args.source)
    else:
        designs = [_from_case(args)]
        if args.out is None:
            raise InputError("sole strain: give --out with a case file")
    place = prepare_out_or_source(args, strain_report.TABLE)
    with place as out:
        found = {design.name: of_design(design) for design in designs}
        print(strain_report.write_table(out, found))
        _note(out, found)
    print(f"results in {args.out or args.source}")
    return 1 if any(sole["failures"] for sole in found.values()) else 0


def of_design(design: StoredDesign) -> dict:
    """Compare small and finite strain of one design, with progress."""
    progress = Progress(f"{design.name}, finite strain", interval_seconds=2.0)
    return strain_report.compare(
        design.sole,
        design.case.contact.friction,
        design.load,
        design.start,
        design.case.cost.heel_strike_fraction,
        lambda done, count: progress.update(f"of {count} samples", done),
    )


def judge_in_finite_strain(
    out: Path, case: Case, mesh: TetMesh, load: Load, start: Start
) -> dict:
    """Write a design's case, compare both strains, write their table.

    Returns:
        As `strain_report.compare`, with its `solve_seconds`.
    """
    case = write_case(out, case, start)
    if case.mesh.element != "linear":
        return {"left_out": "finite strain is for linear elements"}
    began = time.perf_counter()
    design = StoredDesign(out, case, mesh, load)
    found = of_design(design)
    strain_report.write_table(out, {design.name: found})
    found["solve_seconds"] = round(time.perf_counter() - began, 2)
    return found


def _from_case(args) -> StoredDesign:
    case, load, mesh, _ = open_case(args.source, args.data_root, args.mesh)
    return StoredDesign(args.source.parent, case, mesh, load)


def _note(out: Path, found: dict[str, dict]) -> None:
    """Put the figures into the summary, new or already there."""
    summary = read_summary(out) if (out / SUMMARY).is_file() else {}
    if "cases" in summary:
        for row in summary["cases"]:
            row[KEY] = found.get(row["name"], row.get(KEY))
    elif len(found) == 1 and summary:
        summary[KEY] = next(iter(found.values()))
    else:
        summary["cases"] = [{"name": n, KEY: f} for n, f in found.items()]
    write_json(out / SUMMARY, summary)
