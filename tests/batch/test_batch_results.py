"""Tables, pages and figures of a batch."""

import csv
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from unmarked import unmarked

from drake_exo.batch import results
from drake_exo.batch.file import Task
from drake_exo.batch.results import (
    COLUMNS,
    MEASURED,
    PREDICTED,
    Row,
    draw_figures,
    is_told,
    limits_of_agreement,
    rows_of,
    summary,
    unit_of,
    write_report,
    write_results,
    write_table,
)
from drake_exo.batch.run import Batch, outcome
from drake_exo.cli.batch import text_of, unmatched
from drake_exo.errors import InputError
from drake_exo.files.output import Check, Verdict, write_json

SUMMARY = {
    "phase": "interaction",
    "objective": 3.5,
    "success": True,
    "settings": {"solver": {"tolerance": 1e-6}},
    "rmsd": [
        {"trial": "t1", "grf_n": {"vertical": 12.0}, "cop_mm": 2.0},
        {"trial": "t2", "grf_n": {"vertical": 14.0}, "cop_mm": None},
    ],
    "parameters": [
        {"name": "heel.x", "value": 0.01, "unit": "m", "half_width_95": 0.002},
        {"name": "toe.x", "value": 0.02, "unit": "m", "half_width_95": None},
    ],
    "audit": [{"trial": "t1", "holds": True, "simulated_grf_n": [0.1, 0.2]}],
    "clocks": [
        {
            "trial": "t2",
            "system": "encoders",
            "lag_s": -0.02,
            "half_width_95_s": 0.004,
            "sure": True,
        }
    ],
    "front": [{"angles_deg": 1.0}],
}


@pytest.fixture
def batch(tmp_path):
    """One task that holds, one that does not, one without results."""
    tasks, outcomes = [], {}
    for name, code, sentence in (
        ("anna", 0, ""),
        ("bert", 3, "audit: off <b>by</b> 3 N"),
        ("carl", 2, "carl/study.yaml: </script> wrong; mend it"),
    ):
        task = Task(f"{name}/calibrate", name, "", "calibrate", key=name)
        folder = tmp_path / task.name
        folder.mkdir(parents=True)
        if code != 2:
            write_json(folder / "summary.json", SUMMARY)
        tasks.append(task)
        outcomes[task.name] = found = outcome(task, code, sentence)
        write_json(folder / "task.json", found)
    return Batch(tmp_path, tuple(tasks), outcomes, 3)


def test_rows(batch):
    rows = rows_of(batch)
    anna = {(r.trial, r.signal): r for r in rows if r.subject == "anna"}
    assert {key: row.value for key, row in anna.items()} == {
        ("t1", "rmsd.grf_n.vertical"): 12.0,
        ("t1", "rmsd.cop_mm"): 2.0,
        ("t2", "rmsd.grf_n.vertical"): 14.0,
        ("t1", "audit.simulated_grf_n.0"): 0.1,
        ("t1", "audit.simulated_grf_n.1"): 0.2,
        ("t2", "clocks.encoders.lag_s"): -0.02,
        ("t2", "clocks.encoders.half_width_95_s"): 0.004,
        ("", "parameters.heel.x"): 0.01,
        ("", "parameters.heel.x.half_width_95"): 0.002,
        ("", "parameters.toe.x"): 0.02,
        ("", "objective"): 3.5,
    }
    assert anna["t1", "rmsd.cop_mm"].unit == "mm"
    assert anna["", "parameters.heel.x"].unit == "m"
    assert anna["t2", "clocks.encoders.lag_s"].unit == "s"
    assert {r.verdict for r in anna.values()} == {"holds"}
    bert = [r for r in rows if r.subject == "bert"]
    assert len(bert) == len(anna)
    assert bert[0].verdict == "does not hold: audit: off <b>by</b> 3 N"
    (carl,) = (r for r in rows if r.subject == "carl")
    assert carl.value is None and "mend it" in carl.verdict


@pytest.mark.parametrize(
    ("name", "tree"),
    [
        ("quality.json", {"trials": 3}),
        ("summary.json", 3),
        ("summary.json", SUMMARY | {"parameters": [{"name": "heel.x"}]}),
        ("summary.json", SUMMARY | {"parameters": [True]}),
    ],
)
def test_results_of_another_form_are_damaged(batch, name, tree):
    write_json(batch.out / "bert" / "calibrate" / name, tree)
    with pytest.raises(InputError, match=f"bert/calibrate: {name} is damaged"):
        rows_of(batch)


@pytest.mark.parametrize(
    ("signal", "unit"),
    [
        ("rmsd.velocities_deg_s.hip", "deg/s"),
        ("rmsd.moments_nm.knee", "N m"),
        ("rmsd.angles_deg.exo_s", "deg"),  # however joints are called
        ("rmsd.foot.x_mm", "mm"),
        ("peaks_n.brace_m.today", "N"),
        ("wearers_n.Adam_s.before", "N"),
        ("iterations", ""),
        ("stability_min_n_per_m", "N/m"),
        ("c_tr", "N/m"),
        ("c_rot_mean_nm_per_rad", "N m/rad"),
        ("volume_cm3", "cm^3"),
        ("felt.thigh.before.pressure_kpa", "kPa"),
        ("felt.thigh.before.rate_n_s", "N/s"),
        ("band_coverage.angles_deg.exo_hip", ""),
        ("band_coverage.half_width_n.pelvis", "N"),
        ("free_moment_nm.cut_samples", ""),  # a number of them
        ("multipliers.tilt_deg", ""),
        ("parts.places alone", "N"),
        ("finite_strain.c_tr_small", "N/m"),
        ("gait.c_tr_sole_alone", "N/m"),
        ("gait.c_rot_sole_alone", "N m/rad"),
        ("gait.walk.step_time.0", "s"),
        ("gait.walk.aim_x.1", "m"),
    ],
)
def test_units(signal, unit):
    assert unit_of(signal) == unit


def test_numbers_of_a_design():
    variable = {"name": "thigh.along_m", "value": 0.1, "today": 0.0,
                "unit": "m", "at_bound": True}  # fmt: skip
    found = results._summary(
        {
            "variables": [variable],
            "felt": [{"cuff": "thigh", "after": {"shear_n": 3.0}}],
            "drives": [{"joint": "exo_hip", "before": {"power_w": 4.0}}],
            "support": {"before": 90.0, "measured_after": None},
        }
    )
    assert list(found) == [
        ("", "variables.thigh.along_m", 0.1, "m"),
        ("", "variables.thigh.along_m.today", 0.0, "m"),
        ("", "felt.thigh.after.shear_n", 3.0, "N"),
        ("", "drives.exo_hip.before.power_w", 4.0, "W"),
        ("", "support.before", 90.0, "J"),
    ]


def test_csv_is_read_back(batch):
    rows = rows_of(batch)
    assert "results.csv" in write_table(batch.out, rows)
    with (batch.out / "results.csv").open(encoding="utf-8", newline="") as file:
        found = list(csv.DictReader(file))
    assert tuple(found[0]) == COLUMNS
    assert COLUMNS[:7] == (
        *("subject", "trial", "phase", "signal", "value", "unit", "verdict"),
    )
    assert [r["value"] for r in found] == [
        "" if r.value is None else str(r.value) for r in rows
    ]


def test_parquet_where_it_can_be(batch):
    parquet = pytest.importorskip("pyarrow.parquet", reason="no pyarrow here")
    rows = rows_of(batch)
    assert "results.parquet" in write_table(batch.out, rows)
    table = parquet.read_table(batch.out / "results.parquet")
    assert table.column_names == list(COLUMNS)
    assert table.column("value").to_pylist() == [r.value for r in rows]


def test_told_once(batch):
    assert not is_told(batch)
    assert "results.csv" in write_results(batch)
    again = Batch(batch.out, batch.tasks, batch.outcomes, 0)
    assert is_told(again) and not is_told(batch)
    fewer = Batch(batch.out, batch.tasks[:2], batch.outcomes, 0)
    assert not is_told(fewer)
    # Done anew on other files, and killed before it was told.
    other = replace(batch.tasks[0], key="other")
    assert not is_told(replace(batch, tasks=(other, *batch.tasks[1:]), fresh=0))
    assert summary(batch)["verdicts"] == {
        "holds": 1,
        "does not hold": 1,
        "failed": 1,
    }
    assert batch.exit_code == 3


def test_a_replay_that_was_saved_since_is_told(batch):
    write_results(batch)
    again = replace(batch, fresh=0)
    (batch.out / "anna/calibrate/replay.html").write_text("")
    assert not is_told(again)
    write_results(again)
    assert is_told(again)
    page = (batch.out / "report.html").read_text()
    assert '"anna/calibrate/replay.html"' in page


def test_figures_of_an_earlier_batch_file_do_not_stay(batch):
    for name in ("over_subjects.png", "bland_altman_m=1.png"):
        (batch.out / name).write_text("")
    write_results(batch)
    assert not list(batch.out.glob("*.png"))


def test_what_is_accepted_does_not_hold_and_ends_with_0(batch):
    (task, *_) = batch.tasks
    found = outcome(task, 0, "audit: off by 3 N", "does not hold")
    accepted = Batch(batch.out, (task,), {task.name: found}, 1)
    assert accepted.exit_code == 0
    assert summary(accepted)["verdict"] == "does not hold"
    text = text_of(accepted)
    assert text.startswith(f"{task.name}: does not hold: audit: off by 3 N")
    assert "0 of 1 tasks hold" in text


def test_what_is_accepted_but_is_no_check_is_told(batch):
    """A misspelt name; what one task alone may need is none."""
    first, second, *_ = batch.tasks
    words = ("audti", "solved", "replay")
    tasks = [
        replace(task, step="predict", options=("--accept", *words))
        for task in (first, second)
    ]
    for task, own in zip(tasks, ("solved", "replay"), strict=True):
        verdict = Verdict((Check(own, True),), words)
        path = batch.out / task.name / "summary.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, verdict.summary())
    done = {task.name: outcome(task, 0) for task in tasks}
    assert unmatched(Batch(batch.out, tuple(tasks), done, 2)) == [
        "note: options of predict: --accept audti: no check has that name"
    ]


def results_in(path: Path) -> dict:
    (found,) = re.findall(
        r"const RESULTS = (\{.*\});</script>", path.read_text("utf-8")
    )
    return json.loads(found)


def test_the_page_holds_everything_failures_first(batch):
    rows = rows_of(batch)
    write_report(batch, rows, {})
    text = (batch.out / "report.html").read_text("utf-8")
    found = results_in(batch.out / "report.html")
    assert found["count"] == len(rows)
    verdicts = found["columns"]["verdict"]["texts"]
    assert verdicts[-1] == "holds" and len(verdicts) == 3
    assert "off &lt;b&gt;by&lt;/b&gt; 3 N" in text
    assert 'href="carl/calibrate/"' in text
    assert text.count("</script>") == 2
    assert "//" not in "".join(
        re.findall(r"<(?:script|link|img)\b[^>]*>", text)
    )


def test_the_page_leads_to_replays(batch):
    """Those that soles write, and those that `view --out` saved."""
    pages = {
        "anna/calibrate": "anna/calibrate/replay.html",
        "bert/calibrate": "bert/calibrate/animation.html",
    }
    for page in pages.values():
        (batch.out / page).touch()
    write_report(batch, rows_of(batch), {})
    assert results_in(batch.out / "report.html")["replays"] == pages


def test_the_page_stays_small(batch, monkeypatch):
    rows = rows_of(batch) * 100
    monkeypatch.setattr(results, "LARGEST_BYTES", results._TEXT_BYTES + 20_000)
    write_report(batch, rows, {})
    text = (batch.out / "report.html").read_text("utf-8")
    shown = results_in(batch.out / "report.html")["count"]
    assert shown == int(20_000 / results._BYTES_OF_ROW) < len(rows)
    assert f"of {len(rows)} rows are shown here" in text
    assert len(text) < 60_000


def test_tasks_that_have_a_replay_are_linked_with_it(batch):
    assert results._links(batch) == {}
    name = batch.tasks[-1].name
    (batch.out / name).mkdir(parents=True, exist_ok=True)
    (batch.out / name / "replay.html").write_text("")
    assert results._links(batch) == {name: f"{name}/replay.html"}


def test_a_row_of_the_page_takes_the_bytes_that_it_is_counted_by(batch):
    row = rows_of(batch)[0]
    sizes = []
    for count in (1000, 3000):
        write_report(batch, [row] * count, {})
        sizes.append((batch.out / "report.html").stat().st_size)
    per_row = (sizes[1] - sizes[0]) / 2000
    assert per_row == pytest.approx(results._BYTES_OF_ROW, rel=0.02)


def many_rows(count):
    rng = np.random.default_rng(0)
    values = rng.normal(size=count)
    return [
        Row(
            f"seed_{k % 40}",
            f"trial_{k % 9}",
            "predict",
            f"rmsd.signal_{k % 700}_n",
            float(values[k]),
            "N",
            "holds" if k % 1000 else "failed: why",
            "",
            f"seed_{k % 40}/predict",
        )
        for k in range(count)
    ]


@pytest.mark.slow
def test_200_000_rows_in_a_browser(tmp_path):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no chromium on this machine")
    batch = Batch(tmp_path, (), {}, 0)
    rows = many_rows(200_000)
    write_report(batch, rows, {})
    report = tmp_path / "report.html"
    assert report.stat().st_size < results.LARGEST_BYTES
    done = subprocess.run(
        [
            *(browser, "--headless=new", "--no-sandbox", "--disable-gpu"),
            *("--virtual-time-budget=3000", "--dump-dom"),
            *("--host-resolver-rules=MAP * ~NOTFOUND",),
            *(f"--user-data-dir={tmp_path}/b", "--enable-logging=stderr"),
            f"{report.as_uri()}#sort=value&filter-signal=signal_12_",
        ],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert "Uncaught" not in done.stderr
    (body,) = re.findall(r"<body([^>]*)>", done.stdout)
    took = dict(re.findall(r'data-([a-z-]+)-ms="(\d+)"', body))
    assert set(took) == {"ready", "sort", "filtersignal"}
    assert all(int(ms) <= 2000 for ms in took.values()), took
    wanted = sorted(r.value for r in rows if "signal_12_" in r.signal)
    assert f">{len(wanted)} of 200000 rows.<" in done.stdout
    shown = re.findall(r'class="value" title="(.*?)"', done.stdout)
    expected = [f"{v:.5g}" for v in wanted[: len(shown)]]
    assert len(shown) < 100
    np.testing.assert_allclose(
        [float(v) for v in shown], [float(v) for v in expected]
    )
    assert "<svg" in done.stdout


def test_limits_of_agreement():
    rng = np.random.default_rng(3)
    off = 2.0 + 0.5 * rng.standard_normal(20_000)
    for subjects in (np.arange(20_000), np.zeros(20_000)):  # 1 trial each; 1
        np.testing.assert_allclose(
            limits_of_agreement(off, subjects), (2.0, 1.02, 2.98), atol=0.03
        )


def test_trials_of_a_subject_are_not_independent():
    """Off by 2 for each subject and 1 for each trial: SD of the square root
    of 5 however many trials a subject has."""
    rng = np.random.default_rng(4)
    of = np.repeat(np.arange(4_000), rng.integers(1, 9, 4_000))
    off = 2.0 * rng.standard_normal(4_000)[of]
    off += rng.standard_normal(len(of))
    _, low, high = limits_of_agreement(off, of)
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt(5.0), rel=0.02)
    # By hand: means 1 and 4, within 4 / 2, between 9; 2 + (9 - 2) / 2.
    _, low, high = limits_of_agreement([0.0, 2.0, 3.0, 5.0], list("aabb"))
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt(5.5))


@pytest.mark.slow
def test_figures_where_there_is_enough(tmp_path):
    def row(subject, trial, signal, value):
        return Row(subject, trial, "predict", signal, value, "N", *"hvf")

    rows = [
        row(s, t, "rmsd.grf_n.vertical", 5.0) for s in "ab" for t in ("1", "2")
    ]
    assert list(draw_figures(tmp_path, rows)) == ["over_subjects.png"]
    for k in range(4):
        rows.append(row("a", str(k), PREDICTED + "force", 10.0 + k))
        rows.append(row("a", str(k), MEASURED + "force", 11.0))
    assert list(draw_figures(tmp_path, rows)) == [
        *("over_subjects.png", "bland_altman.png"),
    ]
    assert (tmp_path / "bland_altman.png").read_bytes().startswith(b"\x89PNG")
    assert draw_figures(tmp_path, []) == {}


@pytest.mark.slow
def test_each_variant_has_figures_of_its_own(tmp_path):
    rows = [
        replace(_row("a", "1", "rmsd.grf_n.vertical", 5.0), variant=v)
        for v in ("m=1", "m=2")
    ]
    drawn = draw_figures(tmp_path, rows)
    assert list(drawn) == ["over_subjects_m=1.png", "over_subjects_m=2.png"]
    assert drawn["over_subjects_m=2.png"].startswith("m=2: RMSD")
    assert all((tmp_path / name).is_file() for name in drawn)


@pytest.mark.slow
def test_a_swept_sole_leaves_figures_of_studies_as_they_are(tmp_path):
    rows = [
        replace(
            _row("sole", "", "c_rot", 5.0), phase="sole simulate", variant=v
        )
        for v in map(str, range(results._MOST_VARIANTS))
    ]
    rows.append(replace(_row("a", "1", "rmsd.grf_n.vertical", 5.0), variant=""))
    assert list(draw_figures(tmp_path, rows)) == ["over_subjects.png"]


def _row(subject, trial, signal, value):
    return Row(subject, trial, "predict", signal, value, "N", *"hvf")


def test_a_panel_holds_differences_over_means():
    """A dot a trial, predicted less measured; their mean as a line."""
    pairs = {"1": (10.0, 14.0), "2": (30.0, 28.0), "3": (55.0, 60.0)}
    rows = []
    for trial, values in pairs.items():
        for source, value in zip((PREDICTED, MEASURED), values, strict=True):
            rows.append(_row("a", trial, f"{source}force", value))
    (ax,) = (a for a in results._bland_altman(rows).axes if a.get_visible())
    (dots,) = ax.collections
    expected = [(12.0, -4.0), (29.0, 2.0), (57.5, -5.0)]
    np.testing.assert_allclose(dots.get_offsets(), expected)
    drawn = [line.get_ydata()[0] for line in ax.lines]
    sd = np.sqrt((25.0 + 169.0 + 64.0) / 9.0 / 2.0)
    bias = -7.0 / 3.0
    np.testing.assert_allclose(
        drawn, [bias, bias - 1.96 * sd, bias + 1.96 * sd]
    )
    assert ax.get_title() == "peak force"
    assert ax.get_ylabel() == "predicted − measured [N]"
    said = [text.get_text().split("\n")[0].strip() for text in ax.texts]
    assert said == ["bias", "−1.96 SD", "+1.96 SD"]
    assert float(ax.texts[0].get_text()[6:].replace("−", "-")) == -2.33


@pytest.mark.slow
def test_colours_of_subjects_have_a_key():
    """Where there are several, and each has a colour of its own."""
    for count in (1, 3, 7):
        rows = [
            replace(_row(subject, trial, f"{source}force", 5.0), folder=subject)
            for subject in "abcdefg"[:count]
            for trial in "123"
            for source in (PREDICTED, MEASURED)
        ]
        figure = results._bland_altman(rows)
        ax = figure.axes[0]
        if count != 3:
            assert not figure.legends
            continue
        dots, *keys = ax.collections
        said = {key.get_label(): key.get_facecolor()[0] for key in keys}
        (legend,) = figure.legends
        assert [text.get_text() for text in legend.texts] == [*"abc"]
        figure.draw_without_rendering()
        box = legend.get_window_extent()
        assert not any(box.overlaps(a.get_tightbbox()) for a in figure.axes)
        np.testing.assert_array_equal(
            dots.get_facecolor()[::3], [said[name] for name in "abc"]
        )


@pytest.mark.slow
def test_figures_of_what_does_not_hold_are_marked(tmp_path):
    rows = [_row(s, "1", "rmsd.grf_n.vertical", 5.0) for s in "ab"]
    sound = [replace(row, verdict="holds") for row in rows]
    off = replace(rows[0], verdict="does not hold: audit", folder="a/predict")
    draw_figures(tmp_path, sound)
    assert unmarked(tmp_path) == ["over_subjects.png"]
    draw_figures(tmp_path, [off, *sound])
    assert unmarked(tmp_path) == []


def test_bars_are_means_over_subjects():
    """Of each subject's own mean, with the SD between subjects."""
    values = {("a", "1"): 2.0, ("a", "2"): 4.0, ("b", "1"): 7.0}
    rows = [
        _row(*key, "rmsd.grf_n.vertical", value)
        for key, value in values.items()
    ]
    (ax,) = results._over_subjects(rows).axes
    (bar,) = ax.patches
    assert bar.get_height() == pytest.approx(5.0)
    (segment,) = ax.collections[0].get_segments()
    half = np.sqrt(8.0)
    np.testing.assert_allclose(segment[:, 1], [5.0 - half, 5.0 + half])
    dots = ax.lines[-1].get_ydata()
    np.testing.assert_allclose(dots, [3.0, 7.0])
    assert ax.get_title() == "2 subjects"
    rows[-1] = _row("b", "1", "rmsd.grf_n.vertical", 70.0)
    (ax,) = results._over_subjects(rows).axes
    assert ax.get_ylim()[0] == 0.0  # whatever the SD
    (alone,) = results._over_subjects(rows[:2]).axes
    assert not alone.collections  # one subject has no SD, not one of 0
    rows.append(_row("c", "1", "rmsd.grf_n.horizontal", 1.0))
    (ax,) = results._over_subjects(rows).axes
    assert ax.get_title() == "1 to 2 subjects"
    # As in tables, whatever comes first.
    rows = [
        _row("a", "1", f"rmsd.angles_deg.{n}", 1.0) for n in ("hip", "knee")
    ]
    (ax,) = results._over_subjects(rows).axes
    assert [t.get_text() for t in ax.get_xticklabels()] == ["knee", "hip"]


def test_numbers_of_an_earlier_study_are_not_told(batch):
    anna = replace(batch.tasks[0], key="of another file")
    lost = outcome(anna, None, "not begun: it builds on what failed")
    found = Batch(batch.out, (anna,), {anna.name: lost}, 0)
    (row,) = rows_of(found)
    assert row.value is None and "not begun" in row.verdict


def test_numbers_of_phase_a_are_told_beside_those_of_b(batch):
    both = {"objective": 1.0, "foot_ground": SUMMARY}
    write_json(batch.out / "anna/calibrate/summary.json", both)
    found = {r.signal: r.value for r in rows_of(batch) if r.subject == "anna"}
    assert found["foot_ground.parameters.heel.x"] == 0.01
    assert found["foot_ground.rmsd.grf_n.vertical"] in (12.0, 14.0)
    assert found["objective"] == 1.0
