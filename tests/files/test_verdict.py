"""The verdict: words, exit codes, marks, and what is accepted."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.legend import Legend

from drake_exo.errors import InputError
from drake_exo.files.output import (
    Check,
    Verdict,
    is_accepted,
    save_figure,
    stored,
    stored_mark,
)

SOLVED = Check("solved", True)
AUDIT = Check("audit", False, 2.5, 1.0, "N", "rise1", "the grid is coarse")
MASS = Check("plausibility.mass", False, 0.3, 0.05, "", "standing")
NOTE = Check("bounds", False, where="thigh.x", level="note")


@pytest.mark.parametrize(
    ("checks", "accepted", "word", "code"),
    [
        ((SOLVED,), (), "holds", 0),
        ((SOLVED, NOTE), (), "holds", 0),
        ((SOLVED, AUDIT), (), "does not hold", 3),
        ((SOLVED, AUDIT), ("audit",), "does not hold", 0),
        ((SOLVED, AUDIT), ("aud",), "does not hold", 3),
        ((SOLVED, AUDIT, MASS), ("audit",), "does not hold", 3),
        ((SOLVED, AUDIT, MASS), ("audit", "plausibility"), "does not hold", 0),
        ((SOLVED, AUDIT, MASS), ("all",), "does not hold", 0),
        ((Check("solved", False),), (), "not solved", 1),
        ((Check("solved", False), AUDIT), ("all",), "not solved", 1),
    ],
)
def test_word_and_exit_code(checks, accepted, word, code):
    made = Verdict(checks, accepted)
    assert (made.word, made.exit_code) == (word, code)


def test_an_accepted_result_keeps_its_mark():
    made = Verdict((SOLVED, AUDIT), ("all",))
    assert made.mark == Verdict((SOLVED, AUDIT)).mark
    assert "audit (rise1, 2.5 N, limit 1 N)" in made.mark
    assert Verdict((SOLVED, NOTE)).mark == ""


def test_what_holds_has_no_sentence_of_what_is_wrong():
    holds = Check("audit", True, 0.5, 1.0, "N", "rise1", AUDIT.sentence)
    told = Verdict((holds, AUDIT)).summary()["checks"]
    assert [c["sentence"] for c in told] == ["", "the grid is coarse"]


def test_what_is_accepted_and_was_never_checked_is_told():
    text = Verdict((SOLVED, AUDIT), ("auditt", "audit", "all")).text()
    assert "--accept auditt: no check has that name" in text
    assert text.count("no check has that name") == 1


def test_failures_come_last_and_red():
    text = Verdict((AUDIT, SOLVED, NOTE)).text(color=True)
    last = text.splitlines()[-2]
    assert "\x1b[31m" in last
    assert "the grid is coarse" in last
    assert text.splitlines()[-1].endswith("--accept audit")
    assert "\x1b" not in Verdict((AUDIT, SOLVED)).text(color=False)
    assert "bounds (thigh.x)" in text


def test_a_ratio_is_told_without_a_unit():
    made = Verdict((Check("a", False, 1.3, 2.0, "1", "hip", level="note"),))
    assert "note  a (hip, 1.3, limit 2)" in made.text()


def test_failures_with_one_sentence_share_a_line():
    """A design's six cuffs said the same thing six times."""
    far = [
        Check("far", False, value, 1.0, "m", cuff, "nothing known", level)
        for level in ("note", "fail")
        for cuff, value in (("calf", 2.0), ("thigh", 3.0))
    ]
    other = Check("far", False, where="hip", sentence="loose")
    text = Verdict((*far, other), ("far",)).text(color=False)
    both = "far (calf, 2 m, limit 1 m; thigh, 3 m, limit 1 m): nothing known"
    assert text.splitlines()[1:] == [
        f"  note  {both}", f"  accepted  {both}", "  accepted  far (hip): loose"
    ]  # fmt: skip


def test_of_many_that_hold_the_nearest_to_its_limit_is_told():
    checks = [
        Check("audit", True, value, 1.0, "N", f"rise{i}")
        for i, value in enumerate((0.1, 0.9, 0.2))
    ]
    text = Verdict(tuple(checks)).text(color=False)
    assert "3 hold  nearest (rise1, 0.9 N, limit 1 N)" in text
    # Where none is measured, or nothing but zero is allowed, none is nearest.
    bare = [
        Check("bounds", True, where="x"),
        Check("bounds", True, 0.0, 0.0, "s", "y"),
    ]
    text = Verdict(tuple(bare)).text(color=False)
    assert "2 hold" in text and "nearest" not in text


def test_a_summary_comes_back():
    made = Verdict((SOLVED, AUDIT, NOTE), ("audit",))
    assert stored(made.summary()) == made
    assert stored_mark(made.summary()) == made.mark


def test_a_summary_of_an_earlier_version_is_marked():
    assert stored({"success": True}) is None
    assert "without checks" in stored_mark({"success": True})


@pytest.mark.parametrize(
    "checks",
    [
        [{"name": "audit"}],
        [{"name": 3, "holds": True}],
        [{"name": "audit", "holds": True, "value": []}],
        5,
        [5],
        ["audit"],
    ],
)
def test_damaged_checks_are_bad_input(checks):
    with pytest.raises(InputError, match="run it again"):
        stored({"checks": checks})
    with pytest.raises(InputError, match="run it again"):
        stored({"checks": [], "accepted": [7.5]})


def test_beginnings_are_accepted_at_dots_only():
    assert is_accepted("plausibility.mass", ["plausibility.mass"])
    assert not is_accepted("plausibility.mass", ["plaus"])
    assert not is_accepted("plausibility", ["plausibility.mass"])


@pytest.mark.parametrize("size", [(4.0, 3.0), (2.0, 6.0)])
def test_a_mark_lies_across_a_figure_from_corner_to_corner(tmp_path, size):
    """And under it, in lines that are no wider than it."""
    figure = Figure(size)
    mark = "DOES NOT HOLD: " + "audit (rise1, 2.5 N, limit 1 N), " * 5
    save_figure(tmp_path / "a.png", figure, mark)
    across, under = figure.texts
    assert across.get_text() == "DOES NOT HOLD"
    assert across.get_position() == (0.5, 0.5)
    slope = np.tan(np.deg2rad(across.get_rotation()))
    assert slope == pytest.approx(size[1] / size[0])
    drawn = FigureCanvasAgg(figure).get_renderer()
    box = across.get_window_extent(drawn)
    # Half of the diagonal at least, within the figure.
    length = np.hypot(box.width, box.height) / np.hypot(*figure.bbox.size)
    assert 0.5 < length < 1.0
    assert " ".join(under.get_text().split()) == mark.strip()
    box = under.get_window_extent(drawn)
    assert box.y1 <= 0.0 and box.width < 1.4 * figure.bbox.width


@pytest.mark.slow
def test_a_mark_lies_below_a_legend_outside_the_axes(tmp_path, monkeypatch):
    figure = Figure((4.0, 3.0), layout="constrained")
    axes = figure.add_subplot(xlabel="time")
    axes.plot([0, 1], label="line")
    figure.legend(loc="outside lower center")
    drawn = []

    def draw(legend, renderer):
        parts = [axes.xaxis.label, legend, *figure.texts[1:]]
        drawn.append([part.get_window_extent(renderer) for part in parts])

    monkeypatch.setattr(Legend, "draw", draw)
    save_figure(tmp_path / "a.png", figure, "DOES NOT HOLD: audit")
    label, legend, under = drawn[-1]
    assert label.y0 >= legend.y1 and legend.y0 >= under.y1


def test_without_a_mark_nothing_is_drawn(tmp_path):
    figure = Figure((2.0, 2.0))
    save_figure(tmp_path / "a.png", figure)
    assert not figure.texts


def test_a_figure_is_as_fine_as_print_needs_wherever_it_is_saved(tmp_path):
    save_figure(tmp_path / "a.png", Figure((3.0, 2.0)))
    assert imread(tmp_path / "a.png").shape[:2] == (400, 600)
