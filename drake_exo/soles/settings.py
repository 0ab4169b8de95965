"""Settings of a case file, and a `Setup` with the files that it names read.

Each block of keys is a dataclass; docs/soles.md explains all keys. Paths are
relative to --data-root if given, else to the case file's folder.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from drake_exo.errors import InputError, check_data_root, check_type, path_of
from drake_exo.files import schema
from drake_exo.files.output import checksum
from drake_exo.files.schema import exactly_one, not_negative, positive, quantity
from drake_exo.soles.contact.law import COLUMNS, FLAT, ContactLaw, Ground
from drake_exo.soles.contact.newton import Start
from drake_exo.soles.elasticity import MATERIALS, Material, Sole
from drake_exo.soles.load_blocks import (
    LoadBlock,
    StepReader,
    Vector2,
    Vector3,
    angle,
)
from drake_exo.soles.loads import Load, read_columns
from drake_exo.soles.mesh import (
    SphericalSpline,
    TetMesh,
    brick,
    check_frame,
    check_turned,
    halved,
    read_mesh,
)
from drake_exo.soles.numerics import rotation_z
from drake_exo.soles.surface import (
    SUFFIXES,
    Unit,
    read_surface,
    sole_from_surface,
)
from drake_exo.soles.walking_pattern import Gait


@dataclass(frozen=True)
class Brick:
    """A brick and its number of cells, see `mesh.brick`."""

    size_m: Vector3 = quantity("m", minimum=1e-3)
    divisions: tuple[int, int, int] = quantity(None, minimum=1)

    def __post_init__(self):
        check_turned(np.array([(0.0, 0.0, 0.0), self.size_m]), "size_m")


@dataclass(frozen=True)
class MeshBlock:
    """Where the mesh comes from: a file or a brick.

    A file is one of tetrahedra, or a closed surface (.stl, .obj), to which
    `unit`, `tets` and `top_m` belong.
    """

    file: str | None = None
    brick: Brick | None = None
    origin_m: Vector3 | None = None
    unit: Unit | None = None
    tets: int = quantity(None, 5000, minimum=500, maximum=1_000_000)
    top_m: float | None = quantity("m", None)
    element: Literal["linear", "smoothed"] = "smoothed"

    def __post_init__(self):
        exactly_one(self, ("file", "brick"))
        for name in ("unit", "origin_m", "top_m"):
            if self.brick is not None and getattr(self, name) is not None:
                raise InputError(
                    f"{name} is for a file, not for a brick; remove it"
                )
        if self.file is None or Path(self.file).suffix.lower() in SUFFIXES:
            return
        for name in ("unit", "top_m"):
            if getattr(self, name) is not None:
                raise InputError(
                    f"{name} is for a surface ({', '.join(SUFFIXES)}), but "
                    f"{self.file} is not one; remove it"
                )


@dataclass(frozen=True)
class MaterialBlock:
    """A named material; numbers given replace the named one's."""

    name: str
    youngs_modulus_pa: float | None = quantity(
        "Pa", None, minimum=1e3, maximum=1e12
    )
    poissons_ratio: float | None = None
    density_kg_per_m3: float | None = quantity(
        "kg/m³", None, minimum=10.0, maximum=3e4
    )

    def material(self) -> Material:
        """The material with its numbers filled in."""
        known = MATERIALS.get(self.name)
        given = {
            key: value for key, value in vars(self).items() if key != "name"
        }
        missing = [key for key, value in given.items() if value is None]
        if missing and known is None:
            raise InputError(
                f"material {self.name!r} is not one of {', '.join(MATERIALS)}; "
                f"give its {missing[0]}"
            )
        return Material(
            self.name, **given | {key: getattr(known, key) for key in missing}
        )


@dataclass(frozen=True)
class ContactBlock:
    """Friction of the contact, and the method that solves it."""

    # Above 0, else nothing holds the foot.
    friction: float = quantity("", 0.8, above=0.0, maximum=10.0)
    method: Literal["newton", "gauss_seidel"] = "newton"


@dataclass(frozen=True)
class GroundBlock:
    """Uneven ground: a CSV file of heights in the sole's world frame."""

    heights: str


@dataclass(frozen=True)
class StartBlock:
    """How the sole is held just before the first contact."""

    point_in_sole_m: Vector3 | None = None
    point_in_world_m: Vector2 | None = quantity(
        "m", None, minimum=-100.0, maximum=100.0
    )
    yaw_rad: float = angle()


@dataclass(frozen=True)
class CostBlock:
    """The paper's cost c = c_tr − w c_rot."""

    weight: float = not_negative("", 1.0)
    heel_strike_fraction: float = quantity(None, 0.1, above=0.0, maximum=1.0)
    mass_limit_kg: float = quantity("kg", 1.0, above=0.0, maximum=20.0)
    of: Literal["mean", "worst"] = "mean"


@dataclass(frozen=True)
class Stage:
    """One run of the optimiser.

    Attributes:
        divisions: Cells of the brick along x, y, z; None: the case's own mesh.
        samples: Number of the load's samples that are simulated; None: all.
        layer_m, kappa: Parameters of the smoothed contact law.
        iterations: Largest number of iterations.
        roughness: Factor on the case's roughness.
    """

    divisions: tuple[int, int, int] | None = quantity(None, None, minimum=1)
    samples: int | None = quantity(None, None, minimum=1)
    layer_m: float = quantity("m", 1e-5, above=0.0, maximum=0.01)
    kappa: float = quantity("", 0.1, minimum=0.0, maximum=1.0)
    iterations: int = quantity(None, 40, minimum=0, maximum=1_000_000)
    roughness: float = not_negative("", 1.0)


_FINE = (18, 12, 4)
# The fine mesh from the start, since strains and poses depend on the mesh.
# Smooth shapes first, by a large roughness. Then two stages: each begins with
# the true largest strain, and the second tells which start is best. The last
# has more samples, since an optimum fits itself to few.
STAGES = (
    Stage(_FINE, 24, 3e-4, 0.2, 24, roughness=10.0),
    Stage(_FINE, 24, 2e-4, 0.2, 28),
    Stage(_FINE, 36, 2e-4, 0.2, 100),
)


def without_divisions(stages: Sequence[Stage]) -> tuple[Stage, ...]:
    """The stages on the case's own mesh, as for one that is no brick."""
    return tuple(replace(stage, divisions=None) for stage in stages)


def stage_mesh(own: TetMesh, stage: Stage) -> TetMesh:
    """The stage's brick in the own mesh's bounding box, or the own mesh."""
    if stage.divisions is None:
        return own
    if not own.is_block:
        raise InputError(
            "optimize.stages: divisions need a brick as the initial shape, but "
            "this mesh is not one; leave them out"
        )
    return brick_like(own, stage.divisions)


_MOST = 200_000  # elements of a finer mesh: some 4 GB


def finer_mesh(own: TetMesh, stage: Stage) -> TetMesh | None:
    """A finer mesh than `stage_mesh`; None if it had too many elements.

    A brick gets at least twice the tets, any other mesh eight times as many,
    see `halved`.
    """
    if stage.divisions is not None:
        return brick_like(own, _at_least_twice(stage.divisions))
    return halved(own) if 8 * len(own.tets) <= _MOST else None


def _at_least_twice(divisions) -> tuple[int, int, int]:
    """Divisions that give at least twice, and little more, cells."""
    finer = np.ceil(2 ** (1 / 3) * np.array(divisions)).astype(int)
    for one in np.eye(3, dtype=int):
        if np.prod(finer - one) >= 2 * np.prod(divisions):
            finer = finer - one
    return tuple(finer.tolist())


def brick_like(own: TetMesh, divisions: tuple[int, int, int]) -> TetMesh:
    """A brick that fills the bounding box of another block."""
    low, high = own.nodes.min(axis=0), own.nodes.max(axis=0)
    base = brick(tuple(high - low), divisions)
    return base.with_nodes(
        base.nodes + np.append(0.5 * (low + high)[:2], high[2])
    )


@dataclass(frozen=True)
class ShapeBlock:
    """What the surface of a design has to keep, in the sole's frame."""

    symmetric: bool = False
    fixed_m: tuple[tuple[Vector3, Vector3], ...] = quantity(
        "m", (), minimum=-2.0, maximum=2.0
    )
    least_depth_m: float | None = quantity("m", None, above=0.0, below=1.0)
    largest_height_m: float | None = quantity("m", None, above=0.0, below=1.0)
    draft_deg: float | None = quantity("°", None, minimum=0.0, below=45.0)

    def __post_init__(self):
        low, high = self.least_depth_m, self.largest_height_m
        if low is not None and high is not None and low >= high:
            raise InputError(
                f"least_depth_m {low:g} has to be below largest_height_m "
                f"{high:g}"
            )


@dataclass(frozen=True)
class OptimizeBlock:
    """Shape parametrisation, limits and stages of an optimisation."""

    # Finer ones than any mesh would only take memory.
    intervals: tuple[int, int] = quantity(None, (10, 10), minimum=1, maximum=50)
    fixed_top: bool = False
    bounds: Vector2 = (0.3, 1.4)
    stability_n_per_m: float | None = positive("N/m", 1000.0)
    tilt_deg: float | None = quantity("°", 20.0, above=0.0, maximum=90.0)
    strain: float | None = quantity("", 0.3, above=0.0, maximum=2.0)
    c_rot_nm_per_rad: float | None = quantity("N·m/rad", None, minimum=1e-3)
    roughness: float = not_negative("", 1.0)
    tolerance: float = positive("", 1e-4)
    starts: int = quantity(None, 3, minimum=1, maximum=1000)
    stages: tuple[Stage, ...] | None = None
    shape: ShapeBlock = ShapeBlock()

    def __post_init__(self):
        if not 0 < self.bounds[0] < 1 < self.bounds[1]:
            raise InputError(
                f"bounds {list(self.bounds)} must lie around 1, the initial "
                "shape, and above 0"
            )
        if self.stages is not None and not self.stages:
            raise InputError("stages: give at least one")


@dataclass(frozen=True)
class Settings:
    """Everything that a case file says; the fields are the file's keys.

    >>> import drake_exo as dx
    >>> case = dx.soles.Case.from_text(dx.soles.EXAMPLE)
    >>> case.settings.contact.friction, case.settings.optimize.tilt_deg
    (0.8, 20.0)
    """

    name: str
    mesh: MeshBlock
    material: MaterialBlock
    load: LoadBlock | None = None
    contact: ContactBlock = ContactBlock()
    start: StartBlock = StartBlock()
    cost: CostBlock = CostBlock()
    optimize: OptimizeBlock = OptimizeBlock()
    loads: tuple[LoadBlock, ...] = ()
    ground: GroundBlock | None = None

    def __post_init__(self):
        if (self.load is None) == (not self.loads):
            raise InputError("give either load, or loads as a list of such")
        if self.load is not None and self.load.weight != 1.0:
            raise InputError(
                f"load.weight is {self.load.weight:g}, but a single load is "
                "weighed against no other; leave it out, or give several loads"
            )
        for k, block in enumerate(self.all_loads):
            free = block.pattern is not None and block.pattern.free
            if free and (self.loads or block.straight):
                which = f"loads[{k}]" if self.loads else "load"
                raise InputError(
                    f"{which}.pattern.free: a walk can only be sought for a "
                    "single load that is not straight; leave it out here"
                )
        self.material.material()
        if self.optimize.stages is None:
            stages = STAGES if self.mesh.brick else without_divisions(STAGES)
            block = replace(self.optimize, stages=stages)
            object.__setattr__(self, "optimize", block)

    @property
    def all_loads(self) -> tuple[LoadBlock, ...]:
        """The entries of `loads`, or the one `load`."""
        return self.loads or (self.load,)

    @property
    def files(self) -> list[str]:
        """Paths of mesh, ground and loads, as the case gives them."""
        found = [load.file for load in self.all_loads]
        found += [self.mesh.file, self.ground and self.ground.heights]
        return [file for file in found if file is not None]

    def walking_on(self, places: np.ndarray) -> "Settings":
        """Settings whose walking patterns keep the ZMP inside a sole.

        Args:
            places: Places of the sole's nodes in its frame [m], (m, 2).
        """
        load, *loads = (
            block if block is None or block.pattern is None
            else replace(block, pattern=block.pattern.within(places))
            for block in (self.load, *self.loads)
        )  # fmt: skip
        return replace(self, load=load, loads=tuple(loads))

    @classmethod
    def read(cls, path: Path | str) -> "Settings":
        """Read a case file alone, not the files that it names.

        Raises:
            InputError: It cannot be read; the message has file, line, key and
                remedy.
        """
        return schema.load(path, cls)

    def read_mesh(self, root: Path, replacement: Path | None = None) -> TetMesh:
        """Read the case's mesh, or the file given instead of it."""
        block = self.mesh
        if replacement is None and block.brick is not None:
            return brick(block.brick.size_m, block.brick.divisions)
        path = path_of(replacement or root / block.file, "mesh_file")
        origin = block.origin_m
        if replacement is not None and origin is not None:
            origin = (0.0, 0.0, 0.0)  # as sole.vtk, in the sole's frame
        if path.suffix.lower() not in SUFFIXES:
            mesh = read_mesh(path, origin)
        else:
            surface = read_surface(path, block.unit)
            mesh = sole_from_surface(surface, block.tets, block.top_m, origin)
        check_frame(mesh, path)
        return mesh

    def start_pose(self, mesh: TetMesh, ground: Ground = FLAT) -> Start:
        """How the sole is held until contact.

        By default the held point is the middle of the lower back edge of the
        mesh's bounding box, at the place it has in a level sole at the world's
        origin.
        """
        point = self.start.point_in_sole_m
        least, largest = mesh.nodes.min(0), mesh.nodes.max(0)
        if point is None:
            point = (least[0], 0.5 * (least[1] + largest[1]), least[2])
        off = np.abs(point - np.clip(point, least, largest)).max()
        if off > (largest - least).max():
            raise InputError(
                f"start.point_in_sole_m: {off:g} m off the sole; give a point "
                "of it, in metres in its frame"
            )
        place = np.array(self.start.point_in_world_m or point[:2])
        height = ground.height(place[None])[0]
        return Start(
            np.array(point), np.array([*place, height]), self.start.yaw_rad
        )


@dataclass(frozen=True)
class Setup:
    """A sole, how it is held, and the step that it takes; see `Case`."""

    settings: Settings
    load: Load
    mesh: TetMesh
    start: Start
    ground: Ground = FLAT

    def __repr__(self) -> str:
        kind = type(self).__name__
        return f"{kind}({self.name!r}, {self.mesh!r}, {self.load!r})"

    @classmethod
    def open(
        cls,
        settings: Settings,
        data_root: Path | str = ".",
        mesh_file: Path | None = None,
        read_step: StepReader | None = None,
    ) -> "Setup":
        """Read the files that settings name, relative to a folder.

        See `Case.read` for the arguments.

        Raises:
            InputError: A file cannot be read, the ZMP leaves the sole, the
                force leaves the friction cone or would press the sole flat; a
                fixed patch holds none of the sole, or all of it.
        """
        root, ground = path_of(data_root, "data_root"), FLAT
        check_data_root(root)
        mesh = settings.read_mesh(root, mesh_file)
        settings = settings.walking_on(mesh.nodes[mesh.contact, :2])
        if settings.ground is not None:
            path = root / settings.ground.heights
            ground = Ground.of_table(read_columns(path, COLUMNS), str(path))
        start = settings.start_pose(mesh, ground)
        setup = cls(settings, None, mesh, start, ground)
        ground.check_below(setup.level, "ground.heights")
        found = []
        for k, block in enumerate(settings.all_loads):
            try:
                found.append(setup._read_load(block, root, read_step))
            except InputError as error:
                if not settings.loads:
                    raise
                raise InputError(f"loads[{k}]: {error}") from error
        load = found[0]
        if settings.loads:
            weights = [block.weight for block in settings.loads]
            load = Load.one_after_another(found, weights)
        setup = replace(setup, load=load)
        setup.spline().free_map()  # refuses what leaves nothing to change
        return setup if mesh_file is None else setup.on_own_mesh()

    def _read_load(self, block: LoadBlock, root: Path, read_step) -> Load:
        """One load of the case, with moments that friction bears."""
        load = block.load(root, read_step)
        if load.rotation is not None:
            turned = load.rotation @ rotation_z(self.start.yaw)
            load = replace(load, rotation=turned)
        setup = replace(self, load=load)
        setup.check_load()
        return setup.bearable_load

    def check_load(self) -> None:
        """Refuse a load that no pose of the sole can carry.

        Raises:
            InputError: It is no load, the ZMP leaves the sole, the force
                leaves the friction cone, or it would press the sole flat.
        """
        check_type(self.load, Load, "load")
        self.load.check_inside(self.level)
        self.load.check_friction(self.settings.contact.friction, self.up)
        area = float(np.ptp(self.mesh.nodes[:, :2], axis=0).prod())
        material = self.settings.material.material()
        # Stress over strain where no side can bulge.
        stiff = material.lame_lambda + 2 * material.shear_modulus
        self.load.check_pressed(stiff * area)

    @property
    def bearable_load(self) -> Load:
        """The load with free moments that friction bears, cut once."""
        if self.load.moment_cut is not None:
            return self.load
        width = float(np.ptp(self.mesh.nodes[:, :2], axis=0).min())
        friction = self.settings.contact.friction
        return self.load.bearable(friction, width, self.up)

    @property
    def gait(self) -> Gait | None:
        """The walk to be sought with the sole; None if none of it is free."""
        pattern = self.settings.load and self.settings.load.pattern
        if not (pattern and pattern.free):
            return None
        return Gait(pattern, self.settings.contact.friction, tuple(self.up))

    @property
    def name(self) -> str:
        """The case's name."""
        return self.settings.name

    @property
    def level(self) -> np.ndarray:
        """Places of the nodes that may touch, the sole level [m], (m, 2)."""
        places = self.mesh.nodes[self.mesh.contact]
        return self.start.places(np.eye(3), places)[:, :2]

    @property
    def up(self) -> np.ndarray:
        """Normal of the plane that fits the ground below the sole, (3,)."""
        return self.ground.normal(self.level)

    @property
    def friction_used(self) -> float:
        """Largest ratio of tangential to normal force, on the plane of `up`."""
        return float(self.load.friction_used(self.up).max())

    @property
    def ground_told(self) -> dict:
        """Entries of summary.json on a ground that is not flat."""
        if self.ground.is_flat:
            return {}
        return {"ground": self.ground.summary(self.level)}

    def sole(self, mesh: TetMesh | None = None) -> Sole:
        """Finite elements of the case's material, by default on its mesh."""
        block = self.settings
        return Sole(
            self.mesh if mesh is None else mesh,
            block.material.material(),
            block.mesh.element,
        )

    def spline(self) -> SphericalSpline:
        """The spline of shapes, with the coefficients that are free.

        Raises:
            InputError: A fixed patch holds none of the surface, or all of it.
        """
        block, meshes = self.settings.optimize, [self.mesh]
        if self.mesh.is_block:
            meshes += [stage_mesh(self.mesh, s) for s in block.stages]
        free = SphericalSpline(tuple(block.intervals), block.fixed_top)
        kept, shape = set(), block.shape
        points = np.concatenate([m.nodes[m.bare] for m in meshes])
        if block.fixed_top:
            # Below z = 0 more coefficients than the held rows move the top.
            top = np.concatenate([m.nodes[m.fixed] for m in meshes])
            low = top[top[:, 2] < -1e-9]
            kept.update(free.around(low) if len(low) else ())
        for k, corners in enumerate(shape.fixed_m):
            low, high = np.sort(corners, axis=0)
            inside = ((low <= points) & (points <= high)).all(axis=1)
            if not inside.any():
                raise InputError(
                    f"optimize.shape.fixed_m[{k}]: no node of the sole's "
                    "bare surface is in that box; give two corners in the "
                    "sole's frame (top at z = 0), in metres"
                )
            kept |= set(free.around(points[inside]))
        kept = tuple(sorted(kept))
        return replace(free, symmetric=shape.symmetric, kept=kept)

    def law(self, sole: Sole) -> ContactLaw:
        """The contact law with the sole's own scale r."""
        return ContactLaw(self.settings.contact.friction, sole.penalty)

    @property
    def key(self) -> str:
        """Checksum of what a search is of, but for iterations and names."""
        block = self.settings.optimize
        stages = tuple(replace(s, iterations=0) for s in block.stages)
        block = replace(block, stages=stages)
        mesh, load = self.mesh, replace(self.load, name="")
        own = checksum(self.settings.start_pose(mesh, self.ground))
        given = [] if checksum(self.start) == own else [self.start]
        return checksum(
            [
                replace(self.settings, name="", optimize=block),
                [mesh.nodes, mesh.tets, mesh.fixed],
                [load, self.ground],
                *given,
            ]
        )

    def without_limits(self) -> "Setup":
        """The paper's problem: without limits on stability, tilt and strain."""
        return self.optimizing(
            stability_n_per_m=None, tilt_deg=None, strain=None
        )

    def with_iterations(self, iterations: int | None) -> "Setup":
        """The same with this limit on the last stage's iterations.

        None leaves the case's.

        Raises:
            InputError: It is not a whole number from 0 on.
        """
        if iterations is None:
            return self
        return self._with_last_stage(iterations=iterations)

    def on_own_mesh(self) -> "Setup":
        """The same with the last stage on its own mesh.

        If that is no brick, all stages are.
        """
        if self.mesh.is_block:
            return self._with_last_stage(divisions=None)
        stages = self.settings.optimize.stages
        return self.optimizing(stages=without_divisions(stages))

    def _with_last_stage(self, **changes) -> "Setup":
        *stages, last = self.settings.optimize.stages
        return self.optimizing(stages=(*stages, replace(last, **changes)))

    def optimizing(self, **changes) -> "Setup":
        """The same with other values for keys of the block `optimize`.

        Raises:
            InputError: A case file could not have these values.
        """
        block = replace(self.settings.optimize, **changes)
        block = schema.check(block, OptimizeBlock, f"{self.name}: optimize")
        settings = replace(self.settings, optimize=block)
        return replace(self, settings=settings)
