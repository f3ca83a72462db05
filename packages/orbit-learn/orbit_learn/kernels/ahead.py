"""Kernels of tasks compiled in a process of its own, which :mod:`orbit_learn.cli.cache` starts.

    python -m orbit_learn.kernels.ahead COMPILER ARCH THREADS TASK[:ROBOT] ...

Each task is made on the CPU and stepped twice; then its engine goes through a physics step once more as on a GPU.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import torch

from orbit_core.envs import make
from orbit_learn.kernels.compilers import KernelCompiler, kernel_compilers


def note_kernels(task: str, compiler: KernelCompiler, arch: int) -> None:
    """Go through all that a task's environments launch.

    Args:
        task: TASK or TASK:ROBOT.
        compiler: notes what is launched.
        arch: compute capability, such as 90.
    """
    name, _, robot = task.partition(":")
    fields: dict[str, Any] = {"robot": robot} if robot else {}
    with compiler.watching():
        environment = make(name, num_envs=2, backend=compiler.backend, **fields)
        for _ in range(2):
            environment.step(torch.zeros(2, environment.action_size))
        environment.reset(env_ids=torch.tensor([0]))
        compiler.rehearse(environment.world.engine, arch)
        environment.close()


def main(words: Sequence[str]) -> None:
    """Compile, by the words that the module's documentation names."""
    compiler, arch, threads = kernel_compilers().get(words[0])(), int(words[1]), int(words[2])

    def report(line: str) -> None:
        print(line, flush=True)

    torch.set_num_threads(1)
    for task in words[3:]:
        report(f"{task}: going through a step on the CPU ...")
        note_kernels(task, compiler, arch)
    compiler.compile(arch, threads, report)


if __name__ == "__main__":
    main(sys.argv[1:])
    sys.stdout.flush()
    # A compiler without a driver may not be able to clean up.
    os._exit(0)
