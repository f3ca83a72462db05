"""Terms of what the trunk of a robot that walks or runs feels, in its own axes."""

from __future__ import annotations

from torch import Tensor

from orbit_core.envs import Environment
from orbit_core.envs.terms import means, measured_in, once_per_state
from orbit_core.mdp import common
from orbit_tasks import walking

TRUNK = "trunk: axes of the robot's root link"


@once_per_state
def trunk_motion(env: Environment) -> Tensor:
    """(N, 3, 3) linear velocity, angular velocity and direction of gravity in the trunk's axes."""
    return walking.trunk_motion(common.robot_of(env.world))


@means("velocity of the root link's origin, turned into the trunk's axes: R^T v", frame=TRUNK)
@measured_in("m/s")
@once_per_state
def linear_velocity(env: Environment) -> Tensor:
    """(N, 3) of the trunk, in its own axes."""
    return trunk_motion(env)[:, 0]


@means("angular velocity of the root link, turned into the trunk's axes: R^T w", frame=TRUNK)
@measured_in("rad/s")
@once_per_state
def angular_velocity(env: Environment) -> Tensor:
    """(N, 3) of the trunk, in its own axes."""
    return trunk_motion(env)[:, 1]


@means("direction of gravity, turned into the trunk's axes: R^T (0, 0, -1)", frame=TRUNK, components=("x", "y", "z"))
@measured_in("1")
@once_per_state
def projected_gravity(env: Environment) -> Tensor:
    """(N, 3) the direction of gravity in the trunk's axes; (0, 0, -1) when level."""
    return trunk_motion(env)[:, 2]
