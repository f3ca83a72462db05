"""What USD binds to geometry: physics materials for contact, colours for pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from orbit_assets.usd.library import pxr
from orbit_assets.usd.stage import Reading, applies, attribute, number
from orbit_core.scene import Color, Compliance, PhysicsMaterial, Plane, Shape


class Surfaces:
    """Materials of the geometry of one stage, looked up together."""

    def __init__(self, reading: Reading, gprims: list[Any]) -> None:
        self._reading = reading
        paths = [str(prim.GetPath()) for prim in gprims]
        bound = pxr().UsdShade.MaterialBindingAPI.ComputeBoundMaterials
        self._physics = dict(zip(paths, bound(gprims, "physics")[0], strict=True)) if gprims else {}
        self._drawn = dict(zip(paths, bound(gprims, "")[0], strict=True)) if gprims else {}

    def material(self, prim: Any) -> PhysicsMaterial:
        """The physics material bound to a prim; the default one where none is."""
        source = self.physics_prim(prim)
        if source is None or not source.HasAPI(pxr().UsdPhysics.MaterialAPI):
            return PhysicsMaterial()
        self._note_combination(source)
        units = self._reading.units
        read = PhysicsMaterial(
            static_friction=number(source, "physics:staticFriction"),
            dynamic_friction=number(source, "physics:dynamicFriction"),
            restitution=number(source, "physics:restitution"),
        )
        if "NewtonMaterialAPI" not in source.GetAppliedSchemas():
            return read
        stiffness = number(source, "newton:contactStiffness", -math.inf)
        damping = number(source, "newton:contactDamping", -math.inf)
        read = replace(
            read,
            torsional_friction=number(source, "newton:torsionalFriction") * units.length,
            rolling_friction=number(source, "newton:rollingFriction") * units.length,
            compliance=Compliance(stiffness * units.mass, max(damping, 0.0) * units.mass) if stiffness > 0 else None,
        )
        return self._as_mujoco(prim, read) if applies(prim, "MjcCollisionAPI") else read

    def _as_mujoco(self, prim: Any, material: PhysicsMaterial) -> PhysicsMaterial:
        """The material of a collider with MuJoCo's schema: ``condim`` says in which directions friction acts.

        What Newton's schema then has for stiffness is MuJoCo's ``solref``, which is in proportion to the mass that
        touches and no stiffness of the material.
        """
        if material.compliance is not None:
            self._reading.note("the softness of contacts (solref) of colliders with MuJoCo's schema is left out")
        dimensions = int(number(prim, "mjc:condim", 3.0))
        return PhysicsMaterial(
            static_friction=material.static_friction if dimensions >= 3 else 0.0,
            dynamic_friction=material.dynamic_friction if dimensions >= 3 else 0.0,
            restitution=material.restitution,
            torsional_friction=material.torsional_friction if dimensions >= 4 else 0.0,
            rolling_friction=material.rolling_friction if dimensions >= 6 else 0.0,
        )

    def physics_prim(self, prim: Any) -> Any:
        """The material prim that says how the prim's surface touches and what it is made of; ``None`` without one."""
        material = self._physics.get(str(prim.GetPath()))
        return material.GetPrim() if material else None

    def _note_combination(self, source: Any) -> None:
        for what in ("friction", "restitution"):
            mode = attribute(source, f"physxMaterial:{what}CombineMode")
            if mode not in (None, "max"):
                self._reading.note(
                    f"{source.GetPath()} combines {what} of two surfaces by '{mode}'; everywhere the larger counts"
                )

    def color(self, prim: Any) -> Color:
        """A prim's display colour, or else the diffuse colour of the preview surface bound to it, or else grey."""
        gprim = pxr().UsdGeom.Gprim(prim)
        if colors := gprim.GetDisplayColorPrimvar().Get():
            opacities = gprim.GetDisplayOpacityPrimvar().Get()
            if len(colors) > 1:
                self._reading.note(f"{prim.GetPath()} has {len(colors)} colours and is drawn in the first")
            return _color(colors[0], opacities[0] if opacities else 1.0)
        material = self._drawn.get(str(prim.GetPath()))
        surface = material.ComputeSurfaceSource()[0] if material else None
        return self._surface_color(prim, surface) if surface else Shape(Plane()).color

    def _surface_color(self, prim: Any, surface: Any) -> Color:
        for name in ("diffuseColor", "diffuse_color_constant"):
            found = surface.GetInput(name)
            if not found:
                continue
            if found.HasConnectedSource():
                self._reading.note(f"the texture of {prim.GetPath()} is left out, and its texture coordinates")
            if (value := found.Get()) is not None:
                opacity = surface.GetInput("opacity")
                alpha = opacity.Get() if opacity else None
                return _color(value, 1.0 if alpha is None else alpha)
        if surface.GetInput("diffuse_texture"):
            self._reading.note(f"the texture of {prim.GetPath()} is left out, and its texture coordinates")
        return Shape(Plane()).color


def _color(rgb: Any, alpha: float) -> Color:
    red, green, blue = (float(value) for value in rgb)
    return (red, green, blue, float(alpha))
