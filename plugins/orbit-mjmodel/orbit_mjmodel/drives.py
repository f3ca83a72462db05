"""Drives that stay stable however stiff they are for the time step.

MuJoCo's implicit integrators take a drive's damping d at the end of a step and its stiffness k at the beginning. For a
joint of inertia m and a step h, with ``a = h^2 k / m`` and ``b = h d / m``, a step of position and velocity is a linear
map of determinant ``1 / (1 + b)`` and trace ``1 + (1 - a) / (1 + b)``. Its motion grows without end where
``a > 4 + 2 b``. Damping of at least ``h k - m / h``, which is ``b >= a - 1``, keeps both between 0 and 2: the joint
settles at its target, in fewer steps the stiffer its drive. A drive below one radian of natural frequency per
step, ``a < 1``, or damped that much by itself, is left as it is.

m is the inertia that the joint shows while all others are free, one over ``dof_invweight0``, at zero joint positions.
Several joints of a chain are stable together while ``4 M`` exceeds the diagonal matrix of these, M being the mass
matrix; of the catalogue's robots it does so at home by 1.6 times and more.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

from typing import TypeVar

import mujoco
import numpy as np
import numpy.typing as npt
from torch import Tensor

from orbit_core.interfaces import Approximation, SceneLayout
from orbit_core.scene import JointType
from orbit_mjmodel.addresses import Addresses

STIFFNESS, DAMPING, ASKED_DAMPING = 1, 2, 3
"""Columns of ``actuator_biasprm``, whose numbers are negative. MuJoCo reads the first two; the third is ours."""
VELOCITY_IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
"""Integrators that take damping at the end of a step, and stiffness at its beginning."""

_Array = TypeVar("_Array", npt.NDArray, Tensor)


def implicit_bounds(model: mujoco.MjModel) -> npt.NDArray[np.float64]:
    """(J,) size of a drive's force at and beyond which a step applies it as it was at the step's beginning.

    Below it an implicit integrator takes the drive's damping at the end of the step; others never do.
    """
    implicit = model.opt.integrator in (*VELOCITY_IMPLICIT, mujoco.mjtIntegrator.mjINT_DISCRETE)
    limits = np.where(model.actuator_forcelimited, model.actuator_forcerange[:, 1], np.inf)
    return np.where((model.actuator_gainprm[:, 0] > 0) & implicit, limits, 0.0)


def adds_damping(model: mujoco.MjModel) -> bool:
    """Return True if the integrator adds damping after the accelerations that sensors are computed with."""
    return model.opt.integrator in (*VELOCITY_IMPLICIT, mujoco.mjtIntegrator.mjINT_EULER)


def spring_lead(model: mujoco.MjModel) -> float:
    """Seconds by which an integrator that takes damping at the end of a step takes a drive's spring earlier."""
    return model.opt.timestep if model.opt.integrator in VELOCITY_IMPLICIT else 0.0


def damping_bias(bias: _Array, inverse_inertia: _Array, time_step: float) -> _Array:
    """Minus the damping (..., J) that drives need to be stable, at least what they were asked to have.

    Args:
        bias: (..., J, 10) ``actuator_biasprm``.
        inverse_inertia: (..., J) ``dof_invweight0`` of each joint, in 1/kg or 1/(kg m^2).
        time_step: seconds.
    """
    asked = bias[..., ASKED_DAMPING]
    needed = time_step * bias[..., STIFFNESS] + 1.0 / (time_step * inverse_inertia)
    return asked + (needed - asked).clip(max=0.0)


def hold_drives(model: mujoco.MjModel, addresses: Addresses, layout: SceneLayout) -> list[Approximation]:
    """Give a compiled model's drives the damping that they need, and report those that have or lack it."""
    step, bias = model.opt.timestep, model.actuator_biasprm
    inverse_inertia = model.dof_invweight0[addresses.joint_velocities]
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_DISCRETE:
        return []  # takes stiffness at the end of a step as well
    held = model.opt.integrator in VELOCITY_IMPLICIT
    if held:
        bias[:, DAMPING] = damping_bias(bias, inverse_inertia, step)
        concerned = bias[:, DAMPING] < bias[:, ASKED_DAMPING]
    else:
        concerned = -step * (step * bias[:, STIFFNESS] + 2 * bias[:, DAMPING]) * inverse_inertia > 4.0
    return [_told(int(number), model, layout, held) for number in np.flatnonzero(concerned)]


def report_swings(model: mujoco.MjModel, addresses: Addresses, layout: SceneLayout) -> list[Approximation]:
    """Report drives that swing about their targets once they were at their effort limit.

    A drive at its limit is applied without its damping. The speed that it gives in a step is more than its damping
    lets it lose again where that, over a step, exceeds twice the inertia: the drive goes from one limit to the other.
    """
    step, bias = model.opt.timestep, model.actuator_biasprm
    gain = step * model.dof_invweight0[addresses.joint_velocities]
    swings = model.actuator_forcelimited.astype(bool) & (-bias[:, DAMPING] * gain > 2.0)
    report: list[Approximation] = []
    for number in np.flatnonzero(swings):
        limit = float(model.actuator_forcerange[number, 1])
        unit = "m/s" if layout.joints[number].type is JointType.PRISMATIC else "rad/s"
        asked = f"a drive of damping {-bias[number, DAMPING]:.4g} with an effort limit of {limit:.4g}"
        got = f"one that swings by {limit * gain[number]:.2g} {unit} once it was at its limit"
        why = "MuJoCo applies a drive at its limit undamped: armature, less damping or a smaller physics_dt prevent it"
        report.append(Approximation(_subject(int(number), layout), asked, got, why))
    return report


def least_damping(stiffness: _Array, inverse_inertia: _Array, time_step: float) -> _Array:
    """Damping (..., J) that joints need at least, for their own springs (..., J) are as stiff."""
    return (time_step * stiffness - 1.0 / (time_step * inverse_inertia)).clip(min=0.0)


def hold_springs(model: mujoco.MjModel, addresses: Addresses, layout: SceneLayout) -> list[Approximation]:
    """Give joints whose own springs are as stiff the damping that they need, by the rule of drives."""
    step, columns = model.opt.timestep, addresses.joint_velocities
    stiffness, asked = layout.joint_parameters.spring_stiffness, model.dof_damping[columns]
    needed = least_damping(model.jnt_stiffness[addresses.joints], model.dof_invweight0[columns], step)
    model.dof_damping[columns] = np.maximum(asked, needed)
    report: list[Approximation] = []
    for number in np.flatnonzero(needed > asked):
        why = f"so stiff a spring needs it to be stable in steps of {step:g} s: use a smaller physics_dt"
        spring = f"a spring of stiffness {stiffness[number]:.4g} and damping {asked[number]:.4g}"
        report.append(Approximation(_subject(int(number), layout), spring, f"damping {needed[number]:.4g}", why))
    return report


def throwing_wheels(layout: SceneLayout) -> list[str]:
    """Return the joints of wheels whose velocity drives are strong in a step, and which no effort limit bounds.

    A wheel turns without end and has collision shapes; its drive is strong where its damping over a step exceeds the
    wheel's own inertia about the joint.
    """
    parameters, step = layout.joint_parameters, layout.scene.physics_dt
    velocity = (parameters.drive_stiffness == 0) & (parameters.drive_damping > 0)
    found: list[str] = []
    for entity in layout.entities:
        articulation = entity.spec.articulation
        for number, joint in zip(
            range(entity.joints.start, entity.joints.stop), articulation.movable_joints, strict=True
        ):
            wheel = articulation.links[articulation.link_names.index(joint.child)]
            if not velocity[number] or np.isfinite(parameters.effort_limit[number]):
                continue
            if joint.type is not JointType.CONTINUOUS or not wheel.collisions:
                continue
            axis = joint.child_pose.rotation_matrix() @ joint.axis
            arm = np.cross(axis, wheel.center_of_mass - np.asarray(joint.child_pose.position))
            inertia = axis @ wheel.inertia @ axis + wheel.mass * arm @ arm + parameters.armature[number]
            if step * parameters.drive_damping[number] > inertia:
                found.append(_subject(number, layout))
    return found


def _subject(number: int, layout: SceneLayout) -> str:
    entity = next(e for e in layout.entities if e.joints.start <= number < e.joints.stop)
    return f"joint '{layout.joints[number].name}' of '{entity.name}'"


def _told(number: int, model: mujoco.MjModel, layout: SceneLayout, held: bool) -> Approximation:
    stiffness, got, asked = -model.actuator_biasprm[number, [STIFFNESS, DAMPING, ASKED_DAMPING]]
    subject = _subject(number, layout)
    drive = f"a drive of stiffness {stiffness:.4g} and damping {asked:.4g}"
    if held:
        why = f"so stiff a drive needs it to be stable in steps of {model.opt.timestep:g} s: use a smaller physics_dt"
        return Approximation(subject, drive, f"damping {got:.4g}", why)
    why = "this integrator takes drives at the beginning of a step: use 'implicitfast', or a smaller physics_dt"
    return Approximation(subject, drive, f"one that is not stable in steps of {model.opt.timestep:g} s", why)
