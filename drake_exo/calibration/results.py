"""The model that a result was computed with, on disk beside it.

Results of a phase on disk: summary, parameters, trajectories.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from drake_exo.calibration.measured import MeasuredMovement
from drake_exo.calibration.problem import PhaseProblem, PhaseResult, Trajectory
from drake_exo.calibration.scores import rmsd, spread
from drake_exo.calibration.settings import FootGroundSettings
from drake_exo.collocation.bushing_kernels import BUSHING_PARAMETERS, BUSHINGS
from drake_exo.collocation.kernels import SPHERE_PARAMETERS
from drake_exo.contact.parameters import ContactParameter
from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.opensim import write_table
from drake_exo.files.output import check_arrays, read_arrays, write_json
from drake_exo.files.schema import load
from drake_exo.files.tables import Table
from drake_exo.model.plant import COUPLED_COORDINATES
from drake_exo.model.segments import ExoskeletonParameters, HumanParameters
from drake_exo.nlp.ipopt import Solution
from drake_exo.report.tables import format_table

MODEL = "model.json"


@dataclass(frozen=True)
class ModelFile:
    """Subject and device, as `build_plant` takes them.

    Attributes:
        kind: of plant.
        human: the fitted subject.
        exoskeleton: the fitted device; None for the kind "human".
    """

    kind: Literal["coupled", "rigid", "human"]
    human: HumanParameters
    exoskeleton: ExoskeletonParameters | None = None


def write_model(folder: Path, model: tuple) -> None:
    """Write (kind, human, exoskeleton) into a folder of results."""
    write_json(folder / MODEL, ModelFile(*model))


def read_model(folder: Path) -> ModelFile:
    """Read what `write_model` wrote.

    Raises:
        InputError: it is missing or damaged.
    """
    path = Path(folder) / MODEL
    if not path.is_file():
        raise InputError(
            f"{path}: is missing, so the model of these results is unknown; "
            "run the command that wrote them again"
        )
    return load(path, ModelFile)


PARAMETERS = "parameters.json"
_LARGEST = 1e12  # of a parameter, in SI units
# Arrays of a trajectory: n nodes, q coordinates, c controls, t torques.
_TRAJECTORY = {
    "times": ("n",),
    "q": ("n", "q"),
    "v": ("n", "q"),
    "a": ("n", "q"),
    "jerk": ("c", "q"),
    "torque": ("n", "t"),
    "ground": ("n", 3),
}
COMPONENTS = ("tangential", "normal", "rotation")


@dataclass(frozen=True)
class Calibration:
    """Calibrated contact, as `parameters.json` holds it.

    Attributes:
        law: of the foot-ground contact.
        constants: of that law by name.
        parameters: name -> value, of spheres and, after Phase B, of
            bushings.
        units: parameter name -> unit.
        damping: segment -> tangential, normal, rotational damping; empty
            after Phase A.
    """

    law: Literal["simbody", "paper"]
    constants: dict[str, float]
    parameters: dict[str, float]
    units: dict[str, str]
    damping: dict[str, tuple[float, float, float]]

    def __post_init__(self):
        FootGroundSettings(self.law, self.constants).law_constants()
        groups = {"heel": SPHERE_PARAMETERS, "toe": SPHERE_PARAMETERS}
        if self.damping or any(s in self._segments() for s in BUSHINGS):
            groups |= dict.fromkeys(BUSHINGS, BUSHING_PARAMETERS)
            for segment in BUSHINGS:
                if segment not in self.damping:
                    raise InputError(f"damping of {segment} is missing")
        for group, names in groups.items():
            for name in (f"{group}.{n}" for n in names):
                if name not in self.parameters or name not in self.units:
                    raise InputError(f"{name} is missing")
                if not abs(self.parameters[name]) < _LARGEST:
                    raise InputError(f"{name} is out of all bounds")

    def _segments(self) -> set[str]:
        return {name.partition(".")[0] for name in self.parameters}

    def spheres(self) -> np.ndarray:
        """Sphere parameters (10,) in the kernel's order."""
        return np.array(
            [
                self.parameters[f"{sphere}.{name}"]
                for sphere in ("heel", "toe")
                for name in SPHERE_PARAMETERS
            ]
        )

    def bushings(self) -> list[ContactParameter]:
        """Bushing parameters in the kernel's order, fixed."""
        parameters = []
        for segment in BUSHINGS:
            for what in BUSHING_PARAMETERS:
                name = f"{segment}.{what}"
                value = self.parameters[name]
                parameters.append(
                    ContactParameter(
                        name,
                        self.units[name],
                        value,
                        value - 1.0,
                        value + 1.0,
                        free=False,
                    )
                )
        return parameters

    @property
    def has_bushings(self) -> bool:
        """Whether Phase B was done."""
        return bool(self.damping)


def write_parameters(
    folder: Path, problem: PhaseProblem, result: PhaseResult
) -> None:
    """Write all that a later phase needs of the contact models."""
    spheres, bushings = problem.contact_values(result.values())
    named = problem.foot.parameters((0.0, 0.0), (0.0, 0.0))
    units = {p.name: p.unit for p in named}
    values = dict(zip(units, spheres, strict=True))
    if len(bushings):
        values |= {p.name: p.nominal for p in result.parameters}
        units |= {p.name: p.unit for p in result.parameters}
    write_json(
        folder / PARAMETERS,
        {
            "law": problem.foot.law,
            "constants": asdict(problem.foot.law_constants()),
            "parameters": values,
            "units": units,
            "damping": getattr(problem, "damping", {}),
        },
    )


def read_calibration(folder: Path) -> Calibration:
    """Read a folder that a calibration has written.

    Raises:
        InputError: it holds none.
    """
    path = Path(folder) / PARAMETERS
    try:
        return schema.load(path, Calibration)
    except InputError as error:
        raise InputError(
            f"no calibrated parameters ({error}); give the --out folder of a "
            "successful 'drake-exo calibrate'"
        ) from error


def solve_summary(solution: Solution) -> dict:
    """How a solve went."""
    return {
        "success": solution.success,
        "status": solution.status,
        "strategy": solution.strategy,
        "iterations": solution.iterations,
        "objective": solution.objective,
        "infeasibility": solution.infeasibility,
        "worst_constraints": solution.worst_constraints,
        "binding_bounds": [str(b) for b in solution.binding],
        "build_seconds": solution.seconds["build"],
        "solve_seconds": solution.seconds["solve"],
        "part_seconds": solution.seconds,
        "evaluations": solution.evaluations,
        "num_variables": solution.num_variables,
        "num_constraints": solution.num_constraints,
        "jacobian_nonzeros": solution.jacobian_nonzeros,
    }


def phase_summary(
    phase: str,
    subject: str,
    result: PhaseResult,
    trials: list[MeasuredMovement],
) -> dict:
    """What summary.json holds of one program."""
    return {
        "phase": phase,
        "subject": subject,
        **solve_summary(result.solution),
        "settings": asdict(result.settings),
        "parameters": [
            {
                "name": p.name,
                "unit": p.unit,
                "value": p.nominal,
                "lower": p.lower,
                "upper": p.upper,
                "free": p.free,
                "at_bound": p.free and p.at_bound(p.nominal),
            }
            for p in result.parameters
        ],
        "rmsd": [
            rmsd(found, trial, loads=phase != "foot-ground")
            for found, trial in zip(result.trajectories, trials, strict=True)
        ],
        "measured_sd": spread(trials),
    }


def parameters_table(parameters: list[dict]) -> str:
    """The parameters of a summary as text."""
    rows = [
        [
            p["name"],
            f"{p['value']:.4g}",
            _interval(p),
            f"{p['lower']:.3g}",
            f"{p['upper']:.3g}",
            p["unit"],
            _remark(p),
        ]
        for p in parameters
    ]
    header = ["parameter", "value", "95 %", "lower", "upper", "unit", ""]
    return format_table(header, rows)


def _remark(parameter: dict) -> str:
    if not parameter["free"]:
        return "fixed"
    if parameter["at_bound"]:
        return "at bound"
    return "" if parameter.get("identifiable", True) else "weakly determined"


def _interval(parameter: dict) -> str:
    half = parameter.get("half_width_95")
    return "-" if half is None else f"± {half:.2g}"


def write_trajectories(folder: Path, trajectories: list[Trajectory]) -> None:
    """Motion and forces as OpenSim reads them, and all of it as .npz."""
    for t in trajectories:
        names = COUPLED_COORDINATES[: t.q.shape[1]]
        for kind, values in (("coordinates", t.q), ("speeds", t.v)):
            degrees = np.hstack([values[:, :2], np.rad2deg(values[:, 2:])])
            table = Table(t.times, names, degrees, in_degrees=True)
            write_table(
                folder / f"{t.name}_{kind}.sto", table, kind.capitalize()
            )
        cop = np.nan_to_num(t.cop_x)
        zero = np.zeros(len(t.times))
        force = np.column_stack(
            [t.ground[:, 0], t.ground[:, 1], zero, cop, *[zero] * 5]
        )
        columns = [f"ground_force_{k}{a}" for k in "vp" for a in "xyz"]
        columns += [f"ground_torque_{a}" for a in "xyz"]
        tables = {
            "ground_reaction": (columns, force, "Ground reaction"),
            "torques": (
                [f"{n}_moment" for n in names[3:]],
                t.torque,
                "Joint moments",
            ),
        }
        if t.interaction is not None:
            columns = [f"{s}_{c}" for s in BUSHINGS for c in COMPONENTS]
            tables["interaction"] = (
                columns,
                t.interaction,
                "Interaction on the human",
            )
        for kind, (columns, values, title) in tables.items():
            table = Table(t.times, tuple(columns), values, in_degrees=False)
            write_table(folder / f"{t.name}_{kind}.sto", table, title)
        arrays = {k: v for k, v in vars(t).items() if k != "name"}
        kept = {k: v for k, v in arrays.items() if v is not None}
        np.savez(folder / f"solution_{t.name}.npz", **kept)


def read_trajectory(folder: Path, name: str) -> Trajectory:
    """Read what `write_trajectories` wrote.

    Raises:
        InputError: it is not there.
    """
    path = folder / f"solution_{name}.npz"
    again = "run the phase again"
    arrays = read_arrays(path, again)
    shapes = dict(_TRAJECTORY)
    if "interaction" in arrays:
        shapes["interaction"] = ("n", 3 * len(BUSHINGS))
    check_arrays(path, arrays, shapes, again)
    if not all(np.isfinite(arrays[name]).all() for name in shapes):
        raise InputError(f"{path}: holds gaps; {again}")
    nq = arrays["q"].shape[1]
    if arrays["torque"].shape[1] != nq - 3 or set(arrays) != set(shapes):
        raise InputError(f"{path}: holds no trajectory; {again}")
    return Trajectory(name, **arrays)
