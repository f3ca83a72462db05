"""Worlds and their sensors, as tasks, nodes, viewers and learning code see them: simulated, recorded or real."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any, Protocol

import torch
from torch import Tensor

from orbit_core.interfaces.capture import Schedule
from orbit_core.interfaces.engine import Engine
from orbit_core.interfaces.entities import Deformable, Marker, Object, Robot
from orbit_core.interfaces.errors import UnsupportedCapabilityError
from orbit_core.interfaces.layout import Approximation, SceneLayout
from orbit_core.interfaces.renderer import LightTable, Renderer
from orbit_core.scene import CameraSpec, Scene, SensorSpec, Studio


class Sensor(ABC):
    """One sensor of all environments. A subclass adds typed properties for its values."""

    spec: SensorSpec
    """Description in the scene."""

    def begin_step(self) -> None:
        """Start a control step: averages over it begin here."""

    @abstractmethod
    def advance(self, steps: int) -> None:
        """Advance the sensor's clock by ``steps`` physics steps; it measures when its period is over."""

    @abstractmethod
    def reset(self, env_ids: Tensor | None = None) -> None:
        """Forget the past of some environments; their next reading is fresh."""


Bound = float | tuple[float, ...] | Tensor


class WorldClock(Protocol):
    """Counts the changes of a world's state, so that what is derived from it is computed once per state."""

    version: int
    """Differs whenever the state may have changed."""
    steps: int
    """Physics steps made."""

    def touch(self) -> None:
        """Count a write of the state."""
        ...


class WorldSelector(Protocol):
    """Selection of the environments that a call is for; while a mask is set, of those in it only."""

    # A context, so that the mask is lifted even where the code within raises.
    def only(self, mask: Tensor) -> AbstractContextManager[None]:
        """Set a mask (N,) bool for a while."""
        ...

    def given(self, env_ids: Tensor | None) -> AbstractContextManager[Tensor]:
        """Give indices (n,) for indices; for a mask (N,), the indices of all environments, under the mask."""
        ...

    def where(self, mask: Tensor) -> Tensor | None:
        """Return the environments of a mask (N,) as indices, None without any; in a traced step the mask itself."""
        ...

    def resolve(self, env_ids: Tensor | None) -> Tensor | None:
        """Return the environments that ``env_ids`` means: checked indices (n,), a mask (N,) bool, or None for all."""
        ...


class WorldRandom(Protocol):
    """Random streams, one per environment: each draws the same numbers for any number of environments."""

    def seed(self, seed: int, env_ids: Tensor | None = None) -> None:
        """Restart the streams of some environments from a seed."""
        ...

    def uniform(
        self, shape: tuple[int, ...], low: Bound = 0.0, high: Bound = 1.0, env_ids: Tensor | None = None
    ) -> Tensor:
        """Return (n, *shape) float32 in [low, high); bounds broadcast to ``shape``."""
        ...

    def normal(self, shape: tuple[int, ...], std: float | Tensor = 1.0, env_ids: Tensor | None = None) -> Tensor:
        """Return (n, *shape) float32 of mean zero."""
        ...

    def integers(self, low: int, high: int, env_ids: Tensor | None = None) -> Tensor:
        """Return (n,) int64 in [low, high]."""
        ...

    @property
    def episode(self) -> Tensor:
        """Number (N,) of each environment's episode, from 0; -1 before the first."""
        ...

    def begin(self, episode: Tensor) -> None:
        """Begin the streams of given episodes (N,), in the environments that are in others."""
        ...

    def save_state(self) -> Any:
        """Return detached copy of all streams."""
        ...

    def load_state(self, state: Any) -> None:
        """Return to a saved state."""
        ...


class World(ABC):
    """N environments of a scene, stepped together.

    What every world has is abstract or plain data. What only some have (pictures, snapshots, parameters of physics, an
    engine) raises an UnsupportedCapabilityError that says so, until a subclass provides it.

    The mappings by name raise an UnknownNameError with the nearest name
    (:class:`~orbit_core.interfaces.names.NamedThings`).
    """

    scene: Scene
    """Scene of the world, as it was built."""
    layout: SceneLayout
    """Numbers of the scene's links and joints."""
    backend: str
    """Name of the backend, or what else the world comes from."""
    # Typed by the plugin, which the core does not know.
    settings: Any = None
    """The backend's settings, a dataclass; None where nothing is simulated."""
    matter: str = ""
    """Name of the matter solver that simulates deformables; empty where the engine does, or there are none."""
    num_envs: int
    """Number N of environments."""
    device: torch.device
    """Device of all tensors."""
    physics_dt: float
    """Seconds of a physics step."""
    robots: Mapping[str, Robot]
    """Robots by name."""
    objects: Mapping[str, Object]
    """Objects by name."""
    deformables: Mapping[str, Deformable]
    """Cloth, ropes, soft bodies and liquids by name."""
    sensors: Mapping[str, Sensor]
    """Sensors by name."""
    markers: Mapping[str, Marker]
    """Markers by name."""
    clock: WorldClock
    """Counter of steps and changes."""
    random: WorldRandom
    """Random streams, one per environment."""
    selector: WorldSelector
    """Mask of environments that calls are for."""

    # Time

    @abstractmethod
    def step(self, steps: int = 1) -> None:
        """Advance by that many physics steps with commands held; sensors measure when they are due."""

    @abstractmethod
    def reset(self, env_ids: Tensor | None = None) -> None:
        """Return environments to the scene's initial state, sensors, actuators and random streams included."""

    @abstractmethod
    def close(self) -> None:
        """Free the world's resources; idempotent."""

    def add_servo(self, servo: Callable[[], None]) -> None:
        """Have ``servo`` set targets of joints before every physics step, as a motor controller does.

        It reads the present state, is called in the order of adding, and keeps to what a captured step may do.
        """
        raise self._unsupported("servos at the physics rate")

    def settle(self, steps: int, env_ids: Tensor | None = None) -> None:
        """Simulate some environments for physics steps that count nowhere: no sensor measures, and others stand still.

        Free objects move meanwhile; robots are held by their commands. All environments are stepped, and those that are
        not meant are restored, which takes as long as a step of all. Where ``Capability.SNAPSHOTS`` is approximate,
        these continue with the difference that it declares.

        Args:
            steps: of physics.
            env_ids: indices (n,) int64; all environments if None.

        Raises:
            SimulationError: the engine diverged.
            UnsupportedCapabilityError: nothing is simulated, or the engine has no snapshots of this scene.
        """
        raise self._unsupported("physics to run on for a while")

    def save_state(self) -> Any:
        """Return everything that the continuation depends on."""
        raise self._unsupported("snapshots")

    def load_state(self, state: Any) -> None:
        """Return to a saved state."""
        raise self._unsupported("snapshots")

    def copy_state(self, source: int, targets: Tensor | None = None, origin: World | None = None) -> None:
        """Copy the state of one environment into others, as predictions of a model start from it.

        Poses, velocities, joint states and commands are copied on every engine. A solver's warm start
        is copied where ``Capability.COPIED_STATES`` is exact, and the continuation then repeats; elsewhere it is reset,
        and the continuation differs a little where things touch. Sensors and delayed commands of the targets are reset.
        Parameters (masses, gains, friction) stay the targets' own.

        Args:
            source: index of the environment.
            targets: indices (n,) int64 or a mask (N,) bool; all environments if None.
            origin: the world that ``source`` is of, of the same scene; this one if None.

        Raises:
            ArgumentError: there is no such environment, or ``origin`` is a world of another scene.
            UnsupportedCapabilityError: the scene has deformables, or the world has no states to write.
        """
        raise self._unsupported("states to copy")

    # Poses of the whole scene, for renderers and viewers

    @property
    def link_poses(self) -> Tensor:
        """Link poses (N, L, 7) of every link of the scene, in the layout's order."""
        # Robots come first, as in the layout, whose link indices these rows match.
        entities = (*self.robots.values(), *self.objects.values())
        poses = [entity.link_poses for entity in entities]
        return torch.cat(poses, 1) if poses else torch.zeros(self.num_envs, 0, 7, device=self.device)

    @property
    def marker_poses(self) -> Tensor:
        """Marker poses (N, M, 7) of every marker, in the scene's order."""
        poses = [marker.pose for marker in self.markers.values()]
        return torch.stack(poses, 1) if poses else torch.zeros(self.num_envs, 0, 7, device=self.device)

    @property
    def renderer(self) -> Renderer:
        """Draws the scene's cameras."""
        raise self._unsupported("renderer")

    def create_renderer(
        self, cameras: tuple[CameraSpec, ...], frames: bool = False, studio: Studio | None = None
    ) -> Renderer:
        """Return another renderer of this scene, for cameras that are no sensors. The caller closes it.

        Args:
            cameras: all that it will be used with.
            frames: draw axes at the robots' bases, end effectors, finger tips, feet and wheels.
            studio: look of the pictures; None draws them as the scene's own cameras see it.
        """
        raise self._unsupported("renderer")

    # Physics of environments

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        """Set gravity (n, 3) in m/s^2 of some environments; it outlasts resets."""
        raise self._unsupported("gravity to set")

    def set_terrain_friction(self, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        """Set friction (n,), static and dynamic alike, of all terrain shapes."""
        raise self._unsupported("friction to set")

    # Pictures of environments

    def set_lights(self, lights: LightTable, env_ids: Tensor | None = None) -> None:
        """Light some environments (n, ...) otherwise, in colour images; it outlasts resets.

        There are as many directional lights as the scene has: a radiance of zero switches one off.
        """
        raise self._unsupported("lights to set")

    @property
    def nominal_lights(self) -> LightTable:
        """The scene's own lights, a row for each environment."""
        raise self._unsupported("lights")

    # Lower layers

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        """Parts of the scene that the engine and the matter solver approximate."""
        return ()

    @property
    def python_laws(self) -> Mapping[str, object]:
        """Actuator models and active models that compute in Python during a step, by name."""
        return {}

    @property
    def engine(self) -> Engine:
        """The physics engine, past this interface: for measurements of engines, not for tasks."""
        raise self._unsupported("engine")

    @property
    def native(self) -> Any:
        """The engine's own objects, for users who know why."""
        raise self._unsupported("native objects")

    @property
    def schedule(self) -> Schedule | None:
        """Counters of a step, which a captured step moves on; None where nothing is simulated, nor captured."""
        return None

    def _unsupported(self, what: str) -> UnsupportedCapabilityError:
        return UnsupportedCapabilityError(f"this world has no {what}: {type(self).__name__} provides none")
