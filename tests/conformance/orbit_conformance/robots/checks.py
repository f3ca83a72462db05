"""All checks of robots, in the order in which reports show them, and a robot put to them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np
import torch

from orbit_assets.audit.robots.postures import with_followers
from orbit_assets.catalogue import robot
from orbit_conformance.bodies import scene
from orbit_conformance.robots.check import (
    ROBOT_GAPS,
    CheckResult,
    Measures,
    RobotCheck,
    RobotResult,
    judge_check,
    travel,
)
from orbit_conformance.robots.grasping import GRASP
from orbit_conformance.robots.standing import HOLD, STAND
from orbit_conformance.robots.tracking import TRACKING
from orbit_conformance.scenario import SINGLE, Metric, Trial
from orbit_conformance.verdict import Status
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.dynamics.transforms import quat_distance
from orbit_core.interfaces import Backend, Gap, Robot, SimulationError, UnsupportedCapabilityError, World
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import RobotSpec

# Check that an engine built the robot that was described: its mass and its link poses ---------------------------------

# Twenty configurations, spread over environments so that a wrong one shows.
_ENVS, _ROUNDS = 4, 5


def _run(trial: Trial, spec: RobotSpec) -> Measures:
    world = trial.world(scene(spec, terrain=()), _ENVS)
    robot = world.robots[spec.name]
    random = np.random.default_rng(trial.seed)
    found = [_misplaced(world, robot, spec, random) for _ in range(_ROUNDS)]
    return Measures(
        {
            "mass": _mass_error(world, spec),
            "position": max(position for position, _ in found),
            "orientation": max(orientation for _, orientation in found),
        },
        {"mass (kg)": spec.articulation.mass},
    )


def _mass_error(world: World, spec: RobotSpec) -> float:
    """Relative. The number of a fixed root plays no part in any motion, and engines may keep none."""
    # A fixed root never moves.
    moving = slice(1 if spec.fixed_base else 0, None)
    links = world.engine.layout.entity(spec.name).links
    built = world.engine.built_model()[0].masses[links][moving].sum()
    described = sum(link.mass for link in spec.articulation.links[moving])
    return abs(float(built) - described) / described


def _misplaced(world: World, robot: Robot, spec: RobotSpec, random: np.random.Generator) -> tuple[float, float]:
    """Largest distance (m) and angle (rad) of a link from where the description has it, in random configurations."""
    articulation = spec.articulation
    joints = articulation.movable_joints
    low, high = np.array([travel(joint) for joint in joints]).T
    home = robot.home_positions.cpu().numpy().astype(np.float64)
    # Random joint positions would tear a closed loop open.
    drawn = home if articulation.loops else random.uniform(low, high, (world.num_envs, len(joints)))
    positions = _tensor(world, with_followers(articulation, np.broadcast_to(drawn, (world.num_envs, len(joints)))))
    robot.set_joint_state(positions, torch.zeros_like(positions))
    root = robot.root_pose.clone()
    if not spec.fixed_base:
        # Normal components make uniformly distributed rotations.
        turned = random.normal(size=(world.num_envs, 4))
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        root = _tensor(world, np.concatenate((random.uniform(0.5, 1.5, (world.num_envs, 3)), turned), 1))
        robot.set_root_pose(root)
    # Double precision: the truth must be better than the engine's single.
    tree = KinematicTree(articulation, dtype=torch.float64)
    truth = tree.forward(root.cpu().double(), positions.cpu().double())
    measured = robot.link_poses.cpu().double()
    distance = (measured[..., :3] - truth[..., :3]).norm(dim=-1).max()
    return float(distance), float(quat_distance(measured[..., 3:], truth[..., 3:]).max())


def _tensor(world: World, values: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32, device=world.device)


DESCRIPTION = RobotCheck(
    name="robot_description",
    title="description",
    question="Does the engine have the robot's mass, and its links where the description's kinematics put them?",
    truth="the description's total mass, without a fixed root's; forward kinematics in double precision",
    metrics=(
        Metric(
            name="mass",
            unit="",
            tolerance=1e-5,
            meaning="relative error of the total mass that the engine holds",
            looser_because=SINGLE,
        ),
        Metric(
            name="position",
            unit="m",
            tolerance=1e-5,
            meaning="largest distance of a link from its place, 20 random configurations",
            looser_because=SINGLE,
        ),
        Metric(
            name="orientation",
            unit="rad",
            tolerance=1e-5,
            meaning="largest angle of a link from its orientation, 20 random configurations",
            looser_because=SINGLE,
        ),
    ),
    spared=lambda spec: "",
    run=_run,
)


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
