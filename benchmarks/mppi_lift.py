"""How often sampled action sequences lift the cube, by the task's rewards alone.

    python benchmarks/mppi_lift.py --episodes 4

MPPI without an expert, a plan or a learned policy: each control step of each environment rolls out samples in copies of
its state. An episode succeeds as the task says: the cube is at its goal when the time is over.
"""

from __future__ import annotations

import argparse
import time

import torch

from orbit_core.envs import Environment, make
from orbit_motion.experts.mppi import Mppi, MppiConfig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--model", default="mujoco", help="backend of the samples")
    parser.add_argument("--device", default="cpu", help="of the samples")
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--samples", type=int, default=96)
    parser.add_argument("--horizon", type=int, default=20)
    parser.add_argument("--action", default="ik_relative")
    arguments = parser.parse_args()
    count = arguments.episodes
    real = make("Lift", count, backend=arguments.backend, action=arguments.action)
    model = make(
        "Lift", count * arguments.samples, backend=arguments.model, device=arguments.device, action=arguments.action
    )
    real.reset(seed=3)
    policy = Mppi(real, model, MppiConfig(horizon=arguments.horizon, noise=0.5, correlation=0.8))
    steps = round(real.task.episode_length / real.step_dt) - 1
    begin = time.perf_counter()
    with torch.inference_mode():
        for step in range(1, steps + 1):
            real.step(policy.compute({})["action"])
            if step % 25 == 0 or step == steps:
                seconds = (time.perf_counter() - begin) / step
                print(f"step {step} of {steps}: {_reached(real)}, {seconds:.2f} s a control step of all", flush=True)
    print(f"{arguments.samples} samples of {arguments.horizon} steps: {_reached(real)}")


def _reached(environment: Environment) -> str:
    heights = environment.world.objects["cube"].root_pose[:, 2]
    succeeded = int(environment.task.success(environment).sum())
    return f"{succeeded} of {environment.num_envs} at the goal, {int((heights > 0.06).sum())} off the table"


if __name__ == "__main__":
    main()
