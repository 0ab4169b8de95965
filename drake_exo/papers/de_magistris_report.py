"""Pictures and finite-strain table of a study from its folders.

`drake-exo sole report` draws them again without optimising again.
"""

from pathlib import Path

import numpy as np

from drake_exo.cli.sole_arguments import (
    add_source_arguments,
    prepare_out_or_source,
)
from drake_exo.cli.sole_strain import KEY
from drake_exo.soles.mesh import read_mesh
from drake_exo.soles.optimize.design_folder import (
    StoredDesign,
    find_designs,
    read_steps,
)
from drake_exo.soles.step import strain_report
from drake_exo.soles.step.stiffness import heel_strike_count

_FIRST = "soles.png"


def add_parser(jobs) -> None:
    """Add `report` to the jobs of `drake-exo sole`."""
    parser = jobs.add_parser(
        "report", help="draw the pictures of a study or a design again"
    )
    add_source_arguments(parser, "folder of 'sole optimize' or 'sole study'")
    parser.set_defaults(run=run_report)


def run_report(args) -> int:
    """Draw and print."""
    designs = find_designs(args.source)
    with prepare_out_or_source(args, _FIRST) as out:
        text = write(out, designs)
    if text:
        print(text)
    print(f"pictures in {args.out or args.source}")
    return 0


def finish(folder: Path) -> str:
    """Report of a study into its own folder; the finite-strain table."""
    return write(folder, find_designs(folder))


def write(out: Path, designs: list[StoredDesign]) -> str:
    """soles.png, stiffness.png, histories.png, finite_strain.csv and .txt.

    Returns:
        The finite-strain table, empty where no design has one.
    """
    from drake_exo.papers import de_magistris_pictures as study_pictures

    study_pictures.soles_figure(out / _FIRST, [_drawn(d) for d in designs])
    if len(designs) > 1:  # a design has a picture of its own stiffness
        _draw_stiffness(out / "stiffness.png", designs)
    study_pictures.histories_figure(
        out / "histories.png", {d.name: _trace(d.folder) for d in designs}
    )
    found = {d.name: d.summary().get(KEY) or {} for d in designs}
    found = {
        name: strain_report.from_json(f)
        for name, f in found.items()
        if "samples" in f
    }
    return strain_report.write_table(out, found) if found else ""


def _draw_stiffness(path: Path, designs: list[StoredDesign]) -> None:
    from drake_exo.papers.de_magistris_pictures import stiffness_figure

    curves = {
        d.name: {
            "initial": read_steps(d.folder / "initial_steps.csv"),
            "optimised": read_steps(d.folder / "steps.csv"),
        }
        for d in designs
    }
    first = designs[0]
    strike = heel_strike_count(
        len(first.load.times), first.case.cost.heel_strike_fraction
    )
    stiffness_figure(path, curves, strike)


def _trace(folder: Path) -> np.ndarray:
    """Rows (stage, iteration, cost, violation, dual infeasibility)."""
    columns = read_steps(folder / "history.csv")
    return np.stack(list(columns.values()), axis=1)


def _drawn(design: StoredDesign):
    from drake_exo.papers.de_magistris_pictures import DrawnSole, radial_change

    row = design.summary()
    caption = (
        f"c_tr × {row['ratio_tr']:.3f}, c_rot × {row['ratio_rot']:.3f}, "
        f"{row['volume_cm3']:.0f} cm³, "
        f"{'stable' if row['stable'] else 'not stable'}, "
        f"tilt up to {row['tilt_max_deg']:.0f}°"
    )
    initial = read_mesh(design.folder / "initial.vtk", (0.0, 0.0, 0.0))
    change = radial_change(design.mesh, *design.shape())
    return DrawnSole(design.name, caption, initial, design.mesh, change)
