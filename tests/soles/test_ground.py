"""A sole on uneven ground against flat ground turned, and differences."""

from dataclasses import replace

import numpy as np
import pytest
from small_parts import complementarity, measure

from drake_exo.errors import InputError
from drake_exo.soles.animation import SoleMotion, write_animation
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact.gauss_seidel import GaussSeidelSolver
from drake_exo.soles.contact.law import COLUMNS, FLAT, ContactLaw, Ground
from drake_exo.soles.contact.newton import ContactSolver, Start
from drake_exo.soles.elasticity import MATERIALS, Sole
from drake_exo.soles.finite_strain import (
    FiniteStrainSolver,
    NeoHookeanBody,
    compare_strains,
    follow,
)
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import brick
from drake_exo.soles.numerics import rotations_xyz
from drake_exo.soles.optimize.adjoint import gradients, singular_terms
from drake_exo.soles.optimize.files import find_designs
from drake_exo.soles.results import sole_samples
from drake_exo.soles.simulation import HISTORY, simulate

POINT = np.array([-0.115, 0.0, -0.03])


def _ground(height, spacing=0.02):
    """Of a function of x and y, on 0.4 m by 0.3 m."""
    x, y = np.arange(-0.2, 0.201, spacing), np.arange(-0.16, 0.161, spacing)
    X, Y = np.meshgrid(x, y, indexing="ij")
    columns = [v.ravel() for v in (X, Y, height(X, Y) + 0 * X)]
    return Ground.of_table(dict(zip(COLUMNS, columns, strict=True)), "grid")


def _bumps(x, y):
    return 0.002 * np.sin(40 * x + 1) * np.cos(50 * y) + 0.05 * x - 0.03 * y


def _load(count=4):
    s = np.linspace(0, 1, count)
    force = np.stack([30 - 50 * s, 10 * s, 200 + 300 * s], axis=1)
    zmp = np.stack([-0.06 + 0.1 * s, 0.02 - 0.03 * s], axis=1)
    return Load(0.05 * np.arange(count), force, zmp)


def _start(ground):
    place = np.array([POINT[0], POINT[1], 0.0])
    place[2] = ground.height(place[None])[0]
    return Start(POINT, place)


def _sole():
    return Sole(brick((0.23, 0.13, 0.03), (7, 5, 3)), MATERIALS["neoprene"])


def _simulated(ground, load, start=None, kind=ContactSolver, layer=0.0):
    sole = _sole()
    law = ContactLaw(0.8, sole.penalty, layer, 0.2 * (layer > 0))
    solver = kind.of(sole, law, ground=ground)
    history = simulate(solver, load, start or _start(ground))
    assert history.failed_steps == 0, history.reports
    return sole, solver, history


def _turned(load, R):
    """Load and start on flat ground as they are on one turned by R."""
    Z = np.column_stack([load.zmp, np.zeros(len(load.zmp))]) @ R.T
    turned = replace(load, force=load.force @ R.T, zmp=Z[:, :2])
    place = R @ [*POINT[:2], 0.0]
    return turned, Start(POINT, place)


SLOPE = 0.15
LATERAL = rotations_xyz(np.array([np.arctan(SLOPE), 0.0, 0.0]))


def test_planes_touch_the_ground():
    ground, rng = _ground(_bumps), np.random.default_rng(1)
    P = np.column_stack([rng.uniform(-0.12, 0.12, (30, 2)),
                         rng.uniform(0, 0.02, 30)])  # fmt: skip
    Q, axes = ground.planes(P)
    # On a plane through the ground below, along its normal.
    below = np.column_stack([P[:, :2], ground.height(P)])
    n = axes[:, 2]
    np.testing.assert_allclose(((Q - below) * n).sum(1), 0, atol=1e-15)
    np.testing.assert_allclose(np.cross(P - Q, n), 0, atol=1e-15)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1) - np.eye(3),
                               0, atol=1e-14)  # fmt: skip
    # Between grid points the spline is near what it was made of.
    assert np.abs(ground.height(P) - _bumps(*P[:, :2].T)).max() < 1e-4
    h, found = 1e-6, ground.plane_derivatives(P)
    for k in range(3):
        (Qp, Ap), (Qm, Am) = (
            ground.planes(P + s * h * np.eye(3)[k]) for s in (1, -1)
        )
        by_n = (Ap[:, 2] - Am[:, 2]) / (2 * h)
        numbers = (Qp - Qm) / (2 * h), np.cross(n, by_n)
        for got, expected in zip(found, numbers, strict=True):
            np.testing.assert_allclose(got[:, :, k], expected, atol=2e-8)


def test_raised_ground_raises_the_foot():
    load = _load()
    flat = _simulated(FLAT, load)[2]
    raised = _simulated(_ground(lambda x, y: 0.07), load)[2]
    np.testing.assert_allclose(raised.F, flat.F, atol=1e-8)
    np.testing.assert_allclose(raised.O - flat.O, [[0, 0, 0.07]] * 4,
                               atol=1e-11)  # fmt: skip
    np.testing.assert_allclose(raised.K_c, flat.K_c, rtol=1e-8, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [ContactSolver, GaussSeidelSolver])
def test_a_slope_is_flat_ground_turned(kind):
    """Sideways, where a turn leaves the yaw of Rx·Ry·Rz as it is."""
    load = _load()
    sole, solver, flat = _simulated(FLAT, load, kind=kind)
    ground = _ground(lambda x, y: SLOPE * y)
    turned, start = _turned(load, LATERAL)
    _, _, slope = _simulated(ground, turned, start, kind)
    np.testing.assert_allclose(slope.F, flat.F @ LATERAL.T, atol=2e-5)
    np.testing.assert_allclose(slope.O, flat.O @ LATERAL.T, atol=2e-9)
    np.testing.assert_allclose(slope.R, LATERAL @ flat.R, atol=2e-8)
    both = np.kron(np.eye(2), LATERAL)
    np.testing.assert_allclose(slope.K_c, both @ flat.K_c @ both.T,
                               rtol=1e-5, atol=1.0)  # fmt: skip
    error = complementarity(
        slope, solver.law, start, sole.positions, ground=ground
    )
    assert error < 1e-8
    # Judged as if it stood on flat ground, the law is broken.
    assert complementarity(slope, solver.law, start, sole.positions) > 1e-2


@pytest.mark.slow
def test_finite_strain_on_a_slope_is_flat_ground_turned():
    load = _load(2)
    sole = _sole()
    law = ContactLaw(0.8, sole.penalty)
    turned, start = _turned(load, LATERAL)
    ground = _ground(lambda x, y: SLOPE * y)
    flat = follow(sole, law, load, _start(FLAT))
    slope = follow(sole, law, turned, start, ground=ground)
    assert flat.converged.all() and slope.converged.all()
    for a, b in zip(flat.states, slope.states, strict=True):
        np.testing.assert_allclose(b.F, a.F @ LATERAL.T, atol=1e-4)
        np.testing.assert_allclose(b.u, a.u, atol=1e-8)
    both = np.kron(np.eye(2), LATERAL)
    np.testing.assert_allclose(slope.K_c, both @ flat.K_c @ both.T,
                               rtol=1e-5, atol=1.0)  # fmt: skip
    # Nodes that slipped and came to rest stick, whatever rounding tells.
    body = NeoHookeanBody(sole.mesh, sole.material)
    solver, state = FiniteStrainSolver(body, law, ground=ground), b
    target = turned.target(1, solver.places(state), ground)
    up = (state.F @ LATERAL[:, 2])[:, None] * LATERAL[:, 2]
    found = [
        solver.cartesian_stiffness(
            replace(state, F=up + part * (state.F - up)), target
        )
        for part in (1 - 1e-13, 1 + 1e-13)
    ]
    np.testing.assert_allclose(*found, rtol=1e-9, atol=1e-3)


def test_an_animation_s_zmp_is_the_load_s():
    """Horizontal forces act at heights, too."""
    ground, load = _ground(_bumps), _load()
    sole, _, history = _simulated(ground, load)
    motion = SoleMotion.of("it", sole.mesh, load.times, history, ground)
    found = motion.ground.zero_moment_point(motion.force, motion.places)
    np.testing.assert_allclose(found[:, :2], load.zmp, atol=1e-7)
    np.testing.assert_allclose(found[:, 2], ground.height(load.zmp), atol=1e-8)


@pytest.mark.slow
def test_methods_agree_on_bumps():
    ground, load = _ground(_bumps), _load()
    newton = _simulated(ground, load)[2]
    paper = _simulated(ground, load, kind=GaussSeidelSolver)[2]
    np.testing.assert_allclose(paper.F, newton.F, atol=1e-4)
    np.testing.assert_allclose(paper.O, newton.O, atol=1e-9)
    # They are bumps: on the plane that fits them nodes carry otherwise.
    slope = _ground(lambda x, y: 0.05 * x - 0.03 * y)
    plain = _simulated(slope, load)[2]
    assert np.abs(plain.F - newton.F).max() > 5.0


@pytest.mark.slow
def test_finite_strain_stands_on_bumps():
    """A stiff sole strains little: both kinds give the same forces."""
    ground, load = _ground(_bumps), _load(2)
    stiff = replace(MATERIALS["neoprene"], youngs_modulus_pa=1e8)
    sole = Sole(_sole().mesh, stiff)
    law, start = ContactLaw(0.8, sole.penalty), _start(ground)
    small = simulate(ContactSolver.of(sole, law, ground=ground), load, start)
    finite = follow(sole, law, load, start, ground=ground)
    assert finite.converged.all()
    np.testing.assert_allclose(finite.states[1].F, small.F[1], atol=1.0)
    assert small.F[1, :, 2].max() > 30.0


@pytest.mark.slow
@pytest.mark.parametrize(("count", "leans"), [(1, 0), (4, 0), (3, 5e-3)])
def test_gradients_on_bumps_match_differences(count, leans, monkeypatch):
    """By shape and by load; without the ground's curvature they do not.

    Poses that are given lean from those of the load, so that the ZMP is the
    forces' own.
    """
    ground, load, rng = _ground(_bumps), _load(count), np.random.default_rng(3)
    mesh = _sole().mesh
    law = ContactLaw(0.8, _sole().penalty, 5e-5, 0.2)
    by_tr, by_rot = np.ones(count), -3.0 * np.ones(count)
    start = _start(ground)

    def forward(nodes, load):
        sole = Sole(mesh.with_nodes(nodes), MATERIALS["neoprene"])
        solver = ContactSolver.of(sole, law, tolerance=1e-13, ground=ground)
        history = simulate(solver, load, start, keep=True)
        assert history.failed_steps == 0
        return sole, solver, history

    sole, solver, history = forward(mesh.nodes, load)
    if leans:
        lean = rotations_xyz(leans * np.array([1.0, -1.0, 0.0]))
        load = replace(load, rotation=lean @ history.R)
        sole, solver, history = forward(mesh.nodes, load)
    terms = [singular_terms(history.K_c, by_tr, by_rot)]
    given = sole, solver, load, start, history, terms
    (by_shape,), (by_load,) = gradients(*given)
    direction = rng.standard_normal(mesh.nodes.shape)
    direction[mesh.fixed] = 0.0
    pull = rng.standard_normal((count, 5)) * [1, 1, 1, 1e-3, 1e-3]

    def differences(change, h):
        ends = [measure(change(s * h), by_tr, by_rot) for s in (1, -1)]
        return (ends[0] - ends[1]) / (2 * h)

    def moved(h):
        return forward(mesh.nodes + h * direction, load)[2]

    def pulled(h):
        d = h * pull
        there = replace(load, force=load.force + d[:, :3],
                        zmp=load.zmp + d[:, 3:])  # fmt: skip
        return forward(mesh.nodes, there)[2]

    slope = (by_shape * direction).sum()
    found = [differences(moved, h) for h in (1e-8, 3e-9)]
    assert min(abs(f / slope - 1) for f in found) < 2e-5
    ends = [differences(pulled, h) for h in (1e-3, 3e-4)]
    assert min(abs(f / (by_load * pull).sum() - 1) for f in ends) < 2e-5
    # A planted error: the ground's normals taken as if they stayed.
    plain = Ground.plane_derivatives
    monkeypatch.setattr(
        Ground, "plane_derivatives",
        lambda self, P: (plain(self, P)[0], 0 * plain(self, P)[1]),
    )  # fmt: skip
    wrong = (gradients(*given)[0][0] * direction).sum()
    assert min(abs(f / wrong - 1) for f in found) > 2e-5


def _file(path, points):
    rows = "\n".join(",".join(f"{v:.6g}" for v in row) for row in points)
    path.write_text(f"x_m,y_m,z_m\n{rows}\n", encoding="utf-8")


def _points(height=lambda x, y: 0.0, x=(-0.2, 0.2), count=9):
    return [
        (a, b, height(a, b))
        for a in np.linspace(*x, count)
        for b in np.linspace(-0.2, 0.2, count)
    ]


CASE = EXAMPLE + "ground: {heights: ground.csv}\n"


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (_points()[:-1], "not a grid of 9 x 9"),
        (_points() + _points()[:1], "82 points are not a grid"),
        (_points()[1:] + _points()[1:2], "81 points are not a grid"),
        (_points(count=3), "too small; give at least 4 x 4"),
        (_points(lambda x, y: 1000 * x * y), "give heights in metres"),
        (_points(x=(-0.1, 0.1)), "give heights below all of it"),
        (_points(lambda x, y: np.nan), "missing or NaN"),
    ],
)
def test_bad_grids_are_refused(points, said, tmp_path):
    _file(tmp_path / "ground.csv", points)
    (tmp_path / "case.yaml").write_text(CASE, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        Case.read(tmp_path / "case.yaml")


def test_a_slope_beyond_friction_is_refused(tmp_path):
    _file(tmp_path / "ground.csv", _points(lambda x, y: 0.9 * y))
    (tmp_path / "case.yaml").write_text(CASE, encoding="utf-8")
    with pytest.raises(InputError, match=r"asks for a friction of 0\.9"):
        Case.read(tmp_path / "case.yaml")


def test_tilt_is_that_from_the_slope(tmp_path):
    """A sole that lies on it does not lean."""
    _file(tmp_path / "ground.csv", _points(lambda x, y: 0.2 * x, count=21))
    (tmp_path / "case.yaml").write_text(CASE, encoding="utf-8")
    case = Case.read(tmp_path / "case.yaml")
    step = case.simulate()
    pitch = -np.rad2deg(step.angles[:, 1])
    slope = np.rad2deg(np.arctan(0.2))
    assert (np.abs(pitch - slope) < 1.5).all() and (step.tilt_deg < 1.5).all()
    samples = compare_strains(case)["samples"]
    assert samples[0]["tilt_deg_small"] < 1.5 > samples[0]["tilt_deg_finite"]


@pytest.mark.slow
def test_a_case_on_bumps(tmp_path):
    """From the file to a design, its pictures, and back."""
    _file(tmp_path / "ground.csv", _points(_bumps, count=21))
    (tmp_path / "case.yaml").write_text(CASE, encoding="utf-8")
    case = Case.read(tmp_path / "case.yaml")
    step = case.simulate()
    assert step.failed_steps == 0
    found = case.with_iterations(2).optimize()
    (tmp_path / "out").mkdir()
    found.write(tmp_path / "out")
    told = found.summary()["ground"]
    assert told["relief_m"] == pytest.approx(
        np.ptp(_bumps(*case.level.T)), rel=1e-3
    )
    assert 5 < told["steepest_deg"] < 10
    assert told["relief_m"] > 0.01
    (design,) = find_designs(tmp_path / "out")
    np.testing.assert_allclose(design.setup.ground.z, case.ground.z)
    flat = Case.from_text(EXAMPLE).simulate()
    assert abs(step.c_tr / flat.c_tr - 1) > 0.01
    np.testing.assert_allclose(step.zmp, case.load.zmp, atol=1e-6)
    # Told on: pictures, the animation, and what flat ground alone allows.
    with pytest.raises(InputError, match="stood on uneven ground"):
        sole_samples(tmp_path / "out")
    motion = SoleMotion.read(tmp_path / "out" / HISTORY, "bumps")
    np.testing.assert_allclose(motion.ground.z, case.ground.z)
    below = motion.ground.height(case.load.zmp)
    zmp = motion.ground.zero_moment_point(motion.force, motion.places)
    np.testing.assert_allclose(zmp[:, :2], found.step.zmp, atol=1e-7)
    np.testing.assert_allclose(zmp[:, 2], below, atol=1e-7)
    level = tmp_path / "level.html"
    write_animation(level, [replace(motion, ground=FLAT)], "")
    bumpy = tmp_path / "out" / "animation.html"
    assert bumpy.stat().st_size > level.stat().st_size + 10_000
