"""Measures whole steps of tasks with cloth and rope: physics, matter and the task's own code together.

    python plugins/orbit-matter/benchmarks/speed.py Cloth-Lifting Rope-Reshaping --num-envs 64 1024 --compile

Each line is one task and size: environment steps per second, the median over blocks, after steps that trace, compile
and record; seconds until the first step was done, kernels compiled; and what the device's memory lost since the start.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from typing import Any

import torch

from orbit_core.envs import make
from orbit_core.envs.actors import Actor, scripted_actor
from orbit_core.envs.environment import Environment


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="+")
    parser.add_argument("--num-envs", type=int, nargs="+", default=[1024])
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--agent", choices=("zero", "random", "expert"), default="zero")
    parser.add_argument("--steps", type=int, default=60, help="environment steps of a block")
    parser.add_argument("--blocks", type=int, default=5)
    parser.add_argument("--compile", action="store_true", help="compile the layer's part of the step")
    parser.add_argument("--profile", action="store_true", help="print the kernels that cost most in ten steps")
    parser.add_argument("--setting", action="append", default=[], help="of orbit-matter, as name=JSON")
    parser.add_argument("--field", action="append", default=[], help="of all tasks, as name=JSON")
    arguments = parser.parse_args()
    for task in arguments.tasks:
        for num_envs in arguments.num_envs:
            print(json.dumps(measure(arguments, task, num_envs)), flush=True)


def _values(items: list[str]) -> dict[str, Any]:
    """Return values by name of items such as ``name=JSON``."""
    return {name: json.loads(value) for name, _, value in (item.partition("=") for item in items)}


def measure(arguments: argparse.Namespace, task: str, num_envs: int) -> dict[str, object]:
    """Measure one task at one number of environments."""
    settings, fields = _values(arguments.setting), _values(arguments.field)
    free, begun = _free(arguments.device), time.perf_counter()
    environment = make(
        task,
        num_envs=num_envs,
        backend=arguments.backend,
        device=arguments.device,
        compile=arguments.compile,
        matter_settings=settings,
        **fields,
    )
    agent = scripted_actor(arguments.agent, environment, 0)
    environment.step(agent.act())
    _wait(environment)
    ready = time.perf_counter() - begun
    for _ in range(10):
        environment.step(agent.act())
    blocks = [_seconds(environment, agent, arguments.steps) for _ in range(arguments.blocks)]
    left = _free(arguments.device)
    if arguments.profile:
        _profile(environment, agent)
    environment.close()
    return {
        "task": task,
        "num_envs": num_envs,
        "backend": arguments.backend,
        "device": torch.cuda.get_device_name() if free else "cpu",
        "agent": arguments.agent,
        "compile": arguments.compile,
        "env_steps_per_s": round(num_envs * arguments.steps / statistics.median(blocks)),
        "blocks_per_s": [round(num_envs * arguments.steps / seconds) for seconds in blocks],
        "ready_s": round(ready, 1),
        "memory_MiB": free - left,
    }


def _seconds(environment: Environment, agent: Actor, steps: int) -> float:
    _wait(environment)
    begun = time.perf_counter()
    for _ in range(steps):
        environment.step(agent.act())
    _wait(environment)
    return time.perf_counter() - begun


def _profile(environment: Environment, agent: Actor) -> None:
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    with torch.profiler.profile(activities=activities) as profile:
        _seconds(environment, agent, 10)
    print(profile.key_averages().table(sort_by="cuda_time_total", row_limit=25))


def _wait(environment: Environment) -> None:
    if environment.device.type == "cuda":
        torch.cuda.synchronize(environment.device)


def _free(device: str) -> int:
    """MiB of the device's memory; 0 on a CPU."""
    return torch.cuda.mem_get_info(device)[0] // 2**20 if device.startswith("cuda") else 0


if __name__ == "__main__":
    main()
