"""Count the Python calls that one environment step makes.

python benchmarks/step_calls.py --task Lift --backend mujoco
python benchmarks/step_calls.py --task Lift --action ik_relative --backend bullet --list
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import torch
import tyro

from orbit_core.backends import default_backend
from orbit_core.cli.output import console, new_table
from orbit_core.envs import make

_WARM_STEPS = 8
_OWN = ("orbit_", "orbit-")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Count the Python calls of one uncompiled step in which no episode ends."""

    task: str = "Lift"
    """Name of the task."""
    action: str | None = None
    """Name of the action space; the task's own if None."""
    backend: str | None = None
    """Name of the backend; the default one if None."""
    num_envs: int = 16
    """Environments stepped together."""
    list: bool = False
    """Print each function with its number of calls."""


@dataclass
class StepCalls:
    """Python calls of one step."""

    functions: Counter[CodeType] = field(default_factory=Counter)
    depth: int = 0
    """Deepest stack below ``env.step``."""

    @property
    def files(self) -> dict[str, int]:
        """Calls by file."""
        counts: Counter[str] = Counter()
        for code, calls in self.functions.items():
            counts[code.co_filename] += calls
        return dict(counts.most_common())


def count(settings: Settings) -> StepCalls:
    """Step an environment until all caches are filled, then count the calls of one step.

    Args:
        settings: task and backend to step.

    Returns:
        calls of Python functions, those of torch and the engine's binding included.
    """
    fields: dict[str, Any] = {} if settings.action is None else {"action": settings.action}
    backend = settings.backend or default_backend()
    environment = make(settings.task, settings.num_envs, backend=backend, **fields)
    try:
        action = torch.zeros(settings.num_envs, environment.action_size)
        for _ in range(_WARM_STEPS):
            environment.step(action)
        return _profiled(environment.step, action)
    finally:
        environment.close()


def _profiled(step: Any, action: torch.Tensor) -> StepCalls:
    calls, depth = StepCalls(), 0

    def note(frame: FrameType, event: str, _: object) -> None:
        nonlocal depth
        if event == "call":
            depth += 1
            calls.functions[frame.f_code] += 1
            calls.depth = max(calls.depth, depth)
        elif event == "return":
            depth -= 1

    # Generators and comprehensions count as calls: they cost one. C functions do not: torch's operations are the work.
    sys.setprofile(note)
    try:
        step(action)
    finally:
        sys.setprofile(None)
    return calls


def main(settings: Settings) -> None:
    """Print the calls of a step, and where they go."""
    calls = count(settings)
    out = console()
    out.print(
        f"{settings.task}: {calls.functions.total()} Python calls of {len(calls.functions)} functions in "
        f"{len(calls.files)} files, {calls.depth} deep"
    )
    table = new_table("calls", "file")
    for file, number in calls.files.items():
        table.add_row(str(number), _short(file))
    out.print(table)
    if settings.list:
        table = new_table("calls", "function", "file")
        for code, number in calls.functions.most_common():
            table.add_row(str(number), code.co_qualname, f"{_short(code.co_filename)}:{code.co_firstlineno}")
        out.print(table)


def _short(file: str) -> str:
    parts = Path(file).parts
    own = [i for i, part in enumerate(parts) if part.startswith(_OWN)]
    return "/".join(parts[own[0] :] if own else parts[-3:])


if __name__ == "__main__":
    main(tyro.cli(Settings))
