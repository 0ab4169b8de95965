"""Forward kinematics of an .osim file, just enough to check against it.

Joints: pin, weld and custom ones with linear, constant, polynomial and
spline functions. Frames as OpenSim defines them: body-fixed x-y-z angles,
translations of a custom joint in the parent's offset frame.
"""

import xml.etree.ElementTree as ET

import numpy as np
from scipy.interpolate import CubicSpline


def _numbers(text):
    return np.array([float(x) for x in text.split()])


def _function(node):
    """A callable of the coordinate's value."""
    if node is None:
        return None
    if node.tag == "function" and len(node):
        return _function(node[0])
    if node.tag == "LinearFunction":
        a, b = _numbers(node.findtext("coefficients"))
        return lambda q: a * q + b
    if node.tag == "PolynomialFunction":
        c = _numbers(node.findtext("coefficients"))
        return lambda q: np.polyval(c, q)
    if node.tag == "Constant":
        value = float(node.findtext("value"))
        return lambda q: value + 0.0 * q
    if node.tag == "SimmSpline":
        spline = CubicSpline(
            _numbers(node.findtext("x")),
            _numbers(node.findtext("y")),
            bc_type="not-a-knot",
        )
        return spline
    if node.tag == "MultiplierFunction":
        inner, scale = (
            _function(node.find("function")),
            float(node.findtext("scale")),
        )
        return lambda q: scale * inner(q)
    raise NotImplementedError(node.tag)


def rotation(axis, angle):
    """Rotation matrices (N, 3, 3) about an axis by angles (N,)."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle), np.cos(angle)
    return np.eye(3) + s[:, None, None] * K + (1 - c)[:, None, None] * (K @ K)


def _offset(node):
    p = _numbers(node.findtext("translation"))
    a = _numbers(node.findtext("orientation"))
    R = np.eye(3)
    for axis, angle in zip(np.eye(3), a, strict=True):
        R = R @ rotation(axis, np.array([angle]))[0]
    return R, p, node.findtext("socket_parent").rsplit("/", 1)[-1]


class Osim:
    """Bodies' poses from coordinate values; also masses and the total CoM."""

    def __init__(self, path):
        model = ET.parse(path).getroot().find("Model")
        self.joints = [
            j
            for j in model.find("JointSet/objects")
            if not j.attrib["name"].startswith("patellofemoral")
        ]
        self.bodies = {}
        for body in model.find("BodySet/objects"):
            self.bodies[body.attrib["name"]] = (
                float(body.findtext("mass")),
                _numbers(body.findtext("mass_center")),
                _numbers(body.findtext("inertia"))[:3],
            )

    def poses(self, coordinates):
        """Body name -> (R (N, 3, 3), p (N, 3)) in ground."""
        n = len(next(iter(coordinates.values())))
        X = {"ground": (np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)))}
        for joint in self.joints:
            frames = {
                f.attrib["name"]: _offset(f)
                for f in joint.iter("PhysicalOffsetFrame")
            }
            Rp, pp, parent = frames[joint.findtext("socket_parent_frame")]
            Rc, pc, child = frames[joint.findtext("socket_child_frame")]
            R, p = self._joint(joint, coordinates, n)
            R_WP, p_WP = X[parent]
            R_WF = R_WP @ Rp
            p_WF = p_WP + R_WP @ pp + (R_WF @ p[:, :, None])[:, :, 0]
            R_WC = R_WF @ R @ Rc.T
            X[child] = (R_WC, p_WF - R_WC @ pc)
        return X

    def _joint(self, joint, coordinates, n):
        R, p = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        if joint.tag == "WeldJoint":
            return R, p
        if joint.tag == "PinJoint":
            name = next(joint.iter("Coordinate")).attrib["name"]
            return rotation(np.array([0.0, 0, 1]), coordinates[name]), p
        for axis in joint.find("SpatialTransform"):
            names = (axis.findtext("coordinates") or "").split()
            direction = _numbers(axis.findtext("axis"))
            kinds = [c for c in axis if c.tag not in ("coordinates", "axis")]
            function = _function(kinds[0])
            q = coordinates[names[0]] if names else np.zeros(n)
            value = function(q)
            if axis.attrib["name"].startswith("rotation"):
                R = R @ rotation(direction, value)
            else:
                p = p + value[:, None] * direction
        return R, p

    def center_of_mass(self, X):
        """Whole-body centre of mass (N, 3)."""
        total = moment = 0.0
        for name, (mass, com, _) in self.bodies.items():
            if name in X:
                R, p = X[name]
                moment = moment + mass * (p + R @ com)
                total += mass
        return moment / total

    def places(self):
        """Child body -> place of its joint in the parent (no rotation)."""
        found = {}
        for joint in self.joints:
            frames = {
                f.attrib["name"]: _offset(f)
                for f in joint.iter("PhysicalOffsetFrame")
            }
            child = frames[joint.findtext("socket_child_frame")][2]
            found[child] = frames[joint.findtext("socket_parent_frame")][1]
        return found


def joint_function(osim, joint, axis):
    """The function of one axis of a custom joint."""
    (node,) = (j for j in osim.joints if j.attrib["name"] == joint)
    for item in node.find("SpatialTransform"):
        if item.attrib["name"] == axis:
            return _function(
                next(c for c in item if c.tag not in ("coordinates", "axis"))
            )
    raise KeyError(axis)
