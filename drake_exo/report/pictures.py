"""Still pictures and static pages of a posed model, without a screen."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    Meshcat,
    RenderCameraCore,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo, ImageIo, ImageRgba8U

from drake_exo.report.scene import RENDERER, Scene

# Angles [deg] of ankle, knee and hip that a rise from a chair passes through.
SEATED_DEG = (8.0, 92.0, 84.0)
HALFWAY_DEG = (20.0, 60.0, 75.0)
STANDING_DEG = (0.0, 0.0, 0.0)


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
FROM_THE_RIGHT = View(eye=(0.0, -4.2, 1.0), target=(0.0, 0.0, 0.88))


def upright_pose(
    scene: Scene,
    joints_deg: Sequence[float],
    offsets_deg: Sequence[float] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """Positions with flat feet on the ground.

    Args:
        scene: tells the number of positions and the depth of the soles.
        joints_deg: ankle, knee, hip [deg].
        offsets_deg: by how much the exoskeleton's angles differ [deg].

    Returns:
        (nq,) positions of the scene's plant.
    """
    plant = scene.plant
    coupled = plant.num_positions() == 9
    q = np.zeros(plant.num_positions())
    q[3:6] = np.radians(joints_deg)
    if coupled:
        q[6:9] = q[3:6] + np.radians(offsets_deg)
    shod = plant.HasFrameNamed("plate_heel")
    sole = plant.GetFrameByName("plate_heel" if shod else "sole_heel")
    q[1] = -sole.GetFixedPoseInBodyFrame().translation()[2]
    return q


def render(
    scene: Scene,
    q: Sequence[float],
    view: View = OBLIQUE,
    *,
    width: int = 700,
    height: int = 900,
) -> np.ndarray:
    """Picture of a pose.

    Args:
        scene: made with `stills=True`.
        q: (nq,) positions.
        view: the camera.
        width, height: of the picture [pixels].

    Returns:
        (height, width, 3) colours, 0 to 255.
    """
    scene.set_pose(q)
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
    image = scene.geometry_query().RenderColorImage(
        camera, scene.world_frame_id, view.pose()
    )
    colours = image.data[:, :, :3].reshape(height, fine, width, fine, 3)
    return np.round(colours.mean(axis=(1, 3))).astype(np.uint8)


def write_png(path: Path, colours: np.ndarray) -> None:
    """Write colours (height, width, 3) as a PNG file."""
    height, width, _ = colours.shape
    image = ImageRgba8U(width, height)
    image.mutable_data[:, :, :3] = colours
    image.mutable_data[:, :, 3] = 255
    ImageIo().Save(image, Path(path))


def write_page(
    path: Path, kind: str, q: Sequence[float] | None = None, **model
) -> None:
    """Write a page (static HTML) on which the posed model can be turned.

    Args:
        path: of the page, about 5 MB; needs no server and no network.
        kind: "coupled", "rigid" or "human".
        q: (nq,) positions; standing if None.
        model: `human`, `exoskeleton`, `chair_height_m`, as for `Scene`.
    """
    meshcat = Meshcat()
    scene = Scene(kind, meshcat=meshcat, **model)
    scene.set_pose(upright_pose(scene, STANDING_DEG) if q is None else q)
    scene.diagram.ForcedPublish(scene.context)
    set_stage(meshcat)
    Path(path).write_text(meshcat.StaticHtml())


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
