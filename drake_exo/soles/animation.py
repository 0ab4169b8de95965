"""The deforming sole as one HTML file: meshcat's viewer, nothing fetched."""

import base64
import warnings
from importlib.resources import files
from pathlib import Path

import numpy as np
import umsgpack
from matplotlib import colormaps

with warnings.catch_warnings():  # its server uses a deprecated part of zmq
    warnings.simplefilter("ignore", DeprecationWarning)
    from meshcat import commands, geometry
    from meshcat.animation import Animation
    from meshcat.path import Path as ScenePath

_MAX_FRAMES = 110
_MAX_BYTES = 14_000_000

_PAGE = """<!DOCTYPE html>
<html>
<head><meta charset="utf-8"><title>{title}</title>
<style>body {{margin: 0;}}
#meshcat-pane {{width: 100vw; height: 100vh; overflow: hidden;}}
#caption {{position: absolute; left: 12px; top: 10px; font: 14px sans-serif;
color: #222; background: rgba(255,255,255,0.8); padding: 6px 10px;}}
#bar {{width: 220px; height: 12px; background:
linear-gradient(to right, {stops});}}</style></head>
<body><div id="meshcat-pane"></div>
<div id="caption">{title}<div id="bar"></div>
contact pressure 0 to {top:.0f} kPa; {note}</div>
<script>{viewer}</script>
<script>
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
function show(text) {{
  viewer.handle_command_bytearray(
    Uint8Array.from(atob(text), c => c.charCodeAt(0)));
}}
{commands}
viewer.controls.target.set({target});
viewer.controls.update();
</script>
<script id="embedded-json"></script></body></html>
"""


def write_animation(
    path: Path,
    faces: np.ndarray,
    places: np.ndarray,
    pressure: np.ndarray,
    times: np.ndarray,
    title: str,
    slow: float = 5.0,
) -> int:
    """Write the animation; returns the number of frames in it.

    Args:
        path: HTML file.
        faces: Surface triangles, indices into places, (f, 3).
        places: Surface nodes over time, world [m], (N, n, 3).
        pressure: Contact pressure at them [kPa], (N, n).
        times: [s], (N,).
        title: Caption.
        slow: Times slower than life.
    """
    frame_bytes = places.shape[1] * 24 + len(faces) * 12
    limit = min(_MAX_FRAMES, int(_MAX_BYTES * 0.75 / frame_bytes))
    count = max(2, min(len(times), limit))
    picked = np.unique(np.linspace(0, len(times) - 1, count).astype(int))
    top = max(float(pressure.max()), 1e-9)
    span = max(times[-1] - times[0], 1e-3)
    fps = len(picked) / (span * slow)
    scene = list(_stage(places))
    animation = Animation(default_framerate=1.0)
    for k, q in enumerate(picked):
        colours = colormaps["turbo"](pressure[q] / top)[:, :3]
        colours[pressure[q] <= 0] = 0.62
        name = ScenePath(("meshcat", "sole", f"frame{k:03d}"))
        scene.append(_mesh(name, places[q], faces, colours, k))
        _show_between(animation, name, k, len(picked))
    for clip in animation.clips.values():
        clip.fps = fps
    scene.append(commands.SetAnimation(animation, repetitions=1000))
    viewer = files("meshcat").joinpath("viewer", "dist", "main.min.js")
    text = _PAGE.format(
        title=title,
        note=f"{span:.2f} s of contact, {slow:g} times slower",
        top=top,
        stops=", ".join(
            "rgb({:.0f},{:.0f},{:.0f})".format(
                *(255 * np.array(colormaps["turbo"](x)[:3]))
            )
            for x in np.linspace(0, 1, 9)
        ),
        viewer=viewer.read_text(encoding="utf-8"),
        target=", ".join(f"{v:.4f}" for v in _turned(_middle(places))),
        commands="\n".join(
            f'show("{base64.b64encode(umsgpack.packb(c.lower())).decode()}");'
            for c in scene
        ),
    )
    Path(path).write_text(text, encoding="utf-8")
    return len(picked)


def _mesh(name, vertices, faces, colours, number):
    # Random identifiers would make equal runs differ.
    shape = geometry.TriangularMeshGeometry(vertices, faces, colours)
    look = geometry.MeshLambertMaterial(vertexColors=True, side=2)
    thing = geometry.Mesh(shape, look)
    shape.uuid, look.uuid = f"geometry-{number}", f"material-{number}"
    thing.uuid = f"object-{number}"
    return commands.SetObject(thing, path=name)


def _show_between(animation, name, k, count):
    """Frame k is visible from its own instant to the next one."""
    with animation.at_frame(_Named(name), 0) as frame:
        frame.set_property("visible", "bool", k == 0)
    if k > 0:
        with animation.at_frame(_Named(name), k) as frame:
            frame.set_property("visible", "bool", True)
    with animation.at_frame(_Named(name), k + 1) as frame:
        frame.set_property("visible", "bool", False)
    if k + 1 < count:  # clips of unequal length would not loop together
        with animation.at_frame(_Named(name), count) as frame:
            frame.set_property("visible", "bool", False)


class _Named:
    """What meshcat's animation asks of a visualizer: its path."""

    def __init__(self, path):
        self.path = path


def _stage(places):
    """Ground, camera, background."""
    low, high = places.min(axis=(0, 1)), places.max(axis=(0, 1))
    middle = _middle(places)
    margin = 0.04
    corners = np.array(
        [
            [low[0] - margin, low[1] - margin, -5e-4],
            [high[0] + margin, low[1] - margin, -5e-4],
            [high[0] + margin, high[1] + margin, -5e-4],
            [low[0] - margin, high[1] + margin, -5e-4],
        ]
    )
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    ground = ScenePath(("meshcat", "ground"))
    yield _mesh(ground, corners, faces, np.full((4, 3), 0.85), 10**6)
    size = float(np.linalg.norm(high - low))
    eye = middle + size * np.array([-1.0, -1.3, 0.35])
    camera = ("Cameras", "default", "rotated", "<object>")
    yield commands.SetProperty("position", _turned(eye), ScenePath(camera))
    for name in ("Grid", "Axes"):
        yield commands.SetProperty("visible", False, ScenePath((name,)))


def _middle(places) -> np.ndarray:
    return 0.5 * (places.min(axis=(0, 1)) + places.max(axis=(0, 1)))


def _turned(point) -> list[float]:
    """World point in the viewer's camera frame (y up)."""
    return [float(point[0]), float(point[2]), -float(point[1])]
