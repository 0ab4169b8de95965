"""The commands `sole strain` and `sole report` on what an optimiser left."""

import csv
import json
import shutil

import numpy as np
import pytest
from page_reader import player_data
from small_step import optimize, stage, write_case, write_step

from drake_exo import cli
from drake_exo.errors import InputError
from drake_exo.files.output import Check, Verdict
from drake_exo.soles import finite_strain
from drake_exo.soles.animation import replay_soles
from drake_exo.soles.case import Case
from drake_exo.soles.loads import read_columns
from drake_exo.soles.mesh import read_mesh
from drake_exo.soles.optimize.files import find_designs

pytestmark = pytest.mark.slow


def _write_inputs(place, name="small", element="linear"):
    case = place / f"{name}.yaml"
    stages = [stage(4, 5e-5, 2)]
    write_case(case, name, (5, 4, 2), element, intervals=[5, 5], stages=stages)
    write_step(place / "load.csv", 30, 0.02, 300.0)
    return case


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A folder as `sole study` leaves it, with one design."""
    place = tmp_path_factory.mktemp("strain")
    case = _write_inputs(place)
    folder = place / "study"
    assert optimize(case, folder / "small") == 0
    row = json.loads((folder / "small" / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({"cases": [row]}))
    return folder


def test_an_optimised_design_is_judged_in_finite_strain(study):
    row = json.loads((study / "small" / "summary.json").read_text())
    found = row["finite_strain"]
    assert found["heel_strike_samples"] == found["converged_samples"] == 3
    assert [s["sample"] for s in found["samples"]] == [1, 2, 3]
    for sample in found["samples"]:
        small, finite = (
            sample[f"sigma_max_tr_n_per_m_{k}"] for k in ("small", "finite")
        )
        assert finite == pytest.approx(small, rel=0.5)
        assert finite != pytest.approx(small, rel=1e-4)
        assert sample["largest_stretch_finite"] > 1
        assert 0 < sample["least_stretch_finite"] < 1


def test_the_stored_design_gives_the_same_figures(study, tmp_path):
    """Mesh, load and start survive the folder."""
    code = cli.main(
        ["sole", "strain", str(study), "--out", str(tmp_path / "out")]
    )
    assert code == 0
    again = json.loads((tmp_path / "out" / "summary.json").read_text())
    row = json.loads((study / "small" / "summary.json").read_text())
    for one, other in zip(
        again["cases"][0]["finite_strain"]["samples"],
        row["finite_strain"]["samples"],
        strict=True,
    ):
        assert one == pytest.approx(other, rel=1e-5)
    with open(tmp_path / "out" / "finite_strain.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["sole"] for r in rows] == ["small"] * 3
    text = (tmp_path / "out" / "finite_strain.txt").read_text()
    assert "σ_max(K_tr)" in text


def test_the_table_of_a_design_that_does_not_hold_says_so(study, tmp_path):
    folder = tmp_path / "small"
    shutil.copytree(study / "small", folder)
    path = folder / "summary.json"
    off = Check("bounds.tilt", False, 33.0, 20.0, "°", "small", "leans")
    row = json.loads(path.read_text()) | Verdict((off,)).summary()
    path.write_text(json.dumps(row))
    assert cli.main(["sole", "strain", str(folder), "--force"]) == 0
    text = (folder / "finite_strain.txt").read_text()
    assert text.startswith(f"DOES NOT HOLD: small: {off.name} (small, 33 °")


def test_results_are_not_overwritten_unasked(study, capsys):
    assert cli.main(["sole", "strain", str(study / "small")]) == 2
    assert "--force" in capsys.readouterr().err
    for job in ("strain", "report"):
        for out in (study, study / "small"):
            where = [str(study / "small"), "--out", str(out), "--force"]
            assert cli.main(["sole", job, *where]) == 2
            assert "would replace" in capsys.readouterr().err
    for option in ("--mesh", "--data-root"):
        where = [str(study), "--out", str(study / "new"), option, str(study)]
        assert cli.main(["sole", "strain", *where]) == 2
        assert "are for a case file; leave them" in capsys.readouterr().err
    assert not (study / "new").exists()


def test_a_case_file_is_judged_without_optimising(tmp_path):
    case = _write_inputs(tmp_path, "brick")
    assert cli.main(["sole", "strain", str(case)]) == 2
    out = tmp_path / "out"
    assert cli.main(["sole", "strain", str(case), "--out", str(out)]) == 0
    cases = json.loads((out / "summary.json").read_text())["cases"]
    assert cases[0]["finite_strain"]["converged_samples"] == 3


def test_whatever_the_elements_both_strains_are_in_linear_ones(tmp_path):
    found = [
        finite_strain.compare_strains(Case.read(case))
        for case in (
            _write_inputs(tmp_path, "one", "smoothed"),
            _write_inputs(tmp_path, "other", "linear"),
        )
    ]
    assert found[0] == found[1]


def test_a_folder_without_designs_is_refused(tmp_path, capsys):
    assert cli.main(["sole", "strain", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "holds no design" in told and "also a case file" in told


def test_a_table_with_samples_that_fail_replaces_an_earlier_one(
    study, tmp_path, monkeypatch
):
    """In another folder as in the design's own: that they fail is its news."""
    own, out = tmp_path / "own", tmp_path / "out"
    shutil.copytree(study / "small", own)
    found = json.loads((own / "summary.json").read_text())["finite_strain"]
    where = ["sole", "strain", str(own)]
    assert cli.main([*where, "--out", str(out)]) == 0
    failed = {"sample": 2, "reached": 0.5, "message": "no equilibrium"}
    monkeypatch.setattr(
        "drake_exo.soles.compare_strains",
        lambda *given: found | {"failures": [failed]},
    )
    for more in (["--out", str(out)], []):
        assert cli.main([*where, *more, "--force"]) == 1
    assert not out.with_name("out.partial").exists()
    for folder in (own, out):
        text = (folder / "finite_strain.txt").read_text()
        assert "sample 2: no equilibrium" in text


def test_designs_side_by_side_are_found_without_a_summary(study, tmp_path):
    """As a study leaves those without limits."""
    for name in ("b", "a"):
        shutil.copytree(study / "small", tmp_path / name)
    found = find_designs(tmp_path)
    assert [design.folder.name for design in found] == ["a", "b"]


def test_pictures_are_drawn_again_from_the_folders(study, tmp_path):
    """Of two designs, the same bytes each time."""
    pair = tmp_path / "pair"
    for name in ("small", "twin"):
        shutil.copytree(study / "small", pair / name)
        text = (study / "small" / "case.yaml").read_text()
        (pair / name / "case.yaml").write_text(
            text.replace("name: small", f"name: {name} <b>", 1)
        )
    said = pair / "twin" / "summary.json"
    row = json.loads(said.read_text())
    row["checks"][0]["holds"] = False
    said.write_text(json.dumps(row))
    rows = [{"name": "small"}, {"name": "twin"}]
    (pair / "summary.json").write_text(json.dumps({"cases": rows}))
    # What the study alone can write; of the table one byte is damaged.
    (pair / "table.txt").write_bytes(b"Table 2\xff")
    (pair / "front.png").write_bytes(b"front")
    out = tmp_path / "out"
    assert cli.main(["sole", "report", str(pair), "--out", str(out)]) == 0
    pictures = ("soles.png", "stiffness.png", "histories.png")
    first = [(out / name).read_bytes() for name in pictures]
    assert min(map(len, first)) > 10_000
    again = ["sole", "report", str(pair), "--out", str(out), "--force"]
    assert cli.main(again) == 0
    assert [(out / name).read_bytes() for name in pictures] == first
    text = (out / "finite_strain.txt").read_text()
    mark, *lines = text.splitlines()
    assert mark == "DOES NOT HOLD: twin <b>: NOT SOLVED: solved (small)"
    assert sum(line.startswith("twin <b> ") for line in lines) == 3
    page = (out / "report.html").read_text()
    assert "://" not in page
    assert page.count("data:image/png;base64,") == 3 + 2 + 1
    assert "<pre>Table 2" in page and 'alt="front"' in page
    assert "<h2>twin &lt;b&gt;</h2>" in page and "<b>" not in page
    assert page.count('class="mark"') == 1
    animation = tmp_path / "animation.html"
    replay_soles(pair, animation)
    marks = [clip["mark"] for clip in player_data(animation)["clips"]]
    assert sum(map(bool, marks)) == 1  # not that of its first shape


def test_a_design_s_stl_is_told(study):
    told = json.loads((study / "small" / "summary.json").read_text())["stl"]
    sole, mould = told["sole.stl"], told["mould.stl"]
    assert sole["watertight"] and mould["watertight"]
    mesh = read_mesh(study / "small" / "sole.vtk", (0.0, 0.0, 0.0))
    assert sole["height_mm"] == pytest.approx(-1e3 * mesh.nodes[:, 2].min())
    assert 0 < sole["least_depth_mm"] <= sole["height_mm"]


def test_a_sample_not_reached_is_nan_in_table_and_csv(study, tmp_path):
    """The summary says null there."""
    folder = tmp_path / "small"
    shutil.copytree(study / "small", folder)
    row = json.loads((folder / "summary.json").read_text())
    row["finite_strain"]["c_tr_finite"] = None
    row["finite_strain"]["samples"][0]["tilt_deg_finite"] = None
    (folder / "summary.json").write_text(json.dumps(row))
    out = tmp_path / "out"
    assert cli.main(["sole", "report", str(folder), "--out", str(out)]) == 0
    with open(out / "finite_strain.csv", newline="") as file:
        assert next(csv.DictReader(file))["tilt_deg_finite"] == "nan"
    text = (out / "finite_strain.txt").read_text()
    assert text.count("nan") == 2


@pytest.mark.parametrize(
    "change",
    [
        lambda told: told["samples"][0].update(tilt_deg_small="12"),
        lambda told: told["samples"][1].pop("stability_n_per_m_small"),
        lambda told: told["samples"].clear(),
        lambda told: told.update(failures=7),
        lambda told: told.pop("samples"),
    ],
)
def test_a_changed_table_is_refused(study, tmp_path, change, capsys):
    """Before anything is drawn."""
    folder = tmp_path / "small"
    shutil.copytree(study / "small", folder)
    row = json.loads((folder / "summary.json").read_text())
    change(row["finite_strain"])
    (folder / "summary.json").write_text(json.dumps(row))
    out = tmp_path / "out"
    assert cli.main(["sole", "report", str(folder), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "small/summary.json: finite_strain is damaged; run drake" in said
    assert not (out / "soles.png").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"checks": "x"}, "checks are not as a command writes them"),
        ({"active": None}, "is damaged; optimise the sole again"),
        ({"finer": {"design": {}}}, "is damaged; optimise the sole again"),
    ],
)
def test_a_changed_summary_is_refused(study, tmp_path, change, words, capsys):
    folder = tmp_path / "small"
    shutil.copytree(study / "small", folder)
    row = json.loads((folder / "summary.json").read_text()) | change
    (folder / "summary.json").write_text(json.dumps(row))
    out = tmp_path / "out"
    assert cli.main(["sole", "report", str(folder), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"small/summary.json: {words}" in said


def test_the_start_is_that_of_the_initial_shape(study):
    (design,) = find_designs(study)
    np.testing.assert_allclose(design.setup.start.point_L, [-0.115, 0.0, -0.03])


def test_a_collapse_stands_in_the_table():
    row = {"sample": 11, "converged": False, "reached": 0.4}
    for name in finite_strain._FIGURES:
        row |= {f"{name}_small": -0.5, f"{name}_finite": float("nan")}
    sole = {
        "heel_strike_samples": 21,
        "converged_samples": 10,
        "c_tr_small": 1.0,
        "c_tr_finite": float("nan"),
        "samples": [row],
        "failures": [
            {"sample": 11, "reached": 0.4,
             "message": "no equilibrium found beyond 0.400 of the way"}
        ],
    }  # fmt: skip
    text = finite_strain.table({"1-Ref": sole})
    assert "10 of 21 samples have an equilibrium" in text
    assert "no equilibrium found beyond 0.400" in text
    assert "inside out" in text
    assert "not stable" not in text
    row["stability_n_per_m_finite"] = -1.0
    assert "not stable at sample 11" in finite_strain.table({"1-Ref": sole})


def test_a_table_without_rows_is_read(tmp_path):
    """As a run leaves that had no iteration to do."""
    (tmp_path / "history.csv").write_text("stage,cost\n")
    given = tmp_path / "history.csv", ("cost",)
    columns = read_columns(*given, may_be_empty=True)
    assert {k: len(v) for k, v in columns.items()} == {"stage": 0, "cost": 0}
    with pytest.raises(InputError, match="holds no data rows"):
        read_columns(*given)


def test_columns_keep_their_order_when_read_again(study, tmp_path):
    """JSON has keys in the order of the alphabet."""
    row = json.loads((study / "small" / "summary.json").read_text())
    found = {"small": row["finite_strain"]}
    finite_strain.write_table(tmp_path, found)
    with open(tmp_path / finite_strain.TABLE, newline="") as file:
        names = next(csv.reader(file))
    assert names[:4] == ["sole", "sample", "converged", "reached"]
    assert set(names) == {"sole", *found["small"]["samples"][0]}
