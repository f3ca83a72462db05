"""What engines make of one walker: how its feet slip and sink, how its joints lag, how fast they run.

    python tools/walker_differences.py --backend sapien
    python tools/walker_differences.py --backend mujoco --friction 0.3 --stiffness 0.7 --damping 3

A line of JSON: a kept policy walks by the same commands whatever the engine, and with the parameters given, so that
ranges that randomisation draws from can be held against how engines differ.
"""

from __future__ import annotations

import argparse
import json

import torch
from torch import Tensor

from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_learn.policy import load_policy
from orbit_learn.pretrained import policy_path
from orbit_tasks.biped import contacts_of

FOOT = 0.022
"""Metres: the radius of a Go2's foot."""
FIRST = 50
"""Steps that do not count: the robot gets up to speed."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--num-envs", type=int, default=16)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--friction", type=float, default=1.0, help="of feet and ground")
    parser.add_argument("--stiffness", type=float, default=1.0, help="of the drives, over their own")
    parser.add_argument("--damping", type=float, default=1.0, help="of the drives, over their own")
    parser.add_argument("--setting", action="append", default=[], help="of the backend, as name=JSON")
    arguments = parser.parse_args()
    settings = {name: json.loads(value) for name, _, value in (item.partition("=") for item in arguments.setting)}
    environment = make(
        "Velocity-Flat", arguments.num_envs, arguments.backend, robot="unitree_go2", settings=settings, seed=0
    )
    environment.reset(seed=0)
    _change(environment, arguments.friction, arguments.stiffness, arguments.damping)
    print(json.dumps({**vars(arguments), **_measured(environment, arguments.steps)}))
    environment.close()


def _change(environment: Environment, friction: float, stiffness: float, damping: float) -> None:
    world, robot = environment.world, environment.world.robots["robot"]
    everywhere = torch.full((world.num_envs, len(robot.link_names)), friction)
    robot.set_friction(everywhere)
    world.set_terrain_friction(everywhere[:, 0])
    joints = list(robot.nominal_gains)
    own = torch.tensor([robot.nominal_gains[joint] for joint in joints]).expand(world.num_envs, -1, -1)
    robot.set_gains(stiffness * own[..., 0], damping * own[..., 1], joints)


def _measured(environment: Environment, steps: int) -> dict[str, float]:
    world, robot = environment.world, environment.world.robots["robot"]
    task, policy = environment.task, load_policy(policy_path("velocity_flat_go2"))
    seen = environment.observe()["policy"]
    slips, sinks, lags, speeds = list[Tensor](), list[Tensor](), list[Tensor](), list[Tensor]()
    for step in range(steps):
        action = policy.module(seen).detach()
        seen = environment.step(action)[0]["policy"]
        if step < FIRST:
            continue
        touching = contacts_of(world).in_contact()[:, task.foot_links]  # pyright: ignore[reportAttributeAccessIssue]
        feet = robot.spec.feet
        along = torch.stack([robot.frame_velocity(foot)[:, :2].norm(dim=1) for foot in feet], 1)
        low = torch.stack([FOOT - robot.frame_pose(foot)[:, 2] for foot in feet], 1)
        slips.append(along[touching])
        sinks.append(low[touching])
        lags.append((robot.home_positions + 0.5 * action.clamp(-1.0, 1.0) - robot.joint_positions).square().mean(1))
        speeds.append(robot.joint_velocities.abs().amax(1))
    slip, sink, speed = torch.cat(slips), torch.cat(sinks), torch.cat(speeds)
    return {
        "slip_median_m_s": _rounded(slip.quantile(0.5)),
        "slip_90_m_s": _rounded(slip.quantile(0.9)),
        "sink_median_mm": _rounded(1e3 * sink.quantile(0.5)),
        "sink_99_mm": _rounded(1e3 * sink.quantile(0.99)),
        "lag_rad": _rounded(torch.cat(lags).mean().sqrt()),
        "joint_speed_median_rad_s": _rounded(speed.quantile(0.5)),
        "joint_speed_99_rad_s": _rounded(speed.quantile(0.99)),
    }


def _rounded(value: Tensor) -> float:
    return round(float(value), 4)


if __name__ == "__main__":
    main()
