"""Links out of USD bodies: mass, shapes, label."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from orbit_assets.usd.contents import MASSLESS, STAGE, Contents
from orbit_assets.usd.geometry import Placements, Shapes
from orbit_assets.usd.library import pxr
from orbit_assets.usd.mass import NOTHING, body_mass, is_given, solid
from orbit_assets.usd.stage import Reading, attribute
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.merge import MassProperties
from orbit_core.scene import Link, Shape


@dataclass(eq=False)
class Links:
    """Reads the links of one stage."""

    reading: Reading
    contents: Contents
    placements: Placements

    def __post_init__(self) -> None:
        self.shapes = Shapes(self.reading, self.placements, self.contents.geometry)

    def body(self, path: str, name: str) -> Link:
        """The link of a rigid body."""
        body = self.contents.bodies[path]
        parts = self.contents.parts.get(path, [])
        massless = bool(attribute(body, MASSLESS, False))
        collisions, visuals, solids = self._shapes(parts, body, weighed=not (massless or is_given(body)))
        properties = NOTHING if massless else body_mass(body, solids, self.placements, self.reading.units)
        return Link(
            name,
            properties.mass,
            properties.center_of_mass,
            properties.inertia,
            collisions,
            visuals,
            semantic_label(body),
        )

    def static(self, prim: Any, parts: list[Any], name: str) -> Link:
        """A link without mass, in the frame of ``prim``, of geometry that does not move."""
        collisions, visuals, _ = self._shapes(parts, prim, weighed=False)
        kind = "" if str(prim.GetPath()) == STAGE else semantic_label(prim)
        return Link(name, NOTHING.mass, NOTHING.center_of_mass, NOTHING.inertia, collisions, visuals, kind)

    def _shapes(
        self, parts: list[Any], body: Any, *, weighed: bool
    ) -> tuple[tuple[Shape, ...], tuple[Shape, ...], list[MassProperties]]:
        """What collides, what is drawn, and what each collider weighs."""
        collisions: list[Shape] = []
        visuals: list[Shape] = []
        solids: list[MassProperties] = []
        for prim in parts:
            if not prim.IsA(pxr().UsdGeom.Gprim):
                continue
            collides = prim.HasAPI(pxr().UsdPhysics.CollisionAPI) and attribute(prim, "physics:collisionEnabled", True)
            imageable = pxr().UsdGeom.Imageable(prim)
            drawn = imageable.ComputePurpose() != "guide" and imageable.ComputeVisibility() != "invisible"
            shape = self.shapes.read(prim, body, collides=collides) if collides or drawn else None
            if shape is None:
                self._lack_shape(prim, collides, drawn)
                continue
            visuals += [shape] if drawn else []
            if collides:
                collisions.append(shape)
                if weighed:
                    material = self.shapes.surfaces.physics_prim(prim)
                    solids.append(solid(prim, body, material, shape, self.reading.units))
        return tuple(collisions), tuple(visuals), solids

    def _lack_shape(self, prim: Any, collides: bool, drawn: bool) -> None:
        if collides:
            raise AssetError(f"{prim.GetPath()} is a collider of type {prim.GetTypeName()}: make it a mesh")
        if drawn:
            self.reading.note(f"{prim.GetPath()} is drawn as a {prim.GetTypeName()} and left out: make it a mesh")


def semantic_label(prim: Any) -> str:
    """The first that the prim bears of any taxonomy; none where it bears none."""
    for taxonomy in pxr().UsdSemantics.LabelsAPI.GetDirectTaxonomies(prim):
        if labels := pxr().UsdSemantics.LabelsAPI(prim, taxonomy).GetLabelsAttr().Get():
            return str(labels[0])
    return ""
