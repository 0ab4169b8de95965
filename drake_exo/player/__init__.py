"""Write a page that plays clips, as one HTML file that needs no network.

The page is meshcat's (Drake's or the Python package's, both know the same
commands) with the bodies in it; a script moves them. A clip holds only numbers,
so a page holds each mesh once, however many clips it plays.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np

from drake_exo.files.output import replace_file


@dataclass(frozen=True)
class Surface:
    """A surface that deforms, coloured by a value at its nodes.

    Attributes:
        faces: (f, 3) triangles, indices of nodes.
        places: (n, m, 3) world [m].
        values: (n, m) from 0 to 1; grey where 0.
        copies: path -> (4, 4) transform of a copy that is shown.
    """

    faces: np.ndarray
    places: np.ndarray
    values: np.ndarray
    copies: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Arrow:
    """How a force is drawn.

    Attributes:
        name: unique; an identifier.
        text: of the legend; none if empty.
        colour: as in HTML, "#rrggbb".
        metres_per_newton: its length.
        root: path of the scene under which it hangs.
        label: written at its tip, with its size; none if empty.
        opacity: 0 to 1.
        radius_m: of the shaft.
    """

    name: str
    text: str
    colour: str
    metres_per_newton: float
    root: str = "/arrows"
    label: str = ""
    opacity: float = 1.0
    radius_m: float = 0.009


@dataclass(frozen=True)
class Clip:
    """One motion that a page can play.

    Attributes:
        title: its name in the list.
        group: clips of one group are listed together.
        times: (n,) increasing from 0 [s].
        bodies: path -> (n, 7) position [m] and quaternion (w, x, y, z);
            hidden where NaN, or if the clip lacks the path.
        arrows: name -> (n, 6) point [m] and force [N]; hidden where NaN.
        surfaces: path -> surface that deforms.
        note: a line of text shown with it.
        mark: text in red: that it does not hold, and why.
    """

    title: str
    group: str
    times: np.ndarray
    bodies: Mapping[str, np.ndarray]
    arrows: Mapping[str, np.ndarray] = field(default_factory=dict)
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    note: str = ""
    mark: str = ""

    def __post_init__(self):
        n = len(self.times)
        if n < 2 or not (np.diff(self.times) > 0.0).all():
            raise ValueError(
                f"clip '{self.title}' needs at least two increasing times"
            )
        widths = dict.fromkeys(self.bodies, 7) | dict.fromkeys(self.arrows, 6)
        for name, rows in {**self.bodies, **self.arrows}.items():
            if np.shape(rows) != (n, widths[name]):
                raise ValueError(
                    f"'{name}' of clip '{self.title}' needs shape "
                    f"({n}, {widths[name]}), not {np.shape(rows)}"
                )
            if np.isinf(rows).any():
                raise ValueError(
                    f"'{name}' of clip '{self.title}' holds infinite values"
                )


@dataclass(frozen=True)
class Page:
    """Title, camera, legend and controls around the clips.

    Attributes:
        title: of the page.
        eye, target: where the camera stands and looks, world [m].
        arrows: of all clips.
        switches: text -> paths that a box shows or hides.
        ghost: (root path, shift when shown beside [m]) of what is drawn for
            comparison; None if there is none.
        ghost_text: what that is.
        legend: lines of HTML under the title.
        colours: (256, 3) colour map of surfaces, 0 to 1.
        field_of_view_deg: of the camera, vertical.
        speed: of the replay at first, 1 is real time.
    """

    title: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    arrows: Sequence[Arrow] = ()
    switches: Mapping[str, Sequence[str]] = field(default_factory=dict)
    ghost: tuple[str, tuple[float, float, float]] | None = None
    ghost_text: str = "measured"
    legend: Sequence[str] = ()
    colours: np.ndarray | None = None
    field_of_view_deg: float = 30.0
    speed: float = 1.0


def write_page(
    path: Path, meshcat_page: str, page: Page, clips: Sequence[Clip]
) -> None:
    """Write meshcat's page with the player in it.

    Args:
        path: of the HTML file.
        meshcat_page: HTML with the global `viewer` and the bodies in it.
        page, clips: what to play, the first one at first.

    Raises:
        ValueError: there is no clip.
    """
    if not clips:
        raise ValueError("a page needs at least one clip")
    head, body_end, tail = meshcat_page.rpartition("</body>")
    speeds = "".join(
        f'<option value="{s:g}"{" selected" if s == page.speed else ""}>'
        f"{s:g} × real time</option>"
        for s in _SPEEDS
    )
    inserted = (
        f"<style>{_asset('player.css')}</style>\n{_card(page, clips)}"
        f"{_BAR.format(speeds=speeds)}"
        f"<script>const PLAYER = {_data(page, clips)};</script>\n"
        f"<script>{_asset('player.js')}</script>\n"
    )
    head = head.replace(
        "<title>Drake MeshCat</title>", f"<title>{escape(page.title)}</title>"
    )
    text = head + inserted + body_end + tail
    replace_file(Path(path), text.encode())


_BAR = """<div class="player" id="player-bar">
<button id="player-play" title="space">pause</button>
<input type="range" id="player-slider" min="0" value="0"
 title="time; arrow keys step" aria-label="time">
<span id="player-time"></span>
<select id="player-speed" aria-label="speed">{speeds}</select></div>
"""
_SPEEDS = (0.1, 0.2, 0.5, 1.0)


def _asset(name: str) -> str:
    return files("drake_exo.player").joinpath(name).read_text("utf-8")


def _card(page: Page, clips: Sequence[Clip]) -> str:
    """Title, choice of clip, legend and switches."""
    groups: dict[str, list[str]] = {}
    for number, clip in enumerate(clips):
        option = f'<option value="{number}">{escape(clip.title)}</option>'
        groups.setdefault(clip.group, []).append(option)
    chooser = "".join(
        f'<optgroup label="{escape(group)}">{"".join(options)}</optgroup>'
        for group, options in groups.items()
    )
    parts = [
        f"<h1>{escape(page.title)}</h1>",
        f'<select id="player-clip" aria-label="trial">{chooser}</select>',
        '<p class="player-mark" id="player-mark"></p>',
        '<p class="player-quiet" id="player-note"></p>',
    ]
    if page.ghost is not None:
        parts.append(
            f"<p>{escape(page.ghost_text)}: "
            '<select id="player-ghost"><option value="over">overlaid'
            '</option><option value="beside">side by side</option>'
            '<option value="hidden">hidden</option></select></p>'
        )
    boxes = "".join(
        f'<label><input type="checkbox" id="player-switch-{i}" checked> '
        f"{escape(name)}</label>"
        for i, name in enumerate(page.switches)
    )
    parts += [f"<p>{boxes}</p>", _arrow_table(page), *page.legend]
    return f'<div class="player" id="player-card">{"".join(parts)}</div>\n'


def _arrow_table(page: Page) -> str:
    rows = [
        f'<tr><td><span class="player-swatch" style="background:{a.colour};'
        f'opacity:{a.opacity}"></span></td><td>{escape(a.text)}</td>'
        f'<td class="number" id="player-value-{a.name}"></td></tr>'
        for a in page.arrows
        if a.text
    ]
    return f"<table>{''.join(rows)}</table>" if rows else ""


def _data(page: Page, clips: Sequence[Clip]) -> str:
    """All that the script reads, as JSON."""
    bodies = sorted({path for clip in clips for path in clip.bodies})
    data = {
        "bodies": bodies,
        "arrows": [vars(arrow) for arrow in page.arrows],
        "switches": [{"paths": list(p)} for p in page.switches.values()],
        "camera": {
            "eye": page.eye,
            "target": page.target,
            "fov": page.field_of_view_deg,
        },
        "ghost": page.ghost
        and {"root": page.ghost[0], "beside": page.ghost[1]},
        "colours": None
        if page.colours is None
        else _packed(page.colours, "f4"),
        "clips": [_clip(clip) for clip in clips],
    }
    # "</" would end the script that holds the data.
    return json.dumps(data, ensure_ascii=False).replace("</", "<\\/")


def _clip(clip: Clip) -> dict:
    return {
        "note": clip.note,
        "mark": clip.mark,
        "times": _packed(clip.times, "f4"),
        "bodies": {k: _packed(v, "f4") for k, v in clip.bodies.items()},
        "arrows": {k: _packed(v, "f4") for k, v in clip.arrows.items()},
        "surfaces": {k: _surface(v) for k, v in clip.surfaces.items()},
    }


def _surface(surface: Surface) -> dict:
    """A surface, its places rounded to 1/65535 of their bounding box."""
    low = surface.places.min(axis=(0, 1))
    span = np.maximum(np.ptp(surface.places, axis=(0, 1)), 1e-9)
    steps = np.round((surface.places - low) / span * 65535)
    values = np.round(np.clip(surface.values, 0.0, 1.0) * 65535)
    return {
        "rest": _packed(surface.places[0], "f4"),
        "faces": _packed(surface.faces, "u4"),
        # The viewer's matrices are column-major.
        "copies": {k: m.T.ravel().tolist() for k, m in surface.copies.items()},
        "low": low.tolist(),
        "span": span.tolist(),
        "places": _packed(steps, "u2"),
        "values": _packed(values, "u2"),
    }


def _packed(array: np.ndarray, kind: str) -> dict[str, str]:
    """Numbers as base64 of little-endian binary."""
    data = np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()
    return {"type": kind, "data": base64.b64encode(data).decode("ascii")}
