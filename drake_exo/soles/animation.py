"""Animation of deforming soles as one HTML file: pressure, force, ZMP.

It shows simulations in memory, or those in folders that the commands wrote.
"""

from __future__ import annotations

import base64
import html
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import umsgpack
from matplotlib import colormaps
from scipy.spatial.transform import Rotation

from drake_exo.errors import InputError
from drake_exo.files.output import read_json, stored_mark
from drake_exo.player import Arrow, Clip, Page, Surface, write_page
from drake_exo.soles.contact.law import FLAT, Ground
from drake_exo.soles.mesh import TetMesh
from drake_exo.soles.simulation import FIRST_HISTORY, HISTORY, read_history

with warnings.catch_warnings():  # its server uses a deprecated part of zmq
    warnings.simplefilter("ignore", DeprecationWarning)
    from meshcat import commands, geometry
    from meshcat.path import Path as ScenePath

_MAX_FRAMES = 110
_MAP = "viridis"
_METRES_PER_NEWTON = 2e-4
_GRID_M, _FINE_M = 0.05, 0.01  # spacing of lines; of facets of uneven ground
_AGAIN = "run the command that wrote it again"
_PAGE = """<!DOCTYPE html>
<html>
<head><meta charset="utf-8"><title>{title}</title>
<style>body {{margin: 0;}}
#meshcat-pane {{width: 100vw; height: 100vh; overflow: hidden;}}</style></head>
<body><div id="meshcat-pane"></div>
<script>{viewer}</script>
<script>
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
function show(text) {{
  viewer.handle_command_bytearray(
    Uint8Array.from(atob(text), c => c.charCodeAt(0)));
}}
{commands}
</script></body></html>
"""


@dataclass(frozen=True)
class SoleMotion:
    """A sole's motion over N samples, to be drawn.

    Times [s] (N,), origin [m] (N, 3) and rotation (N, 3, 3) of its frame in the
    world, places [m] and forces [N] of its contact nodes there, (N, m, 3);
    `mark` is `Verdict.mark`; motions of one `group` are listed together.
    """

    title: str
    group: str
    times: np.ndarray
    mesh: TetMesh
    origin: np.ndarray
    rotation: np.ndarray
    places: np.ndarray
    force: np.ndarray
    mark: str = ""
    ground: Ground = FLAT

    @staticmethod
    def of(
        title: str,
        mesh: TetMesh,
        times: np.ndarray,
        history,
        ground: Ground = FLAT,
        mark: str = "",
        group: str = "",
    ) -> SoleMotion | None:
        """The motion in a `StepHistory`; None if under two samples converged.

        At most `_MAX_FRAMES` samples are kept, the first and last among them.
        """
        good = np.flatnonzero(history.converged)
        if len(good) < 2:
            return None
        count = min(len(good), _MAX_FRAMES)
        shown = good[np.linspace(0, len(good) - 1, count).astype(int)]
        parts = (times, history.O, history.R, history.P, history.F)
        times, *rest = (part[shown] for part in parts)
        return SoleMotion(title, group, times, mesh, *rest, mark, ground)

    @staticmethod
    def read(
        path: Path, title: str, group: str = "", mark: str = ""
    ) -> SoleMotion | None:
        """The motion in a file of `simulation.write_history`, as `of`."""
        return SoleMotion.of(title, *read_history(path, _AGAIN), mark, group)

    @property
    def surface(self) -> np.ndarray:
        """Sorted nodes of the surface (n,)."""
        return np.unique(self.mesh.boundary_faces)

    @property
    def faces(self) -> np.ndarray:
        """Triangles of the surface, indices into `surface`, (f, 3)."""
        return np.searchsorted(self.surface, self.mesh.boundary_faces)

    def surface_places(self) -> np.ndarray:
        """World places of the surface's nodes [m], (N, n, 3)."""
        rest = self.mesh.nodes[self.surface]
        turned = np.einsum("qij,nj->qni", self.rotation, rest)
        places = self.origin[:, None, :] + turned
        # Other nodes are drawn as moving with the foot.
        places[:, self._touching] = self.places
        return places

    def pressure(self) -> np.ndarray:
        """Contact pressure at the surface's nodes [kPa], (N, n)."""
        found = np.zeros((len(self.times), len(self.surface)))
        pressed = self.force[:, :, 2] / self.mesh.contact_areas
        found[:, self._touching] = 1e-3 * pressed
        return found

    @property
    def _touching(self) -> np.ndarray:
        return np.searchsorted(self.surface, self.mesh.contact)


def write_animation(
    path: Path, motions: Sequence[SoleMotion], title: str
) -> None:
    """Write a page that plays motions of soles, the first one to begin with.

    It is an HTML file of 1 MB and at most 1.5 MB for each motion.
    """
    pressures = [motion.pressure() for motion in motions]
    # Not the maximum: pressure peaks at heel strike would leave the rest dark.
    top = max(float(np.quantile(p[p > 0], 0.99)) for p in pressures)
    box = _Box.of(motions)
    scene = list(_stage(box, motions[0].ground))
    clips = []
    for k, (motion, p) in enumerate(zip(motions, pressures, strict=True)):
        scene.append(_undeformed(k, motion))
        clips.append(_clip(k, motion, p / top, box))
    viewer = files("meshcat").joinpath("viewer", "dist", "main.min.js")
    stage = _PAGE.format(
        title=html.escape(title),
        viewer=viewer.read_text(encoding="utf-8"),
        commands="\n".join(
            f'show("{base64.b64encode(umsgpack.packb(c.lower())).decode()}");'
            for c in scene
        ),
    )
    write_page(path, stage, _page(title, top, box), clips)


@dataclass(frozen=True)
class _Box:
    """Bounding box of all motions in the world [m], corners (3,)."""

    low: np.ndarray
    high: np.ndarray

    @staticmethod
    def of(motions: Sequence[SoleMotion]) -> _Box:
        places = [motion.surface_places() for motion in motions]
        return _Box(
            np.min([p.min(axis=(0, 1)) for p in places], axis=0),
            np.max([p.max(axis=(0, 1)) for p in places], axis=0),
        )

    @property
    def mirror(self) -> np.ndarray:
        """Matrix that shows the underside in front of the sole, (4, 4)."""
        matrix = np.diag([1.0, 1.0, -1.0, 1.0])
        # Farther in front if a foot that rolls far lifts the sole.
        apart = max(0.08, self.high[2])
        matrix[1, 3] = -(self.high[1] - self.low[1]) - apart
        matrix[2, 3] = self.high[2]
        return matrix


def _page(title: str, top: float, box: _Box) -> Page:
    middle = 0.5 * (box.low + box.high)
    # Between the sole and its mirrored underside in front.
    target = middle + np.array([0.0, 0.42 * box.mirror[1, 3], 0.03])
    colours = colormaps[_MAP](np.linspace(0.0, 1.0, 256))[:, :3]
    stops = ", ".join(
        "rgb({:.0f},{:.0f},{:.0f})".format(*(255 * c)) for c in colours[::15]
    )
    legend = (
        '<div class="player-scale" style="background:linear-gradient('
        f'to right, {stops})"></div><div class="player-ends"><span>0</span>'
        f"<span>contact pressure</span><span>{top:.0f} kPa and more</span>"
        '</div><p class="player-quiet">An arrow of 0.1 m is 500 N; grid: '
        "0.05 m. In front: the underside, as in a mirror.</p>"
    )
    force = Arrow(
        "ground", "ground reaction at the ZMP", "#c8102e", _METRES_PER_NEWTON,
        label="ground", radius_m=0.0025,
    )  # fmt: skip
    return Page(
        title,
        tuple(target + np.array([-0.30, -0.95, 0.62])),
        tuple(target),
        arrows=(force,),
        switches={
            "force": ("/arrows",),
            "ZMP": ("/zmp/ball",),
            "undeformed": ("/undeformed",),
            "underside": ("/underside",),
        },
        legend=(legend,),
        colours=colours,
        field_of_view_deg=32.0,
        speed=0.2,
    )


def _clip(number: int, motion: SoleMotion, values, box: _Box) -> Clip:
    zmp = motion.ground.zero_moment_point(motion.force, motion.places)
    turn = np.roll(Rotation.from_matrix(motion.rotation).as_quat(), 1, axis=1)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(zmp), 1))
    times = motion.times - motion.times[0]
    bodies = {
        "/zmp": np.column_stack([zmp, upright]),
        f"/undeformed/{number}": np.column_stack([motion.origin, turn]),
    }
    mirrored = {f"/underside/{number}": box.mirror}
    sole = Surface(motion.faces, motion.surface_places(), values, mirrored)
    return Clip(
        motion.title,
        motion.group or "Step",
        times,
        bodies,
        {"ground": np.column_stack([zmp, motion.force.sum(axis=1)])},
        {f"/sole/{number}": sole},
        note=f"{times[-1]:.2f} s of contact",
        mark=motion.mark,
    )


def _undeformed(number: int, motion: SoleMotion):
    """Command that adds the undeformed shape, translucent, in its frame."""
    nodes = motion.mesh.nodes[motion.surface]
    look = geometry.MeshLambertMaterial(
        color=0x3A6EA5,
        opacity=0.2,
        transparent=True,
        side=2,
        depthWrite=False,
        # Drawn behind faces it coincides with, without flicker.
        polygonOffset=True,
        polygonOffsetFactor=4,
        polygonOffsetUnits=40,
    )
    shape = geometry.TriangularMeshGeometry(nodes, motion.faces)
    return _mesh(f"undeformed/{number}", shape, look)


def _mesh(path: str, shape, look, kind=geometry.Mesh):
    """Command that adds an object, the same in equal runs."""
    thing = kind(shape, look)
    # meshcat's random identifiers would make equal runs differ.
    shape.uuid, look.uuid = f"{path}-shape", f"{path}-look"
    thing.uuid = f"{path}-thing"
    return commands.SetObject(thing, path=ScenePath(tuple(path.split("/"))))


def _stage(box: _Box, ground: Ground) -> Iterator:
    """Commands that add the ground with its grid, the ZMP, the background."""
    low = np.floor((box.low[:2] - np.array([0.05, 0.08])) / _GRID_M) * _GRID_M
    high = np.ceil((box.high[:2] + np.array([0.05, 0.05])) / _GRID_M) * _GRID_M
    low[1] += np.floor(box.mirror[1, 3] / _GRID_M) * _GRID_M
    coarse = [
        np.arange(a, b + 1e-9, _GRID_M) for a, b in zip(low, high, strict=True)
    ]
    every, fine = round(_GRID_M / _FINE_M), coarse
    if not ground.is_flat:
        fine = [
            np.linspace(v[0], v[-1], every * (len(v) - 1) + 1) for v in coarse
        ]

    def lying(x, y, under: float) -> np.ndarray:
        x, y = (v.ravel() for v in np.broadcast_arrays(x, y))
        height = ground.height(np.column_stack([x, y])) - under
        return np.column_stack([x, y, height])

    x, y = np.meshgrid(*fine, indexing="ij")
    corner = np.arange(x.size).reshape(x.shape)
    a, b = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
    c, d = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    yield _mesh(
        "ground/slab",
        geometry.TriangularMeshGeometry(lying(x, y, 8e-4), faces),
        geometry.MeshLambertMaterial(color=0xDCDDE0, side=2),
    )
    along = [np.repeat(v, 2)[1:-1] for v in fine]
    lines = [lying(x, along[1], 6e-4) for x in coarse[0]]
    lines += [lying(along[0], y, 6e-4) for y in coarse[1]]
    yield _mesh(
        "ground/grid",
        geometry.PointsGeometry(np.concatenate(lines).T.astype(np.float32)),
        geometry.LineBasicMaterial(color=0xB4B7BD),
        geometry.LineSegments,
    )
    look = {"color": 0xC8102E, "depthTest": False, "transparent": True}
    yield _mesh(
        "zmp/ball", geometry.Sphere(0.005), geometry.MeshBasicMaterial(**look)
    )
    for name in ("Grid", "Axes"):
        yield commands.SetProperty("visible", False, ScenePath((name,)))
    background = ScenePath(("Background",))
    yield commands.SetProperty("top_color", [1.0, 1.0, 1.0], background)
    yield commands.SetProperty("bottom_color", [0.93, 0.94, 0.96], background)


def replay_soles(folder: Path, path: Path) -> None:
    """Write a page that plays all soles found under a folder.

    Args:
        folder: Folder that `sole simulate`, `optimize` or `study` wrote.
        path: Path of the page.

    Raises:
        InputError: No sole has two samples that converged, or a file is
            damaged.
    """
    motions = []
    for file in sorted(Path(folder).rglob(HISTORY)):
        name, mark = _told(file.parent)
        first = file.with_name(FIRST_HISTORY)
        if first.is_file():
            motions += [
                SoleMotion.read(file, f"{name}: optimised", name, mark),
                SoleMotion.read(first, f"{name}: initial shape", name),
            ]
        else:
            motions.append(SoleMotion.read(file, name, name, mark))
    shown = [motion for motion in motions if motion is not None]
    if not shown:
        raise InputError(
            f"{folder}: holds no {HISTORY} of a sole of which two samples "
            "converged; give the --out folder of 'drake-exo sole simulate', "
            "'optimize' or 'study'"
        )
    groups = sorted({motion.group for motion in shown})
    write_animation(path, shown, f"Sole {', '.join(groups)}")


def _told(folder: Path) -> tuple[str, str]:
    """Name of the case in a folder, and its verdict's mark."""
    path = folder / "summary.json"
    summary = read_json(path, _AGAIN)
    if not isinstance(summary, dict):
        return folder.name, ""
    mark, name = stored_mark(summary, path), summary.get("name")
    return name if isinstance(name, str) else folder.name, mark
