"""Description of a robot as its computer serves it: joints in order, limits, gains, rate, and what it measures."""

from __future__ import annotations

import re
from enum import StrEnum

import msgspec
import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_core.scene import ImplicitPd, RobotSpec, Scene
from orbit_deploy.pictures import CameraDescription

FloatArray = npt.NDArray[np.float64]

# Accelerations and jerks that the makers state: Franka's for Panda, libfranka's rate_limiting.h for FR3
_STATED = {
    "franka_panda": (r"panda_joint(\d)", (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0), 500.0),
    "franka_fr3": (r"fr3_joint(\d)", (10.0,) * 7, 500.0),
}
# Where nothing is stated: full speed in 0.1 s, full acceleration in 5 ms, full effort in 0.1 s
_ACCELERATION_PER_SPEED, _JERK_PER_ACCELERATION, _EFFORT_RISE = 10.0, 200.0, 0.1
# Speed of joints without a limit, rad/s or m/s
_DEFAULT_SPEED = 3.0
# Relative difference of limits and gains that rounding explains
_CLOSE = 1e-5


class JointKind(StrEnum):
    """Quantity that the drive of a joint follows."""

    POSITION = "position"
    """rad or m."""
    VELOCITY = "velocity"
    """rad/s or m/s."""
    EFFORT = "effort"
    """N m or N."""


class RobotDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Robot of a robot computer. Lists are in the order of its joints, in rad and N m, or m and N."""

    model: str
    """Name of the robot's articulation."""
    joints: list[str]
    """Names of the joints, which give all other lists their order."""
    kinds: list[JointKind]
    """Quantity that each joint's drive follows."""
    lower: list[float]
    """Least positions; minus infinity if unlimited."""
    upper: list[float]
    """Greatest positions; infinity if unlimited."""
    velocity: list[float]
    """Greatest speeds, rad/s or m/s."""
    acceleration: list[float]
    """Greatest accelerations, rad/s^2 or m/s^2."""
    jerk: list[float]
    """Greatest jerks, rad/s^3 or m/s^3."""
    effort: list[float]
    """Greatest efforts; infinity if unlimited."""
    stiffness: list[float]
    """Stiffness of the drives; 0 for those that follow no position."""
    damping: list[float]
    """Damping of the drives, N m s/rad or N s/m."""
    home: list[float]
    """Positions of rest."""
    rate: float = 1000.0
    """Rate of the robot's loop, Hz."""
    objects: list[str] = []
    """Objects whose poses the robot's computer measures, as a motion-capture system does."""
    imus: list[str] = []
    """Inertial units of the robot, whose measurements a task's units of the same names have."""
    cameras: list[CameraDescription] = []
    """Cameras of the robot, whose pictures a task's cameras of the same names have."""
    arranges: bool = False
    """True for a simulated robot, which puts itself and objects where a client asks."""
    direct: bool = False
    """True if clients may send targets to the drives without limits of acceleration and jerk."""
    simulated: str = ""
    """Backend that simulates the robot; empty for a real one."""

    @staticmethod
    def of(spec: RobotSpec, rate: float = 1000.0) -> RobotDescription:
        """Describe a robot of a scene.

        Joints whose actuator is no drive of the engine (:class:`~orbit_core.scene.ImplicitPd`) take efforts.

        Args:
            spec: robot.
            rate: of the robot's loop, Hz.
        """
        numbers, actuators = SceneLayout.of(Scene(robots=(spec,))).joint_parameters, actuator_of_joint(spec)
        names = [joint.name for joint in spec.articulation.movable_joints]
        own = [actuators.get(index) for index in range(len(names))]
        # A path needs a finite speed to be limited by.
        speeds = np.where(np.isfinite(numbers.velocity_limit), numbers.velocity_limit, _DEFAULT_SPEED)
        accelerations, jerks = _stated(spec.articulation.name, names, speeds)
        kinds = [
            JointKind.POSITION
            if group is None or (isinstance(group, ImplicitPd) and group.stiffness > 0)
            else JointKind.VELOCITY
            if isinstance(group, ImplicitPd) and group.damping > 0
            else JointKind.EFFORT
            for group in own
        ]
        return RobotDescription(
            model=spec.articulation.name,
            joints=names,
            kinds=kinds,
            lower=numbers.lower_limit.tolist(),
            upper=numbers.upper_limit.tolist(),
            velocity=speeds.tolist(),
            acceleration=accelerations.tolist(),
            jerk=jerks.tolist(),
            effort=numbers.effort_limit.tolist(),
            stiffness=[float(group.stiffness) if group else 0.0 for group in own],
            damping=[float(group.damping) if group else 0.0 for group in own],
            home=numbers.home.tolist(),
            rate=rate,
        )

    @property
    def limits(self) -> MotionLimits:
        """Limits of the joints as arrays."""
        return MotionLimits(*(np.array(getattr(self, name), np.float64) for name in MotionLimits.__struct_fields__))

    def check(self) -> None:
        """Check that lists fit the joints and numbers are numbers.

        Raises:
            ConfigurationError: names the field.
        """
        for name in ("kinds", *MotionLimits.__struct_fields__, "stiffness", "damping", "home"):
            values = getattr(self, name)
            if len(values) != len(self.joints):
                raise ConfigurationError(f"the robot describes {len(self.joints)} joints and {len(values)} of '{name}'")
            if name != "kinds" and any(value != value for value in values):
                raise ConfigurationError(f"the robot's '{name}' holds a NaN")
        if not 1.0 <= self.rate <= 10_000.0:
            raise ConfigurationError(f"the robot's rate is {self.rate} Hz, not from 1 to 10,000")
        for camera in self.cameras:
            camera.check()


class MotionLimits(msgspec.Struct, frozen=True):
    """Limits (J,) of the joints of a robot."""

    lower: FloatArray
    """Least positions, rad or m."""
    upper: FloatArray
    """Greatest positions, rad or m."""
    velocity: FloatArray
    """Greatest speeds, rad/s or m/s."""
    acceleration: FloatArray
    """Greatest accelerations, rad/s^2 or m/s^2."""
    jerk: FloatArray
    """Greatest jerks, rad/s^3 or m/s^3."""
    effort: FloatArray
    """Greatest efforts, N m or N."""

    @property
    def effort_rate(self) -> FloatArray:
        """Greatest rate of change of commanded efforts, N m/s or N/s."""
        return self.effort / _EFFORT_RISE


def check_robot(expected: RobotDescription, served: RobotDescription, where: str) -> list[str]:
    """Compare the robot of a task with the one that a computer serves, before anything moves.

    Args:
        expected: robot of the task's scene.
        served: robot of the computer.
        where: address, for messages.

    Returns:
        Differences that change effects but not the meaning of commands, one sentence each.

    Raises:
        ConfigurationError: joints, their order or their kinds differ, so that numbers would have another meaning.
    """
    # Order counts: a command is a list of numbers without names.
    if expected.joints != served.joints:
        missing = [name for name in expected.joints if name not in served.joints]
        cause = f"it lacks {', '.join(missing)}" if missing else "they are others or in another order"
        raise ConfigurationError(
            f"the robot at {where} is a {served.model} with joints {', '.join(served.joints)}, and the task's is a "
            f"{expected.model} with {', '.join(expected.joints)}: {cause}"
        )
    for name, one, other in zip(expected.joints, expected.kinds, served.kinds, strict=True):
        if one != other:
            raise ConfigurationError(
                f"joint {name} of the robot at {where} takes {other} commands, and the task's takes {one} commands"
            )
    found: list[str] = []
    for field in ("stiffness", "damping", "lower", "upper", "velocity", "effort"):
        one, other = np.array(getattr(expected, field)), np.array(getattr(served, field))
        if not np.allclose(one, other, rtol=_CLOSE, atol=_CLOSE):
            worst = int(np.argmax(np.abs(np.nan_to_num(one - other, nan=0.0, posinf=1e9, neginf=-1e9))))
            found.append(
                f"{field} of {served.joints[worst]} is {other[worst]:g} at the robot and {one[worst]:g} in the task"
            )
    return found


def _stated(model: str, names: list[str], speeds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return accelerations and jerks (J,): the maker's where they are known."""
    accelerations = speeds * _ACCELERATION_PER_SPEED
    jerks = accelerations * _JERK_PER_ACCELERATION
    pattern, stated, ratio = _STATED.get(model, ("", (), 0.0))
    for index, name in enumerate(names):
        if stated and (match := re.fullmatch(pattern, name)):
            accelerations[index] = stated[int(match[1]) - 1]
            jerks[index] = ratio * accelerations[index]
    return accelerations, jerks
