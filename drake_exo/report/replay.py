"""A page that replays results of calibration, prediction and design.

The model moves as computed, beside or over a translucent one that moves as
measured or, for a design, as in today's device. Forces of ground, chair and
cuffs are arrows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform

from drake_exo.calibration.results import (
    read_calibration,
    read_model,
    read_trial,
)
from drake_exo.contact.bushing import ROTATION, bushing_wrench
from drake_exo.contact.parameters import ContactModel, ContactSphere
from drake_exo.contact.strap import EXTRAPOLATED, TODAY, read_design
from drake_exo.errors import InputError
from drake_exo.files.output import checksum, read_json, stored_mark
from drake_exo.measurement.sagittal import PlanarWrench
from drake_exo.measurement.trial import CuffForce, Trial
from drake_exo.model.plant import Model
from drake_exo.player import Arrow, Clip, Page, write_page
from drake_exo.report.gathering import Results, gather
from drake_exo.report.scene import (
    Scene,
    View,
    add_floor,
    add_stool,
    quiet_drake,
    set_stage,
)

# The seat under the hip joint: half a thigh and the cushion [m].
_HIP_OVER_SEAT_M = 0.13


class DrawnModel:
    """Places of one model's bodies and forces over time, to be drawn.

    Args:
        model: subject and device.
        contact: tells where cuffs act; None if they were not calibrated.
    """

    def __init__(self, model: Model, contact: ContactModel | None = None):
        self.model = model
        self.tree = model.tree
        self.soles = model.soles
        if contact is not None:
            under = contact.ground.under(model)
            self.soles = {body: own.spheres for body, own in under.items()}
        plant = model.plant()
        bodies = [plant.GetBodyByName(name) for name in model.tree.names]
        # Body -> path in meshcat's tree.
        self._paths = {
            body.name(): f"{plant.GetModelInstanceName(body.model_instance())}"
            f"/{body.name()}"
            for body in bodies
        }
        self._hip = ("pelvis", 0.0)
        if model.tree.root != "pelvis":
            self._hip = ("thigh", model.human.thigh.length_m)
        self._bushings = contact.bushings if contact else {}

    def poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Path of a body -> (n, 7) position [m] and quaternion."""
        return {
            path: spatial(self.tree.poses(q, name))
            for name, path in self._paths.items()
        }

    def hip(self, q: np.ndarray) -> np.ndarray:
        """Place (x, z) of the hip joint [m], (n, 2)."""
        body, z = self._hip
        return self.tree.point_positions(q, body, (0.0, z))

    def seat_height(self, motion: Trial) -> float:
        """Height of a seat that the subject would sit on at the start [m]."""
        return float(self.hip(motion.q[:1])[0, 1]) - _HIP_OVER_SEAT_M

    def centres_of_pressure(self, motion: Trial) -> dict[str, np.ndarray]:
        """Path -> centre of pressure (n, 3) [m]; NaN where hardly loaded."""
        found = {}
        for side, wrench in motion.soles.items():
            x = wrench.cop_x
            place = np.column_stack([x, _ACROSS_M[side] + 0.0 * x, 0.0 * x])
            found[f"/cop/{side}"] = place
        return found

    def arrows(self, motion: Trial) -> dict[str, np.ndarray]:
        """Name -> (n, 6) point [m] and force [N], world; NaN where unloaded."""
        found = {}
        for side, wrench in motion.soles.items():
            rows = _on_level(wrench, 0.0)
            rows[:, 1] = _ACROSS_M[side]
            found[_GROUND[side]] = rows
        if motion.chair_shares:
            seat = self.seat_height(motion)
            found["chair"] = _on_level(motion.chair, seat)
        for name, force in motion.cuffs.items():
            if name in self._bushings:
                found[name] = self._cuff(motion, name, force)
        return found

    def _cuff(self, motion: Trial, name: str, force: CuffForce) -> np.ndarray:
        human, device = self.tree.cuffs[name]
        # Mats measure the normal component only.
        wrench = bushing_wrench(
            (*np.nan_to_num(force.components.T[:ROTATION]), 0.0),
            self.tree.poses(motion.q, human).T,
            self.tree.poses(motion.q, device).T,
            self._bushings[name].origin,
            self._bushings[name].preload,
        )
        zero = 0.0 * wrench.force_x
        across = zero + _ACROSS_M.get(human.rpartition("_")[2], 0.0)
        return np.column_stack(
            [
                *(wrench.point_x, across, wrench.point_z),
                *(wrench.force_x, zero, wrench.force_z),
            ]
        )


def spatial(pose: np.ndarray) -> np.ndarray:
    """Planar poses x, z, angle (n, 3) as position and quaternion (n, 7)."""
    x, z, angle = pose.T
    zero = 0.0 * x
    # The angle is about -y.
    turn = np.cos(0.5 * angle), zero, -np.sin(0.5 * angle), zero
    return np.column_stack([x, zero, z, *turn])


def _on_level(wrench: PlanarWrench, height: float) -> np.ndarray:
    """Point and force (n, 6) where a wrench's line of action is at a height."""
    x, zero = wrench.cop_at(height), 0.0 * wrench.force_z
    return np.column_stack(
        [x, zero, zero + height, wrench.force_x, zero, wrench.force_z]
    )


SIMULATED, MEASURED = "/simulated", "/measured"
_SECONDS_PER_FRAME = 0.02
_BESIDE_M = (1.35, 0.0, 0.0)
_CHAIR = "/chair"
_SPHERES = "/spheres"
_AWAY_M = -10.0
_GHOST = Rgba(0.30, 0.55, 0.95, 0.35)
_ACROSS_M = {"left": 0.1, "right": -0.1, "both": 0.0}
_FEET_Y_M = (_ACROSS_M["left"], _ACROSS_M["right"])
_GROUND = {"left": "ground_left", "right": "ground_right", "both": "ground"}
_GROUND_SCALE, _CUFF_SCALE = 1e-3, 4e-3  # m/N
_LOADS = {
    "ground": ("ground reaction", "#c8102e", _GROUND_SCALE, "feet"),
    "ground_left": ("ground, left foot", "#c8102e", _GROUND_SCALE, "left"),
    "ground_right": ("ground, right foot", "#e07020", _GROUND_SCALE, "right"),
    "chair": ("chair", "#8a5a1f", _GROUND_SCALE, "chair"),
}
_CUFF_COLOURS = ("#1f5fb4", "#7a3fb0", "#0f7f6b", "#b0603f", "#5f7f0f")
_WRENCHES = (*_GROUND.values(), "chair")
_ORDER = ("prediction", "interaction", "foot-ground")
_PHASES = {"interaction": "B", "foot-ground": "A"}
_GROUPS = {
    "prediction": "Predicted",
    "interaction": "Calibrated, human and exoskeleton",
    "foot-ground": "Calibrated, foot and ground",
}
_SCALES = {
    _GROUND_SCALE: "Feet and chair: an arrow of 0.5 m is 500 N.",
    _CUFF_SCALE: "Cuffs (force on the human): 0.2 m is 50 N.",
}
_AROUND, _SUMMED = "Grid: 0.25 m.", "Both legs are summed."


def replay_results(
    folder: Path, path: Path, accept: Sequence[str] = ()
) -> None:
    """Write the page of all results under a folder.

    Args:
        folder: that `calibrate`, `predict`, `design` or `demo` wrote.
        path: of the page.
        accept: see `gather`.

    Raises:
        InputError: no results, of several models, or none that succeeded.
    """
    summary = folder / "summary.json"
    if summary.exists():
        told = read_json(summary, "run the command that wrote it again")
        if isinstance(told, dict) and told.get("phase") == "design":
            _replay_design(folder, told, path)
            return
    found = sorted(gather(folder, accept), key=lambda r: _ORDER.index(r.phase))
    model = read_model(found[0].folder)
    trials = []
    for results in found:
        if checksum(read_model(results.folder)) != checksum(model):
            raise InputError(
                f"{folder}: holds results of several models; view one of "
                f"its folders, such as {results.folder}"
            )
        trials += _replayed(results, model)
    write_replay(path, model, trials, _title(found))


def _replay_design(folder: Path, summary: dict, path: Path) -> None:
    """Write the page of a design's first wearer, beside today's device."""
    if not summary.get("success"):
        raise InputError(
            f"{folder}: holds no solved design to replay; see its summary.json"
        )
    told = folder / "summary.json"
    mark = stored_mark(summary, told)
    for key in ("subjects", "trials"):
        names = summary.get(key)
        if not (
            isinstance(names, list)
            and names
            and all(isinstance(name, str) for name in names)
        ):
            raise InputError(
                f"{told}: {key} is no list of names; run the command that "
                "wrote it again"
            )
    model, design = read_model(folder), read_design(folder)
    design.check(model)
    after = read_calibration(folder).contact
    drawn = DrawnModel(design.model(model), after)
    today = DrawnModel(model, read_calibration(folder / TODAY).contact)
    if summary.get("extrapolated"):
        mark = ". ".join(filter(None, (mark, EXTRAPOLATED)))
    trials = [
        Replayed(
            name.replace("_", " "),
            "Design, forecast",
            drawn,
            read_trial(folder, name, "after"),
            before := read_trial(folder, name, "before"),
            after.ground.spheres,
            before.chair is not None,
            mark,
            today,
        )
        for name in summary["trials"]
    ]
    who = summary["subjects"][0].replace("_", " ")
    # The model of today has the cuffs that the design leaves out.
    write_replay(path, model, trials, f"Design for {who}", "today")


def _title(found: Sequence[Results]) -> str:
    names = {r.summary.get("subject", "") for r in found} - {""}
    who = ", ".join(sorted(names)) or "a subject"
    return f"Movements of {who}".replace("_", " ")


@dataclass(frozen=True)
class Replayed:
    """One trial to be replayed.

    Attributes:
        title: its name.
        group: trials of one group are listed together.
        drawn: its model, with cuffs if there are any.
        simulated: motion and forces as computed.
        measured: as measured; None if there is nothing to compare with.
        spheres: name -> contact sphere in its segment.
        on_chair: whether to draw a stool.
        mark: text shown with a result that does not hold.
        drawn_measured: model of `measured`, if it is a different one.
    """

    title: str
    group: str
    drawn: DrawnModel
    simulated: Trial
    measured: Trial | None
    spheres: dict[str, ContactSphere]
    on_chair: bool = False
    mark: str = ""
    drawn_measured: DrawnModel | None = None

    @property
    def halves(self) -> dict[str, tuple[DrawnModel, Trial]]:
        """Root in meshcat's tree -> model and motion that are drawn there."""
        found = {SIMULATED: (self.drawn, self.simulated)}
        if self.measured is not None:
            drawn = self.drawn_measured or self.drawn
            found[MEASURED] = (drawn, self.measured)
        return found


def _replayed(results: Results, model: Model) -> list[Replayed]:
    """The trials of one result."""
    contact = read_calibration(results.folder).contact
    drawn = DrawnModel(model, contact)
    label = _PHASES.get(results.phase) or results.label
    group = f"{_GROUPS[results.phase]}, Phase {label}"
    return [
        Replayed(
            f"{label}: {found.name.replace('_', ' ')}",
            group,
            drawn,
            found,
            measured,
            contact.ground.spheres,
            # A plate measured it: there was a chair.
            measured.chair is not None,
            results.mark,
        )
        for found, measured in results.pairs()
    ]


def write_replay(
    path: Path,
    model: Model,
    trials: Sequence[Replayed],
    title: str,
    other: str = "measured",
) -> None:
    """Write a page that plays trials of one model.

    Args:
        path: of the page; some MB for the meshes, 0.2 MB for each trial.
        model: with all cuffs whose forces are drawn.
        trials: the first one is played at first.
        title: of the page.
        other: word for what the translucent model shows.
    """
    # The laboratory's origin need not be under the feet.
    centre = round(4.0 * float(trials[0].simulated.q[0, 0])) / 4.0
    view = View(
        eye=(centre + 2.0, -4.9, 1.75),
        target=(centre + 0.05, 0.0, 0.82),
        field_of_view_deg=28.0,
    )
    compared = any(t.measured for t in trials)
    with quiet_drake():
        stage = _stage(trials, centre, view, compared)
    clips = [_clip(trial) for trial in trials]
    known = set().union(*(clip.arrows for clip in clips))
    arrows = [a for a in _arrows(model, other) if a.name in known]
    drawn = {a.metres_per_newton for a in arrows}
    legend = [text for scale, text in _SCALES.items() if scale in drawn]
    legend += [_AROUND] if model.assembly.human.sides else [_AROUND, _SUMMED]
    page = Page(
        title,
        view.eye,
        view.target,
        arrows=arrows,
        switches={
            "forces": ("/arrows", f"{MEASURED}/arrows"),
            "centre of pressure": ("/cop", f"{MEASURED}/cop"),
            "contact spheres": (_SPHERES,),
        },
        ghost=(MEASURED, _BESIDE_M) if compared else None,
        ghost_text=f"{other.capitalize()} (blue, translucent)",
        legend=(f'<p class="player-quiet">{" ".join(legend)}</p>',),
        field_of_view_deg=view.field_of_view_deg,
        speed=0.5,
    )
    write_page(path, stage, page, clips)


def _stage(trials, centre: float, view: View, compared: bool) -> str:
    """Meshcat's page with all bodies in it."""
    meshcat = Meshcat()
    set_stage(meshcat, view)
    _draw_figures(meshcat, trials, compared)
    _draw_markers(meshcat, trials[0], compared)
    add_floor(meshcat, centre)
    seats = [t.drawn.seat_height(t.simulated) for t in trials if t.on_chair]
    if seats:
        add_stool(meshcat, _CHAIR, min(seats))
    return meshcat.StaticHtml()


def _draw_figures(meshcat, trials, compared: bool) -> None:
    """Draw the model and, if compared, the translucent one."""
    for root in (SIMULATED, MEASURED)[: 1 + compared]:
        drawn, _ = next(t.halves[root] for t in trials if root in t.halves)
        scene = Scene(
            drawn.model,
            meshcat=meshcat,
            prefix=root,
            colour=_GHOST if root == MEASURED else None,
        )
        scene.diagram.ForcedPublish(scene.context)
        meshcat.Delete(f"{root}/ground")


def _draw_markers(meshcat, trial: Replayed, compared: bool) -> None:
    """Draw centres of pressure and contact spheres, seen through the feet."""
    for root, opacity in (("", 1.0), (MEASURED, 0.45))[: 1 + compared]:
        disc = Cylinder(0.022, 0.006)
        for side in trial.simulated.soles:
            own = f"{root}/cop/{side}/disc"
            _overlay(meshcat, own, disc, "c8102e", opacity)
    for path, _, sphere, places in _spheres(trial):
        for side, y in enumerate(places):
            own = f"{path}/{side}"
            _overlay(meshcat, own, Sphere(sphere.radius), "f08a1c", 0.45)
            meshcat.SetTransform(own, RigidTransform([0.0, y, 0.0]))


def _spheres(trial: Replayed) -> Iterator[tuple]:
    """Path, segment, sphere and places across [m] of each contact sphere."""
    soles = trial.drawn.soles
    for body, names in soles.items():
        own = _ACROSS_M.get(body.rpartition("_")[2])
        places = list(_FEET_Y_M) if own is None else [own]
        for name in names:
            path = f"{_SPHERES}/{name}"
            path += f"_{body}" if len(soles) > 1 else ""
            yield path, body, trial.spheres[name], places


def _overlay(meshcat, path, shape, colour: str, opacity: float) -> None:
    """Draw a shape that is seen through the bodies in front of it."""
    rgb = (int(colour[i : i + 2], 16) / 255 for i in (0, 2, 4))
    meshcat.SetObject(path, shape, Rgba(*rgb, opacity))
    for name, value in (("depthTest", False), ("transparent", True)):
        meshcat.SetProperty(f"{path}/<object>", f"material.{name}", value)


def _arrows(model: Model, other: str) -> list[Arrow]:
    """Arrows of all forces, as computed and as measured."""
    measured = other == "measured"
    drawn = []
    loads = dict(_LOADS)
    # From above: the pelvis first, as in tables.
    for i, cuff in enumerate(reversed(model.tree.cuffs)):
        colour = _CUFF_COLOURS[i % len(_CUFF_COLOURS)]
        loads[cuff] = (f"cuff at the {cuff}", colour, _CUFF_SCALE, cuff)
    for name, (text, colour, scale, label) in loads.items():
        radius = 0.011 if scale == _GROUND_SCALE else 0.008
        part = measured and name not in _WRENCHES
        drawn += [
            Arrow(name, text, colour, scale, label=label, radius_m=radius),
            Arrow(
                f"{name}_measured",
                f"{other}, normal part" if part else other,
                colour,
                scale,
                root=f"{MEASURED}/arrows",
                opacity=0.55,
                radius_m=1.4 * radius,
            ),
        ]
    return drawn


def _clip(trial: Replayed) -> Clip:
    """One trial as the player's clip, sampled at even times."""
    end = trial.simulated.times[-1]
    times = np.linspace(0.0, end, max(2, round(end / _SECONDS_PER_FRAME) + 1))
    bodies, arrows = {}, {}
    for root, (drawn, motion) in trial.halves.items():
        at = motion.sample(times)
        for path, pose in drawn.poses(at.q).items():
            bodies[f"{root}/{path}"] = pose
        ghost = root == MEASURED
        for path, place in drawn.centres_of_pressure(at).items():
            bodies[root + path if ghost else path] = _still(place)
        for name, rows in drawn.arrows(at).items():
            arrows[f"{name}_measured" if ghost else name] = rows
    bodies |= _surroundings(trial, trial.simulated.sample(times))
    return Clip(
        trial.title, trial.group, times, bodies, arrows, mark=trial.mark
    )


def _surroundings(trial: Replayed, motion: Trial) -> dict[str, np.ndarray]:
    """Path -> poses (n, 7) of the contact spheres and of the stool."""
    found = {}
    tree = trial.drawn.tree
    for path, body, sphere, _ in _spheres(trial):
        place = (sphere.x, sphere.z)
        p_x, p_z = tree.point_positions(motion.q, body, place).T
        place = np.column_stack([p_x, 0.0 * p_x, p_z])
        found[path] = _still(place)
    if trial.on_chair:
        place = np.zeros((len(motion.q), 3))
        place[:, 0] = trial.drawn.hip(motion.q[:1])[0, 0]
        found[_CHAIR] = _still(place)
    return found


def _still(p: np.ndarray) -> np.ndarray:
    """Poses (n, 7) at places (n, 3), without rotation."""
    return np.column_stack([p, np.tile([1.0, 0.0, 0.0, 0.0], (len(p), 1))])


def show_trial(meshcat: Meshcat, model: Model, trial: Trial) -> None:
    """Show a trial as an animation in meshcat, with its centre of pressure.

    Args:
        meshcat: where; what was recorded there before is replaced.
        model: subject and device.
        trial: its motion.
    """
    scene, drawn = Scene(model, meshcat=meshcat), DrawnModel(model)
    set_stage(meshcat)
    for side in trial.soles:
        disc = Cylinder(0.022, 0.006)
        _overlay(meshcat, f"/cop/{side}/disc", disc, "c8102e", 1.0)
    frames = max(2, round(trial.duration / _SECONDS_PER_FRAME) + 1)
    at = trial.sample(np.linspace(0.0, trial.duration, frames))
    cops = drawn.centres_of_pressure(at)
    meshcat.StartRecording()
    for i, (t, q) in enumerate(zip(at.times, at.q, strict=True)):
        scene.set_pose(q, t)
        scene.diagram.ForcedPublish(scene.context)
        for path, place in cops.items():
            # Where a foot bears nothing, its disc is out of sight.
            at_rest = RigidTransform(np.nan_to_num(place[i], nan=_AWAY_M))
            meshcat.SetTransform(path, at_rest, t)
    meshcat.StopRecording()
    meshcat.PublishRecording()
