"""A scene's looks as a MuJoCo model: every link a body whose pose is set from outside."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Box, Capsule, Cylinder, Entity, HeightField, Mesh, Plane, Shape, Sphere

SUN = np.array([-0.35, 0.45, -1.0]) / np.linalg.norm([-0.35, 0.45, -1.0])
"""Direction of the light that casts shadows."""

CHECKER_SIZE = 1.0
"""Metres of a plane's squares."""
CHECKER_CONTRAST = 0.07
"""Of the way to white that every other square is lighter."""
SKY_HIGH, SKY_LOW = (0.55, 0.68, 0.82), (0.88, 0.91, 0.94)
"""Colours straight above and below."""

_HEIGHT_FIELD_BASE = 0.01
_GEOM = mujoco.mjtGeom


def all_variants(layout: SceneLayout) -> tuple[SceneLayout, npt.NDArray[np.bool_]]:
    """The scene with each object looking like all its alternatives at once, and which shapes are whose.

    Returns:
        The layout to draw, and (kinds, shapes) whether each kind of environment has each of its drawn shapes.
    """
    kinds = np.arange(len(layout.variants))
    objects = []
    for thing in layout.scene.objects:
        root = replace(thing.articulation.root, visuals=tuple(shape for seen in _seen(thing) for shape in seen))
        whole = replace(thing.articulation, links=(root, *thing.articulation.links[1:]))
        objects.append(thing if len(thing.alternatives) == 1 else replace(thing, articulation=whole, variants=()))
    columns = [kinds >= 0 for _ in layout.scene.terrain]
    for entity in layout.entities:
        if len(entity.spec.alternatives) == 1:
            links = entity.spec.articulation.links
            columns += [kinds >= 0 for link in links for _ in link.visuals or link.collisions]
        else:
            choices = _seen(entity.spec)
            columns += [kinds % len(choices) == number for number, seen in enumerate(choices) for _ in seen]
    shown = np.array(columns, dtype=bool).reshape(-1, len(kinds)).T
    return SceneLayout.of(replace(layout.scene, objects=tuple(objects))), shown


def _seen(entity: Entity) -> list[tuple[Shape, ...]]:
    """The shapes of each alternative's root that are drawn."""
    return [alternative.root.visuals or alternative.root.collisions for alternative in entity.alternatives]


def looks_spec(layout: SceneLayout) -> mujoco.MjSpec:
    """What to compile and draw. Body ``i + 1`` is link ``i`` and has mocap index ``i``; body 0 carries the terrain."""
    spec = mujoco.MjSpec()
    _set_lights(spec)
    looks = _Looks(spec)
    for shape in layout.scene.terrain:
        looks.add(spec.worldbody, shape)
    for link in layout.links:
        body = spec.worldbody.add_body(mocap=True)
        for shape in link.visuals or link.collisions:
            looks.add(body, shape)
    return spec


def _set_lights(spec: mujoco.MjSpec) -> None:
    headlight = spec.visual.headlight
    headlight.ambient, headlight.diffuse = (0.38, 0.38, 0.40), (0.20, 0.20, 0.20)
    headlight.specular = (0.05, 0.05, 0.05)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=SKY_HIGH,
        rgb2=SKY_LOW,
        width=256,
        height=1536,
    )
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.worldbody.add_light(
        type=directional, dir=SUN, castshadow=True, diffuse=(0.52, 0.50, 0.47), specular=(0.25, 0.25, 0.25)
    )
    spec.worldbody.add_light(
        type=directional, dir=(0.6, -0.5, -0.4), castshadow=False, diffuse=(0.12, 0.14, 0.17), specular=(0, 0, 0)
    )


class _Looks:
    """Adds shapes to bodies; a mesh that several shapes share is stored once."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self._meshes: dict[Mesh, str] = {}
        self._grounds: dict[tuple[float, ...], str] = {}
        self._height_fields = 0
        # MuJoCo takes a geom's own colour for unset, and the material's instead, if it equals the default grey.
        spec.add_material(name="surface", rgba=(0.5, 0.5, 0.5, 1.0), specular=0.35, shininess=0.45)

    def add(self, body: mujoco.MjsBody, shape: Shape) -> None:
        """Draw ``shape`` as part of ``body``."""
        geom = body.add_geom(
            pos=shape.pose.position,
            quat=shape.pose.orientation,
            rgba=shape.color,
            material="surface",
            contype=0,
            conaffinity=0,
            mass=0.0,
        )
        match shape.geometry:
            case Box(half_extents):
                geom.type, geom.size = _GEOM.mjGEOM_BOX, half_extents
            case Sphere(radius):
                geom.type, geom.size = _GEOM.mjGEOM_SPHERE, (radius, 0, 0)
            case Capsule(radius, half_length):
                geom.type, geom.size = _GEOM.mjGEOM_CAPSULE, (radius, half_length, 0)
            case Cylinder(radius, half_length):
                geom.type, geom.size = _GEOM.mjGEOM_CYLINDER, (radius, half_length, 0)
            case Plane():
                geom.type, geom.size = _GEOM.mjGEOM_PLANE, (0, 0, CHECKER_SIZE)
                geom.material, geom.rgba = self._ground(shape.color), (1, 1, 1, shape.color[3])
            case Mesh() as mesh:
                geom.type, geom.meshname = _GEOM.mjGEOM_MESH, self._mesh(mesh)
            case HeightField() as field:
                self._set_height_field(geom, shape, field)

    def _mesh(self, mesh: Mesh) -> str:
        if mesh not in self._meshes:
            name = self._meshes[mesh] = f"mesh{len(self._meshes)}"
            self._spec.add_mesh(
                name=name,
                uservert=np.asarray(mesh.vertices, dtype=np.float64).ravel(),
                userface=np.asarray(mesh.faces, dtype=np.int32).ravel(),
                # Needs no closed surface, which visual meshes often lack.
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
        return self._meshes[mesh]

    def _ground(self, color: tuple[float, float, float, float]) -> str:
        if color not in self._grounds:
            name = self._grounds[color] = f"ground{len(self._grounds)}"
            base = np.asarray(color[:3])
            self._spec.add_texture(
                name=name,
                type=mujoco.mjtTexture.mjTEXTURE_2D,
                builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
                rgb1=base,
                rgb2=base + CHECKER_CONTRAST * (1.0 - base),
                width=256,
                height=256,
            )
            material = self._spec.add_material(
                name=name, texuniform=True, texrepeat=(1 / CHECKER_SIZE, 1 / CHECKER_SIZE), specular=0.1
            )
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        return self._grounds[color]

    def _set_height_field(self, geom: mujoco.MjsGeom, shape: Shape, field: HeightField) -> None:
        heights = np.asarray(field.heights, dtype=np.float64)
        lowest, span = heights.min(), max(float(np.ptp(heights)), 1e-6)
        name = f"height_field{self._height_fields}"
        self._height_fields += 1
        self._spec.add_hfield(
            name=name,
            nrow=heights.shape[0],
            ncol=heights.shape[1],
            size=(field.size[0] / 2, field.size[1] / 2, span, _HEIGHT_FIELD_BASE),
            userdata=((heights - lowest) / span).ravel(),
        )
        geom.type, geom.hfieldname = _GEOM.mjGEOM_HFIELD, name
        geom.pos = shape.pose.transform((0.0, 0.0, lowest))
