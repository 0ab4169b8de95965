"""Names of a planar model's coordinates, read from its plant.

Only this class knows which column of an array is the hip, or which hinges are
the device's; all other code takes its columns from here.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from drake_exo.errors import InputError, nearest

# What a planar joint to the ground adds: two lengths and an angle.
_ROOT = ("x", "z", "pitch")


@dataclass(frozen=True)
class Coordinates:
    """Names of a planar floating tree's coordinates, and their columns.

    Attributes:
        names: (nq,) in the order of the plant's positions: x, z and pitch of
            the root, then the hinges.
        device: the hinges that are the device's; the others are the human's.
        coupling: one row for each hinge of the device: its rotation per
            rotation of each of the human's hinges while the device follows
            the human. Empty: it turns with the hinge that its name ends in.

    >>> names = Coordinates(("x", "z", "pitch", "ankle"))
    >>> names.joints, names.index("pitch")
    (('ankle',), 2)
    """

    names: tuple[str, ...]
    device: tuple[str, ...] = ()
    coupling: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self):
        given = {
            "names": self.names,
            "device": self.device,
            "coupling": map(tuple, self.coupling),
        }
        for name, value in given.items():  # lists never equal a model's tuples
            object.__setattr__(self, name, tuple(value))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def root(self) -> tuple[str, ...]:
        """Names of the root's three coordinates."""
        return self.names[: len(_ROOT)]

    @property
    def joints(self) -> tuple[str, ...]:
        """All hinges."""
        return self.names[len(_ROOT) :]

    @property
    def human(self) -> tuple[str, ...]:
        """The human's hinges."""
        return tuple(n for n in self.joints if n not in self.device)

    @property
    def body(self) -> tuple[str, ...]:
        """Root and human's hinges: coordinates of the model without device."""
        return self.root + self.human

    def index(self, name: str) -> int:
        """Column of a coordinate in arrays (n, nq).

        Raises:
            InputError: there is none of that name.
        """
        if name not in self.names:
            raise InputError(
                f"there is no coordinate {name!r}; known are "
                f"{', '.join(self.names)}{nearest(name, self.names)}"
            )
        return self.names.index(name)

    def columns(self, names) -> np.ndarray:
        """Columns of several coordinates in arrays (n, nq)."""
        return np.array([self.index(name) for name in names], int)

    @cached_property
    def root_columns(self) -> np.ndarray:
        """Columns of `root` in arrays (n, nq)."""
        return self.columns(self.root)

    @cached_property
    def joint_columns(self) -> np.ndarray:
        """Columns of `joints` in arrays (n, nq)."""
        return self.columns(self.joints)

    @cached_property
    def body_columns(self) -> np.ndarray:
        """Columns of `body` in arrays (n, nq)."""
        return self.columns(self.body)

    @cached_property
    def device_columns(self) -> np.ndarray:
        """Columns of `device` in arrays (n, nq)."""
        return self.columns(self.device)

    @cached_property
    def is_device_joint(self) -> np.ndarray:
        """Which of `joints` are the device's, (n_joints,) bool."""
        return np.array([name in self.device for name in self.joints], bool)

    @property
    def num_joints(self) -> int:
        """Number of hinges."""
        return len(self.names) - len(_ROOT)

    @property
    def is_angle(self) -> np.ndarray:
        """Whether each is an angle, not a length; (nq,) bool."""
        return np.arange(len(self)) >= len(_ROOT) - 1

    def joint(self, name: str) -> int:
        """Column of a hinge in arrays of joint moments (n, n_joints).

        Raises:
            InputError: there is none of that name.
        """
        place = self.index(name) - len(_ROOT)
        if place < 0:
            raise InputError(
                f"{name!r} is not a joint; known are {', '.join(self.joints)}"
            )
        return place

    @cached_property
    def turned_by(self) -> np.ndarray:
        """`coupling` as matrix, (device's hinges, human's hinges).

        Raises:
            InputError: a hinge's name ends in none of the human's.
        """
        rows = np.zeros((len(self.device), len(self.human)))
        if self.coupling:
            return np.reshape(self.coupling, rows.shape)
        for row, name in zip(rows, self.device, strict=True):
            beside = [h for h in self.human if name.endswith(f"_{h}")]
            if not beside:
                raise InputError(
                    f"joint {name!r} of the device sits beside none of the "
                    "human's; let its name end in one of "
                    f"_{', _'.join(self.human)}"
                )
            row[self.human.index(beside[0])] = 1.0
        return rows

    def follows(self, name: str) -> str | None:
        """The human's hinge that the device's hinge `name` mostly turns with.

        None if it does not turn while the human moves, like a pad's pivot.

        Raises:
            InputError: as `turned_by`.
        """
        row = np.abs(self.turned_by[self.device.index(name)])
        return self.human[int(np.argmax(row))] if row.any() else None

    def joined(self, human: np.ndarray, device: np.ndarray) -> np.ndarray:
        """Columns of human and device joined, in the order of `names`.

        A plant numbers hinges along its branches, so those of the device may
        lie between those of the human.

        Args:
            human: (n, .) of `body`, or of `human`.
            device: (n, .) of `device`.
        """
        both = np.hstack([human, device])
        columns = np.concatenate([self.body_columns, self.device_columns])
        return both[:, np.argsort(columns[len(self) - both.shape[1] :])]

    def aligned(self, body: np.ndarray) -> np.ndarray:
        """All coordinates (n, nq) while the device follows the human.

        Args:
            body: (n, len(self.body)) coordinates of `body`.
        """
        human = body[:, len(_ROOT) :]
        return self.joined(body, human @ self.turned_by.T)


def read_coordinates(plant: MultibodyPlant) -> Coordinates:
    """Coordinates of a finalized plant whose root has a planar joint.

    Hinges of the root's model instance are the human's, all others the
    device's.

    Raises:
        ValueError: the first joint is not planar, or one that follows is no
            hinge.
    """
    joints = [plant.get_joint(i) for i in plant.GetJointIndices()]
    joints = [j for j in joints if j.num_positions()]
    joints.sort(key=lambda j: j.position_start())
    root, *hinges = joints
    if root.num_positions() != len(_ROOT):
        raise ValueError(f"joint {root.name()!r} of the root is not planar")
    for joint in hinges:
        if joint.num_positions() != 1:
            raise ValueError(f"joint {joint.name()!r} is not a hinge")
    human = root.child_body().model_instance()
    return Coordinates(
        tuple(
            [f"{root.name()}_{what}" for what in _ROOT]
            + [joint.name() for joint in hinges]
        ),
        tuple(
            joint.name()
            for joint in hinges
            if joint.child_body().model_instance() != human
        ),
    )
