"""Measure ORBIT and a peer in one run, in turns, and write the figures and their page.

    python benchmarks/peers/run.py raw
    python benchmarks/peers/run.py robosuite --environments out/peers
    python benchmarks/peers/run.py mjlab newton --environments out/peers --num-envs 4096 --starts 0 --ways compiled
    python benchmarks/peers/run.py

Without a peer only the page is written. The first call for a peer makes its virtual environment under
``--environments``, by venv and pip. Figures of other peers, cases and sizes stay in the file. Run no other
job meanwhile. With ``--starts 0`` the processes of all cases start at the same time, before the first block of any.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro
from environments import python_of
from page import page
from peers import PEERS, Case, Peer
from results import Measurement, Side, Spread, merged, read, read_learned, write
from session import Request
from turns import Place, Plan, Worker, measure, start_together

from orbit_conformance.hardware import device_label
from orbit_core.cli.output import console
from orbit_core.files import written_whole
from orbit_core.interfaces.errors import ConfigurationError, OrbitError, UnknownNameError

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Measure ORBIT and a peer in turns."""

    peers: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Names of peers; only the page is written if left out."""
    environments: Path = Path("out/peers")
    """Folder of the peers' virtual environments."""
    cases: tuple[str, ...] = ()
    """Names of cases, which every peer has; all if left out."""
    num_envs: tuple[int, ...] = ()
    """Numbers of environments; the peer's own if left out."""
    device: str | None = None
    """Device; the peer's own if left out."""
    rounds: int = 7
    """Blocks of each side."""
    seconds: float = 0.6
    """Length of a block."""
    starts: int = 3
    """Starts of each side's process that are timed."""
    ways: tuple[str, ...] = ("plain", "compiled")
    """Ways of stepping ORBIT."""
    patience: float = 540.0
    """Seconds that a process may take for its start or an answer."""
    logs: Path | None = None
    """Folder that keeps what the processes print."""
    remove: bool = False
    """Delete the peers' virtual environments at the end."""
    json: Path = ROOT / "docs" / "figures" / "peers.json"
    """Figures, which the new ones are added to."""
    learning: Path = ROOT / "docs" / "figures" / "peers_learning.jsonl"
    """Lines of ``learn.py`` and of ``benchmarks/learning/speed.py``, for the page; none if there is no such file."""
    page: Path = ROOT / "docs" / "measured" / "peers.md"
    """Page that is made of the figures."""


def main(settings: Settings) -> None:
    """Measure, and write the figures and the page."""
    if unknown := [name for name in settings.peers if name not in PEERS]:
        raise UnknownNameError("peer", unknown[0], PEERS)
    chosen = [
        (peer, case, num_envs)
        for peer in (PEERS[name] for name in settings.peers)
        for case in chosen_cases(peer, settings.cases)
        for num_envs in settings.num_envs or peer.num_envs
    ]
    # With starts that are timed, the processes of one measurement run at a time.
    groups = [chosen] if settings.starts == 0 else [[each] for each in chosen]
    for group in groups:
        for measurement in measured(group, settings):
            report(measurement)
            # After each, because a later one may run into a time limit.
            write(settings.json, merged(read(settings.json), [measurement]))
    if settings.remove:
        for name in settings.peers:
            shutil.rmtree(settings.environments / name, ignore_errors=True)
    text = page(read(settings.json), read_learned(settings.learning))
    with written_whole(settings.page) as written:
        written.write_text(text, encoding="utf-8")


def chosen_cases(peer: Peer, names: tuple[str, ...]) -> list[Case]:
    """Return a peer's cases of those names, or all.

    Raises:
        UnknownNameError: the peer has no case of a name.
    """
    known = {case.name: case for case in peer.cases}
    if unknown := [name for name in names if name not in known]:
        raise UnknownNameError("case", unknown[0], known, peer.title)
    return [known[name] for name in names or known]


def measured(group: Sequence[tuple[Peer, Case, int]], settings: Settings) -> Iterator[Measurement]:
    """Measure cases and numbers of environments; what cannot run is absent, with the reason."""
    plan = Plan(
        rounds=settings.rounds, seconds=settings.seconds, starts=settings.starts, patience=settings.patience,
        logs=settings.logs,
    )  # fmt: skip
    places: list[list[Place] | ConfigurationError] = []
    for peer, case, num_envs in group:
        device = settings.device or peer.device
        try:
            if device.startswith("cuda") and not torch.cuda.is_available():
                raise ConfigurationError("no GPU on the machine")
            python = python_of(peer, settings.environments)
            sides = theirs(peer, case, num_envs, device, python) + ours(case, num_envs, device, settings.ways)
            places.append(sides)
        except ConfigurationError as error:
            places.append(error)
    with ExitStack() as stack:
        running: dict[int, Worker | ConfigurationError] = {}
        if settings.starts == 0:
            flat = [place for sides in places if isinstance(sides, list) for place in sides]
            running = dict(zip(map(id, flat), start_together(flat, plan), strict=True))
            for worker in running.values():
                if isinstance(worker, Worker):
                    stack.enter_context(worker)
        for (peer, case, num_envs), sides in zip(group, places, strict=True):
            device = settings.device or peer.device
            identity = {"peer": peer.name, "case": case.name, "num_envs": num_envs, "device": device}
            try:
                if isinstance(sides, ConfigurationError):
                    raise sides
                found = _measure(sides, plan, [running[id(place)] for place in sides] if running else None)
            except ConfigurationError as error:
                yield Measurement(**identity, absent=f"not run: {error}")
                continue
            hardware = device_label(torch.device(device))
            load = Path("/proc/loadavg")
            busy = float(load.read_text().split()[0]) if load.exists() else 0.0
            yield Measurement(**identity, hardware=hardware, block_seconds=plan.seconds, load=busy, sides=found)


def _measure(sides: list[Place], plan: Plan, running: Sequence[Worker | ConfigurationError] | None) -> list[Side]:
    """Measure one case; raise what ended a worker."""
    for worker in running or ():
        if isinstance(worker, ConfigurationError):
            raise worker
    return measure(sides, plan, [worker for worker in running if isinstance(worker, Worker)] if running else None)


def theirs(peer: Peer, case: Case, num_envs: int, device: str, python: Path) -> list[Place]:
    """Return the peer's sides of a case: one for each of its ways of stepping.

    Args:
        peer: the peer; one without packages has no side, because ORBIT's measures its own bare engine.
        case: environments of both.
        num_envs: number of environments.
        device: where they are stepped.
        python: interpreter of the peer.
    """
    ways = () if not peer.packages else peer.ways if num_envs > 1 else ("one",)
    common = {"environment": case.environment, "options": case.options, "num_envs": num_envs, "device": device}
    return [Place(peer.name, python, Request(adapter=peer.name, way=way, **common)) for way in ways]


def ours(case: Case, num_envs: int, device: str, ways: tuple[str, ...]) -> list[Place]:
    """Return ORBIT's sides of a case.

    Args:
        case: environments of both.
        num_envs: number of environments.
        device: where they are stepped.
        ways: ways of stepping: "plain" and "compiled".
    """
    options = {"backend": case.orbit.backend, "fields": case.orbit.fields}
    common = {"environment": case.orbit.task, "options": options, "num_envs": num_envs, "device": device}
    python = Path(sys.executable)
    return [Place("orbit", python, Request(adapter="orbit", way=way, **common)) for way in ways]


def report(measurement: Measurement) -> None:
    """Print a measurement."""
    title = f"{measurement.peer} {measurement.case}, {measurement.num_envs:,} environments"
    if measurement.absent:
        console().print(f"{title}: {measurement.absent}")
    for side in measurement.sides:
        rate = Spread.of(side.rates)
        raw = f", {Spread.of_ratio(side.rates, side.raw_rates).median:.2f} of raw" if side.raw_rates else ""
        console().print(f"{title}: {side.project}, {side.way}: {rate.median:,.0f} steps/s{raw}")


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings))
    except OrbitError as error:
        sys.exit(f"error: {error}")
