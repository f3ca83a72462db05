"""Measures environments on one device: a whole step of a task, against captured stepping of the same model alone.

    python plugins/orbit-warp/benchmarks/gpu/bench.py --task Lift --num-envs 4096 16384 --action ik_relative

Each line is one size, random actions or a policy's (``--policy lift``), episodes of every age: rates are environment
steps per second, medians over blocks. ``alone`` is MuJoCo-Warp's own captured stepping: from the state that a block
began in, by the very commands that the environment gave; ``ratio`` is the median of the blocks' ratios.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import torch

from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_warp.native_baseline import raw_steppers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="Lift")
    parser.add_argument("--num-envs", type=int, nargs="+", default=[4096])
    parser.add_argument("--action")
    parser.add_argument("--robot")
    parser.add_argument("--policy", help="file or name of a kept policy that acts; without, actions are random")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--steps", type=int, default=200, help="environment steps of a block")
    parser.add_argument("--blocks", type=int, default=5)
    parser.add_argument("--warm", type=int, default=16, help="environment steps before the first block")
    parser.add_argument("--compile", action="store_true", help="compile the layer's part of the step, with Triton")
    parser.add_argument("--setting", action="append", default=[], help="of WarpConfig, as name=JSON")
    parser.add_argument("--profile", help="write a trace of ten steps here, and print the kernels that cost most")
    arguments = parser.parse_args()
    for num_envs in arguments.num_envs:
        print(json.dumps(measure(arguments, num_envs)), flush=True)


def measure(arguments: argparse.Namespace, num_envs: int) -> dict[str, object]:
    """Measure one number of environments."""
    settings = {name: json.loads(value) for name, _, value in (item.partition("=") for item in arguments.setting)}
    fields = fields_of(arguments)
    begun = time.perf_counter()
    environment = make(
        arguments.task,
        num_envs=num_envs,
        backend="warp",
        device=arguments.device,
        settings=settings,
        compile=arguments.compile,
        reset_diverged=True,
        **fields,
    )
    made = time.perf_counter() - begun
    environment.reset(seed=0)
    environment.state.episode_step.random_(environment.max_episode_steps)
    act = actor_of(arguments, environment)
    begun = time.perf_counter()
    environment.step(act(0))
    _wait(environment)
    first = time.perf_counter() - begun
    for k in range(arguments.warm):  # traces, compiles and records
        environment.step(act(k))
    _wait(environment)
    ready = time.perf_counter() - begun
    engine, decimation = environment.world.engine, environment.task.decimation
    (raw,) = raw_steppers(engine).values()  # pyright: ignore[reportArgumentType]
    raw.synchronize()
    raw.step(raw.command(), decimation)
    whole, alone, free = [], [], []
    commands: list[torch.Tensor] = []

    def step(k: int) -> None:
        environment.step(act(k))
        commands.append(raw.command())

    for _ in range(arguments.blocks):
        raw.synchronize()
        commands.clear()
        whole.append(_timed(environment, step, arguments.steps))
        alone.append(_timed(environment, lambda k: raw.step(commands[k], decimation), arguments.steps))
        free.append(torch.cuda.mem_get_info()[0] // 2**20 if environment.device.type == "cuda" else None)
    if arguments.profile:
        _profile(environment, act, arguments.profile)
    result = {
        "task": arguments.task,
        "robot": fields.get("robot"),
        "policy": arguments.policy,
        "settings": settings,
        "compile": arguments.compile,
        "num_envs": num_envs,
        "device": torch.cuda.get_device_name() if environment.device.type == "cuda" else "cpu",
        "env_steps_per_s": round(num_envs / statistics.median(whole)),
        "alone_per_s": round(num_envs / statistics.median(alone)),
        "ratio": round(statistics.median(a / w for a, w in zip(alone, whole, strict=True)), 3),
        "ratios": [round(a / w, 3) for a, w in zip(alone, whole, strict=True)],
        "spread": [round(max(times) / min(times), 3) for times in (whole, alone)],
        "made_s": round(made, 1),
        "first_step_s": round(first, 1),
        "ready_s": round(ready, 1),
        "device_memory_free_MiB": free,
        "buffers": str(engine.buffer_sizes),  # pyright: ignore[reportAttributeAccessIssue]
        "peaks": str(engine.buffer_peaks),  # pyright: ignore[reportAttributeAccessIssue]
        "diverged": environment.lost.count,  # pyright: ignore[reportOptionalMemberAccess]
        "overflows": engine.overflows,  # pyright: ignore[reportAttributeAccessIssue]
        "finite": bool(engine.link_poses.isfinite().all()),
    }
    environment.close()
    return result


def fields_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the task's fields that the policy or the command names."""
    fields: dict[str, Any] = {}
    if arguments.policy:
        from orbit_learn.policy import load_policy
        from orbit_learn.pretrained import policy_fields, policy_path

        learned = load_policy(policy_path(arguments.policy)).description
        fields = {"robot": learned.robot, "action": learned.action, **policy_fields(arguments.policy)}
    return fields | {name: value for name in ("action", "robot") if (value := getattr(arguments, name))}


def actor_of(arguments: argparse.Namespace, environment: Environment) -> Callable[[int], torch.Tensor]:
    """Return what gives the action of a step: the policy, or sixteen random actions in turn."""
    if arguments.policy:
        from orbit_learn.policy import PolicyActor
        from orbit_learn.pretrained import policy_path

        actor = PolicyActor(environment, policy_path(arguments.policy))

        def act(_: int) -> torch.Tensor:
            with torch.inference_mode():
                return actor.act().clone()

        return act
    shape = (16, environment.num_envs, environment.action_size)
    actions = torch.rand(shape, device=environment.device) * 2 - 1
    return lambda k: actions[k % 16]


def _timed(environment: Environment, step, steps: int) -> float:
    """Seconds per step."""
    _wait(environment)
    begun = time.perf_counter()
    for k in range(steps):
        step(k)
    _wait(environment)
    return (time.perf_counter() - begun) / steps


def _wait(environment: Environment) -> None:
    if environment.device.type == "cuda":
        torch.cuda.synchronize(environment.device)


def _profile(environment: Environment, act: Callable[[int], torch.Tensor], path: str) -> None:
    activities = [torch.profiler.ProfilerActivity.CPU, torch.profiler.ProfilerActivity.CUDA]
    with torch.profiler.profile(activities=activities) as profile:
        for k in range(10):
            environment.step(act(k))
        _wait(environment)
    profile.export_chrome_trace(path)
    print(profile.key_averages().table(sort_by="cuda_time_total", row_limit=25))


if __name__ == "__main__":
    main()
