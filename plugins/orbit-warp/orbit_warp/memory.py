"""Memory that MuJoCo-Warp's arrays take per environment, counted before they are made."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information, and Warp's arrays carry theirs at run time.

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

import mujoco
import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src.collision_core import create_collision_context
from mujoco_warp._src.collision_driver import MJ_COLLISION_TABLE
from mujoco_warp._src.math import upper_trid_index
from mujoco_warp._src.solver import _create_solver_context
from mujoco_warp._src.types import MJ_MAX_EPAFACES, MJ_MAX_EPAHORIZON, CollisionType, DisableBit, GeomType

from orbit_warp.buffers import BufferSizes

_NUMBER, _VECTOR = 4, 12
# Types of shapes whose contacts with each other are clipped polygons
_FLAT = (GeomType.BOX, GeomType.MESH, GeomType.CYLINDER, GeomType.CAPSULE)


def bytes_per_environment(host_model: mujoco.MjModel, model: mjw.Model, sizes: BufferSizes) -> int:
    """Count the bytes of MuJoCo-Warp's arrays for one more environment.

    Args:
        host_model: compiled model.
        model: the same on the device.
        sizes: of the buffers of contacts and constraints.

    Returns:
        bytes of the data, and of the larger of the search for contacts and the solver, which follow each other. Fields
        of distances, flexible bodies and integrators of several stages take more.
    """
    (data, search, solver), more = (_bytes_of(host_model, model, sizes, num_envs) for num_envs in (1, 2))
    search = more[1] - search + sizes.nconmax * _bytes_of_convex_contact(model)
    return more[0] - data + max(search, more[2] - solver)


def _bytes_of(host_model: mujoco.MjModel, model: mjw.Model, sizes: BufferSizes, num_envs: int) -> tuple[int, ...]:
    """Return the bytes of data, search for contacts and solver."""
    data = mjw.make_data(host_model, nworld=num_envs, nconmax=sizes.nconmax, njmax=sizes.njmax)
    owners = data, create_collision_context(data.naconmax), _create_solver_context(model, data)
    # Arrays of one owner may share memory.
    return tuple(sum({array.ptr: array.capacity for array in _arrays(owner)}.values()) for owner in owners)


def _arrays(owner: object) -> Iterator[wp.array]:
    """Yield the arrays of a dataclass, and of those within it."""
    for field in fields(owner):
        value = getattr(owner, field.name)
        if isinstance(value, wp.array):
            yield value
        elif is_dataclass(value):
            yield from _arrays(value)


def _bytes_of_convex_contact(model: mjw.Model) -> int:
    """Return the bytes in which one contact of convex shapes is searched for, as ``convex_narrowphase`` makes them."""
    boxes = (GeomType.BOX, GeomType.BOX)
    primitive = model.opt.disableflags & DisableBit.NATIVECCD
    # Contacts of height fields are found elsewhere.
    counts = {
        pair: model.geom_pair_type_count[upper_trid_index(len(GeomType), pair[0].value, pair[1].value)]
        for pair, kind in MJ_COLLISION_TABLE.items()
        if kind == CollisionType.CONVEX and GeomType.HFIELD not in pair and not (primitive and pair == boxes)
    }
    if not any(counts.values()):
        return 0
    of_boxes = counts.get(boxes, 0)
    rounds = 16 if of_boxes == sum(counts.values()) else model.opt.ccd_iterations
    vertices, faces = 10 + 2 * rounds, 6 + MJ_MAX_EPAFACES * rounds
    polytope = vertices * (_VECTOR + _NUMBER) + faces * (_VECTOR + 2 * _NUMBER) + MJ_MAX_EPAHORIZON * _NUMBER
    corners, edges = (4, 3) if of_boxes else (0, 0)
    if not model.opt.disableflags & DisableBit.MULTICCD and any(
        count for (one, other), count in counts.items() if one in _FLAT and other in (GeomType.MESH, GeomType.CYLINDER)
    ):
        corners, edges = max(model.npolygonmax, corners), max(model.nmeshdegmax, 3)
    return polytope + corners * (7 * _VECTOR + _NUMBER) + edges * (3 * _VECTOR + 2 * _NUMBER)
