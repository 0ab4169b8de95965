"""Spheres that stand for a sole: known ones come back, errors are told."""

import numpy as np
import pytest
import yaml

from drake_exo import cli
from drake_exo.contact.hunt_crossley import SimbodyConstants, sphere_force
from drake_exo.contact.reduction import Samples, reduce_sole, softened
from drake_exo.errors import InputError
from drake_exo.soles.case import EXAMPLE, Case

SIZE = np.array([0.26, 0.1, 0.03])
E = np.array([3e7, 6e7, 2e7])
PLACE = np.array(
    [[-0.1, 0.0, -0.005], [0.05, 0.03, -0.005], [0.1, -0.03, -0.004]]
)
RADIUS, SHARE = 0.025, 0.15


def _poses(count=40, planar=False):
    s = np.linspace(0, 1, count)
    pitch = -0.02 + 0.04 * s
    roll = 0 * s if planar else 0.01 * np.sin(7 * s)
    c, sn = np.cos(pitch), np.sin(pitch)
    R = np.zeros((count, 3, 3))
    R[:, 0, 0], R[:, 0, 2], R[:, 2, 0], R[:, 2, 2] = c, sn, -sn, c
    R[:, 1, 1] = 1.0
    tilt = np.zeros_like(R)
    tilt[:, 0, 0] = 1.0
    tilt[:, 1, 1] = tilt[:, 2, 2] = np.cos(roll)
    tilt[:, 1, 2], tilt[:, 2, 1] = -np.sin(roll), np.sin(roll)
    height = 0.0285 - 0.001 * np.sin(np.pi * s)
    return np.stack([0 * s, 0 * s, height], axis=1), tilt @ R


def _truth(planar=False):
    """Samples of spheres, by a loop of its own."""
    origin, R = _poses(planar=planar)
    place = PLACE * [1, 0, 1] if planar else PLACE
    constants = softened(SHARE)
    force, cop = np.zeros(len(origin)), np.zeros((len(origin), 2))
    for q, (O, turn) in enumerate(zip(origin, R, strict=True)):  # noqa: E741
        for modulus, p in zip(E, place, strict=True):
            x, y, z = O + turn @ p
            normal, _ = sphere_force(
                "simbody", RADIUS - z, 0.0, 0.0, modulus, 0.0, RADIUS, constants
            )
            force[q] += normal
            cop[q] += normal * np.array([x, y])
    return Samples(origin, R, force, cop / force[:, None], SIZE)


def test_smoothing_of_a_centimetre_is_the_law_s_own():
    assert softened(1.0) == SimbodyConstants()
    assert softened(0.5).hertz_smoothing == 600.0


@pytest.mark.parametrize("planar", [True, False])
def test_spheres_are_found_again(planar):
    found = reduce_sole(_truth(planar), 3, planar)
    assert found.force_error < 2e-3
    assert found.cop_error < 2e-4
    assert found.is_near
    rows = found.table()
    np.testing.assert_allclose(rows["force_n"], found.samples.force)
    assert ("cop_y_m" in rows) == (not planar)


def test_errors_are_those_of_what_is_written():
    """One sphere cannot do it; the figures are those of its own table."""
    found = reduce_sole(_truth(), 1)
    rows = found.table()
    off = rows["force_spheres_n"] - rows["force_n"]
    wanted = np.sqrt((off**2).mean()) / rows["force_n"].max()
    assert found.force_error == pytest.approx(wanted)
    loaded = rows["loaded"].astype(bool)
    dx = (rows["cop_x_spheres_m"] - rows["cop_x_m"])[loaded]
    dy = (rows["cop_y_spheres_m"] - rows["cop_y_m"])[loaded]
    wanted = np.sqrt((dx**2 + dy**2).mean())
    assert found.cop_error == pytest.approx(wanted)
    assert not found.is_near
    law = found.law()
    assert law["force_error_rms"] == found.force_error
    assert law["spheres"]["sphere1"]["radius_m"] == found.radius


def test_too_few_samples_are_refused():
    whole = _truth()
    few = Samples(
        whole.origin[:3], whole.rotation[:3], whole.force[:3], whole.cop[:3],
        SIZE,
    )  # fmt: skip
    with pytest.raises(InputError, match="fewer spheres"):
        reduce_sole(few, 3)


@pytest.mark.slow
def test_the_command_writes_law_and_samples(tmp_path, capsys):
    Case.from_text(
        EXAMPLE.replace("samples: 5", "samples: 9")
    ).simulate().write(tmp_path)
    out = tmp_path / "law.yaml"
    argv = ["sole", "reduce", str(tmp_path), "--spheres", "2", "--planar",
            "--out", str(out)]  # fmt: skip
    assert cli.main(argv) in (0, 1)
    law = yaml.safe_load(out.read_text())
    assert law["planar"] and list(law["spheres"]) == ["sphere1", "sphere2"]
    assert f"{100 * law['force_error_rms']:.1f} %" in capsys.readouterr().out
    assert out.with_suffix(".csv").is_file()
    assert cli.main(argv) == 2
    assert (
        cli.main(["sole", "reduce", "nowhere", "--out", str(out), "--force"])
        == 2
    )
