"""Starts under light loads, time refined, and what a simulation tells."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from as_load import as_load
from small_parts import START, complementarity
from undrawn import undrawn
from unmarked import unmarked

from drake_exo import cli
from drake_exo.errors import InputError
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.contact.newton import ContactSolver
from drake_exo.soles.elasticity import Material, Sole
from drake_exo.soles.load_blocks import Constant
from drake_exo.soles.mesh import SphericalSpline, brick, read_mesh, write_vtk
from drake_exo.soles.optimize.optimizer import (
    Optimum,
    _Callbacks,
    cost_and_violation,
)
from drake_exo.soles.simulation import simulate

SIZE = (0.23, 0.13, 0.03)


def _case(old="", new=""):
    return Case.from_text(EXAMPLE.replace(old, new) if old else EXAMPLE)


@pytest.mark.slow
@pytest.mark.parametrize("force", [0.1, 1.0, 10.0, 800.0])
def test_a_foot_is_set_down_under_any_load(force):
    text = EXAMPLE.replace("[4, 3, 2]", "[18, 12, 4]")
    case = Case.from_text(
        text.replace("[10, 0, 400]", f"[{0.1 * force}, 0, {force}]")
    )
    history = simulate(
        ContactSolver.of(sole := case.sole(), ContactLaw(0.8, sole.penalty)),
        case.load.at(np.arange(1)), case.start,
    )  # fmt: skip
    (report,) = history.reports
    assert report.converged and report.parts == 1 and not report.message
    np.testing.assert_allclose(
        history.F[0].sum(axis=0), case.load.force[0], atol=1e-8 * force
    )


def _bent(seed: int):
    """A soft, bent sole; of bends drawn one after the other the last."""
    rng = np.random.default_rng(1)
    spline, mesh = SphericalSpline((4, 4)), brick(SIZE, (10, 6, 2))
    for _ in range(seed + 1):
        p = 1 + 0.4 * rng.uniform(-1, 1, spline.count)
    shaped = mesh.with_nodes(spline.deform(mesh.nodes, p))
    assert shaped.volumes.min() > 0
    return Sole(shaped, Material("soft", 6e5, 0.3, 1000.0))


FORCE = np.array([[45, 0, 60], [0, -520, 700], [-390, 0, 500], [300, 300, 550]])
ZMP = np.array([[-0.09, 0.04], [0.08, -0.045], [0.09, 0.05], [-0.1, -0.04]])


def _follow(seed, pieces=1, **more):
    """A slipping step in four samples, or as many times more."""
    sole = _bent(seed)
    law = ContactLaw(0.8, sole.penalty)
    t = np.linspace(0, 3, 3 * pieces + 1)
    force, zmp = (
        np.stack([np.interp(t, range(4), x) for x in values.T], axis=1)
        for values in (FORCE, ZMP)
    )
    solver = ContactSolver.of(sole, law)
    return simulate(solver, as_load(force, zmp), START, **more), sole, law


@pytest.mark.slow
def test_a_sample_too_far_from_the_one_before_is_led_to():
    history, sole, law = _follow(45)
    assert history.failed_steps == 0
    parts = history.reports[1].parts
    assert parts > 1
    assert history.reports[1].converged and not history.reports[1].message
    # What led there is not told, but has been: the law holds against the
    # references of the last part, and the stiffness is finite.
    assert complementarity(history, law, START, sole.positions) < 1e-8
    assert np.isfinite(history.K_c).all()
    coarse, _, _ = _follow(45, stop_at_failure=True)
    assert coarse.failed_steps == 3


@pytest.mark.slow
def test_time_refined_where_need_be_is_near_time_refined_throughout():
    history, _, _ = _follow(45)
    fine, _, _ = _follow(45, 16)
    assert fine.failed_steps == 0
    away = np.abs(history.R - fine.R[::16]).max()
    assert away < 0.1


@pytest.mark.slow
def test_where_no_sample_in_between_helps_the_limit_is_told():
    history, _, _ = _follow(4)
    assert not history.reports[1].converged
    said = history.reports[1].message
    assert "no equilibrium beyond" in said
    assert "in steps of 1/64" in said
    assert np.isnan(history.K_c[1]).all()


def test_a_force_beyond_friction_is_named_at_once():
    with pytest.raises(InputError, match=r"friction of 0\.900.*friction is"):
        _case("[10, 0, 400]", "[0, 360, 400]")
    _case("[10, 0, 400]", "[0, 300, 400]")


def test_the_outline_turns_with_the_foot():
    zmp = "zmp_m: [0.02, 0.01]", "zmp_m: [-0.11, 0.09]"
    with pytest.raises(InputError, match="outside the sole by 25"):
        _case(*zmp)
    # Held at its back edge and turned by a quarter to the left, the sole
    # reaches from y = 0 to 0.23 and from x = -0.18 to -0.05.
    turned = EXAMPLE.replace(*zmp) + "start: {yaw_rad: 1.5707963}\n"
    assert Case.from_text(turned).start.yaw > 1.5


def test_lengths_in_millimetres_are_refused(tmp_path):
    mesh = brick(SIZE, (4, 3, 2))
    write_vtk(tmp_path / "sole.vtk", mesh.with_nodes(1e3 * mesh.nodes))
    with pytest.raises(InputError, match="230 x 130 x 30 m large"):
        read_mesh(tmp_path / "sole.vtk")
    with pytest.raises(InputError, match="scale it"):
        brick((230, 130, 30), (4, 3, 2))


def test_a_bent_top_needs_its_origin(tmp_path):
    mesh = brick(SIZE, (6, 4, 2))
    spline = SphericalSpline((3, 3))
    p = 1 + 0.2 * np.linspace(-1, 1, spline.count)
    bent = mesh.with_nodes(
        spline.deform(mesh.nodes, p) + np.array([0.3, 0.0, 0.1])
    )
    write_vtk(tmp_path / "sole.vtk", bent)
    with pytest.raises(InputError, match=r"give mesh\.origin_m"):
        read_mesh(tmp_path / "sole.vtk")
    found = read_mesh(tmp_path / "sole.vtk", (0.3, 0.0, 0.1))
    np.testing.assert_allclose(found.nodes, bent.nodes - [0.3, 0, 0.1])
    # A rectangle has a middle, wherever it lies.
    write_vtk(tmp_path / "flat.vtk", mesh.with_nodes(mesh.nodes + 0.1))
    found = read_mesh(tmp_path / "flat.vtk")
    np.testing.assert_allclose(found.nodes, mesh.nodes, atol=1e-12)


class Nothing:
    """A problem of which nothing can be simulated."""

    def constraints(self, p):
        return np.full(3, np.nan)

    def cost(self, p):
        return np.nan


def test_what_cannot_be_simulated_is_no_optimum():
    p = np.ones(2)
    cost, violation = cost_and_violation(Nothing(), p)
    assert (cost, violation) == (np.inf, np.inf)
    best = Optimum(p)
    best.consider(2 * p, cost, violation)
    assert best.p is p


def _simulate(tmp_path, text, *more):
    (tmp_path / "case.yaml").write_text(text)
    out = tmp_path / "out"
    code = cli.main(
        ["sole", "simulate", str(tmp_path / "case.yaml"), "--force",
         "--out", str(out), *more]
    )  # fmt: skip
    return code, json.loads((out / "summary.json").read_text())


@pytest.mark.slow
def test_a_simulation_ends_with_its_verdict(tmp_path, capsys):
    with undrawn():
        code, summary = _simulate(tmp_path, EXAMPLE)
    assert (code, summary["verdict"]) == (0, "holds")
    assert "verdict: holds" in capsys.readouterr().out
    checks = {c["name"]: c for c in summary["checks"]}
    assert set(checks) == {
        "solved", "plausibility.strain", "plausibility.tilt",
        "plausibility.stability", "plausibility.friction",
        "plausibility.undercut", "plausibility.load_force",
        "plausibility.load_time", "plausibility.load_spacing", "contact",
    }  # fmt: skip
    soft = EXAMPLE.replace("neoprene}", "neoprene, youngs_modulus_pa: 1.5e4}")
    code, summary = _simulate(tmp_path, soft)
    assert (code, summary["verdict"]) == (3, "does not hold")
    out = tmp_path / "out"
    assert unmarked(out) == [] and len(list(out.glob("*.png"))) >= 5
    assert "inside out" in capsys.readouterr().out
    with undrawn():
        code, summary = _simulate(tmp_path, soft, "--accept", "plausibility")
    assert (code, summary["accepted"]) == (0, ["plausibility"])


def test_beyond_small_strain_is_told_and_beyond_reason_refused():
    strains = {}
    for modulus in (1e7, 5e4, 1.5e4):
        text = EXAMPLE.replace(
            "neoprene}", f"neoprene, youngs_modulus_pa: {modulus}}}"
        )
        found = {c.name: c for c in Case.from_text(text).simulate()
                 .verdict().checks}  # fmt: skip
        strains[modulus] = found["plausibility.strain"]
    assert strains[1e7].holds
    assert not strains[5e4].holds
    assert strains[5e4].level == "note"
    assert "finite strain" in strains[5e4].sentence
    assert strains[1.5e4].level == "fail"


@pytest.mark.slow
def test_a_lost_sample_is_named_by_its_time():
    case = _case("zmp_m: [0.02, 0.01]", "zmp_m: [0.1149, -0.0649]")
    case = case.from_text(
        EXAMPLE.replace("[0.02, 0.01]", "[0.1149, -0.0649]").replace(
            "[10, 0, 400]", "[10, 0, 4000]"
        )
    )
    verdict = case.simulate().verdict()
    assert verdict.word == "not solved"
    assert "sample 1 at 0 s" in verdict.failing[0].sentence


def test_friction_used_is_that_of_the_steepest_sample():
    load = Constant((30.0, 40.0, 100.0), (0.0, 0.0), 3).load()
    np.testing.assert_allclose(
        load.friction_used(np.array([0.0, 0.0, 1.0])), 0.5
    )


def test_undercut_is_the_part_that_faces_upwards():
    mesh = brick(SIZE, (4, 4, 2))
    assert mesh.undercut == 0.0
    # Shrunk below: all four sides hang over nothing; widened: all face up.
    z = mesh.nodes[:, 2:] / SIZE[2]
    narrow = mesh.with_nodes(mesh.nodes * (1 + 0.3 * z) ** [1, 1, 0])
    wide = mesh.with_nodes(mesh.nodes * (1 - 0.3 * z) ** [1, 1, 0])
    assert narrow.undercut == 0.0
    low = 1.3**2 * SIZE[0] * SIZE[1]
    x = wide.nodes[wide.contact_faces]
    area = (
        0.5
        * np.linalg.norm(
            np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1
        ).sum()
    )
    assert wide.undercut == pytest.approx(1 - low / area)


@pytest.mark.slow
def test_a_design_is_told_where_a_finer_mesh_disagrees():
    design = Case.from_text(EXAMPLE).optimize()
    words = {}
    for change in (0.01, -0.05, np.nan):
        finer = {"change": change, "design": None}
        found = design.verdict(finer=finer).checks[-1]
        assert (found.name, found.level) == ("plausibility.mesh", "note")
        words[change] = found.holds, found.sentence
    assert words[0.01] == (True, "")
    assert "too coarse" in words[-0.05][1]
    assert "turns elements" in list(words.values())[-1][1]
    outside = {c.name for c in design.verdict().checks if not c.holds}
    assert "bounds.volume" not in outside


def test_slopes_of_cost_and_constraints_are_told_apart():
    """What IPOPT is handed: the gradient with roughness, rows one by one."""
    problem = SimpleNamespace(
        regularization=lambda p: (0.5, 3.0 * p, None),
    )
    calls = _Callbacks(problem, None, None, None)
    calls.at = lambda p: (10.0 * p, np.array([[1.0, 2.0], [3.0, 4.0]]))
    p = np.ones(2)
    np.testing.assert_array_equal(calls.gradient(2.0 * p), [26.0, 26.0])
    rows = calls.jacobian(2.0 * p)
    np.testing.assert_array_equal(rows, [1.0, 2.0, 3.0, 4.0])
