"""The five cases of the paper on soft soles: study, tables and figures.

De Magistris, Miossec, Escande and Kheddar, Design of optimized soft soles for
humanoid robots. Its Table 2 is compared with our optima.
"""

import html
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.output import (
    Check,
    Verdict,
    embedded,
    joined_mark,
    read_json,
    save_figure,
    stored,
    stored_mark,
    write_json,
    write_text,
)
from drake_exo.files.tables import read_text
from drake_exo.jobs.engine import (
    BatchProgress,
    Ended,
    Job,
    Processes,
    logged,
    run_jobs,
)
from drake_exo.soles import finite_strain
from drake_exo.soles.case import Case
from drake_exo.soles.load_blocks import LoadBlock, OneFoot
from drake_exo.soles.loads import read_columns
from drake_exo.soles.mesh import read_mesh
from drake_exo.soles.optimize.files import (
    SUMMARY,
    StoredDesign,
    kept_file,
    read_summary,
)
from drake_exo.soles.optimize.search import (
    finished,
    front_checks,
    pareto_front,
    search_jobs,
)
from drake_exo.soles.results import strikes
from drake_exo.soles.settings import (
    STAGES,
    Brick,
    ContactBlock,
    CostBlock,
    MaterialBlock,
    MeshBlock,
    OptimizeBlock,
    Settings,
    Stage,
    StartBlock,
)
from drake_exo.soles.walking_pattern import Robot

SIZE = (0.23, 0.13, 0.03)
AUTHORS_STEP = "soft_sole_hrp4/trajectory/one_foot_80kg_200Hz.txt"
# Sole's centre in that file's frame: see tests/cases/hrp4_neoprene.yaml.
AUTHORS_ORIGIN = (1.274728354176543, -0.056000000000611)

# Table 2: initial and optimised c_tr [N/m], then c_rot [N·m/rad].
TABLE_2 = {
    "1-Ref": (3.88e6, 8.06e5, 1.79e5, 1.74e5),
    "2-Rot": (3.88e6, 4.65e6, 1.79e5, 3.50e5),
    "3-Rubber": (5.39e6, 9.59e5, 2.48e5, 2.14e5),
    "4-Straight": (9.14e6, 1.02e6, 3.41e5, 5.84e4),
    "5-Fixed": (3.88e6, 1.21e6, 1.79e5, 1.16e5),
}

COARSE = (
    Stage((10, 6, 3), 24, 3e-4, 0.2, 16),
    Stage((10, 6, 3), 24, 1e-4, 0.2, 8),
)
# Floors of c_rot over the brick's; the first is the paper's 1-Ref.
FLOORS = (0.9721, 1.1, 1.2, 1.3, 1.4, 1.55, 1.7, 1.85)
_WHOLE = "1-Ref"  # the case whose front has all floors
# Folder and key of the cases without limits, which have the same names.
# Below: folder and key of the front, by key of the cases.
UNLIMITED = "unlimited"
_BELOW = {"cases": "", UNLIMITED: UNLIMITED + "/"}
_PARETO_FRONTS = {"cases": "front", UNLIMITED: "unlimited_front"}
_PARETO_FRONT, SOLES = "front.json", "soles.png"
_TOLD = ("/optimize", "/front")  # jobs whose end is printed


def step_block(root: Path | None) -> LoadBlock:
    """The authors' step under `root`, or without one our walking pattern."""
    if root is None:
        return LoadBlock(pattern=Robot())
    return LoadBlock(one_foot=OneFoot(AUTHORS_STEP, AUTHORS_ORIGIN))


def five_cases(load: LoadBlock, coarse: bool) -> list[Settings]:
    """The cases of the paper's Table 1, with the given load.

    Args:
        load: The step.
        coarse: Two coarse stages, for a first look.
    """
    stages = COARSE if coarse else STAGES
    reference = Settings(
        "1-Ref",
        MeshBlock(brick=Brick(SIZE, stages[-1].divisions)),
        MaterialBlock("neoprene"),
        load,
        ContactBlock(friction=0.8),
        StartBlock((-0.115, 0.0, -0.03), (-0.115, 0.0)),
        CostBlock(),
        OptimizeBlock(stages=stages),
    )
    fixed = replace(reference.optimize, fixed_top=True)
    return [
        reference,
        replace(reference, name="2-Rot", cost=CostBlock(weight=1000.0)),
        replace(reference, name="3-Rubber", material=MaterialBlock("butyl")),
        replace(
            reference, name="4-Straight", load=replace(load, straight=True)
        ),
        replace(reference, name="5-Fixed", optimize=fixed),
    ]


@dataclass(frozen=True)
class Study:
    """The five cases, with our limits, without them (as the paper), or both.

    Attributes:
        source: Where the step comes from, in words.
        limits: "all", "none" or "both".
        variants: Cases by their key in summary.json.
    """

    source: str
    limits: str
    variants: dict[str, list[Case]]

    @classmethod
    def read(
        cls,
        data_root: Path | None = None,
        mesh_file: Path | None = None,
        coarse: bool = False,
        limits: str = "all",
        iterations: int | None = None,
    ) -> "Study":
        """Open the five cases with the files they need.

        Args:
            data_root: Folder with the authors' step; without it the load
                is our own walking pattern.
            mesh_file: Mesh that the last stage uses instead of the brick.
            coarse: Two coarse stages, for a first look.
            limits: Whether stability, tilt and strain are limited, see class.
            iterations: Largest number of iterations in the last stage.

        Raises:
            InputError: Step or mesh cannot be read, or the ZMP leaves the
                sole.
        """
        load = step_block(data_root)
        source = "authors’ step" if load.one_foot else "own walking pattern"
        cases = [
            Case.open(settings, data_root or ".", mesh_file).with_iterations(
                iterations
            )
            for settings in five_cases(load, coarse)
        ]
        variants = {"cases": cases}
        if limits != "all":
            free = [case.without_limits() for case in cases]
            variants["cases" if limits == "none" else UNLIMITED] = free
        return cls(source, limits, variants)

    def run(
        self,
        out: Path,
        at_once: int = 2,
        with_pareto_front: bool = False,
        accepted: Sequence[str] = (),
    ) -> tuple[Verdict, str]:
        """Optimise all cases; write their folders, summary, table, front.png.

        Args:
            out: Folder to write into.
            at_once: Number of processes at a time.
            with_pareto_front: Also find the front of c_tr against c_rot.
            accepted: Names of checks that the user accepts.

        Returns:
            The verdict on all designs together, and the tables' text.
        """
        began = time.perf_counter()
        summary = {"load": self.source, "limits": self.limits}
        jobs, fronts = [], []
        for key, cases in self.variants.items():
            for case in cases:
                name = f"{_BELOW[key]}{case.name}/"
                folder = out / name
                folder.mkdir(parents=True, exist_ok=True)
                stages = search_jobs(case, folder, name=name)
                what = {"folder": folder, "case": case}
                last = Job(
                    f"{name}optimize", f"{__name__}:optimize_job",
                    what | {"accepted": tuple(accepted)}, (stages[-1].name,),
                    given="search",
                )  # fmt: skip
                jobs += [*stages, last]
                front = Job(f"{name}front", f"{__name__}:pareto_job", what)
                fronts.append(front)
        jobs += fronts if with_pareto_front else []

        def note() -> None:
            """Write summary.json: an interrupted study keeps its cases."""
            for key, cases in self.variants.items():
                folder = out / _BELOW[key]
                summary[key] = [
                    read_summary(folder / case.name)
                    for case in cases
                    if (folder / case.name / SUMMARY).is_file()
                ]
                if with_pareto_front:
                    summary[_PARETO_FRONTS[key]] = study_front(folder, cases)
            summary["total_seconds"] = round(time.perf_counter() - began, 2)
            write_json(out / SUMMARY, summary)

        def end(row: Ended) -> None:
            if row.name.endswith(_TOLD):
                said = f"{row.name}: {row.cause or row.error}"
                if row.value:
                    unlimited = row.name.startswith(UNLIMITED)
                    said = _BELOW[UNLIMITED] * unlimited + row.value
                print(said, flush=True)
                note()

        try:
            with Processes(at_once) as pool, TemporaryDirectory() as logs:
                jobs = logged(jobs, Path(logs))
                ended = run_jobs(jobs, pool, end, BatchProgress("study"))
        except KeyboardInterrupt:
            note()
            raise
        checks = [
            Check(
                "solved", False, where=row.name, sentence=row.cause or row.error
            )
            for row in ended.values()
            if row.state != "done" and row.name.endswith(_TOLD)
        ]
        for key in self.variants:
            own = [c for row in summary[key] for c in stored(row).checks]
            own += front_checks(_points(summary, key))
            checks += [replace(c, where=_BELOW[key] + c.where) for c in own]
        verdict = Verdict(tuple(checks), tuple(accepted))
        summary |= verdict.summary()
        write_json(out / SUMMARY, summary)
        text = _tables(out, summary, verdict.mark)
        write_text(out / "table.txt", text, verdict.mark)
        return verdict, text


def optimize_job(folder: Path, case: Case, say, search, accepted=()) -> str:
    """Verify and write the design that a search found; its `line`."""
    (found,) = search.values()
    design = finished(case, found)
    return line(design.write(folder, say, accepted))


def pareto_job(folder: Path, case: Case, say) -> str:
    """Find a case's front and write front.json; a line with its size.

    1-Ref has all floors; every other case the paper's own ratio of c_rot.
    """
    tr0, tr, rot0, rot = TABLE_2[case.name]
    floors = FLOORS
    if case.name != _WHOLE:
        floors = (rot / rot0,)
    points = pareto_front(case, floors, say)
    points[0]["paper_ratio_tr"] = tr / tr0
    write_json(folder / _PARETO_FRONT, points)
    return f"{case.name}: {len(points)} points of the front"


def study_front(folder: Path, cases: list[Case]) -> dict:
    """Points found so far: all of 1-Ref, and the first of every case.

    Numbers that are null in the files become NaN.
    """
    found = {"points": [], "at_paper": []}
    for case in cases:
        file = folder / case.name / _PARETO_FRONT
        if not file.is_file():
            continue
        points = [
            {key: np.nan if x is None else x for key, x in point.items()}
            for point in read_json(file, "run the study again")
        ]
        if case.name == _WHOLE:
            found["points"] = points
        found["at_paper"] += points[:1]
    return found


def _points(summary: dict, key: str) -> list[dict]:
    """Every point of a study's front once, by the key of its cases."""
    found = summary.get(_PARETO_FRONTS[key], {"points": [], "at_paper": []})
    points = found["points"]
    return points + [p for p in found["at_paper"] if p not in points]


def line(row: dict) -> str:
    """One line on a finished case, from its summary."""
    finer = row.get("finer")
    there, on_finer = (finer or {}).get("design"), ""
    if there is not None and there["failed_steps"]:
        on_finer = f"no equilibrium on {finer['tets']} tets; "
    elif there is not None:
        on_finer = (
            f"{_number(there['c'], '.4g')} on {finer['tets']} tets, "
            f"{_number(finer['change'], '+.1%')}; "
        )
    found = (row.get("gait") or {}).get("walk", {})
    walk = [f"{name} {a:.3g} → {b:.3g}" for name, (a, b) in found.items()]
    return (
        f"{row['name']}: c {row['c']:.4g} on {row['tets']} tets, {on_finer}"
        f"c_tr {row['c_tr']:.3g} (×{row['ratio_tr']:.3f}), "
        f"c_rot {row['c_rot']:.3g} (×{row['ratio_rot']:.3f}), "
        f"{row['volume_cm3']:.0f} cm³, "
        f"{'optimal' if row['optimal'] else row.get('status', 'sole alone')}, "
        f"{'stable' if row['stable'] else 'unstable'}, largest strain "
        f"{row['max_strain']:.2f}; held by "
        f"{', '.join(row.get('active', ())) or 'no limit'}"
        + (f"; walk: {', '.join(walk)}" if walk else "")
    )


def _tables(out: Path, summary: dict, mark: str) -> str:
    """Text of all tables; draws front.png."""
    parts, fronts = [], {}
    for key, title in (("cases", ""), (UNLIMITED, "without limits\n")):
        rows = summary.get(key)
        if rows:
            parts.append(title + table(rows) + "\n\n" + certainty_table(rows))
        found = summary.get(_PARETO_FRONTS[key])
        if found:
            fronts[_PARETO_FRONTS[key].replace("_", " ")] = found["points"]
            parts.append(front_table(_points(summary, key)))
    draw_pareto_front(out, fronts, summary["cases"], mark)
    return "\n\n".join(parts)


def table(rows: list[dict]) -> str:
    """The paper's Table 2 with all its columns, ours below each row."""
    head = (
        f"{'case':11s} {'':6s} {'c_tr ini':>9s} {'c_tr opt':>9s} "
        f"{'ratio':>6s} {'comp.':>7s} {'c_rot ini':>9s} {'c_rot opt':>9s} "
        f"{'ratio':>6s} {'comp.':>7s} {'c ini':>9s} {'c opt':>9s}"
    )
    lines = [head, "-" * len(head)]
    ours_1 = next((r for r in rows if r["name"] == "1-Ref"), None)
    for row in rows:
        tr0, tr, rot0, rot = TABLE_2[row["name"]]
        first = TABLE_2["1-Ref"]
        lines.append(
            _line(
                row["name"], "paper", row["weight"], (tr0, tr, rot0, rot),
                (first[1], first[3]),
            )
        )  # fmt: skip
        mine = (
            row["c_tr_initial"], row["c_tr"],
            row["c_rot_initial"], row["c_rot"],
        )  # fmt: skip
        base = (ours_1["c_tr"], ours_1["c_rot"]) if ours_1 else mine[1::2]
        lines.append(_line("", "ours", row["weight"], mine, base))
    return "\n".join(lines)


def _line(name, who, weight, values, base) -> str:
    tr0, tr, rot0, rot = values
    return (
        f"{name:11s} {who:6s} {tr0:9.2e} {tr:9.2e} {tr / tr0:6.3f} "
        f"{100 * (tr / base[0] - 1):+6.0f}% {rot0:9.2e} {rot:9.2e} "
        f"{rot / rot0:6.3f} {100 * (rot / base[1] - 1):+6.0f}% "
        f"{tr0 - weight * rot0:9.2e} {tr - weight * rot:9.2e}"
    )


def paper_cost(row: dict) -> float:
    """The paper's optimal c rescaled to our brick, the c to beat [N/m]."""
    tr0, tr, rot0, rot = TABLE_2[row["name"]]
    c_tr = row["c_tr_initial"] * tr / tr0
    return c_tr - row["weight"] * row["c_rot_initial"] * rot / rot0


def certainty_table(rows: list[dict]) -> str:
    """Table of how certain each optimum is.

    Columns: c and the paper's, rescaled; IPOPT's error and complementarity;
    change of c by the exact law from a cold start; change of c on a finer mesh,
    and the brick's; spread of c between starts; largest strain and tilt,
    whether stable.
    """
    head = (
        f"{'case':11s} {'c':>10s} {'paper':>10s} {'error':>8s} {'compl.':>8s} "
        f"{'exact law':>9s} {'finer':>7s} {'brick':>7s} {'spread':>7s} "
        f"{'strain':>6s} {'tilt':>5s} {'stable':>6s}"
    )
    lines = [head, "-" * len(head)]
    for row in rows:
        finer = row.get("finer") or {}
        lines.append(
            f"{row['name']:11s} {row['c']:10.3e} {paper_cost(row):10.3e} "
            f"{_number(row.get('optimality_error'), '8.1e')} "
            f"{_number(row.get('complementarity'), '8.1e')} "
            f"{_number(row.get('exact_change'), '+9.2%')} "
            f"{_number(finer.get('change'), '+7.2%')} "
            f"{_number(finer.get('brick_change'), '+7.2%')} "
            f"{_number(row.get('spread'), '+7.2%')} "
            f"{row['max_strain']:6.2f} {row['tilt_max_deg']:5.1f} "
            f"{'yes' if row['stable'] else 'no':>6s}"
        )
    return "\n".join(lines)


def _number(value, form: str) -> str:
    if value is None or np.isnan(value):
        return f"{'-':>{form.strip('+').split('.')[0]}s}"
    return f"{value:{form}}"


def front_table(points: list[dict]) -> str:
    """Table of a front, one line for every point."""
    lines = [
        f"{'case':11s} {'floor':>6s} {'c_tr':>9s} {'ratio':>6s} "
        f"{'paper':>6s} {'c_rot':>9s} {'ratio':>6s} {'error':>8s}"
    ]
    lines += [
        f"{p['case']:11s} {p['floor']:6.3f} {_number(p['c_tr'], '9.2e')} "
        f"{_number(p['ratio_tr'], '6.3f')} "
        f"{_number(p.get('paper_ratio_tr'), '6.3f')} "
        f"{_number(p['c_rot'], '9.2e')} {_number(p['ratio_rot'], '6.3f')} "
        f"{p['optimality_error']:8.1e}"
        for p in points
    ]
    return "\n".join(lines)


def draw_pareto_front(
    out: Path, fronts: dict[str, list[dict]], rows=(), mark: str = ""
) -> None:
    """Draw front.png: fronts by label, and designs beside the paper's."""
    from drake_exo.soles import pictures

    paper = {
        name: (tr / tr0, rot / rot0)
        for name, (tr0, tr, rot0, rot) in TABLE_2.items()
    }
    figure = pictures.pareto_figure(fronts, rows, paper)
    save_figure(out / "front.png", figure, mark)


def report(out: Path, designs: list[StoredDesign], source: Path) -> str:
    """Write the pictures of designs, finite_strain.* and report.html.

    Args:
        out: Folder to write into.
        designs: What is shown.
        source: Their folder, from which a study's own tables and front come.

    Returns:
        The finite-strain table; empty if no design has one.
    """
    # matplotlib takes half a second to load.
    from drake_exo.soles import pictures

    summaries = {d.name: d.summary() for d in designs}
    told = {d.name: _told(d, summaries[d.name]) for d in designs}
    figures = {
        SOLES: pictures.soles_figure(
            [_drawn(d, summaries[d.name]) for d in designs]
        ),
        "histories.png": pictures.histories_figure(
            {d.name: d.history() for d in designs}
        ),
    }
    if len(designs) > 1:  # a single design has its own stiffness.png
        figures["stiffness.png"] = _stiffness(designs)
    found = {
        d.name: finite_strain.from_json(kept, d.folder / SUMMARY)
        for d in designs
        if (kept := summaries[d.name].get("finite_strain"))
    }
    mark = joined_mark({d.name: d.mark for d in designs})
    for name, figure in figures.items():
        save_figure(out / name, figure, mark)
    text = finite_strain.write_table(out, found, mark) if found else ""
    files = [*(out / name for name in figures), source / "front.png"]
    _write_page(out, designs, told, source / "table.txt", files, text)
    return text


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>body {{font: 15px sans-serif; max-width: 75em; margin: 2em auto;
padding: 0 1em}} img {{max-width: 100%}} pre {{white-space: pre-wrap}}
.mark {{color: #c8102e; font-weight: bold}}</style></head>
<body><h1>{title}</h1>
{body}
</body></html>
"""


def _preformatted(text: str) -> str:
    return f"<pre>{html.escape(text)}</pre>"


def _told(design: StoredDesign, row: dict) -> list[str]:
    """What report.html says of a design by its summary.json.

    Raises:
        InputError: That is damaged.
    """
    path = design.folder / SUMMARY
    found, mark = stored(row, path), html.escape(stored_mark(row, path))
    try:
        said = line(row)
    except (AttributeError, LookupError, TypeError, ValueError):
        raise InputError(
            f"{path}: is damaged; optimise the sole again"
        ) from None
    told = [f'<p class="mark">{mark}</p>'] if mark else []
    told.append(_preformatted(said))
    return told + ([_preformatted(found.text())] if found else [])


def _write_page(
    out: Path, designs, told, tables: Path, pictures, strains: str
) -> None:
    """Write report.html: every table and picture in one file."""
    body = []
    if tables.is_file():
        body.append(_preformatted(read_text(tables)))
    body += [embedded(file, file.stem) for file in pictures if file.is_file()]
    if strains:
        heading = "<h2>Heel strike in finite strain</h2>"
        body += [heading, _preformatted(strains)]
    for design in designs:
        body += [f"<h2>{html.escape(design.name)}</h2>", *told[design.name]]
        drawing = design.folder / "drawing.png"
        body += [embedded(drawing, "drawing")] if drawing.is_file() else []
    title = ", ".join(design.name for design in designs)
    page = _PAGE.format(
        title=html.escape(f"Soles: {title}"), body="\n".join(body)
    )
    (out / "report.html").write_text(page, encoding="utf-8")


def _drawn(design: StoredDesign, row: dict):
    from drake_exo.soles.pictures import radial_change

    mesh = design.setup.mesh
    caption = (
        f"c_tr × {row['ratio_tr']:.3f}, c_rot × {row['ratio_rot']:.3f}, "
        f"{row['volume_cm3']:.0f} cm³, "
        f"{'stable' if row['stable'] else 'not stable'}, "
        f"tilt up to {row['tilt_max_deg']:.0f}°"
    )
    path = kept_file(design.folder, "initial.vtk")
    initial = read_mesh(path, (0.0, 0.0, 0.0))
    change = radial_change(mesh, *design.shape())
    return design.name, caption, initial, mesh, change


def _stiffness(designs: list[StoredDesign]):
    """Figure of the designs' stiffness, see `pictures.stiffness_figure`."""
    from drake_exo.soles import pictures

    files = {"initial": "initial_steps.csv", "optimised": "steps.csv"}
    time = ("time_s",)
    needed = (*time, *pictures.STIFFNESS)
    soles = {
        design.name: {
            label: read_columns(kept_file(design.folder, file), needed, time)
            for label, file in files.items()
        }
        for design in designs
    }
    return pictures.stiffness_figure(soles, strikes(designs[0].setup))
