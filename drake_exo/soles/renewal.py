"""When a design has worn out its elements: the same problem on new ones.

A coarse element inverts once s varies within it, though the map does not;
the element floor then stops the search, not the physics. Elements near the
floor also flatter a design: its cost on new ones is higher.
"""

import numpy as np

from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.problem import ShapeProblem
from drake_exo.soles.remesh import RemeshError, remesh
from drake_exo.soles.shape import SphericalSpline

_WORN = 0.02  # least volume ratio above the element floor
_PARTS = (1.0, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3)
_MOST_STEPS = 4  # of the way from a brick to a design
_CARRIED = 0.05  # least quality to mesh anew from


def is_worn(problem: ShapeProblem, p: np.ndarray) -> bool:
    """Whether a design's elements are at their floor."""
    return problem.room(p) < _WORN


def renewed(problem: ShapeProblem, p: np.ndarray) -> ShapeProblem:
    """The problem on new elements, on which the design can be simulated.

    Raises:
        RemeshError: There are none.
    """
    mesh = remesh(problem.mesh, problem.spline, p, _simulates(problem, p))
    return problem.with_mesh(mesh, p)


def carried(problem: ShapeProblem, p: np.ndarray) -> ShapeProblem:
    """The problem on elements that carry a design of another mesh.

    Raises:
        RemeshError: There are none.
    """
    mesh = carrier(problem.mesh, problem.spline, p, _simulates(problem, p))
    return problem.with_mesh(mesh, p)


def carrier(
    mesh: TetMesh, spline: SphericalSpline, p: np.ndarray, usable=None
) -> TetMesh:
    """Elements of the undeformed sole that carry a design, made anew.

    From the undeformed sole towards the design as far as the elements go,
    which are then made anew; and so on. Arguments as for `remesh`.

    Raises:
        RemeshError: The design is not reached.
    """
    done = 0.0
    for _ in range(_MOST_STEPS):
        further = (
            t for t in _PARTS
            if t > done and _quality(mesh, spline, _part(p, t)) > _CARRIED
        )  # fmt: skip
        done = next(further, done)
        if done == 1.0:
            return remesh(mesh, spline, p, usable)
        mesh = remesh(mesh, spline, _part(p, done))
    raise RemeshError("the design is out of reach")


def _simulates(problem: ShapeProblem, p):
    return lambda mesh: problem.with_mesh(mesh, p).evaluate(p) is not None


def record(stage: int, iteration: int, before, after, p) -> dict:
    """What summary.json says of new elements.

    Args:
        stage, iteration: When; the first stage is 1.
        before, after: The problem on either mesh.
        p: The design.

    Returns:
        stage, iteration, tets, and before and after: least_quality, c_tr and
        c_rot by the stage's law and samples, null where not simulated.
    """
    row = {"stage": stage, "iteration": iteration, "tets": len(after.mesh.tets)}
    for name, problem in (("before", before), ("after", after)):
        e = problem.evaluate(p)
        row[name] = {
            "least_quality": _quality(problem.mesh, problem.spline, p),
            "c_tr": None if e is None else e.c_tr,
            "c_rot": None if e is None else e.c_rot,
        }
    return row


def _quality(mesh: TetMesh, spline, p) -> float:
    shaped = mesh.with_nodes(spline.deform(mesh.nodes, p))
    return float(shaped.quality().min())


def _part(p: np.ndarray, t: float) -> np.ndarray:
    return 1.0 + t * (p - 1.0)
