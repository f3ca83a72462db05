"""Which joints' springs an engine may take at the beginning of its steps, and which only at the end.

A spring of stiffness k on inertia m, taken at the beginning of a step h, keeps its energy (symplectic Euler; Hairer,
Lubich and Wanner, Geometric Numerical Integration, section I.1) while ``h^2 k / m < 4``, and diverges beyond. Taken at
the end of the step (backward Euler) it is stable at any stiffness, and loses energy at each step.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.layout import SceneLayout
from orbit_core.plugin_kit.massless import carried
from orbit_core.scene import Articulation, Joint, JointType

FloatArray = npt.NDArray[np.float64]

_SOFT = 1.0
"""The most of ``h^2 k / m``, m being the least that the joint moves: joints of a chain together shake up to twice as
fast as each does alone."""


def least_inertias(layout: SceneLayout) -> FloatArray:
    """(J,) the least that each joint moves, whatever hangs on it: its child link, in kg or kg m^2, and the armature."""
    values = [
        _least_inertia(entity.spec.articulation, joint)
        for entity in layout.entities
        for joint in entity.spec.articulation.movable_joints
    ]
    return np.array(values, dtype=np.float64) + layout.joint_parameters.armature


def softest(layout: SceneLayout, time_step: float) -> FloatArray:
    """(J,) the largest stiffness of a spring that may be taken at the beginning of steps of ``time_step`` seconds."""
    return _SOFT * least_inertias(layout) / time_step**2


def soft_springs(layout: SceneLayout, time_step: float) -> npt.NDArray[np.bool_]:
    """(J,) whether the joint's spring is slow enough to be taken at the beginning of steps of ``time_step`` seconds."""
    return layout.joint_parameters.spring_stiffness <= softest(layout, time_step)


def _least_inertia(articulation: Articulation, joint: Joint) -> float:
    link = next(link for link in articulation.links if link.name == joint.child)
    sliding = joint.type is JointType.PRISMATIC
    if link.mass == 0:
        held = carried(articulation, link)
        return sum(each.mass if sliding else float(np.linalg.eigvalsh(each.inertia)[0]) for each in held)
    axis = joint.child_pose.rotation_matrix() @ np.asarray(joint.axis)
    return link.mass if sliding else float(axis @ np.asarray(link.inertia) @ axis)
