"""Finite strain: a neo-Hookean sole in contact, compared with small strain.

Linear tetrahedra, total Lagrangian (Bonet and Wood, Nonlinear Continuum
Mechanics for Finite Element Analysis, 2nd ed., chapter 6). F = I + Σ u_a g_aᵀ,
ĝ = F⁻ᵀ g, energy W of docs/soles.md with Lamé's constants λ and μ:

    P = μ (F − F⁻ᵀ) + λ ln J F⁻ᵀ
    K_ab = V [μ g_a·g_b I + (μ − λ ln J) ĝ_b ĝ_aᵀ + λ ĝ_a ĝ_bᵀ]

The node law F = T(τ), τ = F − r δ is solved in τ: a contact node lies at
P = Q + (T(τ) − τ)/r, so that the law holds exactly at every iterate. Unknowns
are the interior displacements, τ and the pose; the equations are

    f_int(u) − Eᵀ Rᵀ F = 0,  Σ F = F_des,  Σ (P − Z_des) × F = 0.

With D̂ = Rᵀ (∂T/∂τ) R and dτ = r R ζ: du = (D̂ − I) ζ and dF = r D̂ ζ at fixed
pose, in the sole frame; a pose increment adds Rᵀ(−dzO + hat(P − Z) dω) to du.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.sparse import bsr_matrix, csc_matrix
from scipy.sparse.linalg import splu

from drake_exo.errors import InputError, check_type
from drake_exo.files.output import write_csv, write_text
from drake_exo.soles.contact.law import (
    FLAT,
    ContactLaw,
    Ground,
    at_rest,
    project,
    project_with_derivative,
)
from drake_exo.soles.contact.newton import (
    ContactSolver,
    Convergence,
    Start,
    State,
    Target,
    capped,
    line_search,
    newton,
    wrench_size,
)
from drake_exo.soles.elasticity import Material, Sole, node_dofs
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.numerics import exp_rotation, hat, tilt_deg
from drake_exo.soles.settings import Setup
from drake_exo.soles.simulation import (
    StepHistory,
    first_step,
    lead,
    sample_weights,
    sigma_max_translation,
    sigma_min_rotation,
    simulate,
    stability,
)


def first_stress(F: np.ndarray, material: Material) -> np.ndarray:
    """First Piola–Kirchhoff stress P = ∂W/∂F [Pa], (..., 3, 3)."""
    inverse = np.swapaxes(np.linalg.inv(F), -1, -2)
    log_J = np.log(np.linalg.det(F))[..., None, None]
    shear, lam = material.shear_modulus, material.lame_lambda
    return shear * (F - inverse) + lam * log_J * inverse


class NeoHookeanBody:
    """Internal forces and tangent stiffness of a meshed sole, its top fixed."""

    def __init__(self, mesh: TetMesh, material: Material):
        self.mesh, self.material = mesh, material

    @cached_property
    def free(self) -> np.ndarray:
        """Nodes that are not fixed, sorted."""
        every = np.arange(len(self.mesh.nodes))
        return np.setdiff1d(every, self.mesh.fixed)

    def deformation_gradient(self, u: np.ndarray) -> np.ndarray:
        """Deformation gradients F (e, 3, 3) of displacements u [m] (n, 3)."""
        mesh = self.mesh
        H = np.swapaxes(u[mesh.tets], 1, 2) @ mesh.gradients
        return np.eye(3) + H

    def internal_force(self, u: np.ndarray) -> np.ndarray:
        """Σ_e V P g_a at every node [N], (n, 3).

        Entries are NaN where an element is inverted.
        """
        F = self.deformation_gradient(u)
        mesh = self.mesh
        if (np.real(np.linalg.det(F)) <= 0).any():
            return np.full((len(mesh.nodes), 3), np.nan)
        P = first_stress(F, self.material)
        local = mesh.volumes[:, None, None] * (
            mesh.gradients @ np.swapaxes(P, 1, 2)
        )
        out = np.zeros((len(mesh.nodes), 3), dtype=local.dtype)
        np.add.at(out, mesh.tets.ravel(), local.reshape(-1, 3))
        return out

    def element_tangents(self, u: np.ndarray) -> np.ndarray:
        """Tangent stiffness of every element [N/m], (e, 4, 3, 4, 3)."""
        F = self.deformation_gradient(u)
        g, V = self.mesh.gradients, self.mesh.volumes
        pushed = g @ np.linalg.inv(F)
        log_J = np.log(np.linalg.det(F))
        shear, lam = self.material.shear_modulus, self.material.lame_lambda
        outer = np.einsum("eai,ebj->eaibj", pushed, pushed)
        K = lam * outer
        second = (shear - lam * log_J)[:, None, None, None, None]
        K += second * outer.transpose(0, 1, 4, 3, 2)
        gg = shear * np.einsum("eai,ebi->eab", g, g)
        for i in range(3):
            K[:, :, i, :, i] += gg
        K *= V[:, None, None, None, None]
        return K

    def tangent(self, u: np.ndarray) -> csc_matrix:
        """Tangent stiffness of the free dofs [N/m], sparse symmetric."""
        inside, place, rows, begins = self._entries
        values = self.element_tangents(u).reshape(-1, 144)[inside]
        return csc_matrix((np.bincount(place, values), rows, begins))

    @cached_property
    def _entries(self):
        """Element entries of free dofs, their places in K; CSC rows and begins.

        Summing them in SciPy would take longer than all else of a tangent.
        """
        number, size = np.full(len(self.mesh.nodes), -1), 3 * len(self.free)
        number[self.free] = np.arange(len(self.free))
        dofs = node_dofs(number[self.mesh.tets.ravel()]).reshape(-1, 12)
        rows, cols = np.repeat(dofs, 12, axis=1), np.tile(dofs, (1, 12))
        inside = (rows >= 0) & (cols >= 0)
        key, place = np.unique(
            size * cols[inside] + rows[inside], return_inverse=True
        )
        begins = np.searchsorted(key, size * np.arange(size + 1))
        return inside, place, key % size, begins


_MAX_TURN, _MAX_SHIFT = 0.1, 0.005  # caps on one Newton step: rad, m
_HALVINGS, _MOST_STEPS = 8, 25


@dataclass
class FiniteState(State):
    """State with the displacements u of all nodes, sole frame [m], (n, 3)."""

    u: np.ndarray


class FiniteStrainSolver:
    """Newton solver for one neo-Hookean sole and one contact law.

    `tolerance` is the largest unbalanced force, nodal or whole, over |F_des|.
    """

    def __init__(
        self,
        body: NeoHookeanBody,
        law: ContactLaw,
        tolerance: float = 1e-9,
        ground: Ground = FLAT,
    ):
        self.body, self.law, self.ground = body, law, ground
        self.tolerance = tolerance
        self.nodes = body.mesh.contact
        self.rest = body.mesh.nodes[self.nodes]
        self._blocks = np.searchsorted(body.free, self.nodes)
        self._rows = node_dofs(self._blocks)

    def places(self, state: FiniteState) -> np.ndarray:
        """World places of the contact nodes [m], (m, 3)."""
        return state.O + (self.rest + state.u[self.nodes]) @ state.R.T

    def solve(
        self, state: FiniteState, target: Target
    ) -> tuple[FiniteState, Convergence]:
        """Solve from `state`, which is not changed; last state and report."""
        state = state.copy()
        state.O, state.R = target.turned(state.O, state.R)
        scale = max(float(np.linalg.norm(target.force)), 1e-12)

        def improved(point):
            if not np.isfinite(point.merit):
                raise np.linalg.LinAlgError("inverted elements at the start")
            R, Z, old = point.state.R, target.point, point.state
            # Turns of the planes' axes are left out of the Newton matrix.
            turn = target.turn(self.ground, R, self.rest)
            try:
                lin = _Linearisation(self, point, turn.places if turn else 0.0)
                du, zeta, dp = lin.newton_step(target.asked)
            except (np.linalg.LinAlgError, RuntimeError):
                raise np.linalg.LinAlgError("singular Newton matrix") from None
            d_tau = self.law.penalty * zeta @ R.T

            def trial(size):
                turn = exp_rotation(size * dp[3:])
                u = old.u.copy()
                u[self.body.free] += size * du
                O = Z + turn @ (old.O - Z) + size * dp[:3]  # noqa: E741
                guess = FiniteState(old.F, O, turn @ R, u)
                tau = point.tau + size * d_tau
                return self._evaluate(tau, guess, target, scale)

            step = capped(dp, _MAX_TURN, _MAX_SHIFT)
            return line_search(point, trial, step, _HALVINGS)

        point, report = newton(
            self._evaluate(self._tau(state, target), state, target, scale),
            improved, self.tolerance, _MOST_STEPS,
        )  # fmt: skip
        return point.state, report

    def cartesian_stiffness(
        self, state: FiniteState, target: Target
    ) -> np.ndarray:
        """K_c (6, 6) about the ZMP at a solution, references frozen."""
        target = target.about_own_zmp(state.F, self.places(state), self.ground)
        before = target.places_before(state.R, self.rest)
        frozen = replace(target, reference=before)
        point = self._evaluate(self._tau(state, frozen), state, frozen, 1.0)
        point.tau = _in_planes(
            point.axes,
            point.tau,
            lambda tau: at_rest(tau, self.law, target.force),
        )
        return _Linearisation(self, point, 0.0).wrench_response()

    def _tau(self, state, target) -> np.ndarray:
        Q, _ = self.ground.planes(target.places_before(state.R, self.rest))
        return state.F - self.law.penalty * (self.places(state) - Q)

    def _evaluate(self, tau, guess, target, scale) -> "_Point":
        """Residuals at τ (m, 3), which gives forces and contact places."""
        O, R = guess.O, guess.R  # noqa: E741
        Q, axes = self.ground.planes(target.places_before(R, self.rest))
        F = _in_planes(axes, tau, lambda tau: project(tau, self.law))
        P = Q + (F - tau) / self.law.penalty
        u = guess.u.copy()
        u[self.nodes] = (P - O) @ R - self.rest
        internal = self.body.internal_force(u)
        balance = internal[self.body.free]
        balance[self._blocks] -= F @ R
        arm = P - target.point
        wrench = np.concatenate([F.sum(axis=0), np.cross(arm, F).sum(axis=0)])
        wrench = target.missed(wrench)
        merit = np.inf
        if np.isfinite(balance).all():
            merit = max(float(np.abs(balance).max()), wrench_size(wrench))
        state = FiniteState(F, O, R, u)
        return _Point(state, tau, axes, arm, balance, wrench, merit / scale)


def _in_planes(axes, tau, made):
    """Apply `made` to τ (m, 3) in planes' axes; the result in the world's."""
    there = made(np.einsum("kij,kj->ki", axes, tau))
    return np.einsum("kji,kj->ki", axes, there)


@dataclass
class _Point:
    """An iterate with its residuals; `balance` is of free nodes [N]."""

    state: FiniteState
    tau: np.ndarray
    axes: np.ndarray
    arm: np.ndarray
    balance: np.ndarray
    wrench: np.ndarray
    merit: float


class _Linearisation:
    """Newton matrix at an iterate; all unknowns but the pose are eliminated."""

    def __init__(self, solver: FiniteStrainSolver, point: _Point, dQ):
        self.solver, self.point = solver, point
        self.R, self.dQ = point.state.R, dQ
        tau = np.einsum("kij,kj->ki", point.axes, point.tau)
        turn = point.axes @ self.R
        _, D = project_with_derivative(tau, solver.law)
        self.D = turn.transpose(0, 2, 1) @ D @ turn
        K = solver.body.tangent(point.state.u)
        r = solver.law.penalty
        count = len(solver.body.free)
        node = np.tile(np.eye(3), (count, 1, 1))
        node[solver._blocks] = self.D - np.eye(3)
        force = np.zeros((count, 3, 3))
        force[solver._blocks] = r * self.D
        A = K @ _block_diagonal(node) - _block_diagonal(force)
        self._lu = splu(
            A.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.05,
            options={"SymmetricMode": True},
        )
        self._pose = self._response_to_pose(K)

    def _response_to_pose(self, K):
        """ζ and interior du (3 n_f, 6) for unit pose increments."""
        s, m = self.solver, len(self.solver.nodes)
        shift = np.zeros((m, 3, 6))
        shift[:, :, :3] = -np.eye(3)
        shift[:, :, 3:] = hat(self.point.arm)
        shift[:, :, 3:] += self.dQ
        rhs = K[:, s._rows] @ (self.R.T @ shift).reshape(3 * m, 6)
        turned = self.R.T @ hat(self.point.state.F)
        rhs[s._rows, 3:] -= turned.reshape(3 * m, 3)
        return self._lu.solve(-rhs)

    def _wrench_change(self, x, with_pose: bool) -> np.ndarray:
        zeta = x[self.solver._rows].reshape(-1, 3, x.shape[1])
        F, arm = self.point.state.F, self.point.arm
        dF = self.solver.law.penalty * self.R @ (self.D @ zeta)
        dP = self.R @ (self.D @ zeta - zeta)
        if with_pose:
            dP[:, :, 3:] += self.dQ
        moment = np.einsum("kij,kjc->ic", hat(arm), dF)
        moment -= np.einsum("kij,kjc->ic", hat(F), dP)
        return np.concatenate([dF.sum(axis=0), moment])

    def wrench_response(self) -> np.ndarray:
        """[dF; dΓ_Z] for unit pose increments (dzO, dω), (6, 6)."""
        return self._wrench_change(self._pose, True)

    def newton_step(self, asked):
        """Newton step: interior du (n_f, 3), ζ (m, 3), dp (6,) as `asked`."""
        x = self._lu.solve(-self.point.balance.reshape(-1, 1))
        carried = self._wrench_change(x, False)[:, 0]
        dp, G = np.zeros(6), self.wrench_response()[np.ix_(asked, asked)]
        lacking = self.point.wrench + carried
        dp[asked] = np.linalg.solve(G, -lacking[asked])
        if not np.isfinite(dp).all():
            raise np.linalg.LinAlgError
        x = x[:, 0] + self._pose @ dp
        return x.reshape(-1, 3), x[self.solver._rows].reshape(-1, 3), dp


def _block_diagonal(blocks: np.ndarray):
    """Sparse matrix with 3 × 3 blocks (k, 3, 3) on its diagonal."""
    k = len(blocks)
    return bsr_matrix((blocks, np.arange(k), np.arange(k + 1))).tocsc()


# Parts of the first sample's load at which a small-strain start is tried.
_ENTRIES = (1.0, 0.5, 0.25, 0.1, 0.04)


@dataclass
class FiniteHistory:
    """States over N samples; a failed one keeps the last equilibrium found.

    Attributes:
        states: State of every sample, None if there is none.
        K_c: Cartesian stiffness about the ZMP, NaN where failed, (N, 6, 6).
        reports: Convergence of every sample. `reached` is the part of the way
            from the sample before (at first, from no load) for which an
            equilibrium was found; 1 if converged.
    """

    states: list[FiniteState | None]
    K_c: np.ndarray
    reports: list[Convergence]

    @property
    def converged(self) -> np.ndarray:
        """Which samples converged, (N,)."""
        return np.isfinite(self.K_c).all(axis=(1, 2))


def follow(
    sole: Sole,
    law: ContactLaw,
    load: Load,
    start: Start,
    entry: State | None = None,
    say: Callable[[str], object] | None = None,
    ground: Ground = FLAT,
) -> FiniteHistory:
    """Solve for force and ZMP sample by sample, in finite strain.

    The first sample starts from the small-strain solution (`entry`, if known),
    if need be at a part of its load; the others from the sample before, in
    smaller parts if Newton fails. After a sample without equilibrium the rest
    is left out: contact depends on its history. `say` gets a line for each.
    """
    body = NeoHookeanBody(sole.mesh, sole.material)
    solver = FiniteStrainSolver(body, law, ground=ground)
    count = len(load.times)
    out = Convergence(False, 0, np.inf, "left out after a failure")
    history = FiniteHistory(
        [None] * count, np.full((count, 6, 6), np.nan), [out] * count
    )  # fmt: skip
    for q in range(count):
        if q in load.begins:
            target = load.target(q, start, ground)
            state, report = _enter(
                sole, solver, target, load.largest_force, None if q else entry
            )
        else:
            reference = solver.places(state)
            target = load.target(q, reference, ground)
            before = load.target(q - 1, reference, ground)
            state, report = lead(solver, state, before, target)
        history.states[q], history.reports[q] = state, report
        if not report.converged:
            break
        history.K_c[q] = solver.cartesian_stiffness(state, target)
        if say is not None:
            say(f"finite strain, {q + 1} of {count} samples")
    return history


def _enter(sole, solver, target: Target, largest: float, known: State | None):
    """Solve a first sample from small strain; state and report."""
    small = ContactSolver.of(sole, solver.law, ground=solver.ground)
    best = None
    for part in _ENTRIES:
        aim = replace(
            target, force=part * target.force, moment=part * target.moment
        )
        found = None
        guess = known if part == 1.0 else None
        if guess is None:
            guess, report = first_step(small, aim, part * largest)
            report.reached = 0.0  # in finite strain
        if guess is not None:
            u = sole.displacement(guess.F @ guess.R)
            state = FiniteState(guess.F, guess.O, guess.R, u)
            state, report = solver.solve(state, aim)
            if report.converged:
                found, report = lead(solver, state, aim, target)
                report.reached = part + report.reached * (1.0 - part)
        if report.converged:
            return found, report
        if best is None or report.reached > best[1].reached:
            best = found, report
    return best


_FIGURES = (
    "sigma_max_tr_n_per_m",
    "sigma_min_rot_nm_per_rad",
    "stability_n_per_m",
    "tilt_deg",
    "largest_stretch",
    "least_stretch",
)
_KINDS = ("small", "finite")
TABLE = "finite_strain.csv"


def compare_strains(
    setup: Setup, say: Callable[[str], object] | None = None
) -> dict:
    """Simulate heel strike in small and in finite strain, by the exact law.

    >>> import drake_exo as dx
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> found = dx.soles.compare_strains(case)
    >>> found["converged_samples"], found["heel_strike_samples"]
    (1, 1)
    >>> print(f"{found['c_tr_finite'] / found['c_tr_small']:.2f}")
    1.02

    Both use linear elements, whatever the case's: finite strain has no others.

    Args:
        setup: A sole and its step.
        say: Called with one line of progress now and then.

    Returns:
        c_tr in both kinds of strain, the number of samples converged, and
        `samples`: the figures of both at the first, middle and last sample of
        heel strike, numbered as in the load (1, 11 and 21 of the paper's 21),
        NaN where there is no equilibrium.

    Raises:
        InputError: `setup` is no case.
    """
    check_type(setup, Setup, "setup")
    mesh = setup.mesh.touching_everywhere()
    sole = Sole(mesh, setup.settings.material.material(), "linear")
    load, start = setup.load, setup.start
    cost = setup.settings.cost
    *_, by_tr, _ = sample_weights(load, cost.heel_strike_fraction)
    rows = np.flatnonzero(by_tr)
    strike, weights = load.at(rows), by_tr[rows]
    count = len(strike.times)
    law = setup.law(sole)
    small = simulate(
        ContactSolver.of(sole, law, ground=setup.ground),
        strike,
        start,
        largest_force=load.largest_force,
    )
    entry = small.state(0) if small.converged[0] else None
    finite = follow(sole, law, strike, start, entry, say, setup.ground)
    return {
        "heel_strike_samples": count,
        "converged_samples": int(finite.converged.sum()),
        "c_tr_small": float(weights @ sigma_max_translation(small.K_c)),
        "c_tr_finite": float(weights @ sigma_max_translation(finite.K_c)),
        "samples": [
            {
                "sample": int(rows[q] + 1),
                **_sample(sole, small, finite, q, setup.up),
            }
            for q in np.unique([0, count // 2, count - 1])
        ],
        "failures": _failures(finite, rows),
    }


def from_json(found: dict, name: Path | str) -> dict:
    """What `compare_strains` returned, as read from a file: null becomes NaN.

    Raises:
        InputError: It is damaged; names the file.
    """

    def numbers(row: dict) -> dict:
        return {k: np.nan if v is None else v for k, v in row.items()}

    try:
        sole = numbers(found)
        sole["samples"] = [numbers(row) for row in found["samples"]]
        for written in (table, _columns):  # they fail on damaged entries
            written({"": sole})
    except (AttributeError, LookupError, TypeError, ValueError):
        raise InputError(
            f"{name}: finite_strain is damaged; run drake-exo sole strain again"
        ) from None
    return sole


def _failures(finite: FiniteHistory, rows: np.ndarray) -> list[dict]:
    return [
        {
            "sample": int(rows[q] + 1),
            "reached": finite.reports[q].reached,
            "message": finite.reports[q].message,
        }
        for q in np.flatnonzero(~finite.converged)
    ]


def _sample(
    sole: Sole, small: StepHistory, finite: FiniteHistory, q: int, up
) -> dict:
    """Figures of sample q in both strains, NaN without an equilibrium.

    `up` is the normal of the plane that fits the ground, (3,).
    """
    row = {
        "converged": bool(finite.converged[q]),
        "reached": float(finite.reports[q].reached),
    }
    shapes = {"small": 3 * [np.nan], "finite": 3 * [np.nan]}
    if small.converged[q]:
        R = small.R[q]
        eps = np.linalg.eigvalsh(sole.strain(sole.displacement(small.F[q] @ R)))
        shapes["small"] = [tilt_deg(R, up), 1 + eps.max(), 1 + eps.min()]
    if finite.converged[q]:
        state = finite.states[q]
        F = NeoHookeanBody(sole.mesh, sole.material).deformation_gradient(
            state.u
        )
        values = np.linalg.svd(F, compute_uv=False)
        shapes["finite"] = [tilt_deg(state.R, up), values.max(), values.min()]
    for kind, K_c in zip(_KINDS, (small.K_c[q], finite.K_c[q]), strict=True):
        values = (
            sigma_max_translation(K_c),
            sigma_min_rotation(K_c),
            stability(K_c),
            *shapes[kind],
        )
        row |= {
            f"{name}_{kind}": float(value)
            for name, value in zip(_FIGURES, values, strict=True)
        }
    return row


def table(found: dict[str, dict]) -> str:
    """Text table of soles by name, small beside finite strain."""
    head = (
        f"{'sole':11s} {'sample':>6s} {'σ_max(K_tr) [N/m]':>21s} "
        f"{'σ_min(K_rot) [N·m/rad]':>22s} {'tilt [°]':>13s} "
        f"{'largest stretch':>15s} {'least stretch':>15s}"
    )
    widths = (10, 10, 6, 7, 7)
    under = " " * 18 + "".join(
        f" {'small':>{w}s} {'finite':>{w}s}" for w in widths
    )
    lines = [head, under, "-" * len(head)]
    for name, sole in found.items():
        lines += [_line(name, row) for row in sole["samples"]]
        lines += [*(f"{'':11s} {said}" for said in _remarks(sole)), ""]
    return "\n".join(lines).rstrip()


def _line(name: str, row: dict) -> str:
    forms = ("10.3g", "10.3g", "6.1f", "7.3f", "7.3f")
    figures = [figure for figure in _FIGURES if figure != "stability_n_per_m"]
    numbers = [
        f"{row[f'{figure}_{kind}']:{form}}"
        for figure, form in zip(figures, forms, strict=True)
        for kind in _KINDS
    ]
    return " ".join([f"{name:11s} {row['sample']:6d}", *numbers])


def _remarks(sole: dict) -> list[str]:
    rows = sole["samples"]
    said = [
        f"c_tr {sole['c_tr_small']:.3g} in small, {sole['c_tr_finite']:.3g} in "
        "finite strain"
    ]
    if sole["failures"]:
        first = sole["failures"][0]
        said = [
            f"finite strain: {sole['converged_samples']} of "
            f"{sole['heel_strike_samples']} samples have an equilibrium; "
            f"sample {first['sample']}: {first['message']}"
        ]
    loose = [
        str(r["sample"]) for r in rows if r["stability_n_per_m_finite"] <= 0
    ]
    if loose:
        said.append(f"finite strain: not stable at sample {', '.join(loose)}")
    if any(r["least_stretch_small"] <= 0 for r in rows):
        said.append(
            "small strain turns elements inside out (least stretch below 0): "
            "its figures do not hold here"
        )
    return said


def write_table(folder: Path, found: dict[str, dict], mark: str = "") -> str:
    """Write finite_strain.txt (with a verdict's mark) and .csv; its text."""
    text = table(found)
    write_text(folder / "finite_strain.txt", text, mark)
    write_csv(folder / TABLE, _columns(found))
    return text


def _columns(found: dict[str, dict]) -> dict[str, list]:
    rows = [
        {"sole": name} | row
        for name, sole in found.items()
        for row in sole["samples"]
    ]
    # Rows that are read from JSON have the alphabet's order.
    figures = [f"{figure}_{kind}" for kind in _KINDS for figure in _FIGURES]
    order = ["sole", "sample", "converged", "reached", *figures]
    keys = sorted(rows[0], key=order.index)
    return {key: [row[key] for row in rows] for key in keys}
