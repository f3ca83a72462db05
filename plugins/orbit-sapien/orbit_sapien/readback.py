"""The model that PhysX holds, read back from its own bodies and joints."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# Bodies that are not immovable have mass.

from __future__ import annotations

from itertools import chain

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import BuiltModel
from orbit_sapien.model import NativeEnvironment
from orbit_sapien.native import physx

FloatArray = npt.NDArray[np.float64]


def read_model(environment: NativeEnvironment) -> BuiltModel:
    """The model of one environment; an immovable body, which PhysX keeps no mass of, has none here."""
    bodies = list(chain.from_iterable(entity.bodies for entity in environment.entities))
    joints = list(chain.from_iterable(entity.joints for entity in environment.entities))
    masses, centers = np.zeros(len(bodies)), np.zeros((len(bodies), 3))
    inertias = np.zeros((len(bodies), 3, 3))
    for number, body in enumerate(bodies):
        if not isinstance(body, physx.PhysxRigidStaticComponent):
            masses[number], centers[number], inertias[number] = _inertial(body)
    limits = np.array([joint.get_limit()[0] for joint in joints], np.float64).reshape(-1, 2)
    armatures = np.array([joint.get_armature()[0] for joint in joints], np.float64).reshape(-1)
    return BuiltModel(
        masses=masses,
        centers_of_mass=centers,
        inertias=inertias,
        lower_limits=limits[:, 0],
        upper_limits=limits[:, 1],
        armatures=armatures,
    )


def _inertial(body: physx.PhysxRigidBodyComponent) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre of mass, and inertia about it: PhysX keeps principal moments and the frame that they are in."""
    frame = body.cmass_local_pose.to_transformation_matrix().astype(np.float64)
    axes = frame[:3, :3]
    return body.mass, frame[:3, 3], axes @ np.diag(np.asarray(body.inertia, np.float64)) @ axes.T
