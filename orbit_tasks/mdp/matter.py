"""Terms that tasks of cloth, rope and solids share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_assets.audit.robots.postures import gripper_posture, gripping_links, shapes_in_frame
from orbit_core.dynamics.transforms import quat_multiply, quat_rotate
from orbit_core.envs import Environment, ObservationGroup, ObservationTerm
from orbit_core.envs.terms import ENVIRONMENT, EventFunction, TermFunction, means, measured_in
from orbit_core.interfaces.layout import gripper_positions
from orbit_core.interfaces.names import match_names
from orbit_core.mdp import common
from orbit_core.scene import Gripper, Joint, JointType, RobotSpec


def with_grip_force(robot: RobotSpec, force: float) -> RobotSpec:
    """Return the robot with a first gripper that closes with ``force`` newtons, on thin things too.

    Its drives reach that force half a millimetre from where they want to be, and give no more. The joints that they
    drive are damped so that all of that force moves them at their velocity limit, which few engines enforce: without it
    fingers of 50 N closed within 40 ms on three engines and in 200 ms on the fourth.
    """
    gripper = robot.end_effector.gripper
    if gripper is None:
        return robot
    names = robot.articulation.joint_names
    joints = set(match_names(gripper.joints, names, "joint", f"'{robot.name}'"))
    travel = _jaw_travel(robot, gripper, [robot.articulation.movable_joints[number] for number in joints])
    groups = (
        replace(
            group,
            effort_limit=force * travel,
            # Stiff enough that the limit, and not the drive's spring, sets the force on things of any thickness.
            stiffness=max(group.stiffness, force * travel**2 / 5e-4),
            # A stiffer drive needs more damping to settle as it did.
            damping=2.0 * group.damping,
        )
        if joints & set(match_names(group.joints, names, "joint", f"'{robot.name}'"))
        else group
        for group in robot.actuators
    )
    chosen = {names[number] for number in joints}
    damped = tuple(
        replace(joint, damping=max(joint.damping, force * travel / joint.velocity_limit))
        if joint.name in chosen
        else joint
        for joint in robot.articulation.joints
    )
    return replace(robot, articulation=replace(robot.articulation, joints=damped), actuators=tuple(groups))


def _jaw_travel(robot: RobotSpec, gripper: Gripper, joints: list[Joint]) -> float:
    """Metres that a finger goes for each unit of the gripper's joints: 1 of those that slide."""
    if all(joint.type is JointType.PRISMATIC for joint in joints):
        return 1.0
    links = gripping_links(robot, gripper)
    ends = [
        shapes_in_frame(robot, robot.end_effector.frame, links, gripper_posture(robot, gripper, position))
        for position in (gripper.open_position, gripper.closed_position)
    ]
    # Across the hand's axis only: linked fingers also move along it as they close.
    ways = [np.linalg.norm((b.mean(0) - a.mean(0))[:2]) for a, b in zip(*ends, strict=True)]
    first, last = (
        gripper_positions(robot, gripper, value) for value in (gripper.open_position, gripper.closed_position)
    )
    return float(max(ways)) / max(abs(last[number] - first[number]) for number in first)


def key_points(name: str) -> TermFunction:
    """Term: (N, 3 K) key points of a deformable, in the environment's frame."""

    @means(f"positions of the key points of '{name}', one after the other", ENVIRONMENT)
    @measured_in("m")
    def observe(env: Environment) -> Tensor:
        return env.world.deformables[name].key_points.flatten(1)

    return observe


@dataclass
class DeformableState(ObservationGroup):
    """The arm's joints and hand, key points of what it handles, which tasks name, and the last action."""

    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    key_points: ObservationTerm | None = None
    """Positions of the key points, which a task names by :func:`key_points`; none until then."""
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)


def vector_area(positions: Tensor, triangles: Tensor) -> Tensor:
    """(N, 3) m^2: the sum of triangles' (T, 3) normals times their areas, of particles (N, P, 3).

    Its part along a direction is the area that is seen from there, less twice what folds show of the other side.
    """
    a, b, c = (positions[:, triangles[:, k]] for k in range(3))
    return 0.5 * torch.linalg.cross(b - a, c - a).sum(1)


def place_deformable(
    name: str, spread: tuple[float, float], turn: float = math.pi, carrier: str | None = None
) -> EventFunction:
    """Event: the deformable at its spec's pose, moved by up to ``spread`` (x, y) m and turned by up to ``turn`` rad.

    ``carrier`` names an object that it is fixed to, and that goes with it.
    """

    def place(env: Environment, env_ids: Tensor) -> None:
        thing = env.world.deformables[name]
        # From the positions at rest, so that every episode begins with the same shape.
        rest = torch.tensor(thing.spec.pose.transform(thing.spec.rest_positions), dtype=torch.float32)
        rest = rest.to(env.device)
        low, high = (-spread[0], -spread[1], -turn), (*spread, turn)
        offset = env.world.random.uniform((3,), low, high, env_ids)
        thing.set_state(_moved(rest, rest.mean(0), offset), env_ids=env_ids)
        if carrier is not None:
            carried_by = env.world.objects[carrier]
            pose = carried_by.spec.pose
            position = torch.tensor([pose.position], dtype=torch.float32, device=env.device)
            orientation = torch.tensor(pose.orientation, dtype=torch.float32, device=env.device)
            orientation = quat_multiply(common.turned(offset[:, 2]), orientation.expand(len(offset), 4))
            place = _moved(position, rest.mean(0), offset)[:, 0]
            carried_by.set_root_pose(torch.cat((place, orientation), dim=1), env_ids)

    return place


def place_chosen(name: str, starts: Callable[[Any], Tensor], spread: tuple[float, float]) -> EventFunction:
    """Event: the deformable in one of several states (S, P, 3) around x = y = 0, turned by any angle.

    It is placed around its spec's pose, moved by up to ``spread`` (x, y) m.
    """

    def place(env: Environment, env_ids: Tensor) -> None:
        thing, states = env.world.deformables[name], starts(env)
        x, y, _ = thing.spec.pose.position
        low, high = (x - spread[0], y - spread[1], -math.pi), (x + spread[0], y + spread[1], math.pi)
        offset = env.world.random.uniform((3,), low, high, env_ids)
        chosen = states[env.world.random.integers(0, len(states) - 1, env_ids)]
        thing.set_state(_moved(chosen, torch.zeros(3, device=env.device), offset), env_ids=env_ids)

    return place


def _moved(points: Tensor, pivot: Tensor, offset: Tensor) -> Tensor:
    """(n, P, 3) points ([n,] P, 3) turned about a pivot (3,) and moved, by offsets (n, 3) of x, y and yaw."""
    shift = torch.cat((offset[:, :2], torch.zeros_like(offset[:, :1])), dim=1)
    rotation = common.turned(offset[:, 2])[:, None].expand(-1, points.shape[-2], -1)
    return quat_rotate(rotation, (points - pivot).expand(len(offset), -1, -1)) + pivot + shift[:, None]
