"""When a design has worn out its elements: the same problem on new ones.

A coarse element inverts once s varies within it, though the map does not;
the element floor then stops the search, not the physics. Elements near the
floor also flatter a design: its cost on new ones is higher.
"""

import numpy as np

from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.problem import ShapeProblem
from drake_exo.soles.remesh import remesh, remesh_with

_WORN = 0.02  # least volume ratio above the element floor


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


def carried(problem: ShapeProblem, before: TetMesh, p) -> ShapeProblem:
    """The problem on as many elements, made from others that carry a design.

    Args:
        problem: On elements that do not.
        before: Elements that do.
        p: The design.

    Raises:
        RemeshError: There are none.
    """
    usable = _simulates(problem, p)
    tets = len(problem.mesh.tets)
    mesh = remesh_with(before, problem.spline, p, tets, usable)
    return problem.with_mesh(mesh, p)


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
            "least_quality": float(problem.deformed(p).quality().min()),
            "c_tr": None if e is None else e.c_tr,
            "c_rot": None if e is None else e.c_rot,
        }
    return row
