"""The study file of a virtual campaign."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from drake_exo.virtual_laboratory.instruments import (
    LARGEST_LAG_S,
    PLATES,
    Laboratory,
)
from drake_exo.virtual_laboratory.markers import study_markers
from drake_exo.virtual_laboratory.pressure_mats import CONFIGURATIONS
from drake_exo.virtual_laboratory.truth import Truth

EMPTY = "plates_empty"
_JOINTS = ("ankle", "knee", "hip")


# Standard deviation of each signal as it reaches a phase: markers slide on
# skin, the foot's do not; mats resolve 2.5 kPa on some thirty loaded cells of
# 2 cm^2: 0.8 N a sample, less than half of it after the filter.
_NOISE = {
    "angle_deg": 0.5,
    "velocity_deg_s": 4.0,
    "foot_m": 0.001,
    "foot_pitch_deg": 0.3,
    "force_n": 3.0,
    "cop_m": 0.0005,
}
_FORCE_NOISE = {"moment_nm": 5.0, "exo_moment_nm": 0.3, "energy_j": 1.0}


@dataclass(frozen=True)
class Entry:
    """A movement that the study uses.

    Attributes:
        name: of the recording.
        use: "calibration" or "prediction".
        configuration: of the mats.
        assisted: whether the device helped, and recorded its moments.
        start_s, end_s: used part.
    """

    name: str
    use: str
    configuration: str
    assisted: bool
    start_s: float
    end_s: float


def write_study(
    path: Path,
    truth: Truth,
    laboratory: Laboratory,
    mats: dict[str, dict],
    entries: list[Entry],
) -> None:
    """Write the study file.

    Args:
        path: the file.
        truth: mass, height and gravity are taken from it, and the device's
            friction, as far as a bench found it.
        laboratory: the equipment.
        mats: the section `mats`.
        entries: movements in use.
    """
    active = laboratory.disturbances
    study = {
        "subject": {
            "name": "virtual_subject",
            "mass_kg": round(truth.human.mass_kg, 3),
            "height_m": round(truth.human.height_m, 4),
            "sex": "male",
        },
        "model": "coupled",
        "gravity_m_s2": truth.model.gravity_m_s2,
        "filter": {"cutoff_hz": 6.0, "order": 4},
        "laboratory": laboratory_section(laboratory.files, active),
        "standing": {
            **laboratory.motion_files("standing"),
            "plates": dict(PLATES),
            **_empty_plates(laboratory),
            "start_s": 0.5,
        },
        "scaling": {"lengths": "markers", "trunk_com": "table"},
        "markers": study_markers(),
        "device": _device(truth, laboratory.faults.friction_share),
        "mats": mats,
        "trials": [_trial(laboratory, entry) for entry in entries],
        "foot_ground": foot_ground_section(),
        "interaction": _interaction(),
        "prediction": _prediction(),
    }
    text = yaml.dump(study, sort_keys=False, default_flow_style=None, width=78)
    path.write_text(
        "# A virtual subject in the exoskeleton stands up.\n" + text,
        encoding="utf-8",
    )


def laboratory_section(files: str, active: frozenset[str]) -> dict:
    """The section `laboratory`."""
    section: dict = {}
    if files == "c3d":
        axes = {"forward": "x", "up": "z"}
        section |= {"marker_axes": axes, "force_axes": dict(axes)}
    if "gaps" in active:
        section["fill_gaps_s"] = 0.2
    if "plate_drift" in active:
        section["remove_plate_drift"] = True
    if "clocks" in active:
        section |= {
            "estimate_encoder_delay": True,
            "estimate_pressure_delay": True,
            "largest_delay_s": 1.5 * LARGEST_LAG_S,
        }
    return section


def _empty_plates(laboratory: Laboratory) -> dict:
    if "plate_drift" not in laboratory.disturbances:
        return {}
    return {"empty_plates": laboratory.motion_files(EMPTY)["forces"]}


def _device(truth: Truth, found: tuple[float, ...]) -> dict:
    friction = truth.friction
    section: dict = {"encoder_legs": "both", "moment_legs": "both"}
    for i, joint in enumerate(_JOINTS):
        section[joint] = {
            "viscous_nm_s": found[i] * friction.viscous[i],
            "coulomb_nm": found[i] * friction.coulomb[i],
            "coulomb_speed_rad_s": friction.speed,
        }
    return section


def _trial(laboratory: Laboratory, entry: Entry) -> dict:
    mats = [mat.name for mat in CONFIGURATIONS[entry.configuration]]
    trial = {
        "name": entry.name,
        "use": entry.use,
        **laboratory.motion_files(entry.name),
        "plates": dict(PLATES),
        **_empty_plates(laboratory),
        "encoders": laboratory.device_file(entry.name, "encoders"),
        "pressure": [{"file": f"{entry.name}.asc", "mats": mats}],
        "start_s": entry.start_s,
        "end_s": entry.end_s,
    }
    if entry.assisted:
        moments = laboratory.device_file(entry.name, "moments")
        trial["exo_moments"] = moments
    return trial


def foot_ground_section(legs: int = 1) -> dict:
    """Settings of the first phase; nominal values are not the truth.

    Args:
        legs: that move on their own, each with soles of its own.
    """

    def sphere():
        modulus = {"nominal": 5e6, "lower": 1e6, "upper": 2e7}
        return {
            "modulus_n_m2": {k: v / legs for k, v in modulus.items()},
            "dissipation_s_m": {"nominal": 2.0, "lower": 0.0, "upper": 5.0},
            "x_m": {"below": 0.03, "above": 0.03},
            "z_m": {"below": 0.015, "above": 0.015},
        }

    return {
        "law": "simbody",
        "heel": sphere(),
        "toe": sphere(),
        "noise": dict(_NOISE),
        "solver": {"nodes_per_second": 100.0},
    }


def _interaction() -> dict:
    """Weights of the second phase."""
    own = {
        "exo_angle_deg": 0.1,
        "exo_velocity_deg_s": 1.0,
    }
    return {"noise": {**_NOISE, **own, **_FORCE_NOISE}}


def _prediction() -> dict:
    """Weights of the third phase, which tracks no kinematics but ends.

    Cuffs of some thousand N/m store a tenth of a joule under fifty newtons.
    """
    noise = {**_NOISE, **_FORCE_NOISE, "energy_j": 0.1}
    return {"noise": noise}
