"""A check of a robot: an experiment that any robot of a kind can be put to, on any backend."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from orbit_conformance.scenario import Metric, Trial
from orbit_conformance.verdict import Status, Verdict, judge_metrics
from orbit_core.interfaces import Gap, match_names
from orbit_core.scene import Joint, JointType, RobotSpec

# Test bench of a robot: its placement, and the joints that are moved there --------------------------------------------

FloatArray = npt.NDArray[np.float64]
# Radians to either side of zero, for joints without limits.
_TURN = math.pi


def clamped(spec: RobotSpec) -> RobotSpec:
    """The robot with its root held, and links that do not collide with each other."""
    return replace(spec, fixed_base=True, articulation=replace(spec.articulation, self_collisions=False))


def frictionless(spec: RobotSpec) -> RobotSpec:
    """The robot without Coulomb friction in its joints, which no linear law describes."""
    joints = tuple(replace(joint, friction=0.0) for joint in spec.articulation.joints)
    groups = tuple(replace(group, friction=None) for group in spec.actuators)
    return replace(spec, articulation=replace(spec.articulation, joints=joints), actuators=groups)


def travel(joint: Joint) -> tuple[float, float]:
    """The limits of a joint, in rad or m; half a turn, or as many metres, where it has none."""
    if joint.type is JointType.CONTINUOUS:
        return -_TURN, _TURN
    low, high = joint.lower_limit, joint.upper_limit
    return (low if math.isfinite(low) else -_TURN), (high if math.isfinite(high) else _TURN)


def drive_gains(spec: RobotSpec) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping (J,) of the joints' drives, the engine's or ORBIT's; zero where there is none."""
    gains = np.zeros((2, len(spec.articulation.joint_names)))
    for group in spec.actuators:
        joints = match_names(group.joints, spec.articulation.joint_names, "joint", f"'{spec.name}'")
        gains[:, joints] = [[group.stiffness], [group.damping]]
    return gains[0], gains[1]


def held_joints(spec: RobotSpec) -> list[int]:
    """Indices of the joints that a drive with stiffness holds in place."""
    stiffness, _ = drive_gains(spec)
    joints = enumerate(spec.articulation.movable_joints)
    return [index for index, joint in joints if joint.mimic is None and stiffness[index] > 0.0]


# Declared gaps of robots that miss a check on every engine, by their own nature ---------------------------------------

ROBOT_GAPS: tuple[Gap, ...] = ()


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
    """Errors that ``run`` returns, with their tolerances."""
    spared: Callable[[RobotSpec], str]
    """Why a robot is not put to it, as an arm does not stand; empty where it is."""
    run: Callable[[Trial, RobotSpec], Measures]
    """Function that measures a robot on a trial's backend."""

    def metric(self, name: str) -> Metric:
        """The metric of that name."""
        return next(metric for metric in self.metrics if metric.name == name)


@dataclass(frozen=True)
class CheckResult:
    """The outcome of one check of a robot on a backend."""

    check: str
    """Name of the check."""
    status: Status
    """Pass, declared gap or failure."""
    reason: str
    """The reason for anything but a pass."""
    errors: dict[str, float]
    """Errors by metric."""
    figures: dict[str, float] = field(default_factory=dict)
    """Further measured values by name."""
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
    """Outcomes in order."""
    categories: tuple[str, ...] = ()
    """Kinds of robot that it is: arm, hand, mobile, legged."""
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
