"""Uncertainty of parameters and predictions: intervals and bands of 95 %.

Noise is split into independent parts of unit variance, each of which moves the
optimum to first order (`nlp.sensitivity`); see docs/method.md. It has the
spectrum of the study's filter; noise of velocities is the derivative of that of
positions. The prior counts as a measurement of the nominal value. Cost terms
that track nothing (energy, jerk) add no noise, but pull parameters away from
the data. `contact_sensitivity`: what the data determine (Van den Hof, II-C).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from drake_exo.calibration.problem import (
    PhaseProblem,
    PhaseResult,
    has_encoders,
    kinematic_terms,
    shared_noise,
)
from drake_exo.collocation.kernels import WRENCH_UNITS
from drake_exo.collocation.transcription import stands_for
from drake_exo.collocation.trial_program import (
    LogKernel,
    Tracking,
    TrialProgram,
)
from drake_exo.contact.bushing import NORMAL
from drake_exo.contact.parameters import ContactParameter, Posterior
from drake_exo.measurement.trial import Trial
from drake_exo.nlp.sensitivity import Optimum, Response, response
from drake_exo.nlp.sparse import SparseProgram

QUANTILE_95 = 1.959964
# Of an identifiable parameter the standard deviation is below this share of its
# prior's; without a prior, of a quarter of its range.
_IDENTIFIABLE = 0.5
_LAW_SHARE, _LAW_ORIGIN_M = 0.25, 0.01  # see `_law`
_FREQUENCIES_PER_CYCLE = 4  # spacing of frequencies: a quarter of 1/duration
_HIGHEST = 3.0  # highest frequency, as a multiple of the cut-off


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of free parameters at an optimum, in their own units.

    Attributes:
        names: (m,) as in `ContactModel.values`.
        covariance: (m, m) by noise and prior.
        pull: (m,) shift by cost terms that track no measurement.
        prior_sd: (m,) sd of the prior, at most a quarter of the range.
        at_bound: (m,) bool; nothing else is known of a parameter at a bound.
        law: (m,) standard deviation because a real cuff is not a bushing.
        size: (m,) value of what is never negative, such as a stiffness; inf of
            others.

    >>> one = np.eye(1)
    >>> known = Uncertainty(
    ...     ["heel.x"], 1e-6 * one, 0 * one[0], one[0], one[0] < 0)
    >>> known
    Uncertainty(heel.x ± 0.00196)
    >>> dict(zip(known.names, known.half_width.round(5)))
    {'heel.x': np.float64(0.00196)}
    """

    names: list[str]
    covariance: np.ndarray
    pull: np.ndarray
    prior_sd: np.ndarray
    at_bound: np.ndarray
    law: np.ndarray | float = 0.0
    size: np.ndarray | float = np.inf

    def __repr__(self) -> str:
        # Without the arrays: a notebook prints this for its last line.
        rows = zip(self.names, self.half_width, self.at_bound, strict=True)
        told = (
            f"{name} at a bound" if held else f"{name} ± {width:.3g}"
            for name, width, held in rows
        )
        return f"Uncertainty({', '.join(told)})"

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations (m,); NaN at a bound."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.where(self.at_bound, np.nan, sd)

    @property
    def half_width(self) -> np.ndarray:
        """Half of each 95 % interval (m,), pull and law included."""
        own = np.hypot(self.sd, self.pull)
        # The law's share never widens an interval beyond the prior's.
        both = np.minimum(np.hypot(own, self.law), self.prior_sd)
        return QUANTILE_95 * np.maximum(own, both)

    @property
    def identifiable(self) -> np.ndarray:
        """Whether the data determine each (m,).

        Its sd is less than half of the prior's, and of what is never negative
        the interval does not reach zero.
        """
        off = np.hypot(self.sd, self.law)
        contracted = off < _IDENTIFIABLE * self.prior_sd
        return contracted & (self.half_width < self.size)


def uncertainty(
    result: PhaseResult, cutoff_hz: float = 6.0, order: int = 4
) -> Uncertainty | None:
    """Covariance of the free parameters of a calibration.

    Args:
        result: of a problem with its collocation constraints substituted.
        cutoff_hz, order: of the filter that was applied to the signals.

    Returns:
        None if no parameter is free, or the collocation constraints were kept
        (`reduce: false`): given end states are then not rows of the problem.
    """
    problem = result.problem
    free = _free(result)
    if not free or not problem.settings.solver.reduce:
        return None
    program = result.compiled
    y = program.restrict(result.values)
    index = problem.program.indices(problem.parameter_variables[free])
    columns = program.unknowns.column_of(index)
    unit = program.unknowns.scale[index]
    border = program.unknowns.column_of(_shared(result))
    found = response(program, y, columns, border)
    found = Response(
        unit[:, None] * found.by_gradient, unit[:, None] * found.by_bounds
    )
    # Response (m, num_vars) to changes of the gradient by program variables.
    by_x = found.by_gradient @ program.unknowns.matrix.T
    covariance = np.zeros((len(free), len(free)))
    for movement in problem.movements:
        for part in _noise(movement, result, found, by_x, cutoff_hz, order):
            covariance += part @ part.T
    # The errors' prior counts as a measurement, too.
    _, errors = problem.errors.prior()
    by_errors = by_x[:, problem.program.indices(problem.error_variables)]
    covariance += by_errors @ np.linalg.solve(errors, by_errors.T)
    chosen = [result.parameters[k] for k in free]
    x = result.values[index]
    # In the parameter's own unit, also of a prior of logarithms.
    prior = np.array(
        [
            np.inf
            if p.prior_sd is None
            else p.prior_sd * (v if p.log_prior else 1.0)
            for p, v in zip(chosen, x, strict=True)
        ]
    )
    by_prior = by_x[:, index] / prior
    covariance += by_prior @ by_prior.T
    return Uncertainty(
        [p.name for p in chosen],
        covariance,
        found.by_gradient @ _regulariser(problem, program, y),
        np.minimum(prior, [p.span / 4.0 for p in chosen]),
        np.array([p.at_bound(v) for p, v in zip(chosen, x, strict=True)]),
        np.array([_law(p, v) for p, v in zip(chosen, x, strict=True)])
        if problem.errors.unknowns
        else 0.0,
        np.where([p.lower >= 0.0 for p in chosen], x, np.inf),
    )


def _law(p: ContactParameter, value: float) -> float:
    """Standard deviation of a parameter because a real cuff is not a bushing.

    Its stiffness grows with load, it slips, and skin slides late under it, so
    the best-fitting bushing differs between movements. Chosen on wide campaigns
    of seeds 1 to 4.
    """
    if p.name.endswith("_stiffness"):
        return _LAW_SHARE * abs(value)
    return _LAW_ORIGIN_M if ".origin" in p.name else 0.0


def posterior(result: PhaseResult) -> Posterior:
    """Posterior of parameters and errors of measurement (normal, Laplace's).

    The covariance is the inverse of the cost's curvature at the optimum: the
    cost is a sum of squares of errors over their standard deviations (noise of
    a signal stays the same for about a second) and of priors. The cost of jerk
    is left out: it is neither, and with it a swinging device would seem to
    determine the lag of its encoders.
    """
    problem = result.problem
    names = [problem.parameters[k].name for k in _free(result)]
    names += problem.errors.names
    program = result.compiled
    x = result.values
    y = program.restrict(x)
    index = _shared(result)
    columns = program.unknowns.column_of(index)
    unit = program.unknowns.scale[index]
    matrix = program.unknowns.matrix
    jerk = matrix.T @ sp.diags_array(_jerk_weights(problem, len(x))) @ matrix
    found = response(program, y, columns, without=jerk).by_gradient
    covariance = -unit[:, None] * found[:, columns] * unit
    covariance = 0.5 * (covariance + covariance.T)
    return Posterior(tuple(names), x[index], covariance)


def _free(result: PhaseResult) -> list[int]:
    """Indices of parameters that are free and not fixed in the program."""
    return [k for k, p in enumerate(result.parameters) if p.free]


def _shared(result: PhaseResult) -> np.ndarray:
    """Indices of variables that all nodes share: free parameters, errors."""
    problem = result.problem
    variables = problem.parameter_variables[_free(result)]
    return problem.program.indices(np.r_[variables, problem.error_variables])


def _noise(movement: TrialProgram, result, found, by_x, cut, order):
    """Response (m, k) to independent unit noises, for each signal."""
    values, slopes = noise_basis(movement.grid.times, cut, order)
    unknowns = result.compiled.unknowns
    responses = {"position": [], "velocity": []}
    for term in movement.tracked:
        if term.role == "regulariser":
            continue
        R = by_target(term, result.problem, by_x)
        if term.role in responses:
            # From weighted rows back to the signals, to which given ends refer;
            # positions and velocities each have rows of their own.
            R = R @ term.rows[0]
            variables = result.problem.program.indices(term.variables)
            for node in (0, -1):  # end states that are given as measured
                rows = result.compiled.rows.row_of(variables[node])
                given = rows >= 0
                unit = unknowns.scale[variables[node][given]]
                R[:, node, given] += found.by_bounds[:, rows[given]] / unit
            responses[term.role].append((R, term))
            continue
        sigma = _finite(term.sigma)
        for r in range(R.shape[2]):
            yield (R[:, :, r] * sigma[:, r]) @ values
    # One pair for the coordinates, and one for each of two feet.
    for (R, term), (R_v, _) in zip(*responses.values(), strict=True):
        parts = np.linalg.inv(term.rows[0]) * _finite(term.sigma)[0]
        R, R_v = R @ parts, R_v @ parts
        for d in range(R.shape[2]):
            yield R[:, :, d] @ values + R_v[:, :, d] @ slopes


def _finite(sigma: np.ndarray) -> np.ndarray:
    """Noise of tracked signals; 0 for those not tracked (infinite sigma)."""
    return np.where(np.isfinite(sigma), sigma, 0.0)


def by_target(term: Tracking, problem: PhaseProblem, by_x) -> np.ndarray:
    """Response (m, n, r) of m quantities to a term's target (n, r).

    Args:
        term: tracking term of the cost.
        problem: the problem it belongs to.
        by_x: (m, num_vars) response to changes of the cost's gradient.
    """
    place, weights = problem.program.indices, term.weights
    gain = 1.0 / term.sigma[:, :, None] ** 2
    R = -np.einsum(
        "pnm,nrm,n->pnr",
        by_x[:, place(term.variables)],
        gain * term.rows,
        weights,
        optimize=True,
    )
    if term.effects is not None:
        R -= np.einsum(
            "pk,nrk,n->pnr",
            by_x[:, place(problem.error_variables)],
            gain * term.effects,
            weights,
            optimize=True,
        )
    return R


def _jerk_weights(problem: PhaseProblem, count: int) -> np.ndarray:
    """Curvature (count,) of the cost of jerk by each program variable."""
    found = np.zeros(count)
    for movement in problem.movements:
        jerk = problem.program.indices(movement.grid.jerk)
        weights = movement.grid.jerk_weights[:, None]
        found[jerk] += weights / movement.jerk_sigma**2
    return found


def _regulariser(problem: PhaseProblem, program: SparseProgram, y):
    """Gradient (ny,) of cost terms that track no measurement, less priors."""
    x = program.expand(y)
    g = _jerk_weights(problem, len(x)) * x
    for movement in problem.movements:
        variables, factors, times = movement.damped
        index = problem.program.indices(variables)
        missed = times * np.sum(x[index] * factors, axis=1)
        np.add.at(g, index, missed[:, None] * factors)
        weights = movement.grid.quadrature[:, None]
        for term in movement.tracked:
            if term.role == "regulariser":
                index = problem.program.indices(term.variables)
                g[index] += weights * x[index] / term.sigma**2
    rest = program.residual_gradient(y, without=LogKernel)
    return program.unknowns.matrix.T @ g + rest


def noise_basis(
    times: np.ndarray, cutoff_hz: float, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Independent parts of filtered white noise of unit variance.

    Args:
        times: (n,) [s].
        cutoff_hz: frequency at which amplitudes are damped to 1/sqrt(2).
        order: effective order of the zero-lag Butterworth filter.

    Returns:
        values (n, k): noise is values @ white noise (k,); and their time
        derivatives [1/s].
    """
    duration = times[-1] - times[0]
    step = 1.0 / (_FREQUENCIES_PER_CYCLE * duration)
    frequencies = step * (
        0.5 + np.arange(int(np.ceil(_HIGHEST * cutoff_hz / step)))
    )
    gain = 1.0 / (
        1.0 + (np.sqrt(2.0) - 1.0) * (frequencies / cutoff_hz) ** order
    )
    amplitude = gain / np.sqrt(np.sum(gain**2))
    omega = 2.0 * np.pi * frequencies
    phase = np.outer(times - times[0], omega)
    c, s = amplitude * np.cos(phase), amplitude * np.sin(phase)
    return np.hstack([c, s]), np.hstack([-omega * s, omega * c])


# Parameters are coupled if the cosine of their sensitivities reaches this.
COUPLED = 0.99


@dataclass(frozen=True)
class Identifiability:
    """Sensitivity of forces to parameters, in units of noise and range.

    Attributes:
        names: parameters, length m.
        influence: (m,) RMS change of the forces, in standard deviations of
            their noise, when a parameter moves by a quarter of its range.
        singular_values: (m,) of the scaled sensitivity, largest first.
        directions: (m, m) rows are the parameter combinations.
        cosines: (m, m) between sensitivities; 1 for coupled parameters.
    """

    names: list[str]
    influence: np.ndarray
    singular_values: np.ndarray
    directions: np.ndarray
    cosines: np.ndarray

    def coupled_pairs(self) -> list[tuple[str, str, float]]:
        """Pairs that the data cannot tell apart, most coupled first."""
        pairs = [
            (self.names[i], self.names[j], float(self.cosines[i, j]))
            for i in range(len(self.names))
            for j in range(i + 1, len(self.names))
            if abs(self.cosines[i, j]) >= COUPLED
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[2]))

    def advice(self) -> list[str]:
        """Which parameter to fix, one sentence for each coupled pair.

        A radius if there is one, as the settings do by default.
        """
        influence = dict(zip(self.names, self.influence, strict=True))
        lines = []
        for *pair, cosine in self.coupled_pairs():
            radii = [name for name in pair if name.endswith(".radius")]
            weaker = min(radii or pair, key=influence.get)
            why = (
                "as by default"
                if radii
                else "whose range moves the forces less"
            )
            lines.append(
                f"{pair[0]} and {pair[1]} are coupled (cosine {cosine:+.4f}): "
                f"fix {weaker}, {why}"
            )
        return lines


def _by_parameters(result: PhaseResult, trial, body: str) -> np.ndarray:
    """Derivative (n, 3, m) of a segment's wrench by all m parameters."""
    problem, names = result.problem, [p.name for p in result.parameters]
    x = problem.law_inputs(result.contact, body, trial.q, trial.v)
    own = WRENCH_UNITS[:, None] * problem.kernels[body].jacobian(x, None)
    # The kernel's moment is about the body; here about the laboratory origin.
    own[:, 2] += x[:, [1]] * own[:, 0] - x[:, [0]] * own[:, 1]
    J = np.zeros((len(trial.times), 3, len(names)))
    columns = [
        names.index(p.name)
        for sphere in problem.soles[body]
        for p in result.contact.fixed(sphere)
    ]
    J[:, :, columns] = own[:, :, -len(columns) :]
    return J


def contact_sensitivity(result: PhaseResult) -> Identifiability:
    """Sensitivity of ground reaction and CoP at the calibrated motion.

    By all parameters of the spheres, fixed ones included. Nodes are weighted by
    the time they stand for, so that finer parts of a grid do not count more.
    """
    problem, noise = result.problem, result.problem.settings.noise
    scale = np.array([p.span / 4.0 for p in result.parameters])
    blocks, lengths = [], []
    for trial in result.trials:
        stands = stands_for(np.diff(trial.times))
        for side, wrench in trial.soles.items():
            J = sum(
                _by_parameters(result, trial, body)
                for body in problem.feet[side]
            )
            ground, J = wrench.cut(wrench.is_loaded), J[wrench.is_loaded]
            load, cop = ground.force_z[:, None], ground.cop_x[:, None]
            d_cop = -(J[:, 2] + cop * J[:, 1]) / load
            scaled = np.stack(
                [
                    J[:, 0] / noise.force_n,
                    J[:, 1] / noise.force_n,
                    d_cop / noise.cop_m,
                ],
                axis=1,
            )
            blocks.append(scaled * scale)
            lengths.append(stands[wrench.is_loaded])
    stands = np.concatenate(lengths)
    counts = np.sqrt(stands / stands.mean())[:, None, None]
    sensitivity = counts * np.concatenate(blocks)
    names = [p.name for p in result.parameters]
    return analyse(names, sensitivity.reshape(-1, len(names)))


def analyse(names: list[str], sensitivity: np.ndarray) -> Identifiability:
    """Analyse a scaled sensitivity matrix (outputs, parameters)."""
    norms = np.linalg.norm(sensitivity, axis=0)
    unit = sensitivity / np.maximum(norms, 1e-300)
    _, values, directions = np.linalg.svd(sensitivity, full_matrices=False)
    return Identifiability(
        names=list(names),
        influence=norms / np.sqrt(len(sensitivity)),
        singular_values=values,
        directions=directions,
        cosines=unit.T @ unit,
    )


# Standard deviation of a cuff's force, as a share, that no bushing represents:
# cuffs stiffen and slip.
DISCREPANCY = 0.12


@dataclass(frozen=True)
class Bands:
    """Half widths of 95 % bands around a predicted trial.

    Bands `q`, `v` and `cuffs` are around the prediction. Those of instruments'
    readings are around the prediction plus its expected error: a mat shows
    `found.cuff(name).normal + bands.off_mats[name]` within `bands.mats[name]`.

    Attributes:
        q, v: (n, nq), units as the trial's.
        cuffs: cuff -> (n, 3) tangential, normal [N], moment [N m].
        mats: cuff -> (n,) for readings of its mats [N].
        seen_q, seen_v: (n, nq) for readings of markers and encoders.
        off_q, off_v, off_mats: expected readings less the prediction, by the
            known errors of measurement; shapes likewise.
    """

    q: np.ndarray
    v: np.ndarray
    cuffs: dict[str, np.ndarray]
    mats: dict[str, np.ndarray]
    seen_q: np.ndarray
    seen_v: np.ndarray
    off_q: np.ndarray
    off_v: np.ndarray
    off_mats: dict[str, np.ndarray]

    def __repr__(self) -> str:
        # Without the arrays: a notebook prints this for its last line.
        told = (f"{c} ± {self.normal(c).mean():.1f} N" for c in self.cuffs)
        return f"Bands({len(self.q)} samples; {', '.join(told)})"

    def normal(self, cuff: str) -> np.ndarray:
        """Half width (n,) of a cuff's normal force [N], of its mats' if any."""
        return self.mats.get(cuff, self.cuffs[cuff][:, NORMAL])

    def coverage(self, found: Trial, measured: Trial) -> dict:
        """Share of time during which measurements are within the bands.

        Args:
            found: the prediction to which the bands belong.
            measured: the same trial as measured.

        Returns:
            trial; angles_deg and velocities_deg_s by joint that was measured,
            interaction_n (normal force) by cuff that has mats; and
            half_width_n, the mean half width of each such band over time.
        """
        at, names = measured.sample(found.times), found.coordinates
        lengths = stands_for(np.diff(found.times))

        def mean(x) -> float:
            return float(np.average(x, weights=lengths))

        def share(shown, predicted, width) -> float:
            return mean(np.abs(shown - predicted) <= width)

        told = np.isfinite(self.seen_q).all(axis=0)
        joints = [(n, k) for n in names.joints if told[k := names.index(n)]]

        def of_joints(*arrays) -> dict[str, float]:
            return {n: share(*(x[:, k] for x in arrays)) for n, k in joints}

        cuffs = [c for c in self.mats if c in at.cuffs]
        return {
            "trial": found.name,
            "angles_deg": of_joints(at.q, found.q + self.off_q, self.seen_q),
            "velocities_deg_s": of_joints(
                at.v, found.v + self.off_v, self.seen_v
            ),
            "interaction_n": {
                c: share(
                    at.cuffs[c].normal,
                    found.cuffs[c].normal + self.off_mats[c],
                    self.mats[c],
                )
                for c in cuffs
            },
            "half_width_n": {c: mean(self.mats[c]) for c in cuffs},
        }


def bands(result: PhaseResult) -> Bands | None:
    """Bands of a predicted trial; None without a calibration's posterior."""
    problem = result.problem
    known = problem.contact.posterior
    if known is None or not problem.errors.unknowns:
        return None
    (movement,), (trial,) = problem.movements, result.trials
    program = result.compiled
    y = program.restrict(result.values)
    place = problem.program.indices
    errors = place(problem.error_variables)
    optimum = Optimum(program, y, program.unknowns.column_of(errors))
    # Below, `moved` holds responses of all program variables, one column for
    # each independent part of the deviation.
    matrix = program.unknowns.matrix

    def by_gradient(change: np.ndarray) -> np.ndarray:
        return matrix @ optimum.by_gradient(matrix.T @ change)

    size = matrix.shape[0]
    _, prior = problem.errors.prior()
    chosen = [n for n in known.names if n in problem.contact.values()]
    variables = place(problem.variables_of(chosen))
    names, count = [*chosen, *problem.errors.names], len(chosen)
    covariance = np.zeros((len(names),) * 2)
    covariance[count:, count:] = prior
    # Errors that trials share are correlated with the parameters.
    told = [k for k, name in enumerate(names) if name in known.names]
    _, covariance[np.ix_(told, told)] = known.of([names[k] for k in told])
    change = np.zeros((size, len(errors)))
    change[errors] = -np.linalg.inv(prior)
    moved = [matrix @ optimum.by_fixed(variables), by_gradient(change)]
    parts = [np.hstack(moved) @ _root(covariance)]
    for term in movement.tracked:
        if term.role != "regulariser":
            noise = _noise_of_term(
                term, movement.grid.times, place, errors, size
            )
            parts.append(by_gradient(noise))
    moved = np.hstack(parts)

    def change_of(variables) -> np.ndarray:
        """Change (..., k) of variables by the independent parts."""
        return moved[place(variables)]

    def of_seen(variables, by) -> np.ndarray:
        """The same for readings, with their errors of measurement."""
        return change_of(variables) + by @ moved[errors]

    grid = movement.grid
    at = problem.trials[0].sample(grid.times)
    # Mats' errors are shares of the force: here the predicted one.
    at = replace(at, cuffs={cuff: trial.cuffs[cuff] for cuff in at.cuffs})
    effects, known_errors = problem.errors.effects(at), result.values[errors]

    cuffs, mats = {}, {}
    for cuff, variables in movement.cuffs.items():
        force = trial.cuffs[cuff].components
        law = DISCREPANCY * force
        cuffs[cuff] = _half_width(change_of(variables), law)
        if cuff in effects.normal:
            mats[cuff] = _half_width(
                of_seen(variables[:, NORMAL], effects.normal[cuff]),
                law[:, NORMAL],
                problem.settings.noise.normal_force_n,
            )
    q, v = (_half_width(change_of(x)) for x in (grid.q, grid.v))
    # Noise of readings, also for a periodic step, which tracks nothing.
    shown = kinematic_terms(
        movement, at, problem.settings.noise, encoders=has_encoders(at)
    )
    seen_q, seen_v = (
        _half_width(
            of_seen(variables, by),
            term.sigma[0],
            shared_noise(problem.tree, term.sigma[0]),
        )
        for variables, term, by in zip(
            (grid.q, grid.v), shown[:2], (effects.q, effects.v), strict=True
        )
    )
    return Bands(
        q,
        v,
        cuffs,
        mats,
        seen_q,
        seen_v,
        effects.q @ known_errors,
        effects.v @ known_errors,
        {cuff: by @ known_errors for cuff, by in effects.normal.items()},
    )


def _half_width(parts: np.ndarray, *more) -> np.ndarray:
    """Half widths of 95 % intervals, by parts (..., k) and `more` sds."""
    variance = np.sum(parts**2, axis=-1) + sum(np.square(m) for m in more)
    return QUANTILE_95 * np.sqrt(variance)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Square root (m, k) of a covariance that may be singular."""
    # Scaled: clocks and stiffness differ by 1e9. A variance at a bound is 0.
    unit = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit[unit == 0.0] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _noise_of_term(term, times, place, errors, size) -> np.ndarray:
    """Change (size, k) of the cost's gradient by k parts of a term's noise."""
    n, r = term.target.shape
    active = term.weights > 0.0
    if active.sum() == 2:  # the two ends, independent of each other
        modes = np.zeros((n, 2))
        modes[np.flatnonzero(active), [0, 1]] = 1.0
        modes /= np.sqrt(term.weights[active])
    else:
        modes = _modes(times)
    index = place(term.variables)
    change = np.zeros((size, r * modes.shape[1]))
    for k in range(r):
        gain = term.weights / term.sigma[:, k]
        for m in range(modes.shape[1]):
            column = change[:, k * modes.shape[1] + m]
            by_node = -(gain * modes[:, m])[:, None]
            np.add.at(column, index, by_node * term.rows[:, k])
            if term.effects is not None:
                column[errors] += np.sum(by_node * term.effects[:, k], axis=0)
    return change


def _modes(times: np.ndarray) -> np.ndarray:
    """Modes (n, k), orthonormal in time, of noise that lasts about a second."""
    duration = times[-1] - times[0]
    count = max(round(2.0 * duration), 1)
    phase = np.pi * (times - times[0]) / duration
    modes = np.cos(np.outer(phase, np.arange(count))) * np.sqrt(2.0 / duration)
    modes[:, 0] = np.sqrt(1.0 / duration)
    return modes
