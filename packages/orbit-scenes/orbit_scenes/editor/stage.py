"""Drawing of a document in the browser: what changed is sent again, what moved is moved."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Articulation, CameraSpec, Plane, Pose, Scene
from orbit_core.scene.pose import FloatArray
from orbit_scenes.document.model import TaskPlan
from orbit_scenes.editor.pictures import Picture, camera_pose
from orbit_viewer.scene_view import Drawing, add_lights, add_plane

if TYPE_CHECKING:
    from viser import ViserServer

# viser's cameras look along +z, y down; a scene's look along -z, y up.
_FLIP = Pose.from_axis_angle((1.0, 0.0, 0.0), math.pi)
_SELECTED = (255, 150, 20)
_GOAL = (40, 180, 70)


@dataclass(eq=False)
class _Drawn:
    """Drawing of one entity."""

    articulation: Articulation
    handles: list[tuple[int, Any]] = field(default_factory=list)
    """Index of the link in the entity, and its drawing."""

    def remove(self) -> None:
        for _, handle in self.handles:
            handle.remove()


class Stage:
    """Scene on the page.

    Args:
        server: viser's server, whose scene only this object changes.
        clicked: called with the name of the item or camera that a person clicks, in another thread.
    """

    def __init__(self, server: ViserServer, clicked: Callable[[str], None]) -> None:
        self._server, self._clicked = server, clicked
        self._drawings: dict[int, tuple[Articulation, list[tuple[int, Drawing]]]] = {}
        self._drawn: dict[str, _Drawn] = {}
        self._cameras: dict[str, Any] = {}
        self._ground: tuple[Any, ...] = ()
        self._planes = 0
        self._lit: tuple[Any, ...] = ()
        self._goal: Any = None
        self._goal_size: tuple[float, ...] = ()
        self._box: Any = None
        self._box_size: tuple[float, ...] = ()
        server.scene.set_up_direction("+z")

    def show(self, scene: Scene, link_poses: Tensor, task: TaskPlan | None) -> None:
        """Draw a scene with its links at poses (1, L, 7), and the goal region of its task."""
        with self._server.atomic():
            lit = (scene.lights, scene.sky)
            if lit != self._lit:
                self._lit = lit
                for index in range(len(scene.directional_lights), 3):
                    self._server.scene.remove_by_name(f"/lights/{index}")
                add_lights(self._server, scene)
            if scene.terrain != self._ground:
                self._show_ground(scene)
            for name in set(self._drawn) - {entity.name for entity in scene.entities}:
                self._drawn.pop(name).remove()
            layout = SceneLayout.of(replace(scene, sensors=()))
            for entity in layout.entities:
                self._show_entity(entity.name, entity.spec.articulation)
                self.move(entity.name, link_poses[0, entity.links].numpy())
            self._show_cameras(scene, link_poses)
            self._show_goal(task)

    def move(self, name: str, link_poses: npt.NDArray[np.float32]) -> None:
        """Move an entity's links to poses (L, 7)."""
        for index, handle in self._drawn[name].handles:
            handle.position, handle.wxyz = link_poses[index, :3], link_poses[index, 3:]

    def show_selected(self, low: FloatArray | None, high: FloatArray | None = None) -> None:
        """Draw a box around what is selected, or none."""
        if low is None or high is None:
            self._remove_box()
            return
        size = tuple(float(edge) for edge in np.round(high - low + 0.01, 4))
        if size != self._box_size:
            self._remove_box()
            # Long thin boxes instead of a wireframe, which browsers draw one pixel wide.
            self._box = self._server.scene.add_line_segments(
                "/selected", _edges(size), _SELECTED, thickness=2.5, thickness_units="screen"
            )
            self._box_size = size
        x, y, z = (float(part) for part in (low + high) / 2.0)
        self._box.position = (x, y, z)

    def show_seen(self, name: str, picture: Picture) -> None:
        """Show a camera's picture within its frustum."""
        if name in self._cameras:
            self._cameras[name].image = picture

    def move_goal(self, position: tuple[float, float, float]) -> None:
        """Move the goal region while it is dragged."""
        if self._goal is not None:
            self._goal.position = position

    def _remove_box(self) -> None:
        if self._box is not None:
            self._box.remove()
            self._box, self._box_size = None, ()

    def _show_ground(self, scene: Scene) -> None:
        for index in range(self._planes):
            self._server.scene.remove_by_name(f"/planes/{index}")
        if self._ground:
            self._server.scene.remove_by_name("/terrain")
        planes = [shape for shape in scene.terrain if isinstance(shape.geometry, Plane)]
        for index, plane in enumerate(planes):
            add_plane(self._server, index, plane)
        solids = [shape for shape in scene.terrain if not isinstance(shape.geometry, Plane)]
        if solids:
            self._server.scene.add_glb("/terrain", Drawing.of(solids).glb)
        self._planes, self._ground = len(planes), scene.terrain

    def _show_entity(self, name: str, articulation: Articulation) -> None:
        known = self._drawn.get(name)
        if known is not None and known.articulation is articulation:
            return
        if known is not None:
            known.remove()
        drawn = self._drawn[name] = _Drawn(articulation)
        for index, drawing in self._looks(articulation):
            handle = self._server.scene.add_glb(f"/items/{name}/{index}", drawing.glb)
            handle.on_click(lambda _, name=name: self._clicked(name))
            drawn.handles.append((index, handle))

    def _looks(self, articulation: Articulation) -> list[tuple[int, Drawing]]:
        """Return the drawings of an articulation's links, made once for all items that look alike."""
        if id(articulation) not in self._drawings:
            shapes = ((index, link.visuals or link.collisions) for index, link in enumerate(articulation.links))
            made = [(index, Drawing.of(given)) for index, given in shapes if given]
            # With the articulation itself, so that its identity is not another's later.
            self._drawings[id(articulation)] = (articulation, made)
        return self._drawings[id(articulation)][1]

    def _show_cameras(self, scene: Scene, link_poses: Tensor) -> None:
        cameras: Mapping[str, CameraSpec] = {each.name: each for each in scene.sensors if isinstance(each, CameraSpec)}
        for name in set(self._cameras) - set(cameras):
            self._cameras.pop(name).remove()
        for name, camera in cameras.items():
            at = camera_pose(camera, scene, link_poses) @ _FLIP
            shape = (camera.vertical_fov, camera.width / camera.height)
            handle = self._cameras.get(name)
            if handle is None or (handle.fov, handle.aspect) != shape:
                handle = self._server.scene.add_camera_frustum(
                    f"/cameras/{name}", *shape, scale=0.12, thickness=0.004, color=(30, 90, 200), cast_shadow=False
                )
                handle.on_click(lambda _, name=name: self._clicked(name))
                self._cameras[name] = handle
            handle.position, handle.wxyz = at.position, at.orientation

    def _show_goal(self, task: TaskPlan | None) -> None:
        if self._goal is not None and (task is None or task.size != self._goal_size):
            self._goal.remove()
            self._goal = None
        if task is None:
            return
        if self._goal is None:
            self._goal = self._server.scene.add_box(
                "/goal", _GOAL, task.size, opacity=0.25, cast_shadow=False, receive_shadow=False
            )
            self._goal_size = task.size
        self._goal.position = task.goal


def _edges(size: tuple[float, ...]) -> npt.NDArray[np.float32]:
    """Return the twelve edges (12, 2, 3) of a box around the origin."""
    half = np.asarray(size) / 2.0
    edges = []
    for axis in range(3):
        for first in (-1.0, 1.0):
            for second in (-1.0, 1.0):
                ends = np.array([[first] * 3, [first] * 3])
                ends[:, (axis + 1) % 3], ends[:, (axis + 2) % 3] = first, second
                ends[:, axis] = (-1.0, 1.0)
                edges.append(ends * half)
    return np.asarray(edges, np.float32)
