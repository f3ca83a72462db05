"""A scene's looks as a MuJoCo model: every link a body whose pose is set from outside."""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.meshes import marker_shapes
from orbit_core.plugin_kit.surfaces import textured_surface
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    Entity,
    Finish,
    Geometry,
    HeightField,
    Mesh,
    Plane,
    Scene,
    Shape,
    Sky,
    Sphere,
    Texture,
)

_HEIGHT_FIELD_BASE = 0.01
# Pixels along a side of the cube that shows the sky.
_SKY_SIZE = 256
_DARK = (0.0, 0.0, 0.0)
# Specular reflection of the smoothest surface, of all light that a mirror would reflect
_HIGHLIGHT = 0.6
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
    """Return the specification to compile and draw: :func:`drawn_shapes` in their order, then the markers' shapes.

    Body 0 carries the terrain; then come the links' bodies, then the markers', each with the next mocap index.
    """
    spec = mujoco.MjSpec()
    _set_lights(spec, layout.scene)
    looks = _Looks(spec)
    for shape in layout.scene.terrain:
        looks.add(spec.worldbody, shape)
    for link in layout.links:
        body = spec.worldbody.add_body(mocap=True)
        for shape in link.visuals or link.collisions:
            looks.add(body, shape)
    for marker in layout.scene.markers:
        body = spec.worldbody.add_body(mocap=True)
        for shape in marker_shapes(marker):
            looks.add(body, shape)
    return spec


def _set_lights(spec: mujoco.MjSpec, scene: Scene) -> None:
    """The scene's own lights alone; MuJoCo keeps ambient light in the headlight, which otherwise stays dark."""
    headlight = spec.visual.headlight
    headlight.ambient, headlight.diffuse, headlight.specular = scene.ambient, _DARK, _DARK
    for light in scene.directional_lights:
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            dir=light.unit_direction,
            castshadow=light.shadows,
            ambient=_DARK,
            diffuse=light.radiance,
            # Of the surfaces only those with a finish take any of it.
            specular=light.radiance,
        )
    faces = _sky_faces(scene.sky)
    texture = spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        width=faces.shape[2],
        height=faces.shape[0] * faces.shape[1],
        nchannel=faces.shape[3],
    )
    texture.data = faces.tobytes()


def _sky_faces(sky: Sky) -> npt.NDArray[np.uint8]:
    """(6, size, size, 3) of the cube round the scene: right, left, up, down, front, back; top rows first."""
    along = (np.arange(_SKY_SIZE) + 0.5) * (2.0 / _SKY_SIZE) - 1.0
    across, height = np.meshgrid(along, -along)
    length = np.sqrt(1.0 + across**2 + height**2)
    side, up = height / length, 1.0 / length
    sine = np.stack((side, side, up, -up, side, side))[..., None]
    above, below = np.asarray(sky.above), np.asarray(sky.below)
    return (255.0 * (below + 0.5 * (1.0 + sine) * (above - below)) + 0.5).astype(np.uint8)


class _Looks:
    """Adds shapes to bodies; a mesh or finish that several shapes share is stored once."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self._spec = spec
        self._meshes: dict[Mesh, str] = {}
        self._surfaces: dict[tuple[Geometry, Texture], str] = {}
        self._finishes: dict[tuple[Finish, bool], str] = {}
        self._height_fields = 0

    def add(self, body: mujoco.MjsBody, shape: Shape) -> None:
        """Draw ``shape`` as part of ``body``."""
        # Infinite and gridded ground is mapped by MuJoCo itself; any other shape becomes a mesh with coordinates.
        flat = isinstance(shape.geometry, Plane | HeightField)
        texture = None if flat else shape.finish.texture
        geom = body.add_geom(
            pos=shape.pose.position,
            quat=shape.pose.orientation,
            rgba=shape.color,
            material=self._finish(shape.finish, flat),
            contype=0,
            conaffinity=0,
            mass=0.0,
        )
        if texture is not None:
            geom.type, geom.meshname = _GEOM.mjGEOM_MESH, self._textured(shape, texture)
            return
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
                geom.type, geom.size = _GEOM.mjGEOM_PLANE, (0, 0, 1.0)
            case Mesh() as mesh:
                geom.type, geom.meshname = _GEOM.mjGEOM_MESH, self._mesh(mesh)
            case HeightField() as field:
                self._set_height_field(geom, shape, field)

    def _finish(self, finish: Finish, flat: bool) -> str:
        """Return the name of a material; ``flat`` surfaces lay their texture by metres."""
        key = (finish, flat)
        if key not in self._finishes:
            name = self._finishes[key] = f"finish{len(self._finishes)}"
            gloss = 1.0 - finish.roughness
            # MuJoCo takes a geom's own colour for unset, and the material's instead, if it equals the default grey.
            material = self._spec.add_material(
                name=name, rgba=(0.5, 0.5, 0.5, 1.0), specular=_HIGHLIGHT * gloss, shininess=gloss
            )
            if (texture := finish.texture) is not None:
                self._add_texture(name, texture)
                names = list(material.textures)
                names[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
                material.textures = names
                material.texuniform = flat
                # MuJoCo lays a plane's texture over two metres where texrepeat is one.
                material.texrepeat = (2.0 / texture.width, 2.0 / texture.height) if flat else (1.0, 1.0)
        return self._finishes[key]

    def _add_texture(self, name: str, texture: Texture) -> None:
        pixels = texture.pixels
        made = self._spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=pixels.shape[1],
            height=pixels.shape[0],
            nchannel=3,
        )
        made.data = np.ascontiguousarray(pixels).tobytes()

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

    def _textured(self, shape: Shape, texture: Texture) -> str:
        key = (shape.geometry, texture)
        if key not in self._surfaces:
            name = self._surfaces[key] = f"surface{len(self._surfaces)}"
            surface = textured_surface(shape, texture)
            faces = surface.faces.astype(np.int32).ravel()
            self._spec.add_mesh(
                name=name,
                uservert=surface.vertices.ravel(),
                usernormal=surface.normals.ravel(),
                usertexcoord=(surface.coordinates * (1.0, -1.0) + (0.0, 1.0)).ravel(),
                userface=faces,
                userfacenormal=faces,
                userfacetexcoord=faces,
                inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
        return self._surfaces[key]

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
