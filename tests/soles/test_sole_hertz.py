"""Hertz: contact radius and peak pressure of a paraboloid on a flat."""

import numpy as np
import pytest
from sole_at_pose import contact_at_pose

from drake_exo.soles.contact.gauss_seidel import GaussSeidelSolver
from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.elasticity import Material, Sole
from drake_exo.soles.mesh import checked_mesh, grid_mesh

E, NU, R, A = 1e6, 0.3, 1.0, 0.09  # a/R = 0.09
CELL = A / 10


def _graded(cells, far, growth=2.0):
    """Grid lines: `cells` of size CELL, then growing out to `far`."""
    lines = [k * CELL for k in range(cells + 1)]
    step = CELL
    while lines[-1] < far:
        step *= growth
        lines.append(lines[-1] + step)
    return np.array(lines)


def _paraboloid():
    half = _graded(12, 4 * A)
    lines = np.concatenate([-half[:0:-1], half])
    depth = _graded(6, 4 * A)
    height = depth[-1]
    mesh = grid_mesh(lines, lines, depth - height)  # fine layers below
    x = mesh.nodes.copy()
    r2 = (x[:, :2] ** 2).sum(axis=1)
    rise = np.minimum(r2, (2 * A) ** 2) / (2 * R)
    x[:, 2] += rise * (-x[:, 2] / height)
    top = np.flatnonzero(x[:, 2] > -1e-12)
    return checked_mesh(x, mesh.tets, top, "paraboloid")


def _normal_compliance(sole, near):
    """C of nearby nodes; without friction only normal forces matter."""
    rows = sole.contact_rows[3 * near + 2]
    columns = np.zeros((3 * len(sole.free), len(near)))
    columns[rows, np.arange(len(near))] = 1.0
    normal = sole.factor.solve(columns)[rows]
    C = np.zeros((3 * len(near), 3 * len(near)))
    C[2::3, 2::3] = 0.5 * (normal + normal.T)
    tangential = np.arange(3 * len(near)) % 3 < 2
    C[tangential, tangential] = np.median(np.diag(normal))
    return C


@pytest.mark.slow
def test_hertz_contact_radius_and_peak_pressure():
    force = 4 * E / (1 - NU**2) * A**3 / (3 * R)
    mesh = _paraboloid()
    sole = Sole(mesh, Material("m", E, NU, 1000.0))
    x = sole.positions
    bottom = x[:, 2] < mesh.nodes[:, 2].min() + (1.3 * A) ** 2 / (2 * R)
    near = np.flatnonzero(
        bottom & ((x[:, :2] ** 2).sum(axis=1) < (1.15 * A) ** 2)
    )
    C, lP = _normal_compliance(sole, near), x[near]
    law = ContactLaw(0.0, 1.0 / np.median(np.diag(C)[2::3]))
    solver = GaussSeidelSolver(C, lP, law, sweep_tolerance=1e-7)
    depths, powers, F = [0.0], [0.0], None
    approach = A**2 / R
    for _ in range(6):  # secant steps: F^(2/3) is linear in the approach
        O = np.array([0.0, 0.0, -lP[:, 2].min() - approach])  # noqa: E741
        state, report = contact_at_pose(solver, np.eye(3), O, lP, F)
        assert report.converged, report.message
        F = state.F
        depths.append(approach)
        powers.append(F[:, 2].sum() ** (2 / 3))
        if abs(powers[-1] / force ** (2 / 3) - 1) < 1e-5:
            break
        slope = (powers[-1] - powers[-2]) / (depths[-1] - depths[-2])
        approach += (force ** (2 / 3) - powers[-1]) / slope
    assert F[:, 2].sum() == pytest.approx(force, rel=1e-4)
    pressure = F[:, 2] / mesh.contact_areas[near]
    r2 = (lP[:, :2] ** 2).sum(axis=1)
    # p² = p0² (1 − r²/a²): a straight line in r².
    use = (r2 < (0.85 * A) ** 2) & (pressure > 0)
    slope, p0_squared = np.polyfit(r2[use], pressure[use] ** 2, 1)
    radius, peak = np.sqrt(-p0_squared / slope), np.sqrt(p0_squared)
    exact = 3 * force / (2 * np.pi * A**2)
    assert radius == pytest.approx(A, rel=0.03)
    assert peak == pytest.approx(exact, rel=0.03)
