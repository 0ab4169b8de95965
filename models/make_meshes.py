"""Draws the surfaces of the human and the exoskeleton: meshes/*.obj.

Run `python models/make_meshes.py` after a change here. Every surface is a
sweep: superellipses strung along a path. Dimensions [m] are those of the
nominal adult of human.sdf, in the frame of the link they are drawn on; parts
of a leg are centred at y = 0 and placed by the SDF. They serve the eye only.
"""

from pathlib import Path

import numpy as np
from drake_exo.models.sweeps import beam, loaf, mirrored, obj_text, shell, tube

_FOLDER = Path(__file__).parent / "meshes"

# Lengths of the nominal adult [m].
SHANK, THIGH, ANKLE = 0.436, 0.424, 0.068
SOLE = -ANKLE - 0.022  # underside of the foot-plate


def human_parts() -> dict[str, np.ndarray]:
    """Skin and clothes, by name of the mesh."""
    return {
        "shoe": loaf(
            [
                (-0.052, 0.028, -0.062, 0.016),
                (-0.030, 0.037, -0.064, 0.034),
                (0.010, 0.037, -0.064, 0.036),
                (0.050, 0.037, -0.064, 0.006),
                (0.110, 0.045, -0.064, -0.016),
                (0.150, 0.047, -0.064, -0.024),
                (0.180, 0.040, -0.062, -0.032),
                (0.192, 0.031, -0.060, -0.040),
            ]
        ),
        "sole": loaf(
            [
                (-0.056, 0.030, -0.068, -0.044),
                (-0.030, 0.040, -0.068, -0.046),
                (0.040, 0.038, -0.068, -0.048),
                (0.120, 0.049, -0.068, -0.051),
                (0.160, 0.050, -0.067, -0.051),
                (0.192, 0.036, -0.062, -0.047),
            ],
            power=4.0,
            roundness=0.3,
        ),
        "sock": tube(
            [(-0.02, 0.0, 0.038, 0.034), (0.075, -0.004, 0.041, 0.038)],
            count=6,
        ),
        "shank": tube(
            [
                (0.00, 0.000, 0.036, 0.032),
                (0.08, -0.004, 0.038, 0.035),
                (0.18, -0.010, 0.048, 0.044),
                (0.29, -0.016, 0.059, 0.054),
                (0.36, -0.010, 0.055, 0.052),
                (SHANK, 0.000, 0.056, 0.053),
            ],
            roundness=0.75,
        ),
        "thigh": tube(
            [
                (0.00, 0.000, 0.056, 0.053),
                (0.06, 0.003, 0.058, 0.055),
                (0.15, 0.006, 0.067, 0.064),
                (0.28, 0.004, 0.078, 0.076),
                (THIGH - 0.02, 0.000, 0.082, 0.080),
            ],
            roundness=0.75,
        ),
        "shorts_leg": tube(
            [
                (0.15, 0.006, 0.077, 0.074),
                (0.17, 0.006, 0.079, 0.076),
                (0.30, 0.003, 0.086, 0.083),
                (THIGH - 0.03, 0.000, 0.093, 0.085),
                (THIGH, -0.004, 0.095, 0.082),
            ],
            roundness=0.55,
        ),
        **_trunk_parts(),
        **_head_parts(),
        **_arm_parts(),
    }


def _trunk_parts() -> dict[str, np.ndarray]:
    return {
        "shorts": tube(
            [
                (-0.055, -0.010, 0.080, 0.140),
                (-0.010, -0.014, 0.112, 0.170),
                (0.045, -0.014, 0.114, 0.171),
                (0.090, -0.010, 0.104, 0.160),
            ],
            power=2.3,
            around=32,
            roundness=0.12,
        ),
        "shirt": tube(
            [
                (0.062, -0.013, 0.119, 0.176),
                (0.120, -0.006, 0.106, 0.159),
                (0.190, 0.000, 0.099, 0.147),
                (0.280, -0.002, 0.108, 0.157),
                (0.370, -0.006, 0.117, 0.172),
                (0.440, -0.014, 0.110, 0.184),
                (0.490, -0.022, 0.088, 0.186),
                (0.517, -0.025, 0.074, 0.160),
                (0.538, -0.026, 0.066, 0.122),
                (0.558, -0.026, 0.058, 0.078),
            ],
            count=28,
            around=32,
            power=2.35,
            roundness=0.10,
        ),
        "neck": tube(
            [
                (0.535, -0.026, 0.066, 0.066),
                (0.575, -0.016, 0.055, 0.054),
                (0.640, -0.002, 0.054, 0.052),
            ],
            count=8,
        ),
    }


def _head_parts() -> dict[str, np.ndarray]:
    return {
        "head": tube(
            [
                (0.596, 0.052, 0.032, 0.030),
                (0.612, 0.040, 0.052, 0.046),
                (0.640, 0.026, 0.074, 0.060),
                (0.680, 0.015, 0.090, 0.070),
                (0.720, 0.010, 0.095, 0.074),
                (0.760, 0.004, 0.091, 0.073),
                (0.790, 0.000, 0.076, 0.062),
                (0.810, -0.004, 0.052, 0.044),
            ],
            count=30,
            around=36,
            power=2.15,
            roundness=0.28,
        ),
        "hair": tube(
            [
                (0.655, -0.052, 0.034, 0.050),
                (0.690, -0.040, 0.050, 0.073),
                (0.730, -0.024, 0.069, 0.080),
                (0.762, -0.006, 0.089, 0.080),
                (0.795, -0.006, 0.082, 0.069),
                (0.815, -0.008, 0.058, 0.050),
            ],
            count=28,
            around=40,
            roundness=0.22,
        ),
    }


def _arm_parts() -> dict[str, np.ndarray]:
    """Left arm, hanging a little away from the body, in the pelvis frame."""

    def limb(path, half, roundness):
        return beam(
            path, half, count=18, around=20, power=2.0, roundness=roundness
        )

    shoulder, elbow = [-0.020, 0.176, 0.462], [-0.030, 0.256, 0.226]
    wrist, knuckles = [0.030, 0.296, -0.030], [0.058, 0.300, -0.117]
    shoulder, elbow, wrist, knuckles = map(
        np.array, (shoulder, elbow, wrist, knuckles)
    )
    cuff = shoulder + 0.62 * (elbow - shoulder)
    parts = {
        "sleeve": limb(
            [shoulder, 0.5 * (shoulder + cuff), cuff],
            [(0.056, 0.064), (0.052, 0.057), (0.047, 0.050)],
            1.0,
        ),
        "upper_arm": limb(
            [shoulder, 0.5 * (shoulder + elbow), elbow],
            [(0.045, 0.05), (0.042, 0.044), (0.037, 0.038)],
            0.9,
        ),
        "forearm": limb(
            [elbow, 0.68 * elbow + 0.32 * wrist, wrist],
            [(0.037, 0.038), (0.038, 0.041), (0.024, 0.028)],
            0.9,
        ),
        "hand": limb(
            [
                wrist,
                0.4 * wrist + 0.6 * knuckles,
                knuckles,
                knuckles + np.array([0.004, -0.012, -0.055]),
            ],
            [(0.021, 0.027), (0.020, 0.041), (0.018, 0.042), (0.013, 0.028)],
            0.6,
        ),
        "thumb": limb(
            [
                0.7 * wrist + 0.3 * knuckles + [0.012, 0.0, 0.0],
                0.2 * wrist + 0.8 * knuckles + [0.045, -0.012, 0.0],
                knuckles + np.array([0.040, -0.016, -0.022]),
            ],
            [(0.013, 0.014), (0.011, 0.012), (0.009, 0.010)],
            0.8,
        ),
    }
    left = {f"left_{name}": rings for name, rings in parts.items()}
    right = {f"right_{name}": mirrored(r) for name, r in parts.items()}
    return left | right


def exoskeleton_parts() -> dict[str, np.ndarray]:
    """Device, by name of the mesh; of the struts, the left one and its mirror.

    A leg's parts are centred on the leg: y = 0 is the limb's axis.
    """
    parts = {
        "foot_plate": loaf(
            [
                (-0.068, 0.040, SOLE, SOLE + 0.022),
                (-0.040, 0.050, SOLE, SOLE + 0.022),
                (0.120, 0.055, SOLE, SOLE + 0.022),
                (0.180, 0.052, SOLE + 0.002, SOLE + 0.022),
                (0.215, 0.036, SOLE + 0.006, SOLE + 0.022),
            ],
            power=6.0,
            roundness=0.12,
        ),
        "shin_guard": shell(
            [
                (0.205, -0.006, 0.055, 0.053),
                (0.260, -0.008, 0.060, 0.060),
                (0.320, -0.008, 0.060, 0.062),
            ],
            (-105, 105),
            thickness=0.007,
        ),
        "foot_strap": beam(
            [
                (0.066, -0.044, SOLE + 0.02),
                (0.066, -0.043, -0.028),
                (0.064, -0.026, 0.001),
                (0.063, 0.000, 0.008),
                (0.064, 0.026, 0.001),
                (0.066, 0.043, -0.028),
                (0.066, 0.044, SOLE + 0.02),
            ],
            (0.003, 0.018),
            count=40,
        ),
        "calf_strap": shell(
            [(0.243, -0.012, 0.060, 0.059), (0.283, -0.014, 0.063, 0.061)],
            (90, 270),
            thickness=0.003,
        ),
        "thigh_shell": shell(
            [
                (0.160, 0.004, 0.081, 0.082),
                (0.235, 0.002, 0.087, 0.087),
                (0.305, 0.000, 0.091, 0.090),
            ],
            (75, 285),
            thickness=0.008,
        ),
        "thigh_strap": shell(
            [(0.205, 0.004, 0.086, 0.086), (0.262, 0.003, 0.088, 0.088)],
            (-100, 100),
            thickness=0.003,
        ),
        "belt": shell(
            [
                (0.070, -0.010, 0.122, 0.180),
                (0.105, -0.006, 0.115, 0.172),
                (0.140, -0.003, 0.110, 0.166),
            ],
            (-180, 180),
            thickness=0.007,
        ),
    }
    parts["back_unit"] = tube(
        [
            (0.030, -0.205, 0.050, 0.115),
            (0.100, -0.208, 0.056, 0.125),
            (0.220, -0.208, 0.056, 0.125),
            (0.275, -0.200, 0.046, 0.112),
        ],
        power=5.0,
        around=32,
        roundness=0.12,
    )
    struts = _struts()
    left = {f"left_{name}": rings for name, rings in struts.items()}
    right = {f"right_{name}": mirrored(r) for name, r in struts.items()}
    return parts | left | right


def _struts() -> dict[str, np.ndarray]:
    """Left side; a leg's about the limb's axis, the pelvis' in its frame."""
    ankle, knee, hip = 0.062, 0.082, 0.112  # outside the limb's axis [m]
    return {
        "ankle_bracket": beam(
            [
                (0.0, ankle, 0.0),
                (0.0, ankle, -0.045),
                (0.0, ankle - 0.004, SOLE + 0.012),
            ],
            [(0.006, 0.022), (0.006, 0.026), (0.006, 0.046)],
        ),
        "shank_strut": beam(
            [
                (0.0, ankle, 0.0),
                (0.0, ankle + 0.002, 0.10),
                (0.0, knee - 0.006, 0.26),
                (0.0, knee, SHANK),
            ],
            [(0.008, 0.022), (0.008, 0.017), (0.009, 0.021), (0.009, 0.03)],
        ),
        "thigh_strut": beam(
            [
                (0.0, knee, 0.0),
                (0.0, knee + 0.012, 0.15),
                (0.0, hip - 0.006, 0.30),
                (0.0, hip, THIGH),
            ],
            [(0.009, 0.03), (0.009, 0.022), (0.010, 0.024), (0.010, 0.034)],
        ),
        # From the back unit around the side, then down to the hip motor.
        "hip_arm": beam(
            [
                (-0.165, 0.060, 0.105),
                (-0.155, 0.145, 0.105),
                (-0.115, 0.198, 0.103),
                (-0.060, 0.214, 0.085),
                (-0.022, 0.217, 0.045),
                (0.000, 0.217, -0.004),
            ],
            [(0.010, 0.026)] * 3 + [(0.010, 0.028), *[(0.010, 0.030)] * 2],
            count=36,
            aside=(0.0, 0.0, 1.0),
        ),
    }


def main() -> None:
    """Write every part to meshes/NAME.obj."""
    _FOLDER.mkdir(exist_ok=True)
    for name, rings in {**human_parts(), **exoskeleton_parts()}.items():
        (_FOLDER / f"{name}.obj").write_text(obj_text(rings))


if __name__ == "__main__":
    main()
