import json

import numpy as np
import pytest
from undrawn import undrawn

from drake_exo.cli import main
from drake_exo.report.figures import (
    ContactCurves,
    _up,
    draw_friction,
    draw_normal_force,
    measures,
    write_figures,
)

FILES = {
    "figure_8_normal_force.png",
    "figure_8_normal_force.pdf",
    "figure_9_friction.png",
    "figure_9_friction.pdf",
    "summary.json",
}


def line(axes, label):
    return next(li for li in axes.get_lines() if li.get_label() == label)


def test_figure_8_is_monotone_with_a_slope_in_the_zoom():
    figure = draw_normal_force(ContactCurves())
    (axes,) = figure.axes
    x, force = line(axes, "paper, at rest").get_data()
    assert (x[0], x[-1]) == (-50.0, 20.0)
    assert np.all(np.diff(force) > 0.0)
    (inset,) = axes.child_axes
    zoom, small = inset.get_lines()[0].get_data()
    assert (zoom[0], zoom[-1]) == (-50.0, 0.0)
    assert np.all(np.diff(small) / np.diff(1e-3 * zoom) > 2.9)
    assert np.max(small) < 0.475


def test_figure_8_draws_each_law_in_millimetres():
    """Hertz at rest where the surfaces are well in; damping by 1 + 3/2 c v."""
    curves = ContactCurves()
    (axes,) = draw_normal_force(curves).axes
    drawn = {li.get_label(): li.get_data() for li in axes.get_lines()}
    x, rest = drawn["paper, at rest"]
    deep = np.searchsorted(x, 19.0)
    # Force of Hertz for a plane-strain modulus halved by two bodies.
    hertz = 4.0 / 3.0 * (0.5 * 5e6) * np.sqrt(0.032) * 0.019**1.5
    own, simbody = (
        drawn[k][1][deep] for k in ("paper, at rest", "simbody, at rest")
    )
    assert own / simbody == pytest.approx(1.0, rel=0.02)
    assert 0.3 < own / hertz < 3.0
    for rate in (0.1, -0.1):
        word = "sinking" if rate > 0.0 else "leaving"
        _, moving = drawn[f"paper, {word} at 0.1 m/s"]
        expected = 1.0 + 1.5 * 2.0 * rate
        assert moving[deep] / rest[deep] == pytest.approx(expected, rel=1e-3)
        assert len(moving) == len(x)
    assert axes.get_xlabel() == "indentation [mm]"
    for label in drawn:
        if "rest" in label or "m/s" in label:
            np.testing.assert_allclose(drawn[label][0][[0, -1]], [-50, 20])


def test_figure_9_peaks_at_one_and_is_flat_from_three():
    figure = draw_friction(ContactCurves())
    ratio, mu = line(figure.axes[0], r"paper, $\mu_2$").get_data()
    assert ratio[np.argmax(mu)] == 1.0
    assert np.max(mu) == pytest.approx(0.9)
    np.testing.assert_allclose(mu[ratio >= 3.0], 0.6, rtol=1e-12)
    assert mu[0] == 0.0


def test_slope_out_of_contact_is_that_of_the_curve():
    figure = draw_normal_force(ContactCurves())
    (inset,) = figure.axes[0].child_axes
    zoom, small = inset.get_lines()[0].get_data()
    slope = np.diff(small).min() / (1e-3 * (zoom[1] - zoom[0]))
    told = measures(ContactCurves())
    assert told["slope_out_of_contact_n_per_m"] == pytest.approx(
        slope, rel=6e-3
    )
    assert told["force_out_of_contact_n"] == pytest.approx(small.max())


@pytest.mark.slow
def test_command_writes_the_same_files_twice(tmp_path, capsys):
    for name in ("one", "two"):
        assert main(["contact", "--out", str(tmp_path / name)]) == 0
    shown = capsys.readouterr().out
    for file in FILES:
        assert file in shown
        first, second = (tmp_path / n / file for n in ("one", "two"))
        assert first.read_bytes() == second.read_bytes()
    png = (tmp_path / "one" / "figure_8_normal_force.png").read_bytes()
    assert png.startswith(b"\x89PNG") and len(png) > 20000
    summary = json.loads((tmp_path / "one" / "summary.json").read_text())
    assert summary["parameters"]["modulus"] == 5e6
    assert 0.44 < summary["force_out_of_contact_n"] < 0.475
    assert summary["slope_out_of_contact_n_per_m"] == pytest.approx(
        2.96, abs=0.01
    )
    assert summary["peak_friction_at_v_rel"] == 1.0
    assert summary["friction_at_v_rel_3"] == pytest.approx(0.6)


def test_each_file_holds_what_its_name_says(tmp_path):
    with undrawn():
        files = write_figures(tmp_path, ContactCurves())
    assert {path.name for path in files} == FILES
    told = json.loads((tmp_path / "summary.json").read_text())
    expected = measures(ContactCurves())
    for name, value in expected.items():
        if name != "parameters":
            assert told[name] == pytest.approx(value)
    assert told["peak_friction_at_v_rel"] == 1.0
    assert told["peak_friction"] == pytest.approx(0.9)
    assert told["friction_at_v_rel_3"] == pytest.approx(0.6)
    assert told["slope_out_of_contact_n_per_m"] == pytest.approx(2.96, abs=0.01)


def test_figure_9_against_the_friction_s_formula():
    """Of simbody: min(v, 1) (u_d + 2 (u_s - u_d) / (1 + v²)) (Sherman 2011)."""
    (axes,) = draw_friction(ContactCurves()).axes
    v, mu = line(axes, "simbody, without viscous part").get_data()
    expected = np.minimum(v, 1.0) * (0.6 + 2.0 * 0.3 / (1.0 + v**2))
    np.testing.assert_allclose(mu, expected, atol=1e-6)
    v, dry = line(axes, r"paper, $\mu_2$").get_data()
    (label,) = (
        li.get_label() for li in axes.get_lines() if "mu_1" in li.get_label()
    )
    # 0.5 s/m times the speed, 0.05 m/s at v = 1.
    viscous = line(axes, label).get_data()[1] - dry
    np.testing.assert_allclose(viscous, 0.5 * 0.05 * v, atol=1e-9)
    levels = [li.get_data() for li in axes.get_lines()][3:]
    np.testing.assert_allclose(
        levels,
        [
            [[0.0, 1.0], [0.9, 0.9]],
            [[1.0, 1.0], [0.0, 0.9]],
            [[0.0, 3.0], [0.6, 0.6]],
            [[3.0, 3.0], [0.0, 0.6]],
        ],
    )


def test_bounds_that_are_told_are_rounded_upwards():
    assert _up(0.4612) == 0.47 and _up(-2.9689) == -2.96
    (axes,) = draw_normal_force(ContactCurves()).axes
    (inset,) = axes.child_axes
    told = measures(ContactCurves())
    words = inset.texts[0].get_text()
    force, slope = (float(x.split()[2]) for x in words.split("\n"))
    assert 0.0 <= force - told["force_out_of_contact_n"] < 0.01
    assert 0.0 <= told["slope_out_of_contact_n_per_m"] - slope < 0.01
    # All that is drawn is within the axes.
    for panel in (axes, inset):
        (left, right), (low, high) = panel.get_xlim(), panel.get_ylim()
        for drawn in panel.get_lines():
            x, y = drawn.get_data()
            shown = y[(x >= left) & (x <= right)]
            # The fastest curve may leave it at its end.
            assert low <= shown.min() and shown[0] < high < 3 * shown.max()


def test_command_refuses_to_overwrite(tmp_path, capsys):
    with undrawn():
        assert main(["contact", "--out", str(tmp_path)]) == 0
    assert main(["contact", "--out", str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--radius", "0", "radius is 0, but must be above 0 m"),
        ("--radius", "32", "radius is 32, but must be at most 0.5 m"),
        ("--modulus", "nan", "modulus is nan, but must be a finite number"),
        ("--dissipation", "-1", "must be at least 0"),
        ("--dynamic-friction", "0.95", "above static friction"),
    ],
)
def test_command_refuses_bad_values(tmp_path, capsys, option, value, message):
    folder = tmp_path / "out"
    assert main(["contact", "--out", str(folder), f"{option}={value}"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not folder.exists()
