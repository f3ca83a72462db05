"""The engine: state in double precision, handed out in single."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from orbit_core.interfaces import Approximation, Engine, EntityLayout, SceneLayout, SimulationError
from orbit_torch.dynamics import Body, Chain, step_free_body

_STATE = ("_poses", "_velocities", "_positions", "_rates")
_PARAMETERS = ("_masses", "_centers", "_gravity", "_wrenches")
_COMMANDS = ("position_targets", "velocity_targets", "efforts")


class TorchEngine(Engine):
    """Free bodies and fixed-base articulations in N environments."""

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device) -> None:
        super().__init__(layout, num_envs, device)
        self._dt = layout.scene.physics_dt
        links, joints = len(layout.links), len(layout.joints)
        self._poses = torch.zeros(num_envs, links, 7, dtype=torch.float64)
        self._velocities = torch.zeros(num_envs, links, 6, dtype=torch.float64)
        self._positions, self._rates = torch.zeros(2, num_envs, joints, dtype=torch.float64)
        self._wrenches = torch.zeros(num_envs, links, 6, dtype=torch.float64)
        self._nominal = torch.tensor([link.mass for link in layout.links], dtype=torch.float64)
        self._masses = self._nominal.repeat(num_envs, 1)
        self._centers = torch.tensor([link.center_of_mass for link in layout.links], dtype=torch.float64).repeat(
            num_envs, 1, 1
        )
        self._inertias = torch.stack([torch.as_tensor(link.inertia) for link in layout.links]).to(torch.float64)
        self._gravity = torch.tensor(layout.scene.gravity, dtype=torch.float64).repeat(num_envs, 1)
        parameters = {name: torch.as_tensor(getattr(layout.joint_parameters, name)) for name in _JOINTS}
        self._limits = parameters["lower_limit"], parameters["upper_limit"]
        self._effort_limit = parameters["effort_limit"]
        self._home = parameters["home"]
        self._chains = {
            entity.index: Chain(entity.spec.articulation, parameters["armature"][entity.joints])
            for entity in layout.entities
            if entity.spec.fixed_base
        }
        self._applied = torch.zeros(num_envs, joints)
        self.reset()

    # Time

    def step(self, steps: int) -> None:
        limit = self._effort_limit
        efforts = self.efforts.double().clamp(-limit, limit)
        for _ in range(steps):
            for entity in self.layout.entities:
                self._step_entity(entity, efforts)
        self._applied = efforts.float()
        state = torch.cat((self._poses.flatten(1), self._velocities.flatten(1)), 1)
        if not state.isfinite().all():
            bad = (~state.isfinite().all(1)).nonzero()[:, 0].tolist()
            raise SimulationError(f"environments {bad} diverged: reset them, and use a smaller physics_dt")

    def _step_entity(self, entity: EntityLayout, efforts: Tensor) -> None:
        bodies = [self._body(link, entity) for link in range(entity.links.start, entity.links.stop)]
        root, joints = entity.root_link, entity.joints
        if not entity.spec.fixed_base:
            state = step_free_body(
                bodies[0], self._poses[:, root], self._velocities[:, root], self.layout.scene.physics_dt
            )
            self._poses[:, root], self._velocities[:, root] = state
        elif joints.start < joints.stop:
            state = self._positions[:, joints], self._rates[:, joints], efforts[:, joints]
            positions, rates = self._chains[entity.index].step(
                bodies, self._poses[:, root], *state, self.layout.scene.physics_dt
            )
            lower, upper = (limit[joints] for limit in self._limits)
            rates = torch.where(positions < lower, rates.clamp_min(0.0), rates)
            self._rates[:, joints] = torch.where(positions > upper, rates.clamp_max(0.0), rates)
            self._positions[:, joints] = positions.clamp(lower, upper)
            self._place(entity)

    def _body(self, link: int, entity: EntityLayout) -> Body:
        mass, wrench = self._masses[:, link, None], self._wrenches[:, link]
        weight = 0.0 if entity.spec.gravity_compensation else mass * self._gravity
        inertia = self._inertias[link] * (mass / self._nominal[link].clamp_min(1e-12))[..., None]
        return Body(mass, self._centers[:, link], inertia, wrench[:, :3] + weight, wrench[:, 3:])

    def _place(self, entity: EntityLayout) -> None:
        """Links where the root and the joints say."""
        chain, joints = self._chains[entity.index], entity.joints
        root = self._poses[:, entity.root_link]
        for link, motion in enumerate(
            chain.motions(root, self._positions[:, joints], self._rates[:, joints]), entity.links.start
        ):
            self._poses[:, link] = torch.cat((motion.position, motion.q), -1)
            self._velocities[:, link] = torch.cat((motion.speed, motion.spin), -1)

    # State

    @property
    def joint_positions(self) -> Tensor:
        return self._positions.float()

    @property
    def joint_velocities(self) -> Tensor:
        return self._rates.float()

    @property
    def joint_efforts(self) -> Tensor:
        return self._applied

    @property
    def link_poses(self) -> Tensor:
        positive = torch.where(self._poses[..., 3:4] < 0.0, -1.0, 1.0)
        return torch.cat((self._poses[..., :3], positive * self._poses[..., 3:]), -1).float()

    @property
    def link_velocities(self) -> Tensor:
        return self._velocities.float()

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        at = (slice(None), joints) if env_ids is None else (env_ids[:, None], joints)
        for state, values in ((self._positions, positions), (self._rates, velocities)):
            if values is not None:
                state[at] = values.double()
        self._place_all()

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        rows, root = slice(None) if env_ids is None else env_ids, self.layout.entities[entity].root_link
        if pose is not None:
            turned = pose[:, 3:].double()
            self._poses[rows, root] = torch.cat((pose[:, :3].double(), turned / turned.norm(dim=1, keepdim=True)), 1)
        if velocity is not None:
            self._velocities[rows, root] = velocity.double()
        self._place_all()

    def _place_all(self) -> None:
        for entity in self.layout.entities:
            if entity.spec.fixed_base:
                self._place(entity)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        for entity in self.layout.entities:
            pose = (*entity.spec.pose.position, *entity.spec.pose.orientation)
            self._poses[rows, entity.root_link] = torch.tensor(pose, dtype=torch.float64)
        self._positions[rows] = self._home
        self.position_targets[rows] = self._home.float()
        for cleared in (self._velocities, self._rates, self._wrenches, self._applied):
            cleared[rows] = 0.0
        self.velocity_targets[rows], self.efforts[rows] = 0.0, 0.0
        self._place_all()

    # Parameters per environment

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        self._set(self._wrenches, links, wrenches, env_ids)

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        self._set(self._masses, links, masses, env_ids)

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        self._set(self._centers, links, centers, env_ids)

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        self._gravity[slice(None) if env_ids is None else env_ids] = gravity.double()

    def _set(self, parameter: Tensor, links: Tensor, values: Tensor, env_ids: Tensor | None) -> None:
        parameter[(slice(None), links) if env_ids is None else (env_ids[:, None], links)] = values.double()

    # Snapshots and the rest

    def save_state(self) -> Any:
        return {name: getattr(self, name).clone() for name in (*_STATE, *_PARAMETERS, *_COMMANDS, "_applied")}

    def load_state(self, state: Any) -> None:
        for name, values in state.items():
            getattr(self, name).copy_(values)

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        joints = self.layout.joints
        unlimited = [joint for joint in joints if math.isfinite(joint.velocity_limit)]
        stopped = [joint for joint in joints if math.isfinite(joint.lower_limit) or math.isfinite(joint.upper_limit)]
        return (
            *(Approximation(j.name, "a limit of its velocity", "none", "the example has none") for j in unlimited),
            *(Approximation(j.name, "limits", "a stop", "it passes no impact on to other joints") for j in stopped),
        )

    @property
    def native(self) -> Any:
        return self._chains


_JOINTS = ("lower_limit", "upper_limit", "effort_limit", "armature", "home")
