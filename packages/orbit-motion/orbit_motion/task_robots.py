"""Robots of the catalogue as agents of a task: arms with a workspace that is large enough, and legged robots."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.catalogue import robot
from orbit_core.envs.task import ROBOT
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp.common import placed_workspace
from orbit_core.scene import Pose, RobotSpec
from orbit_core.scene.pose import Vector3
from orbit_motion.workspace import with_workspace

# Least size of a workspace, m, in which a task lays out its things; those of the catalogue's larger arms have more.
ROOM: Vector3 = (0.15, 0.3, 0.2)


def arm(
    name: str, gripper: bool = True, agent: str = ROBOT, pose: Pose | None = None, room: Vector3 = ROOM
) -> RobotSpec:
    """A robot of the catalogue with an end effector, and a gripper on it where that is needed, as an agent of the task.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: it has no end effector, no arm that moves it, or no gripper; or it has no workspace, and
            none is found (:func:`orbit_motion.workspace.with_workspace`), or one that is smaller than the task's
            ``room``, m along x, y and z.
    """
    spec = robot(name, name=agent)
    spec = spec if pose is None else replace(spec, pose=pose)
    lacking = None
    if not spec.end_effectors:
        lacking = "end effector"
    elif not spec.has_arm:
        raise ConfigurationError(
            f"robot '{name}' has no arm, which this task needs: mount it on one, as in 'ur10+{name}', or choose "
            "another robot"
        )
    elif gripper and spec.end_effector.gripper is None:
        lacking = "gripper"
    if lacking:
        raise ConfigurationError(f"robot '{name}' has no {lacking}, which this task needs: choose another robot")
    spec = with_workspace(spec)
    box = placed_workspace(spec)
    size = [high - low for low, high in zip(box.low, box.high, strict=True)]
    if any(has < needs for has, needs in zip(size, room, strict=True)):
        sizes = (" x ".join(f"{length:.2f}" for length in lengths) for lengths in (size, room))
        raise ConfigurationError(
            "the workspace of robot '{}' is {} m, and this task needs {} m: choose a larger robot".format(name, *sizes)
        )
    return spec


def legged(name: str) -> RobotSpec:
    """A robot of the catalogue with feet, as the task's robot.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: it has no feet.
    """
    spec = robot(name, name=ROBOT)
    if not spec.feet:
        raise ConfigurationError(f"robot '{name}' has no feet, which this task needs: choose another robot")
    return spec
