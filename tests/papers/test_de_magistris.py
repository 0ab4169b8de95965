"""The study of five soles: what it runs, tells and draws, without a sole."""

import base64
import json
from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.errors import InputError
from drake_exo.files.output import Check, Verdict
from drake_exo.jobs.engine import Ended, Job
from drake_exo.papers import de_magistris as paper
from drake_exo.soles import pictures
from drake_exo.soles.load_blocks import LoadBlock
from drake_exo.soles.walking_pattern import Robot


def test_a_data_root_means_the_authors_step(tmp_path):
    assert paper.step_block(None) == LoadBlock(pattern=Robot())
    for root, words in (
        (tmp_path, f"{paper.AUTHORS_STEP}: cannot be read"),
        (tmp_path / "none", r"data_root \(--data-root\)"),
    ):
        with pytest.raises(InputError, match=words):
            paper.Study.read(root)


def test_the_five_cases_differ_in_one_thing_each():
    """Table 1: weight of rotation, rubber, straight step, bonded top."""
    five = paper.five_cases(LoadBlock(pattern=Robot()), coarse=False)
    assert [case.name for case in five] == list(paper.TABLE_2)
    first = vars(five[0])
    for case, own in zip(
        five[1:], ("cost", "material", "load", "optimize"), strict=True
    ):
        changed = {k for k, v in vars(case).items() if v != first[k]}
        assert changed == {"name", own}
    assert [case.cost.weight for case in five] == [1.0, 1e3, 1.0, 1.0, 1.0]
    assert five[3].load.straight and five[4].optimize.fixed_top
    assert five[0].optimize.stages == paper.STAGES
    # Meshed as its last stage, or coarsely.
    brick = five[0].mesh.brick
    assert brick.size_m == (0.23, 0.13, 0.03)  # of the paper
    assert brick.divisions == paper.STAGES[-1].divisions
    coarse = paper.five_cases(LoadBlock(pattern=Robot()), coarse=True)[0]
    assert coarse.mesh.brick.divisions == (10, 6, 3)


@pytest.fixture
def ran(tmp_path, monkeypatch, capsys):
    """A study whose jobs write what they would; how it ended."""
    cases = {
        key: [SimpleNamespace(name=name) for name in ("1-Ref", "2-Rot")]
        for key in ("cases", paper.UNLIMITED)
    }
    seen = SimpleNamespace(jobs=[], drawn=[], clock=iter(np.arange(100.0)))

    def run_jobs(jobs, pool, end, progress):
        ended = {}
        for job in jobs:
            seen.jobs.append(job.name)
            folder = job.arguments.get("folder")
            lost = job.name.startswith("2-Rot/stage")
            skipped = job.name == "2-Rot/optimize"
            if job.name.endswith("optimize") and not skipped:
                name = f"{folder.parent.name}/{folder.name}"
                row = {"name": folder.name, "of": name}
                solved = Check("solved", True, where=folder.name)
                row |= Verdict((solved,)).summary()
                (folder / "summary.json").write_text(json.dumps(row))
            state = "failed" if lost else "skipped" if skipped else "done"
            why = "no end" if lost else "not begun"
            value = "fine" if state == "done" else None
            cause = "no end" if skipped else ""
            ended[job.name] = Ended(job.name, state, value, why, cause=cause)
            end(ended[job.name])
        return ended

    def told(word):
        return lambda rows: f"{word} of {len(rows)}"

    def search_jobs(case, folder, name):
        return [Job(f"{name}stage {k}", "") for k in (1, 2)]

    for name, value in (
        ("run_jobs", run_jobs),
        ("search_jobs", search_jobs),
        ("table", told("table")),
        ("certainty_table", told("certainty")),
        ("front_table", told("front")),
        ("study_front", lambda folder, of: {
            "points": ["a", "b"], "at_paper": ["b", "c"], "in": folder.name}),
        ("front_checks", lambda points: [
            Check("bounds.limits", p != "b", where=f"point {p}")
            for p in points]),
        ("draw_pareto_front", lambda *said: seen.drawn.append(said)),
    ):  # fmt: skip
        monkeypatch.setattr(paper, name, value)
    clock = SimpleNamespace(perf_counter=lambda: next(seen.clock))
    monkeypatch.setattr(paper, "time", clock)
    out = tmp_path / "out"
    out.mkdir()
    study = paper.Study("a step", "both", cases)
    seen.verdict, seen.text = study.run(out, 1, with_pareto_front=True)
    seen.said = capsys.readouterr().out
    seen.out, seen.summary = out, json.loads((out / "summary.json").read_text())
    return seen


def test_a_study_has_a_folder_a_case_and_one_for_those_without_limits(ran):
    cases = ("1-Ref", "2-Rot", "unlimited/1-Ref", "unlimited/2-Rot")
    kinds = ("stage 1", "stage 2", "optimize")
    assert ran.jobs == [f"{c}/{kind}" for c in cases for kind in kinds] + [
        f"{c}/front" for c in cases
    ]
    assert [r["of"] for r in ran.summary["cases"]] == ["out/1-Ref"]
    assert [r["of"] for r in ran.summary["unlimited"]] == [
        "unlimited/1-Ref", "unlimited/2-Rot",
    ]  # fmt: skip
    assert ran.summary["front"]["in"] == "out"
    assert ran.summary["unlimited_front"]["in"] == "unlimited"
    assert (ran.summary["load"], ran.summary["limits"]) == ("a step", "both")
    # Noted eight times, a second after each other.
    assert ran.summary["total_seconds"] == 8.0


def test_who_failed_and_who_holds_is_in_the_verdict(ran):
    found = {
        c.where: c.holds for c in ran.verdict.checks if "point" not in c.where
    }
    assert found == {
        "2-Rot/optimize": False,
        "1-Ref": True,
        "unlimited/1-Ref": True,
        "unlimited/2-Rot": True,
    }
    (failed,) = (c for c in ran.verdict.failing if c.name == "solved")
    assert failed.sentence == "no end"
    assert "2-Rot/optimize: no end\n" in ran.said
    assert ran.said.count("fine\n") == 7 and "stage" not in ran.said
    assert ran.said.count("unlimited/fine\n") == 4
    assert ran.summary["verdict"] == ran.verdict.summary()["verdict"]


def test_every_point_of_a_study_s_fronts_is_checked_once(ran):
    found = [
        (c.where, c.holds)
        for c in ran.verdict.checks
        if c.name == "bounds.limits"
    ]
    assert found == [
        (f"{below}point {p}", p != "b")
        for below in ("", "unlimited/")
        for p in ("a", "b", "c")
    ]
    assert {c["where"] for c in ran.summary["checks"]} >= dict(found).keys()


def test_tables_of_a_study_stand_one_after_the_other(ran):
    """Points of the paper's ratio that are on the front are told once."""
    assert ran.text == (
        "table of 1\n\ncertainty of 1\n\nfront of 3\n\n"
        "without limits\ntable of 2\n\ncertainty of 2\n\nfront of 3"
    )
    assert ran.text in (ran.out / "table.txt").read_text("utf-8")
    ((out, fronts, rows, mark),) = ran.drawn
    assert out == ran.out and mark == ran.verdict.mark
    assert fronts == {"front": ["a", "b"], "unlimited front": ["a", "b"]}
    assert len(rows) == 1


def test_the_papers_designs_are_drawn_by_their_ratios(tmp_path, monkeypatch):
    """Of Table 2: 8.06e5 of 3.88e6 and 1.74e5 of 1.79e5, and so on."""
    seen = []
    monkeypatch.setattr(
        pictures, "pareto_figure", lambda *said: seen.extend(said)
    )
    monkeypatch.setattr(paper, "save_figure", lambda *said: seen.extend(said))
    paper.draw_pareto_front(tmp_path, {"a": []}, ["row"], "mark")
    fronts, rows, ratios, path, _, mark = seen
    assert (fronts, rows, mark) == ({"a": []}, ["row"], "mark")
    assert path == tmp_path / "front.png"
    hand = {
        "1-Ref": (0.2077, 0.9721),
        "2-Rot": (1.1985, 1.9553),
        "3-Rubber": (0.1779, 0.8629),
        "4-Straight": (0.1116, 0.1713),
        "5-Fixed": (0.3119, 0.6480),
    }
    assert {n: pytest.approx(r, abs=1e-4) for n, r in hand.items()} == ratios
    assert paper.FLOORS[0] == pytest.approx(hand["1-Ref"][1], abs=1e-4)


def row(name, weight, tr0, tr, rot0, rot):
    return {
        "name": name, "weight": weight, "c_tr_initial": tr0, "c_tr": tr,
        "c_rot_initial": rot0, "c_rot": rot,
    }  # fmt: skip


def test_table_2_beside_ours_by_hand():
    """Ratios, changes against the first case, and c = c_tr - w c_rot."""
    rows = [
        row("1-Ref", 1.0, 4.0e6, 1.0e6, 2.0e5, 1.5e5),
        row("2-Rot", 1e3, 4.0e6, 5.0e6, 2.0e5, 3.0e5),
    ]
    lines = [line.split() for line in paper.table(rows).splitlines()[2:]]
    assert [line[0] for line in lines] == ["1-Ref", "ours", "2-Rot", "ours"]
    assert lines[0][1:] == [
        "paper", "3.88e+06", "8.06e+05", "0.208", "+0%", "1.79e+05",
        "1.74e+05", "0.972", "+0%", "3.70e+06", "6.32e+05",
    ]  # fmt: skip
    assert lines[3][1:] == [
        "4.00e+06", "5.00e+06", "1.250", "+400%", "2.00e+05", "3.00e+05",
        "1.500", "+100%", "-1.96e+08", "-2.95e+08",
    ]  # fmt: skip
    # 4.65e6 against 8.06e5, 3.50e5 against 1.74e5.
    assert (lines[2][5], lines[2][9]) == ("+477%", "+101%")
    # Without 1-Ref a case is compared with itself.
    (_, ours) = (x.split() for x in paper.table(rows[1:]).splitlines()[2:])
    assert (ours[4], ours[8]) == ("+0%", "+0%")
    # The paper's ratios on our brick: 4e6 1.1985 - 1e3 2e5 1.9553.
    cost = 4e6 * 4.65 / 3.88 - 1e3 * 2e5 * 3.5 / 1.79
    assert paper.paper_cost(rows[1]) == pytest.approx(cost)


def stored(folder, name):
    folder.mkdir()
    (folder / "drawing.png").write_bytes(name.encode())
    found = {"name": name} | Verdict((Check("solved", True),)).summary()
    return SimpleNamespace(name=name, folder=folder, summary=lambda: found)


def test_a_page_holds_its_tables_and_pictures(tmp_path, monkeypatch):
    monkeypatch.setattr(paper, "line", lambda row: f"line of {row['name']}")
    designs = [stored(tmp_path / name, name) for name in ("a&b", "c")]
    (tmp_path / "table.txt").write_text("the table")
    (tmp_path / "soles.png").write_bytes(b"soles")
    tables = tmp_path / "table.txt"
    pictures = [tmp_path / name for name in ("soles.png", "front.png")]
    told = {d.name: paper._told(d, d.summary()) for d in designs}
    paper._write_page(tmp_path, designs, told, tables, pictures, "strains")
    page = (tmp_path / "report.html").read_text()
    held = [
        base64.b64decode(part.partition('"')[0]).decode()
        for part in page.split("base64,")[1:]
    ]
    assert held == ["soles", "a&b", "c"]
    assert "<title>Soles: a&amp;b, c</title>" in page
    order = [
        page.index(f"<pre>{x}</pre>")
        for x in ("the table", "strains", "line of a&amp;b", "line of c")
    ]
    assert order == sorted(order)
    assert 'alt="soles"' in page and "front" not in page


def test_stiffness_is_drawn_of_both_shapes_up_to_heel_strike(
    tmp_path, monkeypatch
):
    """A fifth of fifty samples is ten."""
    keys = "time_s,sigma_max_tr_n_per_m,sigma_min_rot_nm_per_rad"
    designs = []
    for k, name in enumerate("ab"):
        (tmp_path / name).mkdir()
        for file, size in (("initial_steps.csv", 1.0), ("steps.csv", 2.0)):
            text = f"other,{keys}\n" + "".join(
                f"9,{t},{size + k},{10 * size + t}\n" for t in range(3)
            )
            (tmp_path / name / file).write_text(text)
        setup = SimpleNamespace(
            load=SimpleNamespace(phases=[slice(0, 50 * (k + 1))]),
            settings=SimpleNamespace(
                cost=SimpleNamespace(heel_strike_fraction=0.2)
            ),
        )
        designs.append(
            SimpleNamespace(name=name, folder=tmp_path / name, setup=setup)
        )
    monkeypatch.setattr(pictures, "stiffness_figure", lambda *said: said)
    soles, strikes = paper._stiffness(designs)
    assert strikes == [(0, 10)]
    assert list(soles) == ["a", "b"]
    for k, name in enumerate("ab"):
        for label, size in (("initial", 1.0), ("optimised", 2.0)):
            time, tr, rot = (soles[name][label][k] for k in keys.split(","))
            np.testing.assert_array_equal(time, [0.0, 1.0, 2.0])
            np.testing.assert_array_equal(tr, size + k)
            np.testing.assert_array_equal(rot, 10 * size + time)
