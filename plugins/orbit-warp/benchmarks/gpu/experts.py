"""Success of each task's expert over one episode in every environment, on one device."""

from __future__ import annotations

import argparse

import torch

from orbit_core.envs import make
from orbit_core.rollout.estimates import proportion


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--num-envs", type=int, default=256)
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--tasks", nargs="+", default=["Reach", "Lift", "Cabinet", "Velocity-Flat"])
    arguments = parser.parse_args()
    for task in arguments.tasks:
        environment = make(task, num_envs=arguments.num_envs, backend=arguments.backend, device=arguments.device)
        expert = environment.expert()
        environment.reset(seed=0)
        ends = []
        for _ in range(environment.max_episode_steps):
            *_, info = environment.step(expert.compute({})["action"])
            ends += [info["final"]] if "final" in info else []
        success = torch.cat([end.success for end in ends])
        rate = proportion(int(success.sum()), len(success)).percent()
        metrics = {name: torch.cat([end.metrics[name] for end in ends]).mean().item() for name in ends[0].metrics}
        print(f"{task}: success {rate} of {len(success)} episodes; means {metrics}", flush=True)
        environment.close()


if __name__ == "__main__":
    main()
