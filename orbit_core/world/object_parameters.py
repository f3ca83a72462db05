"""Parameters of objects that differ between environments: masses, friction, joints, gains, colours, textures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import torch
from torch import Tensor

from orbit_core.dynamics.arguments import (
    COLORS,
    EFFORTS,
    FRICTIONS,
    GAINS,
    MASSES,
    MOVING_MASSES,
    NO_MASS,
    POSITIONS,
    check_numbers,
    columns_chosen,
)
from orbit_core.interfaces import Capability, ConfigurationError, EntityLayout, Object
from orbit_core.scene import ActuatorNetwork, Entity, JointType, Texture
from orbit_core.world.drawing import Painting
from orbit_core.world.state import WorldParts


def _nothing_required(capability: Capability, culprit: str) -> None:
    """Default check for objects that no world has made: accept every capability."""


class ObjectParameters(Object):
    """Parameters of an object in one engine, set per environment; they outlast resets."""

    def __init__(self, layout: EntityLayout, parts: WorldParts) -> None:
        engine = parts.engine
        self.layout = layout
        """Numbers of the entity's links and joints."""
        self.name = layout.name
        """Name in the scene."""
        self.link_names = layout.spec.articulation.link_names
        """Names of the links, in the order of all tensors."""
        self.joint_names = layout.spec.articulation.joint_names
        """Names of the movable joints, in the order of all tensors."""
        self._engine = engine
        self._actuators, self._clock, self._selector = parts.actuators, parts.clock, parts.selector
        self._all_columns = tuple(range(len(self.joint_names)))
        self._all_joints = torch.arange(layout.joints.start, layout.joints.stop, device=engine.device)
        self.require: Callable[[Capability, str], None] = _nothing_required
        """Refuses, naming backends, what the backend lacks that a call for this object needs."""
        self.painting = Painting(engine.num_envs, len(engine.layout.links), engine.device)
        """Takes colours; the world's, where one has made the object."""
        self.write_wrenches = engine.set_wrenches
        """What :meth:`set_wrenches` hands them to."""

    @property
    def spec(self) -> Entity:
        return self.layout.spec

    # Parameters per environment; they outlast resets

    @cached_property
    def nominal_masses(self) -> Tensor:
        """(N, links) in kg, of the scene; what :meth:`set_masses` sets does not change them."""
        # Alternatives of an object have masses of their own, and environments take the kinds in turn.
        kinds = [variant.entities[self.layout.index].spec.articulation for variant in self._engine.layout.variants]
        masses = torch.tensor([[link.mass for link in kind.links] for kind in kinds], device=self._engine.device)
        return masses[torch.arange(self._engine.num_envs, device=self._engine.device) % len(kinds)]

    @cached_property
    def _massive(self) -> Tensor:
        """(links,) bool: which have mass in the scene; the root of a fixed base may have none."""
        links = self.spec.articulation.links
        return torch.tensor([link.mass > 0.0 for link in links], device=self._engine.device)

    @cached_property
    def _weightless(self) -> frozenset[int]:
        """Links without mass: the root of a fixed base, and those between the simple joints of a compound one."""
        return frozenset(index for index, link in enumerate(self.spec.articulation.links) if link.mass == 0.0)

    @cached_property
    def nominal_gains(self) -> Mapping[int, tuple[float, float]]:
        """Stiffness and damping in the scene, by joint, of those that have an actuator with gains."""
        gains: dict[int, tuple[float, float]] = {}
        for group in self.spec.actuators:
            # A network's stiffness is in its weights, so that it has no gains to scale.
            joints = [] if isinstance(group, ActuatorNetwork) else self.find_joints(*group.joints)
            for joint in joints:
                gains[joint] = (group.stiffness, group.damping)
        return gains

    def set_masses(self, masses: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Masses (n, k) in kg of some links; inertias scale with them. Links without mass keep to none.

        Raises:
            ArgumentError: among others, a link that has mass in the scene is given none, or one that moves without any.
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._selector.select(env_ids)
        what = f"masses of '{self.name}'"
        # Checked twice: all masses against zero, then those of moving links against the smallest that engines solve.
        masses = chosen.values(masses, (len(indices),), what, MASSES)
        if chosen.readable:
            check_numbers(masses[:, self._massive[indices - self.layout.root_link]], MOVING_MASSES, what, chosen.rows)
        if self._weightless:
            kept = [column for column, link in enumerate(self._links_named(links)) if link not in self._weightless]
            if chosen.readable:
                moving = [c for c, link in enumerate(self._links_named(links)) if link and link in self._weightless]
                check_numbers(masses[:, moving], NO_MASS, f"{what} without any", chosen.rows)
            indices, masses = indices[kept], masses[:, kept]
        self._engine.set_masses(indices, masses, chosen.rows)

    def set_centers_of_mass(
        self, centers: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Centres of mass (n, k, 3) of some links, in their own frames.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._selector.select(env_ids)
        centers = chosen.values(centers, (len(indices), 3), f"centres of mass of '{self.name}'", POSITIONS)
        self._engine.set_centers_of_mass(indices, centers, chosen.rows)

    def set_friction(
        self, coefficients: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Friction (n, k), static and dynamic alike, of all shapes of some links.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._selector.select(env_ids)
        coefficients = chosen.values(coefficients, (len(indices),), f"friction of '{self.name}'", FRICTIONS)
        self._engine.set_friction(indices, coefficients, chosen.rows)

    def set_wrenches(self, wrenches: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Force at the centre of mass and torque, (n, k, 6), world axes, on some links until set again or reset.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
        """
        indices, chosen = self._link_indices(links), self._selector.select(env_ids)
        wrenches = chosen.values(wrenches, (len(indices), 6), f"wrenches of '{self.name}'", EFFORTS)
        self.write_wrenches(indices, wrenches, chosen.rows)
        self._clock.touch()

    def set_gains(
        self,
        stiffness: Tensor,
        damping: Tensor,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Stiffness and damping (n, k) of the actuators of some joints, implicit and explicit alike.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
            ConfigurationError: a joint has no actuator.
        """
        columns = self._all_columns if joints is None else self._joint_columns(joints)
        chosen, shape = self._selector.select(env_ids), (len(columns),)
        stiffness = chosen.values(stiffness, shape, f"stiffness of '{self.name}'", GAINS)
        damping = chosen.values(damping, shape, f"damping of '{self.name}'", GAINS)
        start = self.layout.joints.start
        self._actuators.set_gains([start + joint for joint in columns], stiffness, damping, chosen.rows)

    def set_joint_parameters(
        self,
        damping: Tensor | None = None,
        friction: Tensor | None = None,
        armature: Tensor | None = None,
        stiffness: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Damping, Coulomb friction, armature and springs' stiffness (n, k) of some joints; None leaves one as it is.

        A stiff spring may need damping to be stable, as in the scene; it keeps that until damping is set.

        Raises:
            UnsupportedCapabilityError: the engine cannot; names the backends that can.
        """
        self.require(Capability.RANDOMIZE_JOINTS, f"joint parameters of '{self.name}'")
        columns = self._all_columns if joints is None else self._joint_columns(joints)
        chosen, shape = self._selector.select(env_ids), (len(columns),)

        def checked(value: Tensor | None, what: str) -> Tensor | None:
            return None if value is None else chosen.values(value, shape, f"{what} of joints of '{self.name}'", GAINS)

        values = [
            checked(value, what)
            for value, what in (
                (damping, "damping"), (friction, "friction"), (armature, "armature"), (stiffness, "spring stiffness")
            )
        ]  # fmt: skip
        self._engine.set_joint_parameters(self._all_joints[list(columns)], *values, env_ids=chosen.rows)

    def set_joint_limits(
        self, lower: Tensor, upper: Tensor, joints: Sequence[int] | None = None, env_ids: Tensor | None = None
    ) -> None:
        """Limits (n, k) in rad or m that some joints stop at, which are limited on both sides in the scene.

        What commands keep to, :attr:`position_limits`, stays the scene's.

        Raises:
            UnsupportedCapabilityError: the engine cannot; names the backends that can.
            ConfigurationError: a joint has no limits in the scene, or a lower one is above the upper.
        """
        self.require(Capability.RANDOMIZE_LIMITS, f"joint limits of '{self.name}'")
        columns = list(self._all_columns if joints is None else self._joint_columns(joints))
        chosen, what = self._selector.select(env_ids), f"limits of joints of '{self.name}'"
        lower = chosen.values(lower, (len(columns),), what, POSITIONS)
        upper = chosen.values(upper, (len(columns),), what, POSITIONS)
        free = [self.joint_names[joint] for joint in columns if not self._is_limited(joint)]
        if free:
            raise ConfigurationError(
                f"joints {', '.join(free)} of '{self.name}' have no limits in the scene: give some"
            )
        # The look would wait for the device in a traced step.
        if chosen.readable and bool((lower > upper).any()):
            raise ConfigurationError(f"lower {what} lie above the upper ones: give them in order")
        self._engine.set_joint_limits(self._all_joints[columns], lower, upper, chosen.rows)

    def _is_limited(self, joint: int) -> bool:
        parameters, column = self._engine.layout.joint_parameters, self.layout.joints.start + joint
        limits = parameters.lower_limit[column], parameters.upper_limit[column]
        return self._engine.layout.joints[column].type is not JointType.CONTINUOUS and all(map(math.isfinite, limits))

    def set_colors(self, colors: Tensor, links: Sequence[int] | None = None, env_ids: Tensor | None = None) -> None:
        """Red, green and blue (n, k, 3) in [0, 1] of all shapes of some links, in pictures.

        Raises:
            UnsupportedCapabilityError: the renderer cannot; names those that can.
        """
        self.require(Capability.COLORS_PER_ENVIRONMENT, f"colours of '{self.name}'")
        indices, chosen = self._link_indices(links), self._selector.select(env_ids)
        colors = chosen.values(colors, (len(indices), 3), f"colours of '{self.name}'", COLORS)
        self.painting.paint(indices, colors, chosen.rows)

    def set_textures(
        self,
        textures: Sequence[Texture],
        chosen: Tensor,
        links: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Give all shapes of some links one of ``textures`` each, by index (n, k) int64; -1 takes it away.

        Raises:
            ArgumentError: among others, an index that no texture has.
            UnsupportedCapabilityError: the renderer lacks what says where in a picture they are; names those that
                have it.
        """
        # A texture is painted after drawing, at the places that depth, normals and segmentation give.
        for capability in (Capability.DEPTH, Capability.NORMALS, Capability.SEGMENTATION):
            self.require(capability, f"textures of '{self.name}'")
        indices, rows = self._link_indices(links), self._selector.select(env_ids)
        places = rows.indices(chosen, (len(indices),), f"textures of '{self.name}'", -1, len(textures) - 1)
        self.painting.texture(indices, textures, places, rows.rows)

    def _joint_columns(self, joints: Sequence[int]) -> tuple[int, ...]:
        return columns_chosen(joints, len(self.joint_names), f"joints of '{self.name}'")

    def _links_named(self, links: Sequence[int] | None) -> Sequence[int]:
        count = len(self.link_names)
        return range(count) if links is None else columns_chosen(links, count, f"links of '{self.name}'")

    def _link_indices(self, links: Sequence[int] | None) -> Tensor:
        return (
            torch.tensor(self._links_named(links), dtype=torch.int64, device=self._engine.device)
            + self.layout.root_link
        )
