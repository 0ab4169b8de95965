"""A diagram that only shows a model: no dynamics, a pose in, a picture out.

Kept apart from the diagrams that simulate or plan, because a viewer inside
a diagram blocks its conversion to other scalar types.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import (
    Box,
    Cylinder,
    LightParameter,
    MakeRenderEngineVtk,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    RenderEngineVtkParams,
    Rgba,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from drake_exo.plant import build_plant
from drake_exo.segments import ExoskeletonParameters, HumanParameters

RENDERER = "still"
_WOOD = np.array([0.78, 0.66, 0.50, 1.0])
_STEEL = np.array([0.45, 0.47, 0.50, 1.0])


class Scene:
    """The model of one kind on the ground, to be posed and looked at.

    Attributes:
        plant: the plant within the diagram.
        diagram: plant, SceneGraph and, if asked for, Meshcat.
        context: the diagram's context.
    """

    def __init__(
        self,
        kind: str,
        human: HumanParameters | None = None,
        exoskeleton: ExoskeletonParameters | None = None,
        *,
        chair_height_m: float | None = None,
        meshcat: Meshcat | None = None,
        stills: bool = False,
    ):
        """Build the diagram.

        Args:
            kind: "coupled", "rigid" or "human", as for `build_plant`.
            human: the subject; the nominal adult if None.
            exoskeleton: the device; fitted to the human if None.
            chair_height_m: height of a stool's seat under the model standing
                at the origin; none is drawn if None.
            meshcat: where to publish to.
            stills: prepare an off-screen renderer for still pictures.
        """
        builder = DiagramBuilder()
        self.plant, self._scene_graph = AddMultibodyPlantSceneGraph(
            builder, 0.0
        )
        build_plant(kind, human, exoskeleton, plant=self.plant)
        if chair_height_m is not None:
            _draw_stool(self.plant, chair_height_m)
        self.plant.Finalize()
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(
                builder,
                self._scene_graph,
                meshcat,
                MeshcatVisualizerParams(prefix="model"),
            )
        if stills:
            self._scene_graph.AddRenderer(RENDERER, _renderer())
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()

    def set_pose(self, q: Sequence[float], time_s: float = 0.0) -> None:
        """Move the model to positions q (nq,), in the plant's order."""
        q = np.asarray(q, dtype=float)
        if q.shape != (self.plant.num_positions(),):
            raise ValueError(
                f"pose needs {self.plant.num_positions()} positions, "
                f"not shape {q.shape}"
            )
        self.context.SetTime(time_s)
        self.plant.SetPositions(
            self.plant.GetMyMutableContextFromRoot(self.context), q
        )

    def geometry_query(self):
        """The QueryObject of the current pose."""
        port = self._scene_graph.get_query_output_port()
        return port.Eval(self._scene_graph.GetMyContextFromRoot(self.context))

    @property
    def world_frame_id(self):
        """The SceneGraph's world frame."""
        return self._scene_graph.world_frame_id()


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
    """A stool behind the feet, a picture only: it bears no force."""
    world, seat, x = plant.world_body(), 0.035, -0.47
    plant.RegisterVisualGeometry(
        world,
        RigidTransform([x, 0.0, height_m - 0.5 * seat]),
        Box(0.36, 0.42, seat),
        "stool_seat",
        _WOOD,
    )
    leg = height_m - seat
    for number, (dx, y) in enumerate(
        [(0.15, 0.18), (0.15, -0.18), (-0.15, 0.18), (-0.15, -0.18)]
    ):
        plant.RegisterVisualGeometry(
            world,
            RigidTransform([x + dx, y, 0.5 * leg]),
            Cylinder(0.013, leg),
            f"stool_leg_{number}",
            _STEEL,
        )
