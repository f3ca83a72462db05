"""Worlds over one engine: the scene's robots, objects and sensors, stepped together."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Hashable, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from orbit_core.actuators import Actuators
from orbit_core.actuators.stability import check_drives
from orbit_core.backends import backend as find_backend
from orbit_core.backends import backend_config, check_capability, check_scene, choose_matter
from orbit_core.backends import renderer as find_renderer
from orbit_core.configuration import settings_table
from orbit_core.dynamics.arguments import (
    ACCELERATIONS,
    COSINES,
    FRICTIONS,
    MOST_ENVIRONMENTS,
    MOST_STEPS,
    RADIANCES,
    seed_number,
    usable_device,
    whole_number,
)
from orbit_core.dynamics.indexing import RowSelector, write_rows
from orbit_core.dynamics.linear import products_ignore_other_rows
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import (
    TERRAIN,
    Approximation,
    ArgumentError,
    Backend,
    Capability,
    ConfigurationError,
    Engine,
    LightTable,
    NamedThings,
    OrbitError,
    Renderer,
    SceneLayout,
    World,
)
from orbit_core.interfaces.capabilities import IMAGES
from orbit_core.interfaces.capture import Schedule, is_tracing
from orbit_core.preparation.scene_data import check_attachments, check_data
from orbit_core.preparation.scenes import prepared
from orbit_core.scene import CameraSpec, RayCameraSpec, Scene, SensorSpec, Studio
from orbit_core.sensors import SensorContext, create_sensor
from orbit_core.sensors.timed import TimedSensor
from orbit_core.world.active import ActiveModels
from orbit_core.world.checks import check_build, check_capacity
from orbit_core.world.drawing import Painting, light_camera, scene_lights, with_frames, with_matter
from orbit_core.world.entities import SimulatedMarker, SimulatedObject, SimulatedRobot, identity_poses
from orbit_core.world.lifetime import mark_closed, mark_forked, register_after_fork
from orbit_core.world.matter import SimulatedDeformable, coupled, rigid_part
from orbit_core.world.state import Clock, DivergenceGuard, WorldParts, WorldState, check_copy, settle
from orbit_core.world.studio import StudioRenderer, dressed


class SimulatedWorld(World):
    """N environments of a scene in one physics engine.

    :func:`~orbit_core.world.simulate` documents arguments and errors. ``backend`` may also be a backend that no plugin
    registers, such as a robot's computer.
    """

    # Never replaced, so that what a reader of World expects holds.
    clock: Clock
    selector: RowSelector
    random: RandomStreams

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        backend: str | Backend,
        settings: Mapping[str, Any] | None = None,
        device: str | torch.device = "cpu",
        seed: int = 0,
        renderer: str | None = None,
        renderer_settings: Mapping[str, Any] | None = None,
        matter: str | None = None,
        matter_settings: Mapping[str, Any] | None = None,
    ) -> None:
        num_envs, seed = whole_number(num_envs, "num_envs", 1, MOST_ENVIRONMENTS), seed_number(seed)
        self._plugin = plugin = backend if isinstance(backend, Backend) else find_backend(backend)
        self._renderer_plugin = plugin if renderer is None else find_renderer(renderer)
        if not isinstance(scene, Scene):
            raise ConfigurationError(f"a world needs a Scene, not a {type(scene).__name__}")
        # Everything that can be refused without the engine is refused before it is built, which may take seconds.
        check_data(scene, "scene")
        scene = prepared(scene)
        check_attachments(scene)
        solver = choose_matter(plugin, scene, matter)
        check_scene(plugin, scene, self._renderer_plugin, solver)
        self._solver = solver
        self.matter = "" if solver is None else solver.name
        self.scene = scene
        self.layout = SceneLayout.of(scene)
        self.num_envs = num_envs
        self.device = usable_device(device)
        self.physics_dt = scene.physics_dt
        self.backend = plugin.name
        self.settings = config = backend_config(plugin, settings)
        drawn = settings_table(settings, plugin.name) if self._renderer_plugin.name == plugin.name else {}
        drawn = {**drawn, **settings_table(renderer_settings, "the renderer")}
        self._renderer_config = backend_config(self._renderer_plugin, drawn)
        check_capacity(self.layout, num_envs, self.device)
        check_drives(self.layout, plugin)
        engine = plugin.create_engine(rigid_part(self.layout, solver), num_envs, self.device, config)
        try:
            # The check moves the joints.
            if plugin.simulates:
                check_build(engine, plugin.name)
            self._engine = coupled(engine, self.layout, solver, matter_settings)
        except OrbitError:
            engine.close()
            raise
        self.painting = Painting(num_envs, len(self.layout.links), self.device)
        """Colours of links and the renderers that draw them."""
        self.selector = RowSelector(num_envs, self.device)  # pyright: ignore[reportIncompatibleVariableOverride]
        """Which environments a call is for."""
        self.random = RandomStreams(num_envs, seed, self.device, self.selector)  # pyright: ignore[reportIncompatibleVariableOverride]
        # Streams begin their first episode before sensors draw their biases.
        self.random.reset()
        self.actuators = Actuators(self._engine, self.layout, self.random, any(each.active for each in scene.objects))
        """Actuators of all joints."""
        self.clock = Clock()  # pyright: ignore[reportIncompatibleVariableOverride]
        self._renderer: Renderer | None = None
        self._names: list[NamedThings] = []
        self._add_entities()
        self._add_sensors()
        register_after_fork(self)

    def _add_entities(self) -> None:
        parts = self._world_parts = WorldParts(self._engine, self.actuators, self.clock, self.selector)
        count = len(self.scene.robots)
        robots = {e.name: SimulatedRobot(e, parts) for e in self.layout.entities[:count]}
        objects = {e.name: SimulatedObject(e, parts) for e in self.layout.entities[count:]}
        for thing in (*robots.values(), *objects.values()):
            thing.require, thing.painting = self._require, self.painting
        self.active = ActiveModels(objects, self._engine, self.selector)
        deformables = {
            spec.name: SimulatedDeformable(i, spec, parts, {**robots, **objects})
            for i, spec in enumerate(self.scene.deformables)
        }
        self._marker_poses = identity_poses(self.num_envs, len(self.scene.markers), self.device)
        markers = {
            spec.name: SimulatedMarker(spec, self._marker_poses[:, i], self.selector)
            for i, spec in enumerate(self.scene.markers)
        }
        self.robots = NamedThings(robots, "robot", "world.robots", self._names)
        self.objects = NamedThings(objects, "object", "world.objects", self._names)
        self.deformables = NamedThings(deformables, "deformable", "world.deformables", self._names)
        self.markers = NamedThings(markers, "marker", "world.markers", self._names)

    def _require(self, capability: Capability, culprit: str) -> None:
        check_capability(self._renderer_plugin if capability in IMAGES else self._plugin, capability, culprit)

    def _add_sensors(self) -> None:
        # The renderer is passed as a function: a scene whose cameras nobody reads makes none.
        self._sensing = SensorContext(self._engine, self.layout, self.physics_dt, self.random, lambda: self.renderer)
        self._timed = {spec.name: self._create_sensor(spec) for spec in self.scene.sensors}
        self.sensors = NamedThings(self._timed, "sensor", "world.sensors", self._names)
        self._servos: list[Callable[[], None]] = []
        self._guard: DivergenceGuard | None = None
        self._plan_steps()
        self._schedule = _WorldSchedule(self)

    def _create_sensor(self, spec: SensorSpec) -> TimedSensor:
        """Create a sensor; worlds whose robots measure by themselves replace some."""
        return create_sensor(spec, self._sensing)

    def _plan_steps(self) -> None:
        """Decide how far the engine runs at a time."""
        # True if something computes before each physics step
        self._singly = self.actuators.explicit or bool(self._servos)
        periods = [sensor.stretch for sensor in self._timed.values() if sensor.stretch is not None]
        if self._singly and self.layout.contact_queries:
            periods.append(1)  # the engine averages contact forces over each call
        # Physics steps whose divisors the engine's stretches are, for they end where a sensor is due
        self._stretch = math.gcd(*periods) if periods else None

    def add_servo(self, servo: Callable[[], None]) -> None:
        self._servos.append(servo)
        self._plan_steps()

    @property
    def link_poses(self) -> Tensor:
        return self._engine.link_poses

    @property
    def marker_poses(self) -> Tensor:
        return self._marker_poses

    @property
    def renderer(self) -> Renderer:
        """Draws the scene's cameras; made on first use."""
        if self._renderer is None:
            cameras = tuple(
                spec
                for spec in self.scene.sensors
                # Rays are cast by the engine.
                if isinstance(spec, CameraSpec) and not isinstance(spec, RayCameraSpec)
            )
            self._renderer = self.create_renderer(cameras)
        return self._renderer

    def create_renderer(
        self, cameras: tuple[CameraSpec, ...], frames: bool = False, studio: Studio | None = None
    ) -> Renderer:
        layout = self.layout if studio is None else dressed(self.layout, studio)
        drawn = rigid_part(with_frames(layout) if frames else layout, self._solver)
        light = light_camera(layout, cameras)
        eyes = cameras if light is None else (*cameras, light)
        renderer = self._renderer_plugin.create_renderer(drawn, eyes, self._renderer_config)
        renderer = with_matter(renderer, self._solver, self._engine, layout, light)
        if studio is None:
            return self.painting.add(renderer)
        return self.painting.add(renderer, lambda inner: StudioRenderer(inner, layout.scene, studio))

    @property
    def python_laws(self) -> Mapping[str, object]:
        """Actuator models and active models that compute in Python during a step, by name."""
        return {**self.actuators.models, **self.active.laws}

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        """Differences from the scene that was requested: of the models first, then of the engine."""
        notes = tuple(
            Approximation(entity.name, "the source's model", note, "the catalogue's choice")
            for entity in self.scene.entities
            for note in entity.articulation.notes
        )
        return notes + self._engine.build_report

    @property
    def engine(self) -> Engine:
        return self._engine

    @property
    def native(self) -> Any:
        return self._engine.native

    def step(self, steps: int = 1) -> None:
        if type(steps) is not int or not 1 <= steps <= MOST_STEPS:
            steps = whole_number(steps, "steps", 1, MOST_STEPS)
        for sensor in self._timed.values():
            sensor.begin_step()
        while steps > 0:
            whole = self._stretch
            stretch = steps if whole is None else min(steps, whole - self.clock.steps % whole)
            if self._singly:
                self._step_singly(stretch)
            else:
                self._engine.step(stretch)
                if self._guard is not None:
                    self._guard.look()
            self.clock.advance(stretch)
            # After the clock, because sensors read the state of the new time.
            for sensor in self._timed.values():
                sensor.advance(stretch)
            steps -= stretch

    def settle(self, steps: int, env_ids: Tensor | None = None) -> None:
        rows, steps = self.selector.select(env_ids).rows, whole_number(steps, "steps", 1, MOST_STEPS)
        step = self._step_singly if self._singly else self._engine.step
        settle(self._engine, (self.actuators, self.active), step, steps, rows)
        self.clock.touch()

    def _step_singly(self, steps: int) -> None:
        """Step the engine one physics step at a time: servos, actuator models and active models compute before each."""
        for left in range(steps, 0, -1):
            for servo in self._servos:
                servo()
            if self.actuators.explicit:
                self.actuators.apply()
            if self.active:
                self.active.apply()
            # A traced step checks no targets that servos compute from diverged states: one look at its end suffices.
            self._engine.step(1)
            if self._guard is not None and (left == 1 or not is_tracing()):
                self._guard.look()
            self.clock.touch()  # the next servo reads the new state

    def guard_divergence(self) -> Tensor:
        """Reset environments that diverge in a step from now on; returns the guard's ``lost`` (N,) bool."""
        self._guard = self._guard or DivergenceGuard(self._world_parts)
        return self._guard.lost

    @property
    def schedule(self) -> Schedule:
        return self._schedule

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        """Gravity (n, 3) in m/s^2 of some environments, for good.

        Raises:
            UnsupportedCapabilityError: the engine cannot.
        """
        chosen = self.selector.select(env_ids)
        gravity = chosen.values(gravity, (3,), "gravity", ACCELERATIONS)
        self._engine.set_gravity(gravity, chosen.rows)
        write_rows(self._sensing.gravity, gravity, chosen.rows)

    def set_terrain_friction(self, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        chosen = self.selector.select(env_ids)
        coefficients = chosen.values(coefficients, (), "friction of the terrain", FRICTIONS)
        self._engine.set_friction(torch.tensor([TERRAIN], device=self.device), coefficients[:, None], chosen.rows)

    def set_lights(self, lights: LightTable, env_ids: Tensor | None = None) -> None:
        """Light some environments otherwise.

        Raises:
            UnsupportedCapabilityError: the renderer cannot; names those that can.
            ShapeError, NonFiniteError, ArgumentError: the lights are no lights of so many environments.
        """
        self._require(Capability.LIGHTS_PER_ENVIRONMENT, "lights of environments")
        chosen, count = self.selector.select(env_ids), len(self.scene.directional_lights)
        given = LightTable(
            chosen.values(lights.ambient, (3,), "ambient light", RADIANCES),
            chosen.values(lights.directions, (count, 3), "directions of lights", COSINES),
            chosen.values(lights.radiance, (count, 3), "radiance of lights", RADIANCES),
        )
        self.painting.light(self.nominal_lights, given, chosen.rows)

    @property
    def nominal_lights(self) -> LightTable:
        own = scene_lights(self.scene, self.num_envs, self.device)
        return LightTable(own.ambient.clone(), own.directions.clone(), own.radiance.clone())

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Return some environments to their start, by index or by mask (N,) bool.

        Raises:
            ArgumentError, ShapeError: ``env_ids`` are no environments; nothing was reset.
        """
        env_ids = self.selector.resolve(env_ids)
        self.random.reset(env_ids)
        self._engine.reset(env_ids)
        self.actuators.reset(env_ids)
        self.active.reset(env_ids)
        for sensor in self._timed.values():
            sensor.reset(env_ids)
        self.clock.touch()

    def save_state(self) -> WorldState:
        sensors = {name: sensor.save_state() for name, sensor in self._timed.items()}
        return WorldState(
            self._engine.save_state(),
            self.actuators.save_state(),
            self.active.save_state(),
            sensors,
            self.random.save_state(),
            self._marker_poses.clone(),
            self.clock.steps,
            self._identity,
        )

    def load_state(self, state: WorldState) -> None:
        """Return to a saved state.

        Raises:
            ArgumentError: it is none, or that of a world of another backend, size or scene.
        """
        if not isinstance(state, WorldState) or state.made_by != self._identity:
            raise ArgumentError(
                "the state is not one that save_state() of such a world gave: the backend, the number of environments, "
                "the names of all things in the scene and the numbers of particles must be the same"
            )
        self._engine.load_state(state.engine)
        self.actuators.load_state(state.actuators)
        self.active.load_state(state.active)
        for name, sensor in self._timed.items():
            sensor.load_state(state.sensors[name])
        self.random.load_state(state.random)
        self._marker_poses.copy_(state.markers)
        # Due times of sensors are multiples on this clock, so it is part of the snapshot.
        self.clock.steps = state.steps
        self.clock.touch()

    def copy_state(self, source: int, targets: Tensor | None = None, origin: World | None = None) -> None:
        origin = self if origin is None else origin
        check_copy(self, origin, source)
        rows = self.selector.select(targets).rows
        # The engine first: actuators and sensors derive their state from it.
        self._engine.copy_state(origin.engine, source, rows)
        if isinstance(origin, SimulatedWorld):
            self.actuators.copy(origin.actuators, source, rows)
            self.active.copy(origin.active, source, rows)
        else:
            self.actuators.reset(rows)
        if self.scene.markers:
            write_rows(self._marker_poses, origin.marker_poses[source].clone(), rows)
        for sensor in self._timed.values():
            sensor.reset(rows)
        self.clock.touch()

    def close(self) -> None:
        """Free what the world holds; idempotent. Every later use raises a ClosedError."""
        # The renderer may hold the engine's buffers, so it goes first.
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self._engine.close()
        for thing in self._parts:
            mark_closed(thing, "the world")

    def mark_forked(self, parent: int) -> None:
        """Refuse every later use in this process, which was forked from the one that made the world."""
        for thing in (*self._parts, *([self._renderer] if self._renderer else ())):
            mark_forked(thing, "the world", parent)

    @property
    def _parts(self) -> tuple[object, ...]:
        return (*(thing for things in self._names for thing in things.values()), self.random, self._engine, self)

    @property
    def _identity(self) -> tuple[str, int, tuple[str, ...], tuple[int, ...]]:
        specs = (*self.scene.entities, *self.scene.deformables, *self.scene.sensors, *self.scene.markers)
        particles = tuple(len(spec.rest_positions) for spec in self.scene.deformables)
        return self.backend, self.num_envs, tuple(spec.name for spec in specs), particles


class _WorldSchedule(Schedule):
    """Physics steps of a simulated world, and the counters of its sensors."""

    def __init__(self, world: SimulatedWorld) -> None:
        self._world = world
        self._sensors = tuple(world._timed.values())

    @property
    def period(self) -> int:
        return math.lcm(*(sensor.period or 1 for sensor in self._sensors))

    @property
    def key(self) -> Hashable:
        place = self._world.clock.steps % (self._world._stretch or 1)
        return (place, *[sensor.counters for sensor in self._sensors])

    @property
    def count(self) -> int:
        return self._world.clock.steps

    def move(self, key: Any, steps: int) -> None:
        self._world.clock.advance(steps)
        for sensor, counters in zip(self._sensors, key[1:], strict=True):
            sensor.counters = counters


class WorldFactory(Protocol):
    """Makes a world of a scene, however it comes by its state: recorded, or measured on real robots."""

    def __call__(self, scene: Scene, num_envs: int, device: torch.device, seed: int) -> World:
        """The world, whose tensors are on ``device`` and whose random streams start from ``seed``."""
        ...


def simulate(
    scene: Scene,
    num_envs: int,
    backend: str,
    settings: Mapping[str, Any] | None = None,
    device: str | torch.device = "cpu",
    seed: int = 0,
    renderer: str | None = None,
    renderer_settings: Mapping[str, Any] | None = None,
    matter: str | None = None,
    matter_settings: Mapping[str, Any] | None = None,
) -> World:
    """N environments of a scene in one physics engine.

    Args:
        scene: what to simulate.
        num_envs: how many copies.
        backend: name of an installed backend.
        settings: the backend's own settings, by field name.
        device: where state tensors live.
        seed: of the environments' random streams.
        renderer: name of the renderer, or backend, that draws; the one that simulates if None.
        renderer_settings: the renderer's own, by field name; over ``settings`` where one backend simulates and draws.
        matter: name of the matter solver that simulates deformables, or ``"native"`` for the engine's own; the first
            installed solver that does what the scene needs, and else the engine, if None.
        matter_settings: the matter solver's own, by field name.

    Raises:
        UnknownNameError, BackendNotInstalledError: no such backend.
        UnsupportedCapabilityError: the backend lacks what the scene needs, or the renderer what its cameras need.
        AssetError: an articulation cannot be simulated.
        BuildError: what the engine built is not what the scene describes.
    """
    drawing, matters = (renderer, renderer_settings), (matter, matter_settings)
    world = SimulatedWorld(scene, num_envs, backend, settings, device, seed, *drawing, *matters)
    if world.device.type == "cpu" and not products_ignore_other_rows():
        warnings.warn(
            "matrix products of this process depend on the number of environments, in their last bits, and so do "
            "observations and rewards: import orbit_core before torch multiplies anything, or set MKL_CBWR=AUTO,STRICT "
            "(where that is set, MKL has no such mode for this processor)",
            stacklevel=2,
        )
    return world
