"""Commands that need each other's results, run side by side within a budget of time, and continued by the next call."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from orbit_core.files import written_whole

_ORBIT = "import sys; from orbit_core.cli import main; sys.exit(main(sys.argv[1:]))"
_GRACE = 12.0
"""Seconds before the end of the budget at which commands are interrupted, so that they save what they have."""


@dataclass(frozen=True)
class Job:
    """A call of ``orbit``."""

    name: str
    words: Callable[[], Sequence[str]]
    """Gives the words of the call when it begins; they depend on what an interrupted call has left."""
    needs: tuple[str, ...] = ()
    """Names of the jobs whose results it reads."""
    read: Callable[[], object] = lambda: None
    """Gives what is kept of its results, as JSON."""
    cores: int = 1
    """Cores that its processes and threads take."""
    leaves: Path | None = None
    """File or folder that other jobs read; where it is gone, as on another machine, the job is done again for them."""


@dataclass
class Done:
    """Cost of a job so far, and its result."""

    ended: bool = False
    seconds: float = 0.0
    core_seconds: float = 0.0
    result: object = None


@dataclass
class Ledger:
    """File of what is done; it is replaced as a whole each time a job ends.

    Args:
        path: of the file.
        settings: that all jobs share; a file of other settings is not continued.
    """

    path: Path
    settings: Mapping[str, object]
    jobs: dict[str, Done] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.path.exists():
            return
        known = json.loads(self.path.read_text())
        changed = [name for name, value in known["settings"].items() if self.settings.get(name) != value]
        if changed:
            sys.exit(f"{self.path} was begun with other {', '.join(changed)}: give another --output")
        self.jobs = {name: Done(**values) for name, values in known["jobs"].items()}

    def ended(self, name: str) -> bool:
        """Return whether a job is done."""
        return name in self.jobs and self.jobs[name].ended

    def write(self) -> None:
        """Replace the file."""
        text = json.dumps({"settings": self.settings, "jobs": {n: asdict(d) for n, d in self.jobs.items()}}, indent=1)
        with written_whole(self.path) as written:
            written.write_text(text)


@dataclass
class _Running:
    job: Job
    process: subprocess.Popen[bytes]
    begin: float


def run_jobs(jobs: Sequence[Job], ledger: Ledger, side_by_side: int, budget: float, logs: Path, gpus: int) -> bool:
    """Run the jobs that are not done, and return whether all are.

    Args:
        jobs: in the order in which they begin, as far as their needs are done. A budget that ends thus leaves the first
            ones whole, and not all of them half done.
        ledger: of what is done.
        side_by_side: cores that jobs take at a time.
        budget: seconds of wall time, after which commands are interrupted.
        logs: folder of what each command prints.
        gpus: that processes are dealt to in turn; 0 for none.
    """
    begin = time.monotonic()
    logs.mkdir(parents=True, exist_ok=True)
    left = _left(jobs, ledger)
    running: list[_Running] = []
    failed: set[str] = set()
    last_gpu = 0
    try:
        while (left or running) and time.monotonic() - begin < budget - _GRACE:
            ready = [job for job in left.values() if all(ledger.ended(need) for need in job.needs)]
            for job in ready:
                # One that takes more than there are begins where nothing else runs.
                if running and sum(each.job.cores for each in running) + job.cores > side_by_side:
                    break
                del left[job.name]
                last_gpu += 1
                running.append(_started(job, logs, last_gpu % gpus if gpus else None))
            if not running:
                break
            _collect(running, ledger, failed, logs)
            time.sleep(0.05)
    finally:
        _interrupt(running, ledger, failed, logs)
    done = sum(ledger.ended(job.name) for job in jobs)
    print(f"{done} of {len(jobs)} done, {len(failed)} failed, {time.monotonic() - begin:.0f} s", flush=True)
    return done == len(jobs)


def _left(jobs: Sequence[Job], ledger: Ledger) -> dict[str, Job]:
    """Return the jobs to do by name, in order: those not done, and those whose results are gone and needed."""
    known = {job.name: job for job in jobs}
    left = {name: job for name, job in known.items() if not ledger.ended(name)}
    unseen = list(left.values())
    while unseen:
        for name in unseen.pop().needs:
            need = known[name]
            if name not in left and need.leaves is not None and not need.leaves.exists():
                ledger.jobs[name].ended = False
                left[name] = need
                unseen.append(need)
    return {name: job for name, job in known.items() if name in left}


def _interrupt(running: list[_Running], ledger: Ledger, failed: set[str], logs: Path) -> None:
    """Let what runs save its state, and end what does not."""
    # os.kill, for Popen's own methods reap a process that has ended, whose cost would be lost.
    for each in running:
        os.kill(each.process.pid, signal.SIGINT)
    begin = time.monotonic()
    while running:
        if time.monotonic() - begin > _GRACE - 2.0:
            for each in running:
                os.kill(each.process.pid, signal.SIGKILL)
        _collect(running, ledger, failed, logs)
        time.sleep(0.05)


def _started(job: Job, logs: Path, gpu: int | None) -> _Running:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
    # Compiled modules are kept even where the shell says not to: each of hundreds of starts takes 5 core s less.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    environment |= {"PYTHONPYCACHEPREFIX": str(logs.resolve() / "pycache")}
    if gpu is not None:
        allowed = os.environ.get("CUDA_VISIBLE_DEVICES")
        environment["CUDA_VISIBLE_DEVICES"] = allowed.split(",")[gpu] if allowed else str(gpu)
    with (logs / f"{job.name}.log").open("ab") as log:
        # A group of its own: Ctrl-C reaches this process alone, which then interrupts each once.
        process = subprocess.Popen(
            [sys.executable, "-c", _ORBIT, *job.words()],
            stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=environment, start_new_session=True,
        )  # fmt: skip
    return _Running(job, process, time.monotonic())


def _collect(running: list[_Running], ledger: Ledger, failed: set[str], logs: Path) -> None:
    """Take note of the processes that have ended."""
    for each in list(running):
        # Not poll(): only wait4 says how much time of a core this very process took.
        pid, status, usage = os.wait4(each.process.pid, os.WNOHANG)
        if not pid:
            continue
        each.process.returncode = os.waitstatus_to_exitcode(status)
        running.remove(each)
        done = ledger.jobs.setdefault(each.job.name, Done())
        done.seconds += time.monotonic() - each.begin
        done.core_seconds += usage.ru_utime + usage.ru_stime
        if each.process.returncode == 0:
            done.result, done.ended = each.job.read(), True
            print(f"{each.job.name}: {done.seconds:.0f} s, {done.core_seconds:.0f} core s", flush=True)
        elif each.process.returncode > 0 and each.process.returncode != 130:
            failed.add(each.job.name)
            print(f"{each.job.name} failed, see {logs / each.job.name}.log", flush=True)
        ledger.write()
