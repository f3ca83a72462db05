"""Soft fingers on the gripper of any arm: their shape, how they hold on, and how they follow the arm at a reset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_assets.audit.robots.postures import (
    FloatArray,
    frame_pose,
    gripper_posture,
    gripping_links,
    home_posture,
    shapes_in_frame,
)
from orbit_assets.deformables import cuboid
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import Environment
from orbit_core.envs.state import TaskState
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Attachment, Gripper, Mesh, Pose, RobotSpec, SoftBody

FINGERS = ("left_soft_finger", "right_soft_finger")
"""Names of the soft bodies, along y and against it in the hand's frame."""
WIDTH, ROOT, TIP = 0.022, 0.018, 0.01
"""Metres across the hand, and from inner face to back at the root and at the tip: the outline of a Fin Ray finger."""
FREE, SEATED = 0.034, 0.016
"""Metres by which a finger reaches beyond the rigid one that carries it, and along which it is seated on that."""
PROUD, LEAN = 0.003, 0.009
"""Metres by which its inner face is in front of the rigid finger's at the root, and further in front at the tip: a
finger that bends outwards over what it holds would press that down and out of the hand."""
_COUNTS = (4, 3, 8)


@dataclass(frozen=True)
class Seat:
    """Rigid finger that carries a soft one, with the gripper as at home."""

    link: str
    """Link of the robot."""
    inner: float
    """Metres along y between the hand's frame and the rigid finger's inner face."""
    tip: float
    """Metres along the hand's z axis to the rigid finger's tip."""


def seats(robot: RobotSpec) -> tuple[Seat, Seat]:
    """Find the rigid fingertips of a robot's first gripper, along y and against it.

    Raises:
        ConfigurationError: the robot has no gripper with a finger on either side of its hand's frame.
    """
    gripper = robot.end_effector.gripper
    found = [] if gripper is None else [_seat(robot, gripper, side) for side in (1.0, -1.0)]
    if len(found) != 2 or found[0] is None or found[1] is None:
        raise ConfigurationError(
            f"robot '{robot.name}' has no gripper with a finger on either side of frame "
            f"'{robot.end_effector.frame}': soft fingers need one, as franka_panda or ur10_robotiq_2f85 have"
        )
    return found[0], found[1]


def _seat(robot: RobotSpec, gripper: Gripper, side: float) -> Seat | None:
    shapes = [
        (link.name, points)
        for link in gripping_links(robot, gripper)
        for points in shapes_in_frame(robot, robot.end_effector.frame, [link], home_posture(robot))
        if side * points[:, 1].mean() > 0.0
    ]
    if not shapes:
        return None
    # Linked fingers have several links on a side: the one that reaches furthest carries the pad.
    link, points = max(shapes, key=lambda shape: float(shape[1][:, 2].max()))
    return Seat(link, float(np.abs(points[:, 1]).min()), float(points[:, 2].max()))


def grasp_depth(robot: RobotSpec) -> float:
    """Return metres from the hand's frame along z to the middle of the soft fingers' free part."""
    return float(np.mean([seat.tip for seat in seats(robot)])) + 0.5 * FREE


def soft_fingers(robot: RobotSpec, density: float, youngs_modulus: float, friction: float) -> tuple[SoftBody, SoftBody]:
    """Build two tapered fingers that are seated on a robot's rigid ones, with the robot at home.

    Args:
        robot: with a gripper that is open at home.
        density: kg/m^3.
        youngs_modulus: Pa.
        friction: of the fingers with everything.

    Raises:
        ConfigurationError: the robot has no gripper with a finger on either side, or one that is closed at home.
    """
    both = seats(robot)
    _check_open(robot, both)
    hand = frame_pose(robot, robot.end_effector.frame, home_posture(robot))
    made = []
    for name, side, seat in zip(FINGERS, (1.0, -1.0), both, strict=True):
        mesh = _finger(side, seat)
        middle = mesh.vertices.mean(axis=0)
        # Only the seated part is held: the rest bends over what it touches.
        held = np.flatnonzero(mesh.vertices[:, 2] < seat.tip - 0.1 * SEATED)
        pose = hand @ Pose(tuple(middle.tolist()))
        made.append(
            SoftBody(
                name, Mesh(mesh.vertices - middle, mesh.faces), density, pose, youngs_modulus, damping=0.005,
                friction=friction, color=(0.95, 0.55, 0.25, 1.0),
                attachments=(Attachment(tuple(held.tolist()), robot.name, seat.link),),
            )
        )  # fmt: skip
    return made[0], made[1]


def _check_open(robot: RobotSpec, both: tuple[Seat, Seat]) -> None:
    gap = sum(seat.inner for seat in both) - 2.0 * (PROUD + LEAN)
    gripper = robot.end_effector.gripper
    if gripper is None:
        return
    opened = gripper_posture(robot, gripper, gripper.open_position)
    home = home_posture(robot)
    if gap <= 0.0 or any(abs(opened[name] - home[name]) > 1e-3 for name in opened):
        raise ConfigurationError(
            f"the gripper of robot '{robot.name}' is not open at home, where soft fingers are put on: give it a home "
            f"with its joints {', '.join(gripper.joints)} at {gripper.open_position}"
        )


def _finger(side: float, seat: Seat) -> Mesh:
    """Build the surface of a finger in the hand's frame: its inner face is flat, its back slants to the tip."""
    length = SEATED + FREE
    mesh = cuboid((WIDTH, ROOT, length), _COUNTS)
    x, y, z = mesh.vertices.T
    along, deep = z / length + 0.5, y + 0.5 * ROOT
    outward = seat.inner - PROUD - LEAN * along + deep * (1.0 - (1.0 - TIP / ROOT) * along)
    vertices: FloatArray = np.column_stack((x, side * outward, seat.tip - SEATED + along * length))
    # Mirrored, triangles are seen from inside.
    return Mesh(vertices, mesh.faces if side > 0.0 else mesh.faces[:, ::-1])


class FingerMemory(TaskState):
    """Places of soft fingers on their links, looked up once in a new world."""

    arm_joints: Tensor
    """(A,) indices of the joints that move the hand."""
    finger_links: Tensor
    """(2,) links of the robot that carry the soft fingers."""
    finger_points: Tensor
    """(2, P, 3) m of their vertices at rest, in the frames of those links."""

    def start(self, env: Environment) -> None:
        robot = env.world.robots[env.task.agents[0]]
        self.arm_joints = torch.tensor(robot.find_joints(*robot.spec.end_effector.arm_joints), device=env.device)
        bodies = [env.world.deformables[name] for name in FINGERS]
        links = [robot.link_names.index(str(body.spec.attachments[0].link)) for body in bodies]
        self.finger_links = torch.tensor(links, device=env.device)
        home = home_posture(robot.spec)
        points = [
            frame_pose(robot.spec, robot.link_names[link], home)
            .inverse()
            .transform(body.spec.pose.transform(body.spec.rest_positions))
            for link, body in zip(links, bodies, strict=True)
        ]
        self.finger_points = torch.tensor(np.stack(points), dtype=torch.float32, device=env.device)


def place_robot(spread: float):
    """Event: the arm's joints uniform within ``spread`` (rad or m) of home, the gripper open, soft fingers on it."""

    def place(env: Environment, env_ids: Tensor) -> None:
        robot, memory = env.world.robots[env.task.agents[0]], env.state
        drawn = env.world.random.uniform((len(memory.arm_joints),), -spread, spread, env_ids)
        positions = robot.home_positions.repeat(len(drawn), 1).index_add(1, memory.arm_joints, drawn)
        limits = robot.position_limits
        robot.set_joint_state(positions.clamp(limits[:, 0], limits[:, 1]), env_ids=env_ids)
        for number, name in enumerate(FINGERS):
            pose = robot.link_poses[:, memory.finger_links[number]][env_ids][:, None]
            points = memory.finger_points[number].expand(len(pose), -1, -1)
            placed = quat_rotate(pose[..., 3:].expand(-1, points.shape[1], -1), points) + pose[..., :3]
            env.world.deformables[name].set_state(placed, env_ids=env_ids)

    return place
