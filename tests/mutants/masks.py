"""Writes that reach other environments than those named, and resets that leave something behind."""

from __future__ import annotations

import torch
from orbit_torch.engine import TorchEngine
from torch import Tensor

from orbit_core.interfaces import RayHits

from .mutant import mutant

BASE = "state::test_a_fixed_base_moves_when_told_in_its_environment_alone"
RESET = "reset::test_a_reset_is_complete"


@mutant(BASE)
class FixedBasesMoveInAllEnvironments(TorchEngine):
    """Moves the fixed base of every environment where one is told to."""

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        if self.layout.entities[entity].spec.fixed_base and pose is not None:
            pose, env_ids = pose[:1].expand(self.num_envs, 7), None
        super().write_root_state(entity, pose, velocity, env_ids)


@mutant(BASE)
class FixedBasesLeaveTheirLinks(TorchEngine):
    """Moves a fixed base without what hangs on it, until the next step."""

    def _place_all(self) -> None:
        pass


@mutant("state::test_writes_reach_only_the_environments_named")
class FreeBodiesMoveInAllEnvironments(TorchEngine):
    """Moves a free body in every environment where one is told to."""

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        if not self.layout.entities[entity].spec.fixed_base and pose is not None:
            pose, env_ids = pose[:1].expand(self.num_envs, 7), None
        super().write_root_state(entity, pose, velocity, env_ids)


@mutant("reset::test_a_reset_reaches_only_the_environments_named")
class ResetsReachAllEnvironments(TorchEngine):
    """Resets every environment where one is told to."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        super().reset()


@mutant("reset::test_a_reset_reaches_only_the_environments_named")
class ResetsClearAllCommands(TorchEngine):
    """Clears the commands of every environment where one is reset."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        super().reset(env_ids)
        self.efforts.zero_()


@mutant(RESET)
class ResetsLeaveEfforts(TorchEngine):
    """Keeps efforts over a reset."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        kept = self.efforts.clone()
        super().reset(env_ids)
        self.efforts.copy_(kept)


@mutant(RESET)
class ResetsLeaveVelocityTargets(TorchEngine):
    """Keeps velocity targets over a reset."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        kept = self.velocity_targets.clone()
        super().reset(env_ids)
        self.velocity_targets.copy_(kept)


@mutant(RESET)
class ResetsLeaveWrenches(TorchEngine):
    """Keeps external wrenches over a reset."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        kept = self._wrenches.clone()
        super().reset(env_ids)
        self._wrenches.copy_(kept)


@mutant("state::test_a_robots_pose_and_home_are_set_together")
class ResetsForgetTheHomePose(TorchEngine):
    """Puts joints to zero at a reset."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._home = torch.zeros_like(self._home)
        super().reset(env_ids)


@mutant("drives::test_drive_gains_per_environment")
class ResetsTakeGainsBack(TorchEngine):
    """Returns to the nominal gains at a reset."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        self._read_joints(self.layout.joint_parameters)
        super().reset(env_ids)


@mutant("contacts::test_force_is_zero_after_a_reset_until_the_next_step")
class ResetsLeaveContactForces(TorchEngine):
    """Tells, after a reset, the contact forces from before."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        kept = self._contact_forces.clone()
        super().reset(env_ids)
        self._contact_forces.copy_(kept)


@mutant("wrenches::test_mass_of_an_articulated_link", "snapshots::test_a_snapshot_holds_what_was_set_per_environment")
class MassesIgnored(TorchEngine):
    """Takes masses per environment and does nothing with them."""

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        pass


@mutant("wrenches::test_centre_of_mass_per_environment")
class CentresOfMassReachAllEnvironments(TorchEngine):
    """Sets one environment's centre of mass in all."""

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        super().set_centers_of_mass(links, centers[:1].expand(self.num_envs, -1, -1))


@mutant("wrenches::test_gravity_compensation_follows_the_gravity_of_the_environment")
class CompensationOfTheNominalGravity(TorchEngine):
    """Cancels the scene's gravity, whatever the environment's is."""

    def _body(self, link: int):
        body = super()._body(link)
        entity = self.layout.entities[int(self.layout.entity_of_link[link])]
        if entity.spec.gravity_compensation:
            body.force = body.force + body.mass * (self._gravity - self._gravity.new_tensor(self.layout.scene.gravity))
        return body


@mutant("contacts::test_friction_per_environment")
class FrictionReachesAllEnvironments(TorchEngine):
    """Sets one environment's friction in all."""

    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        super().set_friction(links, coefficients[:1].expand(self.num_envs, -1))


@mutant("wrenches::test_an_external_force_accelerates")
class WrenchesReachAllEnvironments(TorchEngine):
    """Pushes in every environment where one is pushed."""

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        super().set_wrenches(links, wrenches[:1].expand(self.num_envs, -1, -1))


@mutant("rays::test_rays_see_what_was_just_written_in_their_own_environment")
class RaysInTheFirstEnvironments(TorchEngine):
    """Casts the rays of some environments in the first ones."""

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        return super().cast_rays(origins, directions, max_distance, torch.arange(len(origins)))
