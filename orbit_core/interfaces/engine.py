"""The narrow waist between core and plugin: a physics engine for N copies of a scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from orbit_core.interfaces.capture import Traceable, changes, measures, reads_state
from orbit_core.interfaces.errors import UnsupportedCapabilityError
from orbit_core.interfaces.layout import BACKGROUND, Approximation, BuiltModel, SceneLayout

_MOST_SURFACES = 16  # a ray may cross that many surfaces to be passed before it counts as a miss
_PAST_SURFACE = 2e-5  # metres: a surface nearer than this behind one that is passed is passed too


@dataclass(frozen=True)
class RayHits:
    """The points at which rays met the scene."""

    distances: Tensor
    """(n, R) metres; infinite for a miss."""
    normals: Tensor
    """(n, R, 3) unit normals in world axes; zero for a miss."""
    links: Tensor
    """(n, R) int64 link index, TERRAIN or BACKGROUND."""


def cast_past(
    cast: Callable[[Tensor, Tensor, float, Tensor | None], RayHits],
    origins: Tensor,
    directions: Tensor,
    max_distance: float,
    links: range,
    env_ids: Tensor | None,
) -> RayHits:
    """Cast rays that pass through the shapes of some links: a ray that met one is cast again from behind it.

    Args:
        cast: casts rays as :meth:`Engine.cast_rays` does.
        origins: (n, R, 3) m.
        directions: (n, R, 3) unit vectors.
        max_distance: m.
        links: range of the layout's links that rays pass through.
        env_ids: (n,) environments; all if None.
    """
    hits = cast(origins, directions, max_distance, env_ids)
    distances, normals, met = hits.distances.clone(), hits.normals.clone(), hits.links.clone()
    own = _among(met, links)
    for _ in range(_MOST_SURFACES):
        if not own.any():
            break
        rays = own.any(0).nonzero().squeeze(-1)
        within = own[:, rays]  # of the same ray, another environment's may be through already
        start = torch.where(within, distances[:, rays] + _PAST_SURFACE, 0.0)
        moved = origins[:, rays] + start[..., None] * directions[:, rays]
        hits = cast(moved, directions[:, rays].contiguous(), max_distance, env_ids)
        distances[:, rays] = torch.where(within, start + hits.distances, distances[:, rays])
        normals[:, rays] = torch.where(within[..., None], hits.normals, normals[:, rays])
        met[:, rays] = torch.where(within, hits.links, met[:, rays])
        own = _among(met, links)
    missed = own | (distances > max_distance)
    distances[missed] = torch.inf
    normals[missed] = 0.0
    met[missed] = BACKGROUND
    return RayHits(distances, normals, met)


def _among(met: Tensor, links: range) -> Tensor:
    return (met >= links.start) & (met < links.stop)


_COMMANDS = ("position_targets", "velocity_targets", "efforts")


class Engine(Traceable, ABC):
    """N environments of one scene in one physics engine.

    N = ``num_envs``, J movable joints and L links as numbered by ``layout``; n = ``len(env_ids)``, all environments
    where ``env_ids`` is None. ``env_ids`` are int64 on ``device`` and hold no index twice. State tensors are float32 on
    ``device``, in the environment's own world frame.

    A state tensor may be the engine's own buffer: it is valid until the next step or write, and read only. Writes are
    visible to the next read.

    The engine trusts its caller: the core has checked names, shapes and finiteness.

    What it does for steps that are captured is its :attr:`capture`.
    """

    # Switched off where environments are reset one by one, so that one that diverges does not stop the others.
    raises_divergence: bool = True
    """Whether :meth:`step` raises where environments diverged. Where not, its caller looks for them after each step,
    and resets them before the next; other faults raise as ever."""

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device) -> None:
        self.layout = layout
        self.num_envs = num_envs
        self.device = device
        joints = len(layout.joints)
        # Targets at home keep a robot without commands where a reset puts it.
        home = torch.as_tensor(layout.joint_parameters.home, dtype=torch.float32, device=device)
        self.position_targets = home.repeat(num_envs, 1)
        """(N, J) drive targets; the core writes them in place and the engine reads them at each step."""
        self.velocity_targets = torch.zeros(num_envs, joints, device=device)
        """(N, J)"""
        self.efforts = torch.zeros(num_envs, joints, device=device)
        """(N, J) efforts added to the drive's; their sum is limited to the joint's effort limit."""

    # Time ------------------------------------------------------------------------------------------------------------

    @abstractmethod
    @changes()
    def step(self, steps: int) -> None:
        """Advance by ``steps`` physics steps of ``scene.physics_dt`` with commands held.

        Raises:
            SimulationError: the engine diverged (:mod:`orbit_core.interfaces.errors`); names the environments.
                Not where :attr:`raises_divergence` is off.
        """

    # State -----------------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    @reads_state
    def joint_positions(self) -> Tensor:
        """Joint positions (N, J), rad or m."""

    @property
    @abstractmethod
    @reads_state
    def joint_velocities(self) -> Tensor:
        """Joint velocities (N, J), rad/s or m/s."""

    @property
    @abstractmethod
    @reads_state
    def joint_efforts(self) -> Tensor:
        """Efforts (N, J) of drives and commands over the last physics step after limits, N m or N.

        The mean over the step, not the law at its beginning: ``(inertia + armature) (v1 - v0) / h`` of a free joint.
        Forces of the joint itself are not in them: its damping, friction, spring and limits.
        """

    @property
    @abstractmethod
    @reads_state
    def link_poses(self) -> Tensor:
        """Link poses (N, L, 7), position and quaternion (w, x, y, z), w >= 0, of each link frame."""

    @property
    @abstractmethod
    @reads_state
    def link_velocities(self) -> Tensor:
        """Linear velocities of the link frames' origins, then angular velocities (N, L, 6), in world axes."""

    @abstractmethod
    @changes("positions", "velocities")
    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        """Set the state of joints. Mimic joints follow when the engine next steps.

        Args:
            joints: (k,) indices of the layout.
            positions: (n, k) rad or m; None leaves them.
            velocities: (n, k) rad/s or m/s; None leaves them.
            env_ids: (n,) environments; all if None.
        """

    @abstractmethod
    @changes("pose", "velocity")
    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        """Set the state of an entity's root link.

        Args:
            entity: index of the layout.
            pose: (n, 7) in the environment's world frame; None leaves it.
            velocity: (n, 6) linear, then angular, world axes; None leaves it, and for a fixed base it is None.
            env_ids: (n,) environments; all if None.
        """

    @abstractmethod
    @changes()
    def reset(self, env_ids: Tensor | None = None) -> None:
        """Put environments into the scene's initial state and clear all memory of the past.

        Root poses, home positions, zero velocities, default targets, no efforts, no wrenches, no warm start.
        Randomised parameters stay.
        """

    # Measurements ----------------------------------------------------------------------------------------------------

    @property
    @reads_state
    def contact_forces(self) -> Tensor:
        """Contact forces (N, K, 3) of ``layout.contact_queries``, mean of the last ``step`` call: newtons, world axes.

        Zero after a reset until the environment has stepped.
        """
        raise self._unsupported("contact forces")

    @property
    @reads_state
    def joint_wrenches(self) -> Tensor:
        """Force and torque (N, W, 6) that each of ``layout.wrench_links`` receives from its parent, or the world.

        About the link frame's origin, in the link's axes, over the last physics step. The torque about a hinge's axis
        is the joint's effort, less what its damping, friction, spring and armature take.
        """
        raise self._unsupported("joint wrenches")

    @measures("origins", "directions")
    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        """Cast rays against collision shapes.

        Args:
            origins: (n, R, 3) m, in the environment's world frame.
            directions: (n, R, 3) unit vectors in world axes.
            max_distance: m beyond which a surface counts as missed.
            env_ids: (n,) environments; all if None.
        """
        raise self._unsupported("ray casts")

    @measures("origins", "directions")
    def cast_rays_past(
        self, origins: Tensor, directions: Tensor, max_distance: float, links: range, env_ids: Tensor | None = None
    ) -> RayHits:
        """Cast rays as :meth:`cast_rays` does, through the shapes of some links, a range of the layout's.

        A miss, or a hit beyond ``max_distance``, is BACKGROUND. This one casts again past each surface of those links,
        as often as any ray needs it, and so waits for the device.
        """
        return cast_past(self.cast_rays, origins, directions, max_distance, links, env_ids)

    # Parameters per environment --------------------------------------------------------------------------------------

    @changes("wrenches")
    def set_wrenches(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        """Apply wrenches to links until they are set again.

        Args:
            links: (k,) indices of the layout.
            wrenches: (n, k, 6) force at the centre of mass and torque, world axes, N and N m.
            env_ids: (n,) environments; all if None.
        """
        raise self._unsupported("external wrenches")

    @changes("masses")
    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        """Set masses (n, k) in kg of links (k,); inertias scale with them."""
        raise self._unsupported("mass per environment")

    @changes("centers")
    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        """Set centres of mass (n, k, 3) in the link frame of links (k,)."""
        raise self._unsupported("centre of mass per environment")

    @changes("coefficients")
    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        """Set static and dynamic friction (n, k) of all shapes of links (k,); index TERRAIN sets the terrain's."""
        raise self._unsupported("friction per environment")

    @changes("stiffness", "damping")
    def set_drive_gains(
        self, joints: Tensor, stiffness: Tensor, damping: Tensor, env_ids: Tensor | None = None
    ) -> None:
        """Set gains (n, k) of the native drives of joints (k,)."""
        raise self._unsupported("drive gains per environment")

    @changes("damping", "friction", "armature", "stiffness")
    def set_joint_parameters(
        self,
        joints: Tensor,
        damping: Tensor | None,
        friction: Tensor | None,
        armature: Tensor | None,
        stiffness: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """Set parameters of the mechanism of joints.

        None leaves one as it is. Parameters of drives are no part of it.

        Args:
            joints: (k,) indices of the layout.
            damping: (n, k) N s/m or N m s/rad.
            friction: (n, k) Coulomb friction, N or N m.
            armature: (n, k) kg or kg m^2.
            stiffness: (n, k) of springs, N/m or N m/rad.
            env_ids: (n,) environments; all if None.
        """
        raise self._unsupported("joint damping, friction, armature and springs per environment")

    @changes("lower", "upper")
    def set_joint_limits(self, joints: Tensor, lower: Tensor, upper: Tensor, env_ids: Tensor | None = None) -> None:
        """Set lower and upper limits (n, k), rad or m, of joints (k,) that are limited on both sides in the scene."""
        raise self._unsupported("joint limits per environment")

    @changes("gravity")
    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        """Set gravity (n, 3) in m/s^2."""
        raise self._unsupported("gravity per environment")

    # Deformables -----------------------------------------------------------------------------------------------------

    @measures()
    def particle_positions(self, deformable: int) -> Tensor:
        """Return (N, P, 3) of the scene's deformable of that index."""
        raise self._unsupported("deformables")

    @measures()
    def particle_velocities(self, deformable: int) -> Tensor:
        """Return (N, P, 3) m/s."""
        raise self._unsupported("deformables")

    @changes("positions", "velocities")
    def write_particles(
        self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None
    ) -> None:
        """Set (n, P, 3) positions and velocities."""
        raise self._unsupported("deformables")

    @changes()
    def anchor_particles(
        self, deformable: int, particles: Tensor, link: int | None, env_ids: Tensor | None = None
    ) -> None:
        """Hold particles where they are; resets keep them held.

        Args:
            deformable: index in the scene.
            particles: (k,) indices.
            link: index of the layout; the world if None.
            env_ids: (n,) environments; all if None.
        """
        raise self._unsupported("anchors of particles")

    @changes()
    def release_particles(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        """Release particles (k,), some of which may not be anchored."""
        raise self._unsupported("anchors of particles")

    @changes("values")
    def set_particle_parameter(self, deformable: int, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        """Set (n,) of one of a deformable's parameters (:data:`orbit_core.interfaces.matter.PARAMETERS`)."""
        raise self._unsupported("parameters of deformables per environment")

    @measures()
    def particle_forces(self, deformable: int) -> Tensor:
        """Return (N, L, 3) newtons, world axes, that a deformable exerts on each link, at the last physics step."""
        raise self._unsupported("contact forces of deformables")

    @measures()
    def particle_pressures(self, deformable: int) -> Tensor:
        """Return (N, L) Pa with which a deformable presses on each link: normal force over area in contact."""
        raise self._unsupported("contact pressures of deformables")

    # Snapshots and the rest ------------------------------------------------------------------------------------------

    @abstractmethod
    def save_state(self) -> Any:
        """Return a detached copy of all that the continuation depends on, with commands and parameters."""

    @abstractmethod
    def load_state(self, state: Any) -> None:
        """Return to a saved state; stepping on repeats what followed it."""

    def copy_state(self, origin: Engine, source: int, env_ids: Tensor | None = None) -> None:
        """Put one environment's state into some of this engine's, by index.

        Poses, velocities, joint states and commands are copied, as this does for every engine. Other state
        that the continuation depends on (contacts that a solver starts from) is reset, unless an engine copies it.

        Args:
            origin: the engine that ``source`` is of, of the same scene; it may be this one.
            source: index of the environment.
            env_ids: (n,) int64; all environments if None.
        """
        count = self.num_envs if env_ids is None else len(env_ids)

        def repeated(whole: Tensor) -> Tensor:
            return whole[source].clone().to(self.device).expand(count, *whole.shape[1:])

        # All reads come before the first write: source and target may be the same engine.
        poses, velocities = repeated(origin.link_poses), repeated(origin.link_velocities)
        positions, rates = repeated(origin.joint_positions), repeated(origin.joint_velocities)
        commands = {name: repeated(getattr(origin, name)) for name in _COMMANDS}
        for entity in self.layout.entities:
            root = entity.root_link
            velocity = None if entity.spec.fixed_base else velocities[:, root].contiguous()
            self.write_root_state(entity.index, poses[:, root].contiguous(), velocity, env_ids)
        joints = torch.arange(len(self.layout.joints), device=self.device)
        if len(joints):
            self.write_joint_state(joints, positions.contiguous(), rates.contiguous(), env_ids)
        for name, values in commands.items():
            getattr(self, name)[slice(None) if env_ids is None else env_ids] = values

    def saved_commands(self) -> dict[str, Tensor]:
        """Return a copy of the commands, for :meth:`save_state`."""
        return {name: getattr(self, name).clone() for name in _COMMANDS}

    def load_commands(self, saved: dict[str, Tensor]) -> None:
        """Put saved commands back in place, for :meth:`load_state`."""
        for name in _COMMANDS:
            getattr(self, name).copy_(saved[name])

    @property
    @abstractmethod
    def build_report(self) -> tuple[Approximation, ...]:
        """Parts of the scene that the engine approximates."""

    @abstractmethod
    def built_model(self) -> tuple[BuiltModel, ...]:
        """Return the model that the engine built for each kind of environment, in the order of ``layout.variants``.

        Called once, before the first step; the core compares it with the description.
        """

    @property
    @abstractmethod
    def native(self) -> Any:
        """The engine's own objects, for users who know why."""

    def close(self) -> None:
        """Free the engine's resources; idempotent."""

    def _unsupported(self, what: str) -> UnsupportedCapabilityError:
        return UnsupportedCapabilityError(f"{type(self).__name__} does not provide {what}")
