"""A check of a robot: an experiment that any robot of a kind can be put to, on any backend."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from orbit_conformance.scenario import Metric, Trial
from orbit_conformance.verdict import Status, Verdict, judge_metrics
from orbit_core.interfaces import Gap
from orbit_core.scene import RobotSpec

# Seconds, that of the tasks.
TIME_STEP = 0.005


@dataclass(frozen=True)
class Measures:
    """Errors and figures of a check of one robot on one backend."""

    errors: Mapping[str, float]
    """Errors by metric; a metric that does not apply to the robot is left out."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """What reports show beside the errors, by words with the unit."""


@dataclass(frozen=True, kw_only=True)
class RobotCheck:
    """An experiment with a robot, the truth that it is held against, and how far from it an engine may be."""

    name: str
    """Name in snake case, unlike any scenario's; declared gaps name it."""
    title: str
    """A word for a column of a table."""
    question: str
    """The question that the check asks, in one sentence."""
    truth: str
    """The closed form, or the requirement, that answers it."""
    metrics: tuple[Metric, ...]
    spared: Callable[[RobotSpec], str]
    """Why a robot is not put to it, as an arm does not stand; empty where it is."""
    run: Callable[[Trial, RobotSpec], Measures]

    def metric(self, name: str) -> Metric:
        """The metric of that name."""
        return next(metric for metric in self.metrics if metric.name == name)


@dataclass(frozen=True)
class CheckResult:
    """The outcome of one check of a robot on a backend."""

    check: str
    status: Status
    reason: str
    """The reason for anything but a pass."""
    errors: dict[str, float]
    """Errors by metric."""
    figures: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    """Wall time, building of the world included."""


@dataclass(frozen=True)
class RobotResult:
    """The outcomes of all checks of a robot on a backend."""

    joints: int
    """Number of joints that move freely."""
    mass: float
    """Total mass of the description in kg."""
    checks: tuple[CheckResult, ...]
    categories: tuple[str, ...] = ()
    spared: dict[str, str] = field(default_factory=dict)
    """Reasons by check, of those that the robot is not put to."""

    @property
    def status(self) -> Status:
        """The worst of the checks'; unsupported where the backend can do none of them."""
        found = [check.status for check in self.checks]
        ranks = (Status.FAIL, Status.STALE, Status.GAP, Status.PASS)
        return next((status for status in ranks if status in found), Status.UNSUPPORTED)

    @property
    def reason(self) -> str:
        """The reasons of the checks that have the status."""
        return "; ".join(f"{c.check}: {c.reason}" for c in self.checks if c.status is self.status and c.reason)

    def check(self, name: str) -> CheckResult | None:
        """The outcome of the check of that name; None where it was not run."""
        return next((check for check in self.checks if check.check == name), None)


def judge_check(check: RobotCheck, errors: Mapping[str, float], gaps: Sequence[Gap], robot: str) -> Verdict:
    """Hold a robot's errors against tolerances and the declared gaps that name it."""
    own = {gap.metric: gap for gap in gaps if gap.scenario == check.name and robot in gap.robots}
    return judge_metrics([metric for metric in check.metrics if metric.name in errors], errors, own)
