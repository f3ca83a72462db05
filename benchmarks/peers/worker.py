"""Worker process: environments of one project, measured as the lines of its standard input ask.

    python benchmarks/peers/worker.py '{"adapter": "dm_control", "environment": "humanoid-run"}'

Each line of input is a JSON array of a command and its argument, each line of output a JSON object. Runs in a peer's
virtual environment: standard library only.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import sys
import time
from contextlib import suppress
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

from session import Block, Request, Session, repeated

# Before the project's import, which its adapter makes.
BEGIN = time.perf_counter()


def main() -> None:
    """Make the environments, report when their first step is done, and answer commands until the input ends."""
    # Projects print as they are imported: the protocol keeps standard output for itself.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    request = Request(**json.loads(sys.argv[1]))
    session: Session = importlib.import_module(f"adapters.{request.adapter}").make(request)
    session.step()
    ready = {"start_seconds": time.perf_counter() - BEGIN, "facts": asdict(session.facts), "versions": versions()}
    print(json.dumps(ready), file=answers, flush=True)
    for line in sys.stdin:
        command, argument = json.loads(line)
        print(json.dumps(answer(session, command, argument)), file=answers, flush=True)
    session.close()


def answer(session: Session, command: str, argument: float) -> dict[str, Any]:
    """Carry out a command.

    Args:
        session: environments to measure.
        command: ``settle``, ``step``, ``raw``, ``draw`` or ``memory``.
        argument: seconds of the measurement.

    Returns:
        Values to send: a block's fields, ``seconds`` of settling, ``mib``, or an ``error`` where a project cannot draw.
    """
    gc.collect()
    if command == "settle":
        begin = time.perf_counter()
        session.settle()
        session.wait()
        taken = time.perf_counter() - begin
        session.stepped(argument)  # caches fill
        return {"seconds": taken}
    if command == "memory":
        return {"mib": family_mib()}
    if command == "draw":
        try:
            session.draw()  # makes the renderer
            return asdict(Block(*repeated(session.draw, argument)))
        except Exception as error:  # projects raise what their graphics library does
            return {"error": f"{type(error).__name__}: {error}"}
    block = session.stepped(argument) if command == "step" else session.stepped_raw(argument)
    return asdict(block) if block else {}


def versions() -> dict[str, str]:
    """Return versions of the installed distributions that the projects and their engines come in."""
    wanted = (
        "orbit-core", "dm-control", "gymnasium", "gymnasium-robotics", "metaworld", "robosuite", "mani-skill", "mjlab",
        "playground", "newton", "mujoco", "mujoco-warp", "mujoco-mjx", "sapien", "warp-lang", "jax", "torch", "numpy",
    )  # fmt: skip
    found = {"python": sys.version.split()[0]}
    for name in wanted:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def family_mib() -> float:
    """Return the memory of this process and its descendants, MiB; pages that they share count once."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # a process may end meanwhile
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            parents[int(folder.name)] = int(fields[1])
    family = {os.getpid()}
    while more := {child for child, parent in parents.items() if parent in family} - family:
        family |= more
    private, shared = 0, [0]
    for process in family:
        with suppress(OSError):
            lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
            kib = {name: int(rest.split()[0]) for name, _, rest in (line.partition(":") for line in lines[1:])}
            private += kib["Private_Clean"] + kib["Private_Dirty"]
            shared.append(kib["Shared_Clean"] + kib["Shared_Dirty"])
    # Not the proportional size: other programs on the machine that map the same libraries would lower it.
    return (private + max(shared)) / 1024


if __name__ == "__main__":
    main()
