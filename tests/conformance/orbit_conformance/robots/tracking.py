"""How a robot's drives follow a sine, one joint in each environment, against the linear frequency response."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from orbit_assets.audit.robots.postures import with_followers
from orbit_conformance.bodies import WEIGHTLESS, scene
from orbit_conformance.drive_response import LinearJoints, drive_response
from orbit_conformance.robots.bench import clamped, drive_gains, frictionless, held_joints, travel
from orbit_conformance.robots.check import Measures, RobotCheck
from orbit_conformance.scenario import Metric, Trial
from orbit_core.interfaces import Robot, SceneLayout, World
from orbit_core.scene import Joint, JointType, RobotSpec

FloatArray = npt.NDArray[np.float64]

FREQUENCY = 0.5
"""Hz"""
_RATE = 2.0 * math.pi * FREQUENCY
_SWING = 0.3
"""Largest swing from end to end, of a joint's range."""
_SPEED = 0.8
"""Largest peak velocity, of a joint's velocity limit."""
_EFFORT = 0.5
"""Largest peak effort of the linear solution, of a joint's effort limit."""
_PERIODS = 2
"""The sine grows in the first, and is measured over the second."""


@dataclass(frozen=True, eq=False)
class _Plan:
    """One joint's sine in each of k environments."""

    joints: npt.NDArray[np.int64]
    """(k,) the joint that moves."""
    positions: FloatArray
    """(k, J) about which it moves, the others at home."""
    amplitudes: FloatArray
    """(k,) rad or m."""
    response: npt.NDArray[np.complex128]
    """(k,) of the joint to its own target, linearised."""


def _run(trial: Trial, spec: RobotSpec) -> Measures:
    bench = frictionless(clamped(spec))
    plan = _planned(bench)
    world = trial.world(scene(bench, terrain=(), gravity=WEIGHTLESS), len(plan.joints))
    robot = world.robots[spec.name]
    motion, strays = _tracked(trial, world, robot, plan, bench)
    fitted, residual = _fitted(trial, motion)
    measured = fitted / plan.amplitudes
    turned = measured / plan.response
    lags = -np.angle(measured) / _RATE
    errors = {
        "gain": float(np.abs(np.abs(measured) - np.abs(plan.response)).max()),
        "lag": float(np.abs(np.angle(turned)).max() / _RATE),
        "distortion": float((residual / plan.amplitudes).max()),
    }
    if any(joint.mimic for joint in spec.articulation.movable_joints):
        errors["followers"] = strays
    figures = {
        "largest lag (s)": float(lags.max()),
        "smallest gain": float(np.abs(measured).min()),
        "largest tracking error (of amplitude)": float(np.abs(measured - 1.0).max()),
    }
    return Measures(errors, figures)


def _planned(spec: RobotSpec) -> _Plan:
    joints = np.array(held_joints(spec))
    movable = [spec.articulation.movable_joints[joint] for joint in joints]
    limits = SceneLayout.of(scene(spec)).joint_parameters
    home = limits.home
    widest = np.array([_SWING / 2.0 * (high - low) for low, high in map(travel, movable)])
    positions = np.tile(home, (len(joints), 1))
    rows = np.arange(len(joints))
    positions[rows, joints] = [_center(joint, at, 1.1 * reach)
                               for joint, at, reach in zip(movable, home[joints], widest, strict=True)]  # fmt: skip
    positions = with_followers(spec.articulation, positions)
    stiffness, damping = drive_gains(spec)
    linear = LinearJoints(
        stiffness=stiffness,
        damping=damping,
        spring_stiffness=limits.spring_stiffness,
        joint_damping=limits.damping,
        armature=limits.armature,
    )
    response = drive_response(spec.articulation, linear, positions, FREQUENCY)[rows, :, joints]
    # Efforts of all drives, per unit of the sine of one: k (q* - q) - d q'.
    moved = np.zeros_like(response)
    moved[rows, joints] = 1.0
    efforts = np.abs(stiffness * (moved - response) - 1j * _RATE * damping * response)
    strongest = (_EFFORT * limits.effort_limit / np.maximum(efforts, 1e-12)).min(1)
    fastest = _SPEED * limits.velocity_limit[joints] / _RATE
    amplitudes = np.minimum(np.minimum(widest, strongest), fastest)
    return _Plan(joints, positions, amplitudes, response[rows, joints])


def _center(joint: Joint, home: float, reach: float) -> float:
    """The nearest position to home that leaves ``reach`` on either side."""
    if joint.type is JointType.CONTINUOUS:
        return home
    low, high = travel(joint)
    return min(max(home, low + reach), high - reach)


def _tracked(trial: Trial, world: World, robot: Robot, plan: _Plan, spec: RobotSpec) -> tuple[FloatArray, float]:
    """The joints' motion (T, k) over the last period, and by how much followers stray from their leaders, if any."""
    start = _tensor(world, plan.positions)
    robot.set_joint_state(start, torch.zeros_like(start))
    rows = torch.arange(len(plan.joints), device=world.device)
    joints = torch.as_tensor(plan.joints, device=world.device)
    amplitudes = _tensor(world, plan.amplitudes)
    period = trial.steps(1.0 / FREQUENCY)
    targets, motion = start.clone(), list[torch.Tensor]()
    strays = list[torch.Tensor]()
    for step in range(_PERIODS * period):
        time = (step + 0.5) * trial.time_step  # the middle of the step in which the target holds
        growth = min(1.0, time * FREQUENCY)
        sine = growth * growth * (3.0 - 2.0 * growth) * math.sin(_RATE * time)
        targets[rows, joints] = start[rows, joints] + sine * amplitudes
        robot.set_position_targets(targets)
        trial.step(world)
        if step >= (_PERIODS - 1) * period:
            motion.append((robot.joint_positions - start)[rows, joints].clone())
            strays.append(_stray(spec, robot.joint_positions))
    return torch.stack(motion).cpu().double().numpy(), float(torch.stack(strays).max())


def _stray(spec: RobotSpec, positions: torch.Tensor) -> torch.Tensor:
    """() how far a follower is from where its leader puts it, in rad or m."""
    names = spec.articulation.joint_names
    apart = [torch.zeros((), device=positions.device)]
    for index, joint in enumerate(spec.articulation.movable_joints):
        if joint.mimic is not None:
            wanted = joint.mimic.position(positions[:, names.index(joint.mimic.joint)])
            apart.append((positions[:, index] - wanted).abs().max())
    return torch.stack(apart).max()


def _fitted(trial: Trial, motion: FloatArray) -> tuple[npt.NDArray[np.complex128], FloatArray]:
    """(k,) complex amplitudes of the sine in each motion (T, k), and what is left of it, as a root mean square."""
    steps = np.arange(len(motion)) + 1 + (_PERIODS - 1) * trial.steps(1.0 / FREQUENCY)
    phase = _RATE * trial.time_step * steps
    basis = np.stack((np.ones_like(phase), np.sin(phase), np.cos(phase)), 1)
    coefficients = np.linalg.lstsq(basis, motion, rcond=None)[0]
    residual = np.sqrt(np.square(motion - basis @ coefficients).mean(0))
    return coefficients[1] + 1j * coefficients[2], residual


def _tensor(world: World, values: FloatArray) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32, device=world.device)


_CURVED = "the inertia changes over the swing, which the linear truth leaves out"

TRACKING = RobotCheck(
    name="robot_tracking",
    title="tracks a sine",
    question="Does each joint follow a 0.5 Hz sine as its gains and the inertia that it moves say?",
    truth="H = (k + k_j - w^2 M + i w (d + d_j))^-1 k at w = 2 pi 0.5 Hz, the root held, no gravity, no dry friction; "
    "30 % of the joint's range from end to end, less where 80 % of its velocity or half its effort limit ask for it",
    metrics=(
        Metric(
            name="gain",
            unit="",
            tolerance=0.02,
            meaning="largest error of a joint's amplitude, as a share of its target's",
            looser_because=_CURVED,
        ),
        Metric(
            name="lag",
            unit="s",
            tolerance=0.005,
            meaning="largest error of a joint's lag behind its target",
            looser_because=f"{_CURVED}; one time step",
        ),
        Metric(
            name="distortion",
            unit="",
            tolerance=0.02,
            meaning="largest departure of a joint's motion from a sine, root mean square, as a share of its target's",
            looser_because=_CURVED,
        ),
        Metric(
            name="followers",
            unit="rad or m",
            tolerance=0.005,
            meaning="farthest that a joint which mimics another strays from where that puts it",
        ),
    ),
    spared=lambda spec: "" if held_joints(spec) else "no joint has a position drive",
    run=_run,
)
