"""The bodies of several environments in one Bullet world, side by side, filtered so that they never touch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.config import BulletConfig
from orbit_bullet.library import refusals
from orbit_bullet.urdf import MeshFiles, child_poses, write_entity
from orbit_core.interfaces import TERRAIN, AssetError, ConfigurationError, EntityLayout, SceneLayout
from orbit_core.plugin_kit.meshes import fans, few_faces
from orbit_core.plugin_kit.workers import split_evenly
from orbit_core.scene import (
    Box,
    Capsule,
    Cylinder,
    HeightField,
    LoopJoint,
    Mesh,
    MeshCollision,
    Plane,
    Pose,
    Shape,
    Sphere,
)

FloatArray = npt.NDArray[np.float64]
SPACING = 2048.0
"""Metres between environments, more than the ground of one reaches; a power of two keeps rounding small."""
GROUND, GROUND_DEPTH = 1000.0, 10.0
"""Half extents in metres of the box that stands for a plane: Bullet keeps one contact point a step on its own planes,
on which sliding boxes rattle, and finds all of them on a box."""
# Share of an overlap that a step removes between things that rebound.
_REBOUND_ERP = 0.001
# N/m, as good as rigid: Bullet takes the share from a spring and a damper.
_REBOUND_STIFFNESS = 1e9
# Bullet meets a height field cell by cell on shorter rays, and by chunks of 16 cells, some of which it misses, on
# longer ones.
_RAY_CELLS = 15
# Bytes of a folder's name: Bullet keeps names of files in 1,024.
_LONGEST_FOLDER = 960
_GEAR_FORCE = 1e9
# Share of a mimic joint's error that a step removes.
_GEAR_ERP = 0.2


@dataclass(frozen=True)
class SceneFiles:
    """Files that every world of a scene is loaded from."""

    folder: Path
    """Temporary folder that holds them."""
    entities: tuple[Path, ...]
    """URDF of each entity."""
    terrain: tuple[Path | None, ...]
    """The mesh of each terrain shape, if it is one."""


def write_scene(layout: SceneLayout, folder: Path) -> SceneFiles:
    """Write the files of a scene.

    Raises:
        ConfigurationError: the folder's name is longer than Bullet reads, or Bullet has no such shape.
    """
    if len(bytes(folder)) > _LONGEST_FOLDER:
        raise ConfigurationError(
            f"Bullet reads files from folders whose name has {_LONGEST_FOLDER} bytes or fewer, and this one's has "
            f"{len(bytes(folder))}: set TMPDIR to a shorter one than '{folder.parent}'"
        )
    meshes = MeshFiles(folder)
    paths = []
    for entity in layout.entities:
        paths.append(folder / f"entity{entity.index}.urdf")
        write_entity(entity.spec, paths[-1], meshes)
    terrain = []
    for shape in layout.scene.terrain:
        match shape.geometry:
            case Mesh(collision=MeshCollision.CONVEX_HULL) as mesh:
                terrain.append(meshes.hull(mesh))
            case Mesh() as mesh:
                terrain.append(meshes.surface(mesh))
            case HeightField() as field if (faces := few_faces(field)) is not None:
                terrain.append(meshes.surface(Mesh(*fans(faces), collision=MeshCollision.TRIANGLES)))
            case _:
                terrain.append(None)
    return SceneFiles(folder, tuple(paths), tuple(terrain))


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A ball joint that closes a loop in one environment."""

    slot: int
    """Environment of the client, 0 to K - 1."""
    constraint: int
    """Number of Bullet's constraint, whose force is that on the second link."""
    first: int
    """Link of the layout that has the point."""
    second: int
    """Link of the layout that is held to it."""
    point: npt.NDArray[np.float64]
    """Its place in the first link's frame."""


class Stage:
    """K environments: which body and which link is what."""

    def __init__(self, client: Any, layout: SceneLayout, files: SceneFiles, count: int) -> None:
        self.client = client
        """Connection to Bullet."""
        self.layout = layout
        """Numbers of the scene's links and joints."""
        self.files = files
        """Files that bodies are loaded from."""
        self.count = count
        """K, environments in this client."""
        self.origins = np.outer(SPACING * np.arange(count), (1.0, 0.0, 0.0))
        """(K, 3) m of the environments in Bullet's world, far apart so that they do not meet."""
        self.bodies: list[list[int]] = [[] for _ in range(count)]
        """Bullet's body number of each entity in each slot."""
        self.terrain: list[list[int]] = [[] for _ in range(count)]
        """Bodies of each environment's terrain."""
        self.links: list[list[int]] = [[] for _ in layout.entities]
        """Bullet's number of each link of each entity; -1 is the base."""
        self.joints: list[list[int]] = [[] for _ in layout.entities]
        """Bullet's number of each movable joint of each entity."""
        self.places: dict[tuple[int, int], tuple[int, int]] = {}
        """Slot and layout link (or TERRAIN) of each body and Bullet link."""
        self.loops: list[ClosedLoop] = []
        """Constraints that close loops."""
        self.root_inertials = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(layout.entities), 1))
        """For each entity the base's centre of mass and principal axes in the root link's frame (E, 7)."""
        self.ray_stretch = math.inf
        """Metres that one ray may be cast: over more cells of a height field, Bullet overlooks some."""
        self._colliding: list[list[int]] = [[] for _ in layout.entities]
        self.offsets = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(layout.links), 1))
        """The pose (L, 7) of each link in its principal axes; in its own frame where that is a fixed root."""
        self._terrain_shapes = [
            self._terrain_shape(shape, path) for shape, path in zip(layout.scene.terrain, files.terrain, strict=True)
        ]
        for slot in range(count):
            self._add_terrain(slot)
            for entity in layout.entities:
                self._add_entity(slot, entity)

    def free_bodies(self) -> list[int]:
        """The bodies, of all slots, that have one link and nothing that holds it."""
        free = [e.index for e in self.layout.entities if not e.spec.fixed_base and len(self.links[e.index]) == 1]
        return [bodies[number] for bodies in self.bodies for number in free]

    # Who may touch whom ----------------------------------------------------------------------------------------------

    def groups(self, slot: int, static: bool) -> tuple[int, int]:
        """Collision group and mask: two bits an environment, for what moves and what does not; bit 0 is for rays."""
        # Two bits, because what does not move must not be tested against its like.
        moving, still = 1 << (2 * slot + 1), 1 << (2 * slot + 2)
        return (still, moving | 1) if static else (moving, moving | still | 1)

    def ray_mask(self, slot: int) -> int:
        return 3 << (2 * slot + 1)

    def _filter(self, slot: int, entity: int) -> None:
        body = self.bodies[slot][entity]
        fixed = self.layout.entities[entity].spec.fixed_base
        for link in self.links[entity]:
            groups = self.groups(slot, fixed and link == self.links[entity][0])
            self.client.setCollisionFilterGroupMask(
                body, link, *(groups if link in self._colliding[entity] else (0, 0))
            )

    @property
    def colliding(self) -> list[list[int]]:
        """Bullet's numbers of the links of each entity that have collision shapes."""
        return self._colliding

    # Building --------------------------------------------------------------------------------------------------------

    def _add_terrain(self, slot: int) -> None:
        client = self.client
        for shape, (number, pose) in zip(self.layout.scene.terrain, self._terrain_shapes, strict=True):
            body = client.createMultiBody(
                0, number, -1, tuple(self.origins[slot] + pose.position), _xyzw(pose.orientation)
            )
            client.setCollisionFilterGroupMask(body, -1, *self.groups(slot, True))
            self.places[body, -1] = (slot, TERRAIN)
            self.terrain[slot].append(body)
            self._set_contact(body, -1, shape)

    def _terrain_shape(self, shape: Shape, path: Path | None) -> tuple[int, Pose]:
        client, pose = self.client, shape.pose
        match shape.geometry:
            case Plane():
                extents = (GROUND, GROUND, GROUND_DEPTH)
                # So that the box's upper face is where the plane is.
                ground = pose @ Pose((0.0, 0.0, -GROUND_DEPTH))
                return client.createCollisionShape(client.GEOM_BOX, halfExtents=extents), ground
            case Box(half_extents):
                return client.createCollisionShape(client.GEOM_BOX, halfExtents=half_extents), pose
            case Sphere(radius):
                return client.createCollisionShape(client.GEOM_SPHERE, radius=radius), pose
            case Capsule(radius, half):
                return client.createCollisionShape(client.GEOM_CAPSULE, radius=radius, height=2 * half), pose
            case Cylinder(radius, half):
                return client.createCollisionShape(client.GEOM_CYLINDER, radius=radius, height=2 * half), pose
            case HeightField() as field if path is None:
                return self._height_field(field, pose)
            case Mesh() | HeightField() as surface:
                flags = 0 if _is_hull(surface) else client.GEOM_FORCE_CONCAVE_TRIMESH
                return client.createCollisionShape(client.GEOM_MESH, fileName=str(path), flags=flags), pose
            case other:
                raise ConfigurationError(f"Bullet cannot collide a {type(other).__name__}")

    def _height_field(self, field: HeightField, pose: Pose) -> tuple[int, Pose]:
        """Bullet centres a height field between its lowest and its highest point.

        It splits squares along the falling diagonal: in a quarter turn, along the rising one as everybody else.
        """
        heights = np.asarray(field.heights, dtype=np.float64)[:, ::-1].T
        rows, columns = heights.shape
        scale = (field.size[1] / (columns - 1), field.size[0] / (rows - 1), 1.0)
        number = self.client.createCollisionShape(
            self.client.GEOM_HEIGHTFIELD,
            meshScale=scale,
            heightfieldData=heights.ravel().tolist(),
            numHeightfieldRows=columns,
            numHeightfieldColumns=rows,
        )
        self.ray_stretch = min(self.ray_stretch, _RAY_CELLS * scale[0], _RAY_CELLS * scale[1])
        middle = 0.5 * (float(heights.min()) + float(heights.max()))
        return number, pose @ Pose.from_euler(0.0, 0.0, 0.5 * math.pi, (0.0, 0.0, middle))

    def _add_entity(self, slot: int, entity: EntityLayout) -> None:
        client, spec, number = self.client, entity.spec, entity.index
        articulation = spec.articulation
        flags = client.URDF_USE_INERTIA_FROM_FILE | client.URDF_USE_IMPLICIT_CYLINDER
        # Boxes are clipped against triangles, whose edges they would catch on. Not hulls: Bullet would ignore their
        # margin, and they would sink 1 mm into a box, and 2 mm into a hull.
        if not any(_is_hull(shape.geometry) for link in articulation.links for shape in link.collisions):
            flags |= client.URDF_INITIALIZE_SAT_FEATURES
        if articulation.self_collisions:
            flags |= client.URDF_USE_SELF_COLLISION | client.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        with refusals(f"Bullet cannot load the model of '{entity.name}'", AssetError):
            body = client.loadURDF(
                str(self.files.entities[number]),
                tuple(self.origins[slot] + spec.pose.position),
                _xyzw(spec.pose.orientation),
                useFixedBase=spec.fixed_base,
                flags=flags,
            )
        self.bodies[slot].append(body)
        # Bodies of all environments come from the same file, and have the same numbers.
        if slot == 0:
            self._number_links(body, entity)
        self._set_up_links(slot, body, entity)
        self._set_up_joints(body, entity)
        for loop in articulation.loops:
            self._add_loop(slot, body, entity, loop)

    def _number_links(self, body: int, entity: EntityLayout) -> None:
        client, number = self.client, entity.index
        names = {client.getJointInfo(body, j)[12].decode(): j for j in range(client.getNumJoints(body))}
        articulation = entity.spec.articulation
        self.links[number] = [names.get(f"l{index}", -1) for index in range(len(articulation.links))]
        index_of = {name: index for index, name in enumerate(articulation.link_names)}
        self.joints[number] = [self.links[number][index_of[joint.child]] for joint in articulation.movable_joints]
        shaped = zip(self.links[number], articulation.links, strict=True)
        self._colliding[number] = [index for index, link in shaped if link.collisions]
        inertials = [self.inertial(body, link) for link in self.links[number]]
        self.root_inertials[number] = (*inertials[0].position, *inertials[0].orientation)
        for offset, (inertial, place) in enumerate(zip(inertials, child_poses(entity.spec), strict=True)):
            if offset or not entity.spec.fixed_base:
                frame = inertial.inverse() @ place
                self.offsets[entity.links.start + offset] = (*frame.position, *frame.orientation)

    def inertial(self, body: int, link: int) -> Pose:
        """Centre of mass and principal axes, in Bullet's frame of the link."""
        position, orientation = self.client.getDynamicsInfo(body, link)[3:5]
        return Pose(position, (orientation[3], *orientation[:3]))

    def _set_up_links(self, slot: int, body: int, entity: EntityLayout) -> None:
        client, number = self.client, entity.index
        undamped = {"linearDamping": 0, "angularDamping": 0, "jointDamping": 0, "maxJointVelocity": 1e6}
        for index in range(-1, client.getNumJoints(body)):
            client.changeDynamics(body, index, **undamped)
        for offset, (index, link) in enumerate(zip(self.links[number], entity.spec.articulation.links, strict=True)):
            self.places[body, index] = (slot, entity.links.start + offset)
            for shape in link.collisions:
                self._set_contact(body, index, shape)
        self._filter(slot, number)
        self._exclude_pairs(body, entity)

    def _exclude_pairs(self, body: int, entity: EntityLayout) -> None:
        articulation = entity.spec.articulation
        if not articulation.self_collisions:
            return
        index_of = dict(zip(articulation.link_names, self.links[entity.index], strict=True))
        for first, second in (*articulation.joined_links, *articulation.collision_exclusions):
            self.client.setCollisionFilterPair(body, body, index_of[first], index_of[second], 0)

    def _set_contact(self, body: int, link: int, shape: Shape) -> None:
        if isinstance(shape.geometry, Mesh) and not _is_hull(shape.geometry):
            # Triangles stay where they are; hulls are written smaller by the margin, and keep it.
            self.client.changeDynamics(body, link, collisionMargin=0.0)
        if shape.material.compliance:
            spring = shape.material.compliance
            self.client.changeDynamics(body, link, contactStiffness=spring.stiffness, contactDamping=spring.damping)
        elif shape.material.restitution:
            self._let_rebound(body, link)

    def _let_rebound(self, body: int, link: int) -> None:
        """Let a link rebound by its coefficient.

        Bullet subtracts the gap before the impact from a rebound, and adds the overlap that it removes: so it processes
        only shapes that do overlap, and removes hardly any of it.
        """
        damping = _REBOUND_STIFFNESS * self.layout.scene.physics_dt * (1.0 / _REBOUND_ERP - 1.0)
        self.client.changeDynamics(
            body, link, contactProcessingThreshold=0.0, contactStiffness=_REBOUND_STIFFNESS, contactDamping=damping
        )

    def _set_up_joints(self, body: int, entity: EntityLayout) -> None:
        client = self.client
        friction = self.layout.joint_parameters.friction
        for joint in range(client.getNumJoints(body)):
            client.setJointMotorControl2(body, joint, client.VELOCITY_CONTROL, force=0)
        names = entity.spec.articulation.joint_names
        for offset, joint in enumerate(entity.spec.articulation.movable_joints):
            number = self.joints[entity.index][offset]
            if force := float(friction[entity.joints.start + offset]):
                client.setJointMotorControl2(body, number, client.VELOCITY_CONTROL, targetVelocity=0, force=force)
            if joint.mimic:
                driver = self.joints[entity.index][names.index(joint.mimic.joint)]
                self._add_mimic(body, driver, number, joint.mimic.multiplier, joint.mimic.offset)

    def _add_loop(self, slot: int, body: int, entity: EntityLayout, loop: LoopJoint) -> None:
        """Bullet takes the points in the frames of the centres of mass and principal axes."""
        client, names = self.client, entity.spec.articulation.link_names
        links, points = [], []
        for name, point in ((loop.first, loop.first_point), (loop.second, loop.second_point)):
            offset = names.index(name)
            links.append(self.links[entity.index][offset])
            inertial = self.inertial(body, links[-1])
            points.append((inertial.inverse() @ child_poses(entity.spec)[offset] @ Pose(point)).position)
        ball = client.createConstraint(body, links[0], body, links[1], client.JOINT_POINT2POINT, [0] * 3, *points)
        client.changeConstraint(ball, maxForce=_GEAR_FORCE)
        first, second = (entity.links.start + names.index(name) for name in (loop.first, loop.second))
        self.loops.append(ClosedLoop(slot, ball, first, second, np.array(loop.first_point)))

    def _add_mimic(self, body: int, driver: int, follower: int, multiplier: float, offset: float) -> None:
        """A gear holds ``q_driver - q_follower / multiplier`` at ``- offset / multiplier``."""
        if multiplier == 0.0:
            raise ConfigurationError("Bullet has no gear of ratio zero: make a mimic joint of multiplier 0 a fixed one")
        client = self.client
        gear = client.createConstraint(body, driver, body, follower, client.JOINT_GEAR, [0, 0, 1], [0] * 3, [0] * 3)
        client.changeConstraint(
            gear,
            gearRatio=-1.0 / multiplier,
            maxForce=_GEAR_FORCE,
            erp=_GEAR_ERP,
            relativePositionTarget=-offset / multiplier,
        )


def _is_hull(geometry: object) -> bool:
    """Return True for a mesh that collides as convex hulls."""
    return isinstance(geometry, Mesh) and geometry.collision is not MeshCollision.TRIANGLES


def envs_per_client(layout: SceneLayout, config: BulletConfig) -> int:
    """The most environments of a scene in one Bullet world."""
    return 1 if layout.scene.deformables else config.envs_per_client


def client_ranges(count: int, most: int) -> list[tuple[int, int]]:
    """Environments in as few worlds as may be, of nearly equal size."""
    return split_evenly(count, max(1, math.ceil(count / most)))


def _xyzw(quaternion: Sequence[float]) -> tuple[float, float, float, float]:
    w, x, y, z = quaternion
    return x, y, z, w
