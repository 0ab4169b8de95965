"""Tables hold what summaries hold: text against numbers put there by hand."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from drake_exo.papers import serrancoli
from drake_exo.report import gathering
from drake_exo.report.gathering import Results


def cells(text: str) -> list[list[str]]:
    """A table's rows below its header, split at wide gaps."""
    lines = text.splitlines()
    assert set(lines[1]) <= {"-", " "}
    edges, start = [], 0
    for part in lines[1].split("  "):
        edges.append((start, start + len(part)))
        start += len(part) + 2
    return [[line[a:b].strip() for a, b in edges] for line in lines[2:]]


def header(text: str) -> list[str]:
    lines = text.splitlines()
    return [part.strip() for part in lines[0].split("  ") if part.strip()]


def score(trial, base):
    return {
        "trial": trial,
        "angles_deg": {"knee": base, "ankle": base + 0.5},
        "velocities_deg_s": {"knee": 10.0 * base},
        "foot": {"x_mm": 99.0},
        "grf_n": {"horizontal": base + 1.0, "vertical": base + 2.0},
        "cop_mm": base / 10.0,
        "moments_nm": {"exo_hip": 3.0 * base},
        "interaction_n": {"thigh": 7.0} if trial == "b" else {},
    }


SCORES = [score("a", 1.0), score("b", 4.0)]
SPREAD = {
    "angles_deg": {"knee": 2.25, "ankle": 1.75},
    "velocities_deg_s": {"knee": 8.0},
    "grf_n": {"horizontal": 5.0, "vertical": 6.0},
    "cop_mm": 0.75,
    "moments_nm": {"exo_hip": 4.5},
    "interaction_n": {"thigh": None},
}
# Trial a, trial b, mean, SD of two (half their difference times root 2).
EXPECTED = {
    "angle ankle [deg]": (1.5, 4.5, 3.0, 2.1213, 1.75),
    "angle knee [deg]": (1.0, 4.0, 2.5, 2.1213, 2.25),
    "velocity knee [deg/s]": (10.0, 40.0, 25.0, 21.2132, 8.0),
    "ground reaction horizontal [N]": (2.0, 5.0, 3.5, 2.1213, 5.0),
    "ground reaction vertical [N]": (3.0, 6.0, 4.5, 2.1213, 6.0),
    "centre of pressure [mm]": (0.1, 0.4, 0.25, 0.21213, 0.75),
    "moment exo_hip [N m]": (3.0, 12.0, 7.5, 6.36396, 4.5),
    "normal force thigh [N]": (None, 7.0, 7.0, None, None),
}


def test_rmsd_of_every_signal_with_mean_and_sd():
    text = gathering.rmsd_table(SCORES, SPREAD)
    assert header(text) == ["RMSD", "a", "b", "mean", "SD", "measured SD"]
    found = {row[0]: row[1:] for row in cells(text)}
    assert list(found) == list(EXPECTED)
    for name, values in EXPECTED.items():
        for cell, value in zip(found[name], values, strict=True):
            assert cell == ("-" if value is None else f"{value:.2f}")
    assert "measured SD" not in gathering.rmsd_table(SCORES)


def test_signals_stand_in_the_papers_order():
    names = ["pelvis", "exo_ankle", "hip", "other", "ankle", "thigh"]
    rows = [{"trial": "a", "interaction_n": dict.fromkeys(names, 1.0)}]
    found = [path[1] for _, path in gathering.rmsd_signals(rows)]
    # Signals of no number, such as a centre of pressure, are none.
    assert found == ["ankle", "hip", "exo_ankle", "pelvis", "thigh", "other"]


def test_legs_stand_side_by_side_in_one_order_before_and_after_a_file():
    names = ["hip_left", "knee_left", "toes_left", "ankle_left", "ankle_right"]
    of = {
        "angles_deg": dict.fromkeys(names, 1.0),
        "grf_n": {"vertical left": 1.0, "horizontal right": 1.0},
    }
    kept = {key: dict(sorted(part.items())) for key, part in of.items()}
    for rows in ([of], [kept]):
        assert [path[1] for _, path in gathering.rmsd_signals(rows)] == [
            *("ankle_left", "ankle_right", "knee_left", "hip_left"),
            *("toes_left", "horizontal right", "vertical left"),
        ]


def test_mean_and_sd_leave_out_what_is_missing():
    assert gathering.mean_and_sd([]) == (None, None)
    assert gathering.mean_and_sd([None, 3.0]) == (3.0, None)
    mean, sd = gathering.mean_and_sd([1.0, None, 2.0, 6.0])
    assert (mean, sd) == (3.0, pytest.approx(np.sqrt(7.0)))


def test_numbers_have_fixed_decimals_and_gaps_are_dashes():
    rows = [["x", 1.0, None], ["longer", np.nan, -12.346]]
    text = gathering.format_table(["a", "b", "c"], rows)
    assert cells(text) == [["x", "1.00", "-"], ["longer", "-", "-12.35"]]
    assert cells(gathering.format_table(["a", "b"], [["x", 0.125]], 1)) == [
        ["x", "0.1"]
    ]
    lines = text.splitlines()
    assert lines[2].startswith("x ") and lines[2].endswith(" -")
    assert len(set(map(len, lines[1:]))) == 1  # flush to the right


def parameter(name="thigh.stiffness", **more):
    usual = {"value": 1234.56, "lower": 100.0, "upper": 20000.0, "unit": "N/m"}
    return {"name": name, "free": True, "at_bound": False, **usual, **more}


def test_a_known_contact_has_no_table_of_parameters():
    assert "no parameters" in gathering.parameters_table([])


@pytest.mark.parametrize(
    ("more", "interval", "remark"),
    [
        ({"half_width_95": 98.7}, "± 99", ""),
        ({}, "-", ""),
        ({"half_width_95": 0.0123, "identifiable": True}, "± 0.012", ""),
        ({"half_width_95": 5e3, "identifiable": False}, "± 5e+03", "weakly"),
        ({"at_bound": True, "identifiable": False}, "-", "at bound"),
        ({"free": False, "at_bound": True}, "-", "fixed"),
    ],
)
def test_parameters_with_interval_bounds_and_remark(more, interval, remark):
    text = gathering.parameters_table([parameter(**more)])
    ((name, value, half, lower, upper, unit, said),) = cells(
        text.replace("weakly determined", "weakly           ")
    )
    assert (name, value, unit) == ("thigh.stiffness", "1235", "N/m")
    assert (lower, upper) == ("100", "2e+04")
    assert (half, said) == (interval, remark)


def test_a_value_at_its_bound_is_not_printed_beyond_it():
    row = parameter("toe.x", value=0.22034, upper=0.22034, at_bound=True)
    ((_, value, _, _, upper, *_),) = cells(gathering.parameters_table([row]))
    assert value == upper == "0.2203"


def test_an_audit_is_one_line_a_trial():
    row = {
        "trial": "rise1",
        "force_n": 1.25,
        "moment_nm": 0.5,
        "simulated_grf_n": [2.0, 3.0],
        "simulated_angles_deg": 4.0,
        "simulated_interaction_n": None,
    }
    text = gathering.audit_table([row])
    assert cells(text)[0] == [
        "rise1",
        "1.25",
        "0.50",
        "2.00",
        "3.00",
        "4.00",
        "-",
    ]
    names = header(text)
    for place, words in ((1, "[N]"), (2, "[N m]"), (5, "[deg]"), (6, "[N]")):
        assert words in names[place]
    assert ("F_x" in names[3], "F_z" in names[4]) == (True, True)


def test_a_front_is_one_line_a_factor():
    keys = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")
    values = {k: 1.0 + i for i, k in enumerate(keys)}
    values |= {f"{k}_worst": 10.0 + i for i, k in enumerate(keys)}
    rows = [{"factor": f, "success": f > 0.3, **values} for f in (0.25, 1.0)]
    first, second = cells(gathering.front_table(rows))
    numbers = ["1.00", "10.00", "2.00", "11.00", "3.00", "12.00", "4.00"]
    assert first == ["0.25 (failed)", *numbers, "13.00"]
    assert second == ["1", *numbers, "13.00"]
    assert [n for n in header(gathering.front_table(rows)) if n != "worst"][
        1:
    ] == [
        "angles [deg]",
        "velocities [deg/s]",
        "GRF [N]",
        "CoP [mm]",
    ]


@dataclass
class Told:
    """A summary by hand."""

    phase: str
    rmsd: list = field(default_factory=lambda: SCORES)
    more: dict = field(default_factory=dict)

    def results(self) -> Results:
        summary = {"phase": self.phase, "subject": "virtual_subject"}
        summary |= {"rmsd": self.rmsd, "measured_sd": SPREAD, "checks": []}
        summary |= self.more
        return Results(Path("nowhere"), summary)


def test_the_papers_table_has_each_run_beside_the_paper():
    b = [score("c", 2.0), score("d", 3.0)]
    rows = serrancoli.comparison(
        {
            "A": Told("foot-ground").results(),
            "B": Told("interaction", b).results(),
        }
    )
    assert rows[0] == [
        *("signal", "A mean", "A SD", "B mean", "B SD"),
        *("measured SD", "paper A", "paper B"),
    ]
    found = {row[0]: row[1:] for row in rows[1:]}
    assert found["angle knee [deg]"] == [
        *(2.5, pytest.approx(4.5**0.5), 2.5, pytest.approx(0.5**0.5)),
        *(2.25, "<= 0.8", "<= 1.1"),
    ]
    assert found["moment exo_hip [N m]"][-2:] == ["", "< 10"]
    thigh = found["normal force thigh [N]"]
    assert thigh[0] == 7.0 and thigh[-2:] == ["", "2.3"]


def test_two_legs_stand_beside_no_paper():
    """The laboratory's person in another device than the paper's."""
    rows = [{"angles_deg": {"knee_left": 1.0, "motor": 2.0}}]
    header, *_ = serrancoli.comparison(
        {"B": Told("interaction", rows).results()}
    )
    assert header == ["signal", "B mean", "B SD", "measured SD"]


def predicted(scale, thigh, **more):
    rows = [{**s, "interaction_n": {"thigh": thigh}} for s in SCORES]
    more = {"scale_interaction": scale, **more}
    return Told("prediction", rows, more).results()


def test_a_prediction_stands_beside_nominal_cuffs():
    """Means of those that were solved with them."""
    usual = [{"trial": "a", "interaction_n": {"thigh": 9.0}}, None]
    runs = {
        "C1": predicted(1.0, 4.0, rmsd_uncalibrated=usual),
        "C2": predicted(1.4, 6.0),
    }
    rows = serrancoli.comparison(runs)
    place = rows[0].index("C1 uncalibrated")
    assert rows[0][place - 1 : place + 2] == [
        *("C1 SD", "C1 uncalibrated", "C2 mean"),
    ]
    found = {row[0]: row for row in rows}
    assert found["normal force thigh [N]"][place - 2 : place + 2] == [
        *(4.0, 0.0, 9.0, 6.0),
    ]
    assert found["angle knee [deg]"][place] is None
    assert {len(row) for row in rows} == {len(rows[0])}
    _, texts = serrancoli.tables(list(runs.values()))
    assert texts[1] == ("C1 uncalibrated: means are of 1 trials; not solved: b")


def test_changes_by_a_scaled_interaction_are_ratios():
    found = [
        predicted(1.0, 4.0, starts_from="the data"),
        predicted(1.4, 14.0),
        Told("foot-ground").results(),
    ]
    made, texts = serrancoli.tables(found)
    assert set(made) == {"table_2", "table_3"}
    assert made["table_2"][0][1] == "A mean"  # Phase A is of the ground
    assert [t.split(":")[0] for t in texts[:2]] == ["Table II", "Table III"]
    assert "C1: movements start from the data" in texts
    lines = texts[-1].splitlines()
    assert "scaled by 1.4" in lines[0]
    ((*_, ratio),) = cells("\n".join(lines[1:]))
    assert ratio == "3.50"


@pytest.mark.parametrize(
    ("more", "label"),
    [
        ({}, "C1"),
        ({"scale_interaction": 1.4}, "C2"),
        ({"scale_interaction": 0.7}, "C2 x0.7"),
        ({"objective": "comfort"}, "C1 comfort"),
        (
            {"objective": "tracking", "controller": "my.module:Helper"},
            "C1 Helper",
        ),
    ],
)
def test_a_prediction_is_named_by_what_it_changes(more, label):
    assert Told("prediction", more=more).results().label == label
