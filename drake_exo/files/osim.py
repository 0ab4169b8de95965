"""Read scaled OpenSim models (.osim, version 4), and add elements to them.

Axes are OpenSim's: x forward, y up, z to the right. Every joint is read as up
to three rotations about body-fixed axes and three translations along axes of
the parent's frame, each a function of one coordinate (OpenSim's
SpatialTransform). Pins, welds, sliders and balls are special cases.

Elements can be added: `element` makes one as OpenSim 4 writes it, and
`OsimFile` puts it into its set. Frames on bodies are given as a `Pose`.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PPoly
from scipy.spatial.transform import Rotation

from drake_exo.errors import InputError
from drake_exo.files.output import replace_file
from drake_exo.files.tables import (
    MarkerData,
    Table,
    read_text,
    shown,
    uniform_time,
)

_X, _Y, _Z = (tuple(row) for row in np.eye(3))
# Joints without functions of their own: axes of rotations, translations.
_SIMPLE: dict[str, tuple[tuple, tuple]] = {
    "WeldJoint": ((), ()),
    "PinJoint": ((_Z,), ()),
    "SliderJoint": ((), (_X,)),
    "UniversalJoint": ((_X, _Y), ()),
    "GimbalJoint": ((_X, _Y, _Z), ()),
    "BallJoint": ((_X, _Y, _Z), ()),
    "PlanarJoint": ((_Z,), (_X, _Y)),
    "FreeJoint": ((_X, _Y, _Z), (_X, _Y, _Z)),
}
_LARGEST = 1e6  # of any number, in SI units
# f(x, order): derivative (N,) at values x (N,) of a coordinate; order 0: value.
Function = Callable[[np.ndarray, int], np.ndarray]


@dataclass(frozen=True)
class OsimBody:
    """A rigid body.

    Attributes:
        mass_kg: its mass.
        com_m: (3,) centre of mass in the body's frame.
        inertia_kg_m2: (3, 3) about the centre of mass, in the body's axes.
    """

    mass_kg: float
    com_m: np.ndarray
    inertia_kg_m2: np.ndarray


class Pose(NamedTuple):
    """Rotation R (3, 3) and position p (3,) [m] of a frame in another."""

    R: np.ndarray
    p: np.ndarray


@dataclass(frozen=True)
class OsimAxis:
    """One rotation about, or translation along, an axis of a joint.

    Attributes:
        direction: (3,) unit vector.
        coordinate: name of the coordinate that moves it; None if constant.
        function: angle [rad] or displacement [m] by that coordinate.
    """

    direction: np.ndarray
    coordinate: str | None
    function: Function


@dataclass(frozen=True)
class OsimJoint:
    """A joint, from its parent's frame F to its child's frame M.

    Attributes:
        name, kind: as in the file, such as "knee_r" and "CustomJoint".
        parent, child: names of the bodies; "ground" may be a parent.
        X_PF, X_CM: pose of F in the parent, and of M in the child.
        turns, translations: rotations, then translations, of M in F.
        coordinates: names, in the order of the file.
        ranges: (lower, upper) of each coordinate.
        locked: whether each coordinate is locked.
    """

    name: str
    kind: str
    parent: str
    child: str
    X_PF: Pose
    X_CM: Pose
    turns: tuple[OsimAxis, ...]
    translations: tuple[OsimAxis, ...]
    coordinates: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...]
    locked: tuple[bool, ...]

    def across(self, q: Mapping[str, np.ndarray], n: int, moving: str = ""):
        """Pose of M in F, and its partial velocities for one coordinate.

        Args:
            q: coordinate -> values (n,); missing ones are zero.
            n: number of states.
            moving: name of that coordinate; the velocities are zero without.

        Returns:
            R (n, 3, 3), p (n, 3) [m], angular (n, 3) [rad] and linear velocity
            (n, 3) [m], per unit coordinate.
        """

        def value(axis: OsimAxis, order: int = 0) -> np.ndarray:
            return axis.function(q.get(axis.coordinate, np.zeros(n)), order)

        R, p = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        turn, motion = np.zeros((2, n, 3))
        for axis in self.turns:
            if axis.coordinate == moving:
                turn = turn + value(axis, 1)[:, None] * (R @ axis.direction)
            R = R @ _rotation(axis.direction, value(axis))
        for axis in self.translations:
            if axis.coordinate == moving:
                motion = motion + value(axis, 1)[:, None] * axis.direction
            p = p + value(axis)[:, None] * axis.direction
        return R, p, turn, motion


@dataclass(frozen=True)
class OsimCoupler:
    """A constraint: coordinate `dependent` = function of `independent`."""

    dependent: str
    independent: str
    function: Function


@dataclass(frozen=True)
class OsimModel:
    """The skeleton and markers of a .osim file.

    Attributes:
        source: file name.
        gravity_m_s2: magnitude of gravity.
        bodies: name -> body.
        joints: all joints, parents before children.
        markers: name -> (body, (3,) position in its frame [m]).
        couplers: constraints between two coordinates.
        rest: coordinate -> where it stays, zero if absent: by default, if it is
            locked or slides between bodies; or what couples it to others.
    """

    source: str
    gravity_m_s2: float
    bodies: dict[str, OsimBody]
    joints: tuple[OsimJoint, ...]
    markers: dict[str, tuple[str, np.ndarray]]
    couplers: tuple[OsimCoupler, ...] = ()
    rest: dict[str, float] = field(default_factory=dict)

    @property
    def mass_kg(self) -> float:
        """Total mass of all bodies."""
        return sum(body.mass_kg for body in self.bodies.values())

    def joint_of(self, child: str) -> OsimJoint:
        """The joint whose child is a body.

        Raises:
            InputError: there is no such body.
        """
        for joint in self.joints:
            if joint.child == child:
                return joint
        raise InputError(
            f"{self.source}: has no body {child!r}; it has "
            f"{', '.join(self.bodies)}"
        )

    def at_rest(self, n: int) -> dict[str, np.ndarray]:
        """Values (n,) of the coordinates that do not rest at zero."""
        return {name: np.full(n, value) for name, value in self.rest.items()}

    def poses(self, q: Mapping[str, np.ndarray] | None = None, n: int = 1):
        """Body -> its R (n, 3, 3) and p (n, 3) [m] in the ground.

        Args:
            q: coordinate -> values (n,); missing ones rest. `couplers` are not
                applied to values that are given.
            n: number of states.
        """
        q = self.at_rest(n) | dict(q or {})
        found = {"ground": (np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)))}
        for joint in self.joints:
            R, p, *_ = joint.across(q, n)
            R_GP, p_GP = found[joint.parent]
            R_GF = R_GP @ joint.X_PF.R
            p_GF = p_GP + R_GP @ joint.X_PF.p
            R_GC = R_GF @ R @ joint.X_CM.R.T
            p_GM = p_GF + np.einsum("nij,nj->ni", R_GF, p)
            found[joint.child] = (R_GC, p_GM - R_GC @ joint.X_CM.p)
        return found

    def markers_along(self, table: Table) -> MarkerData:
        """Paths of the markers as coordinates of a file move them.

        Args:
            table: of inverse kinematics (`hip_flexion_r`) or states
                (`/jointset/hip_r/hip_flexion_r/value`).

        Raises:
            InputError: a coordinate is absent, angles are in no known unit,
                or times are uneven.
        """
        turning = {a.coordinate for j in self.joints for a in j.turns}
        named = {
            name.removesuffix("/value").rpartition("/")[2]: name
            for name in table.names
            if not name.endswith("/speed")
        }
        # Inverse kinematics may leave out what follows another coordinate.
        couplers = [c for c in self.couplers if c.independent in named]
        coupled = {coupler.dependent for coupler in couplers}
        for joint in self.joints:
            for name in joint.coordinates:
                if name not in named and name not in coupled:
                    raise InputError(
                        f"{table.source}: has no column for coordinate "
                        f"{name!r} of {self.source}; give markers, or what "
                        "inverse kinematics found with that model"
                    )
        table = table.in_radians([n for c, n in named.items() if c in turning])
        q = {name: table.column(of) for name, of in named.items()}
        for coupler in couplers:
            at = q[coupler.independent]
            q.setdefault(coupler.dependent, coupler.function(at, 0))
        time = uniform_time(table.source, table.time)
        poses = self.poses(q, len(time))
        paths = [
            p + R @ at
            for (R, p), at in (
                (poses[body], place) for body, place in self.markers.values()
            )
        ]
        return MarkerData(
            time,
            tuple(self.markers),
            np.stack(paths, axis=1),
            float(1.0 / (time[1] - time[0])),
            table.source,
        )

    def motion(self, coordinate: str, body: str, p_GQ, q, poses):
        """Partial velocities of a body and of a point on it.

        Args:
            coordinate: name of the coordinate that moves.
            body: body that the point is fixed to.
            p_GQ: (n, 3) the point in the ground [m].
            q: coordinate -> values (n,).
            poses: result of `poses(q, n)`.

        Returns:
            Angular velocity of the body (n, 3) and velocity of the point
            (n, 3), in the ground, per unit speed of the coordinate.
        """
        n = len(p_GQ)
        q = self.at_rest(n) | dict(q)
        (joint,) = (j for j in self.joints if coordinate in j.coordinates)
        moved = {joint.child}
        for other in self.joints:  # parents first
            if other.parent in moved:
                moved.add(other.child)
        if body not in moved:
            return np.zeros((2, n, 3))
        _, p_FM, turn, motion = joint.across(q, n, coordinate)
        R_GP, p_GP = poses[joint.parent]
        R_GF = R_GP @ joint.X_PF.R
        p_GM = p_GP + R_GP @ joint.X_PF.p + np.einsum("nij,nj->ni", R_GF, p_FM)
        turn, motion = (
            np.einsum("nij,nj->ni", R_GF, x) for x in (turn, motion)
        )
        return turn, motion + np.cross(turn, p_GQ - p_GM)


def read_osim(path: str | Path) -> OsimModel:
    """Read a model of OpenSim 4.

    Raises:
        InputError: another kind of file, an older version, or an unknown
            joint or function.
    """
    try:
        root = ET.fromstring(read_text(path))
    except ET.ParseError as error:
        raise InputError(f"{path}: is not XML ({error})") from error
    model = root.find("Model")
    if root.tag != "OpenSimDocument" or model is None:
        raise InputError(
            f"{path}: holds no OpenSim model; give a scaled .osim file"
        )
    if not (root.get("Version") or "0").isdecimal() or (
        int(root.get("Version") or 0) < 40000
    ):
        raise InputError(
            f"{path}: is of OpenSim {root.get('Version')}; open it in "
            "OpenSim 4 and save it"
        )
    units = (model.findtext("length_units") or "meters").strip()
    if units not in ("meters", "m"):
        raise InputError(f"{path}: lengths are in {units}; they must be meters")
    try:
        return _model(str(path), model)
    except (AttributeError, ValueError, TypeError, IndexError) as error:
        raise InputError(
            f"{path}: is not a complete model ({error}); open it in OpenSim 4 "
            "and save it"
        ) from error


_SETS = ("BodySet", "JointSet", "MarkerSet", "ConstraintSet")


def _model(path: str, model: ET.Element) -> OsimModel:
    for name in _SETS:
        if file := getattr(model.find(name), "attrib", {}).get("file"):
            raise InputError(
                f"{path}: its {name} is in another file, {file!r}; put its "
                "<objects> into the model"
            )
    bodies = {
        _name(body): _body(path, body)
        for body in model.iterfind("BodySet/objects/Body")
    }
    for body in model.iter("Body"):
        if body.get("name") not in bodies:  # its mass would be lost
            raise InputError(
                f"{path}: body {body.get('name')!r} is not in the BodySet; put "
                "it there, and its joint into the JointSet"
            )
    # (its owner, a frame) -> the body that it is on, its pose there
    frames: dict[tuple[str, str], tuple[str, Pose]] = {}
    for owner in (
        *model.iterfind("Ground"),
        *model.iterfind("BodySet/objects/Body"),
        *model.iterfind("JointSet/objects/*"),
    ):
        for frame in owner.iterfind("./*/PhysicalOffsetFrame"):
            named, X = _on_body(frame.findtext("socket_parent"), frames)
            named = _name(owner) if named == ".." else named
            frames[_name(owner), _name(frame)] = named, _within(X, _pose(frame))
    joints = [
        _joint(path, joint, bodies, frames)
        for joint in model.iterfind("JointSet/objects/*")
    ]
    if not bodies or not joints:
        raise InputError(f"{path}: has no bodies or no joints")
    if loose := bodies.keys() - {joint.child for joint in joints}:
        raise InputError(
            f"{path}: body {min(loose)!r} hangs from no joint; open it in "
            "OpenSim 4, which gives it one, and save it"
        )
    markers = {}
    for marker in model.iterfind("MarkerSet/objects/Marker"):
        body, X_BF = _on_body(marker.findtext("socket_parent_frame"), frames)
        if body in bodies:
            place = X_BF.p + X_BF.R @ _vector(marker.findtext("location"))
            markers[_name(marker)] = (body, place)
        elif body != "ground":
            raise InputError(
                f"{path}: marker {_name(marker)!r} is on {body!r}, which is no "
                "body of the model; put it on one"
            )
    gravity = _vector(model.findtext("gravity") or "0 -9.80665 0")
    if gravity[0] or gravity[2]:
        raise InputError(
            f"{path}: gravity is not along -y; give a model with y up, as "
            "OpenSim's are"
        )
    couplers = tuple(
        _coupler(path, constraint)
        for constraint in model.iterfind(
            "ConstraintSet/objects/CoordinateCouplerConstraint"
        )
        if not _says(constraint, "isEnforced", "false")
    )
    usual = {
        _name(one): float(_vector(one.findtext("default_value") or "0", 1)[0])
        for one in model.iterfind("JointSet/objects/*/coordinates/Coordinate")
    }
    rest = {}
    for joint in joints:
        turning = {axis.coordinate for axis in joint.turns}
        for name, locked in zip(joint.coordinates, joint.locked, strict=True):
            slides = joint.parent != "ground" and name not in turning
            if locked or slides:
                rest[name] = usual[name]
    for coupler in couplers:
        at = np.array([rest.get(coupler.independent, 0.0)])
        rest[coupler.dependent] = float(coupler.function(at, 0)[0])
    return OsimModel(
        path,
        -float(gravity[1]),
        bodies,
        _ordered(path, joints),
        markers,
        couplers,
        {name: value for name, value in rest.items() if value},
    )


def _pose(frame: ET.Element) -> Pose:
    """Pose of a PhysicalOffsetFrame on what it is attached to."""
    return Pose(
        _attitude(_vector(frame.findtext("orientation") or "0 0 0")),
        _vector(frame.findtext("translation") or "0 0 0"),
    )


def _within(X_AB: Pose, X_BC: Pose) -> Pose:
    return Pose(X_AB.R @ X_BC.R, X_AB.p + X_AB.R @ X_BC.p)


def _on_body(path: str | None, frames) -> tuple[str, Pose]:
    """What a path names: the last part, or the body that a frame is on."""
    *above, last = (path or "").strip().split("/")
    usual = last, Pose(np.eye(3), np.zeros(3))
    return frames.get((above[-1] if above else "", last), usual)


def _says(element: ET.Element, tag: str, value: str) -> bool:
    return (element.findtext(tag) or "").strip() == value


def _coupler(path: str, constraint: ET.Element) -> OsimCoupler:
    where = f"{path}: constraint {_name(constraint)!r}"
    names = (constraint.findtext("independent_coordinate_names") or "").split()
    if len(names) != 1:
        raise InputError(
            f"{where} depends on {len(names)} coordinates, but only one can "
            "be read; take it out, and lock the coordinate that it moves"
        )
    (node,) = constraint.find("coupled_coordinates_function")
    function = _function(where, node)
    (scale,) = _vector(constraint.findtext("scale_factor") or "1", 1)
    return OsimCoupler(
        _last(constraint.findtext("dependent_coordinate_name")),
        names[0],
        lambda x, order: scale * function(x, order),
    )


def _body(path: str, body: ET.Element) -> OsimBody:
    (mass,) = _vector(body.findtext("mass"), 1)
    # OpenSim leaves out what is zero by default.
    com = _vector(body.findtext("mass_center") or "0 0 0")
    xx, yy, zz, xy, xz, yz = _vector(
        body.findtext("inertia") or "0 0 0 0 0 0", 6
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if not mass >= 0.0:
        raise InputError(
            f"{path}: body {body.get('name')!r} has a mass of {mass:g} kg"
        )
    return OsimBody(float(mass), com, inertia)


def _joint(path: str, joint: ET.Element, bodies, frames) -> OsimJoint:
    name, kind = _name(joint), joint.tag
    where = f"{path}: joint {name!r}"
    if kind != "CustomJoint" and kind not in _SIMPLE:
        raise InputError(
            f"{where} is a {kind}, which is not known; replace it by a "
            "CustomJoint or a PinJoint"
        )
    ends = []
    for end in ("parent", "child"):
        to = joint.findtext(f"socket_{end}_frame")
        named, X = frames.get((name, _last(to))) or _on_body(to, frames)
        if named not in bodies and not (end == "parent" and named == "ground"):
            raise InputError(
                f"{where}: its {end} {named!r} is not a body of the model"
            )
        ends.append((named, X))
    (parent, X_PF), (child, X_CM) = ends
    found = list(joint.iterfind("coordinates/Coordinate"))
    names = tuple(_name(c) for c in found)
    if kind == "CustomJoint":
        axes = _custom(where, joint.find("SpatialTransform"), names)
    else:
        count = sum(map(len, _SIMPLE[kind]))
        if len(names) != count:
            raise InputError(
                f"{where}: a {kind} has {count} coordinates, but this one has "
                f"{len(names)}; open it in OpenSim 4 and save it"
            )
        free = iter(names)
        axes = [
            tuple(OsimAxis(np.array(a), next(free), _linear(1, 0)) for a in of)
            for of in _SIMPLE[kind]
        ]
    return OsimJoint(
        name,
        kind,
        parent,
        child,
        X_PF,
        X_CM,
        *axes,
        names,
        tuple(_range(c) for c in found),
        tuple(_says(c, "locked", "true") for c in found),
    )


def _range(coordinate: ET.Element) -> tuple[float, float]:
    lower, upper = _vector(
        coordinate.findtext("range") or f"{-radians(180)} {radians(180)}", 2
    )
    return float(lower), float(upper)


_AXES = tuple(f"{k}{i}" for k in ("rotation", "translation") for i in (1, 2, 3))


def _custom(where: str, transform: ET.Element, names):
    """Rotation and translation axes (three each) of a SpatialTransform."""
    told = list(transform.iterfind("TransformAxis"))
    axes = {axis.get("name"): axis for axis in told}
    if set(axes) != set(_AXES) or len(told) != len(_AXES):
        raise InputError(
            f"{where}: its SpatialTransform must hold each of "
            f"{', '.join(_AXES)} once; open it in OpenSim 4 and save it"
        )
    found = []
    for axis in map(axes.get, _AXES):
        of = (axis.findtext("coordinates") or "").split()
        if len(of) > 1 or not set(of) <= set(names):
            raise InputError(
                f"{where}: axis {axis.get('name')!r} depends on "
                f"{' and '.join(of)}; only one coordinate of the joint can be "
                "read"
            )
        kinds = [c for c in axis if c.tag not in ("coordinates", "axis")]
        direction = _vector(axis.findtext("axis"))
        if not np.linalg.norm(direction) > 1e-6:
            raise ValueError("an axis has no direction")
        item = OsimAxis(
            direction / np.linalg.norm(direction),
            of[0] if of else None,
            # Without a function it is the coordinate, or zero.
            _function(where, kinds[0]) if kinds else _linear(len(of), 0.0),
        )
        found.append(item)
    return tuple(found[:3]), tuple(found[3:])


def _function(where: str, node: ET.Element) -> Function:
    if node.tag == "function" and len(node):
        return _function(where, node[0])
    if node.tag == "MultiplierFunction":
        inner = _function(where, node.find("function"))
        (scale,) = _vector(node.findtext("scale") or "1", 1)
        return lambda x, order: scale * inner(x, order)
    if node.tag == "Constant":
        return _linear(0.0, *_vector(node.findtext("value") or "0", 1))
    if node.tag == "LinearFunction":
        return _linear(*_vector(node.findtext("coefficients") or "1 0", 2))
    if node.tag == "PolynomialFunction":
        c = _vector(node.findtext("coefficients"), None)
        return lambda x, order: np.polyval(np.polyder(c, order), x)
    if node.tag in _SPLINES:
        x, y = (_vector(node.findtext(axis), None) for axis in ("x", "y"))
        if len(y) != len(x) or len(x) < 2 or (np.diff(x) < 1e-9).any():
            raise ValueError(f"a {node.tag} needs as many y as growing x")
        return _SPLINES[node.tag](x, y)
    raise InputError(
        f"{where}: has a {node.tag}, which is not known; known are Constant, "
        "LinearFunction, PolynomialFunction, SimmSpline, "
        "PiecewiseLinearFunction and MultiplierFunction of them"
    )


def _linear(slope: float, value: float) -> Function:
    return lambda x, order: np.polyval(np.polyder([slope, value], order), x)


def _simm_spline(x: np.ndarray, y: np.ndarray) -> Function:
    """OpenSim's SimmSpline: cubic, and straight beyond its ends.

    The third derivatives at the ends are those of the cubics through the four
    outer points (G. E. Forsythe, M. A. Malcolm, C. B. Moler, Computer Methods
    for Mathematical Computations, 1977, chapter 4). Two points give a line; of
    three, the third derivative at the ends is zero.
    """
    n = len(x)
    h = np.diff(x)
    slope = np.diff(y) / h
    # Rows for s = y''/6, which is linear between the points.
    A, b = np.zeros((n, n)), np.zeros(n)
    for i in range(1, n - 1):
        A[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
        b[i] = slope[i] - slope[i - 1]
    A[0, :2], A[-1, -2:] = (-h[0], h[0]), (h[-1], -h[-1])
    if n > 3:
        for row, k, width, sign in ((0, 0, h[0], 1.0), (-1, n - 4, h[-1], -1)):
            third = _divided(x[k : k + 4], y[k : k + 4])
            b[row] = sign * width**2 * third
    s = np.zeros(n) if n == 2 else np.linalg.solve(A, b)
    first = slope - h * (s[1:] + 2.0 * s[:-1])
    last = slope[-1] + h[-1] * (2.0 * s[-1] + s[-2])
    rates = np.append(first, last)
    inner = CubicHermiteSpline(x, y, rates)
    # Add a straight piece at each end; PPoly extrapolates these.
    ends = np.array([x[0] - 1.0, x[-1] + 1.0])
    pieces = np.column_stack(
        [
            [0.0, 0.0, rates[0], y[0] + rates[0] * (ends[0] - x[0])],
            inner.c,
            [0.0, 0.0, rates[-1], y[-1]],
        ]
    )
    whole = PPoly(pieces, np.r_[ends[0], x, ends[1]])
    return lambda at, order: whole(at, order)


def _piecewise_linear(x: np.ndarray, y: np.ndarray) -> Function:
    """Straight between the points, and beyond them as beside the ends."""
    lines = PPoly(np.array([np.diff(y) / np.diff(x), y[:-1]]), x)
    return lambda at, order: lines(at, order)


_SPLINES = {
    "SimmSpline": _simm_spline,
    "PiecewiseLinearFunction": _piecewise_linear,
}


def _divided(x: np.ndarray, y: np.ndarray) -> float:
    """Third divided difference of four points."""
    for k in range(1, 4):
        y = np.diff(y) / (x[k:] - x[:-k])
    return float(y[0])


def _ordered(path: str, joints: list[OsimJoint]) -> tuple[OsimJoint, ...]:
    """Joints sorted so that parents come before children."""
    children = [joint.child for joint in joints]
    for child in children:
        if children.count(child) > 1:
            raise InputError(f"{path}: body {child!r} hangs from two joints")
    known, found, left = {"ground"}, [], list(joints)
    while left:
        ready = [joint for joint in left if joint.parent in known]
        if not ready:
            raise InputError(
                f"{path}: joint {left[0].name!r} hangs from nothing; its "
                f"parent {left[0].parent!r} is not tied to the ground"
            )
        found += ready
        known |= {joint.child for joint in ready}
        left = [joint for joint in left if joint not in ready]
    return tuple(found)


def _rotation(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) about a unit vector by angles (n,)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle), np.cos(angle)
    return np.eye(3) + s[:, None, None] * K + (1 - c)[:, None, None] * (K @ K)


def _attitude(angles: np.ndarray) -> np.ndarray:
    """Rotation matrix of body-fixed x, y, z Euler angles (3,) [rad]."""
    R = np.eye(3)
    for axis, angle in zip(np.eye(3), angles, strict=True):
        R = R @ _rotation(axis, np.array([angle]))[0]
    return R


def _vector(text: str | None, size: int | None = 3) -> np.ndarray:
    """Numbers in an element's text: `size` of them, or at least one."""
    values = np.array((text or "").split(), dtype=float)
    wrong = len(values) != size if size is not None else not len(values)
    if wrong or not (np.abs(values) < _LARGEST).all():
        raise ValueError(
            f"{shown(text or '')!r} is not {size or 'some'} numbers"
        )
    return values


def _name(element: ET.Element) -> str:
    name = element.get("name")
    if not name:
        raise ValueError(f"a {element.tag} has no name")
    return name


def _last(path: str | None) -> str:
    """Last part of a path such as /bodyset/pelvis."""
    return (path or "").strip().rsplit("/", 1)[-1]


_TINY = 1e-12  # smaller angles are rounding [rad]


class OsimFile:
    """A .osim file to which elements are added.

    Args:
        path: of a file that `read_osim` takes.
    """

    def __init__(self, path: str | Path):
        self.source = str(path)
        self.root = ET.fromstring(read_text(path))
        self.model = self.root.find("Model")
        self._names = {e.get("name") for e in self.model.iter()} - {None}

    def add(self, kind: str, element: ET.Element) -> None:
        """Add an element to a set such as "ForceSet".

        Raises:
            InputError: the model already has an element of this name.
        """
        name = element.get("name")
        if name in self._names:
            raise InputError(
                f"{self.source}: has a {name!r} already; give the model as it "
                "was before an export"
            )
        self._names.add(name)
        group = self.model.find(kind)
        if group is None:
            group = ET.SubElement(self.model, kind, name=kind.lower())
        objects = group.find("objects")
        if objects is None:
            objects = ET.SubElement(group, "objects")
        objects.append(element)

    def body(self, name: str) -> ET.Element:
        """The XML element of a body."""
        return self.model.find(f"BodySet/objects/Body[@name='{name}']")

    def write(self, path: Path) -> None:
        """Write the model with its added elements, whole or not at all."""
        ET.indent(self.root, "\t")
        text = ET.tostring(self.root, encoding="UTF-8", xml_declaration=True)
        replace_file(path, text)


def text_of(values) -> str:
    """A number, or several separated by blanks, as text with all digits."""
    return " ".join(repr(float(value) + 0.0) for value in np.ravel(values))


def element(kind: str, name: str, **values) -> ET.Element:
    """Make an element of a class `kind` of OpenSim.

    Args:
        kind: such as "ContactSphere".
        name: of the element.
        values: OpenSim's name of a property -> text, number or numbers.
    """
    made = ET.Element(kind, name=name)
    for key, value in values.items():
        text = value if isinstance(value, str) else text_of(value)
        ET.SubElement(made, key).text = text
    return made


def body(name: str, mass_kg: float, com_m, inertia_kg_m2) -> ET.Element:
    """Make a Body; CoM (3,) and inertia (3, 3) about it in its frame."""
    return element(
        "Body",
        name,
        mass=mass_kg,
        mass_center=com_m,
        inertia=six(inertia_kg_m2),
    )


def six(inertia) -> tuple[float, ...]:
    """Six numbers of an inertia (3, 3), in the order of OpenSim's files."""
    (xx, xy, xz), (_, yy, yz), (*_, zz) = inertia
    return xx, yy, zz, xy, xz, yz


def put(owner: ET.Element, tag: str, values) -> None:
    """Set a property of an element, which may lack it so far."""
    found = owner.find(tag)
    if found is None:
        found = ET.SubElement(owner, tag)
    found.text = text_of(values)


def add_frames(owner: ET.Element, ends: dict[str, tuple[str, Pose]]) -> None:
    """Add offset frames to a joint or force: name -> (body, pose on it)."""
    frames = ET.SubElement(owner, "frames")
    for name, (on, pose) in ends.items():
        angles = Rotation.from_matrix(pose.R).as_euler("XYZ")
        frame = element(
            "PhysicalOffsetFrame",
            name,
            socket_parent=f"/bodyset/{on}",
            translation=pose.p,
            orientation=np.where(np.abs(angles) < _TINY, 0.0, angles),
        )
        frames.append(frame)


def joint(
    name: str,
    coordinate: str | None,
    parent: tuple[str, Pose],
    child: tuple[str, Pose],
) -> ET.Element:
    """Make a pin joint about the frames' z; a weld if without coordinate."""
    ends = {f"{name}_parent": parent, f"{name}_child": child}
    above, below = ends
    made = element(
        "PinJoint" if coordinate else "WeldJoint",
        name,
        socket_parent_frame=above,
        socket_child_frame=below,
    )
    if coordinate:
        coordinates = ET.SubElement(made, "coordinates")
        ET.SubElement(coordinates, "Coordinate", name=coordinate)
    add_frames(made, ends)
    return made
