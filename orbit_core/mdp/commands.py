"""Commands that many tasks share: velocities, poses, positions and orientations, uniform within ranges."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.transforms import quat_from_euler, quat_multiply, yaw_angle
from orbit_core.envs.environment import Environment
from orbit_core.envs.task import ROBOT
from orbit_core.envs.terms import Bounds, CommandTerm, TermFunction
from orbit_core.mdp import common


@functools.cache
def generated_command(name: str) -> TermFunction:
    """Make an observation function of the command of that name, (N, K)."""

    # One function for a name: observation groups that show the same function measure it once.
    def command(env: Environment) -> Tensor:
        return env.commands[name]

    return command


@dataclass(unsafe_hash=True, kw_only=True)
class UniformVelocityCommand(CommandTerm):
    """Velocity (N, 3) of a base in its own axes: forward and to the left in m/s, yaw rate in rad/s."""

    # `easy_share` is read where a sample is made, so that it costs another capture.
    live: ClassVar[frozenset[str]] = frozenset({"forward", "left", "yaw_rate"})
    forward: Bounds = (-1.0, 1.0)
    """m/s"""
    left: Bounds = (-0.5, 0.5)
    """m/s"""
    yaw_rate: Bounds = (-1.0, 1.0)
    """rad/s"""
    easy_share: float = 1.0
    """Share of a sample that is commanded at difficulty 0; all of it at difficulty 1."""

    def ranges(self, env: Environment) -> dict[str, Bounds]:
        return {"forward": self.forward, "left": self.left, "yaw_rate": self.yaw_rate}

    def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
        # At difficulty 1 the factor is exactly 1, so that a task without a curriculum draws what its ranges say.
        share = self.easy_share + (1.0 - self.easy_share) * env.state.difficulty[env_ids]
        return drawn * share[:, None]


@dataclass(unsafe_hash=True, kw_only=True)
class HeadingVelocityCommand(CommandTerm):
    """Velocity and heading (N, 4): forward and to the left in m/s, yaw rate in rad/s, and the heading in rad.

    The yaw rate follows the state: it turns the robot towards the heading.
    """

    forward: Bounds = (-1.0, 1.0)
    """m/s"""
    left: Bounds = (-0.5, 0.5)
    """m/s"""
    heading: Bounds = (-math.pi, math.pi)
    """rad, about the vertical"""
    max_yaw_rate: float = 1.0
    """rad/s"""
    gain: float = 0.5
    """1/s: yaw rate over the error of the heading."""

    def ranges(self, env: Environment) -> dict[str, Bounds]:
        return {"forward": self.forward, "left": self.left, "heading": self.heading}

    def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
        rate = self._yaw_rate(drawn[:, 2], common.robot_of(env.world).root_pose[env_ids])
        return torch.cat((drawn[:, :2], rate[:, None], drawn[:, 2:]), dim=1)

    def follow(self, env: Environment, command: Tensor) -> bool:
        # The heading is the fourth component, so that it needs no further memory; policies see the first three.
        command[:, 2] = self._yaw_rate(command[:, 3], common.robot_of(env.world).root_pose)
        return True

    def _yaw_rate(self, heading: Tensor, pose: Tensor) -> Tensor:
        """(n,) rad/s that turns robots at poses (n, 7) towards headings (n,)."""
        error = common.wrapped(heading - yaw_angle(pose[:, 3:]))
        return (self.gain * error).clamp(-self.max_yaw_rate, self.max_yaw_rate)


@dataclass(unsafe_hash=True, kw_only=True)
class UniformPositionCommand(CommandTerm):
    """Position (N, 3) in the environment's frame, m. A range that is None is that of :meth:`reach`."""

    live: ClassVar[frozenset[str]] = frozenset({"x", "y", "z"})
    x: Bounds | None = None
    """Least and most, m."""
    y: Bounds | None = None
    """Least and most, m."""
    z: Bounds | None = None
    """Least and most, m."""
    marker: str | None = None
    """Name of the marker that shows it; None: nothing does."""
    robot: str = ROBOT
    """Name of the robot whose workspace is meant."""

    def reach(self, env: Environment) -> dict[str, Bounds]:
        """Ranges of the numbers that have none of their own: the workspace of the robot's hand."""
        low, high = common.workspace(env.world, self.robot)
        return {"x": (low[0], high[0]), "y": (low[1], high[1]), "z": (low[2], high[2])}

    def ranges(self, env: Environment) -> dict[str, Bounds]:
        # The reach is computed even where all is given: its names are those of the numbers, in order.
        return {name: getattr(self, name) or own for name, own in self.reach(env).items()}

    def show(self, env: Environment, command: Tensor, env_ids: Tensor) -> None:
        if self.marker is not None:
            common.place_markers(env.world, (self.marker,), command[:, None], env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class UniformPoseCommand(UniformPositionCommand):
    """Pose (N, 7) of a hand that points downwards, in the environment's frame: tilted by roll and pitch, then turned.

    A range that is None is that of the robot's workspace.
    """

    live: ClassVar[frozenset[str]] = frozenset({"x", "y", "z", "roll", "pitch", "yaw"})
    roll: Bounds | None = None
    """rad"""
    pitch: Bounds | None = None
    """rad"""
    yaw: Bounds | None = None
    """rad"""

    def reach(self, env: Environment) -> dict[str, Bounds]:
        box = common.placed_workspace(env.world.robots[self.robot].spec)
        tilt = (-box.tilt, box.tilt)
        return {**super().reach(env), "roll": tilt, "pitch": tilt, "yaw": (-box.yaw, box.yaw)}

    def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
        roll, pitch, yaw = drawn[:, 3:].unbind(1)
        tilt = quat_from_euler(roll, pitch, torch.zeros_like(yaw))
        return torch.cat((drawn[:, :3], quat_multiply(tilt, common.facing_down(yaw))), dim=1)

    def show(self, env: Environment, command: Tensor, env_ids: Tensor) -> None:
        if self.marker is not None:
            env.world.markers[self.marker].set_pose(command, env_ids)


@dataclass(unsafe_hash=True, kw_only=True)
class UniformOrientationCommand(CommandTerm):
    """Orientation (N, 4), uniform over all rotations."""

    def ranges(self, env: Environment) -> dict[str, Bounds]:
        return {"share": (0.0, 1.0), "first": (0.0, math.tau), "second": (0.0, math.tau)}

    def command(self, env: Environment, drawn: Tensor, env_ids: Tensor) -> Tensor:
        return common.rotations_of(drawn)


@dataclass(unsafe_hash=True, kw_only=True)
class UniformScalarCommand(CommandTerm):
    """One number (N, 1), such as how far a drawer is to be open."""

    live: ClassVar[frozenset[str]] = frozenset({"value"})
    value: Bounds
    """Least and most, in the unit of the command."""

    def ranges(self, env: Environment) -> dict[str, Bounds]:
        return {"value": self.value}
