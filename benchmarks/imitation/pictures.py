r"""Lift from pictures: record, clone and evaluate within one call of ten minutes on a machine with a GPU.

    python benchmarks/imitation/pictures.py --jobs 16 --device cuda --budget 560 --output out/pictures
    python benchmarks/imitation/pictures.py --jobs 2 --backend mujoco --renderer-setting shadow_size=0 --demos 4 \
        --parts 2 --cameras front:84x84 --iterations 1 --episodes 2 --algorithms act --output out/pictures-small

Warp draws and steps on the GPU; recordings are many processes, for compressing a picture takes 2 ms of a core. The
first of them compiles the kernels that the others then find. The same command goes on where the budget ended.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path

from table2 import ITERATIONS, continued, outcomes
from work import Job, Ledger, run_jobs

from orbit_core.rollout.estimates import proportion

_FIRST_START = 10_000
"""Seed of the starts of evaluation, which no demonstration had."""
_NOISE = 0.05


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--backend", default="warp")
    parser.add_argument("--device", default="cpu", help="of physics, pictures and training: cpu or cuda")
    parser.add_argument("--renderer-setting", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--cameras", nargs="+", default=["front:84x84", "hand:84x84"])
    parser.add_argument("--demos", type=int, default=400)
    parser.add_argument("--parts", type=int, default=16, help="recordings, an even number; half have noise")
    parser.add_argument("--algorithms", nargs="+", default=["bc", "act", "diffusion"], choices=list(ITERATIONS))
    parser.add_argument("--iterations", type=int, help="of each training; those of the states if left out")
    parser.add_argument("--episodes", type=int, default=100, help="of each evaluation")
    parser.add_argument("--budget", type=float, default=1e9, help="seconds of wall time")
    parser.add_argument("--output", type=Path, default=Path("out/pictures"))
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    kept = ("backend", "demos", "parts", "cameras", "episodes", "iterations", "renderer_setting")
    ledger = Ledger(arguments.output / "results.json", {name: getattr(arguments, name) for name in kept})
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    complete = run_jobs(
        picture_jobs(arguments), ledger, arguments.jobs, arguments.budget, arguments.output / "logs",
        1 if arguments.device == "cuda" else 0,
    )  # fmt: skip
    print(table(json.loads((arguments.output / "results.json").read_text())["jobs"]))
    sys.exit(0 if complete else 75)


def picture_jobs(arguments: argparse.Namespace) -> list[Job]:
    """Return the recordings, and the training and evaluation of each algorithm."""
    output, count = arguments.output, arguments.demos // arguments.parts
    machine = ("--backend", arguments.backend, "--device", arguments.device)
    machine += tuple(word for setting in arguments.renderer_setting for word in ("--renderer-setting", setting))
    task = (
        "Lift", "--action", "ik_relative", "--set", "episode_length=8", "--cameras", *arguments.cameras, *machine,
    )  # fmt: skip
    jobs: list[Job] = []
    files = [output / f"demos_{part}.hdf5" for part in range(arguments.parts)]
    for part, file in enumerate(files):
        words = (
            "record", *task, "--num-envs", str(count), "--episodes", str(count), "--seed", str(part + 1),
            *(("--noise", str(_NOISE)) if part % 2 else ()), "--output", str(file), "--resume",
        )  # fmt: skip
        first = ("record.0",) if part else ()
        jobs.append(Job(f"record.{part}", lambda words=words: words, first, leaves=file))
    recorded, data = tuple(job.name for job in jobs), [word for file in files for word in ("--dataset", str(file))]
    for algorithm in arguments.algorithms:
        folder, into = output / algorithm, output / f"evaluation-{algorithm}"
        iterations = arguments.iterations or ITERATIONS[algorithm]
        words = (
            "train", *task, "--num-envs", "4", "--library", "imitation", "--algorithm", algorithm, *data,
            "--iterations", str(iterations), "--save-every", "20", "--imitation", f"evaluate_every={iterations}",
        )  # fmt: skip
        begin = Job(
            f"train.{algorithm}", lambda w=words, f=folder, n=iterations: (*w, *continued(f, n)), recorded,
            leaves=folder,
        )  # fmt: skip
        words = (
            "evaluate", str(folder), *machine, "--episodes", str(arguments.episodes), "--seed", str(_FIRST_START),
            "--jobs", "1", "--output", str(into),
        )  # fmt: skip
        end = Job(
            f"evaluate.{algorithm}", lambda words=words: words, (begin.name,),
            lambda into=into: outcomes(into / "results.jsonl"),
        )  # fmt: skip
        jobs += [begin, end]
    return jobs


def table(jobs: dict[str, dict[str, object]]) -> str:
    """Return the success of each algorithm that was evaluated, in Markdown."""
    lines = ["| algorithm | success |", "|---|---|"]
    for name, done in jobs.items():
        kind, algorithm = name.split(".")
        if kind == "evaluate" and done["ended"]:
            (result,) = done["result"]  # pyright: ignore[reportGeneralTypeIssues]
            lines.append(f"| {algorithm} | {proportion(result['successes'], result['trials']).percent()} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
