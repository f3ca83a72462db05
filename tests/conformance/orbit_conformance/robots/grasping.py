"""Check that a gripper or a hand closes on a cylinder and holds it against twice its weight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from orbit_assets.audit.robots.postures import all_shapes, frame_pose, gripper_posture, gripping
from orbit_assets.decomposition import Convex, convex_shape, within
from orbit_assets.objects import cylinder
from orbit_conformance.bodies import WEIGHTLESS, G, scene
from orbit_conformance.robots.check import Measures, RobotCheck, clamped
from orbit_conformance.scenario import Metric, Trial
from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse
from orbit_core.interfaces import World
from orbit_core.interfaces.layout import gripper_positions
from orbit_core.scene import Cylinder, EndEffector, Gripper, PhysicsMaterial, Pose, RobotSpec, Shape

# Metres. The axis is along the x of the end effector's frame: across the fingers' opening and the approach.
RADIUS, LENGTH = 0.02, 0.1
# Metres out of the hand, from the end effector's frame, within which a place is looked for.
_FARTHEST, _STRIDE = 0.08, 0.002
# Metres between shapes that count as touching.
_TOUCH = 2e-4
# Share of the radius to which closing fingers would get into the cylinder: less is no more than brushing its front.
_CORE = 0.5
_LYING = Pose.from_axis_angle((0.0, 1.0, 0.0), math.pi / 2.0)


@dataclass(frozen=True, eq=False)
class Place:
    """Pose of the cylinder, and the robot's joints with the hand open and closed."""

    pose: Pose
    """Of the cylinder, in the world."""
    opened: Mapping[str, float]
    """Positions of all movable joints by name."""
    closed: Mapping[str, float]
    """The same with the hand closed on the cylinder."""


def place_of(spec: RobotSpec, effector: EndEffector, gripper: Gripper) -> Place | None:
    """Return the place nearest to the end effector's frame that the open hand leaves free and the closing one does not.

    None where there is none: the hand opens too little, or closes next to it.
    """
    opened = gripper_posture(spec, gripper, gripper.open_position)
    closed = gripper_posture(spec, gripper, gripper.closed_position)
    frame = frame_pose(spec, effector.frame, opened)
    around, within_reach = all_shapes(spec, opened), all_shapes(spec, closed)
    whole, core = (Shape(Cylinder(radius, LENGTH / 2.0)) for radius in (RADIUS, _CORE * RADIUS))
    # The nearest place first: far out on the fingertips every hand is weak.
    for out in np.arange(0.0, _FARTHEST, _STRIDE):
        pose = frame @ Pose((0.0, 0.0, float(out))) @ _LYING
        # The core has to be met, or a closing hand would only brush the cylinder.
        if not _touches(whole, pose, around) and _touches(core, pose, within_reach):
            return Place(pose, opened, closed)
    return None


def _touches(shape: Shape, pose: Pose, others: list[Convex]) -> bool:
    thing = convex_shape(shape, pose)
    assert thing is not None
    return any(within(thing, other, _TOUCH) for other in others)


# kg, and its coefficient: rubber's, also where the finger's own is less.
MASS, FRICTION = 0.2, 1.0
_LOAD = 2.0 * MASS * G
# One in each environment, in the end effector's axes: along the cylinder, towards a finger, and out of the hand.
_PULLS = torch.eye(3)
# Seconds
_CLOSE, _SETTLE, _HOLD = 1.0, 0.5, 2.0


def _run(trial: Trial, spec: RobotSpec) -> Measures:
    """All hands of the robot, one after another."""
    slips = [_slip(trial, spec, *hand) for hand in _hands(spec)]
    return Measures({"slip": max(slips)})


def _hands(spec: RobotSpec) -> list[tuple[EndEffector, Gripper, Place]]:
    """The hands that could hold the cylinder, and where it is put for each."""
    hands = gripping(spec)
    return [(effector, hand, place) for effector, hand in hands if (place := place_of(spec, effector, hand))]


def _slip(trial: Trial, spec: RobotSpec, effector: EndEffector, gripper: Gripper, place: Place) -> float:
    """Return how far the cylinder moves in the end effector's frame while it is pulled, in metres."""
    material = PhysicsMaterial(static_friction=FRICTION, dynamic_friction=FRICTION)
    thing = cylinder("cylinder", RADIUS, LENGTH, mass=MASS, material=material, pose=place.pose)
    # Without gravity only the pulls load the grip, from the same start in each direction.
    world = trial.world(scene(clamped(spec), thing, terrain=(), gravity=WEIGHTLESS), len(_PULLS))
    _close(trial, world, spec, gripper, place)
    robot, held = world.robots[spec.name], world.objects["cylinder"]
    before = _within(world, spec, effector)
    # Directions of the hand, whatever its orientation in the world is.
    pulls = quat_rotate(robot.frame_pose(effector.frame)[:, 3:], _LOAD * _PULLS.to(world.device))
    held.set_wrenches(torch.cat((pulls, torch.zeros_like(pulls)), -1)[:, None])
    trial.step(world, trial.steps(_HOLD))
    return float((_within(world, spec, effector) - before).norm(dim=-1).max())


def _close(trial: Trial, world: World, spec: RobotSpec, gripper: Gripper, place: Place) -> None:
    """Close from the open position at an even pace, and wait."""
    robot = world.robots[spec.name]
    names = spec.articulation.joint_names
    opened, closed = (
        torch.tensor([posture[name] for name in names], device=world.device).repeat(world.num_envs, 1)
        for posture in (place.opened, place.closed)
    )
    robot.set_joint_state(opened, torch.zeros_like(opened))
    fingers = list(gripper_positions(spec, gripper, gripper.closed_position))
    for time in trial.advance(world, _CLOSE):
        # A step of the targets would hit the cylinder instead of gripping it.
        share = min(1.0, time / _CLOSE)
        robot.set_position_targets(((1.0 - share) * opened + share * closed)[:, fingers], fingers)
    # Fingers and cylinder find their balance before the first pull.
    trial.step(world, trial.steps(_SETTLE))


def _within(world: World, spec: RobotSpec, effector: EndEffector) -> torch.Tensor:
    """(N, 3) the cylinder's middle in the end effector's frame."""
    frame = world.robots[spec.name].frame_pose(effector.frame)
    return quat_rotate_inverse(frame[:, 3:], world.objects["cylinder"].root_pose[:, :3] - frame[:, :3]).clone()


def _spared(spec: RobotSpec) -> str:
    if not gripping(spec):
        return "it has no gripper and no hand"
    if not _hands(spec):
        return "its open fingers leave no room for a cylinder of 40 mm that they would close on"
    return ""


GRASP = RobotCheck(
    name="robot_grasp",
    title="grasps",
    question="Does each gripper or hand close on a cylinder of 40 mm and hold it for 2 s against twice its weight?",
    truth="it stays where it is: 200 g, friction of 1, pulled by 3.9 N along its axis, towards a finger and out of "
    "the hand, without gravity",
    metrics=(
        Metric(
            name="slip",
            unit="m",
            tolerance=0.005,
            meaning="farthest that the cylinder moves in the hand in 2 s, of three directions of pull",
            looser_because="fingers and their drives give way under the pull",
        ),
    ),
    spared=_spared,
    run=_run,
)
