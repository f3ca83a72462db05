"""What action spaces cost over joint positions, in the whole step of a task.

    python benchmarks/motion_costs.py --backend mujoco --envs 64
    python benchmarks/motion_costs.py --backend warp --device cuda --envs 4096

Steps are compiled, and on a GPU captured in a CUDA graph. Random actions, resets included. On a CPU the time is the
own time of the process, on a GPU that of the wall. The action spaces take turns, so that what else the machine does
meets all alike. Prints a table in Markdown: ms a step, the median of the turns, and the share over the first one.
"""

from __future__ import annotations

import argparse
import time

import torch

from orbit_core.envs import Environment, make

BASELINE = "joint_position"
ACTIONS = ("osc", "impedance", "hybrid", "joint_impedance", "rmpflow", "differential_ik", "qp_ik")


def prepared(arguments: argparse.Namespace, action: str) -> tuple[Environment, torch.Tensor]:
    """An environment whose step is compiled and warm, and actions for it."""
    env = make(
        arguments.task, arguments.envs, backend=arguments.backend, device=arguments.device,
        compile=arguments.compile, action=action,
    )  # fmt: skip
    env.reset()
    random = torch.Generator().manual_seed(0)
    actions = (2.0 * torch.rand(64, arguments.envs, env.action_size, generator=random) - 1.0).to(env.device)
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
    arguments = parser.parse_args()
    names = [BASELINE, *arguments.actions]
    environments = {name: prepared(arguments, name) for name in names}
    times: dict[str, list[float]] = {name: [] for name in names}
    for _ in range(arguments.turns):
        for name in names:
            times[name].append(turn(*environments[name], arguments.steps))
    medians = {name: sorted(values)[len(values) // 2] for name, values in times.items()}
    print("| action space | ms a step | over joint positions |\n|---|---|---|")
    for name, value in medians.items():
        print(f"| `{name}` | {value:.2f} | {100 * (value / medians[BASELINE] - 1):.0f} % |")


if __name__ == "__main__":
    main()
