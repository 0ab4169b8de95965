"""What a batch comes to: its table, its page, its figures, its counts."""

from __future__ import annotations

from collections import Counter

from drake_exo.batch.page import write_report
from drake_exo.batch.run import Batch
from drake_exo.batch.table import rows_of, write_table
from drake_exo.files.output import read_json, write_json

SUMMARY = "summary.json"


def write_results(batch: Batch) -> list[str]:
    """Write results.csv, results.parquet, figures, report.html, summary.json.

    Returns:
        Names of the files in the batch's folder.

    Raises:
        InputError: a result file is damaged.
    """
    rows = rows_of(batch)
    pictures: dict[str, str] = {}
    if any(row.phase == "predict" and row.trial for row in rows):
        # Half a second to import, which only predictions need.
        from drake_exo.batch.figures import draw_figures, peak_rows

        rows += peak_rows(batch, rows)
        pictures = draw_figures(batch.out, rows)
    names = write_table(batch.out, rows)
    write_report(batch, rows, pictures)
    write_json(batch.out / SUMMARY, summary(batch))
    return [*names, *pictures, "report.html", SUMMARY]


def is_told(batch: Batch) -> bool:
    """Whether just these results are told already."""
    names = (SUMMARY, "results.csv", "report.html")
    if not all((batch.out / name).is_file() for name in names):
        return False
    told = read_json(batch.out / SUMMARY, "remove it")
    return not batch.fresh and told == summary(batch)


def summary(batch: Batch) -> dict:
    """What summary.json holds: counts, and how each task ended."""
    found = batch.outcomes
    return {
        "tasks": [
            {
                "name": task.name,
                "step": task.step,
                "code": found[task.name].code,
                "verdict": found[task.name].verdict,
                "sentence": found[task.name].sentence,
            }
            for task in batch.tasks
        ],
        "verdicts": dict(Counter(row.verdict for row in found.values())),
        "verdict": "does not hold" if batch.bad else "holds",
    }
