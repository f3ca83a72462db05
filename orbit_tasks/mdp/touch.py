"""Tactile pads on the two fingers of a parallel gripper, and what tasks read of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor

from orbit_assets.audit.robots.postures import gripper_posture, gripping_links
from orbit_core.dynamics.transforms import quat_from_matrix, quat_rotate
from orbit_core.envs import Environment, ObservationTerm
from orbit_core.envs.terms import Meaning
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Pose, RobotSpec, TactileSpec
from orbit_core.sensors import TactileSensor

PADS = ("first_pad", "second_pad")
"""Names of the two sensors."""
# Metres by which the pad of a finger may be off the end effector's frame where the fingers meet.
_PARALLEL = 1e-3


@dataclass(frozen=True)
class Pads:
    """Two pads, and how each is turned in the end effector's frame."""

    specs: tuple[TactileSpec, TactileSpec]
    """Sensors of the scene, of :data:`PADS`."""
    turns: Tensor
    """(2, 4) rotations from a pad's axes to those of the end effector's frame."""


def finger_pads(robot: RobotSpec, size: tuple[float, float], taxels: tuple[int, int], **fields: Any) -> Pads:
    """Return pads that face each other where the fingers of a parallel gripper meet.

    A pad's z axis is the way in which its finger closes, and its y axis leads back out of where the hand points.

    Args:
        robot: whose first end effector has the gripper.
        size: full extent of a pad along x and y, m.
        taxels: columns along x and rows along y.
        fields: others of :class:`~orbit_core.scene.TactileSpec`.

    Raises:
        ConfigurationError: the robot's hand is no gripper of two fingers that slide.
    """
    effector = robot.end_effector
    fingers = [] if effector.gripper is None else gripping_links(robot, effector.gripper)
    if effector.gripper is None or len(fingers) != 2:
        raise ConfigurationError(
            f"robot '{robot.name}' has {len(fingers)} links that grip: choose one with a parallel gripper of two "
            "fingers, such as franka_panda"
        )
    gripper = effector.gripper
    opened, closed = (
        link_poses(robot.articulation, gripper_posture(robot, gripper, value))
        for value in (gripper.open_position, gripper.closed_position)
    )
    frame = robot.articulation.frame(effector.frame)
    hand = closed[frame.link] @ frame.pose
    specs, turns = [], []
    for name, finger in zip(PADS, fingers, strict=True):
        way = (hand.inverse() @ closed[finger.name]).position, (hand.inverse() @ opened[finger.name]).position
        out = torch.tensor(way[0]) - torch.tensor(way[1])
        # A finger that slides moves straight across the hand; one that swings moves along it as well.
        if float(out.norm()) < _PARALLEL or abs(float(out[2])) > _PARALLEL:
            raise ConfigurationError(
                f"the finger '{finger.name}' of robot '{robot.name}' does not slide: choose a robot with a parallel "
                "gripper, such as franka_panda"
            )
        z = out / out.norm()
        y = torch.tensor((0.0, 0.0, -1.0))
        turn = quat_from_matrix(torch.stack((torch.linalg.cross(y, z), y, z), dim=1))
        w, i, j, k = turn.tolist()
        pose = closed[finger.name].inverse() @ hand @ Pose((0.0, 0.0, 0.0), (w, i, j, k))
        own = {"entity": robot.name, "links": (finger.name,), "frame": finger.name, "pose": pose, "shear": True}
        specs.append(TactileSpec(name=name, size=size, taxels=taxels, **own, **fields))
        turns.append(turn)
    return Pads((specs[0], specs[1]), torch.stack(turns))


def sensors(world: World) -> list[TactileSensor]:
    """Return the two pads of a world."""
    return [cast(TactileSensor, world.sensors[name]) for name in PADS]


def forces(world: World, turns: Tensor, hand: Tensor) -> Tensor:
    """Return the forces (N, 2, 3) on the two pads in newtons, sums of their taxels, in the environment's axes.

    Args:
        world: with both pads.
        turns: (2, 4) of :class:`Pads`.
        hand: (N, 4) orientation of the end effector's frame.
    """
    own = []
    for pad in sensors(world):
        sideways, pressing = pad.shear_forces.sum((1, 2)), pad.normal_forces.sum((1, 2))
        own.append(torch.cat((sideways, -pressing[:, None]), dim=1))
    return quat_rotate(hand[:, None], quat_rotate(turns, torch.stack(own, dim=1)))


def taxels(index: int, pad: TactileSpec) -> ObservationTerm:
    """Return the term (N, 3 T) of a pad's forces in newtons, row after row: normal, and shear along its x and y.

    Args:
        index: 0 or 1 of :data:`PADS`.
        pad: the sensor, which the scene brings.
    """
    columns, rows = pad.taxels

    def felt(env: Environment) -> Tensor:
        sensor = sensors(env.world)[index]
        return torch.cat((sensor.normal_forces[..., None], sensor.shear_forces), dim=-1).flatten(1)

    names = tuple(
        f"{kind} of taxel ({row}, {column})"
        for row in range(rows)
        for column in range(columns)
        for kind in ("normal force", "shear along x", "shear along y")
    )
    return ObservationTerm(felt, unit="N", meaning=Meaning(f"forces on the taxels of '{pad.name}'", "pad", names))
