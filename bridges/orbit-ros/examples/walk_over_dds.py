"""Walk with a Go2 over Unitree's low-level messages, with the policy that ORBIT keeps.

Start a simulated one first, or name the interface of a real one::

    orbit robot --task Velocity-Flat --set robot=unitree_go2 --bridge unitree --port 1 --direct --realtime
    python bridges/orbit-ros/examples/walk_over_dds.py unitree://127.0.0.1:1/go2 10
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
import torch

from orbit_core.cli.making import make_actor
from orbit_core.envs import Environment, TerminationTerm, make
from orbit_core.mdp import common
from orbit_core.scene import Scene
from orbit_deploy import PathKind, connect, robot_world
from orbit_deploy.realtime import prioritized
from orbit_tasks import walking
from orbit_tasks.velocity_flat import VelocityFlat, VelocityMemory, projected_gravity


class WalkState(VelocityMemory):
    """State of a walk without contacts, which a robot's computer does not measure."""

    def start(self, env: Environment[Any, Any]) -> None:
        walking.SpeedLimited.start(self, env)


def leans(env: Environment[Any, Any]) -> torch.Tensor:
    """(N,) the trunk leans by more than 60 degrees."""
    return projected_gravity(env)[:, 2] > -0.5


@dataclass(kw_only=True)
class Walk(VelocityFlat):
    """Task of the policy, with what a robot measures and without rewards, which are for learning."""

    state_type: ClassVar[type[VelocityMemory]] = WalkState  # pyright: ignore[reportIncompatibleVariableOverride]

    def __post_init__(self) -> None:
        for term in fields(self.rewards):
            setattr(self.rewards, term.name, None)
        self.terminations.fallen = TerminationTerm(leans)
        self.events.place_robot = None
        self.curriculum.skill = None

    def scene(self) -> Scene:
        robot = walking.walker(self.robot, self.action_scale)
        return Scene(robots=(robot,), terrain=(common.floor(),), physics_dt=self.physics_dt)


def main(address: str, seconds: float) -> None:
    """Walk forward at 0.6 m/s, and print how far the robot came and how late commands were."""
    torch.set_num_threads(1)
    task = Walk(robot="unitree_go2", episode_length=seconds + 60.0)
    period = task.physics_dt * task.decimation
    link = connect(address, period, path=PathKind.DIRECT)
    environment = make(task, 1, world=robot_world(link, period), seed=0)
    actor = make_actor("velocity_flat_go2", environment, 0)
    environment.reset(0)
    started = np.array(link.state().objects[0][:2])
    heights, steps = [], round(seconds / period)
    for _ in range(steps):
        environment.commands["velocity"][:, :3] = torch.tensor([0.6, 0.0, 0.0])
        environment.step(actor.act())
        heights.append(link.state().objects[0][2])
    state = link.state()
    way = float(np.linalg.norm(np.array(state.objects[0][:2]) - started))
    engine = environment.world.engine
    print(f"walked {way:.2f} m in {steps * period:g} s, trunk {min(heights):.3f} m above the floor at the lowest")
    print(f"{engine.times.overruns} of {steps} steps late, {state.stops} stops, {state.clamped} commands clamped")  # pyright: ignore[reportAttributeAccessIssue]
    print(f"from command to motor message: {link.round_trips} (p50/p99/p99.9)")
    link.stop()
    environment.close()


if __name__ == "__main__":
    # Before there are threads, which inherit the priority
    with prioritized():
        main(sys.argv[1], float(sys.argv[2]))
