"""Results on disk become the paper's tables and figures."""

import csv
import json

import numpy as np
import pytest

from drake_exo.calibration.results import read_trajectory, write_trajectories
from drake_exo.cli import main
from drake_exo.files.output import write_json
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import COUPLED_COORDINATES


def leave(folder, twin, phase, **more):
    """What a phase leaves behind, as far as a report looks."""
    from drake_exo.calibration.problem import Trajectory
    from drake_exo.calibration.scores import rmsd, spread

    folder.mkdir(parents=True)
    found = []
    for t in twin.trials:
        Trial(
            t.name,
            COUPLED_COORDINATES,
            t.times,
            t.q,
            t.v,
            t.a,
            t.ground[:, :2],
            t.ground[:, 2],
            75.0,
            moments=t.moments,
            normal_force=t.normal_force,
        ).save(folder / f"measured_{t.name}")
        n = len(t.times)
        trajectory = Trajectory(
            t.name,
            t.times,
            t.q,
            t.v,
            t.a,
            np.zeros((n, 9)),
            t.moments + 2.0,
            t.ground,
            np.full((n, 9), more.get("force", 3.0)),
        )
        found.append(trajectory)
    write_trajectories(folder, found)
    summary = {
        "phase": phase,
        "subject": "virtual_subject",
        "rmsd": [rmsd(f, t) for f, t in zip(found, twin.trials, strict=True)],
        "measured_sd": spread(twin.trials),
        **more,
    }
    write_json(folder / "summary.json", summary)
    return found


@pytest.fixture(scope="module")
def twin():
    from drake_exo.virtual_laboratory.interaction_twin import interaction_twin

    return interaction_twin(duration_s=0.8)


@pytest.fixture(scope="module")
def folder(twin, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    leave(folder / "cal" / "foot_ground", twin, "foot-ground")
    leave(folder / "b", twin, "interaction")
    leave(folder / "c1", twin, "prediction", scale_interaction=1.0)
    leave(folder / "c2", twin, "prediction", scale_interaction=1.4, force=60.0)
    assert main(["report", str(folder)]) == 0
    return folder


def test_tables_and_figures_are_there(folder):
    names = {p.name for p in (folder / "report").iterdir()}
    assert {f"figure_{k}.png" for k in range(2, 8)} <= names
    assert {"table_2.csv", "table_3.csv", "tables.txt"} <= names


def test_table_holds_the_numbers_of_the_summaries(folder):
    with (folder / "report" / "table_3.csv").open() as file:
        rows = {row["signal"]: row for row in csv.DictReader(file)}
    summary = json.loads((folder / "c2" / "summary.json").read_text("utf-8"))
    values = [
        r["interaction_n"]["pelvis"]
        for r in summary["rmsd"]
        if "pelvis" in r["interaction_n"]
    ]
    assert len(values) == 2
    row = rows["normal force pelvis [N]"]
    assert float(row["C2 mean"]) == pytest.approx(np.mean(values))
    assert float(row["C2 SD"]) == pytest.approx(np.std(values, ddof=1))
    assert row["paper C2"] == "> 30"
    assert float(rows["moment knee [N m]"]["C1 mean"]) == pytest.approx(2.0)
    assert rows["angle knee [deg]"]["measured SD"]


def test_trajectories_survive_disk(twin, tmp_path):
    (found, *_) = leave(tmp_path / "x", twin, "interaction")
    back = read_trajectory(tmp_path / "x", found.name)
    np.testing.assert_array_equal(back.interaction, found.interaction)
    np.testing.assert_array_equal(back.q, found.q)


def test_a_folder_without_results_is_one_sentence(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "no results" in error and error.count("\n") == 1
