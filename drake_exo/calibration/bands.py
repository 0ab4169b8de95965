"""How sure a prediction is: bands of 95 % around movement and forces.

What a calibration left open (its posterior), what is not known of the trial's
own measurement (ends, clocks, forces and moments that are tracked) and what
bushings cannot express go through the conditions of the optimum
(`nlp.sensitivity`), to first order, as independent parts of one size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_exo.calibration.problem import PhaseResult, shared_noise
from drake_exo.calibration.uncertainty import QUANTILE_95
from drake_exo.contact.bushing import NORMAL
from drake_exo.measurement.trial import Trial
from drake_exo.nlp.sensitivity import Optimum

# Cuffs stiffen and slip: no bushing tells a force better than to this share.
_DISCREPANCY = 0.12


@dataclass(frozen=True)
class Bands:
    """Half widths of 95 % bands around a predicted trial.

    Attributes:
        q, v: (n, nq), units as the trial's.
        cuffs: cuff -> (n, 3) tangential, normal [N], moment [N m].
        mats: cuff -> (n,) of what its mats would show [N].
        seen_q, seen_v: (n, nq) of what markers and encoders would show.
    """

    q: np.ndarray
    v: np.ndarray
    cuffs: dict[str, np.ndarray]
    mats: dict[str, np.ndarray]
    seen_q: np.ndarray
    seen_v: np.ndarray

    def coverage(self, found: Trial, measured: Trial) -> dict:
        """Share of measured samples within the bands around a prediction.

        Args:
            found: that the bands are of.
            measured: the same trial.

        Returns:
            trial; angles_deg and velocities_deg_s by joint, interaction_n
            (normal force) by cuff that has mats; and half_width_n, the mean
            half width of each such band.
        """
        at, names = measured.sample(found.times), found.coordinates

        def share(off, width) -> float:
            return float(np.mean(np.abs(off) <= width))

        joints = [(n, names.index(n)) for n in names.joints]
        cuffs = [c for c in self.mats if c in at.cuffs]
        return {
            "trial": found.name,
            "angles_deg": {
                n: share(at.q[:, k] - found.q[:, k], self.seen_q[:, k])
                for n, k in joints
            },
            "velocities_deg_s": {
                n: share(at.v[:, k] - found.v[:, k], self.seen_v[:, k])
                for n, k in joints
            },
            "interaction_n": {
                c: share(
                    at.cuffs[c].normal - found.cuffs[c].normal, self.mats[c]
                )
                for c in cuffs
            },
            "half_width_n": {c: float(self.mats[c].mean()) for c in cuffs},
        }


def bands(result: PhaseResult) -> Bands | None:
    """Bands of a predicted trial; None where no calibration says how sure."""
    problem = result.problem
    known = problem.contact.posterior
    if known is None or problem.error_variables is None:
        return None
    (movement,), (trial,) = problem.movements, result.trials
    program = problem.compiled
    y = program.restrict(result.values)
    place = problem.program.indices
    errors = place(problem.error_variables)
    optimum = Optimum(program, y, program.unknowns.column_of(errors))
    # Responses of program variables, one column for each independent part.
    matrix = program.unknowns.matrix

    def by_gradient(change: np.ndarray) -> np.ndarray:
        return matrix @ optimum.by_gradient(matrix.T @ change)

    size = matrix.shape[0]
    _, prior = problem.errors.prior()
    weight = np.linalg.inv(prior)
    chosen = [n for n in known.names if n in problem.contact.values()]
    variables = place(problem.variables_of(chosen))
    moved = matrix @ optimum.by_fixed(variables)
    # Errors that trials share are told by the same data as the parameters.
    shared = [k for k, n in enumerate(problem.errors.names) if n in known.names]
    names = [problem.errors.names[k] for k in shared]
    _, whole = known.of([*chosen, *names])
    count = len(chosen)
    covariance = whole[:count, :count]
    cross = np.zeros((len(errors), count))
    cross[shared] = whole[count:, :count]
    # A parameter at a bound has no variance.
    follow = cross @ np.linalg.pinv(covariance, hermitian=True)
    shift = np.zeros((size, count))
    shift[errors] = -weight @ follow
    moved += by_gradient(shift)
    parts = [moved @ _root(covariance)]
    change = np.zeros((size, len(errors)))
    change[errors] = -weight @ _root(prior - follow @ cross.T)
    parts.append(by_gradient(change))
    for term in movement.tracked:
        if term.role != "regulariser":
            noise = _noise(term, movement.grid.times, place, errors, size)
            parts.append(by_gradient(noise))
    moved = np.hstack(parts)

    def spread(variables) -> np.ndarray:
        index = place(variables)
        found = moved[index.ravel()]
        return np.sqrt(np.sum(found**2, axis=1)).reshape(index.shape)

    cuffs, mats = {}, {}
    for cuff, variables in movement.cuffs.items():
        force = trial.cuffs[cuff].components
        sd = np.hypot(spread(variables), _DISCREPANCY * force)
        cuffs[cuff] = QUANTILE_95 * sd
        if cuff in problem.trials[0].cuffs:
            mats[cuff] = QUANTILE_95 * _of_mats(
                problem, prior, cuff, sd[:, NORMAL], force[:, NORMAL]
            )
    grid = movement.grid
    sd = [spread(grid.q), spread(grid.v)]
    effects = problem.errors.effects(problem.trials[0].sample(grid.times))
    ends = movement.tracked[:2]
    seen = [
        np.sqrt(
            own**2
            + term.sigma[0] ** 2
            + shared_noise(problem.tree, term.sigma[0]) ** 2
            + np.einsum("nqa,ab,nqb->nq", by, prior, by, optimize=True)
        )
        for own, term, by in zip(sd, ends, (effects.q, effects.v), strict=True)
    ]
    q, v, seen_q, seen_v = (QUANTILE_95 * x for x in (*sd, *seen))
    return Bands(q, v, cuffs, mats, seen_q, seen_v)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Square root (m, k) of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _noise(term, times, place, errors, size) -> np.ndarray:
    """Gradients (size, k) by independent parts of a tracked signal's noise."""
    n, r = term.target.shape
    active = term.weights > 0.0
    if active.sum() == 2:  # ends: each by itself
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
    """Noise that is one size for about a second: (n, k) orthonormal in time."""
    duration = times[-1] - times[0]
    count = max(round(2.0 * duration), 1)
    phase = np.pi * (times - times[0]) / duration
    modes = np.cos(np.outer(phase, np.arange(count))) * np.sqrt(2.0 / duration)
    modes[:, 0] = np.sqrt(1.0 / duration)
    return modes


def _of_mats(problem, prior, cuff: str, sd, force) -> np.ndarray:
    """Standard deviation (n,) of what mats show of a force (n,)."""
    own = dict(zip(problem.errors.names, np.diag(prior), strict=True))
    unseen = own.get(f"mat.{cuff}.unseen", 0.0)
    offset = own.get(f"mat.{cuff}.offset", 0.0)
    noise = problem.settings.noise.normal_force_n
    return np.sqrt(sd**2 + unseen * force**2 + offset + noise**2)
