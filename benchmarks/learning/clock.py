"""Time from the command to a learned task, with the phases of the start, for several seeds on all GPUs of the machine.

    python benchmarks/learning/clock.py --seeds 0 1 2 3 4 --limit 560 --output clock

Each training is a process; each GPU runs one at a time. Seconds count from the moment its process is started, so that
imports, building and compiling are in them; a training ends at its task's criterion or number of iterations. Trainings
that have not begun, or not ended, when the limit comes are left out or cut short, and reported as such. The folder gets
``clock.json`` with all curves, and ``<task>.png`` where matplotlib is installed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import queue
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

STARTED = "ORBIT_STARTED"


class Goal(NamedTuple):
    """When a task counts as learned."""

    number: str
    """Number of a curve."""
    least: float
    """Value that it reaches; negative numbers stand for one that falls below."""
    iterations: int
    """Most iterations of a training."""


GOALS = {
    "Reach": Goal("success_rate", 0.95, 400),
    "Lift": Goal("success_rate", 0.9, 700),
    "Velocity-Flat": Goal("linear_error_m_s", -0.07, 350),
    "Humanoid": Goal("success_rate", 0.9, 500),
}
# Of off-policy algorithms, whose iterations have fewer steps: until the limit.
MOST_ITERATIONS = 10_000
SMALL = Goal("success_rate", 0.95, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(GOALS)[:3])
    parser.add_argument(
        "--libraries", nargs="+", default=["orbit", "rsl-rl"], help="LIBRARY for PPO, or LIBRARY:ALGORITHM"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument(
        "--ppo", action="append", default=[], help="KEY=JSON of the algorithm; ORBIT's own takes precision"
    )
    parser.add_argument("--off-policy", action="append", default=[], help="KEY=JSON of sac and td3")
    parser.add_argument("--iterations", type=int, help="most iterations, in the place of the task's")
    parser.add_argument("--side-by-side", type=int, default=1, help="trainings on one GPU at a time")
    parser.add_argument("--limit", type=float, default=560.0, help="seconds for all")
    parser.add_argument("--no-compile", dest="compile", action="store_false")
    parser.add_argument("--output", type=Path, default=Path("out/clock"))
    parser.add_argument("--job", help="train this one, as JSON, and print what it gave")
    arguments = parser.parse_args()
    if arguments.job:
        train(json.loads(arguments.job), arguments)
        return
    arguments.output.mkdir(parents=True, exist_ok=True)
    # Seeds outermost: where the limit comes, every task and library has as many seeds.
    jobs = [
        {"task": task, "library": library, "seed": seed}
        for seed in arguments.seeds for task in arguments.tasks for library in arguments.libraries
    ]  # fmt: skip
    results = run_all(jobs, arguments)
    (arguments.output / "clock.json").write_text(json.dumps(results))
    for result in results:
        print(json.dumps({key: value for key, value in result.items() if key != "curve"}), flush=True)
    summarize(results)
    draw(results, arguments.output)


def run_all(jobs: list[dict[str, Any]], arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Run the trainings, as many at a time as there are GPUs."""
    waiting: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    for job in jobs:
        waiting.put(job)
    results: list[dict[str, Any]] = []
    end = time.monotonic() + arguments.limit

    def work(gpu: str | None) -> None:
        while time.monotonic() < end - 30.0:
            try:
                job = waiting.get_nowait()
            except queue.Empty:
                return
            results.append(run_one(job, gpu, end))

    gpus = [None] if arguments.device == "cpu" else _gpus() * arguments.side_by_side
    threads = [threading.Thread(target=work, args=(gpu,)) for gpu in gpus]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return results


def run_one(job: dict[str, Any], gpu: str | None, end: float) -> dict[str, Any]:
    """Run one training in a process of its own; its lines up to the limit are its result."""
    environment = {**os.environ, STARTED: repr(time.time())}
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = gpu
    with tempfile.TemporaryFile("w+") as lines, tempfile.TemporaryFile("w+") as errors:
        command = [sys.executable, __file__, *sys.argv[1:], "--job", json.dumps(job)]
        process = subprocess.Popen(command, env=environment, stdout=lines, stderr=errors)
        try:
            code = process.wait(max(1.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        lines.seek(0), errors.seek(0)
        said = [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}\n")]
        last = errors.read()[-1500:]
    curve = [line for line in said if "iteration" in line]
    phases = {key: value for line in said if "iteration" not in line for key, value in line.items()}
    result = {**job, "gpu": gpu, "code": code, "phases": phases, "reached": phases.pop("reached", None)}
    if curve:
        phases["first iteration"] = curve[0]["clock"]
        seconds = [after["clock"] - before["clock"] for before, after in itertools.pairwise(curve[5:])]
        steps = curve[-1]["env_steps"] / len(curve)
        result |= {"iterations": len(curve), "last": curve[-1]}
        result["env_steps_per_s"] = round(steps / statistics.median(seconds)) if seconds else None
    if code:
        result["error"] = last
    return {**result, "curve": curve}


def train(job: dict[str, Any], arguments: argparse.Namespace) -> None:
    """Train in this process, and print a line for each phase and iteration."""
    started, output = float(os.environ[STARTED]), sys.stdout

    def tell(**values: Any) -> None:
        print(json.dumps(values), file=output, flush=True)  # libraries redirect what is printed while they learn

    def clock() -> float:
        return round(time.time() - started, 3)

    tell(python=clock())
    from orbit_core.configuration import configured
    from orbit_core.envs import make
    from orbit_core.envs.registry import task_entry
    from orbit_learn.learners import trainer_type
    from orbit_learn.training import Training

    library, _, algorithm = job["library"].partition(":")
    make_trainer = trainer_type(library, algorithm or "ppo")
    tell(imported=clock())
    goal = GOALS.get(job["task"], SMALL)
    task = task_entry(job["task"]).task_type()
    environment = make(
        job["task"], arguments.num_envs, arguments.backend, device=arguments.device, seed=job["seed"],
        compile=arguments.compile, reset_diverged=True, **task.metadata.training,
    )  # fmt: skip
    tell(made=clock())
    given = arguments.off_policy if algorithm else arguments.ppo
    words = {key: json.loads(value) for key, _, value in (item.partition("=") for item in given)}
    if library != "orbit":
        words.pop("precision", None), words.pop("compile_update", None)
    preset = environment.task.metadata.ppo
    if algorithm:
        preset, words["algorithm"] = environment.task.metadata.off_policy, algorithm
    settings = configured(preset, words, "off_policy" if algorithm else "ppo", "algorithm setting")
    with tempfile.TemporaryDirectory() as folder:
        trainer = make_trainer(environment, settings, folder, job["seed"])
        tell(trainer=clock())

        def report(progress: Any) -> None:
            numbers = {"success_rate": progress.success_rate, **progress.metrics}
            line = {"iteration": progress.iteration, "clock": clock(), "env_steps": progress.env_steps}
            value = numbers.get(goal.number)
            value = None if value is None or value != value else float(value)
            reached = value is not None and (value >= goal.least if goal.least > 0.0 else value <= -goal.least)
            # Episodes that ended before their time limit was reached once tell of starts alone.
            reached = reached and progress.env_steps >= arguments.num_envs * environment.max_episode_steps
            tell(**line, value=value, episode_return=_finite(progress.episode_return), episodes=progress.episodes)
            if reached:
                tell(reached=clock())
                os._exit(0)  # nothing of this process is needed any more

        # Training writes the curve and checkpoints, as the command does: their time belongs to the clock's.
        training = Training(trainer, job["task"], {})
        training.run(arguments.iterations or (MOST_ITERATIONS if algorithm else goal.iterations), 100, report)


def _finite(value: float) -> float | None:
    return None if value != value else value


def _gpus() -> list[str]:
    """Return the GPUs that this process may use, as ``CUDA_VISIBLE_DEVICES`` names them."""
    if allowed := os.environ.get("CUDA_VISIBLE_DEVICES"):
        return allowed.split(",")
    found = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, check=True).stdout.splitlines()
    return [str(i) for i in range(len(found))]


def summarize(results: list[dict[str, Any]]) -> None:
    """Print medians over the seeds."""
    kinds = sorted({(result["task"], result["library"]) for result in results})
    for task, library in kinds:
        own = [r for r in results if (r["task"], r["library"]) == (task, library) and r["curve"]]
        if not own:
            print(f"{task:14} {library:8} no iteration was completed", flush=True)
            continue
        reached = sorted(r["reached"] for r in own if r["reached"])
        first = [r["phases"]["first iteration"] for r in own]
        median = statistics.median(reached) if reached else None
        rates = [r["env_steps_per_s"] for r in own if r["env_steps_per_s"]]
        print(
            f"{task:14} {library:8} reached {len(reached)} of {len(own)}, median {median} s "
            f"({', '.join(f'{value:.0f}' for value in reached)}); first iteration {statistics.median(first):.1f} s; "
            f"{statistics.median(rates) if rates else 0:,.0f} steps/s",
            flush=True,
        )
        for result in own:
            last, best = result["last"], _best(result)
            print(
                f"  seed {result['seed']}: {last['env_steps']:,} steps, {last['clock']:.0f} s; "
                f"{GOALS.get(task, SMALL).number} at last {last['value']}, best {best}",
                flush=True,
            )


def _best(result: dict[str, Any]) -> float | None:
    """Return the best value of a curve."""
    values = [line["value"] for line in result["curve"] if line["value"] is not None]
    pick = max if GOALS.get(result["task"], SMALL).least > 0.0 else min
    return pick(values, default=None)


def draw(results: list[dict[str, Any]], folder: Path) -> None:
    """Draw each task's curves over environment steps and over the clock."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return
    for task in sorted({result["task"] for result in results}):
        figure = Figure(figsize=(10.0, 4.0), layout="constrained")
        axes: Any = figure.subplots(1, 2, sharey=True)
        colours: dict[str, str] = {}
        for result in (r for r in results if r["task"] == task and r["curve"]):
            points = [line for line in result["curve"] if line["value"] is not None]
            colour = colours.setdefault(result["library"], f"C{len(colours)}")
            for axis, key in zip(axes, ("env_steps", "clock"), strict=True):
                label = f"{result['library']}, seed {result['seed']}"
                axis.plot(
                    [p[key] for p in points], [p["value"] for p in points], color=colour, label=label, linewidth=1
                )
        axes[0].set(xlabel="environment steps", ylabel=GOALS.get(task, SMALL).number)
        axes[1].set(xlabel="seconds since the command")
        axes[1].legend(fontsize=6)
        figure.savefig(folder / f"{task}.png", dpi=120)


if __name__ == "__main__":
    main()
