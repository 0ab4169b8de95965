"""Designs of a device on two legs whose sides are to be alike."""

from dataclasses import replace

import numpy as np
import pytest
import two_legs_device

from drake_exo.calibration.design import DesignProblem
from drake_exo.calibration.design_variables import (
    design_of,
    design_variables,
    mirror_of,
)
from drake_exo.calibration.settings import CuffFreedom, DesignSettings, Solver
from drake_exo.calibration.wearers import Wearer
from drake_exo.collocation.initial_guess import minimum_jerk
from drake_exo.contact.bushing import BushingParameters
from drake_exo.contact.parameters import nominal_contact
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.assembly import Assembly
from drake_exo.model.description import nominal_human
from drake_exo.model.device_file import with_text
from drake_exo.model.plant import Model

SETTINGS = DesignSettings(
    points=2, solver=Solver(10.0, tolerance=1e-6), symmetric=True
)
# Flexion that each joint of the device begins with.
BENT_DEG = {"left_hip": 60, "left_knee": 70, "right_hip": 50, "right_knee": 90}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("device")
    assembly = schema.load(two_legs_device.write(folder), Assembly)
    return Model(with_text(assembly, folder), nominal_human())


@pytest.fixture(scope="module")
def wearer(model):
    """The device rises, driven at the right knee and at both hips."""
    names, times = model.coordinates, np.linspace(0.0, 1.0, 41)
    shape = minimum_jerk(times)
    q, v, a = (np.zeros((41, len(names.names))) for _ in range(3))
    for joint, deg in BENT_DEG.items():
        for x, y in zip((q, v, a), shape, strict=True):
            x[:, names.index(joint)] = np.deg2rad(deg) * (y - (x is q))
    moments = np.zeros((41, len(names.joints)))
    for joint in ("left_hip", "right_hip", "right_knee"):
        moments[:, names.joint(joint)] = 10.0 * np.sin(np.pi * times)
    nothing = PlanarWrench.of(np.zeros((41, 3)))
    trial = Trial(
        "rise", names, times, q, v, a, nothing,
        feet=dict.fromkeys(("left", "right"), nothing), moments=moments,
        cuffs={c: CuffForce.of(np.full((41, 3), 5.0)) for c in model.cuffs},
    )  # fmt: skip
    contact = nominal_contact(model)
    low = BushingParameters(origin_z=0.1)
    contact = replace(contact, bushings=contact.bushings | {"thigh_left": low})
    return Wearer("somebody", model, contact, (trial,))


def test_twins_have_what_both_allow(wearer):
    each, both = (
        {v.name: v for v in design_variables([wearer], settings)}
        for settings in (replace(SETTINGS, symmetric=False), SETTINGS)
    )
    left, right = "thigh_left.along_m", "thigh_right.along_m"
    # 50 mm from the knee, and the usual 100 mm upwards.
    assert each[left].lower == pytest.approx(-0.05)
    assert each[right].lower == -0.1
    assert (both[left].lower, both[left].upper) == pytest.approx((-0.05, 0.1))
    for name, v in both.items():
        assert both[mirror_of(name)] == replace(v, name=mirror_of(name))
    # Only the right knee is driven, so that a left one has no factor; alike,
    # both have, at the angles of both.
    assert "right_knee.factor_at_-90_deg" in each
    assert not any(name.startswith("left_knee") for name in each)
    knees = [n.partition(".")[2] for n in both if n.startswith("left_knee")]
    assert knees == ["factor_at_-90_deg", "factor_at_0_deg"]


def test_a_side_without_a_namesake_is_told(wearer):
    """It would silently be designed by itself."""
    model = wearer.model
    assembly = model.assembly
    cuffs = {
        name.replace("thigh_right", "oben_rechts"): links
        for name, links in assembly.cuffs.items()
    }
    renamed = Model(replace(assembly, cuffs=cuffs), model.human)
    contact = nominal_contact(renamed)
    other = Wearer("somebody", renamed, contact, wearer.trials)
    with pytest.raises(InputError) as caught:
        design_variables([other], SETTINGS)
    assert str(caught.value) == (
        "design.symmetric: thigh_left goes with thigh_left, but there is no "
        "name that differs from it in left and right alone; give both sides "
        "such names, as thigh_left and thigh_right, or leave symmetric out"
    )
    design_variables([other], replace(SETTINGS, symmetric=False))


def test_one_variable_stands_for_both_sides(wearer):
    held = {"thigh_right.along_m": 0.02, "thigh_left.along_m": 0.02}
    problem = DesignProblem([wearer], SETTINGS, held=held)
    pairs = [(n, mirror_of(n)) for n in problem.variables]
    index = {n: problem.program.index(v) for n, v in problem.variables.items()}
    assert all(index[a] == index[b] for a, b in pairs)
    assert len(set(index.values())) == len(pairs) / 2
    x = problem.guess({"shank_left.strap_normal_n_m": 1e-4})
    found = design_of({n: x[i] for n, i in index.items()})
    assert found.cuffs["shank_left"].strap_normal_n_m is None
    x = problem.guess({n: 1e-4 for n in index if "strap_normal" in n})
    found = design_of({n: x[i] for n, i in index.items()})
    for part in ("thigh", "shank"):
        one, other = (found.cuffs[f"{part}_{s}"] for s in ("left", "right"))
        assert one == other
        assert one.strap_normal_n_m == pytest.approx(1e4)
    assert found.cuffs["thigh_left"].along_m == 0.02


def test_a_name_without_side_stands_for_both(wearer):
    free = CuffFreedom(across_m=(-0.01, 0.01))
    settings = replace(SETTINGS, cuffs={"shank": free})
    assert settings.freedom("shank_left") == settings.freedom("shank_right")
    own = replace(
        settings, cuffs=settings.cuffs | {"shank_left": CuffFreedom()}
    )
    assert own.freedom("shank_left") == CuffFreedom()
    with pytest.raises(InputError, match="shank_left and shank_right may not"):
        DesignProblem([wearer], own)
    DesignProblem([wearer], replace(own, symmetric=False))
