"""Joints as kernels see them."""

# pyright: reportGeneralTypeIssues=false, reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import numpy as np
import warp as wp

from orbit_newton.builder import UNLIMITED, joint_limits
from orbit_newton.plant import Plant


@wp.struct
class JointTable:
    """Per joint of the layout, in one environment."""

    positions: wp.array[int]
    """Column of its coordinate."""
    velocities: wp.array[int]
    """Column of its velocity."""
    targets: wp.array[int]
    """Column of its position target."""
    zeros: wp.array[float]
    """The contract's position where Newton's coordinate is zero."""
    lower: wp.array[float]
    """rad or m."""
    upper: wp.array[float]
    """rad or m."""
    effort_limit: wp.array[float]
    """N m or N."""
    damping: wp.array[float]
    """N m s/rad or N s/m of the mechanism."""
    friction: wp.array[float]
    """N m or N of the mechanism."""
    armature: wp.array[float]
    """kg m^2 or kg."""


def joint_table(plant: Plant) -> JointTable:
    """The layout's joints on the model's device."""
    built, parameters = plant.built, plant.layout.joint_parameters
    lower, upper = joint_limits(plant.layout)
    table = JointTable()
    table.positions = wp.array(built.positions, dtype=int)
    table.velocities = wp.array(built.velocities, dtype=int)
    table.targets = wp.array(built.targets, dtype=int)
    table.zeros = wp.array(built.zeros, dtype=float)
    table.lower, table.upper = wp.array(lower, dtype=float), wp.array(upper, dtype=float)
    # Finite, as the model's own limits are.
    table.effort_limit = wp.array(np.minimum(parameters.effort_limit, UNLIMITED), dtype=float)
    table.damping = wp.array(parameters.damping, dtype=float)
    table.friction = wp.array(parameters.friction, dtype=float)
    table.armature = wp.array(parameters.armature, dtype=float)
    return table


def drive_arrays(plant: Plant) -> list[wp.array]:
    """Stiffness and damping of the drives, and the commands."""
    tensors = (plant.stiffness, plant.damping, plant.position_targets, plant.velocity_targets, plant.efforts)
    return [wp.from_torch(tensor) for tensor in tensors]
