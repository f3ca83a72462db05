"""Contacts with height fields, in place of MuJoCo-Warp's own way to find them."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportGeneralTypeIssues=false
# Warp's structures are classes to it alone.

from __future__ import annotations

import copy

import mujoco_warp as mjw
import numpy as np
import numpy.typing as npt
import warp as wp
from mujoco_warp import GeomType
from mujoco_warp._src.collision_driver import MJ_COLLISION_TABLE
from mujoco_warp._src.math import upper_trid_index
from mujoco_warp._src.types import MJ_MAX_EPAFACES, MJ_MAX_EPAHORIZON, BroadphaseType, Callback

from orbit_warp.field_kernel import Contacts, Materials, Near, Pairs, Scene, meet_fields
from orbit_warp.field_search import Meshes, Polytopes, choose_contacts, search_triangles

_TABLE = [pair for pair in MJ_COLLISION_TABLE if GeomType.HFIELD in pair]
_NO_SENSOR = -1
# Triangles near shapes, for each contact that there is room for: most are near and do not touch.
_TRIANGLES = 8
# Threads that search at a time, for each needs 5 KiB of memory, and those of a block, few so that they spread.
_THREADS, _BLOCK = 32768, 64


class FieldContacts:
    """Takes the pairs of height fields out of a model, and is called back once all other contacts are found.

    Spheres' contacts are found in closed form; MuJoCo-Warp's general search looks at other shapes with those triangles
    that their boxes reach below.
    """

    def __init__(self, model: mjw.Model, data: mjw.Data) -> None:
        self._pairs_before, self._ids_before = model.nxn_geom_pair_filtered, model.nxn_pairid_filtered
        self._counts_before = model.geom_pair_type_count
        geoms, ids = self._pairs_before.numpy(), self._ids_before.numpy()
        taken = _of_fields(model)
        field_first = model.geom_type.numpy()[geoms[taken, 0]] == GeomType.HFIELD
        self._pairs = Pairs()
        self._pairs.geoms = wp.array(np.where(field_first[:, None], geoms[taken], geoms[taken, ::-1]), dtype=wp.vec2i)
        self._pairs.ids = wp.array(ids[taken], dtype=wp.vec2i)
        self._near = _near(int(taken.sum()) * data.nworld, _TRIANGLES * data.naconmax)
        self._threads = min(_THREADS, len(self._near.cells))
        self._polytopes = _polytopes(self._threads, model.opt.ccd_iterations)
        model.nxn_geom_pair_filtered = wp.array(geoms[~taken], dtype=wp.vec2i)
        model.nxn_pairid_filtered = wp.array(ids[~taken], dtype=wp.vec2i)
        if not _of_type(geoms[~taken], model, GeomType.HFIELD).any():
            searched = {upper_trid_index(len(GeomType), int(a), int(b)) for a, b in _TABLE}
            counts = enumerate(self._counts_before)
            model.geom_pair_type_count = tuple(0 if index in searched else count for index, count in counts)
        model.callback = Callback(contactfilter=self)

    @staticmethod
    def replace(model: mjw.Model, data: mjw.Data) -> None:
        """Find the contacts of a model's height fields here, if it has any."""
        if model.opt.broadphase == BroadphaseType.NXN and _of_fields(model).any():
            FieldContacts(model, data)

    def __call__(self, model: mjw.Model, data: mjw.Data) -> None:
        near, scene, materials, contacts = self._near, _scene(model, data), _materials(model), _contacts(data)
        near.count.zero_()
        near.triangle_count.zero_()
        dim = (self._pairs.geoms.shape[0], data.nworld)
        wp.launch(meet_fields, dim=dim, inputs=[scene, materials, self._pairs], outputs=[contacts, near, data.overflow])
        opt = model.opt
        wp.launch(
            search_triangles,
            dim=self._threads,
            inputs=[
                self._threads, opt.ccd_tolerance, opt.ccd_iterations, scene, materials, _meshes(model), self._polytopes,
            ],
            outputs=[near, data.overflow],
            block_dim=_BLOCK,
        )  # fmt: skip
        wp.launch(choose_contacts, dim=len(near.envs), inputs=[scene, materials], outputs=[contacts, near])

    def undone(self, model: mjw.Model) -> mjw.Model:
        """The model as MuJoCo-Warp steps it by itself."""
        plain = copy.copy(model)
        plain.nxn_geom_pair_filtered, plain.nxn_pairid_filtered = self._pairs_before, self._ids_before
        plain.geom_pair_type_count, plain.callback = self._counts_before, Callback()
        return plain


def plain_model(model: mjw.Model) -> mjw.Model:
    """Return the model as MuJoCo-Warp alone would step it, with its own contacts of height fields."""
    fields = model.callback.contactfilter
    return fields.undone(model) if isinstance(fields, FieldContacts) else model


def _of_fields(model: mjw.Model) -> npt.NDArray[np.bool_]:
    """Return a mask of the pairs of a height field with a shape that no contact sensor measures."""
    pairs, ids = model.nxn_geom_pair_filtered.numpy(), model.nxn_pairid_filtered.numpy()
    if not len(pairs):
        return np.zeros(0, dtype=bool)
    return _of_type(pairs, model, GeomType.HFIELD) & (ids[:, 1] == _NO_SENSOR)


def _of_type(pairs: npt.NDArray[np.int32], model: mjw.Model, kind: GeomType) -> npt.NDArray[np.bool_]:
    return (model.geom_type.numpy()[pairs] == kind).any(axis=1)


def _near(pairs: int, triangles: int) -> Near:
    near = Near()
    for name, kind in (("geoms", wp.vec2i), ("ids", wp.vec2i), ("envs", int), ("starts", int), ("ends", int)):
        setattr(near, name, wp.zeros(pairs, dtype=kind))
    for name, kind in (
        ("pairs", int), ("cells", int), ("distances", float), ("points", wp.vec3), ("normals", wp.vec3),
    ):  # fmt: skip
        setattr(near, name, wp.zeros(triangles, dtype=kind))
    near.count, near.triangle_count = wp.zeros(1, dtype=int), wp.zeros(1, dtype=int)
    return near


def _polytopes(threads: int, iterations: int) -> Polytopes:
    """Allocate polytopes of the same size as MuJoCo-Warp's."""
    vertices, faces = 10 + 2 * iterations, 6 + MJ_MAX_EPAFACES * iterations
    polytopes = Polytopes()
    polytopes.vertices = wp.empty((threads, vertices), dtype=wp.vec3)
    polytopes.indices = wp.empty((threads, vertices), dtype=int)
    polytopes.faces = wp.empty((threads, faces), dtype=int)
    polytopes.projections = wp.empty((threads, faces), dtype=wp.vec3)
    polytopes.squares = wp.empty((threads, faces), dtype=float)
    polytopes.horizon = wp.empty((threads, MJ_MAX_EPAHORIZON), dtype=int)
    return polytopes


def _meshes(model: mjw.Model) -> Meshes:
    meshes = Meshes()
    meshes.starts, meshes.counts, meshes.graph_starts = model.mesh_vertadr, model.mesh_vertnum, model.mesh_graphadr
    meshes.vertices, meshes.graph = model.mesh_vert, model.mesh_graph
    return meshes


def _scene(model: mjw.Model, data: mjw.Data) -> Scene:
    scene = Scene()
    scene.types, scene.data_ids, scene.sizes = model.geom_type, model.geom_dataid, model.geom_size
    scene.boxes, scene.positions, scene.rotations = model.geom_aabb, data.geom_xpos, data.geom_xmat
    scene.field_sizes, scene.field_rows = model.hfield_size, model.hfield_nrow
    scene.field_columns, scene.field_starts, scene.heights = model.hfield_ncol, model.hfield_adr, model.hfield_data
    return scene


def _materials(model: mjw.Model) -> Materials:
    materials = Materials()
    for name in _names(Materials):
        setattr(materials, name, getattr(model, name if name.startswith("pair_") else f"geom_{name}"))
    return materials


def _contacts(data: mjw.Data) -> Contacts:
    contacts = Contacts()
    for name in _names(Contacts):
        if name not in ("most", "count"):
            setattr(contacts, name, getattr(data.contact, name))
    contacts.most, contacts.count = data.naconmax, data.nacon
    return contacts


def _names(struct: wp.Struct) -> tuple[str, ...]:
    return tuple(struct.vars)
