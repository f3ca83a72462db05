"""Ray casts in a world of their own that holds one environment's shapes.

PhysX's rays stop at whatever they meet first, other environments' shapes included. This world is posed as each
environment is in turn, so that rays meet that environment alone and physics is not disturbed.
"""

# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import BACKGROUND, TERRAIN, SceneLayout
from orbit_sapien.geometry import collision_shape
from orbit_sapien.native import NativePose, physx, sapien


class RayWorld:
    """Immovable copies of every link with collision shapes, and of the terrain."""

    def __init__(self, layout: SceneLayout) -> None:
        self._system = physx.PhysxCpuSystem()
        self._scene = sapien.Scene([self._system])
        self._links: dict[object, int] = {}
        self._placed: list[tuple[int, sapien.Entity]] = []
        material = physx.PhysxMaterial(0.0, 0.0, 0.0)
        for shape in layout.scene.terrain:
            self._add(TERRAIN, [collision_shape(shape, material, f"terrain shape '{shape.name}'", None)])
        for number, link in enumerate(layout.links):
            made = [collision_shape(shape, material, f"link '{link.name}'", None) for shape in link.collisions]
            if made:
                self._placed.append((number, self._add(number, made)))

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
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.int64]]:
        """Distances (n, R), normals (n, R, 3) and links (n, R) of rays (n, R, 3) among links at poses (n, L, 7)."""
        count, rays = origins.shape[:2]
        distances = np.full((count, rays), np.inf, np.float32)
        normals = np.zeros((count, rays, 3), np.float32)
        links = np.full((count, rays), BACKGROUND, np.int64)
        raycast = self._system.raycast
        for row in range(count):
            for link, entity in self._placed:
                pose = link_poses[row, link]
                entity.set_pose(NativePose(pose[:3], pose[3:]))
            for ray in range(rays):
                hit = raycast(origins[row, ray], directions[row, ray], max_distance)
                if hit is not None:
                    distances[row, ray], normals[row, ray] = hit.distance, hit.normal
                    links[row, ray] = self._links[hit.component]
        return distances, normals, links
