"""Motions with their forces, as a replay draws them: computed or measured."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from drake_exo.forces.bushing import bushing_wrench
from drake_exo.laboratory.sagittal import cop_x
from drake_exo.optimal_control.interaction_kernels import BUSHINGS
from drake_exo.phases.measured import MeasuredMovement
from drake_exo.phases.model_file import ModelFile
from drake_exo.phases.problem import Trajectory
from drake_exo.phases.results import Calibration
from drake_exo.planar_tree import PlanarTree
from drake_exo.plant import build_plant

# The seat under the hip joint: half a thigh and the cushion [m].
_HIP_OVER_SEAT_M = 0.13


@dataclass(frozen=True)
class Motion:
    """A motion and the forces in it.

    Attributes:
        times: (n,) from 0 [s].
        q: (n, nq) coordinates.
        ground: (n, 3) F_x, F_z [N] and M_y about the origin [N m].
        cuffs: segment -> (n, 2) tangential and normal force on the human [N].
        chair: (n, 3) as ground; None where no chair was felt.
    """

    times: np.ndarray
    q: np.ndarray
    ground: np.ndarray
    cuffs: dict[str, np.ndarray] = field(default_factory=dict)
    chair: np.ndarray | None = None

    @staticmethod
    def computed(found: Trajectory, trial: MeasuredMovement) -> Motion:
        """Of a solution; the chair's force is given to it."""
        chair = trial.chair
        if chair is not None:
            chair = _rows(found.times, trial.times, chair)
        cuffs = {}
        if found.interaction is not None:
            parts = np.split(found.interaction, len(BUSHINGS), axis=1)
            cuffs = {
                name: part[:, :2]
                for name, part in zip(BUSHINGS, parts, strict=True)
            }
        return Motion(found.times, found.q, found.ground, cuffs, chair)

    @staticmethod
    def measured(trial: MeasuredMovement) -> Motion:
        """Of a recording, whose mats know the normal forces alone."""
        cuffs = {
            name: np.column_stack([0.0 * force, force])
            for name, force in trial.normal_force.items()
        }
        return Motion(trial.times, trial.q, trial.ground, cuffs, trial.chair)

    def sample(self, times: np.ndarray) -> Motion:
        """The same motion at other times, by straight lines."""

        def at(rows):
            return _rows(times, self.times, rows)

        return replace(
            self,
            times=times,
            q=at(self.q),
            ground=at(self.ground),
            cuffs={name: at(rows) for name, rows in self.cuffs.items()},
            chair=None if self.chair is None else at(self.chair),
        )


class Figure:
    """Where bodies and forces of one model are, over time.

    Args:
        model: subject and device.
        contact: where the cuffs act; None where they were not calibrated.
    """

    def __init__(self, model: ModelFile, contact: Calibration | None = None):
        plant = build_plant(model.kind, model.human, model.exoskeleton)
        self.tree = PlanarTree.from_plant(plant)
        self._shank_m = model.human.shank.length_m
        self._thigh_m = model.human.thigh.length_m
        self._origins = {}
        if contact is not None and contact.has_bushings:
            value = {p.name: p.nominal for p in contact.bushings()}
            self._origins = {
                segment: [value[f"{segment}.origin_{axis}"] for axis in "xz"]
                for segment in BUSHINGS
            }

    @property
    def bodies(self) -> list[str]:
        """Paths of the bodies under a scene's root."""
        return [_path(name) for name in self.tree.names if name != "world"]

    def poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Path of a body -> (n, 7) position and quaternion."""
        return {
            _path(name): spatial(self.pose(q, name))
            for name in self.tree.names
            if name != "world"
        }

    def pose(self, q: np.ndarray, body: str) -> np.ndarray:
        """Place x, z [m] and angle [rad] of a body, (n, 3)."""
        index = self.tree.body_index(body)
        angles = self.tree.segment_angles(q)[:, self.tree.segment_of[index]]
        place = self.tree.point_positions(q, body, np.zeros(2))
        turned = np.angle(self.tree.offsets[index])
        return np.column_stack([place, angles + turned])

    def hip(self, q: np.ndarray) -> np.ndarray:
        """Place (x, z) of the hip joint [m], (n, 2)."""
        return self.tree.point_positions(q, "thigh", (0.0, self._thigh_m))

    def seat_height(self, motion: Motion) -> float:
        """Of a seat that the subject would sit on at the start [m]."""
        return float(self.hip(motion.q[:1])[0, 1]) - _HIP_OVER_SEAT_M

    def centre_of_pressure(self, motion: Motion) -> np.ndarray:
        """On the ground (n, 3) [m]; NaN where the feet hardly load."""
        x = cop_x(motion.ground[:, 1], motion.ground[:, 2])
        return np.column_stack([x, 0.0 * x, 0.0 * x])

    def arrows(self, motion: Motion) -> dict[str, np.ndarray]:
        """Force -> (n, 6) point and force, world; NaN where there is none."""
        found = {"ground": _on_level(motion.ground, 0.0)}
        if motion.chair is not None:
            seat = self.seat_height(motion)
            found["chair"] = _on_level(motion.chair, seat)
        for name, force in motion.cuffs.items():
            if name in self._origins:
                found[name] = self._cuff(motion, name, force)
        return found

    def _cuff(self, motion, name: str, force: np.ndarray) -> np.ndarray:
        wrench = bushing_wrench(
            (*force.T, 0.0),
            self.pose(motion.q, name).T,
            self.pose(motion.q, f"exo_{name}").T,
            self._origins[name],
        )
        zero = 0.0 * wrench.force_x
        return np.column_stack(
            [
                *(wrench.point_x, zero, wrench.point_z),
                *(wrench.force_x, zero, wrench.force_z),
            ]
        )


def spatial(pose: np.ndarray) -> np.ndarray:
    """Planar poses x, z, angle (n, 3) as position and quaternion (n, 7)."""
    x, z, angle = pose.T
    zero = 0.0 * x
    # The angle is about -y.
    turn = np.cos(0.5 * angle), zero, -np.sin(0.5 * angle), zero
    return np.column_stack([x, zero, z, *turn])


def _on_level(wrench: np.ndarray, height: float) -> np.ndarray:
    """The force of a wrench where its line meets a level, (n, 6)."""
    F_x, F_z, M_y = wrench.T
    loaded = F_z > 1.0
    z = np.full(len(F_z), height)
    x = np.where(loaded, (z * F_x - M_y) / np.where(loaded, F_z, 1.0), np.nan)
    return np.column_stack([x, 0.0 * z, z, F_x, 0.0 * z, F_z])


def _path(body: str) -> str:
    """Of a body in meshcat's tree."""
    owner = "exoskeleton" if body.startswith("exo_") else "human"
    return f"{owner}/{body}"


def _rows(times, known, rows) -> np.ndarray:
    return np.column_stack([np.interp(times, known, c) for c in rows.T])
