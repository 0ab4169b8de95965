"""How many cuffs a device needs, and whether they hold it.

`fewer` repeats the design with each removable cuff left out in turn. `hold`
checks the remaining ones: with the person held still, springs of the cuffs,
springs across joints and gravity give the device a potential energy. If its
curvature by the device's joints is negative in some direction, the device's own
weight moves it away: it hangs loose, even if a movement on it can be solved.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_exo.calibration.design import DesignProblem, DesignResult
from drake_exo.calibration.design_variables import design_of, partner
from drake_exo.calibration.solving import SolveWatch
from drake_exo.calibration.wearers import less
from drake_exo.contact.bushing import BushingKinematics
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.strap import Design
from drake_exo.errors import InputError
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model
from drake_exo.nlp.ipopt import STOPPED_BY_USER

_STEP_RAD = 1e-5


class Hold(NamedTuple):
    """How well a device is held.

    Attributes:
        stiffness: least curvature of the energy by the device's joint angles
            (least eigenvalue), over all postures [N m/rad].
        joint: the joint that turns most in that direction.
    """

    stiffness: float
    joint: str

    def __str__(self) -> str:
        return (
            f"at {self.joint} the cuffs are {-self.stiffness:.1f} N m/rad too "
            "soft to hold its weight"
        )


def hold(
    model: Model,
    contact: ContactModel,
    trials: Sequence[Trial],
    springs: np.ndarray | float = 0.0,
) -> Hold:
    """Least stiffness that holds the device on a person who keeps still.

    Args:
        model: subject and device.
        contact: its bushings are the cuffs.
        trials: the postures of these are checked.
        springs: stiffness (m,) of springs across the device's joints [N m/rad].
    """
    tree, names = model.tree, model.coordinates
    device = names.device_columns
    cuffs = [
        (BushingKinematics(tree, cuff, b.preload), b)
        for cuff, b in contact.bushings.items()
    ]

    def slope(q: np.ndarray) -> np.ndarray:
        """Energy's slope by the device's joints (n, m) at q (n, nq)."""
        rest = np.zeros_like(q)
        found = tree.inverse_dynamics(q, rest, rest)
        for kinematics, bushing in cuffs:
            places = np.broadcast_to(bushing.origin, (len(q), 2))
            terms = kinematics.terms(q, places)
            d = kinematics.deflection(q, terms)
            found += np.einsum(
                "nc,ncq->nq",
                kinematics.force(d, bushing),
                kinematics.deflection_jacobian(terms),
            )
        return found[:, device]

    q = np.concatenate([t.q for t in trials])
    curvature = np.empty((len(q), len(device), len(device)))
    for i, column in enumerate(device):
        step = np.zeros(q.shape[1])
        step[column] = _STEP_RAD
        change = slope(q + step) - slope(q - step)
        curvature[:, :, i] = change / (2.0 * _STEP_RAD)
    # Symmetric but for errors of differences, also where a cuff slips.
    curvature = 0.5 * (curvature + curvature.transpose(0, 2, 1))
    curvature += springs * np.eye(len(device))
    least, modes = np.linalg.eigh(curvature)
    worst = int(np.argmin(least[:, 0]))
    joint = names.device[int(np.argmax(np.abs(modes[worst, :, 0])))]
    return Hold(float(least[worst, 0]), joint)


@dataclass(frozen=True)
class Tried:
    """A design with some cuffs left out.

    Attributes:
        without: the cuffs left out.
        norm_n: norm of all cuffs' forces [N]; None if there is no such design.
        forecast_n: that norm in the forecast of the design [N], or None.
        design: the design, or None.
        why_not: sentence that says why there is none; else empty.
    """

    without: tuple[str, ...]
    norm_n: float | None = None
    forecast_n: float | None = None
    design: Design | None = None
    why_not: str = ""

    @property
    def name(self) -> str:
        """Names of the cuffs left out, joined by "and"."""
        return " and ".join(self.without) or "none"


def fewer(
    found: DesignResult,
    forecast: Callable[[DesignResult], float],
) -> tuple[DesignResult, list[Tried]]:
    """The best design with as few cuffs as it needs, by greedy removal.

    Each removable cuff (of a symmetric design, both of a pair) is left out in
    turn and all else designed again under all limits. The best of these designs
    replaces the present one if the norm of the forces in its forecast is less,
    and the removal is repeated. Costs are not compared: fractions of 0.02
    degrees by which a movement is off the person's own would decide.

    Args:
        found: solved design with every cuff.
        forecast: norm of the forces on a design as built [N]; raises InputError
            if nobody can move on it, or it hangs loose.

    Returns:
        The best design, and all that were tried, the one with every cuff first.
    """
    settings = found.problem.settings
    cuffs = found.problem.wearers[0].model.cuffs
    removable = dict.fromkeys(
        frozenset({cuff, partner(cuff, cuffs, settings)})
        for cuff in cuffs
        if settings.freedom(cuff).removable
    )
    if not removable:
        return found, []
    best = (forecast(found), found)
    tried = [_told(found, best[0])]
    while True:
        rivals = []
        for pair in removable:
            if pair <= {*best[1].problem.without}:
                continue
            without = (*best[1].problem.without, *sorted(pair))
            try:
                rival = _without(found, without)
                if rival.solution.was_stopped:
                    raise KeyboardInterrupt
                norm = forecast(rival)
            except KeyboardInterrupt:  # between solves, or in a forecast
                tried.append(Tried(without, why_not=STOPPED_BY_USER))
                return min([best, *rivals], key=lambda r: r[0])[1], tried
            except InputError as error:
                tried.append(Tried(without, why_not=str(error)))
                continue
            tried.append(_told(rival, norm))
            rivals.append((norm, rival))
        least = min(rivals, key=lambda r: r[0], default=best)
        if not least[0] < best[0]:
            return best[1], tried
        best = least


def _without(found: DesignResult, without: tuple[str, ...]) -> DesignResult:
    """The design made again without some cuffs.

    Raises:
        InputError: the device would hang loose, or the solve failed.
    """
    problem = found.problem
    for wearer in problem.wearers:
        held = less(wearer, design_of({}, without))
        least = hold(held.model, held.contact, held.trials, held.springs)
        if not least.stiffness > 0.0:
            raise InputError(
                f"the device would hang loose on {wearer.name}: {least}"
            )
    rival = DesignProblem(
        problem.wearers,
        problem.settings,
        today=problem.today,
        support=problem.support,
        without=without,
    ).solve(on_iterate=SolveWatch(f"without {', '.join(without)}"))
    solution = rival.solution
    if not (solution.success or solution.was_stopped):
        raise InputError(f"{solution.status}: {solution.explain()}")
    return rival


def _told(found: DesignResult, forecast: float) -> Tried:
    return Tried(found.problem.without, found.norm_n, forecast, found.design)
