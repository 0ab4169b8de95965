"""A step's figures, tables and costs against sums over its nodes by hand."""

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_parts import complementarity as violation
from small_step import write_case, write_step

from drake_exo.soles import simulation
from drake_exo.soles.case import EXAMPLE, Case
from drake_exo.soles.contact.law import ContactLaw, Ground
from drake_exo.soles.contact.newton import ContactSolver
from drake_exo.soles.load_blocks import Constant
from drake_exo.soles.loads import Load
from drake_exo.soles.numerics import rotations_xyz
from drake_exo.soles.results import Step


@pytest.fixture(scope="module")
def step(tmp_path_factory) -> Step:
    folder = tmp_path_factory.mktemp("step")
    write_step(folder / "load.csv", 11)
    write_case(folder / "case.yaml")
    found = Case.read(folder / "case.yaml").simulate()
    assert found.failed_steps == 0
    return found


@pytest.mark.slow
def test_forces_and_zmp_are_the_nodes_sums(step):
    load = step.setup.load
    for q in range(11):
        F, P = step.history.F[q], step.history.P[q]
        np.testing.assert_allclose(step.force[q], F.sum(axis=0))
        np.testing.assert_allclose(F.sum(axis=0), load.force[q], atol=1e-5)
        zmp = (P[:, :2] * F[:, 2:]).sum(axis=0) / F[:, 2].sum()
        np.testing.assert_allclose(step.zmp[q], zmp)
        np.testing.assert_allclose(zmp, load.zmp[q], atol=1e-7)


def test_what_is_read_from_a_step_does_not_change_it(step):
    """Stiffness in N/mm, made in place, would be that of costs and checks."""
    figures = step.costs, step.summary()
    for signal in (step.stiffness, step.origin, step.rotation, step.force):
        signal *= 1e-3
    assert (step.costs, step.summary()) == figures
    with pytest.raises(ValueError, match="read-only"):
        step.setup.load.force[:] *= 2.0


def test_a_yaw_near_half_a_turn_does_not_leap():
    """In a contact; the next one is as it would be alone."""
    yaw = [179.9, 180.2, 179.8, -179.0]
    turned = np.deg2rad([[0.0, 0.0, angle] for angle in yaw])
    step = SimpleNamespace(
        history=SimpleNamespace(R=rotations_xyz(turned)),
        setup=SimpleNamespace(load=SimpleNamespace(begins=(0, 3))),
    )
    found = Step.angles.fget(step)
    np.testing.assert_allclose(found, turned, atol=1e-12)


def test_pressure_is_force_over_a_nodes_area(step):
    mesh = step.sole.mesh
    area = mesh.contact_areas
    # The bottom's alone: its edge touches with nothing of the sides.
    assert area.sum() == pytest.approx(0.23 * 0.13)
    everywhere = mesh.touching_everywhere()
    area_of = dict(
        zip(everywhere.contact, everywhere.contact_areas, strict=True)
    )
    np.testing.assert_allclose([area_of[k] for k in mesh.contact], area)
    # A node amid a side: its own six or four triangles there.
    assert min(everywhere.contact_areas) > 0.0
    for q in (0, 5):
        expected = step.history.F[q, :, 2] / area
        np.testing.assert_allclose(step.pressure[q], expected)
    carried = (step.pressure * area).sum(axis=1)
    np.testing.assert_allclose(carried, step.setup.load.force[:, 2], rtol=1e-6)
    np.testing.assert_array_equal(step.touching, step.pressure > 0)


def test_stiffness_of_known_matrices():
    """Diagonal blocks: their entries are the singular values."""
    K = np.zeros((4, 6, 6))
    K[0] = -np.diag([1e4, 3e4, 2e4, 50.0, 20.0, 70.0])
    K[1] = -np.diag([5e4, 1e4, 2e4, 90.0, 80.0, 30.0])
    K[2, :3, 3:] = 7.0  # coupling has no part in either block
    K[3] = np.nan
    found = simulation.sigma_max_translation(K)
    np.testing.assert_allclose(found, [3e4, 5e4, 0.0, np.nan])
    found = simulation.sigma_min_rotation(K)
    np.testing.assert_allclose(found, [20.0, 30.0, 0.0, np.nan])
    # Rotations over (0.05 m)^2: 20 / 0.0025 = 8000 N/m.
    found = simulation.stability(K[:2])
    np.testing.assert_allclose(found, [8e3, 1e4])
    assert np.isnan(simulation.stability(K[3]))
    K[0, 0, 1] = 2e4  # the symmetric part alone counts
    sym = np.array([[1e4, -1e4], [-1e4, 3e4]])
    expected = min(np.linalg.eigvalsh(sym)[0], 8e3)
    assert simulation.stability(K[0]) == pytest.approx(expected)
    assert simulation.stability(-K[1]) == pytest.approx(-5e4)


@pytest.mark.parametrize(
    ("samples", "fraction", "count"),
    [
        (10, 0.1, 1),
        (19, 0.1, 1),
        (20, 0.1, 2),
        (5, 0.1, 1),
        (9, 0.5, 4),
        (100, 0.29, 29),
        (99, 0.29, 28),
    ],
)
def test_heel_strike_is_the_first_part(samples, fraction, count):
    assert simulation.heel_strike_count(samples, fraction) == count


def test_several_steps_weigh_by_their_shares():
    """One of 20 samples that counts once, one of 30 that counts thrice."""
    first, second = (
        Constant((0.0, 0.0, 400.0), (0, 0), n).load() for n in (20, 30)
    )
    load = Load.one_after_another([first, second], [1.0, 3.0])
    picked, counts, by_tr, by_rot = simulation.sample_weights(load, 0.1)
    np.testing.assert_array_equal(picked, np.arange(50))
    np.testing.assert_array_equal(counts, 1.0)
    np.testing.assert_allclose(by_rot, [0.25] * 20 + [0.75] * 30)
    strike = [0.25] * 2 + [0.0] * 18 + [0.75] * 3 + [0.0] * 27
    np.testing.assert_allclose(by_tr, strike)


def by_hand(K: np.ndarray) -> tuple[float, float]:
    """Largest and least stretch of a block's rows, by its Gram matrix."""
    largest = np.sqrt(np.linalg.eigvalsh(K[:3, :3].T @ K[:3, :3]).max())
    least = np.sqrt(np.linalg.eigvalsh(K[3:, 3:].T @ K[3:, 3:]).min())
    return largest, least


def test_a_steps_costs_are_those_of_its_stiffness(step):
    cost = step.setup.settings.cost
    tr, rot = np.array([by_hand(K) for K in step.stiffness]).T
    np.testing.assert_allclose(step.sigma_max_translation, tr)
    np.testing.assert_allclose(step.sigma_min_rotation, rot, rtol=1e-6)
    count = max(1, int(cost.heel_strike_fraction * 11))
    assert step.heel_strike == count
    assert step.c_tr == pytest.approx(tr[:count].sum())
    assert step.c_rot == pytest.approx(rot.sum(), rel=1e-6)
    assert step.c == pytest.approx(step.c_tr - cost.weight * step.c_rot)
    settings = replace(step.setup.settings, cost=replace(cost, weight=7.0))
    other = replace(step, setup=replace(step.setup, settings=settings))
    assert other.c == pytest.approx(step.c_tr - 7.0 * step.c_rot)


def test_figures_of_each_contact_phase_are_its_own():
    """Costs as if it were alone, means over its samples."""
    first, second = (
        Constant((0.0, 0.0, 400.0), (0, 0), n).load() for n in (20, 30)
    )
    load = Load.one_after_another([first, second], [1.0, 3.0])
    cost = SimpleNamespace(weight=5.0, heel_strike_fraction=0.1)
    told = SimpleNamespace(
        setup=SimpleNamespace(load=load, settings=SimpleNamespace(cost=cost)),
        times=load.times,
        converged=np.arange(50) != 33,
        _sums=lambda rows: (6.0, 9.0) if rows[0] else (12.0, 45.0),
    )
    one, two = Step.loads(told)
    assert (one["c_tr"], one["c_rot"]) == (24.0, 36.0)  # a quarter of all
    assert (two["c_tr"], two["c_rot"]) == (16.0, 60.0)
    assert (one["c"], two["c"]) == (24.0 - 180.0, 16.0 - 300.0)
    assert (one["c_tr_mean_n_per_m"], two["c_tr_mean_n_per_m"]) == (
        pytest.approx(24.0 / 2),
        pytest.approx(16.0 / 3),
    )
    means = [x["c_rot_mean_nm_per_rad"] for x in (one, two)]
    assert means == pytest.approx([36.0 / 20, 60.0 / 30])
    assert [x["steps"] for x in (one, two)] == [20, 30]
    assert [x["failed_steps"] for x in (one, two)] == [0, 1]
    assert two["begins_s"] == load.times[20]


def test_table_columns_are_in_the_unit_of_their_name(step):
    table, load = step.table(), step.setup.load
    for k, axis in enumerate("xyz"):
        np.testing.assert_array_equal(
            table[f"force_{axis}_n"], load.force[:, k]
        )
        origin = step.history.O[:, k]
        np.testing.assert_array_equal(table[f"origin_{axis}_m"], origin)
    np.testing.assert_array_equal(table["zmp_x_m"], load.zmp[:, 0])
    np.testing.assert_array_equal(table["zmp_y_m"], load.zmp[:, 1])
    # R = Rx Ry Rz: R02 = sin(pitch), R12 = -sin(roll) cos(pitch).
    R = step.history.R
    pitch = np.arcsin(R[:, 0, 2])
    roll = np.arctan2(-R[:, 1, 2], R[:, 2, 2])
    yaw = np.arctan2(-R[:, 0, 1], R[:, 0, 0])
    for name, angle in (("roll", roll), ("pitch", pitch), ("yaw", yaw)):
        np.testing.assert_allclose(
            table[f"{name}_deg"], angle * 180.0 / np.pi, atol=1e-9
        )
    tilt = np.arccos(R[:, 2, 2]) * 180.0 / np.pi
    np.testing.assert_allclose(table["tilt_deg"], tilt, atol=1e-5)
    touching = (step.history.F[:, :, 2] > 0).sum(axis=1)
    np.testing.assert_array_equal(table["nodes_in_contact"], touching)
    np.testing.assert_array_equal(
        table["sigma_max_tr_n_per_m"], step.sigma_max_translation
    )
    np.testing.assert_array_equal(
        table["sigma_min_rot_nm_per_rad"], step.sigma_min_rotation
    )
    np.testing.assert_array_equal(table["stability_n_per_m"], step.stability)
    assert table["converged"].tolist() == [1] * 11
    reports = step.history.reports
    assert table["newton_iterations"].tolist() == [
        r.iterations for r in reports
    ]


def test_figures_of_a_measured_pose_are_about_the_zmp_that_comes_out():
    case, x = Case.from_text(EXAMPLE), np.linspace(-0.3, 0.3, 9)
    ground = Ground(x, x, 0.2 * x[:, None] - 0.1 * x)
    start = case.settings.start_pose(case.mesh, ground)
    case = replace(case, ground=ground, start=start)
    leans = rotations_xyz(np.array([0.004, 0.01, 0.0]))
    load = replace(
        case.load,
        rotation=leans @ case.simulate().rotation,
        free_moment=np.full(5, 0.1),
    )
    step = replace(case, load=load).simulate()
    assert step.failed_steps == 0 and step.zmp_error > 0.01
    table, F, P = step.table(), step.history.F, step.history.P
    Z = np.stack([table["zmp_x_m"], table["zmp_y_m"]], axis=1)
    Z = np.column_stack([Z, ground.height(Z)])
    moment = np.cross(P - Z[:, None], F).sum(axis=1)
    np.testing.assert_allclose(moment[:, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(table["free_moment_nm"], moment[:, 2])
    np.testing.assert_array_equal(table["recorded_zmp_x_m"], load.zmp[:, 0])
    np.testing.assert_array_equal(table["recorded_free_moment_nm"], 0.1)
    # As of a free pose that is asked for this ZMP.
    solver = ContactSolver.of(step.sole, step.law, ground=ground)
    free = replace(load, rotation=None, zmp=step.zmp)
    q = 3
    target = free.target(q, P[q - 1], ground)
    found = solver.linearise(step.history.state(q), target, P[q])
    np.testing.assert_allclose(found.cartesian_stiffness, step.stiffness[q])


def test_summary_is_in_the_unit_of_its_name(step):
    told, mesh = step.summary(), step.sole.mesh
    assert told["volume_cm3"] == pytest.approx(23.0 * 13.0 * 3.0)
    density = step.sole.material.density_kg_per_m3
    assert told["mass_kg"] == pytest.approx(density * 0.23 * 0.13 * 0.03)
    assert told["tilt_max_deg"] == pytest.approx(step.table()["tilt_deg"].max())
    assert told["stability_min_n_per_m"] == step.stability.min()
    assert told["stable"] is bool(step.stability.min() > 0)
    assert (told["c_tr"], told["c_rot"], told["c"]) == step.costs
    assert told["steps"] == 11 and told["failed_steps"] == 0
    assert told["contact_nodes"] == len(mesh.contact)
    assert (told["nodes"], told["tets"]) == (len(mesh.nodes), len(mesh.tets))
    iterations = [r.iterations for r in step.history.reports]
    assert told["newton_iterations_max"] == max(iterations)
    assert told["newton_iterations_mean"] == pytest.approx(np.mean(iterations))
    strains = []
    for q in range(11):
        # Forces in the sole's own axes.
        f_L = np.einsum("ji,mj->mi", step.rotation[q], step.history.F[q])
        eps = step.sole.strain(step.sole.displacement(f_L))
        strains.append(np.abs(np.linalg.eigvalsh(eps)).max())
    assert told["max_strain"] == pytest.approx(max(strains))


def test_a_step_that_is_not_stable_everywhere_is_not_stable(step):
    loose = step.history.K_c.copy()
    loose[3] = -loose[3]
    other = replace(step, history=replace(step.history, K_c=loose))
    assert other.summary()["stable"] is False


def complementarity(step, **change) -> float:
    history = replace(step.history, **change)
    return replace(step, history=history).complementarity()


def test_laws_that_are_broken_are_told_by_how_much(step):
    """Exact laws hold nearly; each is broken in turn by a known amount."""
    law, q = step.law, 4
    base = step.complementarity()
    assert base < 1e-6
    F, P = step.history.F, step.history.P
    total = np.linalg.norm(F[q].sum(axis=0))
    node = int(np.argmax(F[q, :, 2]))
    free = int(np.argmin(F[q, :, 2]))
    assert F[q, free, 2] == 0.0

    pulled = F.copy()
    pulled[q, free, 2] = -0.1 * total
    shift = 1.0 + 0.1  # the sum is smaller by what pulls
    found = complementarity(step, F=pulled)
    assert found > 0.09 * shift

    deep = P.copy()
    deep[q, free, 2] = -0.02 * total / law.penalty
    assert complementarity(step, P=deep) == pytest.approx(0.02)

    high = P.copy()
    high[q, node, 2] += 3.0 * total / law.penalty
    share = F[q, node, 2] / total
    expected = 3.0 * share
    assert complementarity(step, P=high) == pytest.approx(expected)

    sheared = F.copy()
    up = law.friction * F[q, node, 2]
    sheared[q, node, :2] = [2.0 * up, 0.0]
    new = np.linalg.norm(sheared[q].sum(axis=0))
    assert complementarity(step, F=sheared) >= 0.99 * up / new


@pytest.mark.parametrize(
    ("direction", "violated"), [(180.0, 0.0), (90.0, 1.0), (0.0, 2.0)]
)
def test_slip_that_is_not_against_the_force(direction, violated):
    """One node on the edge of its cone, slipping to where it likes."""
    law = ContactLaw(0.5, 1000.0)
    F = np.array([[1.0, 0.0, 2.0]])
    scale = np.sqrt(5.0)
    angle = np.deg2rad(direction)
    slip = 1e-3 * np.array([np.cos(angle), np.sin(angle)])
    history = SimpleNamespace(
        converged=np.array([True, True]),
        F=np.array([F, F]),
        P=np.array([np.zeros((1, 3)), [[*slip, 0.0]]]),
        R=np.tile(np.eye(3), (2, 1, 1)),
        between={},
    )
    start = SimpleNamespace(places=lambda R, lP: lP)
    found = violation(history, law, start, np.zeros((1, 3)))
    # |f| (|s| + s along f), both over |F| of the sample.
    assert found == pytest.approx(violated / scale**2, abs=1e-12)


def test_a_phase_begins_at_its_start_whatever_came_of_its_first_sample():
    """What the last of the phase before touched says nothing of this one."""
    law, n = ContactLaw(0.5, 1000.0), 4
    F = np.tile([[1.0, 0.0, 2.0]], (n, 1, 1))  # on the edge of its cone
    P = np.zeros((n, 1, 3))
    P[:2, 0, 0] = 0.5  # the phase before lay elsewhere
    history = SimpleNamespace(
        converged=np.array([True, True, False, True]), F=F, P=P,
        R=np.tile(np.eye(3), (n, 1, 1)), between={},
    )  # fmt: skip
    slid = iter([P[0], P[3]])
    start = SimpleNamespace(places=lambda R, lP: next(slid))
    found = violation(history, law, start, np.zeros((1, 3)), begins=(0, 2))
    assert found == pytest.approx(0.0, abs=1e-12)


def test_files_hold_the_table_and_the_summary(step, tmp_path, monkeypatch):
    monkeypatch.setattr(Step, "draw", lambda *_: None)
    step.write(tmp_path, {"more_seconds": 1.5})
    with (tmp_path / "steps.csv").open() as file:
        rows = list(csv.DictReader(file))
    table = step.table()
    assert list(rows[0]) == list(table)
    for name, values in table.items():
        np.testing.assert_allclose(
            [float(row[name]) for row in rows], values, rtol=1e-9
        )
    told = json.loads((tmp_path / "summary.json").read_text())
    for key, value in step.summary().items():
        if isinstance(value, float):
            assert told[key] == pytest.approx(value)
    assert told["complementarity"] == step.complementarity()
    assert told["more_seconds"] == 1.5
