"""Implicit drives, joint damping and armature, as flywheels geared to the joints.

An implicit drive applies ``effort + k (target - q - h v') + d (target velocity - v')`` with the velocity v' at the end
of the step of h seconds: a soft constraint. Bullet's joint motors are hard ones. But a flywheel of inertia
``J = h (k h + d)`` that spins at ``s = h (effort + k (target - q) + d target velocity) / J`` before the step, geared
one to one to the joint, gives the joint exactly that impulse, ``J (s - v')``, and it is found by the solver together
with contacts and limits. The gear's greatest force is the effort limit. Damping d and armature a add a second flywheel
of ``J = a + h d`` that spins at ``a v / J``, without a limit. The joint's own spring, of stiffness c and rest r, is a
torque; where it is too stiff for that, it adds ``h^2 c`` to the second wheel's J and ``h c (r - q)`` to its ``a v``.
Where the drive has no limit either, one wheel serves for both.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orbit_bullet.urdf import write_urdf

FloatArray = npt.NDArray[np.float64]
_UNLIMITED = 1e12
# rad/s that a flywheel may reach.
_FASTEST = 1e9


class Wheels:
    """The flywheels of one kind in one environment: a body with a spinning link per joint."""

    def __init__(self, client: Any, file: Path, joints: list[tuple[int, int]]) -> None:
        """``joints`` are bodies and joint numbers that each wheel is geared to."""
        self._client = client
        self._count = len(joints)
        flags = client.URDF_USE_INERTIA_FROM_FILE
        self.body = client.loadURDF(str(file), useFixedBase=True, flags=flags)
        """Bullet's number of the body."""
        self._numbers = list(range(self._count))
        for link in range(-1, self._count):  # Bullet gives links without shapes a place in the collision search
            client.setCollisionFilterGroupMask(self.body, link, 0, 0)
        self._zeros = [[0.0]] * self._count
        self._gears = []
        for wheel, (body, joint) in enumerate(joints):
            # Bullet gives each new joint a motor that holds it, which would brake the wheel.
            client.setJointMotorControl2(self.body, wheel, client.VELOCITY_CONTROL, force=0)
            client.changeDynamics(
                self.body, wheel, linearDamping=0, angularDamping=0, jointDamping=0, maxJointVelocity=_FASTEST
            )
            gear = client.createConstraint(
                body, joint, self.body, wheel, client.JOINT_GEAR, [0, 0, 1], [0, 0, 0], [0, 0, 0]
            )
            self._gears.append(gear)

    def set(self, inertias: FloatArray, limits: FloatArray) -> None:
        """Inertia and greatest force (W,) of each wheel; one without inertia does nothing."""
        for wheel, (inertia, limit) in enumerate(zip(inertias.tolist(), limits.tolist(), strict=True)):
            # Bullet takes a body without inertia for one that does not move.
            moment = max(inertia, 1e-9)
            self._client.changeDynamics(self.body, wheel, localInertiaDiagonal=(moment, moment, moment))
            # A gear without force is as good as none, and keeps its place for later gains.
            force = min(limit, _UNLIMITED) if inertia > 0 else 0.0
            self._client.changeConstraint(self._gears[wheel], gearRatio=-1.0, maxForce=force)

    def inertias(self) -> list[float]:
        """Moment of inertia of each wheel about its axis, as Bullet has it."""
        return [self._client.getDynamicsInfo(self.body, wheel)[2][2] for wheel in self._numbers]

    def spin(self, speeds: list[float]) -> None:
        """Let each wheel turn at a speed before the step."""
        self._client.resetJointStatesMultiDof(self.body, self._numbers, self._zeros, [[speed] for speed in speeds])


def write_wheels(path: Path, count: int) -> None:
    """A fixed base with ``count`` balanced links that spin about z."""
    robot = ET.Element("robot", name="wheels")
    ET.SubElement(robot, "link", name="base")
    for number in range(count):
        link = ET.SubElement(robot, "link", name=f"l{number}")
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value="1.0")
        ET.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
        joint = ET.SubElement(robot, "joint", name=f"j{number}", type="continuous")
        ET.SubElement(joint, "parent", link="base")
        ET.SubElement(joint, "child", link=f"l{number}")
        ET.SubElement(joint, "axis", xyz="0 0 1")
    write_urdf(robot, path)
