"""Limits, drives and efforts of joints, and in which order they come."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from orbit_torch.engine import TorchEngine
from orbit_torch.system import Equation
from torch import Tensor

from orbit_core.interfaces import JointParameters, SceneLayout
from orbit_core.scene import IdealPd, JointType

from .mutant import Misread, mutant, with_actuators, with_links, with_parameters

LIMITS = "drives::test_limits_hold"
ORDER = "state::test_order_is_the_descriptions_and_not_depth_first"
GAINS = "drives::test_drive_gains_per_environment"


def _unlimited(parameters: JointParameters) -> Any:
    return np.full_like(parameters.lower_limit, np.inf)


@mutant(LIMITS)
class LimitsIgnored(Misread):
    """Has no stops."""

    misread = with_parameters(lower_limit=lambda p: -_unlimited(p), upper_limit=_unlimited)


@mutant(LIMITS, "state::test_a_build_is_as_described")
class RevoluteLimitsInDegrees(Misread):
    """Reads the limits of revolute joints in degrees."""

    @staticmethod
    def misread(layout: SceneLayout) -> SceneLayout:
        turns = np.array([joint.type is not JointType.PRISMATIC for joint in layout.joints])
        scale = np.where(turns, np.pi / 180.0, 1.0)
        return with_parameters(
            lower_limit=lambda p: p.lower_limit * scale, upper_limit=lambda p: p.upper_limit * scale
        )(layout)


@mutant(LIMITS)
class OneSidedLimitsIgnored(Misread):
    """Keeps limits only where there are two."""

    misread = with_parameters(
        lower_limit=lambda p: np.where(np.isfinite(p.upper_limit), p.lower_limit, -np.inf),
        upper_limit=lambda p: np.where(np.isfinite(p.lower_limit), p.upper_limit, np.inf),
    )


@mutant(LIMITS)
class LimitsSymmetric(Misread):
    """Takes the larger of two limits for both."""

    misread = with_parameters(lower_limit=lambda p: -np.maximum(np.abs(p.lower_limit), np.abs(p.upper_limit)))


@mutant("drives::test_an_actuator_groups_effort_limit_takes_the_joints_place", "effort_limits")
class EffortLimitsIgnored(Misread):
    """Applies any effort."""

    misread = with_parameters(effort_limit=_unlimited)


@mutant("drives::test_an_actuator_groups_effort_limit_takes_the_joints_place")
class EffortLimitsOfGroupsIgnored(Misread):
    """Ignores an actuator group's effort limit."""

    misread = with_actuators(effort_limit=None)


@mutant("drives::test_an_actuator_groups_armature_takes_the_joints_place")
class ArmaturesOfGroupsIgnored(Misread):
    """Ignores an actuator group's armature."""

    misread = with_actuators(armature=None)


@mutant("drives::test_an_actuator_groups_armature_takes_the_joints_place", "reflected_inertia")
class ArmaturesIgnored(Misread):
    """Gives motors no inertia."""

    misread = with_parameters(armature=lambda p: np.zeros_like(p.armature))


@mutant("drives::test_an_actuator_groups_friction_takes_the_joints_place")
class FrictionsOfGroupsIgnored(Misread):
    """Ignores an actuator group's joint friction."""

    misread = with_actuators(friction=None)


@mutant("joint_friction")
class JointFrictionIgnored(Misread):
    """Gives joints no friction."""

    misread = with_parameters(friction=lambda p: np.zeros_like(p.friction))


@mutant("joint_damping")
class JointDampingIgnored(Misread):
    """Gives joints no damping."""

    misread = with_parameters(damping=lambda p: np.zeros_like(p.damping))


@mutant(GAINS, "drives::test_a_drive_follows_its_velocity_target")
class DrivesIgnored(Misread):
    """Gives joints no drives."""

    misread = with_parameters(
        drive_stiffness=lambda p: np.zeros_like(p.damping), drive_damping=lambda p: np.zeros_like(p.damping)
    )


@mutant(GAINS)
class StiffnessDoubled(TorchEngine):
    """Sets twice the stiffness that it is given."""

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        super().set_drive_gains(joints, 2.0 * stiffness, damping, env_ids)


@mutant("drives::test_explicit_joint_ignores_targets")
class GainsAppliedTwice(Misread):
    """Drives joints natively whose efforts the core computes."""

    @staticmethod
    def misread(layout: SceneLayout) -> SceneLayout:
        groups = [group for entity in layout.entities for group in entity.spec.actuators if isinstance(group, IdealPd)]
        extra = sum(group.stiffness for group in groups)
        return with_parameters(drive_stiffness=lambda p: p.drive_stiffness + extra)(layout)


class _Drives(TorchEngine):
    """With commands that a mutant alters before each step."""

    def altered(self) -> dict[str, Tensor]:
        raise NotImplementedError

    def _drives(self, equation: Equation) -> tuple[Tensor, Tensor]:
        kept = {name: getattr(self, name) for name in ("position_targets", "velocity_targets", "efforts")}
        self.__dict__.update(self.altered())
        try:
            return super()._drives(equation)
        finally:
            self.__dict__.update(kept)


@mutant("drives::test_a_drive_follows_its_velocity_target")
class VelocityTargetsIgnored(_Drives):
    """Brakes towards rest whatever velocity is asked for."""

    def altered(self) -> dict[str, Tensor]:
        return {"velocity_targets": torch.zeros_like(self.velocity_targets)}


@mutant("drives::test_effort_alone_accelerates")
class EffortsIgnored(_Drives):
    """Applies no effort but its drives'."""

    def altered(self) -> dict[str, Tensor]:
        return {"efforts": torch.zeros_like(self.efforts)}


@mutant(GAINS)
class EffortsIgnoredOfDrivenJoints(_Drives):
    """Applies no effort where there is a drive."""

    def altered(self) -> dict[str, Tensor]:
        return {"efforts": torch.where(self._stiffness > 0.0, 0.0, self.efforts)}


@mutant("drives::test_effort_alone_accelerates")
class EffortsOfTheFirstEnvironment(_Drives):
    """Applies the first environment's efforts in all."""

    def altered(self) -> dict[str, Tensor]:
        return {"efforts": self.efforts[:1].expand_as(self.efforts)}


@mutant("drives::test_effort_alone_accelerates")
class EffortsToldAsNone(TorchEngine):
    """Tells no efforts."""

    @property
    def joint_efforts(self) -> Tensor:
        return torch.zeros_like(self._applied)


@mutant("state::test_a_continuous_joint_counts_whole_turns")
class ContinuousJointsWrapped(TorchEngine):
    """Tells angles between minus pi and pi."""

    @property
    def joint_positions(self) -> Tensor:
        told = super().joint_positions
        return torch.atan2(told.sin(), told.cos())


@mutant(ORDER)
class JointsReversed(TorchEngine):
    """Tells joints in the reverse order."""

    @property
    def joint_positions(self) -> Tensor:
        return super().joint_positions.flip(1)


@mutant(ORDER)
class LinksDepthFirst(TorchEngine):
    """Tells links in alphabetical order."""

    @property
    def link_poses(self) -> Tensor:
        order = sorted(range(len(self.layout.links)), key=lambda link: self.layout.links[link].name)
        return super().link_poses[:, order]


@mutant("state::test_joints_are_written_in_the_order_given")
class JointsWrittenInTheirOwnOrder(TorchEngine):
    """Ignores the order in which joints to be written are named."""

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        super().write_joint_state(joints.sort().values, positions, velocities, env_ids)


@mutant("state::test_writes_reach_only_the_environments_named")
class EnvironmentsWrittenInTheirOwnOrder(TorchEngine):
    """Ignores the order in which environments to be written are named."""

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        super().write_joint_state(joints, positions, velocities, None if env_ids is None else env_ids.sort().values)


@mutant("joint_springs")
class SpringsIgnored(Misread):
    """Has no springs in its joints."""

    misread = with_parameters(spring_stiffness=lambda p: np.zeros_like(p.spring_stiffness))


@mutant("joint_springs")
class SpringsPullToZero(Misread):
    """Takes zero for the rest position of every spring."""

    misread = with_parameters(spring_rest=lambda p: np.zeros_like(p.spring_rest))


@mutant("joint_springs")
class SpringsWithinEffortLimits(TorchEngine):
    """Counts the springs' force as the drives', which the effort limit bounds."""

    def _drives(self, equation: Equation) -> tuple[Tensor, Tensor]:
        pull = self._spring * (self._spring_rest - self._positions)
        push, slope = super()._drives(equation)
        within = (push + pull).clamp(-self._effort_limit, self._effort_limit)
        return within - pull, slope


@mutant("compound_joints")
class MasslessLinksWeighed(Misread):
    """Gives links without mass a hundredth of a kilogram."""

    misread = with_links(lambda link: link if link.mass else replace(link, mass=0.01, inertia=1e-4 * np.eye(3)))
