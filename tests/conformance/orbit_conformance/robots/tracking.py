"""Check of drives that follow a sine, one joint per environment, against the linear frequency response."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from orbit_assets.audit.robots.postures import with_followers
from orbit_conformance.bodies import WEIGHTLESS, scene
from orbit_conformance.robots.check import Measures, RobotCheck, clamped, drive_gains, frictionless, held_joints, travel
from orbit_conformance.scenario import Metric, Trial
from orbit_core.dynamics.kinematics import mimic_matrix
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.interfaces import Robot, SceneLayout, World
from orbit_core.scene import Articulation, Joint, JointType, RobotSpec

# Frequency response of PD drives to a small sine of their targets, of the linearised mechanism ------------------------
# About a configuration at rest and without gravity, joints behind drives of stiffness k and damping d obey
# ``M q'' + (d + d_j) q' + (k + k_j) q = k q*``, with the mass matrix M, and damping d_j and springs k_j of the
# mechanism itself. A sine of the target's position alone, at the angular frequency w, moves them by ``H = (k + k_j -
# w^2 M + i w (d + d_j))^-1 k`` (Ogata, Modern Control Engineering, section 7.1). Far below the natural frequency the
# lag is ``d / k`` seconds, whatever the inertia.

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearJoints:
    """Coefficients (J,) of all movable joints, in N m/rad, N m s/rad and kg m^2, or N/m, N s/m and kg."""

    stiffness: FloatArray
    """Of the drives; zero where there is none."""
    damping: FloatArray
    """Of the drives."""
    spring_stiffness: FloatArray
    """Stiffness of the mechanisms' springs."""
    joint_damping: FloatArray
    """Damping of the mechanisms."""
    armature: FloatArray
    """Reflected inertia of the motors."""


def drive_response(
    articulation: Articulation, joints: LinearJoints, positions: FloatArray, frequency: float
) -> ComplexArray:
    """Motion of all joints for a unit sine of one joint's target.

    Args:
        articulation: with a fixed root. Followers move as their leaders make them, by their slope where these are at
            zero, and have no drive of their own.
        joints: drives, springs, damping and armatures.
        positions: (n, J) configurations.
        frequency: of the sine in Hz.

    Returns:
        (n, J, J) complex; the column is the joint whose target moves. Zero in columns of followers and of joints
        without stiffness.
    """
    fold = mimic_matrix(articulation)
    leaders = np.array([joint.mimic is None for joint in articulation.movable_joints])
    drives = np.where(leaders, joints.stiffness, 0.0)
    stiffness = fold.T @ np.diag(drives + joints.spring_stiffness) @ fold
    damping = fold.T @ np.diag(np.where(leaders, joints.damping, 0.0) + joints.joint_damping) @ fold
    mass = fold.T @ _mass_matrices(articulation, joints.armature, positions) @ fold
    rate = 2.0 * math.pi * frequency
    dynamic = stiffness - rate**2 * mass + 1j * rate * damping
    free = np.ix_(leaders, leaders)
    response = np.zeros(dynamic.shape, dtype=np.complex128)
    for number, matrix in enumerate(dynamic):
        response[number][free] = np.linalg.solve(matrix[free], np.diag(drives)[free].astype(np.complex128))
    return fold @ response


def _mass_matrices(articulation: Articulation, armature: FloatArray, positions: FloatArray) -> FloatArray:
    """(n, J, J) in double precision: the fingers' moments are small differences of large ones."""
    model = RigidBodyModel(articulation, True, armature=armature.tolist(), dtype=torch.float64)
    root = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64).repeat(len(positions), 1)
    poses = model.kinematics.forward(root, torch.as_tensor(positions))
    return model.mass_matrix(poses).numpy()


# Hz
FREQUENCY = 0.5
_RATE = 2.0 * math.pi * FREQUENCY
# Largest swing from end to end, of a joint's range.
_SWING = 0.3
# Largest peak velocity, of a joint's velocity limit.
_SPEED = 0.8
# Largest peak effort of the linear solution, of a joint's effort limit.
_EFFORT = 0.5
# The sine grows in the first, and is measured over the second.
_PERIODS = 2


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
    # Phase over angular frequency is the lag in seconds, which users compare.
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
    # Only the driven joint's target moves; coupled joints answer without a target of their own motion.
    moved = np.zeros_like(response)
    moved[rows, joints] = 1.0
    efforts = np.abs(stiffness * (moved - response) - 1j * _RATE * damping * response)
    strongest = (_EFFORT * limits.effort_limit / np.maximum(efforts, 1e-12)).min(1)
    fastest = _SPEED * limits.velocity_limit[joints] / _RATE
    # The linear response holds only where no limit of range, effort or speed is met.
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
        # The sine grows smoothly over the first period, so that its start excites no free motion.
        growth = min(1.0, time * FREQUENCY)
        sine = growth * growth * (3.0 - 2.0 * growth) * math.sin(_RATE * time)
        targets[rows, joints] = start[rows, joints] + sine * amplitudes
        robot.set_position_targets(targets)
        trial.step(world)
        # Only the last period, in which the transient has died out.
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
    # A least-squares fit of the sine: what remains is distortion, such as stick-slip or saturation.
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
