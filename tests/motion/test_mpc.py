"""Model-predictive control: hands that arms and bases bring to their goals, trunks over feet, what is refused."""

from __future__ import annotations

import pytest
import torch

from orbit_core.dynamics.transforms import pose_error
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import Plane, Shape
from orbit_motion.mpc import Gait, HandMpcConfig, Plan, Predictive, TrunkMpc, TrunkMpcConfig, stance_at
from tests.motion.servo_world import BACKENDS, Held, held

pytest.importorskip(
    "crocoddyl", reason="the optimal control solver is not installed (docs/motion-generators.md says how)"
)
GROUND = (Shape(Plane()),)


def predictive(arm: Held) -> Predictive:
    assert isinstance(arm.generator, Predictive)
    return arm.generator


@pytest.mark.parametrize("backend", BACKENDS)
def test_base_and_arm_bring_the_hand_to_a_goal_beyond_the_arms_reach(backend: str) -> None:
    arm = held(HandMpcConfig(), backend, name="base_omni_franka_panda", num_envs=1, physics_dt=0.005)
    mpc, command = predictive(arm), torch.tensor([1.0, -0.9, -0.3, 0.0, 0.1, 0.0])
    goal = torch.as_tensor(mpc.goal(command[None]), dtype=torch.float32)[None]
    fastest = torch.as_tensor(mpc.limits.velocity, dtype=torch.float32)
    for _ in range(16):
        arm.run(command, 20)
        assert not mpc.problem
        assert float((mpc.velocities.abs() / fastest).max()) < 1.1
    error = pose_error(arm.hand(), goal)[0]
    assert float(error[:3].norm()) < 0.015
    assert float(error[3:].norm()) < 0.05
    assert arm.robot.joint_positions[0, :2].norm() > 0.1  # the base has done its part
    arm.world.close()


@pytest.mark.parametrize(("name", "backend"), [("unitree_go2", BACKENDS[0]), ("anymal_c", BACKENDS[-1])])
def test_a_trunk_is_brought_to_poses_over_standing_feet(name: str, backend: str) -> None:
    legged = held(TrunkMpcConfig(), backend, name=name, num_envs=1, physics_dt=0.005, terrain=GROUND)
    mpc = predictive(legged)
    legged.run(torch.zeros(6), 40)  # it comes to stand
    feet = torch.stack([legged.robot.frame_pose(foot)[0, :2] for foot in legged.robot.spec.feet])
    command = torch.tensor([0.2, 0.2, -0.3, 0.0, 0.3, 0.2])
    legged.run(command, 100)
    goal = torch.as_tensor(mpc.goal(command[None]), dtype=torch.float32)[None]
    error = pose_error(legged.robot.frame_pose(mpc.config.frame_of(legged.robot)), goal)[0]
    assert not mpc.problem
    assert float(error[:3].norm()) < 0.03
    assert float(error[3:].norm()) < 0.05
    stood = torch.stack([legged.robot.frame_pose(foot)[0, :2] for foot in legged.robot.spec.feet])
    assert float((stood - feet).norm(dim=1).max()) < 0.03
    legged.world.close()


def test_a_quadruped_trots_in_place() -> None:
    gait = Gait(phases=((0.2, (0, 3)), (0.1, ()), (0.2, (1, 2)), (0.1, ())), step_height=0.04)
    legged = held(
        TrunkMpcConfig(gait=gait), BACKENDS[0], name="unitree_go2", num_envs=1, physics_dt=0.005, terrain=GROUND
    )
    mpc, robot = predictive(legged), legged.robot
    highest = torch.zeros(4)
    for _ in range(12):
        legged.run(torch.zeros(6), 12)
        highest = highest.maximum(torch.stack([robot.frame_pose(foot)[0, 2] for foot in robot.spec.feet]))
        assert not mpc.problem
    goal = torch.as_tensor(mpc.goal(torch.zeros(1, 6)), dtype=torch.float32)[None]
    error = pose_error(robot.frame_pose(mpc.config.frame_of(robot)), goal)[0]
    assert float(error[:3].norm()) < 0.05
    assert float(error[3:].norm()) < 0.15
    assert float(highest.min()) > 0.035  # each foot was in the air; on the ground its middle is at 0.022
    legged.world.close()


def test_what_a_command_asks_for_encode_gives_back() -> None:
    legged = held(TrunkMpcConfig(), BACKENDS[0], name="unitree_go2", num_envs=1, physics_dt=0.005, terrain=GROUND)
    mpc = predictive(legged)
    assert isinstance(mpc, TrunkMpc)
    command = torch.tensor([[0.3, -0.2, 0.1, 0.2, -0.1, 0.4]])
    for _ in range(40):
        goal = torch.as_tensor(mpc.goal(command), dtype=torch.float32)[None]
    torch.testing.assert_close(mpc.encode(goal, torch.ones(1, dtype=torch.bool)), command, rtol=0.0, atol=1e-3)
    legged.world.close()


def test_it_holds_still_where_there_is_no_plan() -> None:
    arm = held(HandMpcConfig(), BACKENDS[0], num_envs=1, physics_dt=0.005)
    mpc = predictive(arm)
    before = arm.robot.joint_positions.clone()
    with pytest.warns(UserWarning, match="holds still: a command is not a number"):
        arm.run(torch.full((6,), torch.nan), 40)
    assert mpc.problem
    torch.testing.assert_close(arm.robot.joint_positions, before, rtol=0.0, atol=5e-3)
    arm.run(torch.tensor([0.2, 0.0, 0.0, 0.0, 0.0, 0.0]), 40)
    assert not mpc.problem
    arm.world.close()


def test_a_plan_says_which_limit_it_breaks() -> None:
    arm = held(HandMpcConfig(), BACKENDS[0], num_envs=1)
    limits = predictive(arm).limits
    home = arm.robot.home_positions[:7].double().numpy()[None]
    still = 0.0 * home
    assert limits.problem(home, still, still) == ""
    beyond, fast, strong = home.copy(), still.copy(), still.copy()
    beyond[0, 1], fast[0, 2], strong[0, 3] = 2.0, 5.0, 200.0
    assert "'panda_joint2' would pass its limit by" in limits.problem(beyond, still, still)
    assert "'panda_joint3' would move at" in limits.problem(home, fast, still)
    assert "'panda_joint4' would need" in limits.problem(home, still, strong)
    assert "not finite" in limits.problem(torch.nan * home, still, still)
    plan = Plan(home.repeat(3, 0), still.repeat(3, 0), still.repeat(2, 0), 0.1, (0.0, 0.0))
    assert (plan.at(9.0)[0] == home[0]).all()
    arm.world.close()


@pytest.mark.parametrize(
    ("term", "robot", "told"),
    [
        (TrunkMpcConfig(), "franka_panda", "no feet|fixed base"),
        (HandMpcConfig(rate=33.0), "franka_panda", "33 Hz do not fall on"),
        (HandMpcConfig(frame="elbow"), "franka_panda", "elbow"),
        (TrunkMpcConfig(gait=Gait(phases=((0.2, (7,)),))), "unitree_go2", "lifts feet"),
        (TrunkMpcConfig(gait=Gait(phases=((0.0, ()),))), "unitree_go2", "takes 0 s"),
    ],
)
def test_refusals(term: HandMpcConfig | TrunkMpcConfig, robot: str, told: str) -> None:
    with pytest.raises((ConfigurationError, UnknownNameError), match=told):
        held(term, BACKENDS[0], name=robot, num_envs=1)


def test_several_environments_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="plans for one environment and the world has 2"):
        held(HandMpcConfig(), BACKENDS[0], num_envs=2)


def test_gaits_repeat() -> None:
    gait = Gait(phases=((0.2, (0, 3)), (0.1, ())))
    assert stance_at(gait, 0.05) == ((0, 3), pytest.approx(0.25))
    assert stance_at(gait, 0.25)[0] == ()
    assert stance_at(gait, 0.35) == ((0, 3), pytest.approx(0.25))
