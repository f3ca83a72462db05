"""Ray casts in a separate world that holds one environment's shapes.

PhysX's rays stop at the first shape that they meet, other environments' shapes included. This world is posed as each
environment is in turn, so that rays meet that environment alone and physics is not disturbed. Rays on the side of a
cylinder, which PhysX has as a prism, are carried back to the cylinder around it: what is left of the prism is the
outline, which rays within 0.5 % of the radius miss.
"""

# pyright: reportAttributeAccessIssue=false

# SAPIEN's stubs give shapes to arrays that NumPy's types cannot express.
# pyright: reportReturnType=false

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import BACKGROUND, TERRAIN, SceneLayout
from orbit_core.scene import Cylinder, Shape
from orbit_sapien.geometry import collision_shape
from orbit_sapien.native import NativePose, native_pose, physx, sapien

# Cosine between a cylinder's axis and a normal below which the normal is the side's; that of an end is 1.
_SIDEWAYS = 0.5
_AWAY = NativePose((0.0, 0.0, -1e5))


class RayWorld:
    """Immovable copies of every link with collision shapes, and of the terrain."""

    def __init__(self, layout: SceneLayout) -> None:
        self._system = physx.PhysxCpuSystem()
        self._scene = sapien.Scene([self._system])
        self._material = physx.PhysxMaterial(0.0, 0.0, 0.0)
        self._links: dict[object, int] = {}
        self._cylinders: dict[object, Shape] = {}
        self._placed: list[tuple[int, sapien.Entity]] = []
        for shape in layout.scene.terrain:
            self._add(TERRAIN, [self._made(shape, f"terrain shape '{shape.name}'")])
        for number, link in enumerate(layout.links):
            made = [self._made(shape, f"link '{link.name}'") for shape in link.collisions]
            if made:
                self._placed.append((number, self._add(number, made)))

    def _made(self, shape: Shape, subject: str) -> physx.PhysxCollisionShape:
        made = collision_shape(shape, self._material, subject, None)
        if isinstance(shape.geometry, Cylinder):
            self._cylinders[made] = shape
        return made

    def _add(self, link: int, shapes: list[physx.PhysxCollisionShape]) -> sapien.Entity:
        body = physx.PhysxRigidStaticComponent()
        for shape in shapes:
            body.attach(shape)
        entity = sapien.Entity()
        entity.add_component(body)
        self._scene.add_entity(entity)
        self._links[body] = link
        return entity

    def cast(
        self,
        link_poses: npt.NDArray[np.float32],
        origins: npt.NDArray[np.float32],
        directions: npt.NDArray[np.float32],
        max_distance: float,
        past: range,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.int64]]:
        """Distances (n, R), normals (n, R, 3) and links (n, R) of rays (n, R, 3) among links at poses (n, L, 7).

        The links ``past`` are put away meanwhile: a ray that begins within a shape would not leave it.
        """
        count, rays = origins.shape[:2]
        distances = np.full((count, rays), np.inf, np.float32)
        normals = np.zeros((count, rays, 3), np.float32)
        links = np.full((count, rays), BACKGROUND, np.int64)
        raycast = self._system.raycast
        for row in range(count):
            for link, entity in self._placed:
                pose = link_poses[row, link]
                entity.set_pose(_AWAY if link in past else NativePose(pose[:3], pose[3:]))
            for ray in range(rays):
                hit = raycast(origins[row, ray], directions[row, ray], max_distance)
                if hit is not None:
                    distances[row, ray], normals[row, ray] = self._refined(hit, origins[row, ray], directions[row, ray])
                    links[row, ray] = self._links[hit.component]
        return distances, normals, links

    def _refined(
        self, hit: physx.PhysxRayHit, origin: npt.NDArray[np.float32], direction: npt.NDArray[np.float32]
    ) -> tuple[float, npt.NDArray[np.float32]]:
        """Distance and normal, where the ray comes from outside to a cylinder's side those of the cylinder."""
        shape = self._cylinders.get(hit.shape)
        if shape is None:
            return hit.distance, hit.normal
        pose = hit.component.entity.pose * native_pose(shape.pose)
        turn = pose.to_transformation_matrix()[:3, :3].astype(np.float64)
        begin, along = (origin - pose.p) @ turn, direction @ turn
        across = begin[:2] @ along[:2], along[:2] @ along[:2]
        beyond = begin[:2] @ begin[:2] - shape.geometry.radius**2
        if abs(hit.normal @ turn[:, 2]) > _SIDEWAYS or beyond <= 0.0:
            return hit.distance, hit.normal
        distance = -(across[0] + np.sqrt(across[0] ** 2 - across[1] * beyond)) / across[1]
        out = begin[:2] + distance * along[:2]
        return distance, turn[:, :2] @ out / shape.geometry.radius
