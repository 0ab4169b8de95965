"""Which bodies a model has, how they are joined and what touches the ground.

A person has one leg (for both) or two, with rigid or hinged toes; a device
comes from a file, is welded to some segments of the person and held by cuffs
on others; spheres touch the ground. The subject's masses and lengths are in
`segments`. This module does not import pydrake.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeVar

from drake_exo.errors import InputError, check_bounds
from drake_exo.files.schema import quantity
from drake_exo.model.segments import CUFFED, IN_BODY, place

Legs = Literal["one", "two"]
Toes = Literal["rigid", "hinged"]
Point = tuple[float, float]
SIDES = ("left", "right")
Given = TypeVar("Given")


@dataclass(frozen=True)
class Person:
    """Segments of the person.

    Attributes:
        legs: "one" leg stands for both, which move alike; "two" legs move on
            their own.
        toes: "hinged" at the ball of the foot, or "rigid" with the foot.
        osim: scaled OpenSim model (.osim, version 4) that masses, lengths
            and inertias come from; if left out, de Leva's tables are used.
        trunk: pelvis, trunk, head and arms are one rigid body; there is no
            other choice yet.

    >>> Person("two").segments[:4]
    ('pelvis', 'thigh_left', 'shank_left', 'foot_left')
    """

    legs: Legs = "one"
    toes: Toes = "rigid"
    osim: Path | None = None
    trunk: Literal["rigid"] = "rigid"

    @property
    def sides(self) -> tuple[str, ...]:
        """Sides of the legs; empty if one leg stands for both."""
        return SIDES if self.legs == "two" else ()

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Ending of each leg's names, "" if one leg stands for both."""
        return tuple(f"_{side}" for side in self.sides) or ("",)

    @property
    def parts(self) -> tuple[str, ...]:
        """Segments of a leg, from the thigh down."""
        toes = ("toes",) if self.toes == "hinged" else ()
        return ("thigh", "shank", "foot", *toes)

    @property
    def root(self) -> str:
        """Segment whose x, z and pitch are the first coordinates."""
        return "pelvis" if self.legs == "two" else "foot"

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of all segments."""
        legs = (p + end for end in self.suffixes for p in self.parts)
        return ("pelvis", *legs)

    @property
    def soles(self) -> dict[str, tuple[str, ...]]:
        """Segment -> names of its contact spheres by default."""
        parts = {"foot": ("heel", "toe")}
        if self.toes == "hinged":
            parts = {"foot": ("heel", "ball"), "toes": ("toe",)}
        return {p + end: parts[p] for end in self.suffixes for p in parts}

    def feet(self, bodies) -> dict[str, tuple[str, ...]]:
        """Side ("both" for one leg) -> those of the bodies on that side."""
        if not self.sides:
            return {"both": tuple(bodies)}
        return {
            side: tuple(b for b in bodies if b.endswith(f"_{side}"))
            for side in self.sides
        }


@dataclass(frozen=True)
class Weld:
    """Where a link of the device sits on a segment of the person.

    Attributes:
        to: the segment.
        at_m: place (x, z) of the link's frame in the segment's.
        pitch_deg: pitch of the link's frame there, positive toes up.
    """

    to: str
    at_m: tuple[float, float] = place((0.0, 0.0))
    pitch_deg: float = quantity("deg", 0.0)


_ONCE_ROUND = {"unit": "deg", "minimum": -360.0, "maximum": 360.0}


@dataclass(frozen=True)
class DeviceFile:
    """A device, and where it is fixed to the person.

    Attributes:
        weld: link -> segment of the person that it is fixed to, or its place
            there; at least one. With all joints at zero, or at `upright_deg`,
            the device is as an upright person wears it. Joints between two
            welded links are left out.
        file: SDF or URDF (what xacro expands to), joints included; if left
            out, the shipped exoskeleton, fitted to the person.
        forward: which way the file's x axes point, forward or ("-x") backward.
        fixed: joints that are held at zero, such as a hip's abduction.
        upright_deg: joint -> its angle in the file where an upright person
            wears it, if not zero; encoders and results count from there.
        text: not for users: the file's text with `forward`, `fixed` and
            `upright_deg` applied, filled in when a study is read.
        notes: not for users: what else was changed in it, in sentences,
            filled in likewise.
    """

    weld: dict[str, str | Weld]
    file: Path | None = None
    forward: Literal["x", "-x"] = "x"
    fixed: tuple[str, ...] = ()
    upright_deg: dict[str, float] = field(
        default_factory=dict, metadata=_ONCE_ROUND
    )
    text: str | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        if not self.weld:
            raise InputError(
                "the device is attached to nothing; weld one of its links to "
                "a segment of the person"
            )
        if self.file is None and (
            self.fixed or self.forward != "x" or self.upright_deg
        ):
            raise InputError(
                "fixed, forward and upright_deg belong to a device's file, but "
                "the shipped exoskeleton has joints and axes of its own; name "
                "a file, or leave them out"
            )
        for name, value in self.upright_deg.items():
            check_bounds(f"upright_deg.{name}", value, _ONCE_ROUND)
        if both := set(self.fixed) & set(self.upright_deg):
            raise InputError(
                f"joint {min(both)!r} is fixed, at zero; leave it out of fixed "
                "or of upright_deg"
            )

    @property
    def name(self) -> str:
        """The device's name in messages."""
        return (
            "the shipped exoskeleton" if self.file is None else self.file.name
        )

    @property
    def kind(self) -> str:
        """Format of the text, as Drake's parser calls it: "sdf" or "urdf"."""
        return "sdf" if self.file is None else self.file.suffix[1:].lower()

    @property
    def welds(self) -> dict[str, Weld]:
        """Link -> its place on the person."""
        return {
            link: Weld(where) if isinstance(where, str) else where
            for link, where in self.weld.items()
        }


@dataclass(frozen=True)
class CuffLinks:
    """What a cuff joins.

    Attributes:
        human: segment of the person.
        device: link of the device.
        at_m: place (x, z) in the segment; if left out, that of the subject's
            cuff on this segment.
        open: whether the cuff is open, so that it bears nothing. It still
            tells which segment the link belongs to.
    """

    human: str
    device: str
    at_m: tuple[float, float] | None = place(None)
    open: bool = False


@dataclass(frozen=True)
class Assembly:
    """A person, a device, and how they are joined: a study's `model`.

    Attributes:
        human: the person.
        device: the device; leave it out for a person alone.
        cuffs: name -> what the cuff joins; any number.
        ground: segment -> its contact spheres: their names, or each name with
            a place (x, z), or `same` as on the other leg. If left out, the
            person's soles have their usual spheres. Spheres of the same name
            share their parameters. `heel_left` and `heel_right` are separate
            spheres, each at the place of a `heel`. A foot's `toe` without a
            place is on its toes if these are hinged.

    >>> Assembly(Person("two", "hinged")).spheres["toes_left"]
    {'toe': None}
    """

    human: Person = Person()
    device: DeviceFile | None = None
    cuffs: dict[str, CuffLinks] = field(default_factory=dict)
    ground: dict[str, tuple[str, ...] | dict[str, Point] | Literal["same"]] = (
        field(default_factory=dict, metadata=IN_BODY)
    )

    def __post_init__(self):
        ground = {body: self._named(body) for body in self.ground}
        object.__setattr__(self, "ground", ground)
        segments = self.human.segments
        if self.cuffs and self.device is None:
            raise InputError("cuffs need a device; name its file, or drop them")
        spheres = {s for named in self.spheres.values() for s in named}
        for name in (*self.cuffs, *spheres):  # parameters are NAME.KEY
            if "." in name or not name.strip():
                raise InputError(
                    f"{name!r} cannot be the name of a cuff or sphere; give "
                    "one without dots"
                )
            if name in self.cuffs and name in spheres:
                raise InputError(
                    f"a cuff and a sphere are called {name!r}; rename one"
                )
        for name, cuff in self.cuffs.items():
            self._check(f"cuff {name!r}", cuff.human)
        for body, spheres in self.ground.items():
            self._check("ground", body)
            if not spheres:
                raise InputError(f"ground: {body} has no sphere; name one")
            if len(set(spheres)) < len(spheres):
                raise InputError(
                    f"ground: {body} names a sphere more than once; name it "
                    "once, or another one"
                )
        for link, weld in (self.device.welds if self.device else {}).items():
            self._check(f"weld of {link!r}", weld.to)
        loose = [s for s in self.human.feet(self.spheres).items() if not s[1]]
        if loose:
            raise InputError(
                f"ground: the {loose[0][0]} foot never touches; give a "
                f"segment of it ({', '.join(segments)}) a sphere"
            )

    def _named(self, body: str):
        """Spheres of a segment in `ground`; "same" becomes the other leg's."""
        named = self.ground[body]
        if named != "same":
            return named
        other = {f"{without_side(body)}_{side}" for side in SIDES} - {body}
        found = [self.ground[b] for b in other if b in self.ground]
        if len(found) != 1 or found == ["same"]:
            raise InputError(
                f"ground: {body} is 'same', but that segment of the other leg "
                "names no spheres; name the spheres of either"
            )
        return found[0]

    def _check(self, what: str, segment: str) -> None:
        known = self.human.segments
        if segment not in known:
            raise InputError(
                f"{what}: the person has no segment {segment!r}; it has "
                f"{', '.join(known)}"
            )

    @property
    def spheres(self) -> dict[str, dict[str, Point | None]]:
        """Segment -> sphere -> place (x, z) [m], None for the usual one."""
        return {
            body: dict(own) if isinstance(own, dict) else dict.fromkeys(own)
            for body, own in (self.ground or self.human.soles).items()
        }

    @property
    def closed(self) -> tuple[str, ...]:
        """Names of the cuffs that are not open."""
        return tuple(n for n, cuff in self.cuffs.items() if not cuff.open)

    def opened(self, names: Iterable[str]) -> "Assembly":
        """The same with the cuffs named opened, so that they bear nothing."""
        found = {n: replace(self.cuffs[n], open=True) for n in names}
        return replace(self, cuffs=self.cuffs | found)

    @property
    def is_fitted(self) -> bool:
        """Whether the device is the shipped one, fitted to the person."""
        return self.device is not None and self.device.file is None


def without_side(part: str) -> str:
    """Name of a sphere or segment without its leg's side.

    >>> without_side("heel_left"), without_side("heel")
    ('heel', 'heel')
    """
    name, _, side = part.rpartition("_")
    return name if name and side in SIDES else part


def either_side(given: Mapping[str, Given], part: str, usual: Given) -> Given:
    """What is given for a part, or for its name without a side, or else usual.

    >>> either_side({"thigh": 1, "foot_left": 2}, "thigh_left", 0)
    1
    """
    return given.get(part, given.get(without_side(part), usual))


def named_so(parts: Iterable[str]) -> list[str]:
    """Names by which parts may be given: their own, and those without a side.

    >>> named_so(["heel_left", "heel_right"])
    ['heel_left', 'heel_right', 'heel']
    """
    parts = list(parts)
    return list(dict.fromkeys([*parts, *map(without_side, parts)]))


def other_side(part: str) -> str:
    """Name of the same part on the other leg; itself if it has no side.

    >>> other_side("thigh_left"), other_side("right_knee"), other_side("hip")
    ('thigh_right', 'left_knee', 'hip')
    """
    swapped = dict(zip(SIDES, SIDES[::-1], strict=True))
    return "_".join(swapped.get(word, word) for word in part.split("_"))


_SHIPPED = ("foot", *CUFFED)
# Shipped models: device on cuffs, device welded on, person alone.
COUPLED = Assembly(
    device=DeviceFile({"exo_foot": "foot"}),
    cuffs={name: CuffLinks(name, f"exo_{name}") for name in CUFFED},
)
RIGID = Assembly(device=DeviceFile({f"exo_{n}": n for n in _SHIPPED}))
ALONE = Assembly()
ASSEMBLIES = {"coupled": COUPLED, "rigid": RIGID, "human": ALONE}
