"""What is known of one trial when its plausibility is judged."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_exo.files.verdict import Check
from drake_exo.measurement.inverse_dynamics import inverse_dynamics
from drake_exo.measurement.processing import Recording
from drake_exo.measurement.settings import TrialFiles
from drake_exo.measurement.subject import SubjectModel
from drake_exo.measurement.trial import Trial
from drake_exo.model.assembly import SIDES

JOINTS = ("ankle", "knee", "hip")
# A plate that bears less has no centre of pressure worth a judgement [N].
LOADED_N = 50.0
# The foot reaches so far behind its hindmost marker, and its markers so far
# inside of its edges [m].
_HEEL_M = 0.03


@dataclass(frozen=True)
class Evidence:
    """One trial, the files that it comes from and its whole recording.

    Attributes:
        files: names of the files.
        trial: the used part.
        recording: what it was cut from.
        subject: fitted to standing.
    """

    files: TrialFiles
    trial: Trial
    recording: Recording
    subject: SubjectModel

    def check(
        self,
        name: str,
        value: float,
        limit: float,
        unit: str,
        file: object,
        sentence: str,
        holds: bool | None = None,
    ) -> Check:
        """A check of this trial, by default that a value is within a limit.

        Args:
            name: without "plausibility.".
            value: found.
            limit: not to be exceeded.
            unit: of both.
            file: that the sentence speaks of.
            sentence: for a check that does not hold.
            holds: where more than the limit decides.
        """
        value = float(value)
        holds = bool(value <= limit) if holds is None else bool(holds)
        return Check(
            f"plausibility.{name}",
            holds,
            value,
            float(limit),
            unit,
            self.trial.name,
            "" if holds else f"{file}: {sentence}",
        )

    @property
    def weight(self) -> float:
        """Body weight with what is rigidly worn [N]."""
        return self.subject.model.rigid.tree.weight

    @cached_property
    def inside(self) -> np.ndarray:
        """The used part of the recording (N,) bool."""
        time, trial = self.recording.motion.time, self.trial
        end = trial.start_s + trial.duration
        return (time >= trial.start_s - 1e-9) & (time <= end + 1e-9)

    @property
    def body(self) -> list[np.ndarray]:
        """q, v, a (n, .) of the body without the device."""
        columns = self.trial.coordinates.body_columns
        return [
            x[:, columns] for x in (self.trial.q, self.trial.v, self.trial.a)
        ]

    def expected(self, body: np.ndarray) -> np.ndarray:
        """The device's angles or speeds (n, device's) if it moves as the body.

        Args:
            body: (n, .) positions or velocities of the body.
        """
        names = self.trial.coordinates
        return body[:, -len(names.human) :] @ names.turned_by.T

    @cached_property
    def needed(self) -> np.ndarray:
        """F_x, F_z [N] and moment [N m] (n, 3) that motion asks for.

        About the laboratory's origin, of feet and chair together.
        """
        tree = self.subject.model.rigid.tree
        Q = inverse_dynamics(tree, *self.body, {})
        return tree.ground_reaction(self.body[0], Q)

    @cached_property
    def needed_z(self) -> np.ndarray:
        """Vertical force (N,) that the whole recording's motion asks for."""
        motion, tree = self.recording.motion, self.subject.model.rigid.tree
        Q = inverse_dynamics(tree, motion.q, motion.v, motion.a, motion.applied)
        return tree.ground_reaction(motion.q, Q)[:, 1]

    @cached_property
    def measured(self) -> np.ndarray:
        """The same as the plates have it (n, 3)."""
        trial = self.trial
        loads = (
            trial.ground,
            *trial.chair_loads().values(),
            *trial.applied.values(),
        )
        return sum(w.array for w in loads)

    def pitch_error(self, turned: bool = False) -> float:
        """RMS moment about the ankle that Euler's law misses [N m].

        Args:
            turned: as if the plates' axes were turned by half a turn.
        """
        measured = self.measured * ([-1.0, 1.0, -1.0] if turned else 1.0)
        F_x, F_z, moment = (self.needed - measured).T
        x, z = self.body[0][:, :2].T
        return float(np.sqrt(np.mean((moment - (z * F_x - x * F_z)) ** 2)))

    @cached_property
    def plates(self) -> dict[str, np.ndarray]:
        """Foot -> force and moment (n, 6) about the origin, not levelled."""
        forces = self.recording.forces
        time = self.recording.motion.time[self.inside]
        return {
            foot: np.column_stack(
                [np.interp(time, forces.time, x) for x in w.T]
            )
            for foot, w in forces.recorded.items()
            if foot != "chair"
        }

    @property
    def has_two_plates(self) -> bool:
        """Whether each foot has one."""
        return all(side in self.plates for side in SIDES)

    def loaded(self, foot: str) -> np.ndarray:
        """Frames (n,) in which a plate bears something."""
        return self.plates[foot][:, 2] > LOADED_N

    def cop(self, foot: str, turned: bool = False, scale: float = 1.0):
        """Centre of pressure (k, 2), forward and left, where loaded [m].

        Args:
            foot: of the plate.
            turned: as if the plates' axes were turned by half a turn.
            scale: of lengths.
        """
        w = self.plates[foot][self.loaded(foot)]
        p = np.column_stack([-w[:, 4], w[:, 3]]) / w[:, 2:3]
        return scale * (-p if turned else p)

    def sole(self, foot: str, plate: str | None = None) -> np.ndarray | None:
        """Where a foot is: back, front, right, left (k, 4) [m].

        Args:
            foot: "left", "right" or "both".
            plate: whose loaded frames are wanted; that of the foot if None.

        Returns:
            None where the foot's markers are not known. Across, only what
            markers show counts; a lone leg says nothing of the other's.
        """
        feet = self.recording.motion.feet
        sides = SIDES if foot == "both" else (foot,)
        known = [feet[s] for s in sides if s in feet]
        if not known:
            return None
        p = np.concatenate(known, axis=1)[self.inside]
        p = p[self.loaded(plate or foot)]
        x, y = p[..., 0], p[..., 1]
        back = x.min(axis=1) - _HEEL_M
        length = self.subject.model.human.foot.length_m + _HEEL_M
        front = np.maximum(x.max(axis=1), x.min(axis=1) + length)
        right, left = y.min(axis=1), y.max(axis=1)
        if len(known) < len(sides):
            right, left = np.full((2, len(p)), np.nan)
        return np.column_stack([back, front, right, left])

    def outside(self, foot: str, **changed) -> tuple[float, float]:
        """How far the centre of pressure leaves the foot, along and across.

        In 95 % of the loaded frames it is nearer [m]; negative inside, NaN
        where nothing can be said.
        """
        sole = self.sole(foot)
        if sole is None or not len(sole):
            return np.nan, np.nan
        x, y = self.cop(foot, **changed).T
        along = np.maximum(sole[:, 0] - x, x - sole[:, 1])
        across = np.maximum(sole[:, 2] - y, y - sole[:, 3])
        return float(np.quantile(along, 0.95)), float(np.quantile(across, 0.95))

    def off_side(self, **changed) -> float:
        """How much nearer each plate's pressure is to its own foot [m].

        Negative where it is nearer to the other: mean over both.
        """
        nearer = []
        for side, other in (SIDES, SIDES[::-1]):
            y = self.cop(side, **changed)[:, 1]
            own, far = (
                np.abs(y - self.sole(s, side)[:, 2:].mean(axis=1))
                for s in (side, other)
            )
            nearer.append(np.median(far - own) if len(y) else np.nan)
        return float(np.nanmean(nearer)) if np.isfinite(nearer).any() else 0.0

    @property
    def has_both_feet(self) -> bool:
        """Whether both feet carry markers."""
        return all(side in self.recording.motion.feet for side in SIDES)
