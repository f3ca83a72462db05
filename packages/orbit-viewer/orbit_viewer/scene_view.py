"""Scene in the browser: every link is sent once, and frames only move it; lights; a robot's ghost.

The browser's renderer computes in linear light. Surfaces that receive no directional light, and those that face a
single one, are as bright as :mod:`orbit_core.scene.scene` defines; between the two, the browser's are brighter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.meshes import marker_shapes, triangles
from orbit_core.plugin_kit.rendering import DeformableSurface
from orbit_core.scene import Color, Fluid, Plane, RobotSpec, Scene, Shape
from orbit_core.scene.pose import Vector3
from orbit_core.world.drawing import frame_shapes
from orbit_viewer.liquids import liquid_surface

if TYPE_CHECKING:
    from trimesh import Trimesh
    from viser import BatchedGlbHandle, MeshHandle, ViserServer


@dataclass(frozen=True, eq=False)
class Drawing:
    """Shapes in their own frame, ready to be drawn."""

    glb: bytes
    """Binary glTF with one mesh for each colour."""
    corners: npt.NDArray[np.float64]
    """Corners (8, 3) of the box around the shapes."""

    @staticmethod
    def of(shapes: Iterable[Shape]) -> Drawing:
        """Convert one or more shapes to triangles.

        Raises:
            ConfigurationError: one is a plane, which is infinite.
        """
        import trimesh
        from trimesh.visual import TextureVisuals

        by_color: dict[Color, list[Trimesh]] = {}
        for shape in shapes:
            mesh = triangles(shape.geometry)
            mesh.apply_transform(shape.pose.matrix())
            by_color.setdefault(shape.color, []).append(mesh)
        scene = trimesh.Scene()
        for color, meshes in by_color.items():
            joined: Any = trimesh.util.concatenate(meshes)
            joined.visual = TextureVisuals(material=_material(color))
            scene.add_geometry(joined)
        data = scene.export(file_type="glb", include_normals=True)
        assert isinstance(data, bytes)  # trimesh's other formats give text or several files
        return Drawing(data, np.asarray(trimesh.bounds.corners(scene.bounds)))


def _material(color: Color) -> Any:
    from trimesh.visual.material import PBRMaterial

    # glTF's colours are linear in light; those of the scene and of screens follow the sRGB curve (IEC 61966-2-1).
    screen = np.asarray(color[:3])
    linear = np.where(screen <= 0.04045, screen / 12.92, ((screen + 0.055) / 1.055) ** 2.4)
    rgba = np.round(255.0 * np.array([*linear, color[3]])).astype(np.uint8)
    return PBRMaterial(
        baseColorFactor=rgba,
        metallicFactor=0.0,
        roughnessFactor=0.6,
        alphaMode="OPAQUE" if color[3] >= 1.0 else "BLEND",
    )


# A translucent blue, in which no robot comes, so that a ghost is not taken for the robot.
_COLOR: Color = (0.15, 0.5, 0.95, 0.35)


class Ghost:
    """Drawing of a robot at chosen joint positions, by forward kinematics.

    Args:
        server: viser's server.
        spec: the robot.
    """

    def __init__(self, server: ViserServer, spec: RobotSpec) -> None:
        self._server, self._tree = server, KinematicTree(spec.articulation)
        self._links = []
        for index, link in enumerate(spec.articulation.links):
            if shapes := link.visuals or link.collisions:
                drawing = Drawing.of([replace(shape, color=_COLOR) for shape in shapes])
                handle = server.scene.add_glb(f"/ghost/{index}", drawing.glb, visible=False, cast_shadow=False)
                self._links.append((index, handle))

    def place(self, root: Tensor, positions: Tensor) -> None:
        """Show the robot with its root at a pose (7,) and its joints at positions (J,)."""
        poses = self._tree.forward(root[None].cpu(), positions[None].cpu().to(torch.float32))[0].numpy()
        with self._server.atomic():  # all links in one picture: the ghost would seem to fall apart for a moment
            for index, handle in self._links:
                handle.position, handle.wxyz = poses[index, :3], poses[index, 3:]
                handle.visible = True

    def hide(self) -> None:
        """Hide the robot."""
        for _, handle in self._links:
            handle.visible = False


# Exponent between a screen's colours and linear light, near enough to the sRGB curve for lights.
_GAMMA = 2.2
# Metres from a directional light to the origin, which it shines at.
_DISTANCE = 3.0


def add_lights(server: ViserServer, scene: Scene) -> None:
    """Add a scene's lights and background instead of viser's."""
    browser = server.scene
    browser.configure_default_lights(enabled=False)
    around = np.asarray(scene.ambient, dtype=np.float64)
    color, intensity = browser_light(around**_GAMMA)
    browser.add_light_ambient("/lights/ambient", color=color, intensity=intensity)
    for index, light in enumerate(scene.directional_lights):
        # The difference in linear light: with the ambient light it adds up to the scene's brightness.
        color, intensity = browser_light((around + light.radiance) ** _GAMMA - around**_GAMMA)
        x, y, z = (-_DISTANCE * part for part in light.unit_direction)
        browser.add_light_directional(
            f"/lights/{index}", color=color, intensity=intensity, cast_shadow=light.shadows, position=(x, y, z)
        )
    sky = np.linspace(scene.sky.above, scene.sky.below, 256)
    rows = (255.0 * sky + 0.5).astype(np.uint8)
    browser.set_background_image(np.repeat(rows[:, None], 2, axis=1), format="png")


def browser_light(linear: npt.NDArray[np.float64]) -> tuple[tuple[int, int, int], float]:
    """Compute the colour and intensity of linear light (3,); three.js divides a light's intensity by pi."""
    brightest = float(linear.max())
    if brightest <= 0.0:
        return (0, 0, 0), 0.0
    red, green, blue = (round(255.0 * float(part / brightest) ** (1.0 / _GAMMA)) for part in linear)
    return (red, green, blue), math.pi * brightest


def add_plane(server: ViserServer, index: int, plane: Shape) -> None:
    """Add a plane as an endless grid, in the place of the one that has the same index."""
    color = _bytes(plane.color)
    server.scene.add_grid(
        f"/planes/{index}",
        infinite_grid=True,
        cell_size=0.25,
        section_size=1.0,
        cell_color=_mixed(color, 255, 0.25),
        section_color=_mixed(color, 255, 0.5),
        plane_color=color,
        plane_opacity=1.0,
        shadow_opacity=0.35,
        fade_distance=30.0,
        position=plane.pose.position,
        wxyz=plane.pose.orientation,
    )


FloatArray = npt.NDArray[np.float32]

VIEW_DIRECTION = np.array((0.35, 0.83, 0.43)) / math.hypot(0.35, 0.83, 0.43)
"""Direction from the scene to the camera: to the left of a robot that faces +x, so that it does not hide its work."""
FIELD_OF_VIEW = math.radians(45.0)
_ALL = slice(None)


@dataclass(frozen=True, eq=False)
class Frame:
    """Poses of all links, markers and particles in each of the n drawn environments, in its own frame."""

    link_poses: FloatArray
    """Poses (n, L, 7) in the layout's order."""
    marker_poses: FloatArray
    """Poses (n, M, 7) in the scene's order."""
    particles: tuple[FloatArray, ...] = ()
    """Positions (n, P, 3) of each deformable's particles."""
    first: int = 0
    """Index of the first environment in the world."""


@dataclass(frozen=True, eq=False)
class _Body:
    """Look of a link in the environments of one kind: those of index ``kind`` modulo ``kinds``."""

    link: int
    drawing: Drawing
    kind: int
    kinds: int

    def rows(self, first: int) -> slice:
        """Return this kind's share of the environments from ``first`` on."""
        return slice((self.kind - first) % self.kinds, None, self.kinds)


class SceneView:
    """Drawing of some environments of a scene side by side on a square grid; a single one is at the origin.

    Args:
        server: viser's server, whose scene only this view changes.
        layout: the scene.
        collisions: draw collision shapes instead of visual ones. A link without visual shapes always shows its
            collision shapes.
    """

    def __init__(self, server: ViserServer, layout: SceneLayout, collisions: bool = False) -> None:
        self._server = server
        self._scene = layout.scene
        self._collisions = collisions
        self._bodies: list[_Body] = []
        self._axes = _robot_axes(layout)
        self._layout = layout
        self._surfaces = [DeformableSurface(spec) for spec in layout.scene.deformables]
        self._markers = [Drawing.of(marker_shapes(marker)) for marker in layout.scene.markers]
        planes = [shape for shape in layout.scene.terrain if isinstance(shape.geometry, Plane)]
        solids = [shape for shape in layout.scene.terrain if not isinstance(shape.geometry, Plane)]
        self._terrain = Drawing.of(solids) if solids else None
        self._bodies_drawn: list[tuple[_Body, BatchedGlbHandle]] = []
        self._markers_drawn: list[BatchedGlbHandle] = []
        self._particles_drawn: list[list[MeshHandle]] = []
        self._terrain_drawn: BatchedGlbHandle | None = None
        self._offsets = np.zeros((0, 3), dtype=np.float32)
        self._markers_visible = True
        self._frames_visible = False
        self._first = 0
        self._clickable: dict[int, str] = {}
        self._clicked: Callable[[str], None] | None = None
        server.scene.set_up_direction("+z")
        add_lights(server, layout.scene)
        for index, plane in enumerate(planes):
            add_plane(server, index, plane)
        self._draw_links()

    @property
    def count(self) -> int:
        """Number of environments that are drawn."""
        return len(self._offsets)

    @property
    def offset(self) -> FloatArray:
        """Offset (3,) in metres at which the first environment is drawn."""
        return self._offsets[0] if self.count else np.zeros(3, np.float32)

    def update(self, frame: Frame) -> None:
        """Move everything to the poses of a frame."""
        # Environments look the same unless the scene has variants, so that otherwise others are shown by moving links.
        if len(frame.link_poses) != self.count or (frame.first != self._first and len(self._layout.variants) > 1):
            self._draw(frame)
            return
        with self._server.atomic():
            for body, handle in self._bodies_drawn:
                self._place(handle, frame.link_poses[:, body.link], body.rows(self._first))
            # Markers and links come in one message with the particles, so that a frame is never half drawn.
            for index, handle in enumerate(self._markers_drawn):
                self._place(handle, frame.marker_poses[:, index])
            for index, (handles, particles) in enumerate(zip(self._particles_drawn, frame.particles, strict=True)):
                for handle, (vertices, faces) in zip(handles, self._meshes(index, particles), strict=True):
                    handle.vertices = vertices
                    # Of a liquid alone these change.
                    if faces is not self._surfaces[index].faces:
                        handle.faces = faces.astype(np.uint32)

    def show_collisions(self, collisions: bool) -> None:
        """Draw collision shapes instead of visual ones, from the next frame on."""
        if collisions != self._collisions:
            self._collisions = collisions
            self._draw_links()

    def show_markers(self, visible: bool) -> None:
        """Show or hide markers."""
        self._markers_visible = visible
        for handle in self._markers_drawn:
            handle.visible = visible

    def show_frames(self, visible: bool) -> None:
        """Show or hide axes at bases, end effectors, finger tips, feet and wheels, from the next frame on."""
        if visible != self._frames_visible:
            self._frames_visible = visible
            self._draw_links()

    def let_click(self, entities: Sequence[str], clicked: Callable[[str], None]) -> None:
        """Call ``clicked`` with an entity's name when a person clicks it, from the next frame on, in another thread."""
        chosen = [self._layout.entity(name) for name in entities]
        self._clickable = {link: e.name for e in chosen for link in range(e.links.start, e.links.stop)}
        self._clicked = clicked
        self._draw_links()

    # What is drawn

    def _draw_links(self) -> None:
        """Prepare the links' shapes; the next frame sends them."""
        self._bodies = []
        for entity in self._layout.entities:
            alternatives = entity.spec.alternatives
            for kind, articulation in enumerate(alternatives):
                for number, link in enumerate(articulation.links, start=entity.links.start):
                    shapes = link.collisions if self._collisions or not link.visuals else link.visuals
                    if shapes:
                        self._bodies.append(_Body(number, Drawing.of(shapes), kind, len(alternatives)))
        # No environment counts as drawn, so that the next frame draws all of them.
        self._offsets = np.zeros((0, 3), dtype=np.float32)

    def aim(self) -> None:
        """Aim the camera of new pages at what the next frame shows; it is sent whole."""
        self._offsets = np.zeros((0, 3), dtype=np.float32)

    def _draw(self, frame: Frame) -> None:
        """Send everything again, for other environments or other shapes."""
        self._remove()
        self._first = frame.first
        low, high = self._extent(frame, range(len(self._layout.links)))
        # Environments are apart by the scene's width, and somewhat more, so that they do not touch.
        self._offsets = _square_grid(len(frame.link_poses), spacing=1.25 * float((high - low)[:2].max()) + 0.2)
        with self._server.atomic():
            for body in self._bodies:
                rows = body.rows(self._first)
                if len(self._offsets[rows]):
                    name = f"/links/{body.link}" + (f".{body.kind}" if body.kind else "")
                    handle = self._add(name, body.drawing, frame.link_poses[:, body.link], rows)
                    self._bodies_drawn.append((body, handle))
                    # Handlers belong to handles, which are new whenever everything is sent again.
                    if (name := self._clickable.get(body.link)) and (clicked := self._clicked):
                        handle.on_click(lambda _, name=name, clicked=clicked: clicked(name))
            for body in self._axes if self._frames_visible else ():
                handle = self._add(f"/frames/{body.link}", body.drawing, frame.link_poses[:, body.link])
                handle.cast_shadow = False
                self._bodies_drawn.append((body, handle))
            for index, drawing in enumerate(self._markers):
                handle = self._add(f"/markers/{index}", drawing, frame.marker_poses[:, index])
                handle.cast_shadow = False
                handle.visible = self._markers_visible
                self._markers_drawn.append(handle)
            if self._terrain:
                origin = np.tile(np.array((0, 0, 0, 1, 0, 0, 0), dtype=np.float32), (self.count, 1))
                self._terrain_drawn = self._add("/terrain", self._terrain, origin)
            self._particles_drawn = [
                self._add_deformable(index, particles) for index, particles in enumerate(frame.particles)
            ]
        low, high = self._extent(frame, self._focus)
        self._look_at(low + self._offsets.min(axis=0), high + self._offsets.max(axis=0))

    def _remove(self) -> None:
        bodies = (handle for _, handle in self._bodies_drawn)
        for handle in (*bodies, *self._markers_drawn, *chain(*self._particles_drawn)):
            handle.remove()
        if self._terrain_drawn is not None:
            self._terrain_drawn.remove()
        self._bodies_drawn, self._markers_drawn, self._particles_drawn = [], [], []
        self._terrain_drawn = None

    def _add(self, name: str, drawing: Drawing, poses: FloatArray, rows: slice = _ALL) -> BatchedGlbHandle:
        places = (poses[:, :3] + self._offsets)[rows]
        return self._server.scene.add_batched_glb(name, drawing.glb, poses[rows, 3:], places, lod="off")

    def _place(self, handle: BatchedGlbHandle, poses: FloatArray, rows: slice = _ALL) -> None:
        handle.batched_positions = (poses[:, :3] + self._offsets)[rows]
        handle.batched_wxyzs = poses[rows, 3:]

    def _add_deformable(self, index: int, particles: FloatArray) -> list[MeshHandle]:
        spec = self._scene.deformables[index]
        return [
            self._server.scene.add_mesh_simple(
                f"/deformables/{index}/{environment}",
                vertices,
                faces,
                color=_bytes(spec.color),
                opacity=spec.color[3] if spec.color[3] < 1.0 else None,
                side="double",
                position=offset,
            )
            for environment, ((vertices, faces), offset) in enumerate(
                zip(self._meshes(index, particles), self._offsets, strict=True)
            )
        ]

    def _meshes(self, index: int, particles: FloatArray) -> list[tuple[FloatArray, npt.NDArray[np.int64]]]:
        """Compute the drawn vertices (V, 3) and triangles (F, 3) in each environment of a deformable's particles."""
        spec = self._scene.deformables[index]
        if isinstance(spec, Fluid):
            return [liquid_surface(each, spec.spacing) for each in particles]
        surface = self._surfaces[index]
        return [(vertices, surface.faces) for vertices in surface.vertices(torch.from_numpy(particles)).numpy()]

    # How it looks

    @property
    def _focus(self) -> list[int]:
        """Links that the camera must show: all except those of fixed objects that cannot move, such as tables."""
        entities = [e for e in self._layout.entities if not e.spec.fixed_base or e.spec.articulation.movable_joints]
        return [link for entity in entities for link in range(entity.links.start, entity.links.stop)]

    def _extent(self, frame: Frame, links: Iterable[int]) -> tuple[FloatArray, FloatArray]:
        """Return the corners of a box around links and all deformables of the first environment, or the terrain."""
        first = [body for body in self._bodies if body.rows(frame.first).start == 0 and body.link in set(links)]
        points = [_transformed(frame.link_poses[0, body.link], body.drawing.corners) for body in first]
        points += [particles[0] for particles in frame.particles]
        if not points:
            points = [self._terrain.corners if self._terrain else np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 0.5]])]
        everything = np.concatenate(points).astype(np.float32)
        return everything.min(axis=0), everything.max(axis=0)

    def _look_at(self, low: FloatArray, high: FloatArray) -> None:
        """Aim the camera at a box."""
        center = (low + high) / 2
        radius = max(0.05, float(np.linalg.norm(high - low)) / 2)
        # At 1 the ball around the box would fill the picture's height; the box does not fill the ball, so go closer.
        eye = center + VIEW_DIRECTION * 0.9 * radius / math.sin(FIELD_OF_VIEW / 2)
        camera = self._server.initial_camera
        camera.fov = FIELD_OF_VIEW
        camera.position, camera.look_at = _vector(eye), _vector(center)
        # In proportion to the scene: a fixed near plane would cut off small scenes or waste depth on large ones.
        camera.near = radius / 100.0


def _robot_axes(layout: SceneLayout) -> list[_Body]:
    """Return the axes of all robots, by the links that they are fixed to."""
    return [
        _Body(entity.links.start + entity.spec.articulation.link_names.index(link), Drawing.of(shapes), 0, 1)
        for entity in layout.entities
        if isinstance(entity.spec, RobotSpec)
        for link, shapes in frame_shapes(entity.spec).items()
    ]


def _square_grid(count: int, spacing: float) -> FloatArray:
    """Return places (count, 3) of a grid centred on the origin, row by row."""
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    row, column = np.divmod(np.arange(count), columns)
    flat = np.column_stack([row - (rows - 1) / 2, column - (columns - 1) / 2, np.zeros(count)])
    return np.asarray(flat * spacing, dtype=np.float32)


def _transformed(pose: FloatArray, points: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    w, u = pose[3], pose[4:]
    # Rotation by a quaternion without its matrix: p + w t + u x t with t = 2 u x p.
    turned = 2.0 * np.cross(u, points)
    return points + w * turned + np.cross(u, turned) + pose[:3]


def _bytes(color: Sequence[float]) -> tuple[int, int, int]:
    r, g, b = (round(255 * channel) for channel in color[:3])
    return (r, g, b)


def _mixed(color: tuple[int, int, int], other: int, share: float) -> tuple[int, int, int]:
    r, g, b = (round((1 - share) * channel + share * other) for channel in color)
    return (r, g, b)


def _vector(values: npt.NDArray[np.floating]) -> Vector3:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
