"""The command `drake-exo sole study`: the paper's five cases side by side."""

import time
from pathlib import Path

from drake_exo.cli.sole_optimize import optimise_case, print_row
from drake_exo.files.output import prepare_output_folder, write_json
from drake_exo.papers.de_magistris_cases import (
    AUTHORS_ORIGIN,
    AUTHORS_STEP,
    TABLE_2,
    five_cases,
)
from drake_exo.papers.de_magistris_report import finish
from drake_exo.papers.de_magistris_tables import certainty_table, table
from drake_exo.soles.case import Case, LoadBlock, OneFoot, Pattern
from drake_exo.soles.optimize import pareto as front
from drake_exo.soles.optimize import workers
from drake_exo.soles.optimize.design import (
    finish_on_own_mesh,
    with_iterations,
    without_limits,
)
from drake_exo.soles.optimize.design_folder import SUMMARY, read_summary

UNLIMITED = "unlimited"  # folder and key of the cases without limits
_FRONTS = {"cases": "front", UNLIMITED: "unlimited_front"}


def run_study(args) -> int:
    """Optimise the five cases; 0 where every final design simulates."""
    root = args.data_root or Path(".")
    measured = args.data_root and (root / AUTHORS_STEP).is_file()
    if measured:
        load = LoadBlock(one_foot=OneFoot(AUTHORS_STEP, AUTHORS_ORIGIN))
    else:
        load = LoadBlock(pattern=Pattern())
    source = "authors’ step" if measured else "own walking pattern"
    print(f"load: {source}")
    cases = five_cases(load, args.coarse)
    for case in cases:
        case.open(root, args.mesh)  # refused before any work
    if args.mesh is not None:
        cases = [finish_on_own_mesh(case) for case in cases]
    began = time.perf_counter()
    with prepare_output_folder(args.out, args.force) as out:
        variants = _variants(out, cases, args.limits, args.iterations)
        jobs = [
            (_one, folder / case.name, case, root, args.mesh)
            for _, folder, rows in variants
            for case in rows
        ]
        if args.front:
            jobs += [(front.study_job, *job[1:]) for job in jobs]
        summary = {"load": source, "limits": args.limits}

        def note() -> None:
            """After every case: an interrupted study keeps its cases."""
            for key, folder, rows in variants:
                summary[key] = _finished(folder, rows)
                if args.front:
                    summary[_FRONTS[key]] = front.study_front(folder, rows)
            summary["total_seconds"] = round(time.perf_counter() - began, 2)
            write_json(out / SUMMARY, summary)

        failed = workers.run(jobs, args.jobs, note)
        for _, folder, rows in variants:
            for place in _missing(folder, rows):
                name = place.relative_to(out)
                print(f"{name}: ended without a result; its last lines say why")
        text = _report(out, summary)
        print(text)
        (out / "table.txt").write_text(text + "\n", encoding="utf-8")
        print(finish(out))
    print(f"results in {args.out}")
    rows = summary["cases"] + summary.get(UNLIMITED, [])
    return 1 if failed or any(r["failed_steps"] for r in rows) else 0


def _variants(out: Path, cases: list[Case], limits: str, iterations):
    """Key of the summary, folder and cases, with limits and without."""
    cases = [with_iterations(case, iterations) for case in cases]
    free = [without_limits(case) for case in cases]
    if limits == "all":
        return [("cases", out, cases)]
    if limits == "none":
        return [("cases", out, free)]
    return [("cases", out, cases), (UNLIMITED, out / UNLIMITED, free)]


def _one(folder: Path, case: Case, root: Path, mesh_file) -> None:
    """One design, in a process of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    load, mesh, start = case.open(root, mesh_file)
    print_row(optimise_case(folder, case, mesh, load, start))


def _finished(folder: Path, cases: list[Case]) -> list[dict]:
    """Summaries on disk, in the table's order."""
    places = [folder / case.name for case in cases]
    return [read_summary(p) for p in places if (p / SUMMARY).is_file()]


def _missing(folder: Path, cases: list[Case]) -> list[Path]:
    """Folders of cases that ended without a result."""
    places = [folder / case.name for case in cases]
    return [p for p in places if not (p / SUMMARY).is_file()]


def _report(out: Path, summary: dict) -> str:
    """Tables and front.png."""
    from drake_exo.papers.de_magistris_pictures import front_figure

    paper = {
        name: (tr / tr0, rot / rot0)
        for name, (tr0, tr, rot0, rot) in TABLE_2.items()
    }
    parts, fronts = [], {}
    for key, title in (("cases", ""), (UNLIMITED, "without limits\n")):
        rows = summary.get(key)
        if rows:
            parts.append(title + table(rows) + "\n\n" + certainty_table(rows))
        found = summary.get(_FRONTS[key])
        if found:
            others = [p for p in found["at_paper"] if p not in found["points"]]
            fronts[_FRONTS[key].replace("_", " ")] = found["points"]
            parts.append(front.table(found["points"] + others))
    front_figure(out / "front.png", summary["cases"], paper, fronts)
    return "\n\n".join(parts)
