"""Grasp candidates on an engine: a jaw that closes at them holds the thing against gravity."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from orbit_core.scene import (
    Articulation,
    Box,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    PhysicsMaterial,
    Pose,
    RobotSpec,
    Scene,
    Shape,
)
from orbit_core.world import simulate
from orbit_scenes.grasps import Jaw, grasps
from orbit_scenes.things import thing

JAW = Jaw()
TIP = 0.008
"""Metres that the fingers reach beyond the line between the contacts."""


def jaw() -> RobotSpec:
    """Return a hand of two fingers in the air that points down and closes with 20 N."""
    x, y, z = (length / 2 for length in JAW.pad)

    def finger(name: str, side: float) -> Link:
        pad = Shape(Box((x, y, z)), Pose((0.0, side * y, TIP - z)), PhysicsMaterial(1.0, 1.0))
        return Link(name, 0.1, (0.0, side * y, TIP - z), np.eye(3) * 1e-4, (pad,), (pad,))

    joints = tuple(
        Joint(
            f"{name}_joint", JointType.PRISMATIC, "palm", name,
            axis=(0.0, side, 0.0), lower_limit=0.0, upper_limit=0.045, damping=5.0,
        )
        for name, side in (("left", 1.0), ("right", -1.0))
    )  # fmt: skip
    links = (Link("palm", 1.0, inertia=np.eye(3) * 1e-2), finger("left", 1.0), finger("right", -1.0))
    return RobotSpec(
        name="jaw",
        articulation=Articulation("jaw", links, joints),
        pose=Pose.from_euler(math.pi, 0.0, 0.0, (0.0, 0.0, 0.6)),
        fixed_base=True,
        actuators=(ImplicitPd(joints=(".*",), stiffness=2000.0, damping=40.0, effort_limit=20.0),),
        gravity_compensation=True,
    )


@pytest.mark.parametrize("name", ["mug", "bowl", "hammer", "soup_can", "banana"])
def test_a_jaw_that_closes_at_any_of_the_first_candidates_holds_the_thing(name: str):
    found, hand = grasps(thing(name))[:8], jaw()
    world = simulate(
        Scene(robots=(hand,), objects=(thing(name).build("thing"),), terrain=(), physics_dt=0.002), len(found), "mujoco"
    )
    held, robot = world.objects["thing"], world.robots["jaw"]
    # Each environment tries one candidate: the thing is put where the hand is at it.
    poses = [hand.pose @ grasp.pose.inverse() for grasp in found]
    held.set_root_pose(torch.tensor([[*pose.position, *pose.orientation] for pose in poses], dtype=torch.float32))
    opened = torch.tensor([[min(grasp.width / 2 + JAW.clearance, 0.045)] * 2 for grasp in found])
    robot.set_joint_state(opened, torch.zeros_like(opened))
    robot.set_position_targets(torch.zeros_like(opened))
    start = held.root_pose[:, :3].clone()
    world.step(400)
    assert float((held.root_pose[:, :3] - start).norm(dim=1).max()) < 0.03
    world.close()
