"""Scaffold of a renderer: one call as one request, the fields of an image that channels need, surfaces of deformables.

A renderer that draws on the device of the poses derives from :class:`KitRenderer`, one that draws with NumPy on the
host from :class:`HostRenderer`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError, Image, Renderer
from orbit_core.scene import CameraSpec, Channel, DeformableSpec, Fluid, Mesh, Rope, Scene, SoftBody

# Sides of the prism that shows a piece of rope
_SIDES = 8
# Cosine of the angle between two triangles of a solid at rest from which on their edge is sharp: 40 degrees
_SHARP = math.cos(math.radians(40.0))


class DeformableSurface:
    """Vertices and triangles of a deformable: of cloth and soft bodies their meshes, of a rope a prism for each piece.

    Vertices of a soft body are repeated along its sharp edges, so that shading by the mean of the triangles at a vertex
    does not round them. A fluid has its particles for vertices and no triangles: its surface is around the particles,
    and new in each step.
    """

    def __init__(self, spec: DeformableSpec) -> None:
        self._spec = spec
        self._repeated: Tensor | None = None
        faces = _faces(spec)
        if isinstance(spec, SoftBody):
            faces, origins = _split_at_edges(spec.mesh)
            if len(origins) > len(spec.rest_positions):
                self._repeated = torch.from_numpy(origins)
        self.faces = faces
        """(F, 3) of indices into the vertices; seen from both sides."""

    def vertices(self, positions: Tensor) -> Tensor:
        """Return (n, V, 3) of particles (n, P, 3)."""
        if isinstance(self._spec, Rope):
            return _prisms(positions, self._spec.radius)
        if self._repeated is not None:
            if self._repeated.device != positions.device:
                self._repeated = self._repeated.to(positions.device)
            return positions.index_select(1, self._repeated)
        return positions


def _faces(spec: DeformableSpec) -> npt.NDArray[np.int64]:
    if isinstance(spec, Rope):
        start = 2 * _SIDES * np.arange(len(spec.rest_positions) - 1)[:, None, None]
        side = np.arange(_SIDES)
        following = (side + 1) % _SIDES
        lower = np.stack((side, following, following + _SIDES), axis=-1)
        upper = np.stack((side, following + _SIDES, side + _SIDES), axis=-1)
        return (start + np.concatenate((lower, upper))).reshape(-1, 3)
    if isinstance(spec, Fluid):
        return np.zeros((0, 3), dtype=np.int64)
    return np.ascontiguousarray(spec.mesh.faces, dtype=np.int64)


def _split_at_edges(mesh: Mesh) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Repeat vertices of a closed surface so that triangles across a sharp edge share none.

    Returns:
        (F, 3) triangles of the new vertices, and (V,) int64 vertex of the mesh that each of them is.
    """
    faces = np.asarray(mesh.faces, dtype=np.int64)
    a, b, c = np.asarray(mesh.vertices, dtype=np.float64)[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-30)
    # Half-edges: of triangle f from its corner k to the next; the same edge of two triangles comes twice in a row.
    count = len(faces)
    first, second = np.arange(3 * count), (np.arange(count)[:, None] * 3 + np.array([1, 2, 0])).ravel()
    ends = np.sort(np.stack((faces.ravel()[first], faces.ravel()[second]), 1), axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    one, two = order[:-1], order[1:]
    smooth = (ends[one] == ends[two]).all(1) & ((normals[one // 3] * normals[two // 3]).sum(1) > _SHARP)
    one, two = one[smooth], two[smooth]
    # Corners of both triangles at both ends of a smooth edge: half-edges of a closed surface run against each other.
    pairs = np.concatenate((np.stack((first[one], second[two]), 1), np.stack((second[one], first[two]), 1)))
    labels, before = np.arange(3 * count), np.empty(0)
    while not np.array_equal(labels, before):
        before = labels.copy()
        least = labels[pairs].min(1)
        np.minimum.at(labels, pairs[:, 0], least)
        np.minimum.at(labels, pairs[:, 1], least)
    corners, new = np.unique(labels, return_inverse=True)
    return np.ascontiguousarray(new.reshape(-1, 3), dtype=np.int64), faces.ravel()[corners]


def _prisms(points: Tensor, radius: float) -> Tensor:
    """Return (n, (P - 1) 2 sides, 3): two rings around each piece, across it."""
    along = points[:, 1:] - points[:, :-1]
    along = along / along.norm(dim=-1, keepdim=True).clamp_min(1e-12)
    # Any direction that is not along: the axis that is least so.
    other = torch.nn.functional.one_hot(along.abs().argmin(-1), 3).to(along.dtype)
    first = torch.linalg.cross(along, other)
    first = first / first.norm(dim=-1, keepdim=True)
    second = torch.linalg.cross(along, first)
    angles = torch.arange(_SIDES, device=points.device) * (2.0 * math.pi / _SIDES)
    ring = radius * (first[:, :, None] * angles.cos()[:, None] + second[:, :, None] * angles.sin()[:, None])
    return torch.cat((points[:, :-1, None] + ring, points[:, 1:, None] + ring), dim=2).flatten(1, 2)


Kind = Literal["rgb", "depth", "normals", "links", "albedo"]
"""A field of :class:`Image`."""

_CHANNELS: Mapping[Kind, frozenset[Channel]] = {
    "rgb": frozenset({Channel.RGB}),
    "depth": frozenset({Channel.DEPTH}),
    "normals": frozenset({Channel.NORMALS}),
    "links": frozenset({Channel.INSTANCE, Channel.SEMANTIC}),
    "albedo": frozenset({Channel.ALBEDO}),
}
PIXELS: Mapping[Kind, tuple[int, torch.dtype]] = {
    "rgb": (3, torch.uint8),
    "depth": (1, torch.float32),
    "normals": (3, torch.float32),
    "links": (1, torch.int32),
    "albedo": (3, torch.uint8),
}
"""Numbers in a pixel, and their type."""


@dataclass(frozen=True)
class Wanted:
    """Fields of an image that serve the channels of a call."""

    channels: frozenset[Channel]
    """Channels of the camera that are requested."""

    def __contains__(self, kind: Kind) -> bool:
        # Instance and semantic images are made of the same field.
        return not self.channels.isdisjoint(_CHANNELS[kind])

    @property
    def measured(self) -> bool:
        """True if any channel but colour is requested; markers and lights do not show in those."""
        return bool(self.channels - _CHANNELS["rgb"])


@dataclass(frozen=True)
class Request:
    """The arguments of :meth:`Renderer.render`."""

    camera: CameraSpec
    """Camera that is rendered."""
    camera_poses: Tensor
    """(n, 7)"""
    link_poses: Tensor
    """(n, L, 7)"""
    wanted: Wanted
    """Fields of the image that it needs."""
    marker_poses: Tensor | None
    """(n, M, 7)"""
    env_ids: Tensor | None
    """(n,) environment of each row; None: all, in order."""


class KitRenderer(Renderer):
    """Turns each call into a :class:`Request`, and refuses calls once it is closed."""

    _closed = False

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        if self._closed:
            raise ConfigurationError("the renderer is closed: make another")
        wanted = Wanted(frozenset(channels))
        return self.draw(Request(camera, camera_poses, link_poses, wanted, marker_poses, env_ids))

    def close(self) -> None:
        if not self._closed:
            # Set first, so that free is not called again where it raises.
            self._closed = True
            self.free()

    @abstractmethod
    def draw(self, request: Request) -> Image:
        """Return the pictures that are wanted; a field that is not wanted is None."""

    @abstractmethod
    def free(self) -> None:
        """Give back what the renderer holds; called once."""


@dataclass(frozen=True, eq=False)
class HostLights:
    """Lights of n rows, as of :class:`LightTable`."""

    ambient: npt.NDArray[np.float64]
    """(n, 3)"""
    directions: npt.NDArray[np.float64]
    """(n, K, 3) unit vectors."""
    radiance: npt.NDArray[np.float64]
    """(n, K, 3)"""

    @staticmethod
    def of_scene(scene: Scene, rows: int) -> HostLights:
        """Return the scene's own lights for each row."""
        lamps = scene.directional_lights
        directions = np.array([lamp.unit_direction for lamp in lamps], np.float64).reshape(-1, 3)
        radiance = np.array([lamp.radiance for lamp in lamps], np.float64).reshape(-1, 3)
        shape = (rows, len(lamps), 3)
        ambient = np.broadcast_to(np.asarray(scene.ambient, np.float64), (rows, 3))
        return HostLights(ambient, np.broadcast_to(directions, shape), np.broadcast_to(radiance, shape))


@dataclass(frozen=True)
class HostRequest:
    """A request with its poses in double precision on the host."""

    camera: CameraSpec
    """Camera that is rendered."""
    cameras: npt.NDArray[np.float64]
    """(n, 7)"""
    links: npt.NDArray[np.float64]
    """(n, L, 7)"""
    wanted: Wanted
    """Fields of the image that it needs."""
    markers: npt.NDArray[np.float64] | None
    """(n, M, 7)"""
    environments: npt.NDArray[np.int64]
    """(n,) which environment each row is of."""
    lights: HostLights | None = None
    """Lights of each row; None: the scene's."""
    colors: npt.NDArray[np.float32] | None = None
    """(n, L, 4) of links, as :attr:`Renderer.link_colors` has them; None: all have their own."""

    def canvas(self, kind: Kind) -> npt.NDArray[Any]:
        """Return pictures (n, H, W, numbers in a pixel) to be filled."""
        count, dtype = PIXELS[kind]
        # Through torch, whose types the contract states; NumPy shares the memory.
        shape = (len(self.cameras), self.camera.height, self.camera.width, count)
        return torch.empty(shape, dtype=dtype).numpy()


@dataclass(frozen=True)
class Pictures:
    """Fields of an :class:`Image` on the host; fields that are not wanted may be set too."""

    rgb: npt.NDArray[np.uint8] | None = None
    """(n, H, W, 3), lit."""
    depth: npt.NDArray[np.float32] | None = None
    """Metres along the optical axis; infinite beyond everything."""
    normals: npt.NDArray[np.floating] | None = None
    """Unit normals in world axes; zero beyond everything."""
    links: npt.NDArray[np.int32] | None = None
    """Link index, TERRAIN or BACKGROUND."""
    albedo: npt.NDArray[np.uint8] | None = None
    """(n, H, W, 3) colours of the shapes, unlit."""


class HostRenderer(KitRenderer):
    """Draws with NumPy on the host; waits for the device of the poses."""

    @abstractmethod
    def draw_pictures(self, request: HostRequest) -> Pictures:
        """Return all pictures that are wanted."""

    def draw(self, request: Request) -> Image:
        count, ids = len(request.link_poses), request.env_ids
        pictures = self.draw_pictures(
            HostRequest(
                request.camera,
                _on_host(request.camera_poses),
                _on_host(request.link_poses),
                request.wanted,
                None if request.marker_poses is None else _on_host(request.marker_poses),
                np.arange(count) if ids is None else ids.cpu().numpy(),
                self._lights_of(count, ids),
                self._colors_of(count, ids),
            )
        )
        # Pictures return to the device that the poses came from.
        device = request.link_poses.device
        return Image(**{kind: _tensor(getattr(pictures, kind), device) for kind in _CHANNELS if kind in request.wanted})

    def _lights_of(self, count: int, ids: Tensor | None) -> HostLights | None:
        if self.lights is None:
            return None
        rows = self.lights.rows(torch.arange(count, device=self.lights.ambient.device) if ids is None else ids)
        return HostLights(_on_host(rows.ambient), _on_host(rows.directions), _on_host(rows.radiance))

    def _colors_of(self, count: int, ids: Tensor | None) -> npt.NDArray[np.float32] | None:
        if self.link_colors is None:
            return None
        return (self.link_colors[:count] if ids is None else self.link_colors[ids]).cpu().numpy()


def painted(own: npt.NDArray[Any], links: npt.NDArray[Any], colors: npt.NDArray[np.float32]) -> npt.NDArray[Any]:
    """Return colours of shapes, replaced by those of their links where these have one.

    Args:
        own: (S, >= 3) colours of the shapes in [0, 1].
        links: (S,) link of each shape; none if negative.
        colors: (L, 4) colours of links; a link without one has zero in the fourth place.
    """
    # Negative indices would wrap around to the last link.
    chosen = colors[np.maximum(links, 0)]
    holds = (links >= 0) & (chosen[:, 3] > 0.0)
    result = own.copy()
    result[holds, :3] = chosen[holds, :3]
    return result


def repainted(
    albedo: npt.NDArray[np.uint8], links: npt.NDArray[np.int32], colors: npt.NDArray[np.float32] | None
) -> npt.NDArray[np.uint8]:
    """Return albedo with the colours of links where these have one.

    Args:
        albedo: (n, H, W, 3) of the shapes.
        links: (n, H, W) link that each pixel shows.
        colors: (n, L, 4) colours of links, as of :func:`painted`; None leaves the albedo as it is.
    """
    if colors is None:
        return albedo
    rows = np.arange(len(links))[:, None, None]
    chosen = colors[rows, np.maximum(links, 0)]
    holds = (links >= 0) & (chosen[..., 3] > 0.0)
    own = (255.0 * np.clip(chosen[..., :3], 0.0, 1.0) + 0.5).astype(np.uint8)
    return np.where(holds[..., None], own, albedo)


def _on_host(poses: Tensor) -> npt.NDArray[np.float64]:
    return poses.detach().cpu().numpy().astype(np.float64)


def _tensor(pictures: npt.NDArray[Any], device: torch.device) -> Tensor:
    # Renderers often hand out flipped views, which torch does not take.
    return torch.from_numpy(np.ascontiguousarray(pictures)).to(device)
