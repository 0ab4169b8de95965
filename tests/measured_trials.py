"""Trials of the coupled model whose every number the test chooses."""

from dataclasses import replace

import numpy as np

from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.plant import nominal_model

TREE = nominal_model("coupled").tree
NAMES = TREE.coordinates
CUFFS = ("thigh", "pelvis", "shank")
JOINTS = ("ankle", "knee", "hip", "exo_ankle", "exo_knee", "exo_hip")


def saying(result, **found):
    """The same result of a phase with other trials or another contact."""
    other = replace(result)
    other.__dict__.update(found)
    return other


def seen(name="rise", duration=2.0, cuffs=("thigh",), n=201) -> Trial:
    """A measured rise: curves that a cubic spline passes to 1e-6."""
    t = np.linspace(0.0, duration, n)
    s = t / duration
    q = np.outer(np.sin(s), np.linspace(0.1, 0.9, 9))
    v = np.outer(np.cos(s), np.linspace(-1.0, 1.0, 9))
    force = np.column_stack([20.0 * np.sin(3.0 * s), 700.0 + 50.0 * s])
    return Trial(
        name,
        NAMES,
        t,
        q,
        v,
        0.0 * q,
        PlanarWrench(force, -0.08 * force[:, 1]),
        moments=np.outer(1.0 + s, np.arange(1.0, 7.0)),
        cuffs={c: CuffForce(30.0 + 10.0 * s) for c in cuffs},
    )


def moved(
    trial: Trial, q=0.0, v=0.0, moments=0.0, force=0.0, cop=0.0, normal=0
):
    """Shifted by given amounts, which broadcast with what they shift."""
    ground = trial.ground
    F = ground.force + force
    cuffs = {c: CuffForce(f.normal + normal) for c, f in trial.cuffs.items()}
    return replace(
        trial,
        q=trial.q + q,
        v=trial.v + v,
        moments=trial.moments + moments,
        ground=PlanarWrench(F, -(ground.cop_x + cop) * F[:, 1]),
        cuffs=cuffs,
    )


def prediction(trial: Trial) -> Trial:
    """What a model might have found: other nodes, all cuffs, all off."""
    at = moved(trial, q=0.01, v=0.1, moments=3.0, force=[2.0, -5.0], cop=0.004)
    at = at.sample(np.linspace(0.0, trial.duration, 41))
    forces = np.outer(1.0 + at.times, [5.0, 20.0, 0.5])
    cuffs = {
        cuff: CuffForce.of((k + 1.0) * forces)
        for k, cuff in enumerate(dict.fromkeys([*trial.cuffs, *CUFFS]))
    }
    return replace(at, source="solved", cuffs=cuffs)
