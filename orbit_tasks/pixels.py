"""Learning from pictures: a camera on the hand, one before the arm, and the observation group of an arm with both."""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from orbit_core.envs import Environment, ObservationGroup, ObservationTerm
from orbit_core.envs.task import ROBOT
from orbit_core.envs.terms import measured_in
from orbit_core.mdp import common
from orbit_core.mdp.sensing import camera_color, camera_depth, camera_segmentation
from orbit_core.scene import END_EFFECTOR, CameraSpec, Channel, look_at

# Pixels, both ways.
SIZE = 64

# A camera next to the fingers, which close across the picture; it looks between and before them.
HAND = CameraSpec(
    name="hand",
    width=SIZE,
    height=SIZE,
    vertical_fov=1.2,
    channels=(Channel.RGB, Channel.DEPTH),
    entity=ROBOT,
    frame=END_EFFECTOR,
    pose=look_at(eye=(0.1, 0.0, -0.12), target=(0.045, 0.0, 0.03), up=(1.0, 0.0, 0.0)),
    far=2.0,
)

# Looks at the arm over the bench, from the other side.
FRONT = CameraSpec(
    name="front",
    width=SIZE,
    height=SIZE,
    vertical_fov=0.85,
    channels=(Channel.RGB, Channel.DEPTH),
    pose=look_at(eye=(1.3, 0.0, 0.75), target=(0.45, 0.0, 0.2)),
    far=2.0,
)


# The same, which sees what each pixel is of, and how far away.
FRONT_LABELS = replace(FRONT, channels=(Channel.SEMANTIC, Channel.DEPTH))


@measured_in("m")
def goal(env: Environment) -> Tensor:
    """(N, ...) the task's goal."""
    return env.commands["goal"]


@dataclass
class ArmPixels(ObservationGroup):
    """Observations of an arm from its joints, its hand, its goal and two cameras, which only see what is before it."""

    concatenate: bool = False
    """False: pictures and numbers stay apart, for networks that read each by its own encoder."""
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    """A robot knows it from its joints; without it a network has to learn kinematics to a centimetre."""
    goal: ObservationTerm | None = ObservationTerm(goal)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)
    hand_color: ObservationTerm | None = camera_color(HAND)
    hand_depth: ObservationTerm | None = camera_depth(HAND)
    front_color: ObservationTerm | None = camera_color(FRONT)
    front_depth: ObservationTerm | None = camera_depth(FRONT)


@dataclass
class ArmLabels(ObservationGroup):
    """Observations of an arm from its joints and a semantic camera, whose labels say which thing is which."""

    concatenate: bool = False
    """False: pictures and numbers stay apart, for networks that read each by its own encoder."""
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)
    joint_velocities: ObservationTerm | None = ObservationTerm(common.joint_velocities)
    hand_pose: ObservationTerm | None = ObservationTerm(common.hand_pose)
    last_action: ObservationTerm | None = ObservationTerm(common.last_action)
    front_labels: ObservationTerm | None = camera_segmentation(FRONT_LABELS)
    front_depth: ObservationTerm | None = camera_depth(FRONT_LABELS)
