"""New elements inside a sole whose elements a design has worn out.

A coarse element inverts once s varies within it, though the map does not;
the element floor then stops the search, not the physics. As the paper does,
the deformed sole is meshed anew by Mmg (Dapogny, Dobrzynski, Frey, J. Comput.
Phys. 262, 2014), its surface kept. X' = s(p, θ, φ) X is radial and s depends
on the direction alone, so that the new mesh is pulled back, X = X'/s, and the
search goes on with the same coefficients. Where that fails it stops.
"""

import numpy as np
from scipy.spatial import cKDTree

from drake_exo.errors import InputError
from drake_exo.soles.mesh import TetMesh, checked_mesh
from drake_exo.soles.mmg import MmgError, run_mmg
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.shape import SphericalSpline, pull_back

_MOST_SECONDS = 20  # of processor time; five thousand tets take one
_WORN = 0.02  # least volume ratio above the element floor


class RemeshError(InputError):
    """The sole could not be meshed anew."""


def is_worn(problem: ShapeProblem, p: np.ndarray) -> bool:
    """Whether a design's elements are at their floor."""
    return problem.margin(p) < _WORN


def with_new_elements(problem: ShapeProblem, p: np.ndarray) -> ShapeProblem:
    """The problem on new elements, on which the design can be simulated.

    Raises:
        RemeshError: There are none.
    """
    new = problem.with_mesh(remesh(problem.mesh, problem.spline, p), p)
    if new.evaluate(p) is None:
        raise RemeshError("the step cannot be simulated on new elements")
    return new


def remesh(mesh: TetMesh, spline: SphericalSpline, p: np.ndarray) -> TetMesh:
    """Mesh the inside of a design's sole anew and pull the mesh back.

    Args:
        mesh: Undeformed sole whose elements are positive at p.
        spline, p: The design.

    Returns:
        The undeformed sole in other elements. Deformed by p they are better;
        undeformed, some may be flat or inverted.

    Raises:
        RemeshError: The elements are inverted already, Mmg fails or is not
            installed, or what it gives is no better.
    """
    deformed = mesh.with_nodes(spline.deform(mesh.nodes, p))
    before = float(deformed.quality().min())
    if before <= 0:
        raise RemeshError("the sole's elements are inverted already")
    body = {
        "nodes": deformed.nodes,
        "tets": deformed.tets,
        "triangles": deformed.boundary_faces,
    }
    try:
        nodes, tets = run_mmg(body, _MOST_SECONDS)
    except MmgError as error:
        raise RemeshError(str(error)) from None
    X = pull_back(nodes, spline, p)
    old = np.unique(mesh.boundary_faces)
    new = np.unique(TetMesh(nodes, tets, old).boundary_faces)
    away, which = cKDTree(deformed.nodes[old]).query(nodes[new])
    same = len(old) == len(new) == len(np.unique(which))
    if not same or away.max() > 1e-9 * np.ptp(nodes, axis=0).max():
        raise RemeshError("Mmg has moved nodes of the surface")
    X[new] = mesh.nodes[old[which]]
    fixed = np.sort(new[np.isin(old[which], mesh.fixed)])
    shaped = checked_mesh(nodes, tets, fixed, "Mmg")
    if shaped.quality().min() <= before:
        raise RemeshError("no element is better for it")
    return TetMesh(X, tets, fixed)


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
