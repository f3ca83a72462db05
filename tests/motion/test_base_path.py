"""A base drives around a wall without touching it, and what stands against its way is told."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_core.actions import BaseVelocityConfig
from orbit_core.dynamics.transforms import yaw_angle
from orbit_core.interfaces import ConfigurationError, PlanningError
from orbit_core.scene import Box, ObjectSpec, Plane, Pose, Shape, single_link
from orbit_motion.planning import BasePathFollower, BasePlanner, BasePlannerConfig
from tests.motion.servo_world import BACKENDS, Held, held

MAP = BasePlannerConfig(radius=0.45, height=0.4, low=(-1.5, -2.5), high=(4.0, 2.5))

GROUND = (Shape(Plane()),)


def block(name: str, half: tuple[float, float, float], x: float, y: float, z: float) -> ObjectSpec:
    body = single_link(name, Shape(Box(half)), 1.0, np.eye(3))
    return ObjectSpec(name=name, articulation=body, fixed_base=True, pose=Pose((x, y, z)))


def behind_a_wall(backend: str, y: float = 1.0) -> Held:
    """A base before a wall, and a lintel above it that is higher than the base."""
    things = (block("wall", (0.05, y, 0.5), 1.3, 0.0, 0.5), block("lintel", (0.05, 2.5, 0.1), 0.5, 0.0, 1.8))
    config = BaseVelocityConfig()
    return held(config, backend, name="base_omni", num_envs=2, physics_dt=0.005, terrain=GROUND, objects=things)


@pytest.mark.parametrize("backend", [BACKENDS[0], BACKENDS[-1]])
def test_a_base_drives_around_a_wall(backend: str) -> None:
    base = behind_a_wall(backend)
    planner = BasePlanner(base.world, MAP)
    goal = torch.tensor([2.6, 0.3])
    path = planner.plan(torch.zeros(2), goal)
    torch.testing.assert_close(path[[0, -1]], torch.stack((torch.zeros(2), goal)))
    follower = BasePathFollower("base", base.robot, BaseVelocityConfig())
    follower.load({0: path}, {0: 1.0})
    link = base.robot.link_names.index(base.robot.spec.base_link)
    places = []
    for _ in range(250):
        base.run(follower.compute({})["command"], 8, decimation=8)
        places.append(base.robot.link_poses[:, link].clone())
    driven = torch.stack(places)
    beyond = (driven[:, 0, :2] - torch.tensor([1.3, 0.0])).abs() - torch.tensor([0.05, 1.0])
    assert torch.linalg.vector_norm(beyond.clamp_min(0.0), dim=1).min() > MAP.radius - 0.06  # it cuts its corners
    assert follower.finished.all()
    torch.testing.assert_close(driven[-1, 0, :2], goal, atol=0.03, rtol=0.0)
    heading = yaw_angle(driven[-1, 0, 3:])
    assert float(heading) == pytest.approx(1.0, abs=0.03)
    assert driven[:, 1, :2].abs().max() < 0.01  # without a path it stays
    base.world.close()


def test_plans_keep_off_and_say_what_is_in_the_way() -> None:
    base = behind_a_wall(BACKENDS[0], y=2.4)
    planner = BasePlanner(base.world, MAP)
    path = planner.plan(torch.zeros(2), torch.tensor([0.6, -1.5]))  # under the lintel
    assert len(path) == 2
    with pytest.raises(PlanningError, match=r"no way of 0.9 m width leads .* goal \(2.60, 0.30\): 'wall' stands"):
        planner.plan(torch.zeros(2), torch.tensor([2.6, 0.3]))
    with pytest.raises(PlanningError, match=r"goal \(1.00, 0.00\) is within its radius of 0.45 m of 'wall'"):
        planner.plan(torch.zeros(2), torch.tensor([1.0, 0.0]))
    with pytest.raises(PlanningError, match=r"start \(9.00, 0.00\) is off the map"):
        planner.plan(torch.tensor([9.0, 0.0]), torch.zeros(2))
    with pytest.raises(ConfigurationError, match="above zero"):
        BasePlannerConfig(radius=0.0, height=0.4, low=(0.0, 0.0), high=(1.0, 1.0))
    follower = BasePathFollower("base", base.robot, BaseVelocityConfig())
    with pytest.raises(ConfigurationError, match="has no heading"):
        follower.load({0: path}, {})
    base.world.close()
