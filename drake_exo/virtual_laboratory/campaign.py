"""A measurement campaign: simulated, measured, written, truth apart."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from drake_exo.errors import InputError
from drake_exo.laboratory.opensim_files import write_table
from drake_exo.laboratory.sagittal import PlanarWrench
from drake_exo.laboratory.tables import Table
from drake_exo.output import Progress, write_json
from drake_exo.planar_tree import PlanarTree
from drake_exo.plant import COUPLED_COORDINATES, build_plant
from drake_exo.virtual_laboratory.instruments import (
    DISTURBANCES,
    MARKER_RATE_HZ,
    PLATES,
    Instruments,
)
from drake_exo.virtual_laboratory.marker_set import (
    marker_set,
    study_markers,
)
from drake_exo.virtual_laboratory.plan import Planner, Posture, RisePlan
from drake_exo.virtual_laboratory.simulation import (
    RATE_HZ,
    Simulated,
    simulate,
)
from drake_exo.virtual_laboratory.truth import STANDING_COP_M, Truth, draw_truth

NUM_TRIALS = 3
_STANDING_S = 2.0
# A trial begins when the chair is felt no more, a little later so that the
# filter does not smear the chair's force into it.
_CHAIR_GONE_N = 2.0
_AFTER_CHAIR_S = 0.08
_AFTER_RISE_S = 0.1


def write_campaign(
    folder: str | Path,
    seed: int,
    disturbances: Iterable[str] = tuple(DISTURBANCES),
    trials: int = NUM_TRIALS,
) -> Path:
    """Simulate a subject and write what a laboratory would hand over.

    Args:
        folder: exists; receives study.yaml, standing and trial files, and
            truth/, which no calibration reads.
        seed: same seed, same bytes.
        disturbances: names of `DISTURBANCES` that act.
        trials: number of sit-to-stand movements.

    Returns:
        The study file.

    Raises:
        InputError: unknown disturbance, negative seed or no trial.
    """
    folder, active = Path(folder), frozenset(disturbances)
    _check(seed, active, trials)
    truth = draw_truth(np.random.default_rng([seed, 0]))
    plant = build_plant(
        "rigid", truth.human, truth.exoskeleton, gravity=truth.gravity
    )
    planner = Planner(PlanarTree.from_plant(plant), truth.contact)
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    windows = {}
    with Progress("virtual laboratory", interval_seconds=2.0) as progress:
        plan = planner.standing(_STANDING_S, STANDING_COP_M)
        standing = simulate("standing", truth, plan, None, progress)
        _measure(folder, standing, truth, active, seed, 1)
        for number in range(1, trials + 1):
            rng = np.random.default_rng([seed, 1, number])
            plan = vary(RisePlan(), rng)
            seat = planner.seat(plan)
            reference = planner.rise(plan, seat)
            movement = simulate(
                f"rise{number}", truth, reference, seat, progress
            )
            _measure(folder, movement, truth, active, seed, 1 + number)
            windows[movement.name] = _window(movement, plan)
    _write_truth(folder / "truth", truth, seed, active)
    return _write_study(folder, truth, windows)


def vary(plan: RisePlan, rng: np.random.Generator) -> RisePlan:
    """Another repetition of the same movement by the same subject."""

    def turned(posture: Posture, spread: Posture) -> Posture:
        return Posture(
            *(
                float(getattr(posture, k) + rng.uniform(-1.0, 1.0) * s)
                for k, s in vars(spread).items()
            )
        )

    return replace(
        plan,
        seated=turned(plan.seated, Posture(2.0, 2.0, 3.0)),
        leant=turned(plan.leant, Posture(2.0, 2.0, 4.0)),
        lean_s=float(plan.lean_s * rng.uniform(0.9, 1.15)),
        rise_s=float(rng.uniform(1.2, 1.7)),
        cop_m=float(plan.cop_m + rng.uniform(-0.01, 0.01)),
    )


def _check(seed: int, active: frozenset[str], trials: int) -> None:
    for name in sorted(active - set(DISTURBANCES)):
        raise InputError(
            f"no disturbance is called '{name}'; known are "
            f"{', '.join(DISTURBANCES)}"
        )
    if seed < 0:
        raise InputError(f"seed is {seed}; give a number from 0 on")
    if trials < 1:
        raise InputError(f"trials is {trials}; one is the least")


def _measure(folder, movement, truth, active, seed, number) -> None:
    """Write one movement's files, and what truly happened."""
    rng = np.random.default_rng([seed, 2, number])
    instruments = Instruments(
        marker_set(truth.human), float(rng.uniform(0.46, 0.54)), active
    )
    name = movement.name
    instruments.write_markers(folder / f"{name}.trc", movement, rng)
    instruments.write_plates(folder / f"{name}_forces.mot", movement, rng)
    if name != "standing":
        instruments.write_encoders(
            folder / f"{name}_encoders.mot", movement, rng
        )
    write_table(
        folder / "truth" / f"{name}.sto",
        truth_table(movement),
        f"{name}: what truly happened",
    )


def _write_truth(folder: Path, truth: Truth, seed: int, active) -> None:
    """All of it, and each phase's parameters by their names there."""
    about = {"seed": seed, "disturbances": active}
    write_json(folder / "truth.json", {**about, "parameters": truth})
    for name, contacts in (
        ("foot_ground", truth.contact.spheres),
        ("interaction", truth.bushings),
    ):
        values = {
            f"{part}.{key}": value
            for part, contact in contacts.items()
            for key, value in vars(contact).items()
        }
        write_json(folder / f"{name}.json", {**about, "parameters": values})


def truth_table(movement: Simulated) -> Table:
    """Motion, joint torques and forces at the markers' rate, in SI units."""
    step = round(RATE_HZ / MARKER_RATE_HZ)
    names, columns = [], []
    for suffix, values in (
        ("", movement.q),
        ("_speed", movement.v),
        ("_acceleration", movement.a),
    ):
        names += [name + suffix for name in COUPLED_COORDINATES]
        columns.append(values)
    names += [f"{name}_torque" for name in COUPLED_COORDINATES[3:]]
    columns.append(movement.torque)
    for place, w in (("ground", movement.ground), ("chair", movement.chair)):
        names += [f"{place}_{k}" for k in ("force_x", "force_z", "moment_y")]
        columns.append(_columns(w))
    names += [
        f"{bushing}_{component}"
        for bushing in ("shank", "thigh", "pelvis")
        for component in ("tangential", "normal", "rotation")
    ]
    columns.append(movement.interaction)
    values = np.hstack(columns)[::step]
    return Table(movement.times[::step], tuple(names), values, False)


def _columns(wrench: PlanarWrench) -> np.ndarray:
    return np.column_stack([wrench.force, wrench.moment])


def _window(movement: Simulated, plan: RisePlan) -> tuple[float, float]:
    """Used part of a trial, to the marker frame [s]."""
    felt = movement.chair.force[:, 1] > _CHAIR_GONE_N
    start = movement.times[np.flatnonzero(felt)[-1]] + _AFTER_CHAIR_S
    end = plan.duration - plan.stand_s + _AFTER_RISE_S
    frames = np.round(np.array([start, end]) * MARKER_RATE_HZ)
    return tuple((frames / MARKER_RATE_HZ).tolist())


def _write_study(folder: Path, truth: Truth, windows) -> Path:
    feet = {side: PLATES[side] for side in ("left", "right")}
    study = {
        "subject": {
            "name": "virtual_subject",
            "mass_kg": round(truth.human.mass_kg, 3),
            "height_m": round(truth.human.height_m, 4),
            "sex": "male",
        },
        "model": "coupled",
        "gravity_m_s2": truth.gravity,
        "filter": {"cutoff_hz": 6.0, "order": 4},
        "standing": {
            "markers": "standing.trc",
            "forces": "standing_forces.mot",
            "plates": feet,
            "start_s": 0.5,
        },
        "scaling": {"lengths": "markers", "trunk_com": "table"},
        "markers": study_markers(),
        "trials": [
            {
                "name": name,
                "markers": f"{name}.trc",
                "forces": f"{name}_forces.mot",
                "encoders": f"{name}_encoders.mot",
                "plates": feet,
                "start_s": start,
                "end_s": end,
            }
            for name, (start, end) in windows.items()
        ],
        "foot_ground": _foot_ground(),
    }
    path = folder / "study.yaml"
    text = yaml.dump(study, sort_keys=False, default_flow_style=None, width=78)
    path.write_text(
        "# A virtual subject in the exoskeleton stands up.\n" + text,
        encoding="utf-8",
    )
    return path


def _foot_ground() -> dict:
    """Settings of the first phase; nominal values are not the truth."""

    def sphere():
        return {
            "modulus_n_m2": {"nominal": 5e6, "lower": 1e6, "upper": 2e7},
            "dissipation_s_m": {"nominal": 2.0, "lower": 0.0, "upper": 5.0},
            "x_m": {"below": 0.03, "above": 0.03},
            "z_m": {"below": 0.015, "above": 0.015},
        }

    return {
        "law": "simbody",
        "heel": sphere(),
        "toe": sphere(),
        "noise": {
            "angle_deg": 0.3,
            "velocity_deg_s": 2.0,
            "foot_m": 0.001,
            "foot_pitch_deg": 0.3,
            "force_n": 3.0,
            "cop_m": 0.0005,
        },
        "solver": {"nodes_per_second": 100.0},
    }
