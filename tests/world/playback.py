"""A world of recorded states, played back: what tasks and viewers need of a world and no physics.

What is written to it (states, targets) is accepted and has no effect, as a recording cannot be changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import RowSelector, write_rows
from orbit_core.dynamics.kinematics import FixedFrame, PointJacobian
from orbit_core.dynamics.random import RandomStreams
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import EntityLayout, Marker, NamedThings, Object, Robot, SceneLayout, World, match_names
from orbit_core.scene import ContactSensorSpec, Entity, Frame, MarkerSpec, RobotSpec, Scene
from orbit_core.sensors import ContactSensor
from orbit_core.world.state import Clock

STATE = ("link_poses", "link_velocities", "joint_positions", "joint_velocities", "joint_efforts")


@dataclass
class Recording:
    """States of all entities of a world, one frame each time that :meth:`add` is called: after a reset, then steps."""

    steps_per_frame: int
    scene: Scene | None = None
    frames: list[dict[str, tuple[Tensor, ...]]] = field(default_factory=list)

    def add(self, world: World) -> None:
        """Note the present state."""
        self.scene = world.scene
        entities = (*world.robots.items(), *world.objects.items())
        frame = {name: tuple(getattr(thing, what).clone() for what in STATE) for name, thing in entities}
        for name, sensor in world.sensors.items():
            assert isinstance(sensor, ContactSensor), "no other sensors are recorded"
            frame[name] = (sensor.forces.clone(),)
        self.frames.append(frame)

    def __call__(self, scene: Scene, num_envs: int, device: torch.device, seed: int) -> World:
        """The world that plays it: a factory for an environment."""
        return PlaybackWorld(self, num_envs, device, seed)


class PlaybackWorld(World):
    """Plays one episode in each environment: a reset goes back to the first frame, and the last one stays."""

    def __init__(self, recording: Recording, num_envs: int, device: torch.device, seed: int) -> None:
        assert recording.scene is not None  # something was recorded
        self.scene = scene = recording.scene
        self.layout = SceneLayout.of(scene)
        self.backend = "playback"
        self.num_envs = num_envs
        self.device = device
        self.physics_dt = scene.physics_dt
        self.clock = Clock()  # pyright: ignore[reportIncompatibleVariableOverride]
        self.selector = RowSelector(num_envs, device)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.random = RandomStreams(num_envs, seed, device, self.selector)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.random.reset()
        self._steps_per_frame = recording.steps_per_frame
        self._last = len(recording.frames) - 1
        self.frame = torch.zeros(num_envs, dtype=torch.int64, device=device)
        """(N,) number of the frame that each environment shows."""
        names: list[NamedThings] = []
        played = {
            entity.name: (entity, _Played(recording.frames, entity.name, STATE, self.frame, device))
            for entity in self.layout.entities
        }
        robots = {name: PlaybackRobot(*played[name]) for name in (spec.name for spec in scene.robots)}
        objects = {name: PlaybackObject(*played[name]) for name in (spec.name for spec in scene.objects)}
        markers = {spec.name: PlaybackMarker(spec, self.selector, num_envs, device) for spec in scene.markers}
        self.robots = NamedThings(robots, "robot", "world.robots", names)
        self.objects = NamedThings(objects, "object", "world.objects", names)
        self.markers = NamedThings(markers, "marker", "world.markers", names)
        sensors = {
            spec.name: PlaybackContacts(
                spec, _Played(recording.frames, spec.name, ("forces",), self.frame, device), self.layout
            )
            for spec in scene.sensors
            if isinstance(spec, ContactSensorSpec)
        }
        self.sensors = NamedThings(sensors, "sensor", "world.sensors", names)
        self.deformables = NamedThings({}, "deformable", "world.deformables", names)

    def step(self, steps: int = 1) -> None:
        frames, rest = divmod(steps, self._steps_per_frame)
        assert rest == 0, "the recording has no frame then"
        self.frame.add_(frames).clamp_(max=self._last)
        self.clock.advance(steps)

    def reset(self, env_ids: Tensor | None = None) -> None:
        rows = self.selector.resolve(env_ids)
        self.random.reset(rows)
        write_rows(self.frame, 0, rows)
        self.clock.touch()

    def close(self) -> None:
        """Nothing is held."""


class _Played:
    """The frames of one entity or sensor, and which of them is shown."""

    def __init__(
        self,
        frames: Sequence[Mapping[str, tuple[Tensor, ...]]],
        name: str,
        state: tuple[str, ...],
        frame: Tensor,
        device: torch.device,
    ) -> None:
        self._whole = {
            what: torch.stack([values[name][i] for values in frames]).to(device) for i, what in enumerate(state)
        }
        self.frame = frame
        self.device = device
        self._environments = torch.arange(len(frame), device=device)

    def now(self, what: str) -> Tensor:
        return self._whole[what][self.frame, self._environments]


class PlaybackObject(Object):
    """What was recorded of an articulation."""

    def __init__(self, layout: EntityLayout, played: _Played) -> None:
        self._layout = layout
        self._played = played
        self.name = layout.name
        self.link_names = layout.spec.articulation.link_names
        self.joint_names = layout.spec.articulation.joint_names

    @property
    def spec(self) -> Entity:
        return self._layout.spec

    @property
    def root_pose(self) -> Tensor:
        return self.link_poses[:, 0]

    @property
    def root_velocity(self) -> Tensor:
        return self.link_velocities[:, 0]

    @property
    def link_poses(self) -> Tensor:
        return self._played.now("link_poses")

    @property
    def link_velocities(self) -> Tensor:
        return self._played.now("link_velocities")

    @property
    def joint_positions(self) -> Tensor:
        return self._played.now("joint_positions")

    @property
    def joint_velocities(self) -> Tensor:
        return self._played.now("joint_velocities")

    @property
    def joint_efforts(self) -> Tensor:
        return self._played.now("joint_efforts")

    def frame_pose(self, name: str) -> Tensor:
        frame = self._frame(name)
        place = (*frame.pose.position, *frame.pose.orientation)
        return FixedFrame(place, self._played.device)(self.link_poses[:, self.link_names.index(frame.link)])

    def frame_velocity(self, name: str) -> Tensor:
        frame = self._frame(name)
        link = self.link_names.index(frame.link)
        velocity = self.link_velocities[:, link]
        offset = torch.tensor(frame.pose.position, dtype=torch.float32, device=self._played.device)
        arm = quat_rotate(self.link_poses[:, link, 3:], offset)
        return torch.cat((velocity[:, :3] + torch.linalg.cross(velocity[:, 3:], arm), velocity[:, 3:]), -1)

    def jacobian(self, frame: str, joints: Sequence[int] | None = None) -> Tensor:
        columns = tuple(range(len(self.joint_names)) if joints is None else joints)
        link = self.link_names.index(self._frame(frame).link)
        jacobian = PointJacobian(self.spec.articulation, link, columns, self._played.device)
        return jacobian(self.link_poses, self.frame_pose(frame)[:, :3])

    @property
    def home_positions(self) -> Tensor:
        home = SceneLayout.of(Scene(objects=(self.spec,))).joint_parameters.home
        return torch.as_tensor(home, dtype=torch.float32, device=self._played.device)

    @property
    def position_limits(self) -> Tensor:
        parameters = SceneLayout.of(Scene(objects=(self.spec,))).joint_parameters
        bounds = [torch.as_tensor(bound) for bound in (parameters.lower_limit, parameters.upper_limit)]
        return torch.stack(bounds, -1).to(self._played.device, torch.float32)

    def set_root_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        """A recording stays as it is."""

    def set_root_velocity(self, velocity: Tensor, env_ids: Tensor | None = None) -> None:
        """A recording stays as it is."""

    def set_joint_state(
        self,
        positions: Tensor | None = None,
        velocities: Tensor | None = None,
        joints: Sequence[int] | None = None,
        env_ids: Tensor | None = None,
    ) -> None:
        """A recording stays as it is."""

    def _frame(self, name: str) -> Frame:
        return self.spec.articulation.frame(name)


class PlaybackRobot(PlaybackObject, Robot):
    """What was recorded of a robot."""

    @property
    def spec(self) -> RobotSpec:
        spec = self._layout.spec
        assert isinstance(spec, RobotSpec)
        return spec

    def set_position_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        """A recording takes no commands."""

    def set_velocity_targets(self, targets: Tensor, joints: Sequence[int] | None = None) -> None:
        """A recording takes no commands."""

    def set_effort_targets(self, efforts: Tensor, joints: Sequence[int] | None = None) -> None:
        """A recording takes no commands."""


class PlaybackContacts(ContactSensor):
    """The net forces that a contact sensor measured; what single bodies exert was not recorded."""

    def __init__(self, spec: ContactSensorSpec, played: _Played, layout: SceneLayout) -> None:
        self.spec = spec
        self._played = played
        (names,) = (e.spec.articulation.link_names for e in layout.entities if e.name == spec.entity)
        self.link_names = tuple(names[index] for index in match_names(spec.links, names, "link"))

    @property
    def forces(self) -> Tensor:
        return self._played.now("forces")

    def advance(self, steps: int) -> None:
        """The world shows another frame."""

    def reset(self, env_ids: Tensor | None = None) -> None:
        """The world shows the first frame."""


class PlaybackMarker(Marker):
    """Tasks place markers themselves, so that these are real."""

    def __init__(self, spec: MarkerSpec, selector: RowSelector, num_envs: int, device: torch.device) -> None:
        self.spec = spec
        self._selector = selector
        self._pose = torch.zeros(num_envs, 7, device=device)
        self._pose[:, 3] = 1.0

    @property
    def pose(self) -> Tensor:
        return self._pose

    def set_pose(self, pose: Tensor, env_ids: Tensor | None = None) -> None:
        chosen = self._selector.select(env_ids)
        write_rows(self._pose, chosen.poses(pose, f"pose of marker '{self.spec.name}'"), chosen.rows)
