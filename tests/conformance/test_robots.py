"""Checks of robots: what is right passes, and what is broken fails the check that is there for it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from orbit_conformance.execution import execute
from orbit_conformance.jobs import Job, Kind, plan
from orbit_conformance.report.page import page_of, render
from orbit_conformance.results import Result, decode, encode
from orbit_conformance.robots.check import ROBOT_GAPS, TIME_STEP, Measures, RobotCheck, RobotResult, judge_check
from orbit_conformance.robots.checks import CHECKS, check_robot, load_robot
from orbit_conformance.robots.grasping import GRASP
from orbit_conformance.robots.standing import STAND
from orbit_conformance.runner import header_of
from orbit_conformance.scenario import Trial
from orbit_conformance.settings import QUICK_ROBOTS, Part, check_declarations, choose
from orbit_conformance.verdict import Status
from orbit_core.backends import backend, default_backend
from orbit_core.interfaces import ConfigurationError, Gap, SimulationError, UnknownNameError, World
from orbit_core.scene import Articulation, RobotSpec, Scene

BACKEND = default_backend()
DESCRIPTION, HOLD, TRACKING = CHECKS[:3]


def test_a_robot_passes_every_check_that_applies_to_it() -> None:
    result = check_robot("franka_panda", backend(BACKEND), Trial(BACKEND, TIME_STEP))
    assert result.status.acceptable, result.reason
    assert {check.check for check in result.checks} | {*result.spared} == {check.name for check in CHECKS}


@dataclass
class Tampering(Trial):
    """An engine that builds another robot than it is asked for."""

    tamper: Callable[[RobotSpec], RobotSpec] = lambda spec: spec

    def world(self, scene: Scene, num_envs: int = 1) -> World:
        return super().world(replace(scene, robots=tuple(map(self.tamper, scene.robots))), num_envs)


def errors_of(check: RobotCheck, name: str, tamper: Callable[[RobotSpec], RobotSpec]) -> set[str]:
    """The metrics that miss their tolerance."""
    with Tampering(BACKEND, TIME_STEP, tamper=tamper) as trial:
        errors = check.run(trial, load_robot(name)).errors
    return {metric for metric, error in errors.items() if not error <= check.metric(metric).tolerance}


def edited(change: Callable[[Articulation], Articulation]) -> Callable[[RobotSpec], RobotSpec]:
    return lambda spec: replace(spec, articulation=change(spec.articulation))


def driven(**values: Any) -> Callable[[RobotSpec], RobotSpec]:
    return lambda spec: replace(spec, actuators=tuple(replace(group, **values) for group in spec.actuators))


def heavier(articulation: Articulation) -> Articulation:
    *others, last = articulation.links
    return replace(articulation, links=(*others, replace(last, mass=1.05 * last.mass)))


def longer(articulation: Articulation) -> Articulation:
    first, *others = articulation.joints
    x, y, z = first.parent_pose.position
    moved = replace(first, parent_pose=replace(first.parent_pose, position=(x, y, z + 1e-4)))
    return replace(articulation, joints=(moved, *others))


def uncoupled(articulation: Articulation) -> Articulation:
    return replace(articulation, joints=tuple(replace(joint, mimic=None) for joint in articulation.joints))


def heavy(spec: RobotSpec) -> RobotSpec:
    return replace(driven(stiffness=50.0)(spec), gravity_compensation=False)


@pytest.mark.parametrize(
    ("check", "name", "tamper", "missed"),
    [
        (DESCRIPTION, "franka_panda", edited(heavier), {"mass"}),
        (DESCRIPTION, "franka_panda", edited(longer), {"position"}),
        (HOLD, "franka_panda", heavy, {"angle"}),
        (TRACKING, "panda_hand", driven(stiffness=1000.0), {"gain", "lag"}),
        (TRACKING, "panda_hand", edited(uncoupled), {"followers"}),
        (GRASP, "panda_hand", driven(effort_limit=1.0), {"slip"}),
        (STAND, "unitree_go1", driven(stiffness=1.0), {"height"}),
    ],
    ids=["mass", "kinematics", "weak drives", "other gains", "no mimic", "weak fingers", "weak legs"],
)
def test_a_broken_robot_fails_the_check_that_is_there_for_it(
    check: RobotCheck, name: str, tamper: Callable[[RobotSpec], RobotSpec], missed: set[str]
) -> None:
    assert missed <= errors_of(check, name, tamper)
    assert not missed & errors_of(check, name, lambda spec: spec)


def test_a_hand_that_cannot_hold_the_cylinder_is_told_why() -> None:
    spec = load_robot("panda_hand")
    effector = spec.end_effector
    assert effector.gripper is not None
    narrow = replace(effector, gripper=replace(effector.gripper, open_position=0.01))
    assert GRASP.spared(spec) == ""
    assert "no room for a cylinder of 40 mm" in GRASP.spared(replace(spec, end_effectors=(narrow,)))
    assert "no gripper" in GRASP.spared(replace(spec, end_effectors=()))


# Verdicts


def failing(error: float) -> RobotCheck:
    return replace(HOLD, run=lambda trial, spec: Measures({"angle": error}), spared=lambda spec: "")


@pytest.mark.parametrize(
    ("error", "gaps", "status"),
    [
        (0.01, (), Status.PASS),
        (0.03, (), Status.FAIL),
        (0.03, (Gap("robot_hold", "angle", 0.05, "soft", ("cartpole",)),), Status.GAP),
        (0.03, (Gap("robot_hold", "angle", 0.05, "soft", ("unitree_go1",)),), Status.FAIL),
        (0.06, (Gap("robot_hold", "angle", 0.05, "soft", ("cartpole",)),), Status.FAIL),
        (0.01, (Gap("robot_hold", "angle", 0.05, "soft", ("cartpole",)),), Status.STALE),
    ],
)
def test_a_miss_is_held_against_the_gaps_that_name_the_robot(
    error: float, gaps: tuple[Gap, ...], status: Status
) -> None:
    assert judge_check(HOLD, {"angle": error}, gaps, "cartpole").status is status


def test_a_run_that_diverges_fails_with_the_engines_words() -> None:
    def diverge(trial: Trial, spec: RobotSpec) -> Measures:
        raise SimulationError("environment 0 diverged")

    checks = [replace(failing(0.0), run=diverge), failing(0.0)]
    result = check_robot("cartpole", backend(BACKEND), Trial(BACKEND, TIME_STEP), checks)
    assert [check.status for check in result.checks] == [Status.FAIL, Status.PASS]
    assert result.status is Status.FAIL
    assert "environment 0 diverged" in result.reason


def test_what_is_declared_of_robots_can_be_true(monkeypatch: pytest.MonkeyPatch) -> None:
    plugin = backend(BACKEND)
    for gap, complaint in (
        (Gap("robot_hold", "angle", 0.05, "soft"), "a check of robots, and no robot"),
        (Gap("robot_hold", "angel", 0.05, "soft", ("cartpole",)), "did you mean 'angle'"),
        (Gap("robot_hold", "angle", 0.05, "soft", ("cartpol",)), "unknown robot 'cartpol'"),
        (Gap("pendulum", "energy", 9.0, "soft", ("cartpole",)), "name robots for 'pendulum'"),
    ):
        monkeypatch.setattr(type(plugin), "gaps", lambda self, gap=gap: (gap,))
        with pytest.raises((ConfigurationError, UnknownNameError), match=complaint):
            check_declarations(plugin)
    monkeypatch.setattr(type(plugin), "gaps", lambda self: ROBOT_GAPS)
    check_declarations(plugin)


# In a run


def test_robots_are_named_by_their_parts_too() -> None:
    chosen = choose(robots=["ur10+robotiq_2f85"], backends=[BACKEND])
    assert (chosen.parts, chosen.robots) == ((Part.ROBOTS,), ("ur10+robotiq_2f85",))
    (phase,) = plan(chosen)
    assert [(job.kind, job.name) for job in phase.jobs] == [(Kind.ROBOT, "ur10+robotiq_2f85")]
    with pytest.raises(UnknownNameError, match="did you mean 'ur10'"):
        choose(robots=["ur11"])
    assert choose(quick=True).robots == QUICK_ROBOTS
    assert {*QUICK_ROBOTS} < {*choose().robots}


def test_the_report_has_a_table_of_robots_for_each_engine(tmp_path: Any) -> None:
    settings = choose(robots=["cartpole", "panda_hand"], backends=[BACKEND])
    records = tuple(execute(job, settings, {}).record for phase in plan(settings) for job in phase.jobs)
    assert all(isinstance(record.robot, RobotResult) for record in records)
    result = Result(header=header_of(settings), records=records, finished="2026-01-01T00:00:00+00:00")
    assert decode(encode(result), Result).records == records
    page = render(page_of(result, tmp_path))
    for words in ("panda_hand", "tracks a sine", "largest lag (s)"):
        assert words in page
    assert re.search(r"its root is held: whether it holds home", page)


def test_a_job_without_its_model_says_what_is_missing() -> None:
    settings = choose(robots=["cartpole"], backends=[BACKEND])
    record = execute(Job(Kind.ROBOT, "nothing", BACKEND), settings, {}).record
    assert record.status is Status.FAIL
    assert "unknown robot 'nothing'" in record.why
