"""A kept policy walks a robot as it is commanded, at its own rate, in a task of any rate."""

from __future__ import annotations

import pytest
import torch

from orbit_core.actions import ActionTerms
from orbit_core.dynamics.transforms import quat_rotate_inverse
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_tasks.locomotion import LocomotionConfig
from tests.motion.servo_world import BACKENDS, held

WANTED = torch.tensor([[0.6, 0.0, 0.0], [0.0, 0.6, 0.0], [0.3, 0.0, 0.7], [-0.5, 0.0, -0.5]])


def walked(backend: str, **fields: float) -> torch.Tensor:
    """(4, 3) mean velocity of the trunk in its own axes over the last of four seconds, in units of command."""
    walk = ActionTerms(walk=LocomotionConfig())
    env = make("Velocity-Flat", num_envs=4, backend=backend, actions=walk, seed=1, **fields)
    env.reset()
    robot, steps = env.world.robots["robot"], round(4.0 / env.step_dt)
    seen = []
    for step in range(steps):
        env.step(WANTED)
        if step >= 3 * steps // 4:
            velocity = robot.root_velocity
            along = quat_rotate_inverse(robot.root_pose[:, 3:], velocity[:, :3])
            seen.append(torch.cat((along[:, :2], velocity[:, 5:]), 1))
    env.close()
    return torch.stack(seen).mean(0) / torch.tensor([1.0, 0.5, 1.0])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_robot_walks_as_commanded(backend: str) -> None:
    torch.testing.assert_close(walked(backend), WANTED, atol=0.2, rtol=0.0)


@pytest.mark.parametrize("decimation", [1, 2, 8])
def test_the_policy_keeps_its_own_rate_whatever_the_tasks(decimation: int) -> None:
    same = walked(BACKENDS[0])
    torch.testing.assert_close(walked(BACKENDS[0], decimation=decimation), same, atol=0.1, rtol=0.0)


def test_a_policy_that_does_not_fit_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'velocity_flat'"):
        held(LocomotionConfig(policy="velocity_flta"), BACKENDS[0], name="anymal_c")
    with pytest.raises(ConfigurationError, match=r"policy 'reach' of task Reach sees '.*', which a robot alone"):
        held(LocomotionConfig(policy="reach"), BACKENDS[0], name="anymal_c")
    with pytest.raises(ConfigurationError, match="learned with robot 'anymal_c', of which 'joint_positions' has 12"):
        held(LocomotionConfig(), BACKENDS[0])
    with pytest.raises(ConfigurationError, match="learned with robot 'unitree_go2', which has no joint 'LF_HAA'"):
        held(LocomotionConfig(policy="velocity_flat_go2"), BACKENDS[0], name="anymal_c")
