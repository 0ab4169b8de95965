"""The report on loaded trials: each number by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_exo.measurement import quality
from drake_exo.measurement.plausibility import LIMITS

N = 4
RESIDUAL = np.array(
    [[3.0, 60.0, 1.0], [-3.0, -60.0, -1.0], [5.0, 0.0, 7.0], [-5.0, 0.0, -7.0]]
)


@pytest.fixture
def assessed(monkeypatch):
    """A trial of 1.5 s from 2 s on, whose residual is given."""
    monkeypatch.setattr(quality, "force_residual", lambda *_: RESIDUAL)

    def assess(rms=None, weight=700.0, said=None, device=None, **report):
        said = {
            "marker_residual_rms_m": rms or {"heel": 0.003, "toe": 0.004},
            "gaps_filled": {"heel": 0.5, "hip": 0.25},
            "markers_left_out": [], "delays_s": {"plates": 0.004},
            "clocks": {}, "plate_levels": {}, "one_leg_doubled": False,
            "legs_followed": ["left", "right"], "moments": {"knee": "bench"},
            "chair": "none", "mats": {},
        } | (said or {})  # fmt: skip
        trial = SimpleNamespace(
            name="one", start_s=2.0, duration=1.5, times=np.zeros(N),
            provenance=said, moments=None,
            coordinates=SimpleNamespace(device=()),
        )  # fmt: skip
        vars(trial).update(device or {})
        subject = SimpleNamespace(
            report={"stated_mass_kg": None, "mass_from": "study"} | report,
            model=SimpleNamespace(tree=SimpleNamespace(weight=weight)),
        )
        return quality.assess(subject, (trial,))

    return assess


def test_a_trial_in_numbers(assessed):
    found = assessed()
    (t,) = found.trials
    assert (t.start_s, t.end_s) == (2.0, 3.5)
    assert t.worst_marker == "toe"
    assert t.marker_rms_all_m == pytest.approx(np.sqrt((9 + 16) / 2) * 1e-3)
    # Half of one marker's frames and a quarter of another's: 3 of 4 frames,
    # three eighths of both.
    assert t.filled_frames == 3 and t.gaps == pytest.approx(0.375)
    # Root mean squares of the columns.
    assert t.residual_n == pytest.approx((np.sqrt(17.0), np.sqrt(1800.0)))
    assert t.residual_nm == pytest.approx(5.0)
    text = quality.text_of(found)
    assert "one (2.00 to 3.50 s)" in text
    assert "markers: 3.5 mm from the model, worst toe 4.0 mm" in text
    assert "gaps filled in 3 marker frames (38 %)" in text
    assert "F_x 4.1 N, F_z 42.4 N, moment 5.0 N m" in text
    assert "plates +4 ms" in text and "joint moments: knee: bench" in text


def test_stuck_cells_of_a_mat_are_warned_of(assessed):
    mats = {"front": {"stuck_cells": 3}, "back": {"peak_kpa": 5.0}}
    (t,) = assessed(said={"mats": mats}).trials
    assert t.warnings[-1].startswith("stuck cells of front: 3 never change")
    found = assessed(said={"mats": mats}, standing_mass_kg=50.0)
    assert found.remarks == [f"one: {w}" for w in t.warnings]
    assert "mat front: 3 cells are stuck" in t.notes


@pytest.mark.parametrize("beyond", [0.99, 1.01])
def test_what_is_beyond_its_limit_is_warned_of(assessed, beyond, monkeypatch):
    """Markers, Newton, gaps, clocks and the mass, each by one per cent."""
    monkeypatch.setitem(LIMITS, "mass", (8.0, "%", "standing"))
    size = np.sqrt(1800.0)
    found = assessed(
        {"heel": beyond * quality.LARGEST_MARKER_RMS_M, "toe": 0.001},
        weight=size / quality.LARGEST_RESIDUAL_N / beyond,
        said={
            "gaps_filled": {"heel": 2.0 * beyond * quality.LARGEST_GAPS},
            "delays_s": {"mats": -beyond * quality.LARGEST_DELAY_S},
        },
        standing_mass_kg=60.0 - 0.6 * 8.0 * beyond,
        stated_mass_kg=60.0,
    )
    (t,) = found.trials
    warned = [*t.warnings, *found.warnings]
    if beyond < 1.0:
        assert warned == []
        return
    for words, sentence in zip(
        (
            "marker heel lies",
            "Newton's law misses 42 N",
            "of marker frames are filled",
            "the clock of mats is -",
            "the study says 60.0 kg (-",
        ),
        warned,
        strict=True,
    ):
        assert words in sentence


def test_what_was_done_to_a_trial_is_listed(assessed):
    found = assessed(
        said={
            "markers_left_out": ["a", "b"],
            "legs_followed": ["right"],
            "one_leg_doubled": True,
            "plate_levels": {"left": {"offset_n": 1.23456, "unloaded_s": 0.7}},
            "mats": {
                "front": {
                    "peak_kpa": 12.3456,
                    "surface": "plane",
                    "forward_share": -0.75,
                }
            },
            "encoder_legs": "left",
        },
        osim={
            "file": "m.osim", "mass_kg": 71.26, "notes": ["n"],
            "not_seen": ["X"],
        },
        stated_mass_kg=70.0,
        standing_mass_kg=70.0,
    )  # fmt: skip
    (t,) = found.trials
    assert t.left_out == ("a", "b")
    assert "left out, hidden for too long: a, b" in t.warnings
    for line in (
        "plate left levelled: offset 1.2 N, unloaded for 0.7 s",
        "one foot on a plate: its forces are doubled",
        "markers follow the right leg alone",
        "encoders of the left leg stand for both",
        "mat front: at most 12.3 kPa, surface plane, "
        "forward part of its push -75 %",
    ):
        assert line in t.notes
    text = quality.text_of(found)
    assert "model: m.osim, 71.3 kg, scaled to 70.0 kg" in text
    assert "markers of the model that standing lacks: X" in text
    assert "body mass: 70.0 kg by the plates, stated 70.0 kg" in text


def test_what_the_device_does_is_told(assessed):
    moments = np.full((N, 3), [7.0, -20.0, 10.0])
    device = {
        "moments": moments,
        "device_moments": moments[:, 1:],
        "device_work": -15.0,
        "coordinates": SimpleNamespace(device=("exo_knee", "exo_hip")),
    }
    told = (
        "device: exo_knee up to 20 N m, exo_hip up to 10 N m; does -15 J on "
        "the movement"
    )
    assert told in assessed(device=device).trials[0].notes
    assert not any("device" in n for n in assessed().trials[0].notes)
