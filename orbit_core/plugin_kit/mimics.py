"""What joints that mimic others weigh on those that they follow."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.layout import SceneLayout

FloatArray = npt.NDArray[np.float64]


def on_leaders(layout: SceneLayout, values: FloatArray) -> FloatArray:
    """Inertias or dampings (J,) with those of followers borne by the joints that they follow, and none left on them.

    A gear passes them on by its ratio squared: the kinetic energy, or the power lost, is the same.
    """
    borne = values.copy()
    for entity in layout.entities:
        joints, names = entity.spec.articulation.movable_joints, entity.spec.articulation.joint_names
        for index, joint in enumerate(joints, entity.joints.start):
            if joint.mimic is not None:
                leader = entity.joints.start + names.index(joint.mimic.joint)
                borne[leader] += joint.mimic.slope(0.0) ** 2 * values[index]
                borne[index] = 0.0
    return borne
