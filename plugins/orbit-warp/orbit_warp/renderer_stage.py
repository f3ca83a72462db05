"""The scene on the device, every shape of every environment placed and in one tree of bounds."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mujoco_warp._src.bvh import _compute_bvh_bounds, compute_bvh_group_roots
from mujoco_warp._src.math import mul_quat, quat_to_mat, rot_vec_quat
from torch import Tensor

from orbit_core.interfaces import LightTable
from orbit_warp.renderer_model import PictureModel


@wp.struct
class StageArrays:
    """Inputs of a ray cast. Colours have a row for each kind; environment i uses row i modulo their number."""

    geom_type: wp.array[int]
    """(geoms,) kind of geom."""
    geom_dataid: wp.array2d[int]
    """(1, geoms) number of the mesh or height field."""
    geom_size: wp.array2d[wp.vec3]
    """(1, geoms) m."""
    geom_matid: wp.array2d[int]
    """(1, geoms) material; -1 for none."""
    colors: wp.array2d[wp.vec4]
    """All that is seen; where markers are not drawn, as the next."""
    solid_colors: wp.array2d[wp.vec4]
    """With markers invisible."""
    shadow_colors: wp.array2d[wp.vec4]
    """The same, with all that casts no shadow invisible."""
    link_of_geom: wp.array[int]
    """(geoms,) number of the link, or TERRAIN."""
    xpos: wp.array2d[wp.vec3]
    """(N, geoms) m in the world."""
    xmat: wp.array2d[wp.mat33]
    """(N, geoms) rotation in the world."""
    bvh: wp.uint64
    """Warp's number of the bounding volumes."""
    roots: wp.array[int]
    """(N,) root of each environment's volumes."""
    geoms: int
    """Geoms in the volumes."""
    every_geom: wp.array[int]
    """(geoms,) numbers of those geoms."""
    mesh_ids: wp.array[wp.uint64]
    """Warp's number of each mesh."""
    hfield_ids: wp.array[wp.uint64]
    """Warp's number of each height field's mesh."""
    mesh_faceadr: wp.array[int]
    """First face of each mesh."""
    mesh_normaladr: wp.array[int]
    """First normal of each mesh."""
    mesh_facenormal: wp.array[wp.vec3i]
    """Normals of each face's corners."""
    mesh_normal: wp.array[wp.vec3]
    """Unit normals, in the mesh's frame."""
    # Lights have a row for each environment, or one for all.
    ambient: wp.array[wp.vec3]
    """(rows,) RGB of the ambient light."""
    sky_above: wp.vec3
    """Linear RGB straight above."""
    sky_below: wp.vec3
    """RGB straight below."""
    light_dir: wp.array2d[wp.vec3]
    """(rows, lights) unit vectors that light travels along."""
    light_color: wp.array2d[wp.vec3]
    """(rows, lights) RGB, times the intensity."""
    light_casts: wp.array[bool]
    """(lights,) True for lights with shadows."""
    texture_of_geom: wp.array[int]
    """(geoms,) index of the geom's texture; -1 for none."""
    texture_repeat: wp.array[wp.vec2]
    """(geoms,) pictures in a metre on geoms that lay their texture by metres; zero on those with coordinates."""
    texture_address: wp.array[int]
    """(textures,) first number of each in the texels, counted in bytes."""
    texture_size: wp.array[wp.vec2i]
    """(textures,) width and height in pixels."""
    texture_mean: wp.array[wp.vec3]
    """(textures,) RGB from far away."""
    texels: wp.array2d[wp.uint8]
    """(pixels, 3) RGB of all textures, the uppermost row of each first."""
    mesh_texcoordadr: wp.array[int]
    """(meshes,) first coordinate of each mesh; -1 without any."""
    mesh_texcoord: wp.array[wp.vec2]
    """Coordinates in pictures, from the upper left corner."""
    mesh_facetexcoord: wp.array[wp.vec3i]
    """Coordinates of each face's corners."""
    # MuJoCo-Warp's ray casts also take what is soft, of which there is none.
    no_ints: wp.array[int]
    """Empty."""
    no_floats: wp.array[float]
    """Empty."""
    no_ids: wp.array[wp.uint64]
    """Empty."""
    no_edges: wp.array[wp.vec2i]
    """Empty."""
    no_colors: wp.array[wp.vec4]
    """Empty."""
    no_points: wp.array2d[wp.vec3]
    """Empty."""
    no_table: wp.array2d[int]
    """Empty."""


@wp.func
def pose_of(poses: wp.array3d[float], env: int, row: int):
    position = wp.vec3(poses[env, row, 0], poses[env, row, 1], poses[env, row, 2])
    return position, wp.quat(poses[env, row, 3], poses[env, row, 4], poses[env, row, 5], poses[env, row, 6])


@wp.kernel(enable_backward=False)
def place_geoms(
    body_of_geom: wp.array[int],
    local_pos: wp.array[wp.vec3],
    local_quat: wp.array[wp.quat],
    links: int,
    link_poses: wp.array3d[float],
    marker_poses: wp.array3d[float],
    xpos: wp.array2d[wp.vec3],
    xmat: wp.array2d[wp.mat33],
):
    """Body 0 is the world; then come links, then markers, which stay where they are if there are no poses for them."""
    env, geom = wp.tid()
    body = body_of_geom[geom]
    if body > links and marker_poses.shape[0] == 0:
        return
    position, orientation = wp.vec3(0.0), wp.quat(1.0, 0.0, 0.0, 0.0)
    if body > links:
        position, orientation = pose_of(marker_poses, env, body - links - 1)
    elif body > 0:
        position, orientation = pose_of(link_poses, env, body - 1)
    xpos[env, geom] = position + rot_vec_quat(local_pos[geom], orientation)
    xmat[env, geom] = quat_to_mat(mul_quat(orientation, local_quat[geom]))


class Stage:
    """One device's copy of a picture model, posed in as many environments as were ever drawn at once."""

    def __init__(self, model: PictureModel) -> None:
        mjm = model.model
        self.device = wp.get_device()
        """Warp's device."""
        # It makes the trees of the meshes' triangles; the scene's own waits for the first poses, to be a good one.
        self._meshes = mjw.create_render_context(mjm, nworld=1, cam_active=[], use_textures=False)
        self._links, self._geoms = model.links, mjm.ngeom
        self._bodies = wp.array(mjm.geom_bodyid, dtype=int)
        self._local_pos, self._local_quat = (
            wp.array(mjm.geom_pos, dtype=wp.vec3),
            wp.array(mjm.geom_quat, dtype=wp.quat),
        )
        self._no_markers = wp.zeros((0, 0, 7), dtype=float)
        self.everyone = wp.zeros(0, dtype=wp.bool)
        """An empty array in the place of a mask: all environments."""
        self._capacity = 0
        self._bvh: wp.Bvh | None = None
        self.arrays = self._constant_arrays(model)
        """Inputs of the ray cast on that device."""
        links = np.where(model.is_marker, -1, model.link_of_geom)
        self._link_of_geom = torch.as_tensor(links, dtype=torch.int64, device=wp.device_to_torch(self.device))
        self._colors = self._kinds_of_colors(model)
        self.choose(None, with_markers=False)
        self.light(None, None)

    def place(self, link_poses: Tensor, marker_poses: Tensor | None) -> None:
        """Move everything to where it is in the n environments of poses (n, L, 7) and (n, M, 7)."""
        envs = len(link_poses)
        fresh = envs > self._capacity
        if fresh:
            self._make_room(envs)
        arrays = self.arrays
        markers = self._no_markers if marker_poses is None else wp.from_torch(marker_poses.contiguous())
        wp.launch(
            place_geoms,
            dim=(envs, self._geoms),
            inputs=[
                self._bodies, self._local_pos, self._local_quat, self._links,
                wp.from_torch(link_poses.contiguous()), markers,
            ],
            outputs=[arrays.xpos, arrays.xmat],
        )  # fmt: skip
        wp.launch(
            _compute_bvh_bounds,
            dim=(envs, self._geoms),
            inputs=[
                arrays.geom_type, arrays.geom_dataid, arrays.geom_size, arrays.xpos, arrays.xmat, self._geoms,
                arrays.every_geom, self._meshes.mesh_bounds_size, self._meshes.hfield_bounds_size,
                self._lower, self._upper, self._group,
            ],
        )  # fmt: skip
        if fresh:
            self._grow_tree()
        else:
            assert self._bvh is not None
            self._bvh.refit()

    def choose(self, env_ids: Tensor | None, with_markers: bool, link_colors: Tensor | None = None) -> None:
        """Let row i look as environment ``env_ids[i]``, or as environment i; with markers or without.

        Links have colours (N, L, 4) of their own, as :attr:`Renderer.link_colors` says.
        """
        own = self._colors if link_colors is None else self._painted(link_colors)
        tables = own if with_markers else own | {"colors": own["solid_colors"]}
        for name, colors in tables.items():
            if env_ids is not None and len(colors) > 1:
                colors = colors[env_ids.to(colors.device) % len(colors)]
            setattr(self.arrays, name, wp.from_torch(colors, dtype=wp.vec4))

    def light(self, env_ids: Tensor | None, lights: LightTable | None) -> None:
        """Light row i as environment ``env_ids[i]``, or as environment i; None takes the scene's own lights."""
        table = self._lights if lights is None else lights
        if env_ids is not None and lights is not None:
            table = lights.rows(env_ids)
        count = self._lights.directions.shape[1]
        # Held, so that a recorded launch finds them where they were.
        self._lit = (
            table.ambient.contiguous(),
            table.directions[:, :count].contiguous(),
            table.radiance[:, :count].contiguous(),
        )
        for name, rows in zip(("ambient", "light_dir", "light_color"), self._lit, strict=True):
            setattr(self.arrays, name, wp.from_torch(rows, dtype=wp.vec3))

    def _painted(self, link_colors: Tensor) -> dict[str, Tensor]:
        """The tables with a row for each environment."""
        device = self._link_of_geom.device
        chosen = link_colors.to(device)[:, self._link_of_geom.clamp_min(0)]
        holds = (self._link_of_geom >= 0)[:, None] & (chosen[..., 3:] > 0.0)
        kinds = torch.arange(len(chosen), device=device) % len(self._colors["colors"])
        painted: dict[str, Tensor] = {}
        for name, table in self._colors.items():
            rows = table[kinds]
            painted[name] = torch.cat((torch.where(holds, chosen[..., :3], rows[..., :3]), rows[..., 3:]), dim=-1)
        return painted

    def _make_room(self, envs: int) -> None:
        self._capacity = envs
        self.arrays.xpos = wp.zeros((envs, self._geoms), dtype=wp.vec3)
        self.arrays.xmat = wp.zeros((envs, self._geoms), dtype=wp.mat33)
        self._lower, self._upper = (wp.zeros(envs * self._geoms, dtype=wp.vec3) for _ in range(2))
        self._group = wp.zeros(envs * self._geoms, dtype=int)

    def _grow_tree(self) -> None:
        self._bvh = wp.Bvh(self._lower, self._upper, groups=self._group, constructor="sah")
        self.arrays.bvh = self._bvh.id
        self.arrays.roots = wp.zeros(self._capacity, dtype=int)
        wp.launch(compute_bvh_group_roots, dim=self._capacity, inputs=[self._bvh.id], outputs=[self.arrays.roots])

    def _kinds_of_colors(self, model: PictureModel) -> dict[str, Tensor]:
        solid, casting = model.colors.copy(), model.colors.copy()
        solid[:, model.is_marker, 3] = 0.0
        casting[model.is_marker | (model.colors[..., 3] < 1.0), 3] = 0.0
        tables = {"colors": model.colors, "solid_colors": solid, "shadow_colors": casting}
        device = wp.device_to_torch(self.device)
        return {name: torch.as_tensor(table, device=device) for name, table in tables.items()}

    def _constant_arrays(self, model: PictureModel) -> StageArrays:
        mjm, meshes, arrays = model.model, self._meshes, StageArrays()
        arrays.geom_type = wp.array(mjm.geom_type, dtype=int)
        arrays.geom_dataid = wp.array(mjm.geom_dataid[None], dtype=int)
        arrays.geom_size = wp.array(mjm.geom_size[None], dtype=wp.vec3)
        arrays.geom_matid = wp.full((1, self._geoms), -1, dtype=int)  # colours are the table's
        arrays.link_of_geom = wp.array(model.link_of_geom, dtype=int)
        arrays.geoms, arrays.every_geom = self._geoms, wp.array(np.arange(self._geoms), dtype=int)
        arrays.mesh_ids, arrays.hfield_ids = meshes.mesh_bvh_id, meshes.hfield_bvh_id
        arrays.mesh_faceadr = wp.array(mjm.mesh_faceadr, dtype=int)
        arrays.mesh_normaladr = wp.array(mjm.mesh_normaladr, dtype=int)
        arrays.mesh_facenormal = meshes.mesh_facenormal
        arrays.mesh_normal = wp.array(mjm.mesh_normal, dtype=wp.vec3)
        arrays.sky_above, arrays.sky_below = wp.vec3(*model.sky.above), wp.vec3(*model.sky.below)
        self._lights = model.lights(wp.device_to_torch(self.device))
        arrays.texture_of_geom = wp.array(model.texture_of_geom, dtype=int)
        arrays.texture_repeat = wp.array(model.texture_repeat, dtype=wp.vec2)
        arrays.texture_address = wp.array(mjm.tex_adr, dtype=int)
        arrays.texture_size = wp.array(np.stack((mjm.tex_width, mjm.tex_height), -1), dtype=wp.vec2i)
        arrays.texture_mean = wp.array(model.texture_mean, dtype=wp.vec3)
        arrays.texels = wp.array(mjm.tex_data.reshape(-1, 3), dtype=wp.uint8)
        arrays.mesh_texcoordadr = wp.array(mjm.mesh_texcoordadr, dtype=int)
        arrays.mesh_texcoord = wp.array(mjm.mesh_texcoord, dtype=wp.vec2)
        arrays.mesh_facetexcoord = wp.array(mjm.mesh_facetexcoord, dtype=wp.vec3i)
        arrays.light_casts = wp.array(mjm.light_castshadow, dtype=bool)
        return arrays
