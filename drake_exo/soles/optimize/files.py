"""Files of an optimisation: checkpoints, and reading designs back."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError, path_of
from drake_exo.files import schema
from drake_exo.files.output import (
    read_arrays,
    read_json,
    stored_mark,
    write_json,
)
from drake_exo.soles.contact.law import FLAT, Ground
from drake_exo.soles.contact.newton import Start
from drake_exo.soles.loads import Load, read_columns, read_csv
from drake_exo.soles.mesh import SphericalSpline, read_mesh
from drake_exo.soles.numerics import rotations_xyz
from drake_exo.soles.settings import Settings, Setup, StartBlock
from drake_exo.soles.simulation import HISTORY

CHECKPOINT = "checkpoint.json"
# Columns of history.csv, of every iteration.
TRACE = ("stage", "iteration", "cost", "violation", "dual_infeasibility")
_LARGEST = 1e30


@dataclass(frozen=True)
class Checkpoint:
    """Where a search stands, to continue it.

    Attributes:
        stage, iteration: Stage to continue (from 0), its iterations done.
        p: Best design so far (P,); None as long as a run's starts are tried.
        latest: The optimiser's latest point (P,).
        multipliers: Multipliers of the constraints there, (m,).
        barrier: IPOPT's barrier parameter μ to continue with.
        curvature: BFGS approximation of the Hessian, (P, P).
        strain_scale: `search.strain_scale` of the design that the stage began
            with.
        starts: A start's rows: stage, cost, violation and cost on a finer mesh
            after every stage done; a run's: the last row of each of its starts
            or walks.
        alone: If a walk is sought, coefficients of the sole found for the
            case's own walk, (k,).
        begun: Checkpoints of the starts, or later the walks, that are being
            tried; None for those without one.
        case: The case's name; "" if a file of an earlier version lacks it.
        key: `Setup.key` of the case that is searched; "" likewise.
    """

    stage: int = 0
    iteration: int = 0
    p: np.ndarray | None = None
    latest: np.ndarray | None = None
    multipliers: np.ndarray | None = None
    barrier: float | None = None
    curvature: np.ndarray | None = None
    strain_scale: float = 1.0
    starts: tuple[dict, ...] = ()
    alone: np.ndarray | None = None
    begun: tuple["Checkpoint | None", ...] = ()
    case: str = ""
    key: str = ""

    @property
    def is_alone(self) -> bool:
        """Whether the sole alone is found, its walks not yet tried."""
        return self.alone is not None and len(self.p) == len(self.alone)

    def check(self) -> None:
        """Raise ValueError if a value is none that a run writes."""
        numbers, rows = [self.p, self.curvature], self.starts
        if self.alone is not None:
            numbers.append(self.alone)
        if self.barrier is not None:
            numbers += [self.latest, self.multipliers]
        sound = (
            self.stage >= 0
            and self.iteration >= 0
            and 0.0 < self.strain_scale < _LARGEST
            and (self.barrier is None or 0.0 < self.barrier < _LARGEST)
            and all((np.abs(x) < _LARGEST).all() for x in numbers)
            and self.latest.shape == self.p.shape
            and (self.multipliers is None or self.multipliers.ndim == 1)
            and (self.alone is None or self.alone.ndim == 1)
            and not any(np.isnan(r["cost"] + r["violation"]) for r in rows)
        )
        if not sound:
            raise ValueError("not a checkpoint")

    def after(self, stage, iteration, best, curvature) -> "Checkpoint":
        """The checkpoint after some iterations of a stage, from its best."""
        latest, multipliers, barrier = best.latest or (best.p, None, None)
        return replace(
            self, stage=stage, iteration=iteration, p=best.p, latest=latest,
            multipliers=multipliers, barrier=barrier, curvature=curvature,
            begun=(),
        )  # fmt: skip

    def check_fits(self, problem) -> None:
        """Refuse a checkpoint of another problem.

        Raises:
            InputError: The number of coefficients or of limits differs.
        """
        count, names = len(problem.undeformed), problem.names()
        if len(self.p) != count:
            raise InputError(
                f"resume: the checkpoint has {len(self.p)} coefficients, but "
                f"the case has {count}; it is of another case, or of an "
                "earlier version"
            )
        if self.alone is not None and len(self.alone) != problem.spline.count:
            raise InputError(
                f"resume: the checkpoint's sole alone has {len(self.alone)} "
                f"coefficients, but the case has {problem.spline.count}; it is "
                "of another case"
            )
        if self.multipliers is not None and len(self.multipliers) != len(names):
            raise InputError(
                f"resume: the checkpoint has {len(self.multipliers)} limits, "
                f"but the case has {len(names)} ({', '.join(names)}); give the "
                "same case and limits"
            )

    def write(self, folder: Path | None) -> None:
        """Write checkpoint.json atomically; make its folder if need be.

        None keeps nothing.
        """
        if folder is None:
            return
        kept = vars(self) | {
            "coefficients": self.p,
            "curvature": self.curvature[np.tril_indices(len(self.p))],
        }
        del kept["p"], kept["begun"]
        folder.mkdir(exist_ok=True)
        write_json(folder / CHECKPOINT, kept)


def start_folder(out: Path | None, start: int) -> Path | None:
    """Folder of a start's or walk's checkpoint, while several are tried."""
    return None if out is None else out / f"start_{start}"


def _start(kept: dict) -> dict:
    """A start's row; infinite costs, of no simulation, are kept as null."""
    failed = [key for key in ("cost", "violation") if kept[key] is None]
    return kept | dict.fromkeys(failed, np.inf)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint from its file or folder, with those of its starts.

    Raises:
        InputError: Missing or not a checkpoint.
    """
    if path.name == CHECKPOINT:  # the starts' folders lie beside it
        path = path.parent
    file = path / CHECKPOINT if path.is_dir() else path
    starts = sorted(path.glob("start_*")) if path.is_dir() else []
    begun = {
        int(number): read_checkpoint(start)
        for start in starts
        if (number := start.name.partition("_")[2]).isdecimal()
        and (start / CHECKPOINT).exists()
    }
    begun = tuple(map(begun.get, range(max(begun, default=-1) + 1)))
    if starts and not file.exists():
        known = next(filter(None, begun), Checkpoint())
        return Checkpoint(begun=begun, case=known.case, key=known.key)
    remedy = "give the folder of an interrupted run"
    data = read_json(file, remedy)

    def optional(key, kind):
        return None if data[key] is None else kind(data[key])

    try:
        data = {"alone": None} | data
        p = np.array(data["coefficients"], dtype=float)
        B = np.zeros((len(p), len(p)))
        B[np.tril_indices(len(p))] = data["curvature"]
        found = Checkpoint(
            int(data["stage"]),
            int(data["iteration"]),
            p,
            np.array(data["latest"], dtype=float),
            optional("multipliers", np.array),
            optional("barrier", float),
            B + np.tril(B, -1).T,
            float(data.get("strain_scale", 1.0)),
            tuple(map(_start, data.get("starts") or ())),
            optional("alone", np.array),
            case=str(data.get("case", "")),
            key=str(data.get("key", "")),
        )
        found.check()
        if found.is_alone:  # the folders beside it are the walks'
            found = replace(found, begun=begun)
    except (ValueError, KeyError, TypeError, OverflowError):
        raise InputError(f"{file}: not a checkpoint; {remedy}") from None
    return found


CASE, MESH, STEPS = "case.yaml", "sole.vtk", "steps.csv"
SUMMARY, DESIGN = "summary.json", "design.json"
_COSTS = ("c_tr", "c_rot", "c", "ratio_tr", "ratio_rot")
_SIZES = ("tets", "volume_cm3", "max_strain", "tilt_max_deg", "seconds")
_SHOWN = (*_COSTS, *_SIZES, "optimal", "stable")


@dataclass
class StoredDesign:
    """An optimised sole, read from the folder that holds it.

    >>> import tempfile
    >>> import drake_exo as dx
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     row = case.optimize().write(folder)
    ...     (stored,) = dx.soles.find_designs(folder)
    ...     spline, coefficients = stored.shape()
    >>> stored.name, stored.setup.mesh.volume < case.mesh.volume
    ('example', True)

    Attributes:
        folder: The folder.
        setup: The case's settings with the start filled in, the optimised
            mesh, and the load.
    """

    folder: Path
    setup: Setup

    def __repr__(self) -> str:
        return f"StoredDesign({self.name!r}, {str(self.folder)!r})"

    @property
    def name(self) -> str:
        """The case's name."""
        return self.setup.name

    def summary(self) -> dict:
        """The contents of summary.json.

        Raises:
            InputError: A figure that reports show is missing.
        """
        found = read_summary(self.folder)
        for key in _SHOWN:
            if not isinstance(found.get(key), int | float):
                raise InputError(
                    f"{self.folder / SUMMARY}: {key} is missing, or no number; "
                    "optimise the sole again"
                )
        return found

    @property
    def mark(self) -> str:
        """The `Verdict.mark` of its summary.json; empty if the design holds."""
        return stored_mark(read_summary(self.folder), self.folder / SUMMARY)

    def history(self) -> dict[str, np.ndarray]:
        """The columns of history.csv by name, see `TRACE`.

        Raises:
            InputError: It is missing or damaged.
        """
        path = kept_file(self.folder, "history.csv")
        return read_columns(path, TRACE, may_be_empty=True)

    def shape(self) -> tuple[SphericalSpline, np.ndarray]:
        """The spline of the shape, and its free coefficients.

        Raises:
            InputError: design.json is missing or damaged.
        """
        path, remedy = self.folder / DESIGN, "optimise the sole again"
        data = read_json(path, remedy)
        try:
            n_theta, n_phi = map(int, data["intervals"])
            spline = SphericalSpline(
                (n_theta, n_phi),
                bool(data["fixed_top"]),
                bool(data.get("symmetric", False)),
                tuple(map(int, data.get("kept", ()))),
            )
            p = np.array(data["coefficients"], dtype=float)
            fits = p.shape == (spline.count,) and np.isfinite(p).all()
        except (ValueError, KeyError, TypeError, OverflowError):
            raise InputError(f"{path}: holds no design; {remedy}") from None
        if not fits:
            raise InputError(f"{path}: coefficients do not fit; {remedy}")
        return spline, p


def write_case(folder: Path, settings: Settings, start: Start) -> None:
    """Write case.yaml with the start written out; paths stay as they were.

    The start's default depends on the initial mesh, which is not in the folder.
    """
    block = StartBlock(
        tuple(map(float, start.point_L)),
        tuple(map(float, start.point_W[:2])),
        float(start.yaw),
    )
    settings = replace(settings, start=block)
    (folder / CASE).write_text(schema.dump_text(settings), encoding="utf-8")


def find_designs(folder: Path | str) -> list[StoredDesign]:
    """Read the design in a folder, or a study's designs in their order.

    >>> import drake_exo as dx
    >>> dx.soles.find_designs("nowhere")
    Traceback (most recent call last):
    drake_exo.errors.InputError: nowhere: holds no design; give a folder ...

    Raises:
        InputError: There is none.
    """
    folder = path_of(folder, "folder")
    if (folder / CASE).is_file():
        return [read_design(folder)]
    names = []
    if (folder / SUMMARY).is_file():
        rows = read_summary(folder).get("cases", [])
        names = [r["name"] for r in rows if (folder / r["name"]).is_dir()]
    else:  # those without limits, which stand in the study's own summary.json
        names = sorted(file.parent.name for file in folder.glob(f"*/{CASE}"))
    if not names:
        raise InputError(
            f"{folder}: holds no design; give a folder that 'sole optimize' "
            "or 'sole study' has written (to 'sole strain' also a case file)"
        )
    return [read_design(folder / name) for name in names]


def kept_file(folder: Path, name: str) -> Path:
    """Path of a design's file.

    Raises:
        InputError: It is missing.
    """
    if not (folder / name).is_file():
        raise InputError(
            f"{folder / name}: is missing; optimise the sole again"
        )
    return folder / name


def read_design(folder: Path) -> StoredDesign:
    """Read one design.

    Raises:
        InputError: A file is missing or damaged.
    """
    settings = Settings.read(kept_file(folder, CASE))
    mesh = read_mesh(kept_file(folder, MESH), (0.0, 0.0, 0.0))
    load, ground = read_csv(kept_file(folder, STEPS)), FLAT
    if settings.ground is not None:
        kept = read_arrays(folder / HISTORY, "optimise the sole again")
        ground = Ground.of_arrays(kept)
    start = settings.start_pose(mesh, ground)
    held = _held(settings, load)
    if held.any():
        names = "roll_deg", "pitch_deg", "yaw_deg"
        table = read_columns(folder / STEPS, names, names)
        angles = [table[name] for name in names]
        R = rotations_xyz(np.deg2rad(angles).T)
        R[~held[load.phase]] = np.nan
        zmp_x, zmp_y, moment = (
            table.get(f"recorded_{name}", table.get(name))
            for name in ("zmp_x_m", "zmp_y_m", "free_moment_nm")
        )
        zmp = np.column_stack([zmp_x, zmp_y])
        load = replace(load, zmp=zmp, free_moment=moment, rotation=R)
    return StoredDesign(folder, Setup(settings, load, mesh, start, ground))


def _held(settings: Settings, load: Load) -> np.ndarray:
    """Contact phases whose pose is prescribed, (K,) bool.

    Phases are matched to blocks by weight, which those of a block share.
    """
    blocks, shares = settings.all_loads, load.shares
    ends = np.cumsum([block.weight for block in blocks])
    middle = np.cumsum(shares) - 0.5 * shares
    measured = np.array([block.pose == "measured" for block in blocks])
    return measured[np.searchsorted(ends / ends[-1], middle)]


def read_summary(folder: Path) -> dict:
    """Read a folder's summary.json; costs that are null become NaN.

    Raises:
        InputError: It cannot be read, or is not a summary.
    """
    remedy = "optimise the sole again"
    data = read_json(folder / SUMMARY, remedy)
    rows = data.get("cases", []) if isinstance(data, dict) else None
    if not isinstance(rows, list) or not all(
        isinstance(row, dict) and isinstance(row.get("name"), str)
        for row in rows
    ):
        raise InputError(f"{folder / SUMMARY}: is not a summary; {remedy}")
    missing = [key for key in _COSTS if key in data and data[key] is None]
    return data | dict.fromkeys(missing, np.nan)
