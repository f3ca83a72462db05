"""Rays that pass through the shapes of some links, in some environments: MuJoCo-Warp's cast with links to ignore."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp
from mujoco_warp._src.ray import _ray_geom_mesh
from mujoco_warp._src.types import MJ_MAXVAL, vec6f

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
