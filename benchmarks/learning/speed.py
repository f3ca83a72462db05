"""Collecting and learning in the steady state, by RSL-RL and by ORBIT's own PPO, in environments of one process.

    python benchmarks/learning/speed.py --tasks Lift Reach Velocity-Flat --json speed.json

Each task is a process of its own. In it every variant makes its environment, learns some iterations, and is timed over
the next ones: policies of all variants are then of one age, which matters because a policy makes contacts that random
actions do not. Rates are environment steps per second of whole iterations, medians; ``collect_ms`` and ``update_ms``
are medians of their parts.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "rsl-rl": ("rsl-rl", {}),
    "orbit": ("orbit", {}),
    "orbit tf32": ("orbit", {"precision": "tf32"}),
    "orbit bfloat16": ("orbit", {"precision": "bfloat16"}),
    "orbit bfloat16 compiled": ("orbit", {"precision": "bfloat16", "compile_update": True}),
}
"""Library and settings of each variant."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["Lift", "Reach", "Velocity-Flat"], help="TASK or TASK:ROBOT")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--warm", type=int, default=15, help="iterations before the timed ones")
    parser.add_argument("--timed", type=int, default=20, help="iterations that are timed")
    parser.add_argument("--setting", action="append", default=[], help="of the backend, as name=JSON")
    parser.add_argument(
        "--no-compile", dest="compile", action="store_false", help="leave the environment's step as it is"
    )
    parser.add_argument("--json", type=Path, help="figures are added here")
    parser.add_argument("--here", action="store_true", help="measure the one task in this process")
    arguments = parser.parse_args()
    if arguments.here:
        for variant in arguments.variants:
            figures = measure(arguments, arguments.tasks[0], variant)
            print(json.dumps(figures), flush=True)
            if arguments.json:
                with arguments.json.open("a") as file:
                    file.write(json.dumps(figures) + "\n")
        return
    for task in arguments.tasks:
        position = sys.argv.index("--tasks") if "--tasks" in sys.argv else None
        words = [word for i, word in enumerate(sys.argv[1:], 1) if position is None or not _of_tasks(i, position)]
        subprocess.run([sys.executable, __file__, "--here", *words, "--tasks", task], check=False)


def _of_tasks(i: int, position: int) -> bool:
    """Return True if word ``i`` is the option --tasks or one of its values."""
    values = next((k for k in range(position + 1, len(sys.argv)) if sys.argv[k].startswith("--")), len(sys.argv))
    return position <= i < values


def measure(arguments: argparse.Namespace, task: str, variant: str) -> dict[str, Any]:
    """Measure one variant."""
    import torch

    from orbit_core.envs import make
    from orbit_core.envs.registry import task_entry
    from orbit_learn.learners import trainer_type

    library, chosen = VARIANTS[variant]
    name, _, robot = task.partition(":")
    settings = {key: json.loads(value) for key, _, value in (item.partition("=") for item in arguments.setting)}
    fields = {**task_entry(name).task_type().metadata.training, **({"robot": robot} if robot else {})}
    begun = time.perf_counter()
    environment = make(
        name, arguments.num_envs, arguments.backend, device=arguments.device, settings=settings,
        compile=arguments.compile, reset_diverged=True, **fields,
    )  # fmt: skip
    made = time.perf_counter() - begun
    ppo = dataclasses.replace(environment.task.metadata.ppo, **chosen)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        trainer: Any = trainer_type(library, "ppo")(environment, ppo, folder, 0)
        parts = _watch_own(trainer, torch) if library == "orbit" else _watch_rsl_rl(trainer)
        ends: list[float] = [time.perf_counter()]
        last: list[Any] = []

        def report(progress: Any) -> None:
            ends.append(time.perf_counter())
            last[:] = [progress]

        trainer.learn(arguments.warm + arguments.timed, report)
    seconds = [after - before for before, after in itertools.pairwise(ends)]
    timed, steps = seconds[arguments.warm :], arguments.num_envs * ppo.steps_per_iteration
    collect, update = parts(arguments.warm)
    result = {
        "task": task,
        "variant": variant,
        "num_envs": arguments.num_envs,
        "device": torch.cuda.get_device_name() if environment.device.type == "cuda" else "cpu",
        "settings": settings,
        "compile": arguments.compile,
        "env_steps_per_s": round(steps / statistics.median(timed)),
        "quartiles": [round(steps / value) for value in reversed(statistics.quantiles(timed, n=4)[::2])],
        "iteration_ms": round(1e3 * statistics.median(timed), 2),
        "collect_ms": collect,
        "update_ms": update,
        "made_s": round(made, 1),
        "first_iterations_s": [round(value, 2) for value in seconds[:6]],
        "recorded": _recorded(trainer) if library == "orbit" else None,
        "episode_return": last[0].episode_return,
        "success_rate": last[0].success_rate,
        "memory_MiB": torch.cuda.max_memory_allocated() // 2**20 if environment.device.type == "cuda" else None,
        "warnings": sorted({str(warning.message).splitlines()[0][:200] for warning in said}),
    }
    environment.close()
    return result


Parts = Callable[[int], tuple[float | None, float | None]]


def _watch_own(trainer: Any, torch: Any) -> Parts:
    """Note events on the device before and after each update."""
    if trainer.environment.device.type != "cuda":
        return lambda warm: (None, None)
    events: list[tuple[Any, Any, Any]] = []
    begin, update = trainer._rollout.begin, trainer._update

    def marked() -> Any:
        event = torch.cuda.Event(enable_timing=True)
        event.record()
        return event

    started: list[Any] = []

    def begun() -> None:
        started[:] = [marked()]
        begin()

    def updated() -> None:
        before = marked()
        update()
        events.append((started[0], before, marked()))

    trainer._rollout.begin, trainer._update = begun, updated

    def parts(warm: int) -> tuple[float, float]:
        torch.cuda.synchronize()
        timed = events[warm:]
        collect = statistics.median(first.elapsed_time(middle) for first, middle, _ in timed)
        learn = statistics.median(middle.elapsed_time(last) for _, middle, last in timed)
        return round(collect, 2), round(learn, 2)

    trainer._recording = update
    return parts


def _recorded(trainer: Any) -> dict[str, bool]:
    """Return whether the steps and the update ended up as recordings."""
    update = getattr(trainer, "_recording", trainer._update)
    composed = trainer._loop._composed is not None
    return {"step": composed, "update": update._graph is not None}


def _watch_rsl_rl(trainer: Any) -> Parts:
    """Keep the times that the library itself takes."""
    kept: list[tuple[float, float]] = []
    logger = trainer._runner.logger
    log = logger.log

    def logged(*args: Any, **words: Any) -> None:
        kept.append((words["collect_time"], words["learn_time"]))
        log(*args, **words)

    logger.log = logged

    def parts(warm: int) -> tuple[float, float]:
        collect, learn = zip(*kept[warm:], strict=True)
        return round(1e3 * statistics.median(collect), 2), round(1e3 * statistics.median(learn), 2)

    return parts


if __name__ == "__main__":
    main()
