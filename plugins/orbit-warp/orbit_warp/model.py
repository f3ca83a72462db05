"""A scene as the model that MuJoCo-Warp steps: of one environment, or of one of each kind where they differ."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace
from typing import cast

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from orbit_core.interfaces import Approximation, AssetError, BuiltModel, SceneLayout
from orbit_mjmodel import model
from orbit_mjmodel.addresses import Addresses
from orbit_mjmodel.readback import ALIKE, VARYING, Fields, read_back
from orbit_warp.config import WarpConfig

LEAST_FRICTION = 1e-5
"""Least value of any coefficient of friction: friction cones of no width are degenerate in single precision."""
# Bits of the kinds of geometry that collide where meshes and fields must not meet.
_OTHERS, _MESHES, _FIELDS = 1, 2, 4
# Degrees of freedom: a tower of 48 blocks next to an arm has 297, which conjugate gradients do not hold; 216 balls in a
# bin take 0.007 s a step on a CPU with ``cg``, and more than a second with ``newton``.
_MOST_FOR_NEWTON = 300


def build_models(layout: SceneLayout, config: WarpConfig) -> tuple[model.BuiltModel, ...]:
    """Compile one environment of each of the layout's variants.

    Raises:
        AssetError: MuJoCo refuses the description; says why.
    """
    # Two boxes meet by MuJoCo's own analytic test: the general one misses boxes that overlap symmetrically.
    no_general_box_test = int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    built = model.build_models(
        layout, config, solver=_solver(layout, config), disabled=no_general_box_test, least_friction=LEAST_FRICTION
    )
    return tuple(_part_meshes_from_fields(one) for one in built)


def _part_meshes_from_fields(built: model.BuiltModel) -> model.BuiltModel:
    """Let convex meshes and fields of distances of different bodies pass through each other, and say so.

    MuJoCo-Warp 3.17 takes a point in the mesh's own frame for one in the world's as it looks how deep it is in the
    mesh, and so finds contacts all over a field that a mesh's bounding box reaches into.
    """
    geoms = built.model
    collide = geoms.geom_contype > 0
    fields = collide & (geoms.geom_type == mujoco.mjtGeom.mjGEOM_SDF)
    meshes = collide & (geoms.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    if not (geoms.geom_bodyid[fields][:, None] != geoms.geom_bodyid[meshes]).any():
        return built
    geoms.geom_conaffinity[collide] = _OTHERS | _MESHES | _FIELDS
    geoms.geom_contype[meshes], geoms.geom_conaffinity[meshes] = _MESHES, _OTHERS | _MESHES
    geoms.geom_contype[fields], geoms.geom_conaffinity[fields] = _FIELDS, _OTHERS | _FIELDS
    why = "MuJoCo-Warp finds contacts between the two where nothing touches"
    line = Approximation("contacts", "of convex meshes with fields of distances", "none between these two", why)
    return dataclasses.replace(built, report=(*built.report, line))


def _solver(layout: SceneLayout, config: WarpConfig) -> str:
    if config.algorithm != "auto":
        return config.algorithm
    free = sum(not entity.spec.fixed_base for entity in layout.entities)
    return "cg" if 6 * free + len(layout.joints) > _MOST_FOR_NEWTON else "newton"


def on_device(built: Sequence[model.BuiltModel], config: WarpConfig) -> mjw.Model:
    """The model on the current device.

    A field in which kinds differ has a row for each: MuJoCo-Warp gives environment i the one of index i modulo theirs.

    Raises:
        AssetError: MuJoCo-Warp refuses the scene; says why.
    """
    most = np.max([one.model.geom_condim for one in built], axis=0)
    kinds: list[mjw.Model] = []
    for one in built:
        one.model.geom_condim[:] = most  # has no rows
        try:
            kinds.append(mjw.put_model(one.model))
        except (NotImplementedError, ValueError) as error:
            raise AssetError(f"MuJoCo-Warp refuses the scene: {error}") from error
    target = kinds[0]
    if len(kinds) > 1:
        _give_rows(target, kinds, built)
    target.opt.warn_overflow = 0  # faults are noted and raised, not printed
    target.opt.deterministic = int(mjw.DeterminismType.ALL if config.deterministic else mjw.DeterminismType.NONE)
    return target


def read_back_kinds(model: mjw.Model, addresses: Addresses, kinds: int) -> tuple[BuiltModel, ...]:
    """The contents of the model on the device for each kind of environment."""
    alike = {name: getattr(model, name).numpy() for name in ALIKE}
    varying = {name: getattr(model, name).numpy() for name in VARYING}
    of_kinds = [{name: rows[kind % len(rows)] for name, rows in varying.items()} for kind in range(kinds)]
    models = (cast(Fields, SimpleNamespace(**alike, **of_kind)) for of_kind in of_kinds)
    return tuple(read_back(one, addresses) for one in models)


def _give_rows(target: mjw.Model, kinds: Sequence[mjw.Model], built: Sequence[model.BuiltModel]) -> None:
    for field in dataclasses.fields(mjw.Model):
        shape = getattr(field.type, "shape", ())
        if not (isinstance(shape, tuple) and shape and shape[0] == "*"):
            continue
        rows = [getattr(kind, field.name).numpy() for kind in kinds]
        if field.name == "geom_dataid":
            for row, one in zip(rows, built, strict=True):
                row[0, one.absent] = -1  # a mesh that is not there
        if any(not np.array_equal(row, rows[0]) for row in rows[1:]):
            setattr(target, field.name, wp.array(np.concatenate(rows), dtype=getattr(target, field.name).dtype))
