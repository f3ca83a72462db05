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
from mujoco_warp._src.collision_convex import convex_narrowphase
from mujoco_warp._src.collision_core import CollisionContext
from mujoco_warp._src.collision_driver import MJ_COLLISION_TABLE
from mujoco_warp._src.math import upper_trid_index
from mujoco_warp._src.types import BroadphaseType, Callback

from orbit_warp.field_kernel import Contacts, Materials, Pairs, Scene, meet_fields

_TABLE = [pair for pair in MJ_COLLISION_TABLE if GeomType.HFIELD in pair]
_NO_SENSOR = -1


class FieldContacts:
    """Takes the pairs of height fields out of a model, and is called back once all other contacts are found.

    Spheres' contacts are found in closed form; MuJoCo-Warp's general search looks at those other shapes alone whose
    boxes reach below a triangle of the field.
    """

    def __init__(self, model: mjw.Model, data: mjw.Data) -> None:
        self._pairs_before, self._ids_before = model.nxn_geom_pair_filtered, model.nxn_pairid_filtered
        self._counts_before = model.geom_pair_type_count
        geoms, ids = self._pairs_before.numpy(), self._ids_before.numpy()
        taken = _of_fields(model)
        field_first = model.geom_type.numpy()[geoms[taken, 0]] == GeomType.HFIELD
        self._pairs, self._near = Pairs(), Pairs()
        self._pairs.geoms = wp.array(np.where(field_first[:, None], geoms[taken], geoms[taken, ::-1]), dtype=wp.vec2i)
        self._pairs.ids = wp.array(ids[taken], dtype=wp.vec2i)
        most = min(int(taken.sum()) * data.nworld, data.naconmax)
        self._near.geoms, self._near.ids = wp.zeros(most, dtype=wp.vec2i), wp.zeros(most, dtype=wp.vec2i)
        self._near.envs, self._near.count = wp.zeros(most, dtype=int), wp.zeros(1, dtype=int)
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
        near = self._near
        near.count.zero_()
        wp.launch(
            meet_fields,
            dim=(self._pairs.geoms.shape[0], data.nworld),
            inputs=[_scene(model, data), _materials(model), self._pairs],
            outputs=[_contacts(data), near, data.overflow],
        )
        searched, found = copy.copy(model), copy.copy(data)
        searched.geom_pair_type_count = self._counts_before
        found.ncollision, found.naccdmax = near.count, min(data.naccdmax, near.geoms.shape[0])
        convex_narrowphase(searched, found, CollisionContext(near.geoms, near.ids, near.envs), _TABLE)

    def undone(self, model: mjw.Model) -> mjw.Model:
        """The model as MuJoCo-Warp steps it by itself."""
        plain = copy.copy(model)
        plain.nxn_geom_pair_filtered, plain.nxn_pairid_filtered = self._pairs_before, self._ids_before
        plain.geom_pair_type_count, plain.callback = self._counts_before, Callback()
        return plain


def plain_model(model: mjw.Model) -> mjw.Model:
    """The model as MuJoCo-Warp steps it by itself, whoever finds contacts with height fields in this one."""
    fields = model.callback.contactfilter
    return fields.undone(model) if isinstance(fields, FieldContacts) else model


def _of_fields(model: mjw.Model) -> npt.NDArray[np.bool_]:
    """Which pairs are of a height field with a shape, and not measured by a sensor of contacts."""
    pairs, ids = model.nxn_geom_pair_filtered.numpy(), model.nxn_pairid_filtered.numpy()
    if not len(pairs):
        return np.zeros(0, dtype=bool)
    return _of_type(pairs, model, GeomType.HFIELD) & (ids[:, 1] == _NO_SENSOR)


def _of_type(pairs: npt.NDArray[np.int32], model: mjw.Model, kind: GeomType) -> npt.NDArray[np.bool_]:
    return (model.geom_type.numpy()[pairs] == kind).any(axis=1)


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
