"""Result of a design: wearers' trials, forces they feel, and their norm."""

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
        solution: state of the whole program's solve.
        contact: the wearer's, with the design's cuffs.
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
        """Cuff -> largest rate of its normal force [N/s]."""
        return {
            cuff: max(largest_rate(t, cuff) for t in self.trials)
            for cuff in self.problem.bushings
        }

    @cached_property
    def mean_forces(self) -> dict[str, float]:
        """Cuff -> mean size of its normal force over time and trials [N]."""
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
        """Largest moment of each of the person's joints (m,) [N m]."""
        human = [
            np.abs(t.moments[:, ~t.coordinates.is_device_joint])
            for t in self.trials
        ]
        return np.vstack(human).max(axis=0)


@dataclass(frozen=True)
class DesignResult:
    """Result of a solved design.

    Attributes:
        problem: the problem that was solved.
        solution: state of the solve.
        compiled: the program as solved; `problem.program` may have been added
            to since.
        values: name -> value of each design variable (straps as compliance).
        wearers: wearer's name -> trials on the design.
    """

    problem: DesignProblem
    solution: Solution
    compiled: SparseProgram
    values: dict[str, float]
    wearers: dict[str, WearerResult]

    @property
    def design(self) -> Design:
        """The design that is to be built.

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
        """Derivative of the optimal cost by each design variable that is fixed.

        Fixed are those with equal bounds; free ones that sit at a bound are
        held there and have no entry.
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
        touching = np.array(sorted({*free, *built}), int)
        border = program.unknowns.column_of(touching)
        optimum = Optimum(program, y, border)
        slopes = optimum.cost_by_fixed(np.array(list(fixed.values()), int))
        return dict(zip(fixed, map(float, slopes), strict=True))


def largest_rate(trial: Trial, cuff: str) -> float:
    """Largest rate of a cuff's normal force, sample to sample [N/s]."""
    rises = np.diff(trial.cuffs[cuff].normal) / np.diff(trial.times)
    return float(np.abs(rises).max())


def mean_force(trials: Sequence[Trial], cuff: str) -> float:
    """Mean size of a cuff's normal force, over time and then trials [N]."""
    means = [
        np.trapezoid(np.abs(t.cuffs[cuff].normal), t.times) / t.duration
        for t in trials
    ]
    return float(np.mean(means))


class Norm(NamedTuple):
    """The norm that is minimised, of all cuffs' forces in some trials.

    Attributes:
        total: integral of |force|^p over time, summed over cuffs [N^p s].
        duration: time, summed over trials and cuffs [s].
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

    Forces are taken as mats would show them and divided by the cuff's area
    relative to today's. A cuff that is left out counts as one without force.

    Args:
        trials: solved.
        settings: the design's.
        design: on which the trials were; nothing changed by default.
        shown: factor on a cuff's force for what mats would show, see Wearer.
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
    """Norm of several wearers together [N]."""
    totals, durations, orders = zip(*norms, strict=True)
    return Norm(sum(totals), sum(durations), orders[0]).newton


def works(result: DesignResult) -> dict[str, float]:
    """Wearer -> work of the device along its movements of today [J]."""
    return {
        name: found.problem.work(found.trials)
        for name, found in result.wearers.items()
    }
