"""Largest differences between engines in each task and learned policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from orbit_conformance.episodes import TaskResult
from orbit_conformance.jobs import Kind
from orbit_conformance.results import Result
from orbit_conformance.verdict import Status


@dataclass(frozen=True)
class Difference:
    """Difference between engines in one task, or with one policy."""

    name: str
    anchor: str
    success: str
    """Lowest and highest success rate with the engines that have them."""
    metric: str
    """Lowest and highest mean of the leading metric."""
    trajectories: str
    """Pair of engines and tracked thing that are farthest apart, median over environments."""
    spread: float
    """Difference of the highest and the lowest success rate; a refusal counts as zero."""
    distance: float
    """Metres between the two trajectories that are farthest apart."""


def differences(result: Result) -> tuple[Difference, ...]:
    """Return the differences of all tasks and policies that more than one engine played, the largest first."""
    found = [*_of_tasks(result), *_of_policies(result)]
    return tuple(sorted(found, key=lambda each: (-each.spread, -each.distance, each.name)))


def _of_tasks(result: Result) -> Iterator[Difference]:
    for task in result.tried_tasks:
        records = {record.job.backend: record for record in result.of(Kind.TASK) if record.job.name == task}
        played = {backend: record.task for backend, record in records.items() if record.task}
        refused = [backend for backend, record in records.items() if record.status is Status.UNSUPPORTED]
        if len(played) + len(refused) > 1 and played:
            yield _difference(task, f"task-{task}", played, refused, *_farthest(result, task))


def _of_policies(result: Result) -> Iterator[Difference]:
    for info in result.header.policies:
        records = [r for r in result.of(Kind.TRANSFER) if r.job.name == info.name and not r.job.renderer]
        played = {record.job.backend: record.transfer.result for record in records if record.transfer}
        refused = [record.job.backend for record in records if record.status is Status.UNSUPPORTED]
        if len(played) + len(refused) > 1 and played:
            yield _difference(f"{info.task}, policy {info.name}", "transfers", played, refused, "", 0.0)


def _difference(
    name: str, anchor: str, played: Mapping[str, TaskResult], refused: list[str], trajectories: str, distance: float
) -> Difference:
    success = {backend: round(100 * found.success.value) for backend, found in played.items()}
    text = _extremes({backend: f"{percent} %" for backend, percent in success.items()}, success)
    if refused:
        text += f"; refused by {', '.join(refused)}"
    leading = next(iter(next(iter(played.values())).metrics))
    means = {backend: found.metrics[leading].value for backend, found in played.items()}
    metric = f"{leading}: {_extremes({backend: f'{mean:.2g}' for backend, mean in means.items()}, means)}"
    # A refused task is the largest difference that there can be for its user.
    lowest = 0 if refused else min(success.values())
    return Difference(name, anchor, text, metric, trajectories, float(max(success.values()) - lowest), distance)


def _extremes(texts: Mapping[str, str], values: Mapping[str, float]) -> str:
    """Return the lowest and the highest text with the backends that have them; one text where all read alike."""
    low, high = texts[min(values, key=lambda b: values[b])], texts[max(values, key=lambda b: values[b])]
    if low == high:
        return low
    ends = ((text, ", ".join(backend for backend in texts if texts[backend] == text)) for text in (low, high))
    return " to ".join(f"{text} ({backends})" for text, backends in ends)


def _farthest(result: Result, task: str) -> tuple[str, float]:
    """Return the thing and pair of backends whose median distance is largest at any time, and that distance."""
    peaks = [
        (max(thing.median), thing.thing, pair)
        for pair in result.partings
        if pair.task == task
        for thing in pair.things
        if thing.median
    ]
    if not peaks:
        return "", 0.0
    distance, thing, pair = max(peaks, key=lambda peak: peak[0])
    return f"{distance:.2g} m: {thing}, {pair.backend} from {pair.reference}", distance
