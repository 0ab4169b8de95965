"""How many cuffs: a design with each removable one left out in turn."""

from collections.abc import Callable
from dataclasses import dataclass

from drake_exo.calibration.attachment import hold
from drake_exo.calibration.design import DesignProblem
from drake_exo.calibration.design_result import DesignResult
from drake_exo.calibration.design_variables import LEAST_GAIN
from drake_exo.calibration.wearers import less
from drake_exo.contact.strap import CuffDesign, Design
from drake_exo.errors import InputError
from drake_exo.nlp.ipopt import Iterate


@dataclass(frozen=True)
class Tried:
    """A design with some cuffs left out.

    Attributes:
        without: the cuffs.
        cost: what is minimised, see `DesignResult.cost`; None where there is
            no such design.
        norm_n: of all cuffs' forces [N]; likewise.
        design: likewise.
        why_not: in a sentence; empty where there is one.
    """

    without: tuple[str, ...]
    cost: float | None
    norm_n: float | None
    design: Design | None = None
    why_not: str = ""

    @property
    def name(self) -> str:
        """Of its cuffs that are left out."""
        return " and ".join(self.without) or "none"


def fewer(
    found: DesignResult,
    watch: Callable[[str], Callable[[Iterate], None]],
) -> tuple[DesignResult, list[Tried]]:
    """The best design with as many cuffs as it needs.

    Of a design, each cuff that may be removed is left out in turn and all
    else is designed again under all limits; the best of them takes its place
    if its cost is less, and so on.

    Args:
        found: with every cuff, solved.
        watch: makes what is called on each iterate, by what is solved.

    Returns:
        The best one, and all that were tried, the one with every cuff first.
    """
    settings = found.problem.settings
    removable = [
        c
        for c in found.problem.wearers[0].model.cuffs
        if settings.freedom(c).removable
    ]
    tried = [_told(found)] if removable else []
    best = found
    while True:
        rivals = []
        for cuff in removable:
            if cuff in best.problem.without:
                continue
            without = (*best.problem.without, cuff)
            told, rival = _attempt(found, without, watch)
            if rival is not None and rival.solution.was_stopped:
                return best, tried
            tried.append(told)
            if told.cost is not None:
                rivals.append(rival)
        least = min(rivals, key=lambda r: r.cost, default=best)
        if not least.cost < best.cost - LEAST_GAIN:
            return best, tried
        best = least


def _attempt(
    found: DesignResult, without: tuple[str, ...], watch
) -> tuple[Tried, DesignResult | None]:
    """A design without some cuffs, and what is told of it."""
    problem = found.problem
    try:
        loose = looseness(problem, without)
    except InputError as error:
        loose = str(error)
    if loose:
        return Tried(without, None, None, why_not=loose), None
    rival = DesignProblem(
        problem.wearers,
        problem.settings,
        today=problem.today,
        support=problem.support,
        without=without,
    ).solve(on_iterate=watch(f"without {', '.join(without)}"))
    if not rival.solution.success:
        why = f"{rival.solution.status}: {rival.solution.explain()}"
        return Tried(without, None, None, why_not=why), rival
    return _told(rival), rival


def _told(found: DesignResult) -> Tried:
    return Tried(found.problem.without, found.cost, found.norm_n, found.design)


def looseness(problem: DesignProblem, without: tuple[str, ...]) -> str:
    """Why a device would hang loose without some cuffs, in a sentence.

    Raises:
        InputError: nothing at all would hold one of its joints.
    """
    fewer = Design(dict.fromkeys(without, CuffDesign(removed=True)))
    for wearer in problem.wearers:
        held = less(wearer, fewer)
        least = hold(held.model, held.contact, held.trials)
        if not least.stiffness > 0.0:
            return (
                f"the device would hang loose on {wearer.name}: at "
                f"{least.joint} its weight pushes it off by "
                f"{-least.stiffness:.1f} N m/rad more than the cuffs hold it"
            )
    return ""
