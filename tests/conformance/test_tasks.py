"""Experts on what the quick run of the suite, which has every task on two backends, leaves out."""

from __future__ import annotations

import pytest
import torch

from orbit_core.backends import backend_names
from orbit_core.envs import make

QUICK = ("mujoco", "sapien")
"""The backends of ``make conformance``."""
EXPERTS = [("Lift", "franka_panda", "ik_relative"), ("Cabinet", "franka_panda", "ik_relative")]
"""Task, robot and action space, on every other backend: something is grasped, something moves on joints."""
VARIANTS = [
    ("Reach", "franka_panda", "ik_absolute"),
    ("Lift", "ur10_robotiq_2f85", "ik_relative"),
    ("Reach", "franka_panda", "joint_position"),
    ("Lift", "franka_panda", "ik_absolute"),
    ("Reach", "ur10_robotiq_2f85", "ik_relative"),
    ("Lift", "franka_panda", "joint_position"),
]
"""Other robots and actions, in which engines are all the same to the core: each on one, all engines in turn."""
TRIED = [(name, *expert) for name in backend_names() if name not in QUICK for expert in EXPERTS]
TRIED += [(backend_names()[n % len(backend_names())], *variant) for n, variant in enumerate(VARIANTS)]


@pytest.mark.parametrize(("backend", "task", "robot", "action"), TRIED)
def test_the_expert_succeeds(backend: str, device: torch.device, task: str, robot: str, action: str) -> None:
    environment = make(task, 4, backend, device, seed=0, robot=robot, action=action)
    expert = environment.expert()
    environment.reset(seed=0)
    ends = []
    for _ in range(environment.max_episode_steps):
        *_, info = environment.step(expert.compute({})["action"])
        ends += [info["final"]] if "final" in info else []
    success = torch.cat([end.success for end in ends]).float().mean()
    environment.close()
    assert success >= 0.75


@pytest.mark.parametrize("backend", backend_names())
def test_the_gait_follows_its_commands(backend: str, device: torch.device) -> None:
    environment = make("Velocity-Flat", 6, backend, device, seed=0, episode_length=5.0, robot="unitree_go1")
    gait = environment.expert()
    environment.reset(seed=0)
    for _ in range(environment.max_episode_steps):
        *_, info = environment.step(gait.compute({})["action"])
    metrics = info["final"].metrics
    environment.close()
    assert len(metrics["falls"]) == 6, "none has fallen before"
    assert not metrics["falls"].any()
    assert metrics["linear_error_m_s"].mean() < 0.15
    # SAPIEN finds contacts 1 mm ahead, so that the feet of this gait strike the ground harder there (docs/legs.md).
    assert metrics["yaw_rate_error_rad_s"].mean() < (0.25 if backend == "sapien" else 0.15), "its sway is taken back"


@pytest.mark.parametrize("backend", backend_names())
def test_the_gait_of_slow_joints_does_not_fall(backend: str, device: torch.device) -> None:
    environment = make("Velocity-Flat", 3, backend, device, seed=0, robot="anymal_c")
    gait = environment.expert()
    environment.reset(seed=0)
    commands = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.5, 0.0]], device=device)
    for _ in range(140):
        environment.commands["velocity"].copy_(commands)
        _, _, terminated, *_ = environment.step(gait.compute({})["action"])
        assert not terminated.any()
    environment.close()
