"""Drawn model: the scene's looks, then its markers, as the geoms of a MuJoCo model that is never stepped."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco
import numpy as np
import torch

from orbit_core.interfaces import LightTable, SceneLayout, drawn_shapes
from orbit_core.plugin_kit.meshes import marker_shapes
from orbit_mjmodel.visuals import all_variants, looks_spec


class PictureModel:
    """The compiled model, and the table of its geoms. Bodies: the terrain, the links, the markers."""

    def __init__(self, layout: SceneLayout) -> None:
        layout, shown = all_variants(layout)
        spec = looks_spec(layout)
        shapes = drawn_shapes(layout)
        self.links = len(layout.links)
        """Number L of links."""
        self.sky = layout.scene.sky
        """Background of the pictures."""
        colors = [shape.color for shape, _ in shapes]
        colors += [shape.color for marker in layout.scene.markers for shape in marker_shapes(marker)]
        if not colors:  # a tree of bounds cannot be empty
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=3 * [1e-3], mass=0.0)
            colors = [(0.0, 0.0, 0.0, 0.0)]
        self.model = spec.compile()
        """MuJoCo's model."""
        markers = len(colors) - len(shapes)
        self.colors = np.tile(np.array(colors, dtype=np.float32).reshape(-1, 4), (len(shown), 1, 1))
        """(kinds, geoms, 4) with opacity, which is zero for what a kind of environment does not have."""
        self.colors[:, : len(shapes), 3] *= shown
        self.is_marker = np.arange(self.colors.shape[1]) >= len(shapes)
        """(geoms,) True for markers."""
        self.link_of_geom = np.array([*(link for _, link in shapes), *[0] * markers], dtype=np.int32)
        """(geoms,) number of the link, or TERRAIN."""
        self.geom_types = tuple(sorted({int(kind) for kind in self.model.geom_type}))
        """Kinds of geoms in the model: others need no code in the ray cast."""
        self._scene = layout.scene
        tables = (
            self.model.tex_data[start:][: 3 * count]
            for start, count in zip(self.model.tex_adr, self.model.tex_width * self.model.tex_height, strict=True)
        )
        self.texture_mean = np.array([table.reshape(-1, 3).mean(0) / 255.0 for table in tables], np.float32)
        """(T, 3) colour of each texture from far away."""
        model = self.model
        material = model.geom_matid
        texture = model.mat_texid[:, mujoco.mjtTextureRole.mjTEXROLE_RGB] if model.nmat else np.zeros(0, np.int32)
        self.texture_of_geom = np.where(material >= 0, texture[np.maximum(material, 0)] if model.nmat else -1, -1)
        """(geoms,) index of the geom's texture; -1 for none."""
        self.textured = bool((self.texture_of_geom >= 0).any())
        """True if any shape has a texture."""
        # MuJoCo lays a texture over two metres where its repeat is one.
        uniform = model.mat_texuniform.astype(bool)[:, None] * model.mat_texrepeat * 0.5
        self.texture_repeat = np.zeros((model.ngeom, 2), np.float32)
        """(geoms, 2) pictures in a metre on geoms that lay their texture by metres; zero on those with coordinates."""
        if model.nmat:
            self.texture_repeat = uniform[np.maximum(material, 0)].astype(np.float32)

    def transparent(self, markers: bool) -> bool:
        """Return True if any shape can be seen through; ``markers`` counts theirs, too."""
        opacity = self.colors[..., 3] if markers else self.colors[:, ~self.is_marker, 3]
        return bool(((opacity > 0.0) & (opacity < 1.0)).any())

    def lights(self, device: torch.device) -> LightTable:
        """Return the scene's own lights, one row for all environments."""
        lamps = self._scene.directional_lights
        directions = torch.tensor([[lamp.unit_direction for lamp in lamps]], device=device).reshape(1, -1, 3)
        radiance = torch.tensor([[lamp.radiance for lamp in lamps]], device=device).reshape(1, -1, 3)
        ambient = torch.tensor([self._scene.ambient], dtype=torch.float32, device=device)
        return LightTable(ambient, directions, radiance)
