"""What is drawn: the scene's looks, then its markers, as the geoms of a MuJoCo model that is never stepped."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import math

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout, drawn_shapes
from orbit_core.plugin_kit.markers import AXIS_COLORS
from orbit_core.scene import Color, MarkerShape, MarkerSpec
from orbit_mjmodel.visuals import all_variants, looks_spec

_ARROW = ((0.0, 0.035), (0.75, 0.035), (0.75, 0.08), (1.0, 0.0))
"""Along an arrow of length 1: how far, and the radius there."""
_SIDES = 16
"""Of an arrow."""
_ALONG = {"x": (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0), "y": (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)}
"""Turns of z into another axis."""


class PictureModel:
    """The compiled model, and the table of its geoms. Bodies: the terrain, the links, the markers."""

    def __init__(self, layout: SceneLayout) -> None:
        layout, shown = all_variants(layout)
        spec = looks_spec(layout)
        shapes = drawn_shapes(layout)
        self.links = len(layout.links)
        self.sky = layout.scene.sky
        self._colors = [shape.color for shape, _ in shapes]
        for marker in layout.scene.markers:
            self._add_marker(spec, marker)
        if not self._colors:  # a tree of bounds cannot be empty
            self._add_geom(spec.worldbody, (0.0, 0.0, 0.0, 0.0), type=mujoco.mjtGeom.mjGEOM_SPHERE, size=3 * [1e-3])
        self.model = spec.compile()
        markers = len(self._colors) - len(shapes)
        self.colors = np.tile(np.array(self._colors, dtype=np.float32).reshape(-1, 4), (len(shown), 1, 1))
        """(kinds, geoms, 4) with opacity, which is zero for what a kind of environment does not have."""
        self.colors[:, : len(shapes), 3] *= shown
        self.is_marker = np.arange(self.colors.shape[1]) >= len(shapes)
        self.link_of_geom = np.array([*(link for _, link in shapes), *[0] * markers], dtype=np.int32)
        self.geom_types = tuple(sorted({int(kind) for kind in self.model.geom_type}))

    def _add_marker(self, spec: mujoco.MjSpec, marker: MarkerSpec) -> None:
        body = spec.worldbody.add_body(mocap=True)
        half = 3 * [marker.size / 2]
        match marker.shape:
            case MarkerShape.SPHERE:
                self._add_geom(body, marker.color, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=half)
            case MarkerShape.BOX:
                self._add_geom(body, marker.color, type=mujoco.mjtGeom.mjGEOM_BOX, size=half)
            case MarkerShape.ARROW:
                mesh = _arrow(spec, marker.size)
                self._add_geom(body, marker.color, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, quat=_ALONG["x"])
            case MarkerShape.FRAME:
                mesh = _arrow(spec, marker.size)
                turns = (_ALONG["x"], _ALONG["y"], (1.0, 0.0, 0.0, 0.0))
                for color, turn in zip(AXIS_COLORS, turns, strict=True):
                    whole = (*color, marker.color[3])
                    self._add_geom(body, whole, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, quat=turn)

    def _add_geom(self, body: mujoco.MjsBody, color: Color, **settings: object) -> None:
        body.add_geom(contype=0, conaffinity=0, mass=0.0, **settings)
        self._colors.append(color)


def _arrow(spec: mujoco.MjSpec, length: float) -> str:
    """A mesh along z, turned around it."""
    name = f"arrow{length!r}"
    if spec.mesh(name) is None:
        vertices, faces = _lathe(length * np.array(_ARROW))
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel(), inertia=shell)
    return name


def _lathe(profile: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """The surface (V, 3), (F, 3) that a profile (P, 2) of heights and radii makes around z, closed at its start."""
    profile = np.concatenate(([[profile[0, 0], 0.0]], profile))
    angles = np.arange(_SIDES) * (2 * math.pi / _SIDES)
    rings = [np.stack((r * np.cos(angles), r * np.sin(angles), np.full(_SIDES, z)), 1) for z, r in profile]
    side = np.arange(_SIDES)
    following = (side + 1) % _SIDES
    faces: list[npt.NDArray[np.int64]] = []
    for ring in range(len(profile) - 1):
        low, high = ring * _SIDES, (ring + 1) * _SIDES
        if profile[ring, 1] > 0:
            faces.append(np.stack((low + side, low + following, high + following), 1))
        if profile[ring + 1, 1] > 0:
            faces.append(np.stack((low + side, high + following, high + side), 1))
    # A ring without a radius is a point many times over; its faces with two equal corners were left out above.
    return np.concatenate(rings), np.concatenate(faces).astype(np.int32)
