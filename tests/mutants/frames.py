"""Frames and units of what is told, written and built."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from orbit_torch.engine import TorchEngine
from orbit_torch.rotations import apply, cross, matrix
from torch import Tensor

from orbit_core.scene import Box, Capsule, Pose, Sphere

from .mutant import Misread, mutant, with_joints, with_links, with_shapes

VELOCITY = "state::test_velocity_is_of_the_origin_in_world_axes_linear_first"


@mutant(VELOCITY)
class VelocitiesOfTheCentreOfMass(TorchEngine):
    """Tells the linear velocity of the centre of mass, not of the link's origin."""

    @property
    def link_velocities(self) -> Tensor:
        told = super().link_velocities.clone()
        arms = apply(matrix(self._poses[..., 3:]), self._centers).float()
        told[..., :3] += cross(told[..., 3:], arms)
        return told


@mutant(VELOCITY)
class VelocitiesInTheLinksAxes(TorchEngine):
    """Tells velocities in the link's axes, not the world's."""

    @property
    def link_velocities(self) -> Tensor:
        back = matrix(self._poses[..., 3:]).mT.float()
        told = super().link_velocities
        return torch.cat((apply(back, told[..., :3]), apply(back, told[..., 3:])), -1)


@mutant(VELOCITY, "state::test_kinematics_of_two_links")
class AngularVelocityFirst(TorchEngine):
    """Tells the angular velocity before the linear one."""

    @property
    def link_velocities(self) -> Tensor:
        return super().link_velocities.roll(3, -1)


@mutant("state::test_a_spinning_body_circles_its_centre_of_mass")
class VelocitiesWrittenToTheCentreOfMass(TorchEngine):
    """Takes a written root velocity for that of the centre of mass."""

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        super().write_root_state(entity, pose, None, env_ids)
        if velocity is not None:
            rows, root = slice(None) if env_ids is None else env_ids, self.layout.entities[entity].root_link
            arms = apply(matrix(self._poses[rows, root, 3:]), self._centers[rows, root]).float()
            linear = velocity[:, :3] - cross(velocity[:, 3:], arms)
            super().write_root_state(entity, None, torch.cat((linear, velocity[:, 3:]), 1), env_ids)


@mutant("state::test_initial_state_is_the_scenes")
class QuaternionsWithTheRealPartLast(TorchEngine):
    """Tells quaternions as (x, y, z, w)."""

    @property
    def link_poses(self) -> Tensor:
        told = super().link_poses
        return torch.cat((told[..., :3], told[..., 4:], told[..., 3:4]), -1)


@mutant("state::test_quaternions_are_unit_with_a_positive_real_part")
class QuaternionsOfEitherSign(TorchEngine):
    """Tells quaternions as they come, the real part negative half of the time."""

    @property
    def link_poses(self) -> Tensor:
        return self._poses.float()


@mutant("state::test_quaternions_are_unit_with_a_positive_real_part")
class QuaternionsConjugated(TorchEngine):
    """Tells the rotation from the world to the link."""

    @property
    def link_poses(self) -> Tensor:
        return super().link_poses * torch.tensor([1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0])


@mutant("state::test_frames_of_a_joint_with_poses_on_both_sides")
class ChildPosesIgnored(Misread):
    """Takes a joint's frame for the child's origin."""

    misread = with_joints(lambda joint: replace(joint, child_pose=Pose()))


@mutant("state::test_frames_of_a_joint_with_poses_on_both_sides")
class ParentPosesWithoutTheirRotation(Misread):
    """Places joints in their parents and does not turn them."""

    misread = with_joints(lambda joint: replace(joint, parent_pose=Pose(joint.parent_pose.position)))


@mutant("state::test_kinematics_of_two_links")
class AxesAlongZ(Misread):
    """Turns every joint about z."""

    misread = with_joints(lambda joint: replace(joint, axis=(0.0, 0.0, 1.0)))


@mutant("state::test_kinematics_of_two_links")
class AxesReversed(Misread):
    """Turns every joint the other way."""

    misread = with_joints(lambda joint: replace(joint, axis=tuple(-part for part in joint.axis)))


@mutant("state::test_a_spinning_body_circles_its_centre_of_mass", "state::test_a_build_is_as_described")
class CentresOfMassIgnored(Misread):
    """Puts every centre of mass into the link's origin."""

    misread = with_links(lambda link: replace(link, center_of_mass=(0.0, 0.0, 0.0)))


@mutant("wrenches::test_an_external_force_accelerates")
class WrenchesInTheLinksAxes(TorchEngine):
    """Applies external forces in the link's axes."""

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        axes = matrix(self._poses[rows][:, links, 3:]).float()
        turned = torch.cat((apply(axes, wrenches[..., :3]), apply(axes, wrenches[..., 3:])), -1)
        super().set_wrenches(links, turned, env_ids)


@mutant("wrenches::test_an_external_force_acts_at_the_centre_of_mass")
class WrenchesAtTheOrigin(TorchEngine):
    """Applies external forces at the link's origin."""

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        arms = apply(matrix(self._poses[rows][:, links, 3:]), self._centers[rows][:, links]).float()
        torque = wrenches[..., 3:] - cross(arms, wrenches[..., :3])
        super().set_wrenches(links, torch.cat((wrenches[..., :3], torque), -1), env_ids)


@mutant("shapes::test_a_shape_stands_where_its_pose_in_the_link_says")
class ShapesInTheLinksOrigin(Misread):
    """Ignores where shapes are in their links."""

    misread = with_shapes(lambda shape: replace(shape, pose=Pose()))


def _resized(sphere: float, box: float, capsule: float):
    def change(shape):
        match shape.geometry:
            case Sphere(radius=radius):
                return replace(shape, geometry=Sphere(sphere * radius))
            case Box(half_extents=half):
                return replace(shape, geometry=Box(tuple(box * side for side in half)))
            case Capsule(radius=radius, half_length=half):
                return replace(shape, geometry=Capsule(radius, half - capsule * radius))
            case _:
                return shape

    return with_shapes(change)


@mutant("shapes::test_a_shape_rests_as_high_as_its_sizes_say", "shapes::test_rays_meet_a_shape_where_its_sizes_say")
class BoxesByFullSizes(Misread):
    """Takes half extents for full ones."""

    misread = _resized(1.0, 0.5, 0.0)


@mutant("shapes::test_a_shape_rests_as_high_as_its_sizes_say", "shapes::test_rays_meet_a_shape_where_its_sizes_say")
class SpheresByDiameter(Misread):
    """Takes radii for diameters."""

    misread = _resized(0.5, 1.0, 0.0)


@mutant("shapes::test_a_shape_rests_as_high_as_its_sizes_say", "shapes::test_rays_meet_a_shape_where_its_sizes_say")
class CapsulesWithTheirCapsInTheirLength(Misread):
    """Counts the round caps into a capsule's half length."""

    misread = _resized(1.0, 1.0, 1.0)


@mutant("state::test_order_is_the_descriptions_and_not_depth_first")
class PositionsInDegrees(TorchEngine):
    """Tells joint positions in degrees."""

    @property
    def joint_positions(self) -> Tensor:
        return super().joint_positions * (180.0 / math.pi)


@mutant("drives::test_effort_alone_accelerates")
class InertiasInGrams(Misread):
    """Reads inertias in g m^2."""

    misread = with_links(lambda link: replace(link, inertia=np.asarray(link.inertia) * 1e-3))


@mutant("wrenches::test_an_external_force_accelerates", "state::test_a_build_is_as_described")
class MassesInPounds(Misread):
    """Reads masses in pounds."""

    misread = with_links(lambda link: replace(link, mass=link.mass * 0.4536))


@mutant("drives::test_gravity_compensation_holds_a_free_chain")
class GravityNeverCompensated(TorchEngine):
    """Lets gravity act on links whose controller cancels it."""

    def _body(self, link: int):
        body = super()._body(link)
        entity = self.layout.entities[int(self.layout.entity_of_link[link])]
        if entity.spec.gravity_compensation:
            body.force = body.force + body.mass * self._gravity
        return body
