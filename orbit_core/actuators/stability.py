"""Refuses drives whose gains make the simulation diverge at the scene's physics step."""

from __future__ import annotations

import numpy as np

from orbit_core.dynamics.drive_stability import ExplicitGains, UnstableDrive, unstable_drive
from orbit_core.interfaces import Backend, ConfigurationError, DriveIntegration, EntityLayout, SceneLayout
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_core.scene import ImplicitPd


def check_drives(layout: SceneLayout, backend: Backend) -> None:
    """Hold every drive that is evaluated once a step to the limit of its gains.

    These are the explicit actuators, and the engine's own drives where the backend declares that it integrates them
    so. Articulations with closed loops are not judged: the loops take away the motions that would diverge first.

    Raises:
        ConfigurationError: names the joint, its gains, the step, and what would be stable.
    """
    for entity in layout.entities:
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
            raise ConfigurationError(_told(found, layout, entity, backend))


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


def _told(drive: UnstableDrive, layout: SceneLayout, entity: EntityLayout, backend: Backend) -> str:
    index = entity.spec.articulation.joint_names.index(drive.joint)
    explicit = not isinstance(actuator_of_joint(entity.spec)[index], ImplicitPd)
    remedy = ""
    if explicit and backend.drive_integration is DriveIntegration.IMPLICIT:
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
    """To three significant digits, rounded down: what is told to be stable must be."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.floor(value / unit) * unit)
