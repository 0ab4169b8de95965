"""Results of a batch as one HTML file that needs no network.

Texts of a column are held once, a row holds their numbers; the script draws
only the rows in view, so that hundreds of thousands stay usable.
"""

from __future__ import annotations

import base64
import html
import json
from importlib.resources import files
from pathlib import Path

import numpy as np

from drake_exo.batch.run import Batch
from drake_exo.batch.table import COLUMNS, Row, replace_file

LARGEST_BYTES = 20_000_000
_BYTES_OF_ROW = 4 / 3 * (4 * (len(COLUMNS) - 1) + 8)
_TEXT_BYTES = 6_000_000  # that pictures, texts and the script may take

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>{css}</style></head><body>
<h1>{title}</h1>
<p>{counts}</p>
{failures}
<section><h2>Over subjects</h2>
<p><label>phase <select id="phase"></select></label>
<label>signal <select id="signal"></select></label>
<label>a box for each <select id="by"><option>variant</option>
<option>subject</option></select></label>
<span id="box-note"></span></p>
<div id="boxes"></div>{pictures}</section>
<section><h2>All numbers</h2>
<p><span id="shown"></span> A click on a name sorts, text below it filters
(numbers: <code>&gt;5</code>, <code>&lt;5</code>).</p>
<div id="head"></div><div id="view"><div id="space"></div></div></section>
<script>const RESULTS = {data};</script>
<script>{script}</script></body></html>
"""


def write_report(
    batch: Batch, rows: list[Row], pictures: dict[str, str]
) -> None:
    """Write report.html.

    Args:
        batch: whose folder it goes to.
        rows: of its table; those that do not hold come first, and stay where
            not all of them fit.
        pictures: name of a PNG in that folder -> what it shows.
    """
    rows = sorted(rows, key=lambda row: row.verdict == "holds")
    most = int((LARGEST_BYTES - _TEXT_BYTES) / _BYTES_OF_ROW)
    good = len(batch.tasks) - len(batch.bad)
    counts = f"{good} of {len(batch.tasks)} tasks hold."
    if len(rows) > most:
        counts += (
            f" The first {most} of {len(rows)} rows are shown here; all of "
            "them are in results.csv."
        )
    page = _PAGE.format(
        title="Results of a batch",
        css=_asset("report.css"),
        counts=html.escape(counts),
        failures=_failures(batch),
        pictures="".join(
            _picture(batch.out / name, text) for name, text in pictures.items()
        ),
        data=_data(rows[:most], _links(batch)),
        script=_asset("report.js"),
    )
    replace_file(batch.out / "report.html", page.encode())


def _asset(name: str) -> str:
    return files("drake_exo.batch").joinpath(name).read_text("utf-8")


def _failures(batch: Batch) -> str:
    """A table of what failed or does not hold; at most 2 000 of them."""
    if not batch.bad:
        return ""
    lines = []
    for task, found in batch.bad[:2000]:
        cells = (
            _link(batch.out, task.name),
            html.escape(found.verdict),
            html.escape(found.sentence),
        )
        lines.append(f"<tr>{''.join(f'<td>{c}</td>' for c in cells)}</tr>")
    title = f"Failed or does not hold ({len(batch.bad)})"
    return (
        f"<section><h2>{title}</h2><table id='failures'>"
        f"{''.join(lines)}</table></section>"
    )


def _link(out: Path, name: str) -> str:
    text = html.escape(name)
    if not (out / name).is_dir():
        return text
    return f'<a href="{_address(name)}/">{text}</a>'


def _address(name: str) -> str:
    from urllib.parse import quote

    return html.escape(quote(name))


def _links(batch: Batch) -> dict[str, str]:
    """Folder -> its replay, of those that have one."""
    return {
        task.name: f"{_address(task.name)}/replay.html"
        for task in batch.tasks
        if (batch.out / task.name / "replay.html").is_file()
    }


def _picture(path: Path, text: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    text = html.escape(text)
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{data}">'
        f"<figcaption>{text}</figcaption></figure>"
    )


def _data(rows: list[Row], replays: dict[str, str]) -> str:
    """What the script reads, as JSON."""
    columns = {}
    for name in COLUMNS:
        cells = [getattr(row, name) for row in rows]
        if name == "value":
            numbers = [np.nan if x is None else x for x in cells]
            columns[name] = {"data": _packed(numbers, "f8")}
            continue
        texts = list(dict.fromkeys(cells))
        places = {text: k for k, text in enumerate(texts)}
        numbers = [places[text] for text in cells]
        columns[name] = {"texts": texts, "data": _packed(numbers, "u4")}
    data = {"columns": columns, "count": len(rows), "replays": replays}
    # "</" would end the script that holds the data.
    return json.dumps(data, ensure_ascii=False).replace("</", "<\\/")


def _packed(numbers, kind: str) -> str:
    data = np.asarray(numbers, dtype=f"<{kind}").tobytes()
    return base64.b64encode(data).decode("ascii")
