"""All checks of robots, in the order in which reports show them, and a robot put to them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from orbit_assets.catalogue import robot
from orbit_conformance.robots.check import CheckResult, RobotCheck, RobotResult, judge_check
from orbit_conformance.robots.description import DESCRIPTION
from orbit_conformance.robots.exceptions import ROBOT_GAPS
from orbit_conformance.robots.grasping import GRASP
from orbit_conformance.robots.standing import HOLD, STAND
from orbit_conformance.robots.tracking import TRACKING
from orbit_conformance.scenario import Trial
from orbit_conformance.verdict import Status
from orbit_core.interfaces import Backend, Gap, SimulationError, UnsupportedCapabilityError
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import RobotSpec

CHECKS: tuple[RobotCheck, ...] = (DESCRIPTION, HOLD, TRACKING, GRASP, STAND)


def load_robot(name: str) -> RobotSpec:
    """The robot as worlds simulate it: links that cannot move against each other made one.

    Raises:
        UnknownNameError: there is no such robot.
        AssetError: its model cannot be had.
    """
    spec = robot(name)
    return robot(name, articulation=merge_fixed_links(spec.articulation))


def check_robot(name: str, backend: Backend, trial: Trial, checks: Sequence[RobotCheck] = CHECKS) -> RobotResult:
    """Put a robot to all checks that apply to it, on the trial's backend, and judge them.

    Raises:
        UnknownNameError: there is no such robot.
        AssetError: its model cannot be had.
    """
    spec = load_robot(name)
    gaps = (*ROBOT_GAPS, *backend.gaps())
    spared = {check.name: reason for check in checks if (reason := check.spared(spec))}
    return RobotResult(
        joints=sum(joint.mimic is None for joint in spec.articulation.movable_joints),
        mass=spec.articulation.mass,
        categories=tuple(category.value for category in spec.categories),
        checks=tuple(_checked(check, name, spec, trial, gaps) for check in checks if check.name not in spared),
        spared=spared,
    )


def _checked(check: RobotCheck, name: str, spec: RobotSpec, trial: Trial, gaps: Sequence[Gap]) -> CheckResult:
    begin = time.perf_counter()

    def result(status: Status, reason: str, errors: dict[str, float], figures: dict[str, float]) -> CheckResult:
        return CheckResult(check.name, status, reason, errors, figures, time.perf_counter() - begin)

    try:
        with trial:
            measures = check.run(trial, spec)
    except UnsupportedCapabilityError as error:
        return result(Status.UNSUPPORTED, str(error), {}, {})
    except SimulationError as error:
        errors = dict.fromkeys((metric.name for metric in check.metrics), math.inf)
        verdict = judge_check(check, errors, gaps, name)
        return result(verdict.status, f"{error}; {verdict.reason}", errors, {})
    verdict = judge_check(check, measures.errors, gaps, name)
    return result(verdict.status, verdict.reason, dict(measures.errors), dict(measures.figures))
