"""Comparison of two results: changes for better or worse that exceed noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from orbit_conformance.jobs import Job, Kind
from orbit_conformance.results import Record, Result, ScenarioInfo
from orbit_conformance.verdict import Status
from orbit_core.rollout.estimates import Estimate

# Smaller changes of an error, as a share of it or of its tolerance, are the noise of other processors and threads.
ERROR_NOISE = 0.1
# Relative change of a speed that the other work of a machine may cause.
SPEED_NOISE = 0.2
_RANKS = (Status.PASS, Status.GAP, Status.UNSUPPORTED, Status.STALE, Status.FAIL)


@dataclass(frozen=True)
class Change:
    """One difference between two results."""

    job: Job
    what: str
    """A status, a metric with its unit, or a speed."""
    before: str
    after: str
    better: bool
    of_status: bool = False


@dataclass(frozen=True)
class Comparison:
    """All changes, and what could not be compared."""

    changes: tuple[Change, ...]
    notes: tuple[str, ...]

    @property
    def worse_status(self) -> bool:
        """Return True if the status of any backend got worse."""
        return any(change.of_status and not change.better for change in self.changes)


def compare(before: Result, after: Result) -> Comparison:
    """Hold the later result against the earlier one, job by job; what only one of them has is noted."""
    old = {record.job: record for record in before.judged}
    new = {record.job: record for record in after.judged}
    # Speeds of two machines say nothing about the code.
    same_machine = before.header.hardware == after.header.hardware
    metrics = {info.name: info for info in after.header.scenarios}
    changes = [
        change
        for job in new
        if job in old
        for change in _changes(old[job], new[job], metrics.get(job.name), same_machine)
    ]
    return Comparison(tuple(changes), tuple(_notes({*old}, {*new}, same_machine)))


def _notes(old: set[Job], new: set[Job], same_machine: bool) -> Iterator[str]:
    for jobs, where in ((old - new, "earlier"), (new - old, "later")):
        if jobs:
            keys = sorted(job.key for job in jobs)
            yield f"{len(keys)} only in the {where} result: {', '.join(keys[:5])}{' ...' if len(keys) > 5 else ''}"
    if not same_machine:
        yield "the machines differ: speeds are not compared"


def _changes(old: Record, new: Record, info: ScenarioInfo | None, same_machine: bool) -> Iterator[Change]:
    if old.status is not new.status:
        better = _RANKS.index(new.status) < _RANKS.index(old.status)
        yield Change(new.job, "status", old.status.value, f"{new.status.value} {new.why}".strip(), better, True)
    if old.scenario and new.scenario and info:
        yield from _errors(old, new, info)
    before, after = old.played, new.played
    if before and after:
        yield from _estimates(new.job, "success", before.success, after.success, higher_is_better=True)
        name = next(iter(after.metrics), "")
        if name in before.metrics:
            yield from _estimates(new.job, name, before.metrics[name], after.metrics[name], higher_is_better=False)
    if same_machine:
        yield from _speed(old, new)


def _errors(old: Record, new: Record, info: ScenarioInfo) -> Iterator[Change]:
    assert old.scenario is not None
    assert new.scenario is not None
    for metric in info.metrics:
        before = old.scenario.errors.get(metric.name, math.nan)
        after = new.scenario.errors.get(metric.name, math.nan)
        # Relative to the tolerance as well: a tenth of an error near zero is no change.
        noise = ERROR_NOISE * max(abs(before), metric.tolerance)
        if math.isfinite(before) != math.isfinite(after) or abs(after - before) > noise:
            texts = (f"{value:.3g} {metric.unit}".strip() for value in (before, after))
            yield Change(new.job, metric.name, *texts, better=not math.isfinite(before) or after < before)


def _estimates(job: Job, what: str, before: Estimate, after: Estimate, *, higher_is_better: bool) -> Iterator[Change]:
    """The change of an estimate, if the confidence intervals lie apart."""
    if after.low > before.high or after.high < before.low:
        texts = (f"{e.value:.3g} [{e.low:.3g}, {e.high:.3g}]" for e in (before, after))
        yield Change(job, what, *texts, better=(after.value > before.value) == higher_is_better)


def _speed(old: Record, new: Record) -> Iterator[Change]:
    """Yield the change of a speed; only of throughput, the one speed that is measured on an idle machine."""
    if new.job.kind is Kind.THROUGHPUT and old.throughput and new.throughput:
        before, after = old.throughput.env_steps_per_second, new.throughput.env_steps_per_second
        if abs(after - before) > SPEED_NOISE * before:
            texts = (f"{value:,.0f} env. steps/s" for value in (before, after))
            yield Change(new.job, "throughput", *texts, better=after > before)
