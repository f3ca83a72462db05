"""Stability of drives that are evaluated once a step: the limit of their gains, and the check of a scene.

Steps of h seconds are those of semi-implicit Euler, as all engines take them: with the mass matrix M, the law's gains K
and D taken at the beginning of the step and other damping C taken at its end,
``(M + h C) (v' - v) = -h (K q + (C + D) v)`` and ``q' = q + h v'``. On each motion x this is a polynomial of second
degree in the factor by which x grows per step; by Jury's criterion (Ogata, Discrete-Time Control Systems, 2nd ed.,
section 4.5) it stays bounded while ``x (h^2 K + 2 h D) x < x (4 M + 2 h C) x``, which it reaches as a motion that
changes sign at every step. Over all x that is a generalised eigenvalue below one.

Measured on four engines with a pendulum and an arm of two links, the last of a hundredth of the mass: gains 2 % below
this limit settle, gains 2 % above it diverge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_core.dynamics.rigid_body import workspace_mass_matrices
from orbit_core.interfaces import Backend, ConfigurationError, DriveIntegration, EntityLayout, SceneLayout
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_core.scene import Articulation, ImplicitPd

FloatArray = npt.NDArray[np.float64]
_HALVINGS = 24


@dataclass(frozen=True)
class UnstableDrive:
    """The joint whose drive is least stable, and what would be stable.

    ``share`` is the factor below one by which all gains of the robot's explicit drives may be taken at most, and
    ``time_step`` the longest step, s, with which they may stay as they are.
    """

    joint: str
    """Name of the joint."""
    stiffness: float
    """N m/rad or N/m, as configured."""
    damping: float
    """N m s/rad or N s/m, as configured."""
    share: float
    time_step: float


@dataclass(frozen=True, kw_only=True)
class ExplicitGains:
    """Gains (J,) of the drives that are evaluated once a step, and what else damps the joints.

    Stiffness is N m/rad or N/m, damping N m s/rad or N s/m; joints without such a drive have zero. ``implicit_damping``
    is taken at the end of each step: the mechanism's own, and that of drives which the engine integrates.
    """

    stiffness: FloatArray
    """(J,) N m/rad or N/m."""
    damping: FloatArray
    """(J,) N m s/rad or N s/m."""
    implicit_damping: FloatArray

    def loads(self, step: float) -> FloatArray:
        """Return ``h^2 K + 2 h D`` (J,), kg m^2 or kg."""
        return self.stiffness * step**2 + 2.0 * self.damping * step


def unstable_drive(
    articulation: Articulation, gains: ExplicitGains, armature: FloatArray, time_step: float, *, fixed_base: bool
) -> UnstableDrive | None:
    """Return the least stable drive if steps of ``time_step`` (s) diverge somewhere in the workspace, else None.

    Configurations are drawn within the joints' limits; a free base moves. Effort limits, commands that come late and
    contacts are left out: the first two make matters worse or bound them, the last add inertia.

    Args:
        articulation: the description.
        gains: of the drives that are evaluated once a step.
        armature: (J,) reflected inertias of the motors.
        time_step: s.
        fixed_base: whether the root cannot move.
    """
    # Most robots have implicit drives only; they skip the sampling of the workspace.
    if not np.any(gains.loads(time_step)):
        return None
    base = 0 if fixed_base else 6
    matrices = workspace_mass_matrices(articulation, free_root=not fixed_base, armature=armature.tolist())
    leading = [index for index, joint in enumerate(articulation.movable_joints) if joint.mimic is None]
    # Followers have no equation of motion: their inertia is folded into the leaders'.
    free = [*range(base), *(base + index for index in leading)]
    masses = matrices[:, free][:, :, free]

    def rates(step: float) -> tuple[FloatArray, FloatArray]:
        """Return largest eigenvalues (S,), below 1 where stable, and the joints' shares (S, leading) of the motions."""
        loads = gains.loads(step)[leading]
        inertias = 4.0 * masses
        inertias[:, range(base, len(free)), range(base, len(free))] += 2.0 * step * gains.implicit_damping[leading]
        roots = np.sqrt(loads)
        values, vectors = np.linalg.eigh(roots[:, None] * np.linalg.inv(inertias)[:, base:, base:] * roots)
        return values[:, -1], np.square(vectors[:, :, -1])

    found, shares = rates(time_step)
    worst = int(found.argmax())
    if found[worst] < 1.0:
        return None
    shortest, longest = 0.0, time_step
    # Bisection, since the largest eigenvalue has no closed form in the step.
    for _ in range(_HALVINGS):
        middle = (shortest + longest) / 2
        shortest, longest = (middle, longest) if rates(middle)[0].max() < 1.0 else (shortest, middle)
    joint = leading[int(shares[worst].argmax())]
    return UnstableDrive(
        articulation.joint_names[joint],
        float(gains.stiffness[joint]),
        float(gains.damping[joint]),
        1.0 / float(found[worst]),
        shortest,
    )


def check_drives(layout: SceneLayout, backend: Backend) -> None:
    """Hold every drive that is evaluated once a step to the limit of its gains.

    These are the explicit actuators, and the engine's own drives where the backend declares that it integrates them
    so. Articulations with closed loops are not judged: the loops take away the motions that would diverge first.

    Raises:
        ConfigurationError: names the joint, its gains, the step, and what would be stable.
    """
    for entity in layout.entities:
        # Loops remove the motions that would diverge first, so that the limit would be too strict.
        if not entity.spec.actuators or entity.spec.articulation.loops:
            continue
        armature = layout.joint_parameters.armature[entity.joints]
        found = unstable_drive(
            entity.spec.articulation,
            _gains(layout, entity, backend.drive_integration),
            armature,
            layout.scene.physics_dt,
            fixed_base=entity.spec.fixed_base,
        )
        if found is not None:
            raise ConfigurationError(_message(found, layout, entity, backend))


def _gains(layout: SceneLayout, entity: EntityLayout, integration: DriveIntegration) -> ExplicitGains:
    joints = entity.spec.articulation.movable_joints
    stiffness, damping = np.zeros(len(joints)), np.zeros(len(joints))
    implicit = layout.joint_parameters.damping[entity.joints].copy()
    for index, group in actuator_of_joint(entity.spec).items():
        if not isinstance(group, ImplicitPd) or integration is DriveIntegration.EXPLICIT:
            stiffness[index], damping[index] = group.stiffness, group.damping
        else:
            implicit[index] += group.damping
    return ExplicitGains(stiffness=stiffness, damping=damping, implicit_damping=implicit)


def _message(drive: UnstableDrive, layout: SceneLayout, entity: EntityLayout, backend: Backend) -> str:
    index = entity.spec.articulation.joint_names.index(drive.joint)
    explicit = not isinstance(actuator_of_joint(entity.spec)[index], ImplicitPd)
    remedy = ""
    if explicit and backend.drive_integration is DriveIntegration.IMPLICIT:
        # Only where it helps: an engine with explicit drives has the same limit for its own.
        remedy = ", or the engine's own drive, ImplicitPd, which is stable at any gain"
    share = _below(drive.share)
    return (
        f"the drive on joint '{drive.joint}' of '{entity.name}', with stiffness {drive.stiffness:g} and damping "
        f"{drive.damping:g}, is unstable in physics steps of {layout.scene.physics_dt:g} s on backend "
        f"'{backend.name}', for its effort is that of the state at the beginning of each step: at most "
        f"{share:g} times these gains are stable (stiffness {_below(share * drive.stiffness):g}, damping "
        f"{_below(share * drive.damping):g}), or a physics_dt of at most {_below(drive.time_step):g}; or give the "
        f"joint more armature{remedy}"
    )


def _below(value: float) -> float:
    """Round down to three significant digits: the gains that the message names must be stable."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.floor(value / unit) * unit)
