"""Draws a model: a Drake diagram without dynamics, a pose in, a picture out.

It is kept apart from the diagrams that simulate or plan, because a viewer
inside a diagram blocks its conversion to other scalar types. Stills and static
pages need no screen.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import radians

import numpy as np
from pydrake.geometry import (
    Box,
    ClippingRange,
    ColorRenderCamera,
    Cylinder,
    IllustrationProperties,
    LightParameter,
    MakeRenderEngineVtk,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    RenderCameraCore,
    RenderEngineVtkParams,
    Rgba,
    Role,
    RoleAssign,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from drake_exo.errors import InputError, check_type
from drake_exo.model.plant import Model

RENDERER = "still"
_WOOD = np.array([0.78, 0.66, 0.50, 1.0])
_STOOL_X_M = -0.47  # of the stool of a model that stands at the origin
_GRID_M = 0.25
_STEEL = np.array([0.45, 0.47, 0.50, 1.0])


@contextmanager
def quiet_drake() -> Iterator[None]:
    """Hide Drake's notes on Meshcat's server: only its page is used."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


def _angles(what: str, degrees, joints: Sequence[str]) -> np.ndarray:
    """Angles [rad], one for each of the joints."""
    found = np.asarray(degrees, dtype=float)
    if found.shape != (len(joints),):
        raise InputError(
            f"{what} has the shape {found.shape}; give an angle for each of "
            f"{', '.join(joints) or 'no joints'}"
        )
    if not np.isfinite(found).all():  # Drake would end the process
        raise InputError(f"{what} holds values that are not finite numbers")
    return np.radians(found)


class Scene:
    """A model on the ground, to be posed and drawn.

    Attributes:
        plant: the plant within the diagram.
        diagram: plant, SceneGraph and, if asked for, Meshcat.
        context: the diagram's context.
        coordinates: of the model.

    >>> from drake_exo.model.plant import nominal_model
    >>> scene = Scene(nominal_model("human"))
    >>> scene.upright_pose((0.0, 90.0, 90.0)).shape
    (6,)
    """

    def __init__(
        self,
        model: Model,
        *,
        chair_height_m: float | None = None,
        meshcat: Meshcat | None = None,
        prefix: str = "model",
        colour: Rgba | None = None,
    ):
        """Build the diagram.

        Args:
            model: subject and device.
            chair_height_m: height of the seat of a stool behind the model,
                which stands at the origin; none is drawn if None.
            meshcat: to publish to.
            prefix: path there, under which the bodies hang.
            colour: of everything, such as a translucent one; the model's own
                colours if None.
        """
        check_type(model, Model, "model")
        self.coordinates = model.coordinates
        builder = DiagramBuilder()
        self.plant, self._scene_graph = AddMultibodyPlantSceneGraph(
            builder, 0.0
        )
        model.plant(self.plant)
        if chair_height_m is not None:
            _draw_stool(self.plant, chair_height_m)
        self.plant.Finalize()
        if colour is not None:
            self._paint(colour)
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(
                builder,
                self._scene_graph,
                meshcat,
                MeshcatVisualizerParams(prefix=prefix),
            )
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()

    def _paint(self, colour: Rgba) -> None:
        """Draw everything in one colour."""
        inspector = self._scene_graph.model_inspector()
        for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
            look = IllustrationProperties(
                inspector.GetIllustrationProperties(geometry)
            )
            look.UpdateProperty("phong", "diffuse", colour)
            self._scene_graph.AssignRole(
                self.plant.get_source_id(), geometry, look, RoleAssign.kReplace
            )

    def set_pose(self, q: Sequence[float], time_s: float = 0.0) -> None:
        """Move the model to positions q (nq,), in the plant's order."""
        q = np.asarray(q, dtype=float)
        if q.shape != (self.plant.num_positions(),):
            raise ValueError(
                f"pose needs {self.plant.num_positions()} positions, "
                f"not shape {q.shape}"
            )
        if not np.isfinite(q).all():  # Drake would end the process
            raise InputError("pose holds values that are not finite numbers")
        self.context.SetTime(time_s)
        self.plant.SetPositions(
            self.plant.GetMyMutableContextFromRoot(self.context), q
        )

    def upright_pose(
        self,
        joints_deg: Sequence[float],
        offsets_deg: Sequence[float] | float = 0.0,
    ) -> np.ndarray:
        """Positions with flat feet on the ground; of two legs, the left foot.

        Args:
            joints_deg: one for each of `coordinates.human` [deg]; of one leg
                ankle, knee, hip.
            offsets_deg: added for the exoskeleton's [deg], one for each of
                `coordinates.device` or one for all.

        Returns:
            (nq,) positions of the plant.

        Raises:
            InputError: another number of angles, or one that is not finite.
        """
        plant, names = self.plant, self.coordinates
        body = np.zeros(len(names.body))
        joints = _angles("joints_deg", joints_deg, names.human)
        body[names.columns(names.human)] = joints
        q = names.aligned(body[None])[0]
        if np.ndim(offsets_deg) == 0:
            offsets_deg = [offsets_deg] * len(names.device)
        q[names.device_columns] += _angles(
            "offsets_deg", offsets_deg, names.device
        )
        heels = "plate_heel", "sole_heel", "sole_heel_left"
        sole = plant.GetFrameByName(next(filter(plant.HasFrameNamed, heels)))
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, q)
        R = sole.CalcPoseInWorld(context).rotation().matrix()
        q[2] -= np.arctan2(R[2, 0], R[0, 0])
        plant.SetPositions(context, q)
        ankle = plant.EvalBodyPoseInWorld(context, sole.body()).translation()
        heel = sole.CalcPoseInWorld(context).translation()
        q[:2] -= ankle[0], heel[2]
        return q

    def render(
        self,
        q: Sequence[float],
        view: "View | None" = None,
        *,
        width: int = 700,
        height: int = 900,
    ) -> np.ndarray:
        """Picture of a pose; the first takes a second longer.

        Args:
            q: (nq,) positions.
            view: the camera; oblique if None.
            width, height: of the picture [pixels].

        Returns:
            (height, width, 3) colours, 0 to 255.
        """
        self.set_pose(q)
        scene = self._scene_graph
        context = scene.GetMyMutableContextFromRoot(self.context)
        if not scene.HasRenderer(context, RENDERER):
            scene.AddRenderer(context, RENDERER, _renderer())
        view = view or OBLIQUE
        fine = 2  # drawn twice as fine and averaged: smooth edges
        camera = ColorRenderCamera(
            RenderCameraCore(
                RENDERER,
                CameraInfo(
                    fine * width, fine * height, radians(view.field_of_view_deg)
                ),
                ClippingRange(0.05, 50.0),
                RigidTransform(),
            ),
            False,
        )
        image = self.geometry_query().RenderColorImage(
            camera, scene.world_frame_id(), view.pose()
        )
        colours = image.data[:, :, :3].reshape(height, fine, width, fine, 3)
        return np.round(colours.mean(axis=(1, 3))).astype(np.uint8)

    def geometry_query(self):
        """The QueryObject of the current pose."""
        port = self._scene_graph.get_query_output_port()
        return port.Eval(self._scene_graph.GetMyContextFromRoot(self.context))


def _renderer():
    """A VTK renderer that needs no screen, lit from above and both sides."""

    def light(direction, intensity: float, frame: str) -> LightParameter:
        direction = np.array(direction) / np.linalg.norm(direction)
        return LightParameter(
            type="directional",
            color=Rgba(1.0, 1.0, 1.0),
            intensity=intensity,
            frame=frame,
            direction=direction,
        )

    return MakeRenderEngineVtk(
        RenderEngineVtkParams(
            default_clear_color=[1.0, 1.0, 1.0],
            lights=[
                light([-0.5, 0.6, -0.8], 0.75, "world"),
                light([0.6, 0.5, -0.4], 0.4, "world"),
                light([0.0, 0.0, 1.0], 0.55, "camera"),
            ],
        )
    )


def _draw_stool(plant, height_m: float) -> None:
    """Draw a stool behind the feet; it bears no force."""
    for name, (shape, p, colour) in _stool(height_m).items():
        plant.RegisterVisualGeometry(
            plant.world_body(),
            RigidTransform(np.add(p, [_STOOL_X_M, 0.0, 0.0])),
            shape,
            f"stool_{name}",
            colour,
        )


def _stool(height_m: float) -> dict[str, tuple]:
    """Part -> shape, place [m] and colour; the seat's top at the height."""
    seat = 0.035
    leg = height_m - seat
    parts = {
        "seat": (Box(0.36, 0.42, seat), [0, 0, height_m - 0.5 * seat], _WOOD)
    }
    for number, (x, y) in enumerate(
        [(0.15, 0.18), (0.15, -0.18), (-0.15, 0.18), (-0.15, -0.18)]
    ):
        place = [x, y, 0.5 * leg]
        parts[f"leg_{number}"] = (Cylinder(0.013, leg), place, _STEEL)
    return parts


def add_stool(meshcat: Meshcat, path: str, height_m: float) -> None:
    """Draw a stool in meshcat only, its seat centred over the path's origin."""
    for name, (shape, p, colour) in _stool(height_m).items():
        meshcat.SetObject(f"{path}/{name}", shape, Rgba(*colour))
        meshcat.SetTransform(f"{path}/{name}", RigidTransform(p))


def add_floor(meshcat: Meshcat, centre_x_m: float) -> None:
    """Draw a floor with a 0.25 m grid in meshcat only, its top at z = 0."""
    length, width, depth = 5.0, 2.5, 0.01
    meshcat.SetObject(
        "/floor/slab", Box(length, width, depth), Rgba(0.86, 0.87, 0.89)
    )
    meshcat.SetTransform(
        "/floor/slab", RigidTransform([centre_x_m, 0.0, -0.5 * depth - 1e-3])
    )
    starts, ends = [], []
    x, y = 0.5 * length, 0.5 * width
    for at in np.arange(-x, x + 1e-9, _GRID_M):
        starts.append([centre_x_m + at, -y, 0.0])
        ends.append([centre_x_m + at, y, 0.0])
    for at in np.arange(-y, y + 1e-9, _GRID_M):
        starts.append([centre_x_m - x, at, 0.0])
        ends.append([centre_x_m + x, at, 0.0])
    meshcat.SetLineSegments(
        "/floor/grid",
        np.array(starts).T,
        np.array(ends).T,
        1.0,
        Rgba(0.70, 0.72, 0.75),
    )


@dataclass(frozen=True)
class View:
    """Where the camera stands and looks, in the world [m].

    Attributes:
        eye, target: positions of the camera and of the picture's centre.
        field_of_view_deg: vertical opening.
    """

    eye: tuple[float, float, float] = (2.3, -3.4, 1.6)
    target: tuple[float, float, float] = (0.0, 0.0, 0.86)
    field_of_view_deg: float = 30.0

    def pose(self) -> RigidTransform:
        """Pose X_WC of the camera: z into the picture, y down."""
        p_WC = np.array(self.eye)
        z = np.array(self.target) - p_WC
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        R_WC = RotationMatrix(np.column_stack([x, np.cross(z, x), z]))
        return RigidTransform(R_WC, p_WC)


OBLIQUE = View()


def set_stage(meshcat: Meshcat, view: View = OBLIQUE) -> None:
    """Point the camera of a page; hide axes and grid."""
    for name in ("/Axes", "/Grid"):
        meshcat.SetProperty(name, "visible", False)
    background = "/Background/<object>"
    meshcat.SetProperty(background, "top_color", [1.0, 1.0, 1.0])
    meshcat.SetProperty(background, "bottom_color", [0.93, 0.94, 0.96])
    # A long lens: little perspective, so that arrows beside the leg still
    # start where they act.
    meshcat.SetCamera(
        Meshcat.PerspectiveCamera(fov=view.field_of_view_deg, aspect=1.5)
    )
    meshcat.SetCameraPose(view.eye, view.target)
