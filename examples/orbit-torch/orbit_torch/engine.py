"""The engine: state in double precision, handed out in single.

A step goes two ways. What is neither driven nor braked nor touched moves by integrators of higher order
(:mod:`orbit_torch.dynamics`); the rest by one semi-implicit Euler step, in which drives and damping are implicit and
contacts, joints' stops and joints' friction are impulses.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import (
    TERRAIN,
    Approximation,
    BuiltModel,
    Engine,
    EntityLayout,
    JointParameters,
    RayHits,
    SceneLayout,
    diverged,
    divergence_error,
)
from orbit_core.plugin_kit.bodies import soft_springs
from orbit_torch.contacts import Contacts
from orbit_torch.dynamics import Body, Chain, step_free_body
from orbit_torch.impulses import JointRows, gather
from orbit_torch.solver import Rows, solve
from orbit_torch.system import Equation, System, move_free_body

_STATE = ("_poses", "_velocities", "_positions", "_rates", "_stopping", "_touching")
_PARAMETERS = ("_masses", "_centers", "_gravity", "_wrenches", "_stiffness", "_drive_damping", "_friction")
_READINGS = ("_applied", "_contact_forces")
_CLEARED = ("_velocities", "_rates", "_stopping", "_touching", "_wrenches", *_READINGS, "velocity_targets", "efforts")
_CONTACTS = 96
"""The nearest candidates of an environment, which are solved for; the others touch nothing."""


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
        centers = torch.tensor([link.center_of_mass for link in layout.links], dtype=torch.float64)
        self._centers = centers.repeat(num_envs, 1, 1)
        inertias = np.array([link.inertia for link in layout.links], dtype=np.float64).reshape(-1, 3, 3)
        self._inertias = torch.as_tensor(inertias)
        self._gravity = torch.tensor(layout.scene.gravity, dtype=torch.float64).repeat(num_envs, 1)
        self._read_joints(layout.joint_parameters)
        self._chains = {
            entity.index: Chain(entity.spec.articulation, self._armature[entity.joints])
            for entity in layout.entities
            if entity.spec.fixed_base
        }
        self._system = System(layout, self._chains)
        self._contacts = Contacts(layout)
        self._friction = self._contacts.friction.repeat(num_envs, 1)
        self._stopping = torch.zeros(num_envs, len(self._joint_rows.least), dtype=torch.float64)
        self._touching = torch.zeros(num_envs, len(self._contacts.links), 3, dtype=torch.float64)
        self._contact_forces = torch.zeros(num_envs, len(layout.contact_queries), 3)
        self._applied = torch.zeros(num_envs, joints)
        self.reset()

    def _read_joints(self, parameters: JointParameters) -> None:
        """Every number of the joints (J,), gains per environment (N, J)."""
        self._effort_limit = torch.as_tensor(parameters.effort_limit)
        self._armature = torch.as_tensor(parameters.armature)
        self._damping = torch.as_tensor(parameters.damping)
        self._spring = torch.as_tensor(parameters.spring_stiffness)
        self._spring_rest = torch.as_tensor(parameters.spring_rest)
        late = ~torch.as_tensor(soft_springs(self.layout, self._dt))
        self._spring_slope = self._dt * self._spring * late
        """(J,) what a spring adds to damping where it is taken at the end of a step."""
        self._home = torch.as_tensor(parameters.home)
        self._stiffness = torch.as_tensor(parameters.drive_stiffness).repeat(self.num_envs, 1)
        self._drive_damping = torch.as_tensor(parameters.drive_damping).repeat(self.num_envs, 1)
        self._joint_rows = JointRows(parameters, self._dt)

    # Time

    def step(self, steps: int) -> None:
        self._contact_forces.zero_()
        for _ in range(steps):
            self._advance(steps)
        bad = diverged(self._poses, self._velocities) | diverged(self._positions, self._rates)
        if bad.any():
            raise divergence_error(bad.nonzero()[:, 0].tolist())

    def _advance(self, steps: int) -> None:
        bodies = [self._body(link) for link in range(len(self.layout.links))]
        equation = self._system.equation(bodies, self._poses, self._velocities, self._positions, self._rates)
        joints = len(self.layout.joints)
        push, slope = self._drives(equation)
        mass, speeds = self._implicit(equation, push, slope)
        rows, near = self._rows(equation)
        inverse = torch.linalg.inv(mass)
        impulses = solve(rows, inverse, speeds, self._warm_start(near))
        self._keep(impulses, near, steps)
        kicks = (rows.jacobian.mT @ impulses[..., None])[..., 0]
        speeds = speeds + (inverse @ kicks[..., None])[..., 0]
        self._applied = (push - slope * speeds[:, :joints]).float()
        involved = kicks != 0.0
        # Efforts that answer to the state are stable with velocities taken before positions, as the core reckons them.
        involved[:, :joints] |= (slope + self._damping + self._spring + self.efforts.abs()) != 0.0
        for entity, columns in zip(self.layout.entities, self._system.columns, strict=True):
            alone = ~involved[:, columns].any(1, keepdim=True)
            self._move(entity, bodies[entity.links], speeds[:, columns], alone)

    def _rows(self, equation: Equation) -> tuple[Rows, Tensor]:
        """What resists motion, and which of all candidates its contacts are (N, C)."""
        touch, near = self._contacts.find(self._poses).nearest(_CONTACTS)
        origins = torch.cat((self._poses[..., :3], torch.zeros_like(self._poses[:, :1, :3])), 1)
        ball, surface = (
            equation.point_jacobian(links, touch.points - origins.gather(1, links[..., None].expand(-1, -1, 3)))
            for links in self._contacts.links[near].unbind(-1)
        )
        pairs = self._contacts.shapes[near]
        friction = self._friction.gather(1, pairs.flatten(1)).view(pairs.shape).amax(-1)
        return gather(self._joint_rows, self._positions, equation, touch, ball - surface, friction, self._dt), near

    def _warm_start(self, near: Tensor) -> Tensor:
        """The impulses of the step before, of the joints' rows and of these contacts."""
        contacts = self._touching.gather(1, near[..., None].expand(-1, -1, 3))
        return torch.cat((self._stopping, contacts.flatten(1)), 1)

    def _keep(self, impulses: Tensor, near: Tensor, steps: int) -> None:
        """Keep the impulses for the next step, and what they come to in newtons, as a mean over ``steps``."""
        joints = self._stopping.shape[1]
        self._stopping = impulses[:, :joints]
        contacts = impulses[:, joints:].unflatten(1, (-1, 3)) if near.shape[1] else self._touching
        self._touching = torch.zeros_like(self._touching).scatter(1, near[..., None].expand(-1, -1, 3), contacts)
        self._contact_forces += (self._contacts.counted @ self._touching / (self._dt * steps)).float()

    def _drives(self, equation: Equation) -> tuple[Tensor, Tensor]:
        """What drives and commands apply is ``push - slope * rates after the step``, both (N, J), within limits."""
        ahead = self.position_targets - self._positions
        push = self.efforts + self._stiffness * ahead + self._drive_damping * self.velocity_targets
        slope = self._dt * self._stiffness + self._drive_damping
        _, speeds = self._implicit(equation, push, slope)
        asked = push - slope * speeds[:, : push.shape[1]]
        given = asked.clamp(-self._effort_limit, self._effort_limit)
        within = asked == given
        return torch.where(within, push, given), torch.where(within, slope, 0.0)

    def _implicit(self, equation: Equation, push: Tensor, slope: Tensor) -> tuple[Tensor, Tensor]:
        """The mass matrix with what drives and damping add, and velocities (N, D) after a step without impulses."""
        joints = push.shape[1]
        mass, force = equation.mass.clone(), equation.force.clone()
        mass[:, :joints, :joints] += torch.diag_embed(self._dt * (slope + self._damping + self._spring_slope))
        force[:, :joints] += push + self._spring * (self._spring_rest - self._positions)
        momentum = (equation.mass @ equation.velocity[..., None])[..., 0] + self._dt * force
        return mass, torch.linalg.solve(mass, momentum)

    def _move(self, entity: EntityLayout, bodies: list[Body], speeds: Tensor, alone: Tensor) -> None:
        """To where the solved velocities (N, D) lead; where ``alone`` (N, 1) nothing acted on it, more exactly."""
        root, joints = entity.root_link, entity.joints
        if not entity.spec.fixed_base:
            pose, velocity = self._poses[:, root], self._velocities[:, root]
            solved = move_free_body(bodies[0], pose, speeds, self._dt)
            if alone.any():
                exact = step_free_body(bodies[0], pose, velocity, self._dt)
                solved = [torch.where(alone, *both) for both in zip(exact, solved, strict=True)]
            self._poses[:, root], self._velocities[:, root] = solved
        elif joints.start < joints.stop:
            position, rate = self._positions[:, joints], self._rates[:, joints]
            solved = position + self._dt * speeds, speeds
            if alone.any():
                efforts, chain = self._applied[:, joints].double(), self._chains[entity.index]
                exact = chain.step(bodies, self._poses[:, root], position, rate, efforts, self._dt)
                solved = [torch.where(alone, *both) for both in zip(exact, solved, strict=True)]
            self._positions[:, joints], self._rates[:, joints] = solved
            self._place(entity)

    def _body(self, link: int) -> Body:
        entity = self.layout.entities[int(self.layout.entity_of_link[link])]
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

    # State and measurements

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

    @property
    def contact_forces(self) -> Tensor:
        return self._contact_forces

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        poses = self._poses if env_ids is None else self._poses[env_ids]
        return self._contacts.cast(poses, origins.double(), directions.double(), max_distance)

    # Writes

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        for state, values in ((self._positions, positions), (self._rates, velocities)):
            if values is not None:
                self._set(state, joints, values, env_ids)
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
        for name in _CLEARED:
            getattr(self, name)[rows] = 0.0
        self._place_all()

    # Parameters per environment

    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        self._set(self._wrenches, links, wrenches, env_ids)

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        self._set(self._masses, links, masses, env_ids)

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        self._set(self._centers, links, centers, env_ids)

    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        rows = slice(None) if env_ids is None else env_ids
        for link, values in zip(links.tolist(), coefficients.double().unbind(1), strict=True):
            for shape in (
                self._contacts.link_of_shape == (link if link != TERRAIN else len(self.layout.links))
            ).nonzero():
                self._friction[rows, shape.item()] = values

    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._set(self._stiffness, joints, stiffness, env_ids)
        self._set(self._drive_damping, joints, damping, env_ids)

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        self._gravity[slice(None) if env_ids is None else env_ids] = gravity.double()

    @staticmethod
    def _set(state: Tensor, columns: Tensor, values: Tensor, env_ids: Tensor | None) -> None:
        state[(slice(None), columns) if env_ids is None else (env_ids[:, None], columns)] = values.double()

    # Snapshots and the rest

    def save_state(self) -> Any:
        own = {name: getattr(self, name).clone() for name in (*_STATE, *_PARAMETERS, *_READINGS)}
        return own | self.saved_commands()

    def load_state(self, state: Any) -> None:
        for name, values in state.items():
            getattr(self, name).copy_(values)

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        unlimited = [joint for joint in self.layout.joints if math.isfinite(joint.velocity_limit)]
        return (
            *(Approximation(j.name, "a limit of its velocity", "none", "the example has none") for j in unlimited),
            *self._contacts.report(self.layout),
        )

    def built_model(self) -> tuple[BuiltModel, ...]:
        return (
            BuiltModel(
                masses=self._masses[0].numpy(),
                centers_of_mass=self._centers[0].numpy(),
                inertias=self._inertias.numpy(),
                lower_limits=self._joint_rows.lower.numpy(),
                upper_limits=self._joint_rows.upper.numpy(),
                armatures=self._armature.numpy(),
                effort_limits=self._effort_limit.numpy(),
            ),
        )

    @property
    def native(self) -> Any:
        return self._system
