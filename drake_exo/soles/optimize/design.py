"""The result of an optimisation, verified, and the files it writes.

It is simulated by the exact law with all samples from a cold start, and for
`write` on a finer mesh and in finite strain.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import path_of
from drake_exo.files.output import (
    Check,
    Verdict,
    save_figure,
    write_csv,
    write_json,
)
from drake_exo.soles.finite_strain import compare_strains, write_table
from drake_exo.soles.mesh import (
    WALL,
    SphericalSpline,
    TetMesh,
    is_watertight,
    mould_triangles,
    write_triangles,
    write_vtk,
)
from drake_exo.soles.optimize.files import (
    DESIGN,
    MESH,
    STEPS,
    SUMMARY,
    TRACE,
    Checkpoint,
    write_case,
)
from drake_exo.soles.optimize.limits import FEASIBLE, ROUNDING
from drake_exo.soles.optimize.optimizer import ITERATION_LIMIT, Optimum
from drake_exo.soles.optimize.problem import ShapeProblem
from drake_exo.soles.results import Step
from drake_exo.soles.settings import Setup, finer_mesh
from drake_exo.soles.simulation import FIRST_HISTORY, HISTORY

_ACTIVE = 0.01  # scaled limits below this are active
_FINER = 0.03  # largest change of c on a finer mesh
_EXACT = 0.05  # largest change of c by the exact law with all samples


@dataclass
class Design:
    """An optimised sole and its initial shape, both by the exact contact law.

    `Case.optimize` returns it.

    >>> import drake_exo as dx
    >>> best = dx.soles.Case.from_text(dx.soles.EXAMPLE).optimize()
    >>> best.step.c < 0.6 * best.first.c
    True
    >>> best.coefficients.shape, best.history["cost"].shape
    ((17,), (6,))

    Attributes:
        setup: The case.
        problem: The last stage's problem, for cost, limits and derivatives at
            any `variables`.
        variables: Coefficients of the spline; then, where a walk was sought
            with the sole, the walk's numbers, each from 0 to 1 in its range,
            (P,).
        step: The design simulated through the step, from a cold start.
        first: The initial shape, simulated likewise.
        optima: Outcome of every stage. Where a walk was sought, only of the
            stages that moved it, or of the sole alone if that is the design.
        starts: For every start (or walk that was tried) its last stage, the
            cost and violation after it, and the cost on a finer mesh.
        seconds: Computing time of the whole search [s].
        gait: The walk sought with the sole: its numbers before and after,
            contact times [s], the sole alone; None if no walk was sought.
    """

    setup: Setup
    problem: ShapeProblem
    variables: np.ndarray
    step: Step
    first: Step
    optima: list[Optimum]
    starts: tuple[dict, ...] = ()
    seconds: float = 0.0
    gait: dict | None = None

    def __repr__(self) -> str:
        # As Step's.
        return (
            f"Design({self.setup.name!r}, c {self.step.c:.4g} for "
            f"{self.first.c:.4g}, {len(self.mesh.tets)} tets)"
        )

    @property
    def coefficients(self) -> np.ndarray:
        """Free coefficients of the spline, (k,)."""
        return self.variables[: self.shape.count]

    @property
    def walk(self) -> np.ndarray:
        """Numbers of the walk that was sought, (G,); empty if none was."""
        return self.variables[self.shape.count :]

    @property
    def mesh(self) -> TetMesh:
        """Mesh of the optimised sole."""
        return self.step.sole.mesh

    @property
    def shape(self) -> SphericalSpline:
        """The spline whose coefficients were sought.

        `shape.deform(points, coefficients)` moves points [m], (n, 3).
        """
        return self.problem.spline

    @property
    def history(self) -> dict[str, np.ndarray]:
        """The K iterations of all stages: columns by name, (K,) each.

        The columns are stage, iteration, cost (c/|c̄| plus regularization),
        violation and dual_infeasibility.
        """
        rows = [
            [best.stage + 1, *row] for best in self.optima for row in best.trace
        ]
        columns = np.array(rows, dtype=float).reshape(-1, len(TRACE)).T
        return dict(zip(TRACE, columns, strict=True))

    @property
    def _told(self) -> dict[str, float]:
        """The smoothed law's c and the exact law's relative change from it."""
        e = self.problem.evaluate(self.variables)
        if e is None:
            return {}
        c = e.c_tr - self.setup.settings.cost.weight * e.c_rot
        return {"c_smoothed": c, "exact_change": self.step.c / c - 1}

    def summary(self) -> dict:
        """What summary.json says of the design, without checks and times."""
        now, first = self.step.summary(), self.first
        row = {
            key: now[key]
            for key in (
                "name", "c_tr", "c_rot", "c", "failed_steps", "failures",
                "volume_cm3", "mass_kg", "stable", "stability_min_n_per_m",
                "tilt_max_deg", "max_strain", "tets", "contact_nodes",
                "least_quality", "weight", "undercut", "c_tr_mean_n_per_m",
                "c_rot_mean_nm_per_rad",
            )
        }  # fmt: skip
        row["loads"] = [
            mine | {"c_initial": its["c"], "ratio": mine["c"] / abs(its["c"])}
            for mine, its in zip(now["loads"], first.loads(), strict=True)
        ]
        last = self.optima[-1] if self.optima else None
        row |= {
            "c_tr_initial": first.c_tr,
            "c_rot_initial": first.c_rot,
            "c_initial": first.c,
            "ratio_tr": now["c_tr"] / first.c_tr,
            "ratio_rot": now["c_rot"] / first.c_rot,
            "optimal": bool(last and last.optimal),
            "starts": self.starts,
            "spread": self.spread,
            "active": self.active(),
            "gait": self.gait,
            **self.setup.ground_told,
        }
        if last is not None:
            names = self.problem.names()
            row |= {
                "status": last.status,
                "optimality_error": last.error,
                "complementarity": last.complementarity,
                "violation": last.violation,
                "multipliers": dict(zip(names, last.multipliers, strict=True)),
                "iterations": [
                    int(o.trace[-1][0] - o.trace[0][0]) if o.trace else 0
                    for o in self.optima
                ],
                "simulations": sum(o.simulations for o in self.optima),
            }
        return row | self._told

    @property
    def _surface(self) -> dict[str, float]:
        """Depth, height and draft over all bare surface, fixed parts too."""
        limits = self.problem.surface
        all_nodes = np.ones_like(limits.moving)
        return replace(limits, moving=all_nodes).measures(self.mesh)

    def active(self) -> list[str]:
        """Names of the active limits, and of what the shape has to keep."""
        values = self.problem.constraints(self.variables)
        names = [
            name
            for name, value in zip(self.problem.names(), values, strict=True)
            if value < _ACTIVE
        ]
        if self.shape.symmetric:
            names.append("symmetric")
        if self.shape.kept:
            names.append(f"{len(self.shape.kept)} coefficients fixed")
        return names

    @property
    def spread(self) -> float | None:
        """Range of cost of the feasible starts that went furthest.

        Relative to the best; None where there are fewer than two.
        """
        stages = [row.get("stage", 1) for row in self.starts]
        costs = [
            row["cost"]
            for row, stage in zip(self.starts, stages, strict=True)
            if row["violation"] <= FEASIBLE and stage == max(stages)
        ]
        if len(costs) < 2:
            return None
        return (max(costs) - min(costs)) / abs(min(costs))

    def check_finer(
        self, say: Callable[[str], object] | None = None
    ) -> dict | None:
        """Simulate the design and the initial shape on a finer mesh.

        See `finer_mesh`. `change` (of the design) and `brick_change` (of the
        initial shape) are the relative change of c from the last stage's mesh;
        NaN if the shape turns finer elements over. Returns None if a finer
        mesh would have too many elements. `say` is called with one line of
        progress now and then.
        """
        last = self.setup.settings.optimize.stages[-1]
        base = finer_mesh(self.setup.mesh, last)
        if base is None:
            return None
        nodes = self.shape.deform(base.nodes, self.coefficients)
        first, shaped = map(self.setup.sole, (base, base.with_nodes(nodes)))
        out = {"tets": len(base.tets)}

        def told(done, count):
            if say is not None:
                say(f"finer mesh, {done} of {count} samples")

        for name, key, sole, before in (
            ("brick", "brick_change", first, self.first),
            ("design", "change", shaped, self.step),
        ):
            out[name], out[key] = None, np.nan
            if sole.mesh.volumes.min() > 0:
                step = Step.of(self.setup, sole, first.penalty, told)
                out[name] = {
                    "c_tr": step.c_tr, "c_rot": step.c_rot, "c": step.c,
                    "failed_steps": step.failed_steps,
                }  # fmt: skip
                out[key] = step.c / before.c - 1
        return out

    def plot(self):
        """Figure of both stiffnesses over time, beside the initial shape's."""
        return self.step.plot("optimised", initial=self.first)

    def write_animation(self, path: Path | str) -> None:
        """Write an HTML page that plays the step of both shapes."""
        self.step.write_animation(
            path, self.verdict().mark, **{"initial shape": self.first}
        )

    def verdict(
        self, accepted: Sequence[str] = (), finer: dict | None = None
    ) -> Verdict:
        """The checks of the design, and whether each holds or is accepted.

        Besides the checks of its step, these are the case's limits by the
        exact law, and notes on the search.

        Args:
            accepted: Names of checks that the user accepts.
            finer: What `check_finer` returned, if it was called.
        """
        limits, name = self.problem.limits, self.setup.name
        surface = self.problem.surface.measures(self.mesh)
        cm3 = 1e6 * self.mesh.volume
        shaped = ", or begin with a shape that is within it"
        further = dict.fromkeys(("depth", "height", "draft"), shaped) | {
            "c_rot": ", or ask for some percent more: the search's smoothed "
            "law and few samples overrate c_rot"
        }
        # Limits on tilt and stability do not hold for prescribed poses.
        free = ~self.setup.load.is_measured
        margin = np.min(self.step.stability[free], initial=np.inf)
        tilt = np.max(self.step.tilt_deg[free], initial=0.0)
        held = [
            ("volume", cm3, 1e6 * limits["volume"], "cm³", 1),
            ("strain", self.step.largest_strain, limits.get("strain"), "", 1),
            ("tilt", tilt, limits.get("tilt_deg"), "°", 1),
            ("stability", margin, limits.get("stability"), "N/m", -1),
            ("c_rot", self.step.c_rot, limits.get("c_rot"), "N·m/rad", -1),
            ("depth", surface["depth"], limits.get("depth"), "m", -1),
            ("height", surface["height"], limits.get("height"), "m", 1),
            ("draft", surface["draft"], limits.get("draft_deg"), "°", -1),
        ]
        checks = [
            Check(
                f"bounds.{what}",
                bool(sign * (value - limit) <= ROUNDING * limit + 1e-9),
                float(value), limit, unit, name,
                "the design by the exact law is outside the case's limit; "
                "optimise it longer (resume, iterations)"
                + further.get(what, ""),
            )
            for what, value, limit, unit, sign in held
            if limit is not None
        ]  # fmt: skip

        def note(what, holds, value, limit, sentence) -> None:
            checks.append(
                Check(what, holds, value, limit, "", name, sentence, "note")
            )

        if self.optima:
            last = self.optima[-1]
            remedy = "more starts may lead further"
            if last.status == ITERATION_LIMIT:
                remedy = "go on (resume) with more iterations"
            said = (
                f"the search ended before it was optimal ({last.status}); "
                f"{remedy}"
            )
            note("optimum", bool(last.optimal), None, None, said)
            change = self._told.get("exact_change", np.nan)
            if np.isfinite(change):
                note(
                    "plausibility.law", bool(abs(change) <= _EXACT), change,
                    _EXACT, "c by the exact law with all samples differs by "
                    "this share from c in the search: give "
                    "optimize.stages a smaller layer_m (stiff soles, "
                    "light loads) or more samples",
                )  # fmt: skip
        if finer is not None:
            change = finer["change"]
            value, said = change, (
                "on a finer mesh c changes by this share; the elements are too "
                "coarse for this design: optimise it on a finer mesh"
            )  # fmt: skip
            if np.isnan(change):
                value = None
                said = (
                    "the design turns elements of a finer mesh inside out"
                    if finer["design"] is None
                    else "samples have no equilibrium on a finer mesh"
                )
            holds = bool(abs(change) <= _FINER)
            note("plausibility.mesh", holds, value, _FINER, said)
        return Verdict((*self.step.verdict().checks, *checks), tuple(accepted))

    def write(
        self,
        folder: Path | str,
        say: Callable[[str], object] | None = None,
        accepted: Sequence[str] = (),
    ) -> dict:
        """Write all results and, last, summary.json.

        Before that, the design is checked on a finer mesh and in finite strain.

        Args:
            folder: Where to write; made if it does not exist.
            say: Called with one line of progress now and then.
            accepted: Names of checks that the user accepts.

        Returns:
            What summary.json holds.
        """
        folder, began = path_of(folder, "folder"), time.perf_counter()
        folder.mkdir(parents=True, exist_ok=True)
        row, finer = self.summary(), self.check_finer(say)
        verdict = self.verdict(accepted, finer)
        row |= verdict.summary() | {"finer": finer}
        row["seconds"] = round(self.seconds + time.perf_counter() - began, 2)
        row["stages_seconds"] = [round(best.seconds, 2) for best in self.optima]
        write_json(
            folder / DESIGN,
            {
                "intervals": self.shape.intervals,
                "fixed_top": self.shape.fixed_top,
                "symmetric": self.shape.symmetric,
                "kept": self.shape.kept,
                "coefficients": self.coefficients,
                "stage": len(self.setup.settings.optimize.stages),
            },
        )
        row["stl"] = self._write_stl(folder)
        for step, mesh, table, history in (
            (self.step, MESH, STEPS, HISTORY),
            (self.first, "initial.vtk", "initial_steps.csv", FIRST_HISTORY),
        ):
            write_vtk(folder / mesh, step.sole.mesh)
            step.write_tables(folder / table, folder / history)
        write_csv(folder / "history.csv", self.history)
        if say is not None:
            say("pictures")
        self._draw(folder, verdict.mark)
        write_case(folder, self.setup.settings, self.setup.start)
        began = time.perf_counter()
        found = compare_strains(replace(self.setup, mesh=self.mesh), say)
        write_table(folder, {self.setup.name: found}, verdict.mark)
        found["solve_seconds"] = round(time.perf_counter() - began, 2)
        row["finite_strain"] = found
        write_json(folder / SUMMARY, row)
        return row

    def _write_stl(self, folder: Path) -> dict:
        """Write sole and mould for printing; what was checked of them."""
        sole = self.mesh.nodes[self.mesh.boundary_faces]
        measured = self._surface
        told = {
            "sole.stl": {
                "watertight": is_watertight(sole),
                "least_depth_mm": 1e3 * measured["depth"],
                "height_mm": 1e3 * measured["height"],
                "least_draft_deg": measured["draft"],
                "undercut": self.mesh.undercut,
            }
        }
        write_triangles(folder / "sole.stl", sole)
        mould = mould_triangles(self.mesh)
        if len(mould):
            write_triangles(folder / "mould.stl", mould)
            told["mould.stl"] = {
                "watertight": is_watertight(mould),
                "least_wall_mm": 1e3 * WALL,
            }
        return told

    def _draw(self, folder: Path, mark: str) -> None:
        # matplotlib takes half a second to load.
        from drake_exo.soles import pictures

        self.step.draw(folder, mark, "optimised", initial=self.first)
        drawn = (
            self.setup.name,
            f"{1e6 * self.mesh.volume:.0f} cm³",
            self.first.sole.mesh,
            self.mesh,
            pictures.radial_change(self.mesh, self.shape, self.coefficients),
        )
        histories = {self.setup.name: self.history}
        for name, figure in (
            ("shape", pictures.soles_figure([drawn])),
            ("history", pictures.histories_figure(histories)),
        ):
            save_figure(folder / f"{name}.png", figure, mark)


def verified(setup: Setup, problem, at: Checkpoint, optima) -> Design:
    """The design at a search's checkpoint, simulated by the exact law."""
    step, penalty = problem.step(at.p), problem.law.penalty
    setup = replace(setup, load=step.setup.load)
    first = Step.of(setup, problem.first.sole, penalty)
    return Design(setup, problem, at.p, step, first, optima, at.starts)
