"""Processes, tables and the front of the study, on tiny cases."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_step import stage, write_case, write_step
from unmarked import unmarked

from drake_exo.files.output import Check, Verdict
from drake_exo.papers import de_magistris as paper
from drake_exo.papers.de_magistris import TABLE_2, certainty_table, table
from drake_exo.soles.case import Case
from drake_exo.soles.load_blocks import LoadBlock
from drake_exo.soles.optimize import search
from drake_exo.soles.optimize.files import find_designs, read_summary
from drake_exo.soles.settings import Stage
from drake_exo.soles.walking_pattern import Robot


@pytest.mark.slow
def test_a_study_runs_its_cases_side_by_side(tmp_path, capsys):
    write_step(tmp_path / "load.csv", 8)
    cases = []
    for name in ("1-Ref", "2-Rot", "3-Rubber"):
        path = tmp_path / f"{name}.yaml"
        write_case(path, name, stages=[stage(4, 5e-5, 2)])
        cases.append(Case.read(path))
    cases[2] = replace(cases[2], mesh=None)
    out = tmp_path / "out"
    out.mkdir()
    study = paper.Study("a small step", "all", {"cases": cases})
    verdict, text = study.run(out, 2)
    said = capsys.readouterr().out
    assert "1-Ref: c " in said and "3-Rubber/optimize: " in said
    assert "2-Rot" in text
    (failed,) = (c for c in verdict.checks if c.where == "3-Rubber/optimize")
    assert failed.name == "solved" and failed.sentence
    rows = json.loads((out / "summary.json").read_text("utf-8"))["cases"]
    assert [row["name"] for row in rows] == ["1-Ref", "2-Rot"]
    assert not list(out.rglob("*.log"))
    # Two iterations find no optimum, and that is told.
    for name in ("1-Ref", "2-Rot"):
        (note,) = (
            c for c in verdict.checks if (c.name, c.where) == ("optimum", name)
        )
        assert not note.holds and note.level == "note"
        why = "before it was optimal (iteration limit); go on (resume)"
        assert why in note.sentence
    # One of three has failed, another is made to: what shows all says so.
    off = Check("plausibility.strain", False, 0.8, 0.6)
    path = out / "1-Ref" / "summary.json"
    row = json.loads(path.read_text("utf-8")) | Verdict((off,)).summary()
    path.write_text(json.dumps(row), encoding="utf-8")
    paper.report(out, find_designs(out), out)
    assert len(list(out.glob("*.png"))) >= 3 and list(out.glob("*.html"))
    assert not [name for name in unmarked(out) if "/" not in name]


def test_the_papers_optimum_is_rescaled_to_our_brick():
    row = {"name": "2-Rot", "weight": 1000.0, "c_tr_initial": 2.0e6,
           "c_rot_initial": 1.0e5}  # fmt: skip
    tr0, tr, rot0, rot = TABLE_2["2-Rot"]
    expected = 2.0e6 * tr / tr0 - 1000 * 1.0e5 * rot / rot0
    assert paper.paper_cost(row) == pytest.approx(expected)


def test_certainty_table_marks_what_is_unknown():
    row = {
        "name": "1-Ref", "c": 5.0e5, "weight": 1.0, "c_tr_initial": 3.5e6,
        "c_rot_initial": 1.5e5, "optimality_error": 2.5e-3,
        "exact_change": 0.004, "finer": {"change": 0.03}, "max_strain": 0.3,
        "tilt_max_deg": 19.0, "stable": True, "seconds": 12.0,
    }  # fmt: skip
    line = certainty_table([row]).splitlines()[-1]
    assert "2.5e-03" in line
    assert "+0.40%" in line
    assert "+3.00%" in line
    assert " - " in line
    # Files are the same, however long it took.
    slower = row | {"seconds": 99.0}
    assert certainty_table([slower]) == certainty_table([row])
    costs = {"tets": 9, "c_tr": 4e5, "ratio_tr": 0.1, "c_rot": 3e5,
             "ratio_rot": 0.9, "volume_cm3": 8e2, "optimal": True}  # fmt: skip
    row |= costs | {"finer": None}
    assert paper.line(row | {"seconds": 99.0}) == paper.line(row)
    lost = {"c": np.nan, "failed_steps": 2}
    lost = {"tets": 99, "change": np.nan, "brick_change": 0.01, "design": lost}
    row |= {"finer": lost}
    assert "c 5e+05 on 9 tets, no equilibrium on 99 tets; " in paper.line(row)
    assert "nan" not in certainty_table([row]) + paper.line(row)
    row |= {"finer": None}
    row["gait"] = {"walk": {"step_time": [0.9, 0.8], "aim_x": [0, 0.01]}}
    walk = "; walk: step_time 0.9 → 0.8, aim_x 0 → 0.01"
    assert paper.line(row).endswith(walk)


def test_a_design_without_costs_has_its_line(tmp_path):
    row = {
        "name": "3-Rubber", "c": None, "c_tr": None, "c_rot": None,
        "ratio_tr": None, "ratio_rot": None, "weight": 1.0,
        "c_tr_initial": 3.5e6, "c_rot_initial": 1.5e5, "exact_change": None,
        "max_strain": 0.3, "tilt_max_deg": 19.0, "stable": False,
        "seconds": 12.0,
    }  # fmt: skip
    (tmp_path / "summary.json").write_text(json.dumps(row), encoding="utf-8")
    read = read_summary(tmp_path)
    assert np.isnan(read["ratio_rot"])
    assert read["exact_change"] is None
    for text in (table([read]), certainty_table([read])):
        assert " nan " in text.splitlines()[-1]


@pytest.mark.slow
def test_a_point_of_the_front_holds_its_floor(tmp_path):
    write_step(tmp_path / "load.csv", 10)
    write_case(
        tmp_path / "case.yaml", "1-Ref", intervals=[3, 3], roughness=10.0,
        strain=None,
    )  # fmt: skip
    case = Case.read(tmp_path / "case.yaml")
    # Far above its own optimum so few elements make the search erratic: stick
    # and slip are smooth, and it may go on until it has converged.
    tiny = [Stage((4, 3, 2), 10, layer, 0.5, 200) for layer in (3e-4, 5e-5)]
    (point,) = search.pareto_front(case, (0.4,), stages=tiny)
    # To the per cent that a limit is checked to: how far it comes changes with
    # the versions of BLAS. Then by the exact law.
    assert point["violation"] < 0.01
    assert point["ratio_rot"] > 0.99 * 0.4
    assert point["ratio_tr"] < 0.6
    assert point["failed_steps"] == 0
    assert "0.400" in paper.front_table([point])


def test_a_study_collects_its_fronts(tmp_path, monkeypatch):
    def points(case, floors, say):
        return [
            {
                "case": case.name, "floor": f, "ratio_tr": 0.1, "c_tr": 1.0,
                "c_rot": 2.0, "ratio_rot": 2.0, "optimality_error": np.inf,
                "violation": np.nan, "failed_steps": 0,
            }
            for f in floors
        ]  # fmt: skip

    monkeypatch.setattr(paper, "pareto_front", points)
    five = paper.five_cases(LoadBlock(pattern=Robot()), coarse=True)
    cases = [Case.open(settings) for settings in five[:3]]
    for case in cases[:2]:  # the third ended without
        (tmp_path / case.name).mkdir()
        paper.pareto_job(tmp_path / case.name, case, str)
    found = paper.study_front(tmp_path, cases)
    assert [p["floor"] for p in found["points"]] == list(paper.FLOORS)
    assert len(paper.FLOORS) >= 7
    tr0, tr, rot0, rot = TABLE_2["2-Rot"]
    first, other = found["at_paper"]
    assert first["floor"] >= TABLE_2["1-Ref"][3] / TABLE_2["1-Ref"][2]
    assert other["floor"] == rot / rot0
    assert other["paper_ratio_tr"] == tr / tr0
    assert "paper_ratio_tr" not in found["points"][1]
    # JSON knows no NaN; what is not known keeps no limit.
    assert paper.front_table(found["points"]).count(" nan") == 8
    checks = search.front_checks(found["points"])
    failed = [c for c in checks if not c.holds]
    assert {c.name for c in failed} == {"bounds.limits"} and len(failed) == 8
    assert failed[0].where == "1-Ref, floor 0.972"
