"""Measuring in turns: workers of all sides stay alive, and take blocks of steps one after the other."""

from __future__ import annotations

import json
import os
import select
import subprocess
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any, Self

import msgspec
from results import Side
from session import Facts, Request

from orbit_core.interfaces.errors import ConfigurationError

_WORKER = Path(__file__).with_name("worker.py")


@dataclass(frozen=True)
class Place:
    """Interpreter and environments of one side."""

    project: str
    """``orbit``, or name of the peer."""
    python: Path
    """Interpreter of its virtual environment."""
    request: Request
    """Environments that its worker makes."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Amount of measuring."""

    rounds: int = 7
    """Blocks of each side."""
    seconds: float = 0.6
    """Length of a block."""
    starts: int = 3
    """Starts of each side's process, in turns; the last ones are measured further. None are timed if 0: all start at
    the same time, which suits kernels that compile for minutes."""
    patience: float = 540.0
    """Seconds that a process may take for its start or an answer: kernels of a GPU compile in minutes."""
    logs: Path | None = None
    """Folder that keeps what the processes print; nothing but the reason of a failure is kept without it."""


class Worker:
    """Process of one side.

    Args:
        place: what it runs.
        plan: its patience, and where what it prints is kept.

    Raises:
        ConfigurationError: the process ended before its first step, as where a model or a device is missing.
    """

    def __init__(self, place: Place, plan: Plan) -> None:
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        environment.setdefault("MUJOCO_GL", "egl")
        if place.project != "orbit":
            environment.pop("PYTHONPATH", None)  # ORBIT's packages are not the peer's
        self._project, self._patience = place.project, plan.patience
        self._errors = _log(place, plan.logs)
        begin = time.perf_counter()
        self._process = subprocess.Popen(
            [str(place.python), str(_WORKER), json.dumps(asdict(place.request))], env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors,
        )  # fmt: skip
        try:
            ready = self._receive()
        except BaseException:
            self.__exit__()
            raise
        self.command_seconds = time.perf_counter() - begin
        """Seconds from the command to the end of the first step."""
        self.start_seconds: float = ready["start_seconds"]
        """Seconds from the first import to the end of the first step."""
        self.facts = msgspec.convert(ready["facts"], Facts)
        """Properties of its environments."""
        self.versions: dict[str, str] = ready["versions"]
        """Versions by distribution."""

    def ask(self, command: str, argument: float = 0.0) -> dict[str, Any]:
        """Return the worker's answer to a command, as ``worker.answer`` describes it."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps([command, argument]) + "\n")
        self._process.stdin.flush()
        return self._receive()

    def rate(self, command: str, seconds: float) -> float | None:
        """Return what a block made per second; None where there is no such measurement."""
        block = self.ask(command, seconds)
        return block["count"] / block["seconds"] if block else None

    def _receive(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        if select.select([self._process.stdout], [], [], self._patience)[0]:
            line = self._process.stdout.readline()
            if line.endswith("\n"):
                return json.loads(line)
            self._process.wait()
            self._errors.seek(0)
            said = [line.strip() for line in self._errors.read().splitlines() if line.strip()]
            raise ConfigurationError(f"{self._project} ended: {said[-1] if said else 'without a word'}")
        raise ConfigurationError(f"{self._project} gave no answer in {self._patience:g} s")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()  # the end of its input ends the worker, and the processes that it made
        try:
            self._process.wait(20.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
        self._errors.close()


def _log(place: Place, folder: Path | None) -> IO[str]:
    """Open the file of what a worker prints; it is closed with the worker."""
    if folder is None:
        return tempfile.TemporaryFile("w+", errors="replace")
    folder.mkdir(parents=True, exist_ok=True)
    request = place.request
    options = "-".join(f"{value}" for value in request.options.get("fields", {}).values())
    name = "-".join((place.project, request.environment, options, str(request.num_envs), request.way)).replace("/", "_")
    return (folder / f"{name}.log").open("w+", errors="replace")


def start_together(places: Sequence[Place], plan: Plan) -> list[Worker | ConfigurationError]:
    """Start workers at the same time, and return each when all have made a step, or why it ended."""

    def start(place: Place) -> Worker | ConfigurationError:
        try:
            worker = Worker(place, plan)
            worker.ask("settle")  # compiles the rest, which is not left to one side's turn
            return worker
        except ConfigurationError as error:
            return error

    with ThreadPoolExecutor(max(1, len(places))) as pool:
        return list(pool.map(start, places))


def measure(places: Sequence[Place], plan: Plan, workers: Sequence[Worker] | None = None) -> list[Side]:
    """Measure several sides in turns.

    Args:
        places: sides, in the order of their turns.
        plan: amount of measuring.
        workers: of the places, if they run already; their starts are not timed.

    Returns:
        A result for each side.

    Raises:
        ConfigurationError: a side's environments cannot be made.
    """
    starts: list[list[tuple[float, float]]] = [[] for _ in places]

    def start(index: int) -> Worker:
        worker = Worker(places[index], plan)
        starts[index].append((worker.start_seconds, worker.command_seconds))
        return worker

    for _ in range(plan.starts - 1):
        for index in range(len(places)):
            start(index).__exit__()
    with ExitStack() as stack:
        if workers is None:
            workers = [stack.enter_context(start(index)) for index in range(len(places))]
        memory = [[worker.ask("memory")["mib"]] for worker in workers]
        settling = [worker.ask("settle", plan.seconds)["seconds"] for worker in workers]
        rates: list[list[float]] = [[] for _ in workers]
        raw: list[list[float]] = [[] for _ in workers]
        for _ in range(plan.rounds):
            for command, found in (("step", rates), ("raw", raw)):
                for worker, values in zip(workers, found, strict=True):
                    if (rate := worker.rate(command, plan.seconds)) is not None:
                        values.append(rate)
            if not memory[0][1:]:
                for worker, values in zip(workers, memory, strict=True):
                    values.append(worker.ask("memory")["mib"])
        pictures = _pictures(workers, plan) if places[0].request.num_envs == 1 else [([], "")] * len(workers)
    return [
        Side(
            project=place.project,
            way=place.request.way,
            facts=worker.facts,
            versions=worker.versions,
            start_seconds=[seconds for seconds, _ in starts[index]],
            command_seconds=[seconds for _, seconds in starts[index]],
            settle_seconds=settling[index],
            memory_mib=max(memory[index]),
            rates=rates[index],
            raw_rates=raw[index],
            pictures=pictures[index][0],
            no_pictures=pictures[index][1],
        )
        for index, (place, worker) in enumerate(zip(places, workers, strict=True))
    ]


def _pictures(workers: Sequence[Worker], plan: Plan) -> list[tuple[list[float], str]]:
    """Return pictures per second of each worker, or why it draws none."""
    drawn: list[list[float]] = [[] for _ in workers]
    reasons = [""] * len(workers)
    for _ in range(max(1, plan.rounds // 2)):
        for index, worker in enumerate(workers):
            if reasons[index]:
                continue
            block = worker.ask("draw", plan.seconds)
            reasons[index] = block.get("error", "")
            if not reasons[index]:
                drawn[index].append(block["count"] / block["seconds"])
    return list(zip(drawn, reasons, strict=True))
