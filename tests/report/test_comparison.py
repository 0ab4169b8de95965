"""Results side by side: what differs, and what cannot be compared."""

from dataclasses import replace

import numpy as np
import pytest
from unmarked import unmarked

from drake_exo.calibration.audit import rmsd
from drake_exo.calibration.results import (
    write_contact,
    write_model,
    write_trial,
)
from drake_exo.cli import main
from drake_exo.contact.parameters import nominal_contact
from drake_exo.errors import InputError
from drake_exo.files.output import Check, Verdict, write_json
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.model.plant import nominal_model
from drake_exo.report import figures
from drake_exo.report.gathering import _labels, compare
from drake_exo.virtual_laboratory import synthetic


@pytest.mark.parametrize(
    ("folders", "labels"),
    [
        (("out/s1/run", "out/s2/run"), ("s1", "s2")),
        (("out/s1/a/run", "out/s2/b/run"), ("s1/a", "s2/b")),
        (("s1/run", "s2/walk"), ("s1/run", "s2/walk")),
        (("out/s1", "out/s1/"), ("1: s1", "2: s1")),
        (("out", "out/s2"), ("out", "out/s2")),
    ],
)
def test_folders_are_told_apart_by_what_differs(folders, labels, tmp_path):
    assert _labels([tmp_path / folder for folder in folders]) == labels


@pytest.fixture(scope="module")
def trials():
    return synthetic.rises_in_device(duration_s=0.8, nodes_per_second=40).trials


MODEL = nominal_model("coupled")
CONTACT = nominal_contact(MODEL)


def leave(folder, trials, force, model=MODEL, contact=CONTACT, **more):
    """Results whose normal forces are off by `force` [N]."""
    folder.mkdir(parents=True)
    write_model(folder, model)
    write_contact(folder, contact)
    rows = []
    for trial in trials:
        trial.save(folder / f"measured_{trial.name}")
        cuffs = {
            name: replace(cuff, normal=cuff.normal + force)
            for name, cuff in trial.cuffs.items()
        }
        solved = replace(trial, source="solved", cuffs=cuffs)
        write_trial(folder, solved)
        rows.append(rmsd(solved, trial))
    summary = {
        "phase": "prediction",
        "success": True,
        "subject": "anna",
        "objective": "tracking",
        "rmsd": rows,
        "measured_sd": {},
        "checks": [],
        "settings": {"solver": {"tolerance": 1e-6}, "at": [0.0, 0.2]},
        "parameters": [
            {"name": "heel.x", "value": force, "unit": "m"},
        ],
    }
    write_json(folder / "summary.json", summary | more)
    return folder


@pytest.fixture
def folders(tmp_path, trials):
    settings = {"solver": {"tolerance": 1e-8}, "at": [0.0, 0.1 + 0.2]}
    return (
        leave(tmp_path / "anna" / "predict", trials, 5.0),
        leave(tmp_path / "bert" / "predict", trials, 20.0, settings=settings),
    )


@pytest.mark.slow
def test_side_by_side(folders, trials):
    found = compare(folders)
    assert found.labels == ("anna", "bert")
    assert found.trials == tuple(t.name for t in trials)
    assert found.settings() == {
        "settings.solver.tolerance": ["1e-06", "1e-08"],
        "settings.at": ["(0, 0.2)", "(0, 0.3)"],
    }
    assert found.parameters() == {"heel.x [m]": ["5", "20"]}
    cuff = next(iter(trials[0].cuffs))
    assert found.rmsd()[f"normal force {cuff} [N]"] == ["5.00", "20.00"]
    ours = found.forces()[f"normal force {cuff} [N]"]
    with_mat = [t.cuffs[cuff].normal for t in trials if cuff in t.cuffs]
    peaks = [
        np.mean([np.abs(x + f).max() for x in with_mat]) for f in (5, 20, 0)
    ]
    assert ours == [f"{p:.2f}" for p in peaks]


@pytest.mark.slow
@pytest.mark.parametrize("row", [True, {"name": "heel.x", "unit": "m"}])
def test_damaged_parameters_are_one_sentence(tmp_path, trials, row):
    sound = leave(tmp_path / "a", trials[:1], 5.0)
    damaged = leave(tmp_path / "b", trials[:1], 5.0, parameters=[row])
    with pytest.raises(InputError, match=r"measured_sd, parameters\); run"):
        compare([sound, damaged])


@pytest.mark.slow
def test_of_two_files_the_first_difference_is_told(tmp_path, trials):
    """Such as of two devices: a whole URDF would fill pages."""
    folders = []
    for name, mass in (("a", "1.7"), ("b", "3.4")):
        text = f'<link>\n<origin xyz="0 0 0.2"/><mass value="{mass}"/>\n</link>'
        asked = {"settings": {"text": text}}
        folders.append(leave(tmp_path / name, trials[:1], 0.0, **asked))
    assert compare(folders).settings() == {
        "settings.text": [
            'line 2: "0 0 0.2"/><mass value="1.7"/>',
            'line 2: "0 0 0.2"/><mass value="3.4"/>',
        ]
    }


@pytest.mark.slow
def test_model_contact_and_filter_count_among_settings(tmp_path, trials):
    filtered = [
        replace(
            t,
            provenance={
                "filter": {"cutoff_hz": 8.0},
                "delays_s": {"forces": 0.011, "pressure": -0.04804},
                "shifted_s": {"pressure": -0.03},  # told among the clocks
            },
        )
        for t in trials
    ]
    name = "thigh.normal_stiffness"
    stiff = CONTACT.with_values({name: 6000.0})
    light = replace(MODEL, gravity_m_s2=1.62)
    first = leave(tmp_path / "a", trials, 0.0)
    other = leave(tmp_path / "b", filtered, 0.0, model=light, contact=stiff)
    expected = {
        f"contact.{name}": ["5000", "6000"],
        "model.gravity_m_s2": ["9.81", "1.62"],
        "filter.cutoff_hz": ["-", "8"],
        "lag_of_forces_s": ["-", "0.011"],
        "lag_of_pressure_s": ["-", "-0.018"],
    }
    assert compare([first, other]).settings() == expected
    # What has no name here, such as a load, shows as well.
    box = PlanarWrench.of(np.full((len(trials[0].times), 3), -100.0))
    loaded = [replace(trials[0], applied={"pelvis": box}), *trials[1:]]
    lift = leave(tmp_path / "d", loaded, 0.0)
    ((name, sums),) = compare([first, lift]).settings().items()
    assert name == "measured trials, checksum" and len(set(sums)) == 2
    # As do the torques of a design, which its contact does not tell.
    factors = {"design": {"exo_knee": {"factor": [1.2, 0.9]}}}
    knee = leave(tmp_path / "e", trials, 0.0, **factors)
    expected = {"design.exo_knee.factor": ["-", "(1.2, 0.9)"]}
    assert compare([first, knee]).settings() == expected
    # Two people differ in all of a model.
    bert = leave(tmp_path / "c", trials, 0.0, model=light, subject="bert")
    assert list(compare([first, bert]).settings()) == ["subject"]


def test_windows_of_one_recording_are_told_and_drawn_where_they_lie(
    tmp_path, trials, monkeypatch
):
    late = replace(trials[0], start_s=0.25)
    late = late.sample(np.linspace(0.1, 0.6, 21))
    late = replace(late, times=late.times - 0.1, start_s=0.35)
    first = leave(tmp_path / "a", [replace(trials[0], start_s=0.25)], 0.0)
    found = compare([first, leave(tmp_path / "b", [late], 0.0)])
    window = f"window.{late.name}"
    assert found.settings() == {
        f"{window}.start_s": ["0.25", "0.35"],
        f"{window}.duration_s": ["0.8", "0.5"],
    }
    for name in ("kinematics", "ground_reaction", "interaction"):
        monkeypatch.setattr(figures, f"{name}_figure", lambda runs, _: runs)
    drawn = found.figures()["ground_reaction"]
    np.testing.assert_allclose(drawn["a"][0].times[[0, -1]], (0.0, 0.8))
    np.testing.assert_allclose(drawn["b"][0].times[[0, -1]], (0.1, 0.6))


@pytest.mark.slow
def test_half_widths_and_marks(folders, tmp_path, trials):
    check = {
        **dict(name="audit", holds=False, value=2.5, limit=1.0, unit="N"),
        **dict(where="rise1", sentence="", level="fail"),
    }
    parameters = [
        {"name": "heel.x", "value": 1.0, "unit": "m", "half_width_95": 0.25}
    ]
    third = leave(
        tmp_path / "carl", trials, 1.0, checks=[check], parameters=parameters
    )
    found = compare([*folders, third])
    assert "what differs in settings" in found.text()
    assert found.parameters()["heel.x [m]"][2] == "1 ± 0.25"
    mark = "DOES NOT HOLD: audit (rise1, 2.5 N, limit 1 N)"
    assert found.marks() == {"carl": mark}
    assert found.text().startswith("carl: DOES NOT HOLD")


@pytest.mark.slow
def test_the_mark_is_on_everything_that_is_written(folders, tmp_path, trials):
    off = Check("audit", False, 2.5, 1.0, "N", "rise1")
    third = leave(tmp_path / "carl", trials, 1.0, **Verdict((off,)).summary())
    out = tmp_path / "compared"
    given = [str(folder) for folder in (*folders, third)]
    assert main(["compare", *given, "--out", str(out)]) == 0
    assert unmarked(out) == []
    assert list(out.glob("*.png"))
    assert main(["compare", *given[:2], "--out", str(tmp_path / "two")]) == 0
    assert "compared.txt" in unmarked(tmp_path / "two")


@pytest.mark.slow
def test_one_trial_in_common_is_enough(tmp_path, trials):
    a = leave(tmp_path / "a", trials, 1.0)
    b = leave(tmp_path / "b", trials[1:], 1.0)
    found = compare([a, b])
    assert found.trials == tuple(t.name for t in trials[1:])
    assert found.settings() == {} and "no setting differs\n" in found.text()
    renamed = [replace(t, name=f"other_{t.name}") for t in trials]
    c = leave(tmp_path / "c", renamed, 1.0)
    with pytest.raises(InputError, match="no trial in common"):
        compare([a, c])


@pytest.mark.slow
def test_what_cannot_be_compared(tmp_path, folders, trials, capsys):
    more = {"phase": "interaction", "objective": 1.0}
    other = leave(tmp_path / "x", trials, 1.0, **more)
    assert main(["compare", str(folders[0]), str(other)]) == 2
    assert "compare results of one phase" in capsys.readouterr().err
    assert main(["compare", str(folders[0])]) == 2
    assert "two or more" in capsys.readouterr().err
    assert main(["compare", str(folders[0]), str(tmp_path)]) == 2
    assert "holds 3 results" in capsys.readouterr().err
    for out in (folders[0], tmp_path):
        words = [*map(str, folders), "--out", str(out), "--force"]
        assert main(["compare", *words]) == 2
        assert "would replace" in capsys.readouterr().err
    assert main(["report", words[0], "--out", words[0], "--force"]) == 2
    assert "would replace" in capsys.readouterr().err
    assert (folders[0] / "summary.json").is_file()


@pytest.mark.slow
def test_command_writes_table_and_figures(folders, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["compare", *map(str, folders), "--out", str(out)]
    assert main(command) == 0
    said = capsys.readouterr().out
    text = (out / "compared.txt").read_text("utf-8")
    assert text in said
    assert "what differs in settings" in text and "measured" in text
    assert {p.name for p in out.glob("*.png")} == {
        *("kinematics.png", "ground_reaction.png", "interaction.png"),
    }
