"""What a design found: its wearers' trials, and what they feel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drake_exo.calibration.design_variables import design_of
from drake_exo.calibration.problem import PhaseProblem
from drake_exo.calibration.settings import DesignSettings
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.strap import CuffDesign, Design
from drake_exo.measurement.trial import Trial
from drake_exo.nlp.ipopt import Solution
from drake_exo.nlp.sensitivity import Optimum
from drake_exo.nlp.sparse import SparseProgram

if TYPE_CHECKING:
    from drake_exo.calibration.design import DesignProblem


@dataclass(frozen=True)
class WearerResult:
    """What a design makes of one wearer's movements.

    Attributes:
        problem: the wearer's part of the program.
        solution: of the whole program.
        contact: with the design's cuffs.
        trials: the solution of each movement, named as measured.
    """

    problem: PhaseProblem
    solution: Solution
    contact: ContactModel
    trials: list[Trial]

    @cached_property
    def largest_forces(self) -> dict[str, np.ndarray]:
        """Cuff -> largest tangential, normal force, moment (3,) [N, N, N m]."""
        forces = {
            cuff: [np.abs(t.cuffs[cuff].components) for t in self.trials]
            for cuff in self.problem.bushings
        }
        return {c: np.vstack(f).max(axis=0) for c, f in forces.items()}

    @cached_property
    def largest_rates(self) -> dict[str, float]:
        """Cuff -> how fast its normal force rises or falls at most [N/s]."""
        return {
            cuff: max(largest_rate(t, cuff) for t in self.trials)
            for cuff in self.problem.bushings
        }

    @cached_property
    def mean_forces(self) -> dict[str, float]:
        """Cuff -> size of its normal force, mean over time and trials [N]."""
        return {
            cuff: mean_force(self.trials, cuff)
            for cuff in self.problem.bushings
        }

    @cached_property
    def largest_deflections(self) -> dict[str, np.ndarray]:
        """Cuff -> largest deflection (3,) over trials [m, m, rad]."""
        return {
            cuff: kinematics.largest(
                self.trials, self.contact.bushings[cuff].origin
            )
            for cuff, kinematics in self.problem.bushings.items()
        }

    @cached_property
    def largest_moments(self) -> np.ndarray:
        """Of each of the person's joints over trials [N m]."""
        human = [
            np.abs(t.moments[:, ~t.coordinates.is_device_joint])
            for t in self.trials
        ]
        return np.vstack(human).max(axis=0)


@dataclass(frozen=True)
class DesignResult:
    """What a design found.

    Attributes:
        problem: that was solved.
        solution: state of the solve.
        compiled: what was solved: its program may be added to afterwards.
        values: name -> value of each design variable (straps as compliance).
        wearers: name -> its trials on the design.
    """

    problem: DesignProblem
    solution: Solution
    compiled: SparseProgram
    values: dict[str, float]
    wearers: dict[str, WearerResult]

    @property
    def design(self) -> Design:
        """What is to be built.

        Raises:
            SealedSolutionError: the solve failed.
        """
        self.solution.check()
        return self._design

    @property
    def _design(self) -> Design:
        return design_of(self.values, self.problem.without)

    @property
    def norm_n(self) -> float:
        """The norm of all cuffs' forces that was minimised [N]."""
        return joint_norm(
            worn_norm(worn, self.problem.settings, self._design)
            for worn in self.wearers.values()
        )

    def slopes(self) -> dict[str, float]:
        """Derivative of the optimum by each design variable that is held.

        Of the whole cost; held are those whose bounds are equal, or that sit
        at a bound.
        """
        problem, program = self.problem, self.compiled
        y = program.restrict(self.solution.raw_values())
        index = {
            n: problem.program.index(v) for n, v in problem.variables.items()
        }
        fixed = {v.name: index[v.name] for v in problem.design if not v.free}
        free = [i for n, i in index.items() if n not in fixed]
        built = [v for part in problem.parts for v in part.built]
        built = problem.program.indices(np.concatenate(built))
        touching = np.array(sorted([*free, *built]), int)
        border = program.unknowns.column_of(touching)
        optimum = Optimum(program, y, border)
        slopes = optimum.cost_by_fixed(np.array(list(fixed.values()), int))
        return dict(zip(fixed, map(float, slopes), strict=True))


def largest_rate(trial: Trial, cuff: str) -> float:
    """How fast a cuff's normal force rises or falls at most [N/s].

    From each sample to the next.
    """
    rises = np.diff(trial.cuffs[cuff].normal) / np.diff(trial.times)
    return float(np.abs(rises).max())


def mean_force(trials: Sequence[Trial], cuff: str) -> float:
    """Size of a cuff's normal force, mean over time and then trials [N]."""
    means = [
        np.trapezoid(np.abs(t.cuffs[cuff].normal), t.times) / t.duration
        for t in trials
    ]
    return float(np.mean(means))


class Norm(NamedTuple):
    """The norm that is minimised, of all cuffs' forces in some trials.

    Attributes:
        total: integral of the forces to the order of the norm [N^p s].
        duration: over time and cuffs [s].
        order: p.
    """

    total: float
    duration: float
    order: float

    @property
    def newton(self) -> float:
        """The norm [N]."""
        return float((self.total / self.duration) ** (1.0 / self.order))


def norm_of(
    trials: Sequence[Trial],
    settings: DesignSettings,
    design: Design | None = None,
    shown: Callable[[str], float] = lambda cuff: 1.0,
) -> Norm:
    """The norm of one wearer's trials.

    Each force over the cuff's area against today's, if a design changes it,
    and as mats would show it; one that is left out counts as one without
    force.

    Args:
        trials: solved.
        settings: of the design.
        design: of the trials; nothing changed by default.
        shown: see Wearer.
    """
    cuffs = {} if design is None else design.cuffs
    removed = () if design is None else design.removed
    p, total, duration = settings.exponent, 0.0, 0.0
    for trial in trials:
        duration += len(removed) * trial.duration
        for cuff, force in trial.cuffs.items():
            square = force.normal**2
            square = square + settings.shear_weight * force.tangential**2
            square *= (shown(cuff) / cuffs.get(cuff, CuffDesign()).area) ** 2
            total += float(np.trapezoid(square ** (p / 2), trial.times))
            duration += trial.duration
    return Norm(total, duration, p)


def worn_norm(
    worn: WearerResult, settings: DesignSettings, design: Design | None = None
) -> Norm:
    """The norm of a wearer's trials, see `norm_of`."""
    return norm_of(worn.trials, settings, design, worn.problem.wearer.shown)


def joint_norm(norms: Iterable[Norm]) -> float:
    """Of several wearers together [N]."""
    totals, durations, orders = zip(*norms, strict=True)
    return Norm(sum(totals), sum(durations), orders[0]).newton


def works(result: DesignResult) -> dict[str, float]:
    """Wearer -> work of the device over its movements of today [J]."""
    return {
        name: found.problem.work(found.trials)
        for name, found in result.wearers.items()
    }


def device_work(trial: Trial) -> float:
    """Work of the device's joints over a trial [J], by the trapezoid rule."""
    names = trial.coordinates
    torque = trial.moments[:, names.is_device_joint]
    power = np.sum(torque * trial.v[:, names.device_columns], axis=1)
    return float(np.trapezoid(power, trial.times))
