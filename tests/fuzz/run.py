"""Reads spoilt files by the thousand: `python -m tests.fuzz.run --count 10000`, `--of hdf5 --count 1000`.

Each file is made from the kept corpus by the seed and its own number, and read in a process that may take 20 s a file,
and 2 GiB of memory besides what the readers' libraries take; ``--first N --count 1`` repeats it.
"""

from __future__ import annotations

import argparse
import atexit
import collections
import functools
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

SECONDS = 20.0
"""That a file may take."""
MEMORY = 2 * 2**30
"""Bytes that a file may take, above what the libraries take."""
KINDS = ("assets", "hdf5", "lerobot", "zarr", "policies", "recordings", "data")
"""What is fuzzed."""
Spoil = Callable[[Path, str], tuple[Path, str]]
Judge = Callable[[Path], tuple[str, str]]
_START = 180.0
"""Seconds until a new process has its libraries."""


@dataclass(frozen=True)
class Outcome:
    """What became of one spoilt file."""

    number: int
    verdict: str
    why: str


def fuzz(count: int, *, first: int = 0, seed: int = 0, workers: int = 1, kind: str = "assets") -> list[Outcome]:
    """Read as many spoilt files of a kind, and say of each whether it was accepted, refused or failed."""
    numbers = iter(range(first, first + count))
    outcomes: list[Outcome] = []
    lock = threading.Lock()

    def work() -> None:
        for outcome in _outcomes(_shared(numbers, lock), seed, kind):
            outcomes.append(outcome)
            if len(outcomes) % 500 == 0:
                print(f"{len(outcomes)} files read", file=sys.stderr, flush=True)

    threads = [threading.Thread(target=work) for _ in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(outcomes, key=lambda outcome: outcome.number)


def _shared(numbers: Iterator[int], lock: threading.Lock) -> Iterator[int]:
    while True:
        with lock:
            number = next(numbers, None)
        if number is None:
            return
        yield number


def _outcomes(numbers: Iterator[int], seed: int, kind: str) -> Iterator[Outcome]:
    """By one process after another: a new one for each that was lost."""
    waiting = next(numbers, None)
    while waiting is not None:
        ours, theirs = multiprocessing.Pipe()
        process = multiprocessing.get_context("spawn").Process(target=_serve, args=(theirs, seed, kind), daemon=True)
        process.start()
        theirs.close()
        alive = ours.poll(_START) and ours.recv() == "ready"
        if not alive:
            raise RuntimeError("the fuzz's process did not start")
        while alive and waiting is not None:
            ours.send(waiting)
            outcome, alive = _awaited(ours, waiting)
            yield outcome
            waiting = next(numbers, None)
        process.kill()
        process.join()


def _awaited(connection: Connection, number: int) -> tuple[Outcome, bool]:
    """The outcome of a file, and whether the process still lives."""
    if not connection.poll(SECONDS):
        return Outcome(number, "failed", f"not read within {SECONDS:g} s"), False
    try:
        return connection.recv(), True
    except EOFError:
        return Outcome(number, "failed", "the process died"), False


def _serve(connection: Connection, seed: int, kind: str) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    os.chdir(tempfile.mkdtemp())
    spoil, judge = _doors(kind)
    status = Path("/proc/self/status").read_text().splitlines()
    used = next(int(line.split()[1]) for line in status if line.startswith("VmData")) * 1024
    resource.setrlimit(resource.RLIMIT_DATA, (used + MEMORY, used + MEMORY))
    connection.send("ready")
    while True:
        try:
            number = connection.recv()
        except EOFError:
            return
        folder = Path(tempfile.mkdtemp())
        path, how = spoil(folder / "robot", f"{seed}:{number}")
        verdict, why = judge(path)
        shutil.rmtree(folder)
        connection.send(Outcome(number, verdict, f"{how}: {why}" if why else how))


def _doors(kind: str) -> tuple[Spoil, Judge]:
    """What spoils and what reads files of a kind, once their libraries are loaded, whose memory is not the files'."""
    if kind == "assets":
        from tests.fuzz.files import CORPUS, judge, spoil

        for name in ("arm.usda", "arm.xml", "box.dae"):
            judge(CORPUS / name)
        return spoil, _judge_model
    from tests.fuzz import data_files

    data_files.warm()
    atexit.register(data_files.clean)
    return functools.partial(data_files.spoil, kind=kind), data_files.judge


def _judge_model(path: Path) -> tuple[str, str]:
    """Judge a model's file; it fails too if a file is opened that the model may not name, or if anything is written."""
    from tests.fuzz.files import SECRETS, judge
    from tests.fuzz.watch import contents, watched

    folder = path.parent
    before = contents(folder)
    with watched([folder / name for name in SECRETS]) as opened:
        verdict, why = judge(path)
    if contents(folder) != before:
        verdict, why = "failed", f"wrote {set(contents(folder)) ^ set(before) or 'into files'}: {why}"
    if opened:
        verdict, why = "failed", f"opened {', '.join(opened)}, which the model may not: {why}"
    return verdict, why


def main() -> int:
    """Run the fuzz and print what failed, and a summary by file."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--of", choices=KINDS, default="assets")
    options = parser.parse_args()
    outcomes = fuzz(options.count, first=options.first, seed=options.seed, workers=options.workers, kind=options.of)
    for outcome in outcomes:
        if outcome.verdict == "failed" or options.count == 1:
            print(f"{outcome.verdict} {outcome.number} of seed {options.seed}: {outcome.why[:600]}")
    verdicts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for outcome in outcomes:
        verdicts[outcome.why.partition(":")[0]][outcome.verdict] += 1
    for name, counts in sorted(verdicts.items()):
        print(f"{name}: {', '.join(f'{counts[each]} {each}' for each in ('accepted', 'refused', 'failed'))}")
    failures = sum(outcome.verdict == "failed" for outcome in outcomes)
    print(f"{len(outcomes)} files, {failures} failures")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
