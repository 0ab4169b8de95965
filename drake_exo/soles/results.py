"""Results of a simulated step: figures, checks, tables, pictures, files."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_exo.errors import InputError, check_type, path_of
from drake_exo.files.output import (
    SOLVED,
    Check,
    Verdict,
    save_figure,
    write_csv,
    write_json,
)
from drake_exo.soles.contact.gauss_seidel import GaussSeidelSolver
from drake_exo.soles.contact.law import ContactLaw
from drake_exo.soles.contact.newton import ContactSolver
from drake_exo.soles.elasticity import Sole
from drake_exo.soles.numerics import angles_xyz, tilt_deg
from drake_exo.soles.settings import Setup
from drake_exo.soles.simulation import (
    HISTORY,
    StepHistory,
    heel_strike_count,
    read_history,
    sample_weights,
    sigma_max_translation,
    sigma_min_rotation,
    simulate,
    stability,
    touches_elsewhere,
    write_history,
)

# Strains at which linear elasticity is some per cent off, and from which on it
# turns elements inside out.
SMALL_STRAIN, _INSIDE_OUT = 0.3, 1.0
_TILT_DEG = 20.0  # beyond, a small-strain pose is not a real foot's
_OVER_DEG = 90.0  # tilt of a foot that has turned over
_ZMP_ERROR = 0.02  # metres
_NEAR_SLIP = 0.95  # largest part of μ that a load may use
# Less force [N] or a longer contact [s] suggests other units.
_LIGHT, _LONG = 5.0, 20.0
_APART = 0.5  # largest excess over the usual spacing; a missing row makes it 1
_CUT = 0.25  # largest part of a load's free moments that friction cuts
_UNDERCUT = 0.01  # largest part of the bare surface that faces upwards
_ON_ITS_HEAD = 0.35  # more than this, which no design came to
_LOST = 0.01  # largest part of a file's surface that is not in the mesh
_COMPLEMENTARITY = 1e-6
_NOT_SMALL = (
    "small strain does not hold so far; judge the sole in finite strain "
    "(drake-exo sole strain, of its case file or the folder of its design)"
)
_TURNED_OVER = (
    "elements turn inside out, so that the figures mean nothing: the load is "
    "too large for this material and shape; check youngs_modulus_pa and the "
    "load's units"
)


def step_checks(step) -> tuple[Check, ...]:
    """Checks of a `Step`, see the table in docs/soles.md."""

    def check(name, holds, value, limit, unit, sentence, level="fail"):
        return Check(
            name, bool(holds), value, limit, unit, where, sentence, level
        )

    where, failed = step.setup.name, np.flatnonzero(~step.converged)
    checks = [Check(SOLVED, True, where=where)]
    if len(failed):
        q, status = failed[0], step.history.reports[failed[0]].message
        # Counted from 1, as the table of finite strain counts.
        phases, place = step.setup.load.phases, ""
        if len(phases) > 1:  # times run on from load to load
            k = next(k for k, rows in enumerate(phases) if q < rows.stop)
            place = f" (sample {q + 1 - phases[k].start} of loads[{k}])"
        said = f"sample {q + 1} at {step.times[q]:g} s{place}: {status}"
        pressed = step.pressed
        if pressed > SMALL_STRAIN:
            said += (
                f"; the load presses the sole by some {pressed:.0%} of its "
                "thickness: check youngs_modulus_pa and the load's units"
            )
        checks = [
            check(SOLVED, False, float(len(failed)), 0.0, "samples", said)
        ]
    if len(failed) == len(step.times):
        return tuple(checks)
    for name, holds, value, limit, unit, said, *fails in _notes(step):
        level = "fail" if any(fails) else "note"
        name = f"plausibility.{name}"
        checks.append(check(name, holds, value, limit, unit, said, level))
    worst = step.complementarity()
    checks.append(
        check("contact", worst <= _COMPLEMENTARITY, worst, _COMPLEMENTARITY,
              "", "forces do not obey Signorini's and Coulomb's laws: the "
              "simulation went wrong")
    )  # fmt: skip
    return tuple(checks)


def _notes(step):
    """Name, holds, value, limit, unit, text of notes; whether one may fail."""
    load, strain = step.setup.load, step.largest_strain
    is_worse = strain >= _INSIDE_OUT
    limit = _INSIDE_OUT if is_worse else SMALL_STRAIN
    yield (
        "strain", strain < limit, strain, limit, "",
        _TURNED_OVER if is_worse else _NOT_SMALL, is_worse,
    )  # fmt: skip
    most = float(load.force[:, 2].max())
    yield (
        "load_force", most >= _LIGHT, most, _LIGHT, "N",
        f"no vertical force is above {most:.3g} N; forces are in N, not kN",
    )  # fmt: skip
    longest = max(float(np.ptp(load.times[phase])) for phase in load.phases)
    yield (
        "load_time", longest <= _LONG, longest, _LONG, "s",
        f"a contact lasts {longest:.3g} s; times are in s, not ms",
    )  # fmt: skip
    spans = [np.diff(load.times[phase]) for phase in load.phases]
    apart = [float(s.max() / np.median(s) - 1.0) for s in spans if len(s)]
    more = max(apart, default=0.0)
    yield (
        "load_spacing", more <= _APART, more, _APART, "",
        f"samples are up to {1 + more:.3g} times as far apart as usual, and "
        "the time without samples counts for nothing in c_tr and c_rot; add "
        "the missing rows, space samples evenly, or, where the foot was in "
        "the air, give each contact a load of its own",
    )  # fmt: skip
    if load.free_moment is not None:
        cut = load.moments_cut / len(load.times)
        yield (
            "free_moment", cut <= _CUT, cut, _CUT, "",
            "at this share of the samples the free moment is beyond what "
            "friction bears and was cut to that; moments are in N·m, not "
            "N·mm, about the vertical at the ZMP",
        )  # fmt: skip
    measured = load.is_measured
    if measured.any():
        error = step.zmp_error
        yield (
            "zmp", error <= _ZMP_ERROR, error, _ZMP_ERROR, "m",
            "the pose that markers tell leads to another centre of pressure: "
            "a tenth of a degree matters on a flat sole; take pose: free for "
            "its stiffness there",
        )  # fmt: skip
    free = step.converged & ~measured  # their pose follows from the load
    if free.any():
        tilt = float(step.tilt_deg[free].max())
        yield (
            "tilt", tilt <= _TILT_DEG, tilt, _TILT_DEG, "°",
            "the foot leans far over: a small push may tip it"
            if tilt < _OVER_DEG
            else "the foot has turned over: what was found there is not a step",
            tilt >= _OVER_DEG,
        )  # fmt: skip
        margin = float(np.nanmin(step.stability[free]))
        loose = int(np.sum(step.stability[free] <= 0))
        yield (
            "stability", margin > 0, margin, 0.0, "N/m",
            f"samples not shown to be stable: {loose}; there the foot may tip "
            "under a force that stays constant",
        )  # fmt: skip
    used, limit = step.setup.friction_used, _NEAR_SLIP * step.law.friction
    yield (
        "friction", used <= limit, used, limit, "",
        "the sole is about to slip away as a whole",
    )  # fmt: skip
    lost, undercut = step.sole.mesh.lost, step.sole.mesh.undercut
    if lost is not None:
        yield (
            "surface", lost <= _LOST, lost, _LOST, "",
            "this share of the file's surface is missing in the mesh, in "
            "grooves, ribs or holes narrower than elements; give more "
            "mesh.tets, or leave them out of the file",
        )  # fmt: skip
    yield (
        "undercut", undercut <= _UNDERCUT, undercut, _UNDERCUT, "",
        "this share of the bare surface faces upwards: a rigid mould that "
        "opens upwards does not let go of the sole"
        + (", which may stand on its head" if undercut > _ON_ITS_HEAD else ""),
    )  # fmt: skip
    if hollows := step.sole.mesh.hollows:
        yield (
            "hollow", False, float(hollows), 0.0, "",
            "this many hollows are closed: nothing holds their cores in a "
            "mould, and they cannot be taken out of the sole; open them to the "
            "top, fill them, or print the sole",
        )  # fmt: skip


_TOGETHER = 16  # samples whose displacements are computed at a time


@dataclass
class Step:
    """A sole simulated at the N samples of a step, as by `Case.simulate`.

    World frame: x forward, y left, z up; SI units. A sample that did not
    converge has NaN stiffness.

    >>> import drake_exo as dx
    >>> step = dx.soles.Case.from_text(dx.soles.EXAMPLE).simulate()
    >>> step.failed_steps, step.force.shape, step.stiffness.shape
    (0, (5, 3), (5, 6, 6))
    >>> print(f"{step.c_tr:.3g} N/m, {step.c_rot:.3g} N·m/rad")
    1.27e+06 N/m, 9.21e+03 N·m/rad
    >>> figure = step.plot()

    Attributes:
        setup: What was simulated: settings, load, mesh, start.
        sole: The finite elements of the sole.
        law: The contact law.
        history: Nodal forces, poses and convergence of every sample.
        seconds: Computing times by name [s].
    """

    setup: Setup
    sole: Sole
    law: ContactLaw
    history: StepHistory
    seconds: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        # Without the arrays: a notebook shows its last line's value.
        return (
            f"Step({self.setup.name!r}, {len(self.times)} samples, c_tr "
            f"{self.c_tr:.4g} N/m, c_rot {self.c_rot:.4g} N·m/rad)"
        )

    @classmethod
    def of(
        cls,
        setup: Setup,
        sole: Sole | None = None,
        r: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> "Step":
        """Simulate a case, or another sole of it, by the exact contact law.

        The law's scale r [N/m] is the sole's own if not given; the method is
        the case's. If a node reaches the ground that is not among those that
        may touch, the sole is simulated again with all bare nodes.
        """
        began = time.perf_counter()
        sole = setup.sole() if sole is None else sole
        r = sole.penalty if r is None else r
        law = ContactLaw(setup.settings.contact.friction, r)
        ready = time.perf_counter()
        kinds = {"newton": ContactSolver, "gauss_seidel": GaussSeidelSolver}
        kind = kinds[setup.settings.contact.method]

        def simulated(sole):
            solver = kind.of(sole, law, ground=setup.ground)
            return simulate(solver, setup.load, setup.start, progress=progress)

        history = simulated(sole)
        if touches_elsewhere(sole, law, history, setup.ground):
            sole = replace(sole, mesh=sole.mesh.touching_everywhere())
            history = simulated(sole)
        return cls(
            setup, sole, law, history,
            {
                "condensation_seconds": round(ready - began, 4),
                "simulation_seconds": round(time.perf_counter() - ready, 4),
            },
        )  # fmt: skip

    @property
    def times(self) -> np.ndarray:
        """Times of the samples [s], (N,)."""
        return self.setup.load.times

    @property
    def force(self) -> np.ndarray:
        """Force of the ground on the sole, summed over nodes [N], (N, 3)."""
        return self.history.F.sum(axis=1)

    @property
    def zmp(self) -> np.ndarray:
        """Zero-moment point of the contact forces, on the ground [m], (N, 2).

        NaN where nothing touches.
        """
        return self._zmp_on_ground[:, :2]

    @property
    def _zmp_on_ground(self) -> np.ndarray:
        """ZMP with its height [m], (N, 3)."""
        F, P = self.history.F, self.history.P
        return self.setup.ground.zero_moment_point(F, P)

    @property
    def free_moment(self) -> np.ndarray:
        """Moment of the forces about the vertical at the ZMP [N·m], (N,)."""
        arm = self.history.P - self._zmp_on_ground[:, None]
        return np.cross(arm, self.history.F)[:, :, 2].sum(axis=1)

    @property
    def zmp_error(self) -> float:
        """RMS distance [m] of the ZMP from the load's, over prescribed poses.

        Only samples that converged count; with a free pose both are the same.
        """
        load = self.setup.load
        off = (self.zmp - load.zmp)[self.converged & load.is_measured]
        return float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else 0.0

    @property
    def origin(self) -> np.ndarray:
        """Place of the sole frame's origin [m], (N, 3)."""
        return self.history.O.copy()

    @property
    def rotation(self) -> np.ndarray:
        """Orientation of the sole frame, (N, 3, 3)."""
        return self.history.R.copy()

    @property
    def angles(self) -> np.ndarray:
        """Roll, pitch and yaw of R = Rx·Ry·Rz [rad], (N, 3).

        They do not leap by a turn between samples of one contact.
        """
        begins = self.setup.load.begins[1:]
        parts = np.split(angles_xyz(self.history.R), begins)
        return np.concatenate([np.unwrap(x, axis=0) for x in parts])

    @property
    def tilt_deg(self) -> np.ndarray:
        """Angle between the sole's normal and the ground's [°], (N,)."""
        return tilt_deg(self.history.R, self.setup.up)

    @property
    def pressure(self) -> np.ndarray:
        """Pressure at the m nodes that may touch [Pa], (N, m).

        Upward force over the node's area at rest.
        """
        return self.history.F[:, :, 2] / self.sole.mesh.contact_areas

    @property
    def pressed(self) -> float:
        """Rough strain: largest upward force over Young's modulus · area."""
        area = self.sole.mesh.contact_areas.sum()
        stiff = self.sole.material.youngs_modulus_pa * area
        return float(self.setup.load.force[:, 2].max() / stiff)

    @property
    def touching(self) -> np.ndarray:
        """Which of the m nodes that may touch carry load, (N, m)."""
        return self.history.F[:, :, 2] > 0

    @property
    def stiffness(self) -> np.ndarray:
        """Stiffness K_c about `zmp`, (N, 6, 6): [dF; dΓ] = K_c [dO; dω].

        dO [m] moves the point of the sole that lies at the ZMP, dω [rad]
        turns the sole about it.
        """
        return self.history.K_c.copy()

    @property
    def sigma_max_translation(self) -> np.ndarray:
        """Largest singular value of K_c's translational block [N/m], (N,)."""
        return sigma_max_translation(self.history.K_c)

    @property
    def sigma_min_rotation(self) -> np.ndarray:
        """Least singular value of K_c's rotational block [N·m/rad], (N,)."""
        return sigma_min_rotation(self.history.K_c)

    @property
    def stability(self) -> np.ndarray:
        """Least eigenvalue of S sym(−K_c) S [N/m], (N,); see docs/soles.md.

        S divides lengths by 0.05 m. Above 0 suffices for stability under a
        force and moment that stay as they are.
        """
        return stability(self.history.K_c)

    @property
    def converged(self) -> np.ndarray:
        """Which samples converged, (N,)."""
        return self.history.converged

    @property
    def failed_steps(self) -> int:
        """Number of samples without a solution."""
        return self.history.failed_steps

    @property
    def heel_strike(self) -> int:
        """Number of samples of heel strike; with several loads, the first's."""
        return strikes(self.setup)[0][1]

    @cached_property
    def costs(self) -> tuple[float, float, float]:
        """c_tr [N/m], c_rot [N·m/rad] and c = c_tr − w c_rot."""
        c_tr, c_rot = self._sums(np.ones(len(self.times), dtype=bool))
        return c_tr, c_rot, c_tr - self.setup.settings.cost.weight * c_rot

    def _sums(self, rows) -> tuple[float, float]:
        fraction = self.setup.settings.cost.heel_strike_fraction
        *_, by_tr, by_rot = sample_weights(self.setup.load, fraction)
        early = rows & (by_tr > 0)
        return (
            float(by_tr[early] @ self.sigma_max_translation[early]),
            float(by_rot[rows] @ self.sigma_min_rotation[rows]),
        )

    def loads(self) -> list[dict]:
        """Figures of every contact phase, as in summary.json."""
        load, w = self.setup.load, self.setup.settings.cost.weight
        early, out = strikes(self.setup), []
        for k, share in enumerate(load.shares):
            rows = load.phase == k
            c_tr, c_rot = (x / share for x in self._sums(rows))
            count, strike = int(rows.sum()), early[k][1] - early[k][0]
            out.append(
                {
                    "begins_s": float(self.times[rows][0]),
                    "weight": load.weights[k],
                    "steps": count,
                    "failed_steps": int((~self.converged[rows]).sum()),
                    "c_tr": c_tr,
                    "c_rot": c_rot,
                    "c": c_tr - w * c_rot,
                    "c_tr_mean_n_per_m": c_tr / strike,
                    "c_rot_mean_nm_per_rad": c_rot / count,
                }
            )
        return out

    @property
    def c_tr(self) -> float:
        """Sum of `sigma_max_translation` over heel strike [N/m].

        With several loads, c_tr and c_rot are weighted means of the loads'
        sums.
        """
        return self.costs[0]

    @property
    def c_rot(self) -> float:
        """Sum of `sigma_min_rotation` over all samples [N·m/rad].

        With several loads a weighted mean, as `c_tr`.
        """
        return self.costs[1]

    @property
    def c(self) -> float:
        """The cost c_tr − w c_rot, with the case's w."""
        return self.costs[2]

    @cached_property
    def largest_strain(self) -> float:
        """Largest |principal strain| over elements and converged samples."""
        sole, history, largest = self.sole, self.history, 0.0
        good = np.flatnonzero(history.converged)
        for part in np.array_split(good, len(good) // _TOGETHER + 1):
            for u in sole.displacement(history.F[part] @ history.R[part]):
                eps = sole.strain(u)
                # |λ| <= Frobenius norm, so most elements need no eigenvalues.
                able = np.sqrt((eps**2).sum(axis=(1, 2))) > largest
                values = np.abs(np.linalg.eigvalsh(eps[able]))
                largest = float(values.max(initial=largest))
        return largest

    def complementarity(self) -> float:
        """Largest violation of Signorini's and Coulomb's laws, normalised.

        The violations are negative force, penetration, force times gap, force
        outside the cone, and force not opposite to the slip. Forces are over
        |F| of the sample, lengths over |F|/r.
        """
        history, law, setup = self.history, self.law, self.setup
        worst, phase, before = 0.0, None, None
        for q in np.flatnonzero(history.converged):
            F, P, R = history.F[q], history.P[q], history.R[q]
            if (
                own := np.searchsorted(setup.load.begins, q, side="right")
            ) != phase:
                phase, before = own, setup.start.places(R, self.sole.positions)
            scale = np.linalg.norm(F.sum(axis=0))
            Q, axes = setup.ground.planes(history.between.get(q, before))
            f = np.einsum("kij,kj->ki", axes, F) / scale
            apart = np.einsum("kij,kj->ki", axes, P - Q) * law.penalty / scale
            gap, slip = apart[:, 2], apart[:, :2]
            size = np.linalg.norm(f[:, :2], axis=1)
            margin = law.friction * f[:, 2] - size
            speed = np.linalg.norm(slip, axis=1)
            touching = f[:, 2] > 0
            # Slip inside the cone, or not opposite to the force.
            free = np.minimum(margin, speed)[touching]
            along = (f[:, :2] * slip).sum(axis=1) + size * speed
            worst = max(
                worst,
                -f[:, 2].min(),
                -gap.min(),
                np.abs(f[:, 2] * gap).max(),
                -margin.min(),
                free.max(initial=0.0),
                along[touching].max(initial=0.0),
            )
            before = P
        return float(worst)

    def verdict(self, accepted: Sequence[str] = ()) -> Verdict:
        """The checks of the step, and whether each holds or is accepted."""
        return Verdict(step_checks(self), tuple(accepted))

    def table(self) -> dict[str, np.ndarray]:
        """Columns over time by name, units in the names, (N,) each."""
        load, reports = self.setup.load, self.history.reports
        angles = np.rad2deg(self.angles)
        columns = {"time_s": load.times}
        forces = "force_x_n", "force_y_n", "force_z_n"
        columns |= zip(forces, load.force.T, strict=True)
        # With a prescribed pose, the simulated ZMP beside the recorded one.
        own = load.is_measured & self.converged
        zmp = np.where(own[:, None], self.zmp, load.zmp)
        columns["zmp_x_m"], columns["zmp_y_m"] = zmp.T
        asked = dict(zip(("zmp_x_m", "zmp_y_m"), load.zmp.T, strict=True))
        if len(load.begins) > 1:
            columns["load"] = load.phase
            columns["weight"] = np.array(load.weights)[load.phase]
        if load.free_moment is not None:
            columns["free_moment_nm"] = np.where(
                own, self.free_moment, load.free_moment
            )
            asked["free_moment_nm"] = load.free_moment
        if load.is_measured.any():
            columns |= {f"recorded_{name}": x for name, x in asked.items()}
        places = "origin_x_m", "origin_y_m", "origin_z_m"
        columns |= zip(places, self.origin.T, strict=True)
        turns = "roll_deg", "pitch_deg", "yaw_deg"
        columns |= zip(turns, angles.T, strict=True)
        return columns | {
            "tilt_deg": self.tilt_deg,
            "sigma_max_tr_n_per_m": self.sigma_max_translation,
            "sigma_min_rot_nm_per_rad": self.sigma_min_rotation,
            "stability_n_per_m": self.stability,
            "nodes_in_contact": self.touching.sum(axis=1),
            "newton_iterations": np.array([r.iterations for r in reports]),
            "parts_of_time": np.array([r.parts for r in reports]),
            "residual": np.array([r.residual for r in reports]),
            "converged": self.converged.astype(int),
        }

    def summary(self) -> dict:
        """The entries of summary.json on the simulation, without times."""
        margin, mesh = self.stability, self.sole.mesh
        density = self.sole.material.density_kg_per_m3
        loads = self.loads()
        mean = {
            key: sum(
                share * row[key]
                for share, row in zip(
                    self.setup.load.shares, loads, strict=True
                )
            )
            for key in ("c_tr_mean_n_per_m", "c_rot_mean_nm_per_rad")
        }
        reports = self.history.reports
        failures = [
            {"step": q, "time_s": float(self.times[q]), "message": r.message}
            for q, r in enumerate(reports)
            if not r.converged
        ]
        iterations = [r.iterations for r in reports]
        return {
            "name": self.setup.name,
            "c_tr": self.c_tr,
            "c_rot": self.c_rot,
            "c": self.c,
            "weight": self.setup.settings.cost.weight,
            **mean,
            "loads": loads,
            "steps": len(reports),
            "failed_steps": self.failed_steps,
            "failures": failures[:20],
            "steps_refined_in_time": sum(
                r.converged and r.parts > 1 for r in reports
            ),
            "contact_nodes": len(mesh.contact),
            "nodes": len(mesh.nodes),
            "tets": len(mesh.tets),
            "volume_cm3": 1e6 * mesh.volume,
            "mass_kg": mesh.volume * density,
            "undercut": mesh.undercut,
            "least_quality": float(mesh.quality().min()),
            "stable": bool(self.failed_steps == 0 and margin.min() > 0),
            "stability_min_n_per_m": float(np.min(margin)),
            "tilt_max_deg": float(
                np.max(self.tilt_deg[self.converged], initial=0.0)
            ),
            "max_strain": self.largest_strain,
            "zmp_error_rms_m": self.zmp_error,
            "friction_used": self.setup.friction_used,
            **self.setup.ground_told,
            "newton_iterations_mean": float(np.mean(iterations)),
            "newton_iterations_max": int(np.max(iterations)),
        }

    def plot(self, label: str = "", **beside: "Step"):
        """Figure of both stiffnesses over time, beside other steps by label."""
        # matplotlib takes half a second to load.
        from drake_exo.soles import pictures

        for name, step in beside.items():
            check_type(step, Step, name)
        steps = beside | {label or self.setup.name: self}
        tables = {label: step.table() for label, step in steps.items()}
        return pictures.stiffness_figure(
            {self.setup.name: tables}, strikes(self.setup)
        )

    def write_animation(
        self, path: Path | str, mark: str = "", **beside: "Step"
    ) -> None:
        """Write an HTML page that plays the step, beside others by label.

        Args:
            path: Path of the page.
            mark: `Verdict.mark`, the line on checks that do not hold.
            beside: Other steps by label.
        """
        from drake_exo.soles.animation import SoleMotion, write_animation

        name, shown = self.setup.name, []
        for label, step in ({name: self} | beside).items():
            motion = SoleMotion.of(
                label, step.sole.mesh, step.times, step.history,
                step.setup.ground, mark if label == name else "",
            )  # fmt: skip
            if motion is not None:
                shown.append(motion)
        if shown:
            write_animation(Path(path), shown, name)

    def draw(
        self, folder: Path, mark: str, label: str = "", **beside: "Step"
    ) -> None:
        """Write all pictures of the step, and its animation.

        Args:
            folder: Where to write them.
            mark: `Verdict.mark`, the line on checks that do not hold.
            label: Name of this step in stiffness.png, in which other steps are
                shown `beside` it, by label.
        """
        from drake_exo.soles import pictures

        load, mesh = self.setup.load, self.sole.mesh
        level = self.setup.start.places(np.eye(3), self.sole.positions)[:, :2]
        peak = self.pressure[self.converged].max(axis=0, initial=0.0)
        from_origin = self._zmp_on_ground - self.origin
        zmp = np.einsum("qij,qi->qj", self.rotation, from_origin)[:, :2]
        drawn = {
            "drawing": pictures.drawing_figure(mesh, self.setup.name, peak),
            "load": pictures.load_figure(load, level, self.setup.ground),
            "stiffness": self.plot(label, **beside),
            "pose": pictures.pose_figure(self.table()),
            "pressure": pictures.pressure_figure(
                mesh, load.times, zmp, self.pressure, self.converged
            ),
        }
        for name, figure in drawn.items():
            if figure is not None:
                save_figure(folder / f"{name}.png", figure, mark)
        self.write_animation(folder / "animation.html", mark)

    def write_tables(self, table: Path, history: Path) -> None:
        """Write the table and the history of all samples."""
        write_csv(table, self.table())
        write_history(
            history, self.sole.mesh, self.times, self.history,
            self.setup.ground,
        )  # fmt: skip

    def write(
        self,
        folder: Path | str,
        seconds: dict | None = None,
        accepted: Sequence[str] = (),
    ) -> Verdict:
        """Write tables, arrays, pictures, animation and, last, summary.json.

        Args:
            folder: Where to write; made if it does not exist.
            seconds: Further computing times to note in summary.json.
            accepted: Names of checks that the user accepts.
        """
        began, verdict = time.perf_counter(), self.verdict(accepted)
        folder = path_of(folder, "folder")
        folder.mkdir(parents=True, exist_ok=True)
        numbers = self.summary() | verdict.summary()
        numbers["complementarity"] = self.complementarity()
        moment = self.table().get("free_moment_nm")
        if moment is not None:
            numbers["free_moment_nm"] = {
                "mean": float(moment.mean()),
                "largest": float(np.abs(moment).max()),
                "cut_samples": self.setup.load.moments_cut,
            }
        self.write_tables(folder / "steps.csv", folder / HISTORY)
        tables = time.perf_counter()
        self.draw(folder, verdict.mark)
        numbers |= self.seconds | (seconds or {})
        numbers["tables_seconds"] = round(tables - began, 4)
        numbers["pictures_seconds"] = round(time.perf_counter() - tables, 4)
        write_json(folder / "summary.json", numbers)
        return verdict


def strikes(setup: Setup) -> list[tuple[int, int]]:
    """Index of heel strike's first sample and of the next after it, by load."""
    fraction = setup.settings.cost.heel_strike_fraction
    return [
        (p.start, p.start + heel_strike_count(p.stop - p.start, fraction))
        for p in setup.load.phases
    ]


class SoleSamples(NamedTuple):
    """Pose of a sole and force on it at the N samples that converged.

    Attributes:
        origin: Place of the sole frame's origin [m], (N, 3).
        rotation: Orientation of the sole frame, (N, 3, 3).
        force: Upward force of the ground [N], (N,).
        cop: Centre of pressure [m], (N, 2).
        size: Length, width and depth of the sole below its frame [m], (3,).
        middle: Middle of the sole in its frame, forward and left [m], (2,).
        friction: Coulomb's coefficient μ.
        arm: Mean distance of the force from its centre of pressure [m], (N,).
            Friction bears a free moment up to about μ force arm.
    """

    origin: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    cop: np.ndarray
    size: np.ndarray
    middle: np.ndarray
    friction: float
    arm: np.ndarray

    def __repr__(self) -> str:
        # Without the arrays: a notebook prints this for its last line.
        return (
            f"SoleSamples({len(self.force)} samples, up to "
            f"{self.force.max(initial=0.0):.1f} N)"
        )


def sole_samples(source: Step | Path | str) -> SoleSamples:
    """Poses, forces and centres of pressure of a step.

    `drake_exo.contact.reduce_sole` fits spheres to them.

    >>> import drake_exo as dx
    >>> step = dx.soles.Case.from_text(dx.soles.EXAMPLE).simulate()
    >>> told = dx.soles.sole_samples(step)
    >>> told.origin.shape, told.force.shape, told.size.round(3).tolist()
    ((5, 3), (5,), [0.23, 0.13, 0.03])

    Args:
        source: A step, or the folder of `Step.write` or `Design.write`.

    Raises:
        InputError: The folder's file is missing, damaged, or of a version that
            did not store μ; no sample converged; or the ground is not flat.
    """
    remedy = "simulate the sole again"
    if isinstance(source, Step):
        name, ground = source.setup.name, source.setup.ground
        mesh, history = source.sole.mesh, source.history
    else:
        name = path_of(source, "source") / HISTORY
        mesh, _, history, ground = read_history(name, remedy)
    good = history.converged
    if not good.any():
        raise InputError(f"{name}: no sample converged; {remedy}")
    if not ground.is_flat:
        raise InputError(
            f"{name}: the sole stood on uneven ground; simulate it without the "
            "key ground"
        )
    if history.friction is None:
        raise InputError(f"{name}: does not say the friction; {remedy}")
    up, P, nodes = history.F[good, :, 2], history.P[good], mesh.nodes
    force = up.sum(axis=1)
    share = up / force[:, None]
    cop = np.einsum("qm,qmi->qi", share, P[:, :, :2])
    away = np.linalg.norm(P[:, :, :2] - cop[:, None], axis=2)
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    size = np.array([*(high - low)[:2], -low[2]])
    middle = 0.5 * (low + high)[:2]
    return SoleSamples(
        history.O[good], history.R[good], force, cop, size, middle,
        history.friction, (share * away).sum(axis=1),
    )  # fmt: skip
