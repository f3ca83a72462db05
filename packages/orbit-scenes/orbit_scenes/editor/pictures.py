"""Pictures drawn by the project's own renderers without an engine: thumbnails, and what cameras of a scene see."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_assets.cache import cache_folder, write_cached
from orbit_core.backends import backend_config, backend_names, renderer
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import Capability, ConfigurationError, OrbitError, Renderer, SceneLayout
from orbit_core.interfaces.layout import home_positions
from orbit_core.preparation.scenes import prepared
from orbit_core.scene import STUDIO, CameraSpec, Channel, Entity, ObjectSpec, Pose, RobotSpec, Scene, look_at
from orbit_core.scene.pose import FloatArray
from orbit_core.world.studio import StudioRenderer, dressed
from orbit_scenes.document.build import SceneBuilder
from orbit_scenes.document.edits import standing_at
from orbit_scenes.document.model import SceneDocument
from orbit_scenes.editor.catalogue import Entry, Group

Picture = npt.NDArray[np.uint8]

THUMBNAIL = (128, 96)
"""Width and height of a thumbnail, pixels."""
_FOV = 0.6
# Direction from a thing to the camera: furniture opens towards -x, robots face +x.
_FROM = {Group.FURNITURE: (-0.75, -0.55, 0.45), Group.ROBOT: (0.8, -0.6, 0.4)}
_ANYWHERE = (-0.5, -0.8, 0.6)


def scene_poses(scene: Scene) -> Tensor:
    """Return the poses (1, L, 7) of all links of a scene at reset, in the layout's order."""
    return torch.cat([entity_poses(entity) for entity in scene.entities] or [torch.zeros(0, 7)])[None]


def entity_poses(entity: Entity) -> Tensor:
    """Return the poses (L, 7) of an entity's links at reset, in the environment's frame."""
    root = torch.tensor([(*entity.pose.position, *entity.pose.orientation)], dtype=torch.float32)
    positions = torch.tensor(home_positions(entity)[None], dtype=torch.float32)
    return KinematicTree(entity.articulation).forward(root, positions)[0]


class Eye:
    """Renderer of one scene whose links may move; it must be used by one thread.

    Args:
        scene: that is drawn.
        cameras: that it is drawn for.
        name: of the renderer.

    Raises:
        OrbitError: the renderer cannot draw the scene.
    """

    def __init__(self, scene: Scene, cameras: Sequence[CameraSpec], name: str) -> None:
        plugin = renderer(name)
        layout = dressed(SceneLayout.of(prepared(replace(scene, sensors=(), markers=()))), STUDIO)
        inner = plugin.create_renderer(layout, tuple(cameras), backend_config(plugin))
        self._renderer: Renderer = StudioRenderer(inner, layout.scene, STUDIO)

    def picture(self, camera: CameraSpec, pose: Pose, link_poses: Tensor) -> Picture:
        """Draw what a camera sees, (H, W, 3).

        Args:
            camera: one of those that the renderer was made for.
            pose: of the camera in the environment's frame.
            link_poses: (1, L, 7) of all links.
        """
        at = torch.tensor([(*pose.position, *pose.orientation)], dtype=torch.float32)
        image = self._renderer.render(camera, at, link_poses, (Channel.RGB,))
        assert image.rgb is not None  # it was asked for
        return image.rgb[0].cpu().numpy()

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


def drawing_name(preferred: str) -> str:
    """Return the name of what draws: the preferred backend or renderer if it can, else the first backend that can.

    Raises:
        ConfigurationError: nothing that is installed draws colours.
        UnknownNameError: there is no backend or renderer of that name.
    """
    if renderer(preferred).capabilities().has(Capability.RGB):
        return preferred
    for name in backend_names():
        try:
            if renderer(name).capabilities().has(Capability.RGB):
                return name
        except OrbitError:
            # A broken plugin is reported where it is chosen.
            continue
    raise ConfigurationError(f"'{preferred}' draws no pictures, nor does any other installed backend: install one")


def thumbnail(entry: Entry, renderer_name: str) -> Picture | None:
    """Return the picture (96, 128, 3) of an entry, from the cache or drawn now; None of what has no looks.

    Args:
        entry: robot or object.
        renderer_name: draws it where the cache has no picture.

    Raises:
        OrbitError: its model is not available.
    """
    from PIL import Image

    path = thumbnail_path(entry, renderer_name)
    if entry.group is Group.SENSOR:
        return None
    if path.is_file():
        with suppress(OSError), Image.open(path) as image:  # a damaged one is drawn again
            if image.size == THUMBNAIL:
                return np.asarray(image.convert("RGB"))
    picture = draw_thumbnail(entry, renderer_name)
    # Without a cache that can be written each session draws its own.
    with suppress(OrbitError, OSError):
        write_cached(path, lambda file: Image.fromarray(picture).save(file, format="PNG"))
    return picture


def thumbnail_path(entry: Entry, renderer_name: str) -> Path:
    """Return the file of an entry's picture in the cache; it is another after a change of the libraries."""
    text = f"{entry.group.name} {entry.name} {renderer_name} {_stamp()}"
    return cache_folder() / "thumbnails" / f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.png"


@functools.cache
def _stamp() -> int:
    """Return the time of the latest change of what models are made by, in nanoseconds."""
    folders = [Path(str(files(package))) for package in ("orbit_scenes", "orbit_assets")]
    sources = (path for folder in folders for path in folder.rglob("*") if path.suffix in (".py", ".toml"))
    return max(path.stat().st_mtime_ns for path in sources)


def draw_thumbnail(entry: Entry, renderer_name: str) -> Picture:
    """Draw an entry alone on the ground, (96, 128, 3).

    Raises:
        OrbitError: its model is not available.
    """
    builder, document = SceneBuilder(Path()), SceneDocument()
    item = standing_at(document, builder, entry.item("item"), 0.0, 0.0)
    low, high = builder.bounds(item)
    entity = builder.entity(item)
    scene = builder.scene(document)
    if isinstance(entity, RobotSpec):
        scene = replace(scene, robots=(entity,))
    elif isinstance(entity, ObjectSpec):
        scene = replace(scene, objects=(entity,))
    camera = CameraSpec(name="thumbnail", width=THUMBNAIL[0], height=THUMBNAIL[1], vertical_fov=_FOV, near=0.005)
    eye = Eye(scene, (camera,), renderer_name)
    try:
        return eye.picture(camera, framing(low, high, _FROM.get(entry.group, _ANYWHERE)), scene_poses(scene))
    finally:
        eye.close()


def framing(low: FloatArray, high: FloatArray, direction: tuple[float, float, float] = _ANYWHERE) -> Pose:
    """Return the pose of a camera that sees a box from a direction.

    Args:
        low: lowest corner, m.
        high: highest corner, m.
        direction: from the box to the camera.
    """
    middle = (low + high) / 2.0
    radius = max(0.03, float(np.linalg.norm(high - low)) / 2.0)
    # The ball around the box, a little cut: boxes do not fill it.
    away = 0.92 * radius / math.sin(_FOV / 2.0)
    way = np.asarray(direction) / np.linalg.norm(direction)
    x, y, z = (float(part) for part in middle + away * way)
    a, b, c = (float(part) for part in middle)
    return look_at((x, y, z), (a, b, c))


def camera_pose(camera: CameraSpec, scene: Scene, link_poses: Tensor) -> Pose:
    """Return the pose of a camera in the environment's frame.

    Args:
        camera: fixed to the scene, or to a frame of an entity.
        scene: that the camera is in.
        link_poses: (1, L, 7) of all links.
    """
    if camera.entity is None:
        return camera.pose
    layout = next(each for each in SceneLayout.of(replace(scene, sensors=())).entities if each.name == camera.entity)
    body = layout.spec.articulation
    mount = body.frame(camera.frame or body.root.name)
    x, y, z, *orientation = link_poses[0, layout.links.start + body.link_names.index(mount.link)].tolist()
    w, qx, qy, qz = orientation
    return Pose((x, y, z), (w, qx, qy, qz)) @ mount.pose @ camera.pose
