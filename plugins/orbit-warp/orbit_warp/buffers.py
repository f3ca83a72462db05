"""Sizes of the buffers of contacts and constraints, from what of the scene can touch."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import mujoco_warp as mjw
import numpy as np
import numpy.typing as npt

from orbit_warp.config import WarpConfig

_LEAST_CONTACTS = 16
# Contacts of a single free body: one face full of contacts, and two fingers that hold it.
_CONTACTS_OF_BODY = 12
# Shapes of a single free body beyond which each has as many contacts, as those of a nut's thread of boxes have.
_MANY_PARTS, _CONTACTS_OF_PART = 8, 12
# Contacts of a shape of an articulation: few of them touch at a time, but each may be near something.
_CONTACTS_OF_GEOM = 1
# Shapes of two fingers that touch at a time what they hold: a nut as it is screwed down needed more than one.
_HOLDING = 4
# Meshes that do not move beyond which they are taken for the triangles of a surface, which lie close together.
_SURFACE = 64
# Contacts in any one environment over what is likely on average: an arm that moves at random against a cabinet, and one
# that learns to lift and presses on the table, needed more rows than the likely contacts have.
_CROWDED = 2


@dataclass(frozen=True)
class BufferSizes:
    """Contacts per environment (on average) and constraint rows in any one environment."""

    nconmax: int
    """Contacts per environment, on average."""
    njmax: int
    """Constraint rows of any one environment."""


def buffer_sizes(model: mujoco.MjModel, device_model: mjw.Model, config: WarpConfig) -> BufferSizes:
    """Return the sizes of the settings, or estimates for the scene, limited to what it can need."""
    pairs = device_model.nxn_geom_pair_filtered.numpy()
    possible = int(_contacts_of_pairs(model, pairs).sum()) if len(pairs) else 0
    touching = np.unique(pairs) if len(pairs) else np.zeros(0, dtype=int)
    moving = touching[model.body_mocapid[model.geom_bodyid[touching]] < 0]
    moving = moving[model.geom_bodyid[moving] > 0]
    tree_sizes = np.bincount(model.body_rootid, minlength=model.nbody)
    alone = tree_sizes[model.body_rootid[model.geom_bodyid[moving]]] == 1
    _, parts = np.unique(model.geom_bodyid[moving[alone]], return_counts=True)
    of_bodies = int(np.where(parts > _MANY_PARTS, _CONTACTS_OF_PART * parts, _CONTACTS_OF_BODY).sum())
    likely = max(of_bodies + _CONTACTS_OF_GEOM * int((~alone).sum()), _LEAST_CONTACTS)
    meshes = (model.geom_type[touching] == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_bodyid[touching] == 0)
    if np.count_nonzero(meshes) > _SURFACE:
        likely *= 4  # a surface offers each of its triangles under a shape
    elif model.nhfield:
        likely *= 2  # a height field's are found for all of a shape, at most four where it is no sphere
    fields = model.geom_type[pairs] == mujoco.mjtGeom.mjGEOM_SDF
    if fields.any():  # each descent of a pair may end in a contact
        likely += model.opt.sdf_initpoints * (_HOLDING + int(fields.all(axis=1).sum()))
    # What the scene can need at all bounds the estimate, so that a small scene takes little memory.
    nconmax = config.nconmax or max(min(possible, likely), 1)
    condim = int(model.geom_condim[touching].max(initial=1))
    rows = condim if config.cone == "elliptic" else max(2 * (condim - 1), 1)
    always = int(np.count_nonzero(model.dof_frictionloss)) + int(np.count_nonzero(model.jnt_limited))
    always += _equality_rows(model)
    return BufferSizes(nconmax, config.njmax or max(always + rows * _CROWDED * nconmax, 1))


def _equality_rows(model: mujoco.MjModel) -> int:
    """Equality rows: one for each mimic joint, three for each ball joint that closes a loop, six for each weld."""
    rows = np.where(model.eq_type == mujoco.mjtEq.mjEQ_CONNECT, 3, 1)
    return int(np.where(model.eq_type == mujoco.mjtEq.mjEQ_WELD, 6, rows).sum())


def _contacts_of_pairs(model: mujoco.MjModel, pairs: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """The most contacts of each pair of shapes (P, 2), by their types."""
    kind = mujoco.mjtGeom
    types = model.geom_type[pairs]

    def has(geom: mujoco.mjtGeom) -> npt.NDArray[np.bool_]:
        return (types == geom).any(axis=1)

    most = np.full(len(pairs), 8)
    most[has(kind.mjGEOM_PLANE)] = 4
    most[has(kind.mjGEOM_CAPSULE)] = 2
    most[has(kind.mjGEOM_SPHERE)] = 1
    most[has(kind.mjGEOM_HFIELD)] = 50
    most[has(kind.mjGEOM_SDF)] = model.opt.sdf_initpoints
    return most
