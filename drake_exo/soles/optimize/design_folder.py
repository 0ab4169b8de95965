"""What `sole optimize` and `sole study` leave on disk, read back."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files import schema
from drake_exo.files.output import read_json
from drake_exo.soles import loads
from drake_exo.soles.case import Case, StartBlock, read_case
from drake_exo.soles.contact.newton import Start
from drake_exo.soles.elasticity.linear import Sole
from drake_exo.soles.loads import Load
from drake_exo.soles.mesh import TetMesh, read_mesh
from drake_exo.soles.shape import SphericalSpline

CASE, MESH, STEPS, SUMMARY, DESIGN = (
    "case.yaml",
    "sole.vtk",
    "steps.csv",
    "summary.json",
    "design.json",
)
_COSTS = ("c_tr", "c_rot", "c", "ratio_tr", "ratio_rot")


@dataclass
class StoredDesign:
    """An optimised sole as its folder holds it.

    Attributes:
        folder: Where it lies.
        case: Its case, with the start filled in.
        mesh: The optimised mesh.
        load: Force and ZMP of every sample.
    """

    folder: Path
    case: Case
    mesh: TetMesh
    load: Load

    @property
    def name(self) -> str:
        """The case's name."""
        return self.case.name

    @property
    def sole(self) -> Sole:
        """Mesh and material, not yet condensed."""
        return self.case.sole(self.mesh)

    @property
    def start(self) -> Start:
        """How the sole is held before contact."""
        return self.case.start_pose(self.mesh)

    def summary(self) -> dict:
        """Its summary.json."""
        return read_summary(self.folder)

    def shape(self) -> tuple[SphericalSpline, np.ndarray]:
        """Its spline and free coefficients.

        Raises:
            InputError: design.json is missing or damaged.
        """
        path, remedy = self.folder / DESIGN, "optimise the sole again"
        data = read_json(path, remedy)
        try:
            n_theta, n_phi = map(int, data["intervals"])
            spline = SphericalSpline((n_theta, n_phi), bool(data["fixed_top"]))
            p = np.array(data["coefficients"], dtype=float)
        except (ValueError, KeyError, TypeError, OverflowError):
            raise InputError(f"{path}: holds no design; {remedy}") from None
        if p.shape != (spline.count,):
            raise InputError(f"{path}: coefficients do not fit; {remedy}")
        return spline, p


def write_case(folder: Path, case: Case, start: Start) -> Case:
    """Write the case beside its design, as `sole simulate` reads it.

    The start is written out: its default depends on the initial mesh, which
    the folder does not hold.

    Returns:
        The case with its start written out.
    """
    block = StartBlock(
        tuple(map(float, start.point_L)),
        tuple(map(float, start.point_W[:2])),
        float(start.yaw),
    )
    case = replace(case, start=block)
    (folder / CASE).write_text(schema.dump_text(case), encoding="utf-8")
    return case


def find_designs(folder: Path) -> list[StoredDesign]:
    """The design in a folder, or those in a study's folders, in order.

    Raises:
        InputError: There is none.
    """
    if (folder / CASE).is_file():
        return [read_design(folder)]
    names = []
    if (folder / SUMMARY).is_file():
        rows = read_summary(folder).get("cases", [])
        names = [r["name"] for r in rows if (folder / r["name"]).is_dir()]
    if not names:
        raise InputError(
            f"{folder}: holds no design; give a folder that 'sole optimize' "
            "or 'sole study' has written"
        )
    return [read_design(folder / name) for name in names]


def read_design(folder: Path) -> StoredDesign:
    """Read one design.

    Raises:
        InputError: A file is missing or damaged.
    """
    for name in (CASE, MESH, STEPS):
        if not (folder / name).is_file():
            raise InputError(
                f"{folder / name}: is missing; optimise the sole again"
            )
    case = read_case(folder / CASE)
    mesh = read_mesh(folder / MESH, (0.0, 0.0, 0.0))
    return StoredDesign(folder, case, mesh, loads.read_csv(folder / STEPS))


def read_summary(folder: Path) -> dict:
    """The summary.json of a folder; costs not found are NaN.

    Raises:
        InputError: It cannot be read, or is no JSON.
    """
    data = read_json(folder / SUMMARY, "optimise the sole again")
    missing = [key for key in _COSTS if key in data and data[key] is None]
    return data | dict.fromkeys(missing, np.nan)


def read_steps(path: Path) -> dict[str, np.ndarray]:
    """Columns of a steps.csv by name.

    Raises:
        InputError: It cannot be read.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        names = lines[0].split(",")
        rows = [[float(v) for v in line.split(",")] for line in lines[1:]]
        values = np.array(rows).reshape(-1, len(names))
        return dict(zip(names, values.T, strict=True))
    except (OSError, ValueError, IndexError):
        raise InputError(
            f"{path}: no table of a step; optimise the sole again"
        ) from None
