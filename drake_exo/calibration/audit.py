"""Audit of a solution between its nodes and by simulation; RMS differences.

Equations of motion and contact laws hold at the nodes. Here they are evaluated
between nodes (states by the grid's polynomials, controls by cubic splines
through the nodes), and the motion is simulated in the Diagram, whose integrator
does not use the grid. `rmsd` and `spread` compare solution and measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from drake_exo.calibration.problem import (
    PhaseResult,
    check_coordinates,
    has_encoders,
)
from drake_exo.collocation.bushing_kernels import UNITS
from drake_exo.collocation.kernels import FORCE_UNIT, WRENCH_UNITS
from drake_exo.collocation.transcription import stands_for
from drake_exo.contact.bushing import CALIBRATED, ROTATION
from drake_exo.contact.diagram import build_diagram, integrate
from drake_exo.contact.systems import Chair_, TrackingController
from drake_exo.files.output import Check
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.planar_tree import PlanarTree

FORCE_TOLERANCE = 1.0  # N
MOMENT_TOLERANCE = 0.5  # N m
ANGLE_TOLERANCE = 0.1  # deg
# Integrator accuracy: damping of 600 N m s/rad turns errors of velocity into
# moments. At 1e-3 they exceed the tolerance, at 1e-4 they do in a walk with a
# device.
_ACCURACY = 1e-5
# Places in each interval at which residuals are evaluated.
_FRACTIONS = (0.25, 0.5, 0.75)
_BETWEEN = (
    "the contact laws and equations of motion hold at the nodes of the grid, "
    "but between nodes they are off by this much; solve on a finer grid "
    "(solver.nodes_per_second)"
)
_SIMULATED = (
    "a simulation does not reproduce the motion; the contact is too stiff for "
    "the grid (raise solver.nodes_per_second), or leaves the ground"
)
# Share of the force in a cuff's mats that a calibration may miss, and the RMS
# force below which mats show little but their steps.
_MISSED = 0.5
_FELT_N = 10.0


@dataclass(frozen=True)
class Audit:
    """Residuals of one trial.

    Attributes:
        trial: name of the trial.
        force_n: largest residual force between nodes [N].
        moment_nm: largest residual moment between nodes [N m].
        simulated_grf_n: RMS difference of the simulated ground reaction
            (horizontal, vertical) from the solution's.
        simulated_angles_deg: largest RMS difference of a joint angle.
        simulated_interaction_n: largest RMS difference of an interaction
            force; None without bushings.
        intervals: number of intervals of the grid.
        simulated_moments_nm: largest RMS, over the joints, of the moment that
            the simulation's feedback adds to the solution's.
    """

    trial: str
    force_n: float
    moment_nm: float
    simulated_grf_n: tuple[float, float]
    simulated_angles_deg: float
    simulated_interaction_n: float | None = None
    intervals: int = 0
    simulated_moments_nm: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether all residuals are within tolerance."""
        return all(check.holds for check in self.checks())

    def checks(self) -> list[Check]:
        """Residuals against tolerances: checks "audit" and "simulation"."""
        forces = [*self.simulated_grf_n, self.simulated_interaction_n or 0.0]
        worst = float(np.max(forces))
        rows = (
            ("audit", self.force_n, FORCE_TOLERANCE, "N", _BETWEEN),
            ("audit", self.moment_nm, MOMENT_TOLERANCE, "N m", _BETWEEN),
            ("simulation", worst, FORCE_TOLERANCE, "N", _SIMULATED),
            (
                "simulation",
                self.simulated_angles_deg,
                ANGLE_TOLERANCE,
                "deg",
                _SIMULATED,
            ),
            (
                "simulation",
                self.simulated_moments_nm,
                MOMENT_TOLERANCE,
                "N m",
                _SIMULATED,
            ),
        )
        return [
            # Written so that NaN fails.
            Check(name, value <= limit, value, limit, unit, self.trial, text)
            for name, value, limit, unit, text in rows
        ]

    def summary(self) -> dict:
        """Entry of this trial in summary.json."""
        return {**vars(self), "holds": self.holds}


def audit(result: PhaseResult, index: int = 0) -> Audit:
    """Residuals of one trial between its nodes and in a simulation.

    Args:
        result: solution of a phase.
        index: number of the trial in it.
    """
    found, simulated = result.trials[index], simulate(result, index)
    force, moment = between_nodes(result, index)
    joints = found.coordinates.joint_columns
    off = [
        simulated.cuffs[cuff].components[:, :ROTATION]
        - force.components[:, :ROTATION]
        for cuff, force in found.cuffs.items()
    ]
    times = found.times
    grf = rms(simulated.ground.force - found.ground.force, times)
    angles = rms(np.rad2deg(simulated.q - found.q)[:, joints], times)
    return Audit(
        found.name,
        float(force.max()),
        float(moment.max()),
        (float(grf[0]), float(grf[1])),
        float(angles.max()),
        float(rms(np.hstack(off), times).max()) if off else None,
        len(force),
        float(rms(simulated.moments - found.moments, times).max()),
    )


def between_nodes(
    result: PhaseResult, index: int
) -> tuple[np.ndarray, np.ndarray]:
    """Largest residual force [N], moment [N m] in each interval, (m,) each.

    Args:
        result: solution of a phase.
        index: number of the trial in it.
    """
    parts = [_residuals(result, index, fraction) for fraction in _FRACTIONS]
    return tuple(
        np.max([np.abs(part[kind]).max(axis=1) for part in parts], axis=0)
        for kind in range(2)
    )


def _residuals(
    result: PhaseResult, index: int, fraction: float
) -> tuple[np.ndarray, np.ndarray]:
    """Residual forces, moments (m, .) at one `fraction` of m intervals."""
    problem, found = result.problem, result.trials[index]
    grid = problem.movements[index].grid
    times = grid.mesh[:-1] + fraction * grid.steps
    q, v, a = grid.at(times, found.q, found.v, found.a, found.jerk)

    def at(values):
        return CubicSpline(found.times, values)(times)

    def repeated(values):
        return np.broadcast_to(values, (len(times), len(values)))

    cuffs = {c: at(force.components) for c, force in found.cuffs.items()}
    ground = {b: at(w) for b, w in _by_segment(result, index).items()}
    inputs = [q, v, a, at(found.moments), *ground.values(), *cuffs.values()]
    inputs += [repeated(result.contact.bushings[c].origin) for c in cuffs]
    movement = problem.movements[index]
    dynamics = FORCE_UNIT * movement.dynamics.evaluate(
        np.hstack(inputs), movement.loads(times)
    )
    value = result.contact.values()
    is_angle = found.coordinates.is_angle
    forces, moments = [dynamics[:, ~is_angle]], [dynamics[:, is_angle]]
    for body, wrench in ground.items():
        x = problem.law_inputs(result.contact, body, q, v, wrench)
        contact = WRENCH_UNITS * problem.kernels[body].evaluate(x, None)
        forces.append(contact[:, :2])
        moments.append(contact[:, 2:])
    for cuff, force in cuffs.items():
        values = repeated([value[f"{cuff}.{name}"] for name in CALIBRATED])
        law = problem.laws[cuff]
        r = UNITS * law.evaluate(np.hstack([q, v, force, values]), None)
        forces.append(r[:, :ROTATION])
        moments.append(r[:, ROTATION:])
    return np.hstack(forces), np.hstack(moments)


def _by_segment(result: PhaseResult, index: int) -> dict[str, np.ndarray]:
    """Segment that touches -> its ground reaction (n, 3) in a trial.

    Each foot's sum is the trial's; its segments share it as in the solution.
    """
    wrenches, found = dict(result.grounds[index]), result.trials[index]
    for side, bodies in result.problem.feet.items():
        others = sum(wrenches[body] for body in bodies[1:])
        wrenches[bodies[0]] = found.soles[side].array - others
    return wrenches


def simulate(result: PhaseResult, index: int = 0) -> Trial:
    """Simulate a trial in the Diagram with the phase's contact.

    The solution's torques act, plus feedback that keeps the model from falling.
    In Phase A, human and exoskeleton do not touch.

    Args:
        result: solution of a phase.
        index: number of the trial in it.

    Returns:
        The simulated motion at the solution's nodes; NaN after the time at
        which the integrator had to stop.
    """
    found, model = result.trials[index], result.problem.model
    built = build_diagram(
        model,
        result.contact,
        controller=TrackingController(
            found.times,
            found.q,
            found.v,
            found.a,
            found.moments,
            *holding_gains(model.tree, found),
        ),
        forces=_borne(model, result.problem.trials[index]),
    )
    diagram, times = built.diagram, found.times
    context = diagram.CreateDefaultContext()
    context.SetTime(times[0])
    context.SetContinuousState(np.hstack([found.q[0], found.v[0]]))
    motion = integrate(diagram, context, times[-1], accuracy=_ACCURACY)
    several = len(built.contacts) > 1
    grounds = {
        body: "ground_reaction" + (f"_{body}" if several else "")
        for body in built.contacts
    }
    held = built.bushings.parameters() if built.bushings else {}
    rows = {name: [] for name in ("state", "joint_torques", *grounds.values())}
    if held:
        rows["interaction_forces"] = []
    for time in times:
        known = time <= motion.t_max
        context.SetTime(time)
        context.SetContinuousState(motion(min(time, motion.t_max)))
        for name, values in rows.items():
            value = diagram.GetOutputPort(name).Eval(context)
            values.append(value if known else np.nan * value)
    signals = {name: np.array(values) for name, values in rows.items()}
    q, v = np.split(signals["state"], 2, axis=1)
    feet = {
        side: PlanarWrench.of(sum(signals[grounds[b]] for b in bodies))
        for side, bodies in result.problem.feet.items()
    }
    return Trial(
        found.name,
        found.coordinates,
        found.times,
        q,
        v,
        np.gradient(v, found.times, axis=0),
        PlanarWrench.of(sum(w.array for w in feet.values())),
        source="simulated",
        feet=feet if found.feet else {},
        moments=signals["joint_torques"],
        cuffs={
            cuff: CuffForce.of(signals["interaction_forces"][:, 3 * i :][:, :3])
            for i, cuff in enumerate(held)
        },
    )


def holding_gains(tree: PlanarTree, trial: Trial) -> tuple[float, float]:
    """Feedback gains of a joint, enough to balance the body above it.

    A body supported by the force F with its centre of mass at height h falls
    over below a stiffness of F h. Twice that is used, critically damped for a
    mass F/g at h; with less, errors of integration grow without limit.

    Args:
        tree: the model's.
        trial: its ground reaction gives F, its postures h.

    Returns:
        Stiffness [N m/rad] and damping [N m s/rad].
    """
    force = float(trial.ground.force_z.max())
    height = float(tree.center_of_mass(trial.q)[:, 1].max())
    stiffness = 2.0 * force * height
    inertia = force / tree.gravity * height**2
    return stiffness, 2.0 * np.sqrt(stiffness * inertia)


def _borne(model, trial: Trial) -> list:
    """Systems that apply a trial's chair and carried loads, if it has any."""
    plant, systems = model.plant(), []
    for shares, wrench in trial.borne():
        bodies = {
            plant.GetBodyByName(name).index(): share
            for name, share in shares.items()
        }
        system = Chair_[float](bodies, trial.times, wrench.array)
        system.set_name(f"borne_{len(systems)}")
        systems.append(system)
    return systems


_PHASE_SAMPLES = 101


def rms(values: np.ndarray, times: np.ndarray | None = None) -> np.ndarray:
    """Root mean square over time, ignoring NaN.

    Args:
        values: (n, m), or (n,).
        times: (n,) [s]; each value is weighted by the time it stands for, so
            that finer parts of a grid do not count more. None: equal weights.

    Returns:
        (m,), or a number; NaN where all values are NaN.
    """
    steps = np.ones(len(values) - 1) if times is None else np.diff(times)
    lengths = stands_for(steps)
    known = ~np.isnan(values)
    square = np.where(known, values, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        return np.sqrt(lengths @ square / (lengths @ known))


def rmsd(found: Trial, measured: Trial, loads: bool = True) -> dict:
    """Root mean square differences of one trial.

    Args:
        found: the model's.
        measured: the same trial as measured.
        loads: compare joint moments and interaction forces, which mean
            nothing while human and exoskeleton do not touch (Phase A).

    Returns:
        The trial's name (trial); angles_deg and velocities_deg_s by joint
        (the device's only if it has encoders); the root's pose under its name
        (x_mm, z_mm, pitch_deg); grf_n (horizontal, vertical) and cop_mm, by
        foot if there are two; moments_nm by joint and interaction_n (normal
        force) by cuff, empty if not measured.

    Raises:
        InputError: the measured trial is of another model.
    """
    names = found.coordinates
    check_coordinates(measured, names)
    at = measured.sample(found.times)
    times = found.times
    d_q, d_v = rms(found.q - at.q, times), rms(found.v - at.v, times)
    grf, cop = {}, {}
    for side, measured_wrench in at.soles.items():
        wrench = found.soles[side]
        d_ground = rms(wrench.force - measured_wrench.force, times)
        off = (wrench.cop_x - measured_wrench.cop_x)[:, None]
        end = "" if side == "both" else f" {side}"
        grf |= _by_name((f"horizontal{end}", f"vertical{end}"), d_ground)
        cop[side] = float(1e3 * rms(off, times)[0])
    x, z, pitch = d_q[names.root_columns]
    moments, interaction = {}, {}
    if at.moments is not None and loads:
        moments = _by_name(names.joints, rms(found.moments - at.moments, times))
    for cuff, force in at.cuffs.items():
        if cuff in found.cuffs:
            off = found.cuffs[cuff].normal - force.normal
            interaction[cuff] = float(rms(off, times))
    angles, rates = _of_joints(names, d_q), _of_joints(names, d_v)
    if not has_encoders(measured):
        for joint in names.device:
            del angles[joint], rates[joint]
    return {
        "trial": found.name,
        "angles_deg": angles,
        "velocities_deg_s": rates,
        names.root[0].removesuffix("_x"): {
            "x_mm": float(1e3 * x),
            "z_mm": float(1e3 * z),
            "pitch_deg": float(np.rad2deg(pitch)),
        },
        "grf_n": grf,
        "cop_mm": cop.get("both", cop),
        "moments_nm": moments,
        "interaction_n": interaction,
    }


def spread(trials: Sequence[Trial], tree: PlanarTree) -> dict:
    """Standard deviation over the measured trials, time-normalised.

    The standard deviation at each percent of the movement, averaged over the
    movement; the paper compares its RMSD with that. NaN for a single trial.
    Keys as in `rmsd`. Device joints: over trials with encoders. The centre of
    pressure: relative to its own foot, at times when all trials load that foot.

    Args:
        trials: measured, on the clocks that were found.
        tree: the model's.
    """
    names = trials[0].coordinates
    sampled = [
        t.sample(np.linspace(0.0, t.duration, _PHASE_SAMPLES)) for t in trials
    ]

    def deviation(signal, of=sampled):
        values = np.stack([signal(t) for t in of])
        if len(values) < 2:
            return np.full(values.shape[2:], np.nan)
        sd = np.ma.masked_invalid(values.std(axis=0, ddof=1))
        return np.ma.filled(sd.mean(axis=0), np.nan)

    own = [s for t, s in zip(trials, sampled, strict=True) if has_encoders(t)]

    def of_joints(signal):
        found = _of_joints(names, deviation(signal))
        told = _of_joints(names, deviation(signal, own or sampled[:1]))
        return found | {joint: told[joint] for joint in names.device}

    moments, interaction = {}, {}
    if all(t.moments is not None for t in trials):
        found = deviation(lambda t: t.moments)
        moments = _by_name(names.joints, found)
    for cuff in dict.fromkeys(c for t in trials for c in t.cuffs):
        having = [t for t in sampled if cuff in t.cuffs]
        found = deviation(lambda t, c=cuff: t.cuffs[c].normal, having)
        interaction[cuff] = None if np.isnan(found) else float(found)
    grf, cop = {}, {}
    for side in trials[0].soles:
        foot = tree.root if side == "both" else f"foot_{side}"
        end = "" if side == "both" else f" {side}"
        force = deviation(lambda t, side=side: t.soles[side].force)
        grf |= _by_name((f"horizontal{end}", f"vertical{end}"), force)
        with np.errstate(invalid="ignore"):
            cop[side] = 1e3 * deviation(
                lambda t, side=side, foot=foot: (
                    t.soles[side].cop_x - tree.point_positions(t.q, foot)[:, 0]
                )
            )
    return {
        "angles_deg": of_joints(lambda t: t.q),
        "velocities_deg_s": of_joints(lambda t: t.v),
        "grf_n": grf,
        "cop_mm": cop.get("both", cop),
        "moments_nm": moments,
        "interaction_n": interaction,
    }


def _of_joints(names, values) -> dict[str, float]:
    """Joint -> its value in degrees, of values (nq,) [rad]."""
    return _by_name(names.joints, np.rad2deg(values[names.joint_columns]))


def cuff_checks(
    found: Sequence[Trial], measured: Sequence[Trial]
) -> list[Check]:
    """Notes: whether calibrated cuffs bear what their mats measured.

    No cuff can if the device's moments, or the mats, count the other way; the
    best one then bears next to nothing.

    Args:
        found: solved trials.
        measured: the same trials as measured.
    """
    made = []
    for cuff in found[0].cuffs:
        off, shown = [], []
        for trial, own in zip(found, measured, strict=True):
            if cuff in own.cuffs:
                normal = own.sample(trial.times).cuffs[cuff].normal
                shown.append(rms(normal, trial.times))
                more = trial.cuffs[cuff].normal - normal
                off.append(rms(more, trial.times))
        if not shown:
            continue
        off, shown = (
            float(np.sqrt(np.mean(np.square(of)))) for of in (off, shown)
        )
        value = off / max(shown, _FELT_N)
        text = (
            f"the calibrated cuff is off by {off:.1f} N where its mats show "
            f"{shown:.1f} N (RMS): the device's moments or these mats may "
            "count the other way, or the mats may lie under another cuff"
        )
        holds = value <= _MISSED
        made.append(
            Check("cuffs", holds, value, _MISSED, "", cuff, text, "note")
        )
    return made


def _by_name(names, values) -> dict[str, float]:
    return {name: float(v) for name, v in zip(names, values, strict=True)}
