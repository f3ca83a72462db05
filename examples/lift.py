"""Lift in twenty lines: a Gymnasium vector environment, one reward term changed, the expert acting."""

import gymnasium

from orbit_core.envs import RewardTerm
from orbit_core.rollout.estimates import proportion
from orbit_tasks.lift import Lift, LiftRewards


def height(env):
    """(N,) metres of the cube above the table: any function of the environment is a term."""
    return env.world.objects["cube"].root_pose[:, 2]


rewards = LiftRewards(lift=RewardTerm(height, weight=30.0), joint_speed=None)
task = Lift(action="ik_relative", rewards=rewards)
env = gymnasium.make_vec("orbit_learn:orbit/Lift-v0", num_envs=16, backend="mujoco", task=task)
expert = env.unwrapped.environment.expert()
observation, _ = env.reset(seed=0)  # {"policy": tensor (16, 38)}
for _ in range(250):
    action = expert.compute({})["action"]  # (16, 7) in [-1, 1]; put your policy's here
    observation, reward, terminated, truncated, info = env.step(action)
success = info["final_info"]["success"]
print("success rate", proportion(int(success.sum()), len(success)).percent())
env.close()
