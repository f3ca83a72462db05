r"""Table II of the Orbit paper, repeated: cloning Lift from fixed and random starts to fixed and random goals.

    python benchmarks/imitation/table2.py --jobs 64 --demos 2000 --seeds 3 --episodes 100 --budget 460
    python benchmarks/imitation/table2.py --merge docs/figures/table2.json --page docs/measured/imitation.md
    python benchmarks/imitation/table2.py --jobs 64 --merge docs/figures/table2.json --forget diffusion
    python benchmarks/imitation/table2.py --jobs 64 --demos 400 --seeds 2 --cells both --actions pictures --transfer \
        --algorithms bc act diffusion --device cuda --gpus 4 --renderer-setting shadow_size=0 --budget 560 \
        --output out/table2-pictures

Demonstrations are recorded on one engine, policies are trained from them, and evaluated on that engine and all others
that are installed: ``orbit record``, ``orbit train`` and ``orbit evaluate``, each in a process of one thread. The same
command goes on where the budget ended; its settings and results are in ``results.json`` of the output folder. On
another machine ``--merge`` takes the results of earlier calls, and what they left behind is made again where it is
needed; ``--forget`` leaves out algorithms that have changed since. One short job on each other engine comes before all
that need it, so that an engine that compiles kernels does so once; the environment variable WARP_CACHE_PATH says where
Warp keeps them.

Why: Mittal et al., Orbit: A Unified Simulation Framework for Interactive Robot Learning Environments (2023), table II.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from table2_page import merged, page, without
from work import Job, Ledger, run_jobs

from orbit_core.backends import backend_names
from orbit_core.files import written_whole
from orbit_learn.evaluation.results import read_results
from orbit_learn.policy_file import newest_file
from orbit_learn.training import CHECKPOINT

_FIRST_START = 10_000
"""Seed of the starts of evaluation, which no demonstration had."""


@dataclass(frozen=True)
class Cell:
    """A column of the table: what differs from episode to episode."""

    name: str
    start: float
    """Spread of the cube's start: 1 for the task's own, 0 for one place."""
    goal: float


CELLS = (Cell("none", 0.0, 0.0), Cell("goal", 0.0, 1.0), Cell("start", 1.0, 0.0), Cell("both", 1.0, 1.0))


@dataclass(frozen=True)
class Action:
    """How the arm is commanded, and what its policy sees."""

    name: str
    space: str
    length: float
    """Seconds of an episode."""
    noise: float
    """Deviation of the noise on executed actions, in their units."""
    part: int = 250
    """Demonstrations of one recording; half of the recordings have noise."""
    together: int = 50
    """Environments of a recording."""
    trials: int = 100
    """Most episodes of one evaluation."""
    watched: int = 16
    """Environments that a training plays in at its end."""
    cameras: tuple[str, ...] = ()
    """Pictures that the policy sees in place of the cube's pose."""


ACTIONS = (
    Action("joint_position", "joint_position", 5.0, 0.012),
    Action("ik_relative", "ik_relative", 8.0, 0.05),
    # Software takes 20 to 80 ms of a core for a picture: small jobs, so that none outlasts a call.
    Action("pictures", "ik_relative", 8.0, 0.05, 8, 8, 4, 1, ("front:84x84", "hand:84x84")),
)


ITERATIONS = {"bc": 60, "bc-rnn": 50, "act": 60, "diffusion": 100}
"""Iterations of each algorithm's training, of 200 gradient steps each."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--demos", type=int, default=2000)
    parser.add_argument("--seeds", type=int, default=3, help="trainings of each policy")
    parser.add_argument("--episodes", type=int, default=100, help="of each policy and engine")
    parser.add_argument("--algorithms", nargs="+", default=list(ITERATIONS), choices=list(ITERATIONS))
    parser.add_argument(
        "--actions", nargs="+", default=["joint_position", "ik_relative"], choices=[a.name for a in ACTIONS]
    )
    parser.add_argument("--renderer", help="of the pictures; the engine itself if left out")
    parser.add_argument("--renderer-setting", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--cells", nargs="+", default=[c.name for c in CELLS], choices=[c.name for c in CELLS])
    parser.add_argument("--engine", default="mujoco", help="of the demonstrations")
    parser.add_argument("--transfer", nargs="*", default=None, help="other engines; all that are installed if left out")
    parser.add_argument("--device", default="cpu", help="of training: cpu or cuda")
    parser.add_argument("--gpus", type=int, default=1, help="that trainings are dealt to with --device cuda")
    parser.add_argument("--eager", action="store_true", help="train without recorded graphs on --device cuda")
    parser.add_argument("--iterations", type=int, help="of each training, to try the script out")
    parser.add_argument("--budget", type=float, default=1e9, help="seconds of wall time")
    parser.add_argument("--output", type=Path, default=Path("out/table2"))
    parser.add_argument("--merge", type=Path, nargs="+", default=[], help="results.json of other runs, to go on from")
    parser.add_argument(
        "--forget", nargs="+", default=[], choices=list(ITERATIONS), help="algorithms whose results are not merged"
    )
    parser.add_argument("--page", type=Path, help="write the page from the results instead of running")
    arguments = parser.parse_args()
    results = arguments.output / "results.json"
    if arguments.merge:
        arguments.output.mkdir(parents=True, exist_ok=True)
        found = [json.loads(results.read_text())] if results.exists() else []
        found += [without(json.loads(path.read_text()), arguments.forget) for path in arguments.merge]
        with written_whole(results) as written:
            written.write_text(json.dumps(merged(found), indent=1))
    if arguments.page is not None:
        text = page(json.loads(results.read_text()))
        with written_whole(arguments.page) as written:
            written.write_text(text)
        return
    arguments.output.mkdir(parents=True, exist_ok=True)
    kept = ("demos", "seeds", "episodes", "engine", "iterations", "renderer", "renderer_setting")
    common = {name: getattr(arguments, name) for name in kept}
    ledger = Ledger(results, common)
    # A scheduler that ends this process lets the commands save their state too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    complete = run_jobs(
        table_jobs(arguments), ledger, arguments.jobs, arguments.budget, arguments.output / "logs",
        arguments.gpus if arguments.device == "cuda" else 0,
    )  # fmt: skip
    sys.exit(0 if complete else 75)


def table_jobs(arguments: argparse.Namespace) -> list[Job]:
    """Return all jobs of the table, named ``kind.cell.action...``."""
    others = arguments.transfer
    if others is None:
        others = [name for name in backend_names() if name != arguments.engine]
    actions = [action for action in ACTIONS if action.name in arguments.actions]
    # Kernels depend on what is drawn, neither on the action nor on the number of environments.
    first: dict[tuple[str, tuple[str, ...]], Job] = {}
    for action in actions:
        for engine in others:
            first.setdefault((engine, action.cameras), _first_job(engine, action, arguments))
    jobs = list(first.values())
    for cell in CELLS:
        for action in actions:
            if cell.name in arguments.cells:
                needs = {engine: first[engine, action.cameras].name for engine in others}
                jobs += _cell_jobs(cell, action, (arguments.engine, *others), needs, arguments)
    return jobs


def _first_job(engine: str, action: Action, arguments: argparse.Namespace) -> Job:
    """Return a job of a few steps on an engine, which compiles what many would compile side by side."""
    file = arguments.output / "first" / f"{action.name}-{engine}.hdf5"
    words = (
        "record", "Lift", "--action", action.space, *_seen(action, arguments), "--set", "episode_length=0.1",
        "--backend", engine, "--num-envs", "1", "--episodes", "1", "--output", str(file), "--overwrite",
    )  # fmt: skip
    return Job(f"first.all.{action.name}.{engine}", lambda: words, leaves=file)


def _looks(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the words that say who draws pictures, and how."""
    renderer = ("--renderer", arguments.renderer) if arguments.renderer else ()
    return (*renderer, *(word for each in arguments.renderer_setting for word in ("--renderer-setting", each)))


def _seen(action: Action, arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the words that show the policy pictures; none for an action whose policy sees none."""
    return ("--cameras", *action.cameras, *_looks(arguments)) if action.cameras else ()


def _cell_jobs(
    cell: Cell, action: Action, engines: Sequence[str], first: Mapping[str, str], arguments: argparse.Namespace
) -> list[Job]:
    """Return the jobs of a cell and an action.

    Args:
        cell: what differs from episode to episode.
        action: how the arm is commanded.
        engines: that policies are evaluated on.
        first: job that an engine's evaluations wait for.
        arguments: of the command line.
    """
    label, output = f"{cell.name}.{action.name}", arguments.output
    task = (
        "Lift", "--action", action.space, *_seen(action, arguments), "--set", f"episode_length={action.length}",
        "--set", f"start_spread={cell.start}", "--set", f"commands.goal.spread={cell.goal}",
    )  # fmt: skip
    jobs: list[Job] = []
    parts = _parts(arguments.demos, action.part)
    files = [output / label / f"demos_{part}.hdf5" for part in range(len(parts))]
    for part, (file, count) in enumerate(zip(files, parts, strict=True)):
        noise = ("--noise", str(action.noise)) if part % 2 else ()
        words = (
            "record", *task, "--backend", arguments.engine, "--num-envs", str(min(count, action.together)),
            "--episodes", str(count), "--seed", str(part + 1), *noise, "--output", str(file), "--resume",
        )  # fmt: skip
        jobs.append(Job(f"record.{label}.{part}", lambda words=words: words, leaves=file))
    recorded = tuple(job.name for job in jobs)
    data = [word for file in files for word in ("--dataset", str(file))]
    for algorithm in arguments.algorithms:
        folders = [output / label / f"{algorithm}-{seed}" for seed in range(arguments.seeds)]
        trained: list[str] = []
        for seed, folder in enumerate(folders):
            iterations = arguments.iterations or ITERATIONS[algorithm]
            settings = (f"evaluate_every={iterations}", f"device={arguments.device}")
            settings += ("recorded=false",) if arguments.eager else ()
            words = (
                "train", *task, "--backend", arguments.engine, "--num-envs", str(action.watched),
                "--library", "imitation", "--algorithm", algorithm, *data, "--iterations", str(iterations),
                "--save-every", "20", "--seed", str(seed),
                *(word for setting in settings for word in ("--imitation", setting)),
            )  # fmt: skip
            trained.append(f"train.{label}.{algorithm}.{seed}")
            begin = Job(
                trained[-1], lambda w=words, f=folder, n=iterations: (*w, *continued(f, n)), recorded,
                leaves=folder,
            )  # fmt: skip
            jobs.append(begin)
        for engine in engines:
            for part, begin in enumerate(range(0, arguments.episodes, action.trials)):
                into = output / label / f"evaluation-{algorithm}-{engine}-{part}"
                words = (
                    "evaluate", *map(str, folders), "--backend", engine, *(_looks(arguments) if action.cameras else ()),
                    "--episodes", str(min(action.trials, arguments.episodes - begin)),
                    "--seed", str(_FIRST_START + part), "--jobs", "1", "--output", str(into),
                )  # fmt: skip

                def read(into: Path = into) -> list[dict[str, object]]:
                    return outcomes(into / "results.jsonl")

                name = f"evaluate.{label}.{algorithm}.{engine}.{part}"
                needs = (*trained, *((first[engine],) if engine in first else ()))
                jobs.append(Job(name, lambda words=words: words, needs, read))
    return jobs


def _parts(demos: int, size: int) -> list[int]:
    """Return the sizes of an even number of recordings."""
    count = 2 * max(1, round(demos / (2 * size)))
    return [demos // count + (part < demos % count) for part in range(count)]


def continued(folder: Path, iterations: int) -> tuple[str, str]:
    """Return the words that begin a training of so many iterations in a folder, or go on with the one there."""
    newest = newest_file(folder, CHECKPOINT) if folder.is_dir() else None
    if newest is not None and newest.stem != f"{CHECKPOINT}_{iterations - 1}":
        return "--resume", str(folder)
    if folder.is_dir():
        shutil.rmtree(folder)  # interrupted before its first checkpoint, or killed after its last
    return "--output", str(folder)


def outcomes(path: Path) -> list[dict[str, object]]:
    """Return successes, trials and the mean number of steps until success, of each training."""
    return [
        {
            "policy": Path(block.key.policy).name,
            "engine": block.engine,
            "successes": sum(block.success),
            "trials": len(block.success),
            "length": sum(block.reached) / len(block.reached),
            "lost": sum(block.failed),
        }
        for block in read_results(path)[1]
    ]


if __name__ == "__main__":
    main()
