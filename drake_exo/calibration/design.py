"""Phase D: cuffs and assistance for the people who will wear them.

All trials of all wearers are one program (`DesignProblem`) that shares the
design variables: place of each cuff, compliance of its straps, assistance at
the device's joints. Minimised are a smooth peak (a norm of high order) or the
mean of the cuffs' forces over time, cuffs, trials and wearers, and the person's
effort. Limits on what is felt and on the device's work are named bounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drake_exo.calibration.design_variables import (
    OFFSETS,
    PRELOADS,
    Variable,
    assistance_of,
    design_of,
    design_variables,
    is_assistance,
    joints_below,
    mirror_of,
)
from drake_exo.calibration.problem import (
    Compiles,
    PhaseProblem,
    bound_feet,
    ground_terms,
    kinematic_terms,
)
from drake_exo.calibration.settings import (
    DesignSettings,
    InteractionNoise,
    PredictionEnds,
    PredictionSettings,
)
from drake_exo.calibration.wearers import Wearer, assisted, check_wearers
from drake_exo.collocation.bushing_kernels import (
    INTERACTION_FORCE_UNIT,
    AssistanceKernel,
    CuffKernel,
    DesignDynamicsKernel,
    ForceNormKernel,
    MigrationKernel,
    MovedWeight,
    ProductKernel,
)
from drake_exo.collocation.kernels import MOMENT_UNIT
from drake_exo.collocation.trial_program import TrialProgram, minimised
from drake_exo.contact.bushing import NORMAL, TANGENTIAL
from drake_exo.contact.strap import (
    BY_AREA,
    RELEASES,
    STRAPS,
    CuffDesign,
    Design,
    weight_above,
)
from drake_exo.errors import InputError
from drake_exo.measurement.trial import Trial
from drake_exo.nlp import ipopt
from drake_exo.nlp.ipopt import Iterate, Solution
from drake_exo.nlp.program import BatchedProgram
from drake_exo.nlp.sensitivity import Optimum
from drake_exo.nlp.sparse import SparseProgram

# Typical size of jerk in a design's cost, as a multiple of the contact's.
_LOOSE = 10.0
# Cost of a change by its typical size: what gains less stays unchanged.
_LEAST_GAIN = 1e-3
# Least scale of the force norm, so that the objective has one without forces.
_LEAST_SCALE_N = 5.0
# Cost of all migration beyond its limit today, as a multiple of the forces'
# cost: the limit takes precedence wherever it can be kept.
_BEYOND = 5.0
# Weight of the objective where nothing changes: so small that the movement
# stays the person's own and the device does not swing to lower forces.
_LIGHT = 0.1
_POWER_UNIT_W = 10.0
_RATE = "rate of normal force"
# Inputs that place every cuff (origin, preloads), see BushingKinematics.
_NUM_PLACES = 2 + len(PRELOADS)


class _Wearing(PhaseProblem):
    """One wearer's trials within the program of a design.

    Args:
        wearer: without the cuffs that the design leaves out.
        posed: the design problem, with its variables.
        scale: unit of the forces in the norm [N].
        weights_s: sum of all nodes' weights, over cuffs, trials, wearers [s].
    """

    def __init__(
        self,
        wearer: Wearer,
        posed: DesignProblem,
        scale: float,
        weights_s: float,
    ):
        self.wearer, self.posed = wearer, posed
        self._scale, self._weights_s = scale, weights_s
        # None while today's solution is not known: then there are no limits.
        self._today = posed.today and posed.today.wearers[wearer.name]
        settings = posed.settings
        jerk = settings.jerk or _LOOSE * wearer.contact.jerk
        phase = PredictionSettings(
            noise=InteractionNoise(jerk=jerk),
            solver=settings.solver,
            guess="data",
        )
        # Each cuff's origin and compliances (variables), given by the design.
        self.built: list[np.ndarray] = []
        # Each trial's joint travel of the device that a node stands for [rad].
        self._ways: list[np.ndarray] = []
        self._total = None
        # (quantity that is limited, cuff or joint, movement) -> its variables.
        self._limited: dict[tuple[str, str, str], np.ndarray] = {}
        self._means: dict[str, np.ndarray] = {}
        self._beyond: dict[str, np.ndarray] = {}
        super().__init__(
            wearer.model,
            [replace(t, name=f"{wearer.name} {t.name}") for t in wearer.trials],
            wearer.contact,
            [],
            phase,
            program=posed.program,
        )
        self._limit_mean()
        self._limit_support()

    def moving(self, cuff: str):
        """See PhaseProblem: the preload, and joints whose place may move."""
        joints = joints_below(self.model, cuff)
        links = [self.tree.cuffs[cuff][1]]
        links += [self.tree.joints[joint][0] for joint in joints]
        return [
            (self._segment(link), way) for link in links for way in (1.0, 1j)
        ]

    def places(self, cuff: str) -> np.ndarray:
        """See PhaseProblem."""
        names = [f"{cuff}.{w}" for w in PRELOADS]
        for joint in joints_below(self.model, cuff):
            names += [f"{joint}.{w}" for w in OFFSETS]
        moved = [self.posed.variables[n] for n in names]
        return np.concatenate([super().places(cuff), moved])

    def equations(self, tree, bodies, bushings, load):
        """See PhaseProblem; with the weight of links at moved joints."""
        moved, known = [], set()
        for b, cuff in enumerate(self.bushings):
            for k, joint in enumerate(joints_below(self.model, cuff)):
                if joint in known:
                    continue
                known.add(joint)
                weight = weight_above(self.model, joint)
                segment = self._segment(tree.joints[joint][0])
                first = _NUM_PLACES + 2 * k
                moved += [
                    MovedWeight(b, first, segment, weight),
                    MovedWeight(b, first + 1, segment, 1j * weight),
                ]
        return DesignDynamicsKernel(tree, bodies, bushings, load, moved)

    def _segment(self, link: str) -> int:
        return int(self.tree.segment_of[self.tree.body_index(link)])

    def _of_cuff(self, cuff: str, names) -> np.ndarray:
        """A cuff's design variables of these names."""
        return np.array([self.posed.variables[f"{cuff}.{n}"] for n in names])

    def _add_group(self, group, parameters):
        if group not in self.contact.bushings:
            return super()._add_group(group, parameters)
        bushing = self.contact.bushings[group]
        prog = self.program.prog
        own = np.array([*bushing.origin, *(1.0 / np.array(bushing.stiffness))])
        known = parameters[len(own) :]
        variables = self.program.add_variables(
            [f"{self.wearer.name} {p.name}" for p in parameters],
            [max(abs(p.nominal), 0.01) for p in parameters],
        )
        design = self._of_cuff(
            group, ("across_m", "along_m", *STRAPS.values(), "area", *RELEASES)
        )
        self.program.add_constraints(
            f"{self.wearer.name} {group} as designed",
            CuffKernel(BY_AREA),
            np.concatenate([variables[: len(own)], design])[None],
            data=own[None],
        )
        self.built.append(variables[: len(own)])
        values = [p.nominal for p in known]
        prog.AddBoundingBoxConstraint(values, values, variables[len(own) :])
        return variables

    def _hold_ends(self, movement: TrialProgram, at: Trial) -> None:
        """Give the person's end states; the device's are left free."""
        if self.posed.settings.response == "own":
            return
        names, grid = movement.coordinates, movement.grid
        ends = np.ix_([0, -1], names.columns(names.human))
        movement.bound(grid.q[ends], at.q[ends], at.q[ends])
        movement.bound(grid.v[ends], at.v[ends], at.v[ends])
        bound_feet(movement, at, PredictionEnds())

    def _terms(self, movement, at, effects):
        settings, noise = self.posed.settings, self.settings.noise
        human = movement.torque[:, ~movement.coordinates.is_device_joint]
        terms = [minimised(human, settings.effort_nm)]
        if settings.response == "own":
            near = replace(
                noise,
                angle_deg=settings.own_angle_deg,
                velocity_deg_s=10.0 * settings.own_angle_deg,
                foot_pitch_deg=settings.own_angle_deg,
                foot_m=1e-4,
            )
            terms += kinematic_terms(movement, at, near, encoders=False)
            terms += ground_terms(movement, at, noise)
        return terms

    def _add(self, trial: Trial) -> TrialProgram:
        movement = super()._add(trial)
        at = trial.sample(movement.grid.times)
        self._drive(movement, at)
        self._add_forces(movement)
        self._limit(movement)
        self._limit_drives(movement, at)
        return movement

    def _drive(self, movement: TrialProgram, at: Trial) -> None:
        """Tie the device's torques to today's and to the design."""
        names, posed = movement.coordinates, self.posed
        torques = movement.torque[:, names.is_device_joint]
        today = at.device_moments
        passive, slope = self.wearer.passive(at), self.wearer.slope(at.q)
        springs = self.wearer.springs
        angles, rates = (x[:, names.device_columns] for x in (at.q, at.v))
        self._ways.append(movement.grid.quadrature[:, None] * rates)
        for i, joint in enumerate(names.device):
            own = posed.assistance(joint)
            if not own and not springs[i]:
                movement.bound(torques[:, i], today[:, i], today[:, i])
                continue
            factors = np.array([posed.variables[n] for n in own])
            known = assistance_of({n.partition(".")[2]: 1.0 for n in own})
            # No design variable scales what stays: friction and springs, or on
            # a joint without such variables the whole torque.
            stays = passive[:, i] if own else today[:, i]
            drive = today[:, i] - stays
            parts, more = (
                known.parts(
                    torque, angles[:, i], rates[:, i], at.times / at.duration
                )[:, : len(own)]
                for torque in (drive, drive + 1.0)
            )
            given = (stays + springs[i] * angles[:, i])[:, None] / MOMENT_UNIT
            there = np.sum(slope[:, i] * angles, axis=1, keepdims=True)
            by_springs = np.tile(np.diag(-springs)[i], (len(angles), 1))
            self.program.add_constraints(
                f"{movement.name} {joint} assistance",
                AssistanceKernel(len(names.device), len(own)),
                np.hstack(
                    [
                        torques[:, [i]],
                        movement.grid.q[:, names.device_columns],
                        movement.at_nodes(factors),
                    ]
                ),
                given,
                given,
                data=np.hstack(
                    [parts, more - parts, slope[:, i], there, by_springs]
                ),
            )

    def _add_forces(self, movement: TrialProgram) -> None:
        """Add the norm of the cuffs' forces, as mats would show them."""
        settings = self.posed.settings
        share = movement.grid.quadrature / self._weights_s
        used = share > 0.0
        for cuff, force in movement.cuffs.items():
            kernel = ForceNormKernel(
                settings.exponent,
                self._scale / self.wearer.shown(cuff),
                settings.shear_weight,
            )
            felt = force[used][:, [TANGENTIAL, NORMAL]]
            area = movement.at_nodes(self._of_cuff(cuff, ["area"]))[used]
            self.program.add_residuals(
                f"{movement.name} {cuff} force",
                kernel,
                np.hstack([felt, area]),
                np.sqrt(settings.weight * share[used])[:, None],
            )

    def _limit(self, movement: TrialProgram) -> None:
        """Add named bounds on what is felt; none where today is unknown.

        Forces across a limb are limited as mats would show them.
        """
        if self._today is None:
            return
        limits, program = self.posed.settings.limits, self.program
        times = [f"at {t:.3g} s" for t in movement.grid.times]
        for cuff, force in movement.cuffs.items():
            differ = self.wearer.shown(cuff)
            most = np.full(3, np.inf)
            today = self._today.largest_force(cuff)
            for k, _, limit in limits.of_forces(today):
                most[k] = min(most[k], limit)
            most[NORMAL] /= differ
            most = self._allowed(most, today)
            program.label(
                "limit",
                force,
                [
                    f"{movement.name} {cuff} {what}"
                    for what in ("shear", "normal force", "moment")
                ],
                times,
                [("N", 1.0), ("N", differ), ("N m", 1.0)],
            )
            bounded = np.isfinite(most)
            if bounded.any():
                most = most[bounded]
                movement.bound(force[:, bounded], -most, most)
            if limits.migration_mm is not None:
                self._limit_migration(movement, cuff)
            if limits.pressure_kpa is not None:
                self._limit_pressure(movement, cuff)
            if limits.rate_n_s is not None:
                self._limit_rate(movement, cuff)
        if limits.effort_factor is not None:
            own = movement.torque[:, ~movement.coordinates.is_device_joint]
            most = limits.effort_factor * self._today.largest_moments
            movement.bound(own, -most, most)

    def _allowed(self, most, today):
        """The limit; for a wearer who was drawn at least today's value."""
        return np.maximum(most, today) if self.wearer.is_drawn else most

    def _new(
        self,
        movement,
        of: str,
        what: str,
        unit,
        size: float,
        most: float,
        rows: int | None = None,
    ) -> np.ndarray:
        """New bounded variables for a limited quantity, one for each node.

        Args:
            movement: to which they are added.
            of: cuff or joint.
            what: name of the quantity.
            unit: for reports, with the factor that converts to it.
            size: typical size.
            most: limit on the absolute value.
            rows: number of nodes, from the first on; all by default.
        """
        times = [f"at {t:.3g} s" for t in movement.grid.times[:rows]]
        found = movement.new(f"{of} {what}", [size], len(times))
        name = f"{movement.name} {of} {what}"
        self.program.label("limit", found, [name], times, [unit])
        movement.bound(found, -most, most)
        self._limited[what, of, movement.name] = found
        return found

    def _limit_migration(self, movement, cuff: str) -> None:
        prog, grid = self.program.prog, movement.grid
        today = self._today.largest_deflection(cuff)[TANGENTIAL]
        wanted = self._most_migration(cuff)
        slid = self._new(
            movement,
            cuff,
            "migration",
            ("mm", 1e3 * self.wearer.slides(cuff)),
            0.01,
            max(wanted, today),
        )
        n, name = len(slid), f"{movement.name} {cuff} migration"
        if today > wanted:
            beyond = self._migration_beyond(cuff, today - wanted)
            rows = np.hstack([np.eye(n), -np.ones((n, 1))])
            for way in (1.0, -1.0):
                rows[:, :n] *= way
                prog.AddLinearConstraint(
                    rows,
                    np.full(n, -np.inf),
                    np.full(n, wanted),
                    np.concatenate([slid.ravel(), beyond]),
                ).evaluator().set_description(f"{name} beyond its limit")
        places = movement.at_nodes(self.places(cuff))
        self.program.add_constraints(
            name,
            MigrationKernel(self.bushings[cuff]),
            np.hstack([grid.q, places, slid]),
        )

    def _migration_beyond(self, cuff: str, most: float) -> np.ndarray:
        """Variable (1,) [m]: how far migration exceeds its limit in any trial.

        If today's does, it is not known whether the limit can be kept. A cost
        in proportion (today's excess costs five times as much as all forces)
        brings it to the limit or as near as possible, never beyond today's.
        """
        if cuff not in self._beyond:
            prog = self.program.prog
            name = f"{self.wearer.name} {cuff} migration beyond its limit"
            beyond = self.program.add_variables([name], [1e-3])
            prog.AddBoundingBoxConstraint([0.0], [most], beyond)
            forces = 0.5 * self.posed.settings.weight
            prog.AddLinearCost([_BEYOND * forces / most], 0.0, beyond)
            self._beyond[cuff] = beyond
        return self._beyond[cuff]

    def _most_migration(self, cuff: str) -> float:
        """Limit on the model's migration [m]."""
        limit = 1e-3 * self.posed.settings.limits.migration_mm
        return limit / self.wearer.slides(cuff)

    def _limit_pressure(self, movement, cuff: str) -> None:
        differ = self.wearer.shown(cuff)
        settings = self.posed.settings
        area_m2 = settings.freedom(cuff).area_m2
        today = 1e-3 * self._today.largest_force(cuff)[NORMAL] / area_m2
        most = self._allowed(settings.limits.pressure_kpa / differ, today)
        pressed = self._new(
            movement, cuff, "pressure", ("kPa", differ), 1.0, most
        )
        area = movement.at_nodes(self._of_cuff(cuff, ["area"]))
        self.program.add_constraints(
            f"{movement.name} {cuff} pressure",
            ProductKernel(1e3 * area_m2, INTERACTION_FORCE_UNIT),
            np.hstack([movement.cuffs[cuff][:, [NORMAL]], area, pressed]),
        )

    def _limit_rate(self, movement, cuff: str) -> None:
        """Limit how fast normal force changes from each node to the next."""
        differ, steps = self.wearer.shown(cuff), np.diff(movement.grid.times)
        limit, n = self.posed.settings.limits.rate_n_s / differ, len(steps)
        most = self._allowed(limit, self._today.largest_rate(cuff))
        unit = "N/s", differ
        rate = self._new(movement, cuff, _RATE, unit, 100.0, most, n)
        rise = np.diff(np.eye(n + 1), axis=0)
        self.program.prog.AddLinearEqualityConstraint(
            np.hstack([rise, -np.diag(steps)]),
            np.zeros(n),
            np.concatenate([movement.cuffs[cuff][:, NORMAL], rate.ravel()]),
        ).evaluator().set_description(f"{movement.name} {cuff} {_RATE}")

    def _limit_mean(self) -> None:
        """Limit each cuff's mean size of normal force, over time and trials."""
        limit = self.posed.settings.limits.mean_n
        if self._today is None or limit is None:
            return
        prog = self.program.prog
        for cuff in self.bushings:
            differ = self.wearer.shown(cuff)
            name = f"{self.wearer.name} {cuff} mean normal force"
            mean = self.program.add_variables([name], [10.0])
            self.program.label(
                "limit", mean[None], [name], [""], [("N", differ)]
            )
            self._means[cuff] = mean
            sizes = []
            for movement in self.movements:
                force = movement.cuffs[cuff][:, NORMAL]
                size = movement.new(f"{cuff} size", [10.0]).ravel()
                eye, n = np.eye(len(size)), len(size)
                prog.AddLinearConstraint(
                    np.block([[eye, eye], [eye, -eye]]),
                    np.zeros(2 * n),
                    np.full(2 * n, np.inf),
                    np.concatenate([size, force]),
                ).evaluator().set_description(f"{movement.name} {cuff} size")
                self._limited["size", cuff, movement.name] = size
                sizes.append(size)
            prog.AddLinearEqualityConstraint(
                np.r_[self._shares(), -1.0][None],
                [0.0],
                np.concatenate([*sizes, mean]),
            ).evaluator().set_description(name)
            today = self._today.mean_force(cuff)
            most = self._allowed(limit / differ, today)
            prog.AddBoundingBoxConstraint([0.0], [most], mean)

    def _shares(self) -> np.ndarray:
        """Weights of all nodes in a mean over time, and then over trials."""
        weights = [m.grid.quadrature for m in self.movements]
        return np.concatenate([w / w.sum() for w in weights]) / len(weights)

    def _limit_drives(self, movement: TrialProgram, at: Trial) -> None:
        """Limit each drive's torque, speed and power; friction is not its."""
        if self._today is None:
            return
        names = movement.coordinates
        drive = self.wearer.drive(at)
        passive = at.device_moments - drive
        for joint, limits in self.posed.settings.limits.drives.items():
            column = names.device.index(joint)
            own = passive[:, column]
            torque = movement.torque[:, names.joint(joint)]
            rate = movement.grid.v[:, names.index(joint)]
            if limits.torque_nm is not None:
                self._check_drive(joint, np.abs(drive[:, column]).max())
                most = limits.torque_nm
                movement.bound(torque, own - most, own + most)
            if limits.speed_deg_s is not None:
                most = np.deg2rad(limits.speed_deg_s)
                movement.bound(rate, -most, most)
            if limits.power_w is None:
                continue
            power = self._new(
                movement, joint, "power", ("W", 1.0), 10.0, limits.power_w
            )
            self.program.add_constraints(
                f"{movement.name} {joint} power",
                ProductKernel(1.0, _POWER_UNIT_W),
                np.column_stack([power, torque, rate]),
                data=own[:, None],
            )

    def _check_drive(self, joint: str, today: float) -> None:
        """Refuse a limit below today's torque if no variable changes it."""
        most = self.posed.settings.limits.drives[joint].torque_nm
        if today > most and not self.posed.assistance(joint):
            raise InputError(
                f"design.limits.drives.{joint}.torque_nm is {most:g}; the "
                f"drive gives {self.wearer.name} up to {today:.3g} N m, which "
                "the design cannot change (too small a share of all drives); "
                "raise this limit or leave it out"
            )

    def work(self, trials: Sequence[Trial]) -> float:
        """Work of the device's torques along its movements of today [J].

        Softer cuffs let the device move further in the solution, but not as
        built, so this would be no support: today's movement is used.

        Args:
            trials: solved, in the order of the wearer's.
        """
        return sum(
            float(np.sum(way * t.sample(movement.grid.times).device_moments))
            for movement, t, way in zip(
                self.movements, trials, self._ways, strict=True
            )
        )

    def _on_the_way(self) -> tuple[np.ndarray, np.ndarray]:
        """Travel of the device's joints at all nodes [rad], and the torques."""
        torques = [
            m.torque[:, m.coordinates.is_device_joint] for m in self.movements
        ]
        return (
            np.concatenate([way.ravel() for way in self._ways]),
            np.concatenate([torque.ravel() for torque in torques]),
        )

    def _limit_support(self) -> None:
        """Keep the device's work over all trials near a share of today's."""
        posed = self.posed
        limit = posed.settings.limits.support
        if self._today is None or limit is None:
            return
        prog, name = self.program.prog, f"{self.wearer.name} work"
        self._total = self.program.add_variables([name], [10.0])
        ways, torques = self._on_the_way()
        prog.AddLinearEqualityConstraint(
            np.r_[ways, -1.0][None],
            [0.0],
            np.concatenate([torques, self._total]),
        ).evaluator().set_description(name)
        today = self.work(self.trials)
        wanted, slack = posed.support * today, abs(today) * limit
        prog.AddBoundingBoxConstraint(
            [wanted - slack], [wanted + slack], self._total
        )
        self.program.label(
            "limit",
            self._total[None],
            [f"{self.wearer.name} work of the device"],
            [""],
            [("J", 1.0)],
        )

    def fill(
        self,
        x: np.ndarray,
        values: Mapping[str, float],
        trials: Sequence[Trial],
    ) -> None:
        """Set this wearer's program variables from solved trials.

        Args:
            x: all program variables, changed in place.
            values: value of each design variable.
            trials: solved.
        """
        design = design_of(values)
        contact = design.contact(self.wearer.contact)
        for group, variables in self._variables.items():
            x[self.program.indices(variables)] = [
                p.nominal for p in contact.fixed(group)
            ]
        for movement, trial in zip(self.movements, trials, strict=True):
            self._fill_trial(x, movement, trial, contact, design)
        for cuff, mean in self._means.items():
            sizes = [
                self._limited["size", cuff, m.name] for m in self.movements
            ]
            sizes = x[self.program.indices(np.concatenate(sizes))]
            x[self.program.indices(mean)] = self._shares() @ sizes
        if self._total is not None:
            ways, torques = self._on_the_way()
            total = ways @ x[self.program.indices(torques)]
            x[self.program.indices(self._total)] = total

    def _under_segments(self, at: Trial) -> dict[str, np.ndarray]:
        """Ground reactions (n, 3), a foot's all on its first segment."""
        found = {body: np.zeros((len(at.times), 3)) for body in self.soles}
        for side, bodies in self.feet.items():
            found[bodies[0]] = at.soles[side].array
        return found

    def _fill_trial(
        self, x, movement, trial: Trial, contact, design: Design
    ) -> None:
        at, indices = trial.sample(movement.grid.times), self.program.indices
        cuffs, limited = {}, {}
        for cuff in self.bushings:
            deflection, force, _ = self._cuff_at(x, cuff, at.q, contact)
            cuffs[cuff] = force
            slid, pressing = deflection[:, TANGENTIAL], force[:, NORMAL]
            if cuff in self._beyond:
                beyond = indices(self._beyond[cuff])
                over = np.abs(slid).max() - self._most_migration(cuff)
                x[beyond] = np.maximum(x[beyond], over)
            area = self.posed.settings.freedom(cuff).area_m2
            area *= design.cuffs.get(cuff, CuffDesign()).area
            limited["migration", cuff] = slid
            limited["pressure", cuff] = 1e-3 * pressing / area
            limited[_RATE, cuff] = np.diff(pressing) / np.diff(at.times)
            limited["size", cuff] = np.abs(pressing)
        given = assisted(at, design, passive=self.wearer.passive(at))
        device = given.device_moments
        power = device - (at.device_moments - self.wearer.drive(at))
        power *= at.v[:, movement.coordinates.device_columns]
        for i, joint in enumerate(movement.coordinates.device):
            limited["power", joint] = power[:, i]
        for (what, of), values in limited.items():
            variables = self._limited.get((what, of, movement.name))
            if variables is not None:
                x[indices(variables).ravel()] = values
        self._fill(
            x,
            movement,
            (at.q, at.v, at.a),
            given.moments,
            self._under_segments(at),
            cuffs,
        )


class DesignProblem(Compiles):
    """A design posed as one MathematicalProgram.

    Args:
        wearers: people who wear the device, with their movements of today.
        settings: what may change, what is minimised and what is limited.
        held: name -> value of design variables to be kept fixed; True fixes
            all of them at today's values.
        today: solution with nothing changed, to which some limits are
            relative; without it there are no limits.
        support: share of today's work that the device is to do.
        without: cuffs that are left out.

    Attributes:
        program: `program.prog` is a MathematicalProgram that may be added to
            before `solve`.
        wearers, settings, today, support, without: as given.
        design: the design variables.
        variables: name -> decision variable; if the design is symmetric, the
            same one for both legs.
        parts: trials of each wearer within the program.

    Raises:
        InputError: there are no wearers, they wear different devices, trials
            hold no device torques, or nothing is left to hold the device.
    """

    def __init__(
        self,
        wearers: Sequence[Wearer],
        settings: DesignSettings | None = None,
        *,
        held: Mapping[str, float] | bool = False,
        today: DesignResult | None = None,
        support: float = 1.0,
        without: Sequence[str] = (),
    ):
        start = time.perf_counter()
        self.wearers = list(wearers)
        self.today, self.support = today, support
        self.settings = settings = settings or DesignSettings()
        check_wearers(self.wearers, settings)
        self.without = tuple(without)
        wearing = [w.on(design_of({}, without)) for w in self.wearers]
        self.program = BatchedProgram()
        self.design = [
            _held(v, held) for v in design_variables(wearing, settings)
        ]
        self.variables = {}
        for v in self.design:
            mirror = mirror_of(v.name) if settings.symmetric else ""
            if mirror in self.variables:
                self.variables[v.name] = self.variables[mirror]
            else:
                self.variables[v.name] = self._variable(v)
        cuffs = len(self.wearers[0].model.cuffs)
        own = [norm_of(w, settings) for w in self.wearers]
        durations = [t.duration for w in self.wearers for t in w.trials]
        scale = max(joint_norm(own), _LEAST_SCALE_N)
        weights_s = cuffs * sum(durations)
        self.parts = [_Wearing(w, self, scale, weights_s) for w in wearing]
        self.build_seconds = time.perf_counter() - start

    @classmethod
    def of_today(
        cls, wearers: Sequence[Wearer], settings: DesignSettings | None = None
    ) -> DesignProblem:
        """The problem with nothing changed, which a design is compared with.

        If people move as before (response "own"), the objective hardly counts;
        if their response is free, it counts in full, as on the design.
        """
        settings = settings or DesignSettings()
        if settings.response == "own":
            settings = replace(settings, weight=_LIGHT)
        return cls(wearers, settings, held=True)

    def _variable(self, v: Variable):
        prog = self.program.prog
        (variable,) = self.program.add_variables([v.name], [v.size])
        prog.AddBoundingBoxConstraint(v.lower, v.upper, variable)
        if v.free:
            prog.AddQuadraticCost(
                0.5 * _LEAST_GAIN * ((variable - v.today) / v.size) ** 2
            )
        return variable

    def assistance(self, joint: str) -> list[str]:
        """Names of the variables that change a joint's torque."""
        return [
            n
            for n in self.variables
            if n.startswith(f"{joint}.") and is_assistance(n)
        ]

    @property
    def movements(self) -> list[TrialProgram]:
        """Movements of all wearers."""
        return [m for part in self.parts for m in part.movements]

    def guess(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Program variables (num_vars,) with the movements of today.

        Args:
            values: value of design variables by name; today's by default.
        """
        x = self.program.start()
        chosen = {
            v.name: v.clipped((values or {}).get(v.name, v.today))
            for v in self.design
        }
        for name, value in chosen.items():
            x[self.program.index(self.variables[name])] = value
        for part in self.parts:
            name, trials = part.wearer.name, part.trials
            if self.today is not None:
                trials = self.today.wearers[name].trials
            part.fill(x, chosen, trials)
        return x

    def solve(
        self,
        guess: np.ndarray | None = None,
        on_iterate: Callable[[Iterate], None] | None = None,
    ) -> DesignResult:
        """Solve, and collect each wearer's trials on the design."""
        compiled = self.compiled_anew()
        guess = self.guess() if guess is None else guess
        solution = ipopt.solve(
            compiled, guess, self.settings.solver.options(), on_iterate
        )
        solution.seconds["build"] = self.build_seconds
        x = solution.raw_values()
        values = {
            v.name: v.clipped(x[self.program.index(self.variables[v.name])])
            for v in self.design
        }
        solution.active_bounds = [
            v.name for v in self.design if v.at_bound(values[v.name])
        ]
        design = design_of(values, self.without)
        wearers = {}
        for part, wearer in zip(self.parts, self.wearers, strict=True):
            trials = [
                replace(part.read(m, t, x, solution.success), name=own.name)
                for m, t, own in zip(
                    part.movements, part.trials, part.wearer.trials, strict=True
                )
            ]
            worn = replace(wearer.on(design), trials=tuple(trials))
            wearers[wearer.name] = worn
        return DesignResult(self, solution, compiled, values, wearers)


def _held(v: Variable, held: Mapping[str, float] | bool) -> Variable:
    if held is True:
        return replace(v, lower=v.today, upper=v.today)
    if held and v.name in held:
        return replace(v, lower=held[v.name], upper=held[v.name])
    return v


@dataclass(frozen=True)
class DesignResult:
    """Result of a solved design.

    Attributes:
        problem: the problem that was solved.
        solution: state of the solve.
        compiled: the program as solved; `problem.program` may have been added
            to since.
        values: name -> value of each design variable (straps as compliance).
        wearers: by name, on the design, with the solution of each movement.
    """

    problem: DesignProblem
    solution: Solution
    compiled: SparseProgram
    values: dict[str, float]
    wearers: dict[str, Wearer]

    @property
    def design(self) -> Design:
        """The design that is to be built.

        Raises:
            SealedSolutionError: the solve failed.
        """
        self.solution.check()
        return design_of(self.values, self.problem.without)

    @property
    def norm_n(self) -> float:
        """The norm of all cuffs' forces that was minimised [N]."""
        return joint_norm(self.norm(worn) for worn in self.wearers.values())

    def norm(self, worn: Wearer) -> Norm:
        """The norm of the cuffs' forces on one who wears the design."""
        problem = self.problem
        design = design_of(self.values, problem.without)
        return norm_of(worn, problem.settings, design)

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
    wearer: Wearer, settings: DesignSettings, design: Design | None = None
) -> Norm:
    """The norm of one wearer's trials.

    Forces are taken as mats would show them and divided by the cuff's area
    relative to today's. A cuff that is left out counts as one without force.

    Args:
        wearer: with solved trials.
        settings: the design's.
        design: on which the trials were; nothing changed by default.
    """
    design = design or Design()
    p, total, duration = settings.exponent, 0.0, 0.0
    for trial in wearer.trials:
        duration += len(design.removed) * trial.duration
        for cuff, force in trial.cuffs.items():
            square = force.normal**2
            square = square + settings.shear_weight * force.tangential**2
            area = design.cuffs.get(cuff, CuffDesign()).area
            square *= (wearer.shown(cuff) / area) ** 2
            total += float(np.trapezoid(square ** (p / 2), trial.times))
            duration += trial.duration
    return Norm(total, duration, p)


def joint_norm(norms: Iterable[Norm]) -> float:
    """Norm of several wearers together [N]."""
    totals, durations, orders = zip(*norms, strict=True)
    return Norm(sum(totals), sum(durations), orders[0]).newton


def works(result: DesignResult) -> dict[str, float]:
    """Wearer -> work of the device along its movements of today [J]."""
    return {
        part.wearer.name: part.work(result.wearers[part.wearer.name].trials)
        for part in result.problem.parts
    }
