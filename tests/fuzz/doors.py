"""The public API as calls with arguments drawn from the pool."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch

from orbit_assets.catalogue import robot, robot_info
from orbit_assets.objects import box, capsule, cylinder, sphere, table
from orbit_core.backends import backend, renderer
from orbit_core.cli import main
from orbit_core.envs import make
from orbit_core.interfaces import OrbitError
from orbit_core.scene import (
    CameraSpec,
    Channel,
    ContactSensorSpec,
    FrameSensorSpec,
    ImuSpec,
    JointSensorSpec,
    MarkerSpec,
    PhysicsMaterial,
    Pose,
    RayCasterSpec,
    Scene,
)
from orbit_core.world import simulate
from orbit_learn.gymnasium import SingleEnvironment, VectorEnvironment
from tests.fuzz.pool import Pool

N = 3
CUBE = box("cube", size=(0.1, 0.1, 0.1), mass=0.5, pose=Pose((0.6, 0.0, 0.05)))
SCENE = Scene(
    robots=(robot("franka_panda", name="arm"),),
    objects=(CUBE,),
    sensors=(
        JointSensorSpec(name="joints", entity="arm"),
        ContactSensorSpec(name="touch", entity="cube"),
        ImuSpec(name="imu", entity="cube", frame="cube"),
        FrameSensorSpec(name="hand", entity="arm", frame="panda_hand"),
    ),
    markers=(MarkerSpec("goal"),),
)


@dataclass(frozen=True)
class Door:
    """A call, and what its arguments are drawn by."""

    name: str
    call: Callable[..., object]
    arguments: Callable[[Pool], tuple[Any, ...]]


class Doors:
    """Everything that is called, on one backend; what was made is closed at the end.

    Raises nothing of its own: what a call does to a world or environment is judged by :meth:`fault`.
    """

    def __init__(self, backend_name: str) -> None:
        self.backend = backend_name
        self.world = simulate(SCENE, N, backend_name)
        self.start = self.world.save_state()
        self.vector = VectorEnvironment("Lift", 2, backend=backend_name)
        self.single = SingleEnvironment("Reach", backend=backend_name)
        parts = (self._of_world(), self._of_entities(), self._of_environments(), self._of_makers())
        self.parts = [list(part) for part in parts]

    def recover(self) -> None:
        """Back to a state that may be stepped, after an engine has refused to go on."""
        self.world.load_state(self.start)
        for environment in (self.vector.environment, self.single.environment):
            environment.reset(seed=0)

    def fault(self) -> str:
        """What is not finite in the present state; empty if nothing."""
        world = self.world
        state = {
            "link poses": world.link_poses,
            "link velocities": world.engine.link_velocities,
            "joint positions": world.engine.joint_positions,
            "joint velocities": world.engine.joint_velocities,
            "position targets": world.actuators.position_targets,
            "velocity targets": world.actuators.velocity_targets,
            "effort targets": world.actuators.effort_targets,
            "marker poses": world.marker_poses,
            "observation": self.vector.environment.observe()["policy"],
        }
        return next((name for name, value in state.items() if not bool(torch.isfinite(value).all())), "")

    def close(self) -> None:
        self.world.close()
        self.vector.close()
        self.single.close()

    def _of_world(self) -> Iterator[Door]:
        world = self.world
        yield Door("world.step", world.step, lambda p: (p.random.choice((1, 2, p.anything())),))
        yield Door("world.reset", world.reset, lambda p: (p.env_ids(N),))
        yield Door("world.set_gravity", world.set_gravity, lambda p: (p.tensor(N, 3), p.env_ids(N)))
        yield Door("world.set_terrain_friction", world.set_terrain_friction, lambda p: (p.tensor(N), p.env_ids(N)))
        yield Door("world.load_state", world.load_state, lambda p: (p.anything(),))
        yield Door("world.random.seed", world.random.seed, lambda p: (p.anything(), p.env_ids(N)))
        yield Door("marker.set_pose", world.markers["goal"].set_pose, lambda p: (p.poses(N), p.env_ids(N)))
        for name, sensor in world.sensors.items():
            yield Door(f"sensor {name}.reset", sensor.reset, lambda p: (p.env_ids(N),))

    def _of_entities(self) -> Iterator[Door]:
        things = (*self.world.robots.values(), *self.world.objects.values())
        for thing in things:
            joints, links = len(thing.joint_names), len(thing.link_names)
            for setter, width in (("set_root_velocity", 6),):
                yield Door(setter, getattr(thing, setter), lambda p, w=width: (p.tensor(N, w), p.env_ids(N)))
            yield Door("set_root_pose", thing.set_root_pose, lambda p: (p.poses(N), p.env_ids(N)))
            yield Door("frame_pose", thing.frame_pose, lambda p: (p.word(("cube", "panda_hand")),))
            yield Door("frame_velocity", thing.frame_velocity, lambda p: (p.word(("cube", "panda_hand")),))
            yield Door("find_joints", thing.find_joints, lambda p: (p.word(("panda_joint1", ".*")),))
            yield Door("find_links", thing.find_links, lambda p: (p.word(("panda_hand", ".*")),))
            yield Door(
                "set_centers_of_mass",
                thing.set_centers_of_mass,
                lambda p, k=links: (p.tensor(N, k, 3), p.indices(k), p.env_ids(N)),
            )
            yield Door(
                "set_wrenches", thing.set_wrenches, lambda p, k=links: (p.tensor(N, k, 6), p.indices(k), p.env_ids(N))
            )
            for setter in ("set_masses", "set_friction"):
                call = getattr(thing, setter)
                yield Door(setter, call, lambda p, k=links: (p.tensor(N, k), p.indices(k), p.env_ids(N)))
            if joints:
                yield from self._of_joints(thing, joints)

    def _of_joints(self, thing: Any, k: int) -> Iterator[Door]:
        two = lambda p: (p.tensor(N, k), p.tensor(N, k), p.indices(k), p.env_ids(N))  # noqa: E731
        yield Door("set_joint_state", thing.set_joint_state, two)
        yield Door("set_gains", thing.set_gains, two)
        yield Door("jacobian", thing.jacobian, lambda p: (p.word(("panda_hand",)), p.indices(k)))
        for setter in ("set_position_targets", "set_velocity_targets", "set_effort_targets"):
            yield Door(setter, getattr(thing, setter), lambda p: (p.tensor(N, k), p.indices(k)))

    def _of_environments(self) -> Iterator[Door]:
        environment = self.vector.environment
        size = environment.action_size
        yield Door("environment.step", environment.step, lambda p: (p.tensor(2, size),))
        yield Door("environment.reset", environment.reset, lambda p: (p.anything(), p.env_ids(2)))
        yield Door("vector.step", self.vector.step, lambda p: (p.tensor(2, size),))
        yield Door("vector.reset", lambda s, o: self.vector.reset(seed=s, options=o), self._reset_arguments)
        size = self.single.environment.action_size
        yield Door("single.step", self.single.step, lambda p: (p.tensor(size),))
        yield Door("single.reset", lambda s, o: self.single.reset(seed=s, options=o), self._reset_arguments)

    @staticmethod
    def _reset_arguments(pool: Pool) -> tuple[Any, ...]:
        options = (None, {}, {"reset_mask": pool.env_ids(2)}, {"nonsense": 1})
        return pool.random.choice((None, 1, pool.anything())), pool.random.choice(options)

    def _of_makers(self) -> Iterator[Door]:
        yield Door("backend", backend, lambda p: (p.word((self.backend,)),))
        yield Door("renderer", renderer, lambda p: (p.word((self.backend,)),))
        yield Door("robot", lambda n, f, v: robot(n, **{f: v}), self._robot_arguments)
        yield Door("robot_info", robot_info, lambda p: (p.word(("franka_panda",)),))
        yield Door("settings", self._settings, lambda p: (self._setting(p), p.anything()))
        yield Door("make", self._make, lambda p: (p.word(("Lift",)), *self._make_keyword(p)))
        yield Door("solid", self._solid, lambda p: (p.random.randrange(5), p.number(), p.anything(), p.number()))
        yield Door("scene", self._world_of, lambda p: (p.random.randrange(len(SCENE_CHANGES)), p.anything()))
        yield Door("orbit", main, lambda p: (self._words(p),))

    def draw(self, pool: Pool) -> Door:
        """One of the calls; each part of the API as often as any other."""
        return pool.random.choice(pool.random.choice(self.parts))

    def _settings(self, name: str, value: object) -> None:
        self._live(LIGHT, {name: value})

    def _live(self, scene: Any, settings: Any = None) -> None:
        """Build a world and step it twice, after which its state must be finite."""
        world = simulate(scene, 1, self.backend, settings)
        try:
            world.step(2)
            assert bool(torch.isfinite(world.link_poses).all()), "a world with a state that is not finite"
        finally:
            world.close()

    def _setting(self, pool: Pool) -> str:
        return pool.random.choice([*backend(self.backend).config_type.__dataclass_fields__, "nonsense"])

    def _make(self, task: Any, keyword: str, value: object) -> None:
        make(task, **{"backend": self.backend, "num_envs": 1, keyword: value}).close()

    def _make_keyword(self, pool: Pool) -> tuple[str, object]:
        names = ("num_envs", "backend", "device", "seed", "renderer", "settings", "tolerance", "episode_length",
                 "physics_dt", "decimation", "robot", "action", "nonsense")  # fmt: skip
        return pool.random.choice(names), pool.anything()

    @staticmethod
    def _robot_arguments(pool: Pool) -> tuple[Any, ...]:
        return pool.word(("franka_panda", "ur10")), pool.random.choice(("name", "pose", "home", "nonsense")), 3

    def _solid(self, kind: int, length: Any, mass: Any, other: Any) -> None:
        solids: tuple[Callable[[], Any], ...] = (
            lambda: box("solid", (length, 0.1, 0.1), mass=mass),
            lambda: sphere("solid", length, mass=mass),
            lambda: cylinder("solid", length, other, density=mass),
            lambda: capsule("solid", length, other, mass=mass),
            lambda: table("solid", (length, other, 0.5)),
        )
        self._live(Scene(objects=(solids[kind](),)))

    def _world_of(self, change: int, value: Any) -> None:
        self._live(SCENE_CHANGES[change](value))

    @staticmethod
    def _words(pool: Pool) -> list[str]:
        """A command that is refused before anything is built, or is quick."""
        command = pool.random.choice(("list", "info", "run", "play", "export", "train", "bench", "nonsense"))
        bad = pool.random.choice(
            ("--num-envs=-1", "--seed=x", "--set=a=b", "--config=/nowhere.toml", "--nonsense", "--episodes=nan", "-1")
        )
        return [command, pool.random.choice(("Lift", "nonsense", "tasks", "")), bad]


LIGHT = Scene(objects=(CUBE,))
SCENE_CHANGES: tuple[Callable[[Any], Scene], ...] = (
    lambda v: replace(LIGHT, gravity=v),
    lambda v: replace(LIGHT, gravity=(0.0, 0.0, v)),
    lambda v: replace(LIGHT, physics_dt=v),
    lambda v: replace(LIGHT, objects=v),
    lambda v: replace(LIGHT, objects=(replace(CUBE, name=v),)),
    lambda v: replace(LIGHT, objects=(replace(CUBE, pose=Pose((v, 0.0, 0.0))),)),
    lambda v: replace(LIGHT, objects=(replace(CUBE, pose=Pose((0.0, 0.0, 0.0), (v, 0.0, 0.0, 0.0))),)),
    lambda v: replace(LIGHT, objects=(replace(CUBE, pose=v),)),
    lambda v: replace(LIGHT, objects=(box("cube", (0.1, 0.1, 0.1), material=PhysicsMaterial(static_friction=v)),)),
    lambda v: replace(LIGHT, objects=(box("cube", (0.1, 0.1, 0.1), material=PhysicsMaterial(restitution=v)),)),
    lambda v: replace(LIGHT, sensors=(JointSensorSpec(name="s", entity=v),)),
    lambda v: replace(LIGHT, sensors=(ImuSpec(name="s", entity="cube", frame="cube", rate=v),)),
    lambda v: replace(LIGHT, sensors=(ImuSpec(name="s", entity="cube", frame="cube", rate=50.0, delay=v),)),
    lambda v: replace(LIGHT, sensors=(CameraSpec(name="s", width=v),)),
    lambda v: replace(LIGHT, sensors=(CameraSpec(name="s", vertical_fov=v),)),
    lambda v: replace(LIGHT, sensors=(CameraSpec(name="s", channels=(Channel.RGB, v)),)),
    lambda v: replace(LIGHT, sensors=(RayCasterSpec(name="s", entity="cube", frame="cube", directions=v),)),
    lambda v: replace(LIGHT, sensors=(v,)),
    lambda v: replace(LIGHT, markers=(MarkerSpec(v),)),
    lambda v: replace(LIGHT, terrain=v),
)


def refused_well(error: BaseException) -> bool:
    """Whether an error is one of ours; the command line's own parser ends the process with a message and code 2."""
    return isinstance(error, OrbitError) or (isinstance(error, SystemExit) and error.code in (0, 2))
