"""What is drawn: curves, bands, labels and units, read from the axes."""

from dataclasses import replace
from itertools import combinations, pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from measured_trials import CUFFS, JOINTS, NAMES, prediction, seen
from replayed_results import CONTACT, solution
from replayed_results import MODEL as COUPLED
from undrawn import undrawn

from drake_exo.calibration.uncertainty import Bands
from drake_exo.contact.strap import CuffDesign, Design
from drake_exo.measurement.quality import TrialQuality
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce
from drake_exo.model.assembly import Assembly, Person
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.description import nominal_human
from drake_exo.model.plant import Model
from drake_exo.report import figures
from drake_exo.virtual_laboratory import synthetic

DEGREES = 180.0 / np.pi


def lines(ax) -> dict[str, np.ndarray]:
    """Label -> x and y of what is drawn, (2, n)."""
    return {x.get_label(): np.array(x.get_data()) for x in ax.get_lines()}


def panels(figure, columns: int = 1):
    """Unit or name on the left -> the axes of its row."""
    axes = np.reshape(figure.axes, (-1, columns))
    return {row[0].get_ylabel(): list(row) for row in axes}


def colours(ax) -> dict[str, str]:
    return {x.get_label(): x.get_color() for x in ax.get_lines()}


@pytest.fixture(scope="module")
def trials():
    return [seen("one"), seen("two", 1.5, ("thigh", "pelvis"))]


@pytest.fixture(scope="module")
def found(trials):
    return [prediction(t) for t in trials]


def same(line, times, values):
    np.testing.assert_allclose(line, [times, values], rtol=1e-12, atol=1e-12)


@undrawn()
def test_five_results_look_each_its_own_way_and_all_are_named(trials, found):
    """Colours begin again with another dash; Matplotlib hides "_" names."""
    names = ["_old", "b", "c", "d", "e"]
    runs = dict.fromkeys(names, found)
    figure = figures.ground_reaction_figure(runs, trials)
    drawn = figure.axes[0].get_lines()
    looks = {(x.get_color(), x.get_linestyle()) for x in drawn}
    assert len(drawn) == len(looks) == 6
    assert " _old" in {x.get_label() for x in drawn}


@pytest.mark.slow
@undrawn()
def test_what_is_shown_has_its_colour_in_every_figure(trials, found):
    """The model, C1 and calibrated are one colour; uncalibrated is another."""

    def used(*names):
        runs = dict.fromkeys(names, found)
        return colours(figures.kinematics_figure(runs, trials).axes[0])

    model, phases = used("model"), used("C1", "C2", "C1 uncalibrated")
    both = used("calibrated", "uncalibrated")
    calibrated = {
        model["model"], model["model, exoskeleton"], phases["C1"],
        both["calibrated"],
        *colours(figures.overview_figure(found[0], trials[0]).axes[0]).values(),
    } - {model["measured"], model["measured, exoskeleton"]}  # fmt: skip
    assert len(calibrated) == 1
    assert both["uncalibrated"] == phases["C1 uncalibrated"]
    assert len({*calibrated, both["uncalibrated"], phases["C2"]}) == 3


@undrawn()
def test_ground_reaction_and_cop(trials, found):
    figure = figures.ground_reaction_figure({"model": found}, trials)
    rows = panels(figure, 2)
    assert list(rows) == ["$F_x$ [N]", "$F_z$ [N]", "CoP $x$ [m]"]
    for column, (m, f) in enumerate(zip(trials, found, strict=True)):
        for label, of in zip(
            rows,
            (
                lambda t: t.ground.force[:, 0],
                lambda t: t.ground.force[:, 1],
                lambda t: -t.ground.moment / t.ground.force[:, 1],
            ),
            strict=True,
        ):
            drawn = lines(rows[label][column])
            assert set(drawn) == {"measured", "model"}
            same(drawn["measured"], m.times, of(m))
            same(drawn["model"], f.times, of(f))
        assert rows["$F_x$ [N]"][column].get_title() == m.name
        assert rows["CoP $x$ [m]"][column].get_xlabel() == "time [s]"
    legend = [t.get_text() for t in figure.legends[0].get_texts()]
    assert legend == ["measured", "model"]


@pytest.mark.slow
@undrawn()
def test_angles_and_velocities_of_both(trials, found):
    figure = figures.kinematics_figure({"model": found}, trials)
    rows = panels(figure, 2)
    human = JOINTS[:3]
    assert list(rows) == [
        *(f"{j} [°]" for j in human),
        *(f"{j} [°/s]" for j in human),
    ]
    for column, (m, f) in enumerate(zip(trials, found, strict=True)):
        for k, joint in enumerate(human):
            for unit, of in (("°", "q"), ("°/s", "v")):
                drawn = lines(rows[f"{joint} [{unit}]"][column])
                for label, t, place in (
                    ("measured", m, 3 + k),
                    ("measured, exoskeleton", m, 6 + k),
                    ("model", f, 3 + k),
                    ("model, exoskeleton", f, 6 + k),
                ):
                    values = DEGREES * getattr(t, of)[:, place]
                    same(drawn[label], t.times, values)
                assert len(drawn) == 4


@undrawn()
def test_a_device_s_joint_that_counts_backwards_lies_on_the_human_s():
    made = synthetic.rises_in_device(1, nodes_per_second=20)
    (plain,) = made.trials
    names = plain.coordinates
    k, knee = names.device.index("exo_knee"), names.index("exo_knee")
    turned = names.turned_by.copy()
    turned[k] *= -1.0
    q, v = plain.q.copy(), plain.v.copy()
    q[:, knee] *= -1.0
    v[:, knee] *= -1.0
    backwards = replace(
        plain, coordinates=replace(names, coupling=turned), q=q, v=v
    )
    for unit in ("°", "°/s"):
        drawn = [
            lines(
                panels(figures.kinematics_figure({"model": [trial]}, [trial]))[
                    f"knee [{unit}]"
                ][0]
            )["model, exoskeleton"]
            for trial in (plain, backwards)
        ]
        same(drawn[1], *drawn[0])


@pytest.mark.slow
@undrawn()
def test_every_joint_of_the_device_is_drawn(trials, found, monkeypatch):
    """Of two beside one human joint, and of one beside none."""
    beside = {"exo_ankle": None, "exo_knee": "hip", "exo_hip": "hip"}
    monkeypatch.setattr(Coordinates, "follows", lambda _, name: beside[name])
    figure = figures.kinematics_figure({"model": found[:1]}, trials[:1])
    rows = panels(figure)
    assert list(rows)[:5] == [
        f"{j} [°]" for j in (*JOINTS[:3], "exo. ankle", "exo. knee")
    ]
    for label, joint, place in (
        ("hip", "model, exoskeleton", 8),
        ("exo. knee", "model", 7),
        ("exo. ankle", "model", 6),
    ):
        drawn = lines(rows[f"{label} [°]"][0])
        same(drawn[joint], found[0].times, DEGREES * found[0].q[:, place])


@pytest.mark.slow
@undrawn()
def test_moments_of_every_joint(trials, found):
    rows = panels(figures.moments_figure({"model": found}, trials), 2)
    assert list(rows) == [f"{j.replace('exo_', 'exo. ')} [N m]" for j in JOINTS]
    for k, row in enumerate(rows.values()):
        for ax, m, f in zip(row, trials, found, strict=True):
            drawn = lines(ax)
            same(drawn["measured"], m.times, m.moments[:, k])
            same(drawn["model"], f.times, f.moments[:, k])
    # A device of the user's own has names of its own.
    own = Coordinates(
        tuple(n.replace("exo_", "my_") for n in NAMES.names),
        tuple(n.replace("exo_", "my_") for n in NAMES.device),
    )
    one = [replace(trials[0], coordinates=own)]
    *_, last = panels(figures.moments_figure({"model": one}, one))
    assert last == "exo. my_hip [N m]"


@pytest.mark.slow
@undrawn()
def test_normal_forces_of_several_runs_where_there_are_any(trials, found):
    half = {
        c: CuffForce.of(0.5 * x.components) for c, x in found[1].cuffs.items()
    }
    other = replace(found[1], cuffs=half)
    runs = {"C1": found, "C2": [None, other]}
    figure = figures.interaction_figure(runs, trials)
    rows = panels(figure, 2)
    assert list(rows) == [
        "thigh normal [N]",
        "pelvis normal [N]",
        "shank normal [N]",
    ]
    assert set(lines(rows["shank normal [N]"][0])) == {"C1"}  # has no mat
    first = lines(rows["thigh normal [N]"][0])
    assert set(first) == {"measured", "C1"}  # C2 failed there
    second = lines(rows["thigh normal [N]"][1])
    same(second["measured"], trials[1].times, trials[1].cuffs["thigh"].normal)
    same(second["C1"], found[1].times, found[1].cuffs["thigh"].normal)
    same(second["C2"], other.times, other.cuffs["thigh"].normal)
    used = colours(rows["thigh normal [N]"][1])
    assert len(set(used.values())) == 3
    legend = [t.get_text() for t in figure.legends[0].get_texts()]
    assert legend == ["measured", "C1", "C2"]


@pytest.mark.slow
def test_cuffs_of_every_run_have_a_row_whichever_comes_first(trials, found):
    thigh = found[0].cuffs["thigh"]
    less = [replace(found[0], cuffs={"thigh": thigh})]
    for runs in ({"a": less, "b": found[:1]}, {"b": found[:1], "a": less}):
        labels = {
            ax.get_ylabel(): list(colours(ax))
            for ax in figures.interaction_figure(runs, trials[:1]).axes
        }
        assert set(labels) == {f"{c} normal [N]" for c in found[0].cuffs}
        assert "a" not in labels["pelvis normal [N]"]
        assert "b" in labels["pelvis normal [N]"]


def band_of(trial, width: float) -> Bands:
    n = len(trial.times)
    cuffs = {c: np.tile([1.0, width, 2.0], (n, 1)) for c in trial.cuffs}
    q, v = 0.0 * trial.q, 0.0 * trial.v
    return Bands(q, v, cuffs, {}, trial.q, trial.v, q, v, {})


@pytest.mark.slow
@undrawn()
def test_bands_are_where_mats_would_show_the_force(trials, found):
    """Those that `band_coverage` counts: moved by what mats do not see."""
    trial = found[0]
    off, width = np.linspace(-9.0, 4.0, len(trial.times)), 6.0 + trial.times
    band = replace(
        band_of(trial, 3.0), mats={"thigh": width}, off_mats={"thigh": off}
    )
    rows = panels(figures.interaction_figure({"C1": found}, trials, [band]), 2)
    middle = trial.cuffs["thigh"].normal + off
    (area,) = rows["thigh normal [N]"][0].collections
    y = area.get_paths()[0].vertices[:, 1]
    ends = [(middle - width).min(), (middle + width).max()]
    np.testing.assert_allclose([y.min(), y.max()], ends)


@pytest.mark.slow
@undrawn()
def test_bands_of_joints_are_what_instruments_would_show(trials, found):
    """Around the person, and the device; of the movement if not measured."""
    trial = found[0]
    names, by_rows = trial.coordinates, np.ones_like(trial.q)
    seen = 0.02 * by_rows
    seen[:, names.index("exo_hip")] = np.inf
    band = replace(
        band_of(trial, 3.0),
        q=0.1 * by_rows, seen_q=seen, off_q=0.01 * by_rows,
        v=0.3 * by_rows, seen_v=0.2 * by_rows, off_v=-0.4 * by_rows,
    )  # fmt: skip
    drawn = figures.plot_trials(found[:1], trials[:1], bands=[band])
    glance = figures.overview_figure(trial, trials[0], band)
    for figure in (drawn["kinematics"], glance):
        rows = {ax.get_ylabel(): ax.collections for ax in figure.axes}
        for joint, own in (("hip", (0.02, 0.1)), ("knee", (0.02, 0.02))):
            for unit, read, off, widths in (
                ("°", trial.coordinate, 0.01, own),
                ("°/s", trial.velocity, -0.4, (0.2, 0.2)),
            ):
                areas = rows[f"{joint} [{unit}]"]
                both = zip((joint, f"exo_{joint}"), widths, strict=True)
                for area, (name, width) in zip(areas, both, strict=True):
                    y = area.get_paths()[0].vertices[:, 1]
                    middle = np.rad2deg(read(name) + off)
                    half = np.rad2deg(width)
                    ends = [middle.min() - half, middle.max() + half]
                    np.testing.assert_allclose([y.min(), y.max()], ends)
        assert not rows.get("CoP $x$ [m]")


@pytest.mark.slow
@pytest.mark.parametrize("runs", [1, 2])
@undrawn()
def test_bands_lie_around_the_first_run(trials, found, runs):
    named = dict.fromkeys(["C1", "C2"][:runs], found)
    figure = figures.interaction_figure(
        named, trials, [band_of(found[0], 3.0), None]
    )
    rows = panels(figure, 2)
    legend = [t.get_text() for t in figure.legends[0].get_texts()]
    assert legend[0] == "measured"
    assert "95 % band" in legend
    for cuff, force in found[0].cuffs.items():
        (area,) = rows[f"{cuff} normal [N]"][0].collections
        corners = area.get_paths()[0].vertices
        low, high = corners.min(axis=0), corners.max(axis=0)
        normal = force.normal
        np.testing.assert_allclose(low, [0.0, normal.min() - 3.0])
        np.testing.assert_allclose(high, [2.0, normal.max() + 3.0])
        start = corners[np.isclose(corners[:, 0], 0.0), 1]
        np.testing.assert_allclose(
            [start.min(), start.max()], [normal[0] - 3.0, normal[0] + 3.0]
        )
        ax = rows[f"{cuff} normal [N]"][0]
        colour = to_rgb(colours(ax)["C1"])
        np.testing.assert_allclose(area.get_facecolor()[0, :3], colour)
        assert not rows[f"{cuff} normal [N]"][1].collections


@pytest.mark.slow
@undrawn()
def test_all_figures_that_there_are_signals_for(trials, found):
    one, model = trials[:1], found[:1]
    drawn = figures.plot_trials(model, one, model)
    names = ["ground_reaction", "kinematics", "interaction", "moments"]
    assert list(drawn) == names
    curves = set(lines(drawn["interaction"].axes[0]))
    assert curves == {"measured", "calibrated", "uncalibrated"}
    bare = [replace(one[0], moments=None, cuffs={})]
    assert list(figures.plot_trials(bare, bare)) == names[:2]
    # Before cuffs are known person and device do not touch.
    apart = [replace(model[0], cuffs={})]
    assert list(figures.plot_trials(apart, one)) == names[:2]


def walk():
    """Two legs; the left foot comes down at 0.4 and 1.4 s, the right once."""
    names, one = Model(Assembly(Person("two")), nominal_human()), seen()
    names, t = names.coordinates, one.times
    q = np.outer(t, np.arange(1.0, len(names) + 1.0))
    loaded = {
        "left": (t < 0.2) | (t > 0.395) & (t < 1.0) | (t > 1.395),
        "right": (t > 0.1) & (t < 0.6),
    }
    feet = {
        side: PlanarWrench(np.outer(on, [10.0, 700.0]), 0.0 * t)
        for side, on in loaded.items()
    }
    return replace(
        one, coordinates=names, q=q, v=q, a=q, moments=None, cuffs={}, feet=feet
    )


@pytest.mark.slow
@undrawn()
def test_legs_of_a_single_trial_are_side_by_side():
    one, other = walk(), replace(walk(), name="other")
    for figure, rows, left, right in (
        (figures.kinematics_figure, 6, "knee_left [°]", "knee_right [°]"),
        (
            figures.ground_reaction_figure,
            3,
            "left $F_z$ [N]",
            "right $F_z$ [N]",
        ),
    ):
        axes = figure({"model": [one]}, [one]).axes
        assert len(axes) == 2 * rows
        names = [ax.get_ylabel() for ax in axes]
        at = names.index(left)
        assert at % 2 == 0 and names[at + 1] == right
        assert axes[at].get_ylim() == axes[at + 1].get_ylim()
        # Of several trials each has a column.
        both = [one, other]
        names = [ax.get_ylabel() for ax in figure({"model": both}, both).axes]
        assert len(names) == 4 * rows and not any(names[1::2])


@pytest.mark.slow
@undrawn()
def test_a_walk_is_drawn_in_percent_of_each_foot_s_cycle(trials):
    one = walk()
    drawn = figures.plot_trials([replace(one, q=2.0 * one.q)], [one])
    assert list(drawn) == ["ground_reaction", "kinematics", "gait"]
    # The right foot has no whole cycle.
    rows = panels(drawn["gait"])
    assert list(rows) == [
        *("hip_left [°]", "knee_left [°]", "ankle_left [°]"),
        *("left $F_x$ [N]", "left $F_z$ [N]"),
    ]
    percent, left = 100.0 * (one.times - 0.4), rows["knee_left [°]"][0]
    knee = DEGREES * one.coordinate("knee_left")
    same(lines(left)["measured"], percent, knee)
    same(lines(left)["model"], percent, 2.0 * knee)
    force = lines(rows["left $F_z$ [N]"][0])["measured"]
    same(force, percent, one.feet["left"].force_z)
    assert left.get_xlim() == (0.0, 100.0)
    assert drawn["gait"].axes[-1].get_xlabel() == "gait cycle [%]"
    assert "gait" not in figures.plot_trials(trials, trials)


def test_a_front_is_force_against_angle():
    rows = [
        {"factor": 0.5, "success": True, "angles_deg": 0.2, "grf_n": 7.0},
        {"factor": 2.0, "success": True, "angles_deg": 0.1, "grf_n": 9.0},
        {"factor": 9.0, "success": False, "angles_deg": 3.0, "grf_n": 1.0},
    ]
    (ax,) = figures.front_figure(rows).axes
    line, lost = ax.get_lines()
    np.testing.assert_array_equal(lost.get_data(), [[3.0], [1.0]])
    assert lost.get_linestyle() == "None" and lost.get_mfc() == "none"
    np.testing.assert_array_equal(line.get_data(), [[0.2, 0.1], [7.0, 9.0]])
    assert "angles" in ax.get_xlabel() and "[°]" in ax.get_xlabel()
    assert "ground reaction" in ax.get_ylabel() and "[N]" in ax.get_ylabel()
    found = {a.get_text(): a.xy for a in ax.texts}
    assert found == {
        "×0.5": (0.2, 7.0), "×2": (0.1, 9.0), "×9, not solved": (3.0, 1.0),
    }  # fmt: skip


def test_factors_of_a_front_can_be_read_where_it_is_flat():
    points = {
        0.25: (0.331, 0.13), 0.5: (0.329, 0.18), 1.0: (0.326, 0.34),
        2.0: (0.315, 0.96), 4.0: (0.281, 2.6),
    }  # fmt: skip
    figure = figures.front_figure(
        [
            {"factor": factor, "success": True, "angles_deg": x, "grf_n": y}
            for factor, (x, y) in points.items()
        ]
    )
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])


@pytest.mark.slow
def test_quality_shows_what_was_loaded():
    trial = replace(
        seen("one"),
        start_s=3.0,
        chair=PlanarWrench.of(np.tile([1.0, 50.0, 7.0], (201, 1))),
    )
    residual = np.outer(np.ones(201), [1.0, -2.0, 3.0])
    quality = TrialQuality(
        **{
            **dict.fromkeys(TrialQuality.__dataclass_fields__),
            "residual": residual,
            "marker_rms_m": {"WORSE": 0.012, "GOOD": 0.003},
        }
    )
    figure = figures.quality_figure(trial, quality)
    panels = {ax.get_title(): ax for ax in figure.axes}
    t = 3.0 + trial.times
    drawn = lines(panels["joint angles"])
    moments = lines(panels["joint moments"])
    for k, joint in enumerate(JOINTS):
        same(drawn[joint], t, DEGREES * trial.q[:, 3 + k])
        same(moments[joint], t, trial.moments[:, k])
    used = colours(panels["joint angles"])
    assert used["knee"] == used["exo_knee"] != used["hip"]
    forces = lines(panels["forces on the body"])
    same(forces["feet $F_x$"], t, trial.ground.force[:, 0])
    same(forces["feet $F_z$"], t, trial.ground.force[:, 1])
    same(forces["chair $F_z$"], t, np.full(201, 50.0))
    missed = lines(panels["missed by Newton's law"])
    for k, name in enumerate(("$F_x$ [N]", "$F_z$ [N]", "$M$ [N m]")):
        same(missed[name], t, residual[:, k])
    (mat,) = lines(panels["mats: normal force on the human"]).values()
    same(mat, t, trial.cuffs["thigh"].normal)
    markers = panels["markers' distance from the model"]
    assert markers.get_xlabel() == "RMS [mm]"
    assert [b.get_width() for b in markers.patches] == [3.0, 12.0]
    names = [label.get_text() for label in markers.get_yticklabels()]
    assert names == ["GOOD", "WORSE"]
    many = {f"M{k}": 1e-3 * k for k in range(60)}
    figure = figures.quality_figure(trial, replace(quality, marker_rms_m=many))
    last = figure.axes[-1]
    assert last.get_title() == "markers' distance from the model, 24 of 60"
    assert last.get_yticklabels()[-1].get_text() == "M59"
    labels = {title: ax.get_ylabel() for title, ax in panels.items()}
    labels.pop("markers' distance from the model")
    assert labels == {
        "joint angles": "angle [°]",
        "forces on the body": "force [N]",
        "missed by Newton's law": "force [N], moment [N m]",
        "joint moments": "moment [N m]",
        "mats: normal force on the human": "force [N]",
    }
    assert {panels[name].get_xlabel() for name in labels} == {"time [s]"}
    nothing = replace(trial, moments=None, cuffs={}, chair=None)
    figure = figures.quality_figure(nothing, quality)
    said = [[x.get_text() for x in ax.texts] for ax in figure.axes]
    assert said.count(["not measured"]) == 2


def moved(trial, measured, bands=None):
    return SimpleNamespace(trial=trial, measured=measured, bands=bands)


def designed(trials, found, **more):
    """A design for two wearers; the second one's first trial is built."""
    before = {
        "a": [moved(found[0], trials[0])],
        "b": [moved(found[1], trials[1])],
    }
    after = {
        name: [
            moved(
                replace(
                    m.trial,
                    cuffs={
                        c: CuffForce.of(0.5 * f.components)
                        for c, f in m.trial.cuffs.items()
                    },
                ),
                m.measured,
                band_of(m.trial, 4.0) if name == "a" else None,
            )
            for m in moves
        ]
        for name, moves in before.items()
    }
    return SimpleNamespace(
        before=before,
        after=after,
        peaks=dict.fromkeys(["thigh", "pelvis"]),
        measured={"b": [trials[1]]},
        beyond=lambda: ["a"],
        worn={"a": seen_by("a"), "b": seen_by("b")},
        **more,
    )


SHOWN = {"a": 1.5, "b": 0.8}  # by mats, over the model


def seen_by(name):
    return SimpleNamespace(name=name, shown=lambda cuff: SHOWN[name])


def test_forces_of_a_design_lie_beside_those_of_today(trials, found):
    made = designed(trials, found, design=SimpleNamespace(removed=("pelvis",)))
    figure = figures.forces_figure(made)
    axes = np.reshape(figure.axes, (2, 2))
    for column, (name, m) in enumerate(zip("ab", trials, strict=True)):
        assert axes[0, column].get_title() == f"{name}\n{m.name}"
        assert axes[1, column].get_xlabel() == "time [s]"
        assert not axes[0, column].get_xlabel()
        for row, cuff in enumerate(("thigh", "pelvis")):
            drawn = lines(axes[row, column])
            (before,), (after,) = made.before[name], made.after[name]
            own = SHOWN[name] * before.trial.cuffs[cuff].normal
            same(drawn["today"], before.trial.times, own)
            same(drawn["design"], after.trial.times, 0.5 * own)
            if cuff in m.cuffs:
                seen = m.cuffs[cuff].normal
                same(drawn["measured today"], m.times, seen)
            assert ("measured as built" in drawn) == (
                name == "b" and cuff in m.cuffs
            )
            areas = axes[row, column].collections
            assert len(areas) == (name == "a")
            if name == "a":
                y = areas[0].get_paths()[0].vertices[:, 1]
                assert y.min() == pytest.approx((0.5 * own).min() - 6.0)
                assert y.max() == pytest.approx((0.5 * own).max() + 6.0)
    assert axes[0, 0].get_ylabel() == "thigh normal [N]"
    assert axes[1, 0].get_ylabel() == "pelvis normal [N],\nleft out"
    assert not axes[0, 1].get_ylabel()
    legend = [t.get_text() for t in figure.legends[0].get_texts()]
    assert sorted(legend) == [
        "95 % band", "design", "measured as built", "measured today", "today",
    ]  # fmt: skip
    assert figure.get_suptitle().endswith(": a")


@pytest.mark.slow
def test_a_designed_device_is_drawn_where_it_holds():
    """At the start and at the end; the thigh's cuff 3 cm further up."""
    trial = solution()
    design = Design(
        {"thigh": CuffDesign(along_m=0.03), "pelvis": CuffDesign(removed=True)}
    )
    wearer = SimpleNamespace(model=COUPLED, contact=CONTACT)
    made = SimpleNamespace(
        first=(wearer, [moved(trial, trial)]), design=design, beyond=list
    )
    figure = figures.device_figure(made)
    tree = COUPLED.tree
    for axis, row in zip(figure.axes, (0, -1), strict=True):
        q = trial.q[[row]]
        found = [x.get_xydata() for x in axis.get_lines()]

        def place(body, p, q=q):
            return tree.point_positions(q, body, p)[0]

        def is_drawn(points, found=found):
            points = np.atleast_2d(points)
            return any(
                x.shape == points.shape and np.allclose(x, points)
                for x in found
            )

        for parent, child in tree.joints.values():
            ends = [place(link, (0.0, 0.0)) for link in (parent, child)]
            assert is_drawn(ends)
        human = COUPLED.human
        top = (0.0, human.pelvis.length_m)
        assert is_drawn([place("pelvis", (0.0, 0.0)), place("pelvis", top)])
        sole = human.heel_m, (0.0, 0.0), human.toe_m
        assert is_drawn([place("foot", p) for p in sole])
        for cuff, b in CONTACT.bushings.items():
            link = tree.cuffs[cuff][0]
            own = np.array([b.origin_x, b.origin_z])
            assert is_drawn(place(link, own))
            if cuff == "shank":  # its link, from the joint to the cuff
                worn = place(tree.cuffs[cuff][1], own)
                assert is_drawn([place("exo_shank", (0.0, 0.0)), worn])
            if cuff == "thigh":
                assert is_drawn(place(link, own + np.array([0.0, 0.03])))
    left, right = figure.axes
    assert not left.texts and len(right.texts) == 3
    said = {t.get_text() for t in right.texts}
    assert said == {"thigh: 30 mm up", "pelvis: left out", "shank: as today"}
    for text in right.texts:  # beside its cuff, at its height
        assert text.xyann[0] > text.xy[0] + 0.1
        assert text.xyann[1] == text.xy[1]
        assert right.get_xlim()[1] > text.xyann[0] + 0.3
    # Where cuffs lie close, as those of both legs, their texts do not, and
    # what is beyond the calibrated stays on the figure.
    low = CuffDesign(
        along_m=-0.15, hinge=0.5, slide=0.5, area=2.0,
        strap_normal_n_m=2e3, strap_rotational_nm_rad=9.0,
    )  # fmt: skip
    close = {"thigh": CuffDesign(along_m=-0.4), "shank": low}
    made.design, made.beyond = Design(close), lambda: ["thigh_of_the_left"] * 6
    crowded = figures.device_figure(made)
    FigureCanvasAgg(crowded).draw()
    boxes = [Text.get_window_extent(t) for t in crowded.axes[1].texts]
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    axes = crowded.axes[1].bbox
    assert all(axes.y0 < box.y0 and box.x1 < crowded.bbox.x1 for box in boxes)
    words = crowded.texts[0].get_text().split(": ")[1]
    assert words.replace("\n", " ") == ", ".join(["thigh_of_the_left"] * 6)
    head = crowded.texts[0].get_window_extent()
    assert head.x0 >= 0.0 and head.x1 <= crowded.bbox.width
    assert left.get_title() == "start"
    assert right.get_title() == f"end of {trial.name}"


@pytest.mark.slow
@pytest.mark.parametrize("place", ["standing", "seated"])
def test_both_panels_of_a_device_have_one_scale(place):
    """Of somebody who stands throughout, numbers along x stay apart."""
    trial = solution()
    row = {"standing": -1, "seated": 0}[place]
    trial = replace(trial, q=np.tile(trial.q[row], (len(trial.q), 1)))
    wearer = SimpleNamespace(model=COUPLED, contact=CONTACT)
    made = SimpleNamespace(
        first=(wearer, [moved(trial, trial)]),
        design=Design({"thigh": CuffDesign(along_m=0.03)}),
        beyond=list,
    )
    figure = figures.device_figure(made)
    FigureCanvasAgg(figure).draw()
    left, right = figure.axes
    assert left.bbox.height == pytest.approx(right.bbox.height)
    for axis in figure.axes:
        numbers = [
            label.get_window_extent()
            for label in axis.get_xticklabels()
            if axis.get_xlim()[0] <= label.get_position()[0]
            and label.get_position()[0] <= axis.get_xlim()[1]
        ]
        assert numbers
        for one, other in combinations(numbers, 2):
            assert not one.overlaps(other)


@pytest.mark.parametrize(
    ("design", "words"),
    [
        (CuffDesign(), "c: as today"),
        (CuffDesign(removed=True, along_m=0.1), "c: left out"),
        (
            CuffDesign(along_m=-0.012, across_m=0.0031),
            "c: 12 mm down\n    3 mm forwards",
        ),
        (CuffDesign(along_m=0.0004, across_m=-0.0006), "c: 1 mm backwards"),
        (CuffDesign(slide=0.5, hinge=1.0),
         "c: slide that takes 50 %\n    hinge"),
        (CuffDesign(slide=0.004, hinge=0.006), "c: hinge that takes 1 %"),
    ],
)  # fmt: skip
def test_what_is_to_be_built_is_told_in_words(design, words):
    assert figures._told("c", design) == words


def test_a_design_s_front_is_force_against_work():
    rows = [
        {"share": 0.1 * w, "work_j": w, "norm_n": n, "success": n < 99.0,
         "dominated": n > 60.0}
        for w, n in ((5.0, 70.0), (7.0, 99.0), (9.0, 50.0))
    ]  # fmt: skip
    (ax,) = figures.design_front_figure(rows).axes
    line, best = ax.get_lines()
    np.testing.assert_array_equal(line.get_data(), [[5.0, 9.0], [70.0, 50.0]])
    np.testing.assert_array_equal(best.get_data(), [[9.0], [50.0]])
    found = {a.get_text(): a.xy for a in ax.texts}
    assert found == {"×0.5": (5.0, 70.0), "×0.9": (9.0, 50.0)}


@pytest.mark.slow
def test_a_legend_leaves_room_for_the_titles(trials, found):
    """However many entries it has: nothing lies on anything else."""
    for runs in ({"model": found}, {f"run {k}": found for k in range(6)}):
        figure = figures.interaction_figure(runs, trials)
        FigureCanvasAgg(figure)
        drawn = figure.canvas.get_renderer()
        legend = figure.legends[0].get_window_extent(drawn)
        assert legend.y1 <= figure.bbox.height
        titles = [ax.title.get_window_extent(drawn) for ax in figure.axes]
        assert max(t.y1 for t in titles) < legend.y0
        assert all(ax.get_visible() for ax in figure.axes)


@pytest.mark.slow
def test_long_names_of_rows_stay_apart(trials, found):
    """As of a device with two legs."""
    labels = [f"exo. {side}_knee [N m]" for side in ("left", "right")]
    rows = [(label, lambda t: t.coordinate("knee")) for label in labels]
    rows = [*rows, ("knee_right [°/s]", rows[0][1])]
    figure = figures._drawn({"model": found}, trials, rows, height=1.35)
    FigureCanvasAgg(figure)
    drawn = figure.canvas.get_renderer()
    first = figure.axes[:: len(trials)]
    boxes = [ax.yaxis.label.get_window_extent(drawn) for ax in first]
    assert all(above.y0 > below.y1 for above, below in pairwise(boxes))
    told = [ax.get_ylabel() for ax in first]
    assert [t.replace("\n", " ").replace("_ ", "_") for t in told] == [
        *labels, "knee_right [°/s]",
    ]  # fmt: skip
    assert "\n[N m]" in told[0] and "\n" not in told[2]


@pytest.mark.slow
def test_many_trials_of_long_names_stay_apart(trials, found):
    """Titles do not touch, nor is a figure too wide for a screen."""
    name = "subject_07_assisted_standing_up_slow_second"
    many = [replace(trials[0], name=f"{name}_{k:02d}") for k in range(12)]
    runs = {"model": found[:1] * 12}
    figure = figures.interaction_figure(runs, many)
    assert figure.get_size_inches()[0] < 20.0
    FigureCanvasAgg(figure)
    drawn = figure.canvas.get_renderer()
    boxes = [a.title.get_window_extent(drawn) for a in figure.axes[:12]]
    for left, right in pairwise(boxes):
        assert left.x1 < right.x0
    told = [a.get_title().replace("\n", "") for a in figure.axes[:12]]
    assert told == [trial.name for trial in many]
    at_a_glance = figures.overview_figure(found[0], many[0])
    FigureCanvasAgg(at_a_glance)
    drawn = at_a_glance.canvas.get_renderer()
    below = at_a_glance.texts[0].get_window_extent(drawn)
    assert below.y1 <= at_a_glance.legends[0].get_window_extent(drawn).y0


@pytest.mark.slow
def test_both_legs_joints_are_told_apart_without_hiding_curves():
    """A joint has its colour, a side its dash; legends lie below."""
    model = Model(Assembly(Person("two")), nominal_human())
    names, one = model.coordinates, seen()
    q = np.outer(one.times, np.arange(len(names)))
    moments = q[:, names.joint_columns]
    moved = {"q": q, "v": q, "a": q, "moments": moments, "cuffs": {}}
    trial = replace(one, coordinates=names, **moved)
    quality = TrialQuality(
        **{
            **dict.fromkeys(TrialQuality.__dataclass_fields__),
            "residual": np.zeros((len(trial.times), 3)),
            "marker_rms_m": {},
        }
    )
    figure = figures.quality_figure(trial, quality)
    ax = figure.axes[0]
    drawn = {x.get_label(): x for x in ax.get_lines()}
    left, right = drawn["knee_left"], drawn["knee_right"]
    assert left.get_color() == right.get_color()
    assert left.get_linestyle() != right.get_linestyle()
    assert left.get_color() != drawn["hip_left"].get_color()
    # Nobody wears mats without a device.
    assert "mats" not in " ".join(ax.get_title() for ax in figure.axes)
    t = trial.start_s + trial.times
    same(lines(figure.axes[4])["feet"], t, trial.ground.cop_x)
    FigureCanvasAgg(figure).draw()
    legend = ax.get_legend().get_window_extent()
    assert legend.y1 < ax.bbox.y0


@pytest.mark.slow
@undrawn()
def test_one_trial_at_a_glance(trials, found):
    measured, predicted = trials[1], found[1]
    figure = figures.overview_figure(predicted, measured, band_of(predicted, 4))
    axes = {ax.get_ylabel(): ax for ax in figure.axes}
    units = [f"{joint} [{u}]" for u in ("°", "°/s") for joint in JOINTS[:3]]
    ground = ["$F_x$ [N]", "$F_z$ [N]", "CoP $x$ [m]"]
    assert set(axes) == {
        *units,
        *(f"{cuff} normal [N]" for cuff in CUFFS),
        *ground,
    }
    drawn = lines(axes["thigh normal [N]"])
    same(drawn["measured"], measured.times, measured.cuff("thigh").normal)
    same(drawn["predicted"], predicted.times, predicted.cuff("thigh").normal)
    for cuff, force in predicted.cuffs.items():
        (area,) = axes[f"{cuff} normal [N]"].collections
        y = area.get_paths()[0].vertices[:, 1]
        around = [force.normal.min() - 4.0, force.normal.max() + 4.0]
        np.testing.assert_allclose([y.min(), y.max()], around)
    assert "measured" not in lines(axes["shank normal [N]"])
    assert [t.get_text() for t in figure.texts] == [measured.name]


def test_texts_beside_a_drawing_follow_each_other():
    """As far apart as their lines are high; a larger figure shows less a m."""
    apart = []
    for larger in (1.0, 2.0):
        axis = Figure().subplots()
        axis.set(xlim=(0.0, 1.0), ylim=(0.0, 2.0))
        same = np.array([0.5, 1.0])
        texts = {"left": same, "right": same, "two\nlines": same}
        figures._write_beside(axis, texts, larger)
        heights = [text.xyann[1] for text in axis.texts]
        apart.append(-np.diff(heights))
    assert apart[0] == pytest.approx([0.084, 0.126])
    assert apart[1] == pytest.approx(0.5 * apart[0])


@pytest.mark.slow
def test_legends_stay_inside_narrow_figures(trials, found):
    # As a batch names the folders of its variants.
    key = "prediction.solver.nodes_per_second"
    long = {f"{key}={n},interaction.{key}={n}": found[:1] for n in (40, 60)}
    for figure in (
        figures.kinematics_figure({"predicted": found[:1]}, trials[:1]),
        figures.kinematics_figure(long, trials[:1]),
        figures.interaction_figure(long, trials[:1]),
        figures.overview_figure(found[0], trials[0]),
    ):
        FigureCanvasAgg(figure).draw()
        (legend,) = figure.legends
        box = legend.get_window_extent()
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.width
        assert box.y1 <= figure.bbox.height
        top = max(ax.get_tightbbox().y1 for ax in figure.axes)
        assert box.y0 >= top
