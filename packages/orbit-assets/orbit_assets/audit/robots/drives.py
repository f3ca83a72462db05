"""Checks of a robot's motors: limits, armature, gains, what holds it at home."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from orbit_assets.audit.findings import Finding, Severity, names_in_short
from orbit_assets.audit.robots.postures import FloatArray
from orbit_core.actuators.stability import ExplicitGains, unstable_drive
from orbit_core.dynamics.kinematics import mimic_matrix
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.dynamics.workspace import DriveResponse, drive_responses, workspace_mass_matrices
from orbit_core.interfaces.layout import JointParameters, SceneLayout, actuator_of_joint
from orbit_core.scene import ImplicitPd, RobotSpec, Scene

_SLOW = 1.0
"""Hz: a joint of a lower natural frequency is left hanging."""
_LOOSE, _STIFF = 0.3, 10.0
"""Damping ratios: below the first a joint rings, beyond the second it creeps."""
_LIGHT = 1e-3
"""kg m^2 or kg that a joint without armature moves: less is light. Motors reflect more, see MOTOR_TIME."""
_SAG = 0.02
"""rad or m that a drive may give way at home."""


@dataclass(frozen=True, eq=False)
class JointRow:
    """One movable joint as the scene has it, after its actuator's overrides. Infinite is unlimited."""

    name: str
    effort_limit: float
    velocity_limit: float
    armature: float
    stiffness: float
    damping: float
    response: DriveResponse | None
    load: float
    """Effort (N m or N) that holds it at home against gravity; zero where that is compensated, or the base is free."""


def joint_rows(spec: RobotSpec) -> tuple[JointRow, ...]:
    """All joints that follow no other."""
    parameters = _parameters(spec)
    groups = actuator_of_joint(spec)
    responses = {response.joint: response for response in drive_responses(spec)}
    loads = np.zeros(len(spec.articulation.joint_names)) if _floats(spec) else _gravity_loads(spec, parameters)
    return tuple(
        JointRow(
            joint.name,
            float(parameters.effort_limit[index]),
            float(parameters.velocity_limit[index]),
            float(parameters.armature[index]),
            groups[index].stiffness if index in groups else 0.0,
            groups[index].damping if index in groups else 0.0,
            responses.get(joint.name),
            float(loads[index]),
        )
        for index, joint in enumerate(spec.articulation.movable_joints)
        if joint.mimic is None
    )


def check_drives(spec: RobotSpec, rows: tuple[JointRow, ...]) -> Iterator[Finding]:
    """Findings on limits, armatures and gains, alike joints together."""
    driven = {spec.articulation.joint_names[index] for index in actuator_of_joint(spec)}
    idle = [row.name for row in rows if row.name not in driven]
    if idle:
        yield Finding(Severity.WARNING, names_in_short(idle), "no actuator drives it: is it meant to swing freely?")
    motors = [row for row in rows if row.name in driven]
    for words, lacking in (
        ("has no effort limit: give the motor's", [row for row in motors if math.isinf(row.effort_limit)]),
        ("has no velocity limit: give the motor's", [row for row in motors if math.isinf(row.velocity_limit)]),
        ("has an effort limit of 0: it cannot move", [row for row in motors if row.effort_limit == 0.0]),
        (
            "has no armature: give the motor's reflected inertia, or with_armature(); without it light links are "
            "thrown about by their own drives",
            [row for row in motors if row.armature == 0.0],
        ),
    ):
        if lacking:
            yield Finding(Severity.WARNING, names_in_short(row.name for row in lacking), words)
    yield from _check_followers(spec)
    for row in motors:
        yield from _check_response(row)
        yield from _check_load(row)


def _check_followers(spec: RobotSpec) -> Iterator[Finding]:
    """Find joints that follow others and move next to nothing: no drive of their own would show it."""
    armature = _parameters(spec).armature
    bare = [
        index
        for index, joint in enumerate(spec.articulation.movable_joints)
        if joint.mimic is not None and armature[index] == 0.0
    ]
    if not bare:
        return
    freed = tuple(replace(joint, mimic=None) for joint in spec.articulation.joints)
    matrices = workspace_mass_matrices(replace(spec.articulation, joints=freed), armature=armature.tolist())
    smallest = np.diagonal(matrices, axis1=1, axis2=2).min(axis=0)
    light = [index for index in bare if smallest[index] < _LIGHT]
    if light:
        text = (
            f"follows another joint, moves as little as {min(smallest[light]):.2g} kg m^2 (kg) and has no armature: "
            "an engine that holds it to its leader by a stiff spring may diverge, at any step and gains; give it some "
            "by edit_joints(..., armature=...), for with_armature() leaves followers out"
        )
        yield Finding(Severity.WARNING, names_in_short(spec.articulation.joint_names[index] for index in light), text)


def check_stability(spec: RobotSpec, time_step: float) -> Iterator[Finding]:
    """Whether steps of ``time_step`` (s) diverge, and which drives are stiffer than such steps resolve."""
    parameters, groups = _parameters(spec), actuator_of_joint(spec)
    stiffness, damping = np.zeros(len(parameters.damping)), np.zeros(len(parameters.damping))
    implicit = parameters.damping.copy()
    for index, group in groups.items():
        if not isinstance(group, ImplicitPd):
            stiffness[index], damping[index] = group.stiffness, group.damping
        else:
            implicit[index] += group.damping
    gains = ExplicitGains(stiffness=stiffness, damping=damping, implicit_damping=implicit)
    found = unstable_drive(spec.articulation, gains, parameters.armature, time_step, fixed_base=spec.fixed_base)
    if found is not None:
        text = (
            f"stiffness {found.stiffness:g} and damping {found.damping:g} diverge in steps of {time_step:g} s: at most "
            f"{found.share:.2g} of these gains are stable, or steps of {found.time_step:.2g} s"
        )
        yield Finding(Severity.FAULT, found.joint, text)
    for response in drive_responses(spec):
        if 2.0 * math.pi * response.fastest * time_step > 1.0:
            text = (
                f"its drive swings at up to {response.fastest:.2g} Hz, more than a radian in a step of "
                f"{time_step:g} s: engines damp it further; less stiffness, or more armature"
            )
            yield Finding(Severity.WARNING, response.joint, text)


def _check_response(row: JointRow) -> Iterator[Finding]:
    found = row.response
    if found is None:
        return
    if found.slowest < _SLOW:
        text = f"natural frequency {found.slowest:.2g} to {found.fastest:.2g} Hz is slow"
        yield Finding(Severity.WARNING, row.name, f"{text}: a design has 4 Hz, see designed_drives()")
    ratio = f"damping ratio {found.least_damped:.2g} to {found.most_damped:.2g}"
    if found.least_damped < _LOOSE:
        yield Finding(Severity.WARNING, row.name, f"{ratio}: it rings; 1 is critical")
    elif found.least_damped > _STIFF:
        yield Finding(Severity.WARNING, row.name, f"{ratio}: it creeps to its target; 1 is critical")


def _check_load(row: JointRow) -> Iterator[Finding]:
    load = abs(row.load)
    if load > row.effort_limit:
        text = f"holding home against gravity takes {load:.3g} N m (N), its limit is {row.effort_limit:.3g}"
        yield Finding(Severity.FAULT, row.name, text)
    elif row.stiffness > 0.0 and load / row.stiffness > _SAG:
        text = f"gives way by {load / row.stiffness:.3g} rad (m) at home under gravity: compensate it, or stiffen it"
        yield Finding(Severity.WARNING, row.name, text)


def _parameters(spec: RobotSpec) -> JointParameters:
    return SceneLayout.of(Scene(robots=(spec,))).joint_parameters


def _floats(spec: RobotSpec) -> bool:
    return spec.gravity_compensation or not spec.fixed_base


def _gravity_loads(spec: RobotSpec, parameters: JointParameters) -> FloatArray:
    """(J,) efforts that hold home, followers' folded into their leaders'."""
    model = RigidBodyModel(spec.articulation, True, dtype=torch.float64)
    root = torch.tensor([[*spec.pose.position, *spec.pose.orientation]], dtype=torch.float64)
    poses = model.kinematics.forward(root, torch.as_tensor(parameters.home)[None])
    return mimic_matrix(spec.articulation).T @ model.gravity_forces(poses)[0].numpy()
