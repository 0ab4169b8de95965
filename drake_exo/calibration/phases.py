"""Phases A and B (calibration) and C (prediction) posed as programs.

After Serrancoli et al., II-C; docs/method.md says what each tracks, minimises
and constrains. In Phase A human and exoskeleton do not touch. In Phase C the
objective "comfort" tracks nothing, nor does `PeriodicStep`, a step that ends in
the mirrored state in which it began and so can be repeated for ever.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pydrake.systems.framework import System

from drake_exo.calibration.audit import rmsd
from drake_exo.calibration.problem import (
    Answer,
    Parts,
    PhaseProblem,
    PhaseResult,
    ground_terms,
    has_encoders,
    kinematic_terms,
    normal_force_terms,
    torque_terms,
    typical_jerk,
)
from drake_exo.calibration.settings import (
    FootGroundSettings,
    InteractionSettings,
    PredictionSettings,
)
from drake_exo.collocation.initial_guess import straight_line
from drake_exo.collocation.kernels import ControllerKernel, SoleKernel
from drake_exo.collocation.trial_program import (
    Tracking,
    TrialProgram,
    minimised,
)
from drake_exo.contact.bushing import COMPONENTS, NORMAL
from drake_exo.contact.parameters import (
    ContactModel,
    ContactParameter,
    GroundContact,
)
from drake_exo.errors import InputError, check_type
from drake_exo.files import schema
from drake_exo.files.output import Progress
from drake_exo.files.tables import runs
from drake_exo.measurement.trial import Trial, as_trials, saw_device
from drake_exo.model.assembly import other_side
from drake_exo.model.coordinates import Coordinates
from drake_exo.model.plant import Model
from drake_exo.nlp.program import LinearKernel


class FootGroundCalibration(PhaseProblem):
    """Phase A posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: measured.
        settings: noise, bounds, grid.
        parameters: to calibrate; the settings' by default; an empty list
            calibrates none.
        ground: known contact of a sole; then no parameters are calibrated.
        refined: finer intervals, see `PhaseProblem`.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> model, (trial,) = synthetic.rises_on_spheres(1, nodes_per_second=40)
    >>> posed = FootGroundCalibration(model, [trial])
    >>> posed.program.prog.num_vars() > 1000
    True
    """

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        settings: FootGroundSettings | None = None,
        parameters: list[ContactParameter] | None = None,
        *,
        ground: GroundContact | None = None,
        refined: Mapping[str, Parts] | None = None,
    ):
        check_type(model, Model, "model")
        settings = schema.checked(settings, FootGroundSettings, "settings")
        trials = as_trials(trials)
        if ground is None:
            contact = settings.contact(model.spheres)
            if parameters is None:
                parameters = settings.parameters(model.spheres)
        else:
            check_type(ground, GroundContact, "ground")
            contact, parameters = ContactModel(ground), []
        for parameter in parameters:
            check_type(parameter, ContactParameter, "parameters")
        if not parameters:  # PhaseProblem sets the jerk only with parameters
            contact = replace(contact, jerk=typical_jerk(trials))
        super().__init__(
            model, trials, contact, parameters, settings, refined=refined
        )

    def _terms(self, movement, at, effects):
        noise = self.settings.noise
        return [
            *kinematic_terms(movement, at, noise),
            *ground_terms(movement, at, noise),
            minimised(movement.torque, noise.torque_nm),
        ]


FRONT_KINDS = ("angles_deg", "velocities_deg_s", "grf_n", "cop_mm")


def pareto_front(result: PhaseResult) -> list[dict]:
    """Calibrate again with the noise of ground reaction and CoP scaled.

    Args:
        result: Phase A's with unscaled noise; its settings' `front_factors` are
            used.

    Returns:
        One row for each factor: factor, success, and for each of FRONT_KINDS
        mean and worst RMSD; fewer rows if the user stops a solve.
    """
    rows = []
    factors = result.problem.settings.front_factors
    progress = Progress("front", total=len(factors))
    for i, factor in enumerate(factors):
        try:
            found = result if factor == 1.0 else _scaled(result, factor)
            row = _row(factor, found)
        except KeyboardInterrupt:  # between solves
            break
        if found.solution.was_stopped:
            break
        rows.append(row)
        progress.update(f"factor {factor:g}", done=i + 1)
    return rows


def _scaled(result: PhaseResult, factor: float) -> PhaseResult:
    problem = result.problem
    settings, noise = problem.settings, problem.settings.noise
    scaled = replace(
        noise, force_n=factor * noise.force_n, cop_m=factor * noise.cop_m
    )
    return FootGroundCalibration(
        problem.model,
        problem.trials,
        replace(settings, noise=scaled),
        problem.parameters,
        refined=problem.refined,
    ).solve(near=result)


def _row(factor: float, found: PhaseResult) -> dict:
    success = found.success
    found = found if success else found.unsealed()
    scores = [
        rmsd(t, measured)
        for t, measured in zip(found.trials, found.problem.trials, strict=True)
    ]
    row = {"factor": factor, "success": success}
    for kind in FRONT_KINDS:
        values = np.hstack(
            [
                list(s[kind].values()) if isinstance(s[kind], dict) else s[kind]
                for s in scores
            ]
        )
        row[kind] = float(np.mean(values))
        row[f"{kind}_worst"] = float(np.max(values))
    return row


EVERY = list(range(len(COMPONENTS)))


class InteractionCalibration(PhaseProblem):
    """Phase B posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: measured.
        contact: calibrated for foot and ground; its bushings are not used.
        settings: noise, bounds, grid.
        refined: finer intervals, see `PhaseProblem`.
        solved: solutions of the trials, see `ErrorModel`.

    Raises:
        InputError: the model has no cuffs.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> posed = InteractionCalibration(made.model, made.trials, made.contact)
    >>> [p.name for p in posed.parameters][:2]
    ['shank.origin_x', 'shank.origin_z']
    """

    # Parameters multiply what moves: steps without them creep.
    exact_near = True

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: InteractionSettings | None = None,
        *,
        refined: Mapping[str, Parts] | None = None,
        solved: Sequence[Trial] = (),
    ):
        check_type(model, Model, "model")
        check_has_cuffs(model)
        settings = schema.checked(settings, InteractionSettings, "settings")
        check_type(contact, ContactModel, "contact")
        bushings = {
            cuff: replace(own, preload_x=x, preload_z=z)
            for cuff, own in settings.bushings(model.cuffs).items()
            for x, z in [model.preload(cuff)]
        }
        super().__init__(
            model,
            trials,
            replace(contact, bushings=bushings, posterior=None),
            settings.parameters(model.cuffs),
            settings,
            settings.errors,
            refined=refined,
            solved=solved,
        )

    def _terms(self, movement, at, effects):
        noise = self.settings.noise
        return [
            *kinematic_terms(
                movement, at, noise, effects, encoders=has_encoders(at)
            ),
            *ground_terms(movement, at, noise),
            *torque_terms(movement, at, noise, effects),
            *normal_force_terms(movement, at, noise, effects),
        ]

    def _add(self, trial: Trial) -> TrialProgram:
        movement = super()._add(trial)
        unmeasured = {
            cuff: [c for c in EVERY if c != NORMAL or cuff not in trial.cuffs]
            for cuff in self.bushings
        }
        self.minimise_energy(movement, unmeasured)
        return movement


def check_has_cuffs(model: Model) -> None:
    """Raises InputError if the model has no cuffs."""
    if not model.cuffs:
        raise InputError(
            "the study's model has no exoskeleton with cuffs; say "
            "'model: coupled' or describe one; for a person alone there are "
            "'calibrate --phase foot-ground' and 'predict'"
        )


def check_knows_cuffs(contact: ContactModel, model: Model) -> None:
    """Raises InputError if the model has cuffs that the contact lacks."""
    unknown = [cuff for cuff in model.cuffs if cuff not in contact.bushings]
    if unknown and contact.bushings:
        raise InputError(
            f"the calibration knows the cuffs {', '.join(contact.bushings)}, "
            f"not the model's {', '.join(unknown)}; calibrate with this model"
        )
    if unknown:
        raise InputError(
            "the calibration holds no interaction parameters; calibrate the "
            "cuffs, too (--phase interaction)"
        )


def check_is_measured(trials: Sequence[Trial]) -> None:
    """Raises InputError if nothing of the device was measured, or no angles.

    Cuffs are calibrated with the device's angles, moments or mats; without
    angles it is not known how far they are deflected.
    """
    if not any(map(saw_device, trials)):
        raise InputError(
            "nothing of the exoskeleton was measured: no trial has encoders, "
            "exo_moments or pressure, and the study has no device; say "
            "'model: human' if none was worn, or calibrate foot and ground "
            "alone (--phase foot-ground)"
        )
    if not any(map(has_encoders, trials)):
        raise InputError(
            "no trial has encoders, and without them it is not known where the "
            "device was on its cuffs; give those of at least one trial"
        )


# Weight of tracking an end state, as seconds of tracking: about as long as
# noise of a signal stays the same.
END_WEIGHT_S = 1.0
_TOES_RAD = np.deg2rad(3.0)


class PredictionProblem(PhaseProblem):
    """Phase C posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: their kinematics give end states and duration; they are
            compared with the prediction, not tracked.
        contact: calibrated.
        settings: objective, noise, grid.
        controller: gives the exoskeleton's torques; None if they are measured
            (tracked) or free.
        answers: trial -> how springs' torques change if the device moves
            otherwise than measured; trials not named have none.
        refined: finer intervals, see `PhaseProblem`.

    >>> from drake_exo.virtual_laboratory import synthetic
    >>> made = synthetic.rises_in_device(1, nodes_per_second=40)
    >>> posed = PredictionProblem(made.model, made.trials, made.contact)
    >>> sorted(posed.bushings)
    ['pelvis', 'shank', 'thigh']

    What is added to the program counts in the next `solve`; its `values` are
    those of all program variables:

    >>> (rise,) = posed.movements
    >>> knee = rise.grid.q[:, rise.coordinates.index("knee")]
    >>> _ = posed.program.prog.AddBoundingBoxConstraint(0.0, 2.0, knee)
    >>> found = posed.solve()
    >>> values = found.values[posed.program.indices(knee)]
    >>> bool((values == found.trials[0].coordinate("knee")).all())
    True

    Raises:
        InputError: the model has cuffs that the contact lacks; or the
            controller cannot be used.
        ValueError: the settings ask for other ends, see `PeriodicStep`.
    """

    ends = "measured"
    # A device whose motion is not tracked would swing on its cuffs: less jerk.
    jerk_share = 0.5

    def __init__(
        self,
        model: Model,
        trials: Sequence[Trial],
        contact: ContactModel,
        settings: PredictionSettings | None = None,
        *,
        controller: System | None = None,
        answers: Mapping[str, Answer | None] | None = None,
        refined: Mapping[str, Parts] | None = None,
    ):
        check_type(model, Model, "model")
        usual = PredictionSettings(ends=self.ends)
        settings = schema.checked(
            settings, PredictionSettings, "settings", usual
        )
        check_type(contact, ContactModel, "contact")
        if settings.ends != self.ends:
            raise ValueError(f"the settings ask for {settings.ends} ends")
        check_knows_cuffs(contact, model)
        self._answers = answers or {}
        self._controller = (
            None
            if controller is None
            else ControllerKernel(controller, len(model.coordinates.device))
        )
        # A human alone has no use for the cuffs of a calibration.
        own = {cuff: contact.bushings[cuff] for cuff in model.cuffs}
        contact = replace(contact, bushings=own)
        super().__init__(
            model,
            self._posed(trials, settings),
            contact,
            [],
            settings,
            settings.errors,
            refined,
        )

    def _posed(self, trials, settings: PredictionSettings):
        """The trials as they enter the program."""
        return trials

    def _terms(self, movement, at, effects):
        noise, toes = self.settings.noise, _held_toes(movement, at)
        if self.settings.objective == "comfort":
            return [minimised(movement.torque, noise.torque_nm), *toes]
        return [
            *ground_terms(movement, at, noise),
            *torque_terms(
                movement,
                at,
                noise,
                effects,
                device=self._controller is None,
                answer=self._answers.get(movement.name),
            ),
            *toes,
        ]

    @property
    def _end_reach(self) -> float:
        # Without unknown errors end states are given: nothing else fixes them.
        return super()._end_reach if self.errors.unknowns else 0.0

    def _hold_ends(self, movement: TrialProgram, at: Trial) -> None:
        super()._hold_ends(movement, at)
        effects = self._effects(at)
        if effects is None and len(self.feet) == 1:
            return
        # Joints are bounded only loosely then: the ends are tracked as well.
        at_ends = np.zeros(len(at.times))
        at_ends[[0, -1]] = END_WEIGHT_S
        movement.add_tracking_cost(
            kinematic_terms(
                movement,
                at,
                self.settings.noise,
                effects,
                encoders=has_encoders(at),
            ),
            self.error_variables,
            at_ends,
        )

    def _add(self, trial: Trial) -> TrialProgram:
        movement = super()._add(trial)
        limit = self.settings.torque_limit_nm
        movement.bound(movement.torque, -limit, limit)
        everything = dict.fromkeys(self.bushings, EVERY)
        self.minimise_energy(movement, everything)
        if self._controller is not None:
            self._drive(movement)
        return movement

    def _drive(self, movement: TrialProgram) -> None:
        """Tie the exoskeleton's torques to the controller."""
        grid, names = movement.grid, movement.coordinates
        device = names.device_columns
        torque = movement.torque[:, names.is_device_joint]
        self.program.add_constraints(
            f"{movement.name} controller",
            self._controller,
            np.hstack([grid.q[:, device], grid.v[:, device], torque]),
            data=grid.times[:, None],
        )

    def _start(self, movement: TrialProgram, trial: Trial) -> Trial:
        steps = len(self.feet) > 1
        if self.settings.guess == "line" and steps:
            raise InputError(
                "prediction.guess: a line between the ends cannot start a "
                "movement whose legs step; say data, or leave it out"
            )
        if steps or self.settings.guess == "data":
            return super()._start(movement, trial)
        return straight_line(trial, movement.grid.times)


def _held_toes(movement: TrialProgram, at: Trial) -> list[Tracking]:
    """Tracking of hinged toes near the line between their end angles.

    They weigh next to nothing, and their share of a plate's force is not known:
    they would flutter otherwise.
    """
    toes = [n for n in at.coordinates.joints if n.startswith("toes")]
    if not toes:
        return []
    columns = at.coordinates.columns(toes)
    share = (at.times / at.times[-1])[:, None]
    line = (1.0 - share) * at.q[0, columns] + share * at.q[-1, columns]
    return [Tracking(movement.grid.q[:, columns], line, _TOES_RAD)]


# Ranges of the joints in a periodic step (American Academy of Orthopaedic
# Surgeons); ankles bend further under load.
_RANGES_DEG = {
    "hip": (-30.0, 120.0),
    "knee": (0.0, 140.0),
    "ankle": (-50.0, 35.0),
    "toes": (-30.0, 70.0),
}


class PeriodicStep(PredictionProblem):
    """A periodic step posed as a MathematicalProgram.

    Args:
        model: subject and device.
        trials: initial guess and duration of each step.
        contact: calibrated.
        settings: speed, clearance, bounds, effort, grid.

    Raises:
        InputError: the model has one leg for both; or as PredictionProblem.
    """

    ends = "periodic"

    def _posed(self, trials, settings):
        speed = settings.speed_m_s
        if speed is None:
            return trials
        return [_loads_at(speed, trial) for trial in as_trials(trials)]

    def _terms(self, movement, at, effects):
        return [minimised(movement.torque, self.settings.noise.torque_nm)]

    def _hold_ends(self, movement: TrialProgram, at: Trial) -> None:
        grid, names = movement.grid, movement.coordinates
        x, *_ = names.root_columns
        other = mirrored(names)
        _check_is_one_step(at, other)
        speed = self.settings.speed_m_s
        if speed is None:
            speed = _speed(at)
        ahead = np.zeros(len(names))
        ahead[x] = speed * at.duration
        movement.bound(grid.q[0, [x]], at.q[0, [x]], at.q[0, [x]])
        # The root's accelerations follow from the other mirrored states.
        for what, values, rows, gain in (
            ("positions", grid.q, slice(None), ahead),
            ("velocities", grid.v, slice(None), 0.0),
            ("accelerations", grid.a, names.joint_columns, 0.0),
        ):
            self.program.add_constraints(
                f"{movement.name} mirrored {what}",
                LinearKernel(np.hstack([np.eye(len(names)), -other])[rows]),
                np.hstack([values[-1], values[0]])[None],
                gain,
                gain,
            )

    def _add(self, trial: Trial) -> TrialProgram:
        movement = super()._add(trial)
        grid, names = movement.grid, movement.coordinates
        at = trial.sample(grid.times)
        for side, bodies in self.feet.items():
            swings = _middle(
                ~at.feet[side].is_loaded,
                grid.times,
                at.duration / len(grid.parts),
            )
            for body in bodies if len(swings) else ():
                self.program.add_constraints(
                    f"{movement.name} clearance of {body}",
                    SoleKernel(self.sphere_values(self.contact, body)),
                    movement.poses[body][swings],
                    self.settings.clearance_m,
                    np.inf,
                )
        for name in names.human:
            lower, upper = np.deg2rad(_RANGES_DEG[name.split("_")[0]])
            q, own = grid.q[:, names.index(name)], at.coordinate(name)
            movement.bound(q, min(lower, own.min()), max(upper, own.max()))
        return movement


def _speed(trial: Trial) -> float:
    """Mean forward speed of the root [m/s]."""
    x, *_ = trial.coordinates.root_columns
    return (trial.q[-1, x] - trial.q[0, x]) / trial.duration


def _check_is_one_step(trial: Trial, other: np.ndarray) -> None:
    """Refuse a trial that ends as it begins with legs not exchanged.

    Args:
        trial: start of the search for a step.
        other: as of `mirrored`.
    """
    columns = trial.coordinates.columns(trial.coordinates.human)
    first, last = trial.q[[0, -1]]
    same, exchanged = (
        np.linalg.norm((last - q)[columns]) for q in (first, other @ first)
    )
    if same < 0.5 * exchanged:
        raise InputError(
            f"trial {trial.name}: ends with legs as they began, but with "
            "prediction.ends: periodic it is one step, which ends with legs "
            "exchanged; end it at the same event of the other foot, as from: "
            "toe_off left 1, to: toe_off right 1"
        )


def _loads_at(speed_m_s: float, trial: Trial) -> Trial:
    """A step whose applied loads move with a person of another speed."""
    ahead = (speed_m_s - _speed(trial)) * (trial.times - trial.times[0])
    moved = {body: w.shifted(ahead) for body, w in trial.applied.items()}
    return replace(trial, applied=moved)


def mirrored(names: Coordinates) -> np.ndarray:
    """Matrix (nq, nq) that exchanges left and right.

    A device joint's sign may be opposite to that on the other side. If none has
    its name with the other side, its counterpart is the one that turns with the
    other leg.

    Raises:
        InputError: a coordinate has no counterpart, or a device joint's is
            beside other joints of the person.
    """
    found = np.zeros((len(names), len(names)))
    human, device = names.columns(names.human), names.device_columns
    for i, name in enumerate(names.names):
        opposite = other_side(name)
        if i in human and opposite == name:
            raise InputError(
                f"prediction.ends: {name} stands for both legs at once, but a "
                "periodic step needs two; say human: {legs: two}"
            )
        if i not in device or (opposite != name and opposite in names.device):
            found[i, names.index(opposite)] = 1.0
    turned = names.turned_by @ found[np.ix_(human, human)]
    unpaired = ~found[device].any(axis=1)
    rows = np.abs(names.turned_by)
    for k in np.flatnonzero(unpaired):
        alike = unpaired & np.isclose(rows, np.abs(turned[k])).all(axis=1)
        alike[k] = False
        if alike.sum() != 1:
            raise InputError(
                f"prediction.ends: which joint is that of {names.device[k]} on "
                "the other leg is not known; give both in the device's file "
                "names that differ in left and right alone, as knee_left and "
                "knee_right"
            )
        found[device[k], device[alike]] = 1.0
    beside = found[np.ix_(device, device)] @ names.turned_by
    for name, i, own, other in zip(
        names.device, device, turned, beside, strict=True
    ):
        if not np.allclose(np.abs(own), np.abs(other)):
            raise InputError(
                f"prediction.ends: {name} turns with other joints of the "
                "person than its counterpart on the other leg does; a periodic "
                "step needs a device that is alike left and right"
            )
        found[i] *= -1.0 if own @ other < 0.0 else 1.0
    return found


def _middle(free: np.ndarray, times: np.ndarray, step: float) -> np.ndarray:
    """Indices of nodes in the middle half of the longest time without load.

    Args:
        free: (n,) whether a node is without load.
        times: (n,) times of the nodes [s].
        step: interval of the grid before refinement [s].
    """
    spans = [(times[a], times[b - 1]) for a, b in runs(free)]
    counts = [round((end - start) / step) + 1 for start, end in spans]
    if not counts:
        return np.arange(0)
    longest = int(np.argmax(counts))
    start, end = spans[longest]
    quarter = (counts[longest] // 4 - 1e-6) * step
    return np.flatnonzero((times > start + quarter) & (times < end - quarter))
