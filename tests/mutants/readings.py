"""MuJoCo that misreads a scene or a call, in scenarios that the example, whose solids are balls, cannot run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Tensor

from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Box, Capsule, Pose, Shape
from orbit_mujoco.config import MujocoConfig
from orbit_mujoco.engine import MujocoEngine

from .mutant import mutant, with_joints, with_shapes


class _Misread(MujocoEngine):
    """Builds from another layout than it was given; a mutant says which."""

    misread: ClassVar[Callable[[SceneLayout], SceneLayout]]

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: MujocoConfig) -> None:
        super().__init__(type(self).misread(layout), num_envs, device, config)
        self.layout = layout


def _rubbing(scale: float) -> Callable[[Shape], Shape]:
    def read(shape: Shape) -> Shape:
        own = shape.material
        less = replace(own, static_friction=scale * own.static_friction, dynamic_friction=scale * own.dynamic_friction)
        return replace(shape, material=less)

    return read


def _lower(shape: Shape) -> Shape:
    if not isinstance(shape.geometry, Box):
        return shape
    x, y, z = shape.geometry.half_extents
    return replace(shape, geometry=Box((x, y, 0.9 * z)))


@mutant("jamming_peg", "puck")
class LittleFriction(_Misread):
    """Gives everything two thirds of its friction."""

    misread = with_shapes(_rubbing(0.66))


@mutant("rod_between_fingers", "jamming_peg", "toppling_tower")
class FrictionIgnored(_Misread):
    """Gives nothing any friction."""

    misread = with_shapes(_rubbing(0.0))


@mutant("puck")
class ReboundsIgnored(_Misread):
    """Lets nothing rebound."""

    misread = with_shapes(lambda shape: replace(shape, material=replace(shape.material, restitution=0.0)))


@mutant("screw")
class BoxesUpright(_Misread):
    """Leaves the turn of shapes in their links out."""

    misread = with_shapes(lambda shape: replace(shape, pose=Pose(shape.pose.position)))


@mutant("magnetic_seal")
class JointsHeavy(_Misread):
    """Adds a motor's inertia to every joint."""

    misread = with_joints(lambda joint: replace(joint, armature=joint.armature + 1.0))


@mutant("joints_per_environment")
class JointsOfTheFirst(MujocoEngine):
    """Gives joint parameters to environments in the order of their numbers, whatever the call says."""

    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        ids = None if env_ids is None else env_ids.sort().values
        super().set_joint_parameters(joints, damping, friction, armature, stiffness, ids)


@mutant("joints_per_environment")
class SpringsOfTheScene(MujocoEngine):
    """Keeps the springs of the scene."""

    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        super().set_joint_parameters(joints, damping, friction, armature, None, env_ids)


@mutant("ring_on_rod")
class ThickCapsules(_Misread):
    """Makes every capsule 3 mm thicker."""

    misread = with_shapes(
        lambda shape: (
            replace(shape, geometry=Capsule(shape.geometry.radius + 0.003, shape.geometry.half_length))
            if isinstance(shape.geometry, Capsule)
            else shape
        )
    )


@mutant("toppling_tower")
class LowBoxes(_Misread):
    """Makes every box a tenth lower."""

    misread = with_shapes(_lower)
