"""A robot's computer as an engine, so that the core's world, sensors, actuators and action terms run on a robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import (
    Approximation,
    Backend,
    BuiltModel,
    Capabilities,
    Capability,
    ConfigurationError,
    Engine,
    Renderer,
    SceneLayout,
    UnsupportedCapabilityError,
    approximate,
    unsupported,
)
from orbit_core.interfaces.capabilities import IMAGES, MATTER
from orbit_core.scene import CameraSpec, ImuSpec, RobotSpec, Scene, SensorSpec
from orbit_core.sensors.timed import TimedSensor
from orbit_core.world.world import SimulatedWorld, WorldFactory
from orbit_deploy.description import RobotDescription, check_robot
from orbit_deploy.link import RobotFaultError, RobotLink
from orbit_deploy.measured import MeasuredImu, PictureRenderer
from orbit_deploy.messages import Arrangement, Mode, RobotState
from orbit_deploy.pictures import check_cameras

# Kinds of pictures that a robot's cameras take
_SEEN = (Capability.RGB, Capability.DEPTH, Capability.TEXTURES, Capability.LIGHTING, Capability.SHADOWS)
# Parts of a world that a simulation has and a robot has not
_NONE = (
    Capability.CONTACT_FORCES, Capability.FRICTION_FORCES, Capability.JOINT_WRENCHES, Capability.LOOP_WRENCHES,
    Capability.EXTERNAL_WRENCHES, Capability.RAY_CASTS, Capability.RANDOMIZE_MASS, Capability.RANDOMIZE_CENTER_OF_MASS,
    Capability.RANDOMIZE_FRICTION, Capability.RANDOMIZE_GAINS, Capability.RANDOMIZE_JOINTS, Capability.RANDOMIZE_LIMITS,
    Capability.RANDOMIZE_GRAVITY,
    Capability.SHAPES_PER_ENVIRONMENT, Capability.SNAPSHOTS, Capability.COPIED_STATES, Capability.DETERMINISTIC,
    Capability.GPU, *MATTER, *(each for each in IMAGES if each not in _SEEN),
)  # fmt: skip
# rad or m: a first target that is farther than this from where the robot is gets a slow way there
_NEAR = 0.02


@dataclass(frozen=True)
class RobotSettings:
    """Settings of a robot: its computer has them."""


@dataclass
class StepTimes:
    """Timing of a client's steps."""

    steps: int = 0
    """Number of steps so far."""
    overruns: int = 0
    """Steps whose command was sent after the next one was due."""


class RobotBackend(Backend):
    """Backend of one robot that a link leads to; no plugin, as it needs the link.

    Args:
        link: session with the robot's computer; the engine closes it.
        period: seconds between commands.
        contacts: accept contact sensors, although nobody measures them: their forces are NaN.
        rehearsing: begin without moving the robot (:attr:`RobotEngine.rehearsing`).
    """

    name: ClassVar[str] = "robot"
    """Name in messages and manifests; it is in no list of plugins."""
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = RobotSettings
    simulates: ClassVar[bool] = False

    def __init__(self, link: RobotLink, period: float, contacts: bool = False, rehearsing: bool = False) -> None:
        self._link, self._period, self._contacts, self._rehearsing = link, period, contacts, rehearsing
        self._engine: RobotEngine | None = None

    def capabilities(self) -> Capabilities:
        declared = {each: approximate("the robot's own") for each in Capability}
        declared |= {each: unsupported("a robot's computer neither measures nor sets it") for each in _NONE}
        if self._contacts:
            declared[Capability.CONTACT_FORCES] = approximate("a robot's computer measures none: forces are NaN")
        return Capabilities(declared)

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: Any) -> Engine:
        if num_envs != 1 or device.type != "cpu":
            raise ConfigurationError(f"a robot is one environment on device 'cpu', not {num_envs} on '{device}'")
        cameras = [spec for spec in layout.scene.sensors if isinstance(spec, CameraSpec)]
        check_cameras(cameras, self._link.description.cameras, self._link.address)
        self._engine = RobotEngine(layout, self._link, self._period, self._rehearsing)
        return self._engine

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: Any) -> Renderer:
        engine = self._engine
        assert engine is not None  # a world makes its engine first
        return PictureRenderer(self._link, lambda: engine.placed_at)


class RobotEngine(Engine):
    """One robot and the objects that its computer tracks.

    A step sends the targets and waits until its time is over on the wall clock. Link poses come from joint positions
    by the description's kinematics; objects that nobody tracks are where the scene puts them, if their base is fixed.

    Args:
        layout: of the scene, with one robot.
        link: session with the robot's computer.
        period: seconds between commands; what is stepped in smaller parts sends one command in each period.
        rehearsing: begin without moving the robot (:attr:`rehearsing`).

    Raises:
        ConfigurationError: the scene has no robot or several, the robot has other joints, or does not track an object.
    """

    def __init__(self, layout: SceneLayout, link: RobotLink, period: float, rehearsing: bool = False) -> None:
        super().__init__(layout, 1, torch.device("cpu"))
        robots = [entity for entity in layout.entities if isinstance(entity.spec, RobotSpec)]
        if len(robots) != 1:
            raise ConfigurationError(f"a robot's computer drives one robot, and the scene has {len(robots)}")
        self.link, self.times = link, StepTimes()
        """Steps so far, and how many of them were late."""
        self._robot, self._period, self._dt = robots[0], period, layout.scene.physics_dt
        spec = self._robot.spec
        assert isinstance(spec, RobotSpec)
        self.differences = check_robot(RobotDescription.of(spec), link.description, link.address)
        """Differences between the robot and the scene's that do not change what commands mean, one sentence each."""
        self._tracked = self._find_tracked(link.description)
        joints, links = len(layout.joints), len(layout.links)
        self._joint_positions = torch.as_tensor(layout.joint_parameters.home, dtype=torch.float32)[None].clone()
        self._joint_velocities, self._joint_efforts = torch.zeros(1, joints), torch.zeros(1, joints)
        self._link_poses, self._link_velocities = torch.zeros(1, links, 7), torch.zeros(1, links, 6)
        self._trees = {entity.index: KinematicTree(entity.spec.articulation) for entity in layout.entities}
        self._root_poses = {
            e.index: torch.tensor((*e.spec.pose.position, *e.spec.pose.orientation))[None] for e in layout.entities
        }
        self._root_velocities = {e.index: torch.zeros(1, 6) for e in layout.entities}
        # No comparison with NaN is true, so that no touch is ever reported, and an action from it is refused.
        self._contact_forces = torch.full((1, len(layout.contact_queries), 3), torch.nan)
        self.rehearsing = rehearsing
        """True while steps and resets send nothing and take no time: an environment is made, which begins with a reset,
        and it is seen what an agent would do."""
        self._due: float | None = None
        self._last_sent = -1.0
        self._soft = True
        self.placed = True
        """True in :attr:`on_step` if the robot was put or led elsewhere since the step before, as a reset does."""
        self.placed_at = 0
        """Time at which that was done last, ns on the robot's clock."""
        self.imus: list[list[float]] = []
        """Newest measurements of the robot's inertial units (10 numbers each)."""
        self.on_step: Callable[[RobotState], None] | None = None
        """Called with each step's state, as a display does."""
        self._take(link.state())

    def step(self, steps: int) -> None:
        if self.rehearsing:
            return
        link = self.link
        now = link.now()
        if self._soft and not link.description.arranges:
            self._start_softly()
            now = link.now()
        self.placed, self._soft = self._soft, False
        late = self._due is not None and now > self._due + steps * self._dt
        if self._due is None or late:
            self.times.overruns += late
            self._due = now
        # Sensors may cut a period into parts, and a knot of the path in each would make stairs of it.
        if self._last_sent < 0.0 or now - self._last_sent >= 0.75 * self._period:
            joints = self._robot.joints
            targets = (self.position_targets, self.velocity_targets, self.efforts)
            link.send(*(tensor[0, joints].tolist() for tensor in targets))
            self._last_sent = now
        self._due += steps * self._dt
        link.wait(self._due)
        state = link.state()
        if state.mode is Mode.FAULT:
            raise RobotFaultError(f"the robot at {link.address} rests after a fault: clear it, then command it")
        self.times.steps += 1
        self._take(state)
        if self.on_step is not None:
            self.on_step(state)

    def _start_softly(self) -> None:
        """Move slowly to the first targets, so that following them begins without a jump."""
        targets, drives = self.position_targets[0, self._robot.joints], self.link.description.stiffness
        far = (targets - self._joint_positions[0, self._robot.joints]).abs() * (torch.tensor(drives) > 0.0)
        if float(far.max()) > _NEAR:
            self.link.move_to(targets.tolist())
            self._take(self.link.finish_motion())
            self._due = None

    # State

    @property
    def joint_positions(self) -> Tensor:
        return self._joint_positions

    @property
    def joint_velocities(self) -> Tensor:
        return self._joint_velocities

    @property
    def joint_efforts(self) -> Tensor:
        return self._joint_efforts

    @property
    def contact_forces(self) -> Tensor:
        return self._contact_forces

    @property
    def link_poses(self) -> Tensor:
        return self._link_poses

    @property
    def link_velocities(self) -> Tensor:
        return self._link_velocities

    def _take(self, state: RobotState) -> None:
        joints = self._robot.joints
        self._stamp, self.imus = state.stamp, state.imus
        for tensor, values in (
            (self._joint_positions, state.positions),
            (self._joint_velocities, state.velocities),
            (self._joint_efforts, state.efforts),
        ):
            tensor[0, joints] = torch.tensor(values, dtype=torch.float32)
        # Frames of all links follow from joints and roots, so that a robot need not measure them.
        for index, place in self._tracked.items():
            numbers = torch.tensor(state.objects[place], dtype=torch.float32)
            self._root_poses[index][0], self._root_velocities[index][0] = numbers[:7], numbers[7:]
        for entity in self.layout.entities:
            root, rate, tree = (
                self._root_poses[entity.index],
                self._root_velocities[entity.index],
                self._trees[entity.index],
            )
            poses = tree.forward(root, self._joint_positions[:, entity.joints])
            self._link_poses[:, entity.links] = poses
            self._link_velocities[:, entity.links] = tree.link_velocities(
                poses, rate, self._joint_velocities[:, entity.joints]
            )

    def _find_tracked(self, description: RobotDescription) -> dict[int, int]:
        """Return the place in a state's objects of each entity that is tracked, by the entity's index."""
        found: dict[int, int] = {}
        for entity in self.layout.entities:
            moves = entity.joints.stop > entity.joints.start
            if entity.name in description.objects:
                found[entity.index] = description.objects.index(entity.name)
            elif not entity.spec.fixed_base:
                raise ConfigurationError(
                    f"the robot at {self.link.address} tracks no '{entity.name}': it tracks "
                    f"{', '.join(description.objects) or 'nothing'}"
                )
            if moves and entity is not self._robot:
                raise ConfigurationError(f"the robot at {self.link.address} measures no joints of '{entity.name}'")
        return found

    # Writes

    def write_joint_state(
        self, joints: Tensor, positions: Tensor | None, velocities: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        # Masks and indices of no environment write nothing, as on every engine.
        if self.rehearsing or positions is None or (env_ids is not None and not len(env_ids)):
            return  # a robot's velocities are nobody's to write
        self._joint_positions[:, joints] = positions
        goal = self._joint_positions[0, self._robot.joints].tolist()
        if self.link.description.arranges:
            self._take(self.link.arrange(Arrangement(positions=goal)))
        else:
            self.link.move_to(goal)
            self._take(self.link.finish_motion())
        self._forget_time()

    def write_root_state(
        self, entity: int, pose: Tensor | None, velocity: Tensor | None, env_ids: Tensor | None = None
    ) -> None:
        if pose is None or (env_ids is not None and not len(env_ids)):
            return
        described = self.layout.entities[entity]
        if described.spec.fixed_base:
            self._root_poses[entity][:] = pose
            return
        if self.rehearsing:
            return
        if not self.link.description.arranges:
            raise UnsupportedCapabilityError(
                f"'{described.name}' at a real robot is placed by hand: switch off the events that place it"
            )
        self._take(self.link.arrange(Arrangement(object=described.name, pose=pose[0].tolist())))
        self._forget_time()

    def reset(self, env_ids: Tensor | None = None) -> None:
        if env_ids is not None and not len(env_ids):
            return
        home = torch.as_tensor(self.layout.joint_parameters.home, dtype=torch.float32)
        self.position_targets[:] = home
        self.velocity_targets.zero_()
        self.efforts.zero_()
        if self.rehearsing:
            return
        if self.link.description.arranges:
            self._take(self.link.arrange(Arrangement(reset=True)))
        else:
            self.link.move_to(home[self._robot.joints].tolist())
            self._take(self.link.finish_motion())
        self._forget_time()

    def _forget_time(self) -> None:
        """Begin the next step whenever it comes: time goes on while an episode is prepared."""
        self._due, self._last_sent, self._soft, self.placed_at = None, -1.0, True, self._stamp

    # The rest

    def save_state(self) -> Any:
        raise self._unsupported("snapshots of a robot")

    def load_state(self, state: Any) -> None:
        raise self._unsupported("snapshots of a robot")

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return tuple(Approximation("robot", "the scene's", line, "the robot's own") for line in self.differences)

    def built_model(self) -> tuple[BuiltModel, ...]:
        raise self._unsupported("a model that was built")

    @property
    def native(self) -> RobotLink:
        return self.link

    def close(self) -> None:
        self.link.close()


class RobotWorld(SimulatedWorld):
    """World over a robot: the core's world on a :class:`RobotEngine`.

    Args:
        scene: of the task, with one robot.
        link: session with the robot's computer; the world closes it.
        period: seconds between commands.
        num_envs: 1.
        device: ``cpu``.
        seed: of the random stream.
        contacts: accept contact sensors, whose forces are NaN.
        rehearsing: begin without moving the robot (:attr:`RobotEngine.rehearsing`).
    """

    def __init__(
        self,
        scene: Scene,
        link: RobotLink,
        period: float,
        num_envs: int,
        device: torch.device,
        seed: int,
        contacts: bool = False,
        rehearsing: bool = False,
    ) -> None:
        super().__init__(scene, num_envs, RobotBackend(link, period, contacts, rehearsing), device=device, seed=seed)
        # Nothing is simulated here, and a manifest says so.
        self.settings = None
        self.link = link
        """Session with the robot's computer."""

    def _create_sensor(self, spec: SensorSpec) -> TimedSensor:
        engine = self._engine
        assert isinstance(engine, RobotEngine)
        units = engine.link.description.imus
        # What an accelerometer measures is worth more than a difference of estimated velocities.
        if isinstance(spec, ImuSpec) and spec.name in units:
            place = units.index(spec.name)
            return MeasuredImu(spec, self._sensing, lambda: engine.imus[place])
        return super()._create_sensor(spec)


def robot_world(link: RobotLink, period: float, contacts: bool = False, rehearsing: bool = False) -> WorldFactory:
    """Return the factory of a world over a robot, for ``orbit_core.envs.make(..., world=robot_world(link, period))``.

    The world has the task's scene. Sensors, action terms, explicit actuators and Jacobians are the core's own, computed
    here from what the robot measures.

    Args:
        link: session with the robot's computer; the world closes it.
        period: seconds between commands: the task's step.
        contacts: accept contact sensors, which a robot has none of: their forces are NaN, so that terms that compare
            them never trigger. For tasks whose rewards or terminations read contacts and whose policy does not.
        rehearsing: begin without moving the robot, whose environment resets it when it is made otherwise, until
            ``world.engine.rehearsing`` is set to False.
    """

    def factory(scene: Scene, num_envs: int, device: torch.device, seed: int) -> RobotWorld:
        return RobotWorld(scene, link, period, num_envs, device, seed, contacts, rehearsing)

    return factory
