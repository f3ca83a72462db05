"""What action spaces cost over joint positions, in the whole step of a task.

    python benchmarks/motion_costs.py --backend mujoco --envs 64
    python benchmarks/motion_costs.py --backend warp --device cuda --envs 4096 --json costs.json

Steps are compiled, and on a GPU captured in a CUDA graph. Resets included. Each action space has a process of its own;
all compile at once, and then they take turns, one at a time, so that what else the machine does meets all alike. On a
CPU the time is the own time of the process, on a GPU that of the wall. Prints a table in Markdown: ms a step, the
median of the turns and their range, the share over the first one, and how many operations of arithmetic for each
environment the law's own kernel has, or why there is none.

Every random action is followed by its negative, so that relative commands lead nowhere. Where they add up, with
`--wander`, hands come to press on the table, and engines that iterate until the last environment converges take three
times as long for it, whatever moved the hands there. `--kernels 12` also tells which kernels a GPU's time goes to.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
import traceback
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import torch

from orbit_core.envs import Environment, make
from orbit_motion.fusion import Fused

BASELINE = "joint_position"
ACTIONS = ("rmpflow", "osc", "impedance", "hybrid", "joint_impedance", "differential_ik", "qp_ik", "full_ik")


def prepared(arguments: argparse.Namespace, action: str) -> tuple[Environment, torch.Tensor]:
    """An environment whose step is compiled and warm, and actions for it."""
    env = make(
        arguments.task, arguments.envs, backend=arguments.backend, device=arguments.device,
        compile=arguments.compile, action=action,
    )  # fmt: skip
    env.reset()
    random = torch.Generator().manual_seed(0)
    actions = 2.0 * torch.rand(64, arguments.envs, env.action_size, generator=random) - 1.0
    if not arguments.wander:
        actions[1::2] = -actions[::2]
    actions = (arguments.spread * actions).to(env.device)
    for step in range(20):
        env.step(actions[step])
    return env, actions


def turn(env: Environment, actions: torch.Tensor, steps: int) -> float:
    """ms a step."""
    on_cpu = env.device.type == "cpu"
    clock = time.process_time if on_cpu else time.perf_counter
    if not on_cpu:
        torch.cuda.synchronize()
    begin = clock()
    for step in range(steps):
        env.step(actions[step % len(actions)])
    if not on_cpu:
        torch.cuda.synchronize()
    return 1e3 * (clock() - begin) / steps


def busiest(env: Environment, actions: torch.Tensor, count: int, steps: int = 20) -> dict[str, list[float]]:
    """The kernels that a GPU spends most time in: ms and launches a step, by name."""
    from torch.profiler import ProfilerActivity, profile

    with profile(activities=[ProfilerActivity.CUDA]) as told:
        turn(env, actions, steps)
    events = sorted(told.key_averages(), key=lambda event: -event.self_device_time_total)
    return {event.key: [1e-3 * event.self_device_time_total / steps, event.count / steps] for event in events[:count]}


def kernels(env: Environment) -> str:
    """What became of the generators' own kernels."""
    parts = {
        id(part): part for node in env.actions.generators for part in vars(node).values() if isinstance(part, Fused)
    }
    return ", ".join(part.refusal or f"{part.operations} operations" for part in parts.values())


def work(arguments: argparse.Namespace, action: str, line: Connection) -> None:
    """In a process: build, tell, and time each turn that is asked for."""
    torch.set_num_threads(1)
    try:
        begin = time.perf_counter()
        env, actions = prepared(arguments, action)
        line.send({"built_s": time.perf_counter() - begin, "kernels": kernels(env)})
        while line.recv():
            line.send(turn(env, actions, arguments.steps))
        line.send(busiest(env, actions, arguments.kernels) if arguments.kernels else {})
    except EOFError:
        return
    except Exception:
        line.send({"error": traceback.format_exc()})


def told(line: Connection) -> Any:
    """What a process sends, or the error that it ended with."""
    try:
        return line.recv()
    except (EOFError, OSError):
        return {"error": "the process ended by itself"}


def measured(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Results of each action space, by name, written after each turn; one that fails stops no other."""
    names, context = list(dict.fromkeys((BASELINE, *arguments.actions))), get_context("spawn")
    lines: dict[str, Any] = {}
    workers = []
    for name in names:
        lines[name], other = context.Pipe()
        workers.append(context.Process(target=work, args=(arguments, name, other), daemon=True))
        workers[-1].start()
        other.close()
        if arguments.one_at_a_time:
            lines[name].poll(None)
    results: dict[str, dict[str, Any]] = {name: {"times": []} for name in names}
    for name in names:
        results[name].update(told(lines[name]))
        print(f"{name}: {results[name].get('error') or results[name]}", file=sys.stderr, flush=True)
    for asked in [True] * arguments.turns + [False]:
        for name in names:
            if "error" in results[name]:
                continue
            lines[name].send(asked)
            answer = told(lines[name])
            if isinstance(answer, float):
                results[name]["times"].append(answer)
            else:
                results[name].update(answer if "error" in answer else {"busiest": answer})
        write(arguments, results)
    for worker in workers:
        worker.join(10.0)
    return results


def write(arguments: argparse.Namespace, results: dict[str, dict[str, Any]]) -> None:
    """All numbers so far into the file that was asked for."""
    if arguments.json is not None:
        cuda = torch.cuda.get_device_name() if arguments.device != "cpu" else ""
        settings = {key: str(value) for key, value in vars(arguments).items()}
        arguments.json.write_text(json.dumps({"device": cuda, **settings, "results": results}, indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="Lift")
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--actions", nargs="+", default=list(ACTIONS))
    parser.add_argument("--steps", type=int, default=50, help="of one turn")
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--compile", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--spread", type=float, default=1.0, help="of the random actions; with 0 arms hold still")
    parser.add_argument("--wander", action="store_true", help="random actions that nothing takes back")
    parser.add_argument("--kernels", type=int, default=0, help="so many kernels of a GPU's are told of")
    parser.add_argument("--one-at-a-time", action="store_true", help="build one after the other: for few cores")
    parser.add_argument("--json", type=Path, help="file for all numbers")
    arguments = parser.parse_args()
    results = measured(arguments)
    baseline = results[BASELINE]["times"] or [math.nan] * arguments.turns
    print("| action space | ms a step | turns | over joint positions | the law's kernel |\n|---|---|---|---|---|")
    for name, result in results.items():
        if "error" in result:
            print(f"| `{name}` | - | - | - | {result['error'].strip().splitlines()[-1]} |")
            continue
        result["ms"] = sorted(result["times"])[len(result["times"]) // 2]
        shares = sorted(a / b - 1.0 for a, b in zip(result["times"], baseline, strict=False))
        result["share"] = shares[len(shares) // 2]
        turns = f"{min(result['times']):.2f} to {max(result['times']):.2f}"
        print(f"| `{name}` | {result['ms']:.2f} | {turns} | {100 * result['share']:.0f} % | {result['kernels']} |")
    for name, result in results.items():
        for kernel, (ms, launches) in result.get("busiest", {}).items():
            print(f"{name}: {ms:.4f} ms in {launches:g} launches a step: {kernel[:120]}")
    write(arguments, results)


if __name__ == "__main__":
    main()
