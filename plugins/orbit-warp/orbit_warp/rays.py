"""Rays against collision shapes, each environment's against its own."""

# pyright: reportArgumentType=false
# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import mujoco_warp as mjw
import torch
import warp as wp
from mujoco_warp._src.ray import _ray_geom_mesh
from mujoco_warp._src.types import MJ_MAXVAL, vec6f
from torch import Tensor

from orbit_core.interfaces import TERRAIN, RayHits, SceneLayout
from orbit_mjmodel.addresses import Addresses
from orbit_warp.native import Native
from orbit_warpkit.graphs import Graphs

_FAR = wp.constant(float(MJ_MAXVAL))


@wp.kernel(module="unique", enable_backward=False)
def rays_past(
    ngeom: int,
    nmeshface: int,
    body_weldid: wp.array[int],
    geom_type: wp.array[int],
    geom_bodyid: wp.array[int],
    geom_dataid: wp.array2d[int],
    geom_matid: wp.array2d[int],
    geom_group: wp.array[int],
    geom_size: wp.array2d[wp.vec3],
    geom_rgba: wp.array2d[wp.vec4],
    mesh_vertadr: wp.array[int],
    mesh_faceadr: wp.array[int],
    mesh_vert: wp.array[wp.vec3],
    mesh_face: wp.array[wp.vec3i],
    hfield_size: wp.array[wp.vec4],
    hfield_nrow: wp.array[int],
    hfield_ncol: wp.array[int],
    hfield_adr: wp.array[int],
    hfield_data: wp.array[float],
    mat_rgba: wp.array2d[wp.vec4],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    origins: wp.array2d[wp.vec3],
    directions: wp.array2d[wp.vec3],
    groups: vec6f,
    link_of_geom: wp.array[int],
    first_link: int,
    end_link: int,
    chosen: wp.array[wp.bool],
    distances: wp.array2d[float],
    geoms: wp.array2d[int],
    normals: wp.array2d[wp.vec3],
):
    """One block for each ray: its threads share the geoms, and the nearest hit wins. -1 is a miss.

    Geoms of links from ``first_link`` to before ``end_link`` are not there; environments that are not ``chosen`` keep
    what they had.
    """
    env, ray, thread = wp.tid()
    if not chosen[env]:
        return
    threads = wp.block_dim()
    origin, direction = origins[env, ray], directions[env, ray]
    nearest = wp.float32(_FAR)
    nearest_geom = wp.int32(-1)
    nearest_normal = wp.vec3()
    rounds = (ngeom + threads - 1) // threads
    for turn in range(rounds):
        geom = turn * threads + thread
        distance = wp.float32(_FAR)
        normal = wp.vec3()
        if geom < ngeom:
            link = link_of_geom[geom]
            if link < first_link or link >= end_link:
                distance, normal = _ray_geom_mesh(
                    nmeshface, body_weldid, geom_type, geom_bodyid, geom_dataid, geom_matid, geom_group, geom_size,
                    geom_rgba, mesh_vertadr, mesh_faceadr, mesh_vert, mesh_face, hfield_size, hfield_nrow, hfield_ncol,
                    hfield_adr, hfield_data, mat_rgba, geom_xpos, geom_xmat, env, origin, direction, groups, True, -1,
                    geom,
                )  # fmt: skip
                if distance < 0.0:
                    distance = _FAR
        tile = wp.tile(distance)
        best = wp.tile_argmin(tile)
        shortest = tile[best[0]]
        tile_geom = wp.tile(geom)
        tile_normal = wp.tile(normal, preserve_type=True)
        if shortest < nearest:
            nearest = shortest
            nearest_geom = tile_geom[best[0]]
            nearest_normal = tile_normal[best[0]]
    distances[env, ray] = wp.where(nearest >= _FAR, -1.0, nearest)
    geoms[env, ray] = nearest_geom
    normals[env, ray] = nearest_normal


@wp.kernel(module="unique", enable_backward=False)
def rays_at_few(
    nmeshface: int,
    body_weldid: wp.array[int],
    geom_type: wp.array[int],
    geom_bodyid: wp.array[int],
    geom_dataid: wp.array2d[int],
    geom_matid: wp.array2d[int],
    geom_group: wp.array[int],
    geom_size: wp.array2d[wp.vec3],
    geom_rgba: wp.array2d[wp.vec4],
    mesh_vertadr: wp.array[int],
    mesh_faceadr: wp.array[int],
    mesh_vert: wp.array[wp.vec3],
    mesh_face: wp.array[wp.vec3i],
    hfield_size: wp.array[wp.vec4],
    hfield_nrow: wp.array[int],
    hfield_ncol: wp.array[int],
    hfield_adr: wp.array[int],
    hfield_data: wp.array[float],
    mat_rgba: wp.array2d[wp.vec4],
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    origins: wp.array2d[wp.vec3],
    directions: wp.array2d[wp.vec3],
    groups: vec6f,
    candidates: wp.array[int],
    chosen: wp.array[wp.bool],
    distances: wp.array2d[float],
    geoms: wp.array2d[int],
    normals: wp.array2d[wp.vec3],
):
    """One thread for each ray, which goes through the few geoms that are there, such as one of terrain. -1 is a miss.

    Environments that are not ``chosen`` keep what they had.
    """
    env, ray = wp.tid()
    if not chosen[env]:
        return
    nearest = wp.float32(-1.0)
    nearest_geom = wp.int32(-1)
    nearest_normal = wp.vec3()
    for turn in range(candidates.shape[0]):
        distance, normal = _ray_geom_mesh(
            nmeshface, body_weldid, geom_type, geom_bodyid, geom_dataid, geom_matid, geom_group, geom_size, geom_rgba,
            mesh_vertadr, mesh_faceadr, mesh_vert, mesh_face, hfield_size, hfield_nrow, hfield_ncol, hfield_adr,
            hfield_data, mat_rgba, geom_xpos, geom_xmat, env, origins[env, ray], directions[env, ray], groups, True, -1,
            candidates[turn],
        )  # fmt: skip
        if distance >= 0.0 and (nearest < 0.0 or distance < nearest):
            nearest = distance
            nearest_geom = candidates[turn]
            nearest_normal = normal
    distances[env, ray] = nearest
    geoms[env, ray] = nearest_geom
    normals[env, ray] = nearest_normal


_EVERY_GROUP = (-1.0,) * 6
# Geoms up to which a ray goes through them in one thread; a block of threads shares out more. Terrain with its border
# is five, for which most threads of a block would wait.
_FEW = 16


class RayCaster:
    """Casts the same number of rays in every environment; buffers are kept per number."""

    def __init__(self, layout: SceneLayout, addresses: Addresses, native: Native, graphs: Graphs) -> None:
        self._model, self._data, self._graphs = native.model, native.data, graphs
        self._device = wp.device_to_torch(native.data.qpos.device)
        self._links: list[int] = addresses.link_of_geom.tolist()
        self._link_of_geom = torch.as_tensor(addresses.link_of_geom, device=self._device)
        self._warp_link_of_geom = wp.array(addresses.link_of_geom, dtype=int, device=native.data.qpos.device)
        self._buffers: dict[int, _Buffers] = {}
        # Geoms that are not of a range of links.
        self._others: dict[tuple[int, int], wp.array] = {}

    def cast(self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None) -> RayHits:
        buffers = self._buffers_of(origins, directions, env_ids)
        self._graphs.run(("rays", origins.shape[1]), lambda: self._launch(buffers))
        return self._hits(buffers, max_distance, slice(None) if env_ids is None else env_ids)

    def cast_past(
        self, origins: Tensor, directions: Tensor, max_distance: float, links: range, env_ids: Tensor | None
    ) -> RayHits:
        """Cast rays as :meth:`cast`, through the shapes of some links; with a mask (N,) bool rays are those of all."""
        masked = env_ids is not None and env_ids.dtype == torch.bool
        rows = slice(None) if env_ids is None or masked else env_ids
        buffers = self._buffers_of(origins, directions, None if masked else env_ids)
        if masked:
            buffers.chosen.copy_(env_ids)
        else:
            buffers.chosen[:] = env_ids is None
            buffers.chosen[rows] = True
        if (links.start, links.stop) not in self._others:
            self._others[links.start, links.stop] = self._geoms_past(links)
        key = ("rays past", origins.shape[1], links.start, links.stop)
        self._graphs.run(key, lambda: self._launch_past(buffers, links))
        return self._hits(buffers, max_distance, rows)

    def moving(self, links: range) -> bool:
        """True if there are shapes other than terrain, apart from some links."""
        return any(link != TERRAIN and link not in links for link in self._links[:-1])

    def _geoms_past(self, links: range) -> wp.array:
        others = [geom for geom, link in enumerate(self._links[:-1]) if link not in links]
        return wp.array(others, dtype=int, device=self._data.qpos.device)

    def _buffers_of(self, origins: Tensor, directions: Tensor, env_ids: Tensor | None) -> _Buffers:
        rays = origins.shape[1]
        if rays not in self._buffers:
            self._buffers[rays] = _Buffers(self._data.nworld, rays, self._device)
        buffers = self._buffers[rays]
        rows = slice(None) if env_ids is None else env_ids
        buffers.origins[rows] = origins
        buffers.directions[rows] = directions
        return buffers

    def _hits(self, buffers: _Buffers, max_distance: float, rows: slice | Tensor) -> RayHits:
        distances, normals = buffers.distances[rows], buffers.normals[rows]
        missed = (distances < 0) | (distances > max_distance)
        # The last entry of the table is for rays that meet nothing.
        links = self._link_of_geom[torch.where(missed, -1, buffers.geoms[rows].long())]
        return RayHits(torch.where(missed, torch.inf, distances), torch.where(missed[..., None], 0.0, normals), links)

    def _launch_past(self, buffers: _Buffers, links: range) -> None:
        m, d = self._model, self._data
        scene = [
            m.nmeshface, m.body_weldid, m.geom_type, m.geom_bodyid, m.geom_dataid, m.geom_matid, m.geom_group,
            m.geom_size, m.geom_rgba, m.mesh_vertadr, m.mesh_faceadr, m.mesh_vert, m.mesh_face, m.hfield_size,
            m.hfield_nrow, m.hfield_ncol, m.hfield_adr, m.hfield_data, m.mat_rgba, d.geom_xpos, d.geom_xmat,
            wp.from_torch(buffers.origins, dtype=wp.vec3), wp.from_torch(buffers.directions, dtype=wp.vec3),
            vec6f(*_EVERY_GROUP),
        ]  # fmt: skip
        hits = [
            wp.from_torch(buffers.distances), wp.from_torch(buffers.geoms),
            wp.from_torch(buffers.normals, dtype=wp.vec3),
        ]  # fmt: skip
        chosen, rays = wp.from_torch(buffers.chosen), buffers.distances.shape
        few = self._others[links.start, links.stop]
        if few.shape[0] <= _FEW:
            wp.launch(rays_at_few, dim=rays, inputs=[*scene, few, chosen], outputs=hits)
            return
        past = [self._warp_link_of_geom, links.start, links.stop, chosen]
        inputs = [m.ngeom, *scene, *past]
        wp.launch_tiled(rays_past, dim=rays, inputs=inputs, outputs=hits, block_dim=m.block_dim.ray)

    def _launch(self, buffers: _Buffers) -> None:
        mjw.rays(
            self._model,
            self._data,
            wp.from_torch(buffers.origins, dtype=wp.vec3),
            wp.from_torch(buffers.directions, dtype=wp.vec3),
            vec6f(*_EVERY_GROUP),
            True,
            wp.from_torch(buffers.excluded),
            wp.from_torch(buffers.distances),
            wp.from_torch(buffers.geoms),
            wp.from_torch(buffers.normals, dtype=wp.vec3),
        )


class _Buffers:
    def __init__(self, envs: int, rays: int, device: torch.device) -> None:
        self.origins = torch.zeros(envs, rays, 3, device=device)
        self.directions = torch.zeros(envs, rays, 3, device=device)
        self.directions[..., 2] = 1.0
        self.chosen = torch.zeros(envs, dtype=torch.bool, device=device)
        self.excluded = torch.full((rays,), -1, dtype=torch.int32, device=device)
        self.distances = torch.zeros(envs, rays, device=device)
        self.geoms = torch.zeros(envs, rays, dtype=torch.int32, device=device)
        self.normals = torch.zeros(envs, rays, 3, device=device)
