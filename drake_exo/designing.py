"""Phase D as users call it: from calibrated wearers to a design and forecast.

The trials of a study that are for prediction are moved by the person's own
movement on the cuffs of today, a design is found for all wearers at once, and
the same movements on the design are its forecast.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from operator import attrgetter

import numpy as np

from drake_exo.calibration.clocks import Clock, retimed, timed
from drake_exo.calibration.design import DesignProblem, DesignResult, works
from drake_exo.calibration.design_variables import (
    GAINS,
    Variable,
    design_of,
    partner,
)
from drake_exo.calibration.phases import check_knows_cuffs
from drake_exo.calibration.problem import solved
from drake_exo.calibration.settings import (
    DesignLimits,
    DesignSettings,
    PredictionSettings,
)
from drake_exo.calibration.solving import SolveWatch
from drake_exo.calibration.uncertainty import bands
from drake_exo.calibration.wearers import (
    OwnMovement,
    Wearer,
    answer,
    assisted,
    check_population,
    check_wearers,
    drawn,
    drives_answer,
    hold,
    posture_law,
    sized,
    springs_answer,
    with_more,
)
from drake_exo.contact.bushing import TANGENTIAL
from drake_exo.contact.parameters import ContactModel
from drake_exo.contact.strap import PLACES, RELEASES, STRAPS, Design
from drake_exo.designed import (
    Designed,
    Moved,
    Tried,
    largest_force,
    trial_label,
)
from drake_exo.errors import InputError, check_file_name, check_type
from drake_exo.files import schema
from drake_exo.files.output import Progress
from drake_exo.measurement.trial import Trial
from drake_exo.model.plant import Model
from drake_exo.nlp.ipopt import STOPPED_BY_USER
from drake_exo.study import Calibration, Study, find_clocks

# Mats and model differ by no more than this factor, or one of them is wrong.
_DIFFER = 2.0
# Nor is migration with a device's swing more than this times that without.
_SWINGS = 4.0


def design(
    study: Study | Sequence[Study],
    calibration: Calibration | ContactModel | Sequence,
    settings: DesignSettings | None = None,
    *,
    parts: bool = False,
) -> Designed:
    """Phase D: cuffs and assistance for the people who will wear them.

    Args:
        study: of each wearer; its trials for prediction are what the design
            is worn in.
        calibration: of each wearer, in the same order.
        settings: instead of the first study's.
        parts: also tell what places, straps and assistance reach alone.

    Raises:
        InputError: studies and calibrations do not match, a trial does not
            know the device's torques, or a check before the solve fails.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> study = Study(made.model, made.trials, name="somebody")
    >>> found = design(study, made.contact)
    >>> found.success, found.peaks["thigh"].forecast_after < 100.0
    (True, True)
    """
    studies, contacts = (
        list(given) if isinstance(given, Sequence) else [given]
        for given in (study, calibration)
    )
    for one in studies:
        check_type(one, Study, "study")
    if not studies:
        raise InputError("there are no studies; give at least one")
    if len(studies) != len(contacts):
        raise InputError(
            f"there are {len(studies)} studies and {len(contacts)} "
            "calibrations; give one for each study"
        )
    settings = schema.checked(
        settings, DesignSettings, "settings", studies[0].design
    )
    names = _names(studies)
    if len(names) > 1:  # files are called after them
        _check_labels(names, studies)
    with studies[0].named():
        worn = [
            Wearer(
                name,
                own.model,
                own.worn(contact),
                own.trials("prediction"),
                device=own.device,
            )
            for name, own, contact in zip(names, studies, contacts, strict=True)
        ]
        check_wearers(worn, settings)  # told before minutes of solving
    if settings.population is not None:
        for who in worn:
            check_population(who)
    before, wearers, clocks = {}, [], {}
    for own, who in zip(studies, worn, strict=True):
        own.warn_of(who.trials)
        found = find_clocks(own, who.trials, who.contact)
        clocks[who.name] = found
        before[who.name] = movements(own, who, settings, clocks=found)
        wearers.append(wearer(own, who, before[who.name]))
    everybody = [w for own in wearers for w in _wearers(own, settings)]
    today = DesignProblem.of_today(everybody, settings).solve(
        on_iterate=SolveWatch("today")
    )
    made = Designed(settings, today, today, before, before)
    if not today.solution.success:
        return made
    problem = DesignProblem(everybody, settings, today=today)
    made = replace(made, found=problem.solve(on_iterate=SolveWatch("design")))
    if not made.success:
        return made

    def forecast(found: DesignResult) -> dict[str, list[Moved]]:
        return {
            w.name: movements(own, w, settings, found.design, clocks[w.name])
            for w, own in zip(wearers, studies, strict=True)
        }

    made = fewer(replace(made, after=forecast(made.found)), forecast)
    return _with_parts(made) if parts and not made.stopped else made


def wearer(study: Study, who: Wearer, moved: Sequence[Moved]) -> Wearer:
    """Somebody calibrated, with what recordings tell besides.

    Args:
        study: whose recordings.
        who: the same with recorded trials.
        moved: own movements on the cuffs of today.
    """
    own = tuple(m.trial for m in moved)
    who = replace(who, trials=own, differ=differences(moved))
    told = [m for m in moved if m.seen is not None]
    seen = replace(who, trials=[m.seen for m in told])
    had = replace(who, trials=[m.trial for m in told])
    noise_nm = study.prediction.noise.exo_moment_nm
    return replace(who, slid=slid(seen, had), law=posture_law(seen, noise_nm))


def differences(moved: Sequence[Moved]) -> dict[str, float]:
    """Cuff -> what mats show of its largest force over what the model has.

    At most a factor of 2; of cuffs that were measured. What is designed is what
    is felt, so both objective and forecast are of forces times these.

    Args:
        moved: of one wearer, on the cuffs of today.
    """
    found = {}
    for cuff in moved[0].trial.cuffs:
        seen = [m for m in moved if cuff in m.measured.cuffs]
        if seen:
            by_mats, model = (
                np.mean([largest_force(getattr(m, what), cuff) for m in seen])
                for what in ("measured", "trial")
            )
            ratio = np.clip(by_mats / model, 1.0 / _DIFFER, _DIFFER)
            found[cuff] = float(ratio)
    return found


def slid(seen: Wearer, had: Wearer) -> dict[str, float]:
    """Cuff -> its migration as encoders and markers tell it, over the model's.

    Each the largest of all trials with encoders, as what a design is limited
    in: after the chair a device swings on its cuffs, in some trials much
    further than it comes by itself. At least 1: what the model has is not
    taken back.

    Args:
        seen, had: with these trials by encoders, and by the model.
    """
    found = {}
    for cuff in seen.contact.bushings if seen.trials else ():
        ratio = seen.largest_deflection(cuff)[TANGENTIAL]
        ratio /= had.largest_deflection(cuff)[TANGENTIAL]
        found[cuff] = float(np.clip(ratio, 1.0, _SWINGS))
    return found


def _wearers(own: Wearer, settings: DesignSettings) -> list[Wearer]:
    """A calibrated wearer, and those that it stands for."""
    found = [own, *drawn(own, settings.draws, settings.seed)]
    if settings.population is not None:
        phase = PredictionSettings(solver=settings.solver, guess="data")
        found += sized(own, settings.population, phase)
    return found


def _names(studies: Sequence[Study]) -> list[str]:
    """Of the wearers, different ones."""
    own = [s.name for s in studies]
    if len(set(own)) == len(own):
        return own
    return [f"{name} {k + 1}" for k, name in enumerate(own)]


def _check_labels(names: Sequence[str], studies: Sequence[Study]) -> None:
    """Refuse wearers of whose trials two would be written into one file."""
    named: dict[str, str] = {}
    for name, study in zip(names, studies, strict=True):
        check_file_name("subject.name", name)
        for trial in study.trials("prediction"):
            label = trial_label(trial, name)
            if label in named:
                raise InputError(
                    f"subject.name: a trial of {named[label]!r} and one of "
                    f"{name!r} would both be called {label!r}; give another "
                    "name to one of them"
                )
            named[label] = name


def movements(
    study: Study,
    who: Wearer,
    settings: DesignSettings,
    design: Design | None = None,
    clocks: Sequence[Clock] = (),
) -> list[Moved]:
    """Own movements of a study's trials on its cuffs, or on a design.

    Args:
        study: whose trials.
        who: the wearer; with a design, one whose joints answer where the
            device goes another way than on the cuffs of today, see `wearer`.
        settings: grid and solver.
        design: nothing changed by default.
        clocks: of the trials, as found; torques are on that of the encoders.

    Raises:
        InputError: a movement cannot be solved; or likewise.
    """
    check_knows_cuffs(who.contact, who.model)
    there = who if design is None else who.on(design)
    trials = [retimed(t, clocks) for t in study.trials("prediction")]
    # Its noise and errors, on the grid of the design.
    phase = replace(study.prediction, solver=settings.solver, guess="data")
    found = []
    progress = Progress("own movements", len(trials))
    for k, trial in enumerate(trials):
        contact, seen = timed(there.contact, trial, clocks), None
        if design is None:
            posed, more = trial, springs_answer(trial, who.device)
        else:
            posed = assisted(trial, design, who.contact, who.passive(trial))
            more = answer(trial, who, who.trials[k], design)
        result = solved(
            OwnMovement(
                there.model,
                [posed],
                contact,
                phase,
                answers={trial.name: more},
            ),
            f"trial {trial.name}: the movement does not fit these cuffs",
        )
        if design is None and "encoders" in trial.provenance:
            seen = how_it_was(trial, who.model, contact, phase)
        found.append(Moved(result.trials[0], bands(result), trial, seen))
        progress.update(trial.name, len(found))
    return found


def on_design(
    study: Study,
    contact: ContactModel,
    design: Design,
    clocks: Sequence[Clock] = (),
) -> tuple[Study, ContactModel]:
    """Study and contact with a design: trials for prediction alone.

    The device's torques are those of the design's forecast: as designed, and
    as drives answer where the device goes on other cuffs; what springs answer
    is the prediction's. Where torques are not known, cuffs change alone.

    Raises:
        InputError: the design is of another device, or a movement cannot be
            solved.
    """
    design.check(study.model)
    trials = tuple(retimed(t, clocks) for t in study.trials("prediction"))
    who = Wearer(study.name, study.model, contact, trials, device=study.device)
    worn = [assisted(t, design, contact, who.passive(t)) for t in trials]
    if all(trial.moments is not None for trial in trials):
        before = movements(study, who, study.design, clocks=clocks)
        who = wearer(study, who, before)
        after = movements(study, who, study.design, design, clocks)
        worn = [
            with_more(
                own,
                drives_answer(trial, who, today, design).given(
                    there.trial, trial.times
                ),
            )
            for own, trial, today, there in zip(
                worn, trials, who.trials, after, strict=True
            )
        ]
    built = study.alone(worn)
    built.model = design.model(study.model)
    return built, design.contact(contact)


def how_it_was(
    trial: Trial,
    model: Model,
    contact: ContactModel,
    settings: PredictionSettings,
) -> Trial:
    """A measured movement on the cuffs that it was measured on, with encoders.

    Raises:
        InputError: it cannot be solved.
    """
    problem = OwnMovement(model, [trial], contact, settings, seen=True)
    why = f"trial {trial.name}: encoders and markers do not fit these cuffs"
    return solved(problem, why).trials[0]


def built(
    made: Designed, study: Study, measured: Mapping[str, Sequence[Trial]]
) -> Designed:
    """A design with what was measured on it, once it was built.

    Args:
        made: the design.
        study: whose settings of prediction say how noisy that is.
        measured: wearer -> its trials on the design.

    Raises:
        InputError: one cannot be solved.
    """
    phase = replace(study.prediction, solver=made.settings.solver, guess="data")
    design = made.design
    seen = {
        w.name: [
            how_it_was(trial, w.model, w.contact, phase)
            for trial in measured[w.name]
            if "encoders" in trial.provenance
        ]
        for w in (made.worn[name].on(design) for name in measured)
    }
    seen = {name: trials for name, trials in seen.items() if trials}
    return replace(made, measured=measured, seen=seen)


def fewer(
    whole: Designed,
    forecast: Callable[[DesignResult], dict[str, list[Moved]]],
) -> Designed:
    """The best design with as few cuffs as it needs, by greedy removal.

    Each removable cuff (of a symmetric design, both of a pair) is left out in
    turn and all else designed again under all limits. The best of these designs
    replaces the present one if the norm of the forces in its forecast is less,
    and the removal is repeated. Costs are not compared: fractions of 0.02
    degrees by which a movement is off the person's own would decide.

    Args:
        whole: the design with every cuff.
        forecast: wearer -> movements on a design; raises InputError if nobody
            can move on it.
    """
    settings = whole.settings
    cuffs = whole.found.problem.wearers[0].model.cuffs
    removable = dict.fromkeys(
        frozenset({cuff, partner(cuff, cuffs, settings)})
        for cuff in cuffs
        if settings.freedom(cuff).removable
    )
    if not removable:
        return whole
    by_forecast = attrgetter("forecast_n")
    best, tried = whole, [_told(whole)]
    while True:
        rivals, left_out = [], best.found.problem.without
        for pair in removable:
            if pair <= {*left_out}:
                continue
            without = (*left_out, *sorted(pair))
            try:
                found = _without(whole.found, without)
                if found.solution.was_stopped:
                    raise KeyboardInterrupt
                rival = replace(whole, found=found, after=forecast(found))
                if not rival.held.stiffness > 0.0:
                    raise InputError(
                        f"as built the device would hang loose: {rival.held}"
                    )
            except KeyboardInterrupt:  # between solves, or in a forecast
                tried.append(Tried(without, why_not=STOPPED_BY_USER))
                best = min([best, *rivals], key=by_forecast)
                return replace(best, tried=tuple(tried), stopped=True)
            except InputError as error:
                tried.append(Tried(without, why_not=str(error)))
                continue
            tried.append(_told(rival))
            rivals.append(rival)
        least = min(rivals, key=by_forecast, default=best)
        if not least.forecast_n < best.forecast_n:
            return replace(best, tried=tuple(tried))
        best = least


def _without(found: DesignResult, without: tuple[str, ...]) -> DesignResult:
    """The design made again without some cuffs.

    Raises:
        InputError: the device would hang loose, or the solve failed.
    """
    problem = found.problem
    for wearer in problem.wearers:
        least = hold(wearer.on(design_of({}, without)))
        if not least.stiffness > 0.0:
            raise InputError(
                f"the device would hang loose on {wearer.name}: {least}"
            )
    rival = DesignProblem(
        problem.wearers, problem.settings, today=problem.today, without=without
    ).solve(on_iterate=SolveWatch(f"without {', '.join(without)}"))
    solution = rival.solution
    if not (solution.success or solution.was_stopped):
        raise InputError(f"{solution.status}: {solution.explain()}")
    return rival


def _told(made: Designed) -> Tried:
    found = made.found
    without, norm = found.problem.without, found.norm_n
    return Tried(without, norm, made.forecast_n, found.design)


# What is designed -> what its variables' names begin with.
_KINDS = {
    "places": (*PLACES.values(), "area"),
    "straps": (*STRAPS.values(), *RELEASES),
    "assistance": ("factor", *GAINS),
}


def _is(variable: Variable, kind: str) -> bool:
    return variable.name.partition(".")[2].startswith(_KINDS[kind])


def _with_parts(made: Designed) -> Designed:
    """With the norm of the forces that each kind of variable reaches alone.

    Of each kind of which something may change.
    """
    reached = {"nothing": made.today.norm_n}
    problem = made.found.problem
    kinds = [
        k for k in _KINDS if any(v.free and _is(v, k) for v in problem.design)
    ]
    fewer = ("fewer cuffs",) if problem.without else ()
    try:
        for kind in (*kinds, *fewer):
            found = _alone(made, kind)
            if found.solution.was_stopped:
                raise KeyboardInterrupt
            if found.solution.success:
                reached[f"{kind} alone"] = found.norm_n
    except KeyboardInterrupt:  # between solves, too
        made = replace(made, stopped=True)
    return replace(made, parts=reached | {"all": made.found.norm_n})


def _alone(made: Designed, kind: str) -> DesignResult:
    """The design with one kind of variable free, or with fewer cuffs alone."""
    problem = made.found.problem
    how = {"held": True, "without": problem.without}
    if kind in _KINDS:
        held = {
            v.name: v.today
            for v in made.today.problem.design
            if not _is(v, kind)
        }
        how = {"held": held}
    return DesignProblem(
        problem.wearers, made.settings, today=made.today, **how
    ).solve(on_iterate=SolveWatch(f"{kind} alone"))


SHARES = (0.25, 0.5, 0.75, 1.0, 1.25)


def pareto_front(
    made: Designed, shares: Sequence[float] = SHARES
) -> list[dict]:
    """The least norm of forces for each share of today's support.

    Args:
        made: a design that was found.
        shares: of the device's work of today, kept within the settings'
            limit or, where there is none, its default. Factors on its torques
            may go as low as the share asks for.

    Returns:
        Rows share, work_j, norm_n, success, design, and whether another one
        gives as much support for less (dominated): with little, the person
        bears the device. Fewer where the user stops a solve.
    """
    rows = []
    problem, settings = made.found.problem, made.settings
    low, high = settings.assistance
    limits = settings.limits
    if limits.support is None:  # a share that nothing keeps is none
        limits = replace(limits, support=DesignLimits().support)
    for share in shares:
        wide = replace(
            settings,
            limits=limits,
            assistance=(min(low, low * share), max(high, high * share)),
        )
        try:
            found = DesignProblem(
                problem.wearers,
                wide,
                today=made.today,
                support=share,
                without=problem.without,
            ).solve(on_iterate=SolveWatch(f"support x {share:g}"))
        except KeyboardInterrupt:  # between solves
            break
        if found.solution.was_stopped:
            break
        rows.append(
            {
                "share": share,
                "work_j": sum(works(found)[name] for name in made.before),
                "norm_n": found.norm_n,
                "success": found.solution.success,
                "design": asdict(design_of(found.values, problem.without)),
            }
        )
    solved = [row for row in rows if row["success"]]
    for row in rows:
        row["dominated"] = any(
            other["share"] >= row["share"] and other["norm_n"] < row["norm_n"]
            for other in solved
        )
    return rows
