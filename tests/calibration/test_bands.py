"""Bands, their coverage, and what is written of results, by known numbers."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from measured_trials import CUFFS, JOINTS, NAMES, moved, prediction, seen
from scipy.linalg import null_space

import drake_exo as dx
from drake_exo.calibration import uncertainty as module
from drake_exo.calibration.error_model import NO_ERRORS, ErrorSizes
from drake_exo.calibration.phases import (
    InteractionCalibration,
    PredictionProblem,
)
from drake_exo.calibration.results import (
    write_bands,
    write_trial,
)
from drake_exo.calibration.settings import (
    InteractionSettings,
    PredictionSettings,
    Solver,
)
from drake_exo.calibration.uncertainty import (
    QUANTILE_95,
    Bands,
    Uncertainty,
    bands,
    noise_basis,
    posterior,
)
from drake_exo.collocation.trial_program import Tracking
from drake_exo.contact.parameters import Posterior
from drake_exo.measurement.settings import Device, JointDrive
from drake_exo.virtual_laboratory.synthetic import rises_in_device

DEGREES = 180.0 / np.pi


def wide(trial, q=0.1, v=1.0, normal=5.0, mats=8.0) -> Bands:
    n = len(trial.times)
    return Bands(
        np.full((n, 9), q),
        np.full((n, 9), v),
        {c: np.tile([1.0, normal, 0.1], (n, 1)) for c in trial.cuffs},
        {c: np.linspace(0.0, 2.0 * mats, n) for c in list(trial.cuffs)[:2]},
        np.full((n, 9), 2.0 * q),
        np.full((n, 9), 2.0 * v),
        np.zeros((n, 9)),
        np.zeros((n, 9)),
        {c: np.zeros(n) for c in trial.cuffs},
    )


def near(share):
    return pytest.approx(share, rel=1e-12)


def test_coverage_is_the_share_of_samples_within():
    """Off by as much as the sample's number; in within 30 of 101 of them."""
    measured = seen(n=101, cuffs=("thigh", "pelvis"))
    off = np.arange(101.0)
    found = moved(measured, q=0.01 * off[:, None], v=-off[:, None])
    cuffs = dict(found.cuffs)
    cuffs["pelvis"] = replace(
        cuffs["pelvis"], normal=cuffs["pelvis"].normal - off
    )
    found = replace(found, name="found", cuffs=cuffs)
    band = Bands(
        q=np.zeros((101, 9)),
        v=np.zeros((101, 9)),
        cuffs={},
        mats={"pelvis": np.full(101, 19.5), "shank": np.ones(101)},
        seen_q=np.full((101, 9), 0.295),
        seen_v=np.full((101, 9), 9.5) + 10.0 * (np.arange(9) == 4),
        off_q=np.zeros((101, 9)),
        off_v=np.zeros((101, 9)),
        off_mats={"pelvis": np.zeros(101), "shank": np.ones(101)},
    )
    told = band.coverage(found, measured)
    assert told["trial"] == "found"
    assert list(told["angles_deg"]) == list(JOINTS)
    assert list(told["angles_deg"].values()) == near([30 / 101] * len(JOINTS))
    assert told["velocities_deg_s"]["knee"] == near(20 / 101)
    assert told["velocities_deg_s"]["hip"] == near(10 / 101)
    assert told["interaction_n"] == {"pelvis": near(20 / 101)}
    assert told["half_width_n"] == {"pelvis": near(19.5)}
    # Without encoders nobody saw the device's knee.
    blind = np.where(np.arange(9) == 7, np.inf, band.seen_q)
    told = replace(band, seen_q=blind).coverage(found, measured)
    assert set(JOINTS) - set(told["angles_deg"]) == {JOINTS[4]}
    # What is known of instruments' errors is no miss of the prediction.
    known = replace(
        band,
        off_q=measured.q - found.q,
        off_v=measured.v - found.v,
        off_mats={"pelvis": off},
    ).coverage(found, measured)
    for signal in ("angles_deg", "velocities_deg_s", "interaction_n"):
        assert set(known[signal].values()) == {1.0}


def test_coverage_is_of_time_not_of_nodes():
    """Off in the last tenth, which half of the nodes are in."""
    times = np.r_[np.linspace(0.0, 0.9, 10)[:-1], np.linspace(0.9, 1.0, 11)]
    measured = seen(n=101).sample(times)
    off = 0.15 * (times > 0.899)
    found = moved(measured, q=off[:, None])
    band = wide(found, q=0.05)
    mats = {c: 10.0 + 1e3 * off for c in band.mats}
    told = replace(band, mats=mats).coverage(found, measured)
    # Nodes at the ends stand for a whole step.
    lengths = np.r_[[0.1] * 9, 0.055, [0.01] * 10]
    inside = 0.9 / lengths.sum()
    n = len(told["angles_deg"])
    assert list(told["angles_deg"].values()) == near([inside] * n)
    width = 10.0 + 150.0 * (1.0 - inside)
    assert list(told["half_width_n"].values()) == near([width] * len(mats))


def test_a_measurement_is_looked_at_where_the_bands_are():
    measured = seen(n=201)
    found = prediction(measured)
    narrow = wide(found, q=1e-3, v=0.02)
    told = narrow.coverage(found, measured)
    assert set(told["angles_deg"].values()) == {0.0}  # 10 mrad off
    told = wide(found, q=6e-3, v=0.06).coverage(found, measured)
    assert set(told["angles_deg"].values()) == {1.0}
    assert set(told["velocities_deg_s"].values()) == {1.0}


def test_noise_for_about_a_second_is_orthonormal():
    times = np.linspace(1.0, 3.0, 4001)
    modes = module._modes(times)
    assert modes.shape == (4001, 4)  # two a second
    gram = np.trapezoid(modes[:, :, None] * modes[:, None], times, axis=0)
    np.testing.assert_allclose(gram, np.eye(4), atol=1e-9)
    crossings = (np.diff(np.sign(modes), axis=0) != 0).sum(axis=0)
    np.testing.assert_array_equal(crossings, [0, 1, 2, 3])


def test_noise_for_about_a_second_by_hand():
    """Two samples a second over two seconds: cosines of quarter turns."""
    modes = module._modes(5.0 + np.arange(5.0) / 2.0)
    c = np.sqrt(0.5)
    np.testing.assert_allclose(
        modes[:, :3],
        [[c, 1, 1], [c, c, 0], [c, 0, -1], [c, -c, 0], [c, -1, 1]],
        atol=1e-12,
    )


def test_noise_of_signals_reaches_parameters():
    """Two parameters, by sums over nodes: a force, and angles with speeds."""
    n, rng = 11, np.random.default_rng(3)
    times = np.linspace(0.0, 1.0, n)
    weights = rng.uniform(0.5, 2.0, n)
    places = np.arange(3 * n).reshape(3, n, 1)  # force, angle, speed
    force, angle, speed = (
        Tracking(places[k], np.zeros((n, 1)), sigma, role=role)
        for k, (sigma, role) in enumerate(
            ((4.0, "measured"), (0.5, "position"), (3.0, "velocity"))
        )
    )
    size = rng.uniform(1.0, 2.0, n)
    size[3] = np.inf  # not tracked there
    force.sigma = size[:, None]
    free = Tracking(places[0], np.zeros((n, 1)), 1.0, role="regulariser")
    movement = SimpleNamespace(
        grid=SimpleNamespace(times=times), tracked=[force, free, speed, angle]
    )
    for term in movement.tracked:
        term.weights = weights
    by_x = rng.normal(size=(2, 3 * n))
    scale = rng.uniform(1.0, 2.0, 3 * n)
    rows = np.full(3 * n, -1)
    rows[places[1, 0, 0]], rows[places[2, -1, 0]] = 1, 0  # given ends
    by_bounds = rng.normal(size=(2, 2))
    program = SimpleNamespace(
        rows=SimpleNamespace(row_of=lambda v: rows[v]),
        unknowns=SimpleNamespace(scale=scale),
    )
    problem = SimpleNamespace(program=SimpleNamespace(indices=lambda v: v))
    result = SimpleNamespace(problem=problem, compiled=program)
    found = list(
        module._noise(
            movement,
            result,
            SimpleNamespace(by_bounds=by_bounds),
            by_x,
            6.0,
            4,
        )
    )
    values, slopes = noise_basis(times, 6.0, 4)
    of_force = sum(
        -weights[i] / size[i] * np.outer(by_x[:, i], values[i])
        for i in range(n)
        if i != 3
    )
    of_angles = 0.5 * sum(
        -weights[i]
        * (
            np.outer(by_x[:, n + i], values[i]) / 0.5**2
            + np.outer(by_x[:, 2 * n + i], slopes[i]) / 3.0**2
        )
        for i in range(n)
    )
    of_angles += 0.5 * (
        np.outer(by_bounds[:, 1], values[0]) / scale[n]
        + np.outer(by_bounds[:, 0], slopes[-1]) / scale[3 * n - 1]
    )
    assert len(found) == 2
    np.testing.assert_allclose(found[0], of_force)
    np.testing.assert_allclose(found[1], of_angles)


def test_an_error_that_angles_share_is_one_of_their_speeds():
    """However the cost weighs it beside noise that each has of its own."""
    n, rng = 11, np.random.default_rng(5)
    times, weights = np.linspace(0.0, 1.0, n), rng.uniform(0.5, 2.0, n)
    shared = np.array([0.6, -0.6])
    own = {"position": np.array([0.5, 0.1]), "velocity": np.array([4.0, 1.0])}
    tracked, gains = [], {}
    for k, (role, sigma) in enumerate(own.items()):
        size = shared * (1.0, 8.0)[k]
        covariance = np.diag(sigma**2) + np.outer(size, size)
        d, V = np.linalg.eigh(covariance)
        rows = sigma[:, None] * (V / np.sqrt(d)) @ V.T
        term = Tracking(
            2 * n * k + np.arange(2 * n).reshape(n, 2),
            np.zeros((n, 2)),
            sigma,
            np.broadcast_to(rows, (n, 2, 2)),
            role,
        )
        term.weights = weights
        tracked.append(term)
        gains[role] = np.linalg.inv(covariance)
    problem = SimpleNamespace(program=SimpleNamespace(indices=lambda v: v))
    compiled = SimpleNamespace(
        rows=SimpleNamespace(row_of=lambda v: np.full(len(v), -1)),
        unknowns=SimpleNamespace(scale=np.ones(4 * n)),
    )
    result = SimpleNamespace(problem=problem, compiled=compiled)
    free = SimpleNamespace(by_bounds=np.zeros((3, 0)))
    by_x = rng.normal(size=(3, 4 * n))
    movement = SimpleNamespace(
        grid=SimpleNamespace(times=times), tracked=tracked
    )
    found = sum(
        part @ part.T
        for part in module._noise(movement, result, free, by_x, 6.0, 4)
    )
    values, slopes = noise_basis(times, 6.0, 4)
    place, speed = by_x.reshape(3, 2, n, 2).transpose(1, 0, 2, 3)
    to_place = place @ gains["position"] * weights[:, None]
    to_speed = speed @ gains["velocity"] * weights[:, None]
    both = np.einsum("pnd,nk->pdk", to_place, values)
    both += np.einsum("pnd,nk->pdk", to_speed, slopes)
    covariance = np.diag(own["position"] ** 2) + np.outer(shared, shared)
    expected = np.einsum("pdk,de,qek->pq", both, covariance, both)
    np.testing.assert_allclose(found, expected)


def test_a_root_of_a_covariance():
    full = np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 9.0]])
    root = module._root(full)  # singular
    np.testing.assert_allclose(root @ root.T, full, atol=1e-12)
    # Whatever the units: clocks and places beside a cuff that is bolted on.
    unit = np.array([1e-2, 2e6, 0.02, 1e-2, 40.0, 0.0])
    correlation = 0.6 + 0.4 * np.eye(6)
    covariance = correlation * np.outer(unit, unit)
    covariance[5, 5] = -1e-20  # at a bound, but for what is rounded
    root = module._root(covariance)
    np.testing.assert_allclose(root[5], 0.0, atol=1e-9)
    root = root[:5] / unit[:5, None]
    np.testing.assert_allclose(root @ root.T, correlation[:5, :5], atol=1e-9)


@pytest.fixture(scope="module")
def coarse(in_device):
    """Phase B of one trial with errors, 10 nodes a second."""
    settings = InteractionSettings(solver=Solver(10.0), errors=ErrorSizes())
    found = InteractionCalibration(
        in_device.model, in_device.trials[:1], in_device.contact, settings
    ).solve()
    assert found.success
    return found


def tangent(program, y):
    """Directions in which y may move, and curvature of the cost (dense)."""
    free = np.flatnonzero(
        np.minimum(y - program.y_lower, program.y_upper - y) > 1e-6
    )
    m, n = program.num_constraints, program.num_unknowns
    A = np.zeros((m, n))
    np.add.at(A, program.jacobian_structure, program.jacobian(y))
    g = program.constraints(y)
    held = np.minimum(g - program.g_lower, program.g_upper - g) < 1e-6
    H = np.zeros((n, n))
    np.add.at(H, program.hessian_structure, program.gauss_newton(y))
    H = H + H.T - np.diag(np.diag(H))
    Z = np.zeros((n, 0))
    inner = null_space(A[held][:, free])
    Z = np.zeros((n, inner.shape[1]))
    Z[free] = inner
    return Z, H


@pytest.mark.slow
def test_a_posterior_is_the_inverse_of_the_curvature(coarse):
    """In the directions that the constraints leave, by dense algebra.

    That of a problem in which jerk costs nothing.
    """
    problem = coarse.problem
    program = problem.compiled
    x = coarse.solution.raw_values()
    y = program.restrict(x)
    noise = replace(problem.settings.noise, jerk=1e9)
    settings = replace(problem.settings, noise=noise)
    free_jerk = InteractionCalibration(
        problem.model, problem.trials, problem.contact, settings
    )
    Z, H = tangent(free_jerk.compiled, y)
    assert np.abs(H - tangent(program, y)[1]).max() > 1e-3
    covariance_y = Z @ np.linalg.solve(Z.T @ H @ Z, Z.T)
    matrix = program.unknowns.matrix
    covariance_x = matrix @ (matrix @ covariance_y).T
    known = posterior(coarse)
    free = [p.name for p in problem.parameters if p.free]
    names = problem.errors.names
    assert list(known.names) == free + names
    assert {f"{coarse.trials[0].name}.encoder_clock"} < set(names)
    variables = np.r_[problem.variables_of(free), problem.error_variables]
    index = problem.program.indices(variables)
    np.testing.assert_allclose(known.values, x[index])
    expected = covariance_x[np.ix_(index, index)]
    sd = np.sqrt(np.diag(expected))
    assert (sd[len(free) :] > 0.0).all()
    np.testing.assert_allclose(
        np.diag(known.covariance), sd**2, rtol=2e-6, atol=1e-12
    )
    scale = np.outer(sd, sd) + 1e-30
    assert np.abs((known.covariance - expected) / scale).max() < 2e-6
    # Data can only add to what was known before.
    prior = np.sqrt(np.diag(problem.errors.prior()[1]))
    assert (sd[len(free) :] < 1.001 * prior).all()


@pytest.mark.slow
def test_bands_by_dense_algebra(in_device, coarse):
    """Every part that is not known, through the optimum's dense conditions."""
    known = posterior(coarse)
    contact = replace(coarse.contact, posterior=known)
    settings = PredictionSettings(solver=Solver(10.0))
    problem = PredictionProblem(
        in_device.model, in_device.trials[:1], contact, settings
    )
    result = problem.solve()
    assert result.success
    found = bands(result)
    program = problem.compiled
    y = program.restrict(result.solution.raw_values())
    Z, H = tangent(program, y)
    matrix = program.unknowns.matrix.toarray()
    # Answers of program variables to changes of the gradient, (n, n).
    answer = -matrix @ Z @ np.linalg.solve(Z.T @ H @ Z, Z.T) @ matrix.T
    place = problem.program.indices
    (movement,) = problem.movements
    _, prior = problem.errors.prior()
    errors = place(problem.error_variables)
    names = problem.errors.names
    parameters = [n for n in known.names if n in contact.values()]
    shared = [n for n in names if n in known.names]
    _, joint = known.of([*parameters, *shared])
    # Of what is fixed in a prediction: by differences of its optimum.
    by_fixed = fixed_answers(problem, y, parameters, Z, H, matrix)
    by_mean = -answer[:, errors] @ np.linalg.inv(prior)
    total = np.zeros((len(matrix), 0))
    columns = [names.index(n) for n in shared]
    moving = np.hstack([by_fixed, by_mean[:, columns]])
    total = np.hstack([total, moving @ module._root(joint)])
    own = [k for k, n in enumerate(names) if n not in shared]
    sizes = np.sqrt(np.diag(prior))[own]
    total = np.hstack([total, by_mean[:, own] * sizes])
    for term in movement.tracked:
        if term.role != "regulariser":
            total = np.hstack(
                [total, noise_answers(term, movement, answer, place, errors)]
            )
    sd = np.sqrt(np.sum(total**2, axis=1))
    grid = movement.grid
    for band, variables in ((found.q, grid.q), (found.v, grid.v)):
        expected = 1.959964 * sd[place(variables)]
        size = expected.max(axis=0)
        assert (np.abs(band - expected) < 0.02 * size + 1e-9).all()
    for cuff, variables in movement.cuffs.items():
        force = result.trials[0].cuffs[cuff].components
        own_sd = np.hypot(sd[place(variables)], 0.12 * force)
        off = np.abs(found.cuffs[cuff] - 1.959964 * own_sd)
        assert (off < 1e-4 * 1.96 * own_sd.max(axis=0)).all()
    # What markers show: noise of a sample, and errors of measurement, which
    # ends have in common with it.
    effects = problem.errors.effects(in_device.trials[0].sample(grid.times))
    turn = np.zeros(len(in_device.model.coordinates))
    # The foot alone turns: joints on it turn the other way.
    turn[[2, 3, 6]] = 1.0
    for shown, variables, by, term in (
        (found.seen_q, grid.q, effects.q, movement.tracked[0]),
        (found.seen_v, grid.v, effects.v, movement.tracked[1]),
    ):
        sigma = term.sigma[0]
        both = total[place(variables)] + by @ total[errors]
        expected = np.sum(both**2, axis=2) + sigma**2 + (turn * sigma[2]) ** 2
        expected = 1.959964 * np.sqrt(expected)
        size = expected.max(axis=0)
        assert (np.abs(shown - expected) < 1e-5 * size).all()
    known = result.values[errors]
    assert np.abs(known).max() > 1e-3
    np.testing.assert_allclose(found.off_q, effects.q @ known)
    np.testing.assert_allclose(found.off_v, effects.v @ known)
    # Mats: a share of the predicted force, what they show at rest, the clock.
    (mat,) = found.mats
    assert mat in in_device.trials[0].cuffs
    force = result.trials[0].cuffs[mat].normal
    own = [f"mat.{mat}.unseen", f"mat.{mat}.offset"]
    own.append(f"{in_device.trials[0].name}.mat_clock")
    own = [names.index(n) for n in own]
    by = np.column_stack(
        [-force, np.ones_like(force), -np.gradient(force, grid.times)]
    )
    variables = movement.cuffs[mat][:, 1]
    both = total[place(variables)] + by @ total[errors[own]]
    expected = np.sum(both**2, axis=1) + (0.12 * force) ** 2
    expected += settings.noise.normal_force_n**2
    expected = 1.959964 * np.sqrt(expected)
    assert (np.abs(found.mats[mat] - expected) < 1e-5 * expected.max()).all()
    np.testing.assert_allclose(found.off_mats[mat], by @ known[own])


def fixed_answers(problem, y, parameters, Z, H, matrix) -> np.ndarray:
    """Answers (n, k) to parameters of the contact that move by 1."""
    program = problem.compiled
    m = program.num_constraints
    A = np.zeros((m, len(y)))
    np.add.at(A, program.jacobian_structure, program.jacobian(y))
    g = program.constraints(y)
    held = np.minimum(g - program.g_lower, program.g_upper - g) < 1e-6
    free = np.flatnonzero(
        np.minimum(y - program.y_lower, program.y_upper - y) > 1e-6
    )
    gradient = program.gradient(y)
    multipliers = np.linalg.lstsq(
        A[held][:, free].T, -gradient[free], rcond=None
    )[0]
    index = problem.program.indices(problem.variables_of(parameters))

    def conditions(variable, step):
        program.move_fixed(variable, step)
        B = np.zeros((m, len(y)))
        np.add.at(B, program.jacobian_structure, program.jacobian(y))
        slope = program.gradient(y) + B[held].T @ multipliers
        value = program.constraints(y)[held]
        program.move_fixed(variable, -step)
        return slope, value

    columns = []
    pseudo = np.linalg.pinv(A[held][:, free])
    for variable in index:
        step = 1e-4 * program.unknowns.scale[variable]
        up, down = conditions(variable, step), conditions(variable, -step)
        slope, value = (
            (a - b) / (2.0 * step) for a, b in zip(up, down, strict=True)
        )
        dy = np.zeros(len(y))
        dy[free] = -pseudo @ value
        dy -= Z @ np.linalg.solve(Z.T @ H @ Z, Z.T @ (slope + H @ dy))
        columns.append(matrix @ dy)
    return np.array(columns).T


def noise_answers(term, movement, answer, place, errors) -> np.ndarray:
    """Answers (n, k) to the noise of a tracked signal's targets."""
    times, (n, r) = movement.grid.times, term.target.shape
    ends = np.flatnonzero(term.weights)
    if len(ends) == 2:
        shapes = np.zeros((n, 2))
        shapes[ends, [0, 1]] = 1.0  # weight of a second
    else:
        shapes = module._modes(times)
    columns = []
    for k in range(r):
        for shape in shapes.T:
            # d(cost)/dx of a target that moves by sigma times the shape.
            change = np.zeros(len(answer))
            for node in range(n):
                if not np.isfinite(term.sigma[node, k]):
                    continue
                size = term.weights[node] * shape[node] / term.sigma[node, k]
                variables = place(term.variables[node])
                np.add.at(change, variables, -size * term.rows[node, k])
                if term.effects is not None:
                    change[errors] -= size * term.effects[node, k]
            columns.append(answer @ change)
    return np.array(columns).T


def read(path) -> tuple[dict[str, np.ndarray], bool]:
    """Columns of an OpenSim file and whether it is in degrees, by hand."""
    head, _, body = path.read_text().partition("endheader\n")
    rows = [line.split() for line in body.strip().splitlines()]
    values = np.array(rows[1:], float)
    degrees = re.search(r"inDegrees=(\w+)", head)[1] == "yes"
    return dict(zip(rows[0], values.T, strict=True)), degrees


def test_a_trial_on_disk_is_in_opensims_units(tmp_path):
    trial = prediction(seen())
    write_trial(tmp_path, trial)
    for kind, values in (("coordinates", trial.q), ("speeds", trial.v)):
        found, degrees = read(tmp_path / f"rise_{kind}.sto")
        assert degrees
        np.testing.assert_allclose(found["time"], trial.times, atol=1e-9)
        assert list(found) == ["time", *NAMES.names]
        for k, name in enumerate(NAMES.names):
            unit = 1.0 if name in ("foot_x", "foot_z") else DEGREES
            np.testing.assert_allclose(
                found[name], unit * values[:, k], rtol=1e-6, atol=1e-9
            )
    ground, degrees = read(tmp_path / "rise_ground_reaction.sto")
    assert not degrees
    F = trial.ground.force
    for name, values in (
        ("ground_force_vx", F[:, 0]),
        ("ground_force_vy", F[:, 1]),  # up
        ("ground_force_vz", 0.0),
        ("ground_force_px", -trial.ground.moment / F[:, 1]),
        ("ground_force_py", 0.0),
        ("ground_torque_z", 0.0),
    ):
        np.testing.assert_allclose(ground[name], values + 0.0 * F[:, 0])
    torques, _ = read(tmp_path / "rise_torques.sto")
    for k, joint in enumerate(JOINTS):
        np.testing.assert_allclose(
            torques[f"{joint}_moment"], trial.moments[:, k]
        )
    forces, _ = read(tmp_path / "rise_interaction.sto")
    for cuff in CUFFS:
        own = trial.cuffs[cuff]
        for name, values in (
            ("tangential", own.tangential),
            ("normal", own.normal),
            ("rotation", own.moment),
        ):
            np.testing.assert_allclose(forces[f"{cuff}_{name}"], values)


def test_bands_on_disk_are_the_middle_and_the_width(tmp_path):
    trial = prediction(seen())
    late = {c: np.full(len(trial.times), 2.0) for c in CUFFS}
    found = replace(wide(trial), off_mats=late)
    write_bands(tmp_path, trial, found)
    columns, degrees = read(tmp_path / "rise_bands.sto")
    assert degrees
    for k, name in enumerate(NAMES.names):
        unit = 1.0 if k < 2 else DEGREES
        for suffix, middle, width in (
            ("", trial.q[:, k], 0.1),
            ("_speed", trial.v[:, k], 1.0),
        ):
            for end, sign in (("lower", -1.0), ("upper", 1.0)):
                np.testing.assert_allclose(
                    columns[f"{name}{suffix}_{end}"],
                    unit * (middle + sign * width),
                    rtol=1e-6,
                    atol=1e-9,
                )
    for cuff in CUFFS:
        for i, (component, width) in enumerate(
            (("tangential", 1.0), ("normal", 5.0), ("rotation", 0.1))
        ):
            middle = trial.cuffs[cuff].components[:, i]
            low = columns[f"{cuff}_{component}_lower"]
            np.testing.assert_allclose(low, middle - width, atol=1e-9)
    for cuff, width in found.mats.items():
        shown = trial.cuffs[cuff].normal + 2.0
        for end, sign in (("lower", -1.0), ("upper", 1.0)):
            np.testing.assert_allclose(
                columns[f"{cuff}_mats_{end}"], shown + sign * width, rtol=1e-6
            )
    assert f"{CUFFS[2]}_mats_lower" not in columns


def test_coverage_follows_from_the_files(tmp_path):
    """Bands on disk are those of `Bands.coverage`, also of joints."""
    trial, blind = prediction(seen()), NAMES.index("exo_knee")
    band = wide(trial, q=0.03, v=0.2)
    some = np.linspace(0.0, 1.0, len(trial.times))[:, None]
    band.seen_q[:, blind] = band.seen_v[:, blind] = np.inf
    band = replace(band, off_q=0.111 * some, off_v=-0.777 * some)
    write_bands(tmp_path, trial, band)
    columns, _ = read(tmp_path / "rise_bands.sto")
    measured = moved(trial, q=0.011, v=-0.013)
    told = band.coverage(trial, measured)
    for suffix, signal, shown in (
        ("reading", "angles_deg", measured.q),
        ("speed_reading", "velocities_deg_s", measured.v),
    ):
        assert len(told[signal]) == len(JOINTS) - 1
        for joint, share in told[signal].items():
            at = DEGREES * shown[:, NAMES.index(joint)]
            low, high = (
                columns[f"{joint}_{suffix}_{end}"] for end in ("lower", "upper")
            )
            assert 0.0 < share < 1.0
            assert share == near(np.mean((low <= at) & (at <= high)))
        assert f"exo_knee_{suffix}_lower" not in columns


@pytest.mark.slow
def test_a_summary_holds_parameters_with_their_bounds(coarse):
    problem = coarse.problem
    study = dx.Study(problem.model, problem.trials, name="me")

    def summary_of(phase):
        found = dx.Calibration("interaction", study, coarse)
        # Audits would be simulated.
        vars(found).update(phase=phase, _audits=())
        return found.summary()

    summary = summary_of("interaction")
    assert (summary["phase"], summary["subject"]) == ("interaction", "me")
    assert summary["success"] is True
    assert summary["iterations"] == coarse.solution.iterations
    told = {p["name"]: p for p in summary["parameters"]}
    for p in coarse.problem.parameters:
        own = told[p.name]
        assert (own["lower"], own["upper"]) == (p.lower, p.upper)
        assert (own["unit"], own["free"]) == (p.unit, p.free)
        index = coarse.problem.program.indices(
            coarse.problem.variables_of([p.name])
        )
        value = coarse.solution.raw_values()[index[0]]
        assert own["value"] == pytest.approx(value, rel=1e-6)
    assert summary["rmsd"][0]["moments_nm"]
    alone = summary_of("foot-ground")
    assert not alone["rmsd"][0]["moments_nm"]


def test_intervals_are_two_sigma_with_the_pull():
    found = Uncertainty(
        ["a", "b", "c"],
        np.array([[9.0, 3.0, 0.0], [3.0, 4.0, 0.0], [0.0, 0.0, 1.0]]),
        pull=np.array([4.0, 0.0, 0.0]),
        prior_sd=np.array([6.1, 4.0, 9.0]),
        at_bound=np.array([False, False, True]),
    )
    np.testing.assert_allclose(found.sd, [3.0, 2.0, np.nan])
    np.testing.assert_allclose(
        found.half_width, [1.959964 * 5.0, 1.959964 * 2.0, np.nan]
    )
    assert pytest.approx(1.959963985) == QUANTILE_95
    np.testing.assert_array_equal(found.identifiable, [True, False, False])
    # A stiffness of 9.7 ± 9.8 N/m is unknown.
    for size, known in ((9.9, True), (9.7, False)):
        own = replace(found, size=np.array([size, np.inf, np.inf]))
        assert own.identifiable[0] == known


def test_noise_of_a_filter_has_its_spectrum():
    """Variance 1; half of the power's amplitude gone at the cut-off."""
    times = np.linspace(0.0, 2.0, 101)
    values, slopes = noise_basis(times, 6.0, 4)
    np.testing.assert_allclose((values**2).sum(axis=1), 1.0)
    k = values.shape[1] // 2
    amplitude = np.hypot(values[0, :k], values[0, k:])
    rate = np.hypot(slopes[0, :k], slopes[0, k:])
    frequency = rate / amplitude / (2.0 * np.pi)
    np.testing.assert_allclose(np.diff(frequency), 0.125)
    gain = (
        amplitude
        / amplitude[0]
        * (1.0 + (np.sqrt(2.0) - 1.0) * (frequency[0] / 6.0) ** 4) ** -1
    )
    expected = 1.0 / (1.0 + (np.sqrt(2.0) - 1.0) * (frequency / 6.0) ** 4)
    np.testing.assert_allclose(gain, expected)
    assert frequency[-1] == pytest.approx(18.0, abs=0.13)
    # The second is the derivative of the first.
    h = times[1] - times[0]
    smooth = np.gradient(values[:, 0], h)[1:-1]
    np.testing.assert_allclose(smooth, slopes[1:-1, 0], atol=2e-6)


@pytest.mark.slow
def test_what_a_springs_angle_is_unsure_of_is_in_the_bands():
    """Half a degree of an encoder's zero is a torque across a stiff joint."""
    made = rises_in_device(1, nodes_per_second=20)
    (trial,) = made.trials
    names = made.model.coordinates.device
    errors = replace(NO_ERRORS, encoder_offset_deg=2.0)
    zero, sd = names.index("exo_knee"), np.deg2rad(0.5)

    def forces(source, mean, unsure):
        """Of the shank's cuff, and variance of them by the band."""
        said = {"moments": {"exoskeleton": source}}
        study = dx.Study(made.model, made.trials)
        study.device = Device(knee=JointDrive(stiffness_nm_rad=100.0))
        study.prediction = PredictionSettings(errors=errors)
        means, variances = np.zeros(len(names)), np.full(len(names), 1e-12)
        means[zero], variances[zero] = mean, unsure**2
        found = dx.predict(
            study,
            replace(trial, provenance=trial.provenance | said),
            replace(
                made.contact,
                posterior=Posterior(
                    tuple(f"encoder.{n}" for n in names),
                    means,
                    np.diag(variances),
                ),
            ),
        )
        band = found.bands().cuffs["shank"][:, 1] / QUANTILE_95
        return found.cuffs["shank"].normal, band**2

    for source, least in (("recorded", 1.4), ("device model", 0.0)):
        sure, known = forces(source, 0.0, 1e-6)
        _, unsure = forces(source, 0.0, sd)
        moved, _ = forces(source, sd, 1e-6)
        more = np.sqrt(np.maximum(unsure - known, 0.0)).mean()
        assert least < more < 1.2 * np.abs(moved - sure).mean()
