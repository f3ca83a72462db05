"""A step without its Python, compiled or not, resets by mask or not, is the step that it stands for."""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import (
    CurriculumTerm,
    EventTerm,
    EventTime,
    ObservationGroup,
    ObservationTerm,
    RewardTerm,
    TerminationTerm,
    make,
)
from orbit_core.envs.captured_step import CapturedStep, needs_python
from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import leaves_of
from orbit_core.interfaces import ConfigurationError, NonFiniteError
from orbit_core.mdp import randomize
from orbit_core.scene import (
    ActuatorConfig,
    CameraSpec,
    Channel,
    ContactSensorSpec,
    FrameSensorSpec,
    IdealPd,
    ImuSpec,
    JointSensorSpec,
    Noise,
    Pose,
    RayCasterSpec,
    Scene,
    SensorSpec,
    TactileSpec,
    look_at,
)
from orbit_core.sensors.rays import grid_pattern
from orbit_tasks.lift import Lift, LiftObservations, LiftState
from orbit_tasks.velocity_flat import CONTACTS, VelocityFlat

BACKEND = default_backend()
STEPS = 30


def lift(**changes: object) -> Lift:
    """Episodes that end often, at different times, with noise that every environment draws for itself."""
    task = Lift(episode_length=0.2, **changes)  # pyright: ignore[reportArgumentType]
    task.observations.policy.cube_pose = replace(task.observations.policy.cube_pose, noise_std=0.01)
    task.terminations.dropped = TerminationTerm(lambda env: env.state.last_action[:, 0] > 0.9)
    return task


def closed(environment: Environment, whole: bool) -> Environment:
    environment._closed = CapturedStep(environment, compile=False, whole=whole)
    return environment


def assert_same_life(plain: Environment, other: Environment, exact: bool) -> None:
    tolerance = {"rtol": 0.0, "atol": 0.0} if exact else {"rtol": 1e-4, "atol": 1e-5}
    generator = torch.Generator().manual_seed(0)
    plain.reset(seed=5), other.reset(seed=5)
    ends = 0
    for _ in range(STEPS):
        action = 2.2 * torch.rand(plain.num_envs, plain.action_size, generator=generator) - 1.1
        mine, its = plain.step(action), other.step(action)
        torch.testing.assert_close(its[0], mine[0], **tolerance)
        torch.testing.assert_close(its[1], mine[1], rtol=1e-4, atol=1e-6)
        if plain.multi_agent is not None and other.multi_agent is not None:
            torch.testing.assert_close(other.multi_agent.rewards(), plain.multi_agent.rewards(), rtol=1e-4, atol=1e-6)
        assert torch.equal(its[2], mine[2])
        assert torch.equal(its[3], mine[3])
        assert ("final" in its[4]) == ("final" in mine[4])
        if "final" in mine[4]:
            own, end = mine[4]["final"], its[4]["final"]
            ends += len(own.env_ids)
            assert torch.equal(own.env_ids, end.env_ids)
            assert torch.equal(own.steps, end.steps)
            assert torch.equal(own.success, end.success)
            torch.testing.assert_close(end.observation, own.observation, **tolerance)
            torch.testing.assert_close(end.metrics, own.metrics, **tolerance)
            torch.testing.assert_close(end.rewards, own.rewards, rtol=1e-4, atol=1e-6)
    assert ends > plain.num_envs
    assert plain.world.clock.steps == other.world.clock.steps
    # The one continues where the other stopped: all that they remember is the same.
    torch.testing.assert_close(other.observe(), plain.observe(), **tolerance)
    plain.close(), other.close()


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("action", ["joint_position_relative", "ik_relative"])
def test_a_closed_step_is_the_same_step(whole: bool, action: str) -> None:
    plain, other = (Environment(lift(action=action), 5, BACKEND) for _ in range(2))
    assert_same_life(plain, closed(other, whole), exact=True)


@pytest.mark.parametrize(
    "task",
    [
        "Reach",
        "Cabinet",
        "Velocity-Flat",
        "Handover",
        "Stack-Pyramid",
        "Hockey",
        "Cloth-Dropping",
        "Rope-Reshaping",
        "Soft-Grasp",
        "Soft-Lifting",
        "Soft-Placing",
    ],
)
def test_events_written_for_indices_hold_under_a_mask(task: str) -> None:
    plain, other = (make(task, 3, BACKEND, episode_length=0.2) for _ in range(2))
    other.state.episode_step[:] = plain.state.episode_step[:] = torch.tensor([0, 3, 7])
    assert_same_life(plain, closed(other, whole=True), exact=True)


def test_time_passes_in_resets_of_a_closed_step() -> None:
    plain, other = (make("Hockey", 3, BACKEND, episode_length=0.2, settle_time=0.05) for _ in range(2))
    other.state.episode_step[:] = plain.state.episode_step[:] = torch.tensor([0, 3, 7])
    other._closed = CapturedStep(other, compile=False, whole=False, settles=True)
    assert_same_life(plain, other, exact=True)


def restless() -> VelocityFlat:
    """With all that happens within a step: pushes, late and wrong measurements, a curriculum."""
    task = VelocityFlat(episode_length=0.2, curriculum_enabled=True)
    push = randomize.push("robot", randomize.Range(0.0, 1.0, easy=0.3))
    task.events.push = EventTerm(push, EventTime.INTERVAL, interval=(0.04, 0.1))
    task.events.gains = EventTerm(randomize.gains("robot", *[randomize.Range(0.8, 1.2)] * 2))
    seen = task.observations.policy
    seen.angular_velocity = replace(seen.angular_velocity, delay=(0, 3), bias_std=0.1)
    skill = CurriculumTerm(lambda env: 0.2 - 0.3 * env.state.last_action[:, 0].abs())
    task.curriculum = replace(task.curriculum, skill=skill)
    return task


@pytest.mark.parametrize("whole", [False, True])
def test_what_is_random_within_a_step_is_the_same(whole: bool) -> None:
    plain, other = Environment(restless(), 5, BACKEND), Environment(restless(), 5, BACKEND)
    assert_same_life(plain, closed(other, whole), exact=True)


def test_gains_and_masses_set_between_steps_hold_in_a_captured_step() -> None:
    plain, other = Environment(lift(), 2, BACKEND), closed(Environment(lift(), 2, BACKEND), whole=False)
    action, seen = 0.4 * torch.ones(2, plain.action_size), []
    for environment in (plain, other):
        environment.reset(seed=5)
        robot, cube = environment.world.robots["robot"], environment.world.objects["cube"]
        observations = [leaves_of(environment.step(action)[0])[0] for _ in range(4)]
        soft = torch.tensor([[20.0], [40.0]])
        robot.set_gains(soft, 0.1 * soft, [1])
        observations += leaves_of(environment.step(action)[0])
        cube.set_masses(torch.full((2, 1), 0.5))
        robot.set_gains(2.0 * soft, 0.2 * soft, [3], torch.tensor([0, 1]))
        observations += [leaves_of(environment.step(action)[0])[0] for _ in range(2)]
        seen.append(torch.stack(observations))
        assert environment is plain or other._closed is not None
        environment.close()
    assert torch.equal(seen[0], seen[1])


@pytest.mark.parametrize("wrong", [torch.nan, torch.inf])
@pytest.mark.parametrize("what", ["observation term 'goal'", "reward term 'reach'"])
def test_what_is_not_finite_is_named_by_a_captured_step(what: str, wrong: float) -> None:
    task, poison = lift(), torch.zeros(2)
    if what.startswith("observation"):
        task.observations.policy.goal = ObservationTerm(lambda env: env.commands["goal"] + poison[:, None])
    else:
        task.rewards.reach = RewardTerm(lambda env: poison * 1.0, 1.0)
    environment = closed(Environment(task, 2, BACKEND), whole=False)
    action = torch.zeros(2, environment.action_size)
    for _ in range(3):
        environment.step(action)
    poison[1] = wrong
    with pytest.raises(NonFiniteError, match=f"{what}.* not finite in environment 1"):
        environment.step(action)
    environment.close()


def test_a_compiled_step_is_the_same_step() -> None:
    seen = [LiftObservations(critic=LiftState(history=2, concatenate=False)) for _ in range(2)]
    plain, other = (lift(observations=own) for own in seen)
    assert_same_life(Environment(plain, 5, BACKEND), Environment(other, 5, BACKEND, compile=True), exact=False)


def test_what_looks_at_values_cannot_be_compiled() -> None:
    task = lift()
    task.observations.policy.goal = ObservationTerm(
        lambda env: env.commands["goal"] * float(env.commands["goal"].sum() > 1.0)
    )
    environment = Environment(task, 2, BACKEND, compile=True)
    action = torch.zeros(2, environment.action_size)
    environment.step(action)
    with pytest.raises(ConfigurationError, match=r"cannot be compiled: aten\._local_scalar_dense.*leave compile out"):
        environment.step(action)
    environment.close()


def test_memory_that_is_not_written_in_place_cannot_be_compiled() -> None:
    seen = {"goal": torch.zeros(2, 3)}

    def move_goal(env, env_ids) -> None:
        seen["goal"] = seen["goal"] + 0.1

    task = lift(action="joint_position")
    task.events.place_cube = EventTerm(move_goal)
    environment = Environment(task, 2, BACKEND, compile=True)
    action = torch.zeros(2, environment.action_size)
    environment.step(action)
    environment.state.episode_step[:] = environment.max_episode_steps - 1  # the next step ends in a reset
    with pytest.raises(ConfigurationError, match=r"goal.* is another tensor after each step: write it in place"):
        environment.step(action)
    environment.close()


def test_without_a_compiler_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from torch._inductor import cpp_builder, exc

    def none_found() -> None:
        raise exc.InvalidCxxCompiler

    monkeypatch.setattr(cpp_builder, "get_cpp_compiler", none_found)
    with pytest.raises(ConfigurationError, match=r"C\+\+ compiler.*install g\+\+.*leave compile out"):
        make("Reach", 1, BACKEND, compile=True)


# A pad under a foot, facing down.
_SOLE = Pose.from_euler(np.pi, 0.0, 0.0, (0.0, 0.0, -0.022))


@dataclass(kw_only=True)
class Sensing(VelocityFlat):
    """All that a robot may sense, late, wrong and at rates of their own, and drives that obey late."""

    rate: float = 25.0
    camera: bool = False

    def scene(self) -> Scene:
        noise = Noise(std=0.01, bias_std=0.02)
        origins, directions = grid_pattern((0.4, 0.4), 0.2)
        rays = {"origins": origins, "directions": directions, "pose": Pose((0.0, 0.0, 0.5)), "yaw_only": True}
        scan = RayCasterSpec(name="scan", entity="robot", frame="base", rate=50.0, noise=noise, **rays)
        sensors: list[SensorSpec] = [
            ContactSensorSpec(name=CONTACTS, entity="robot", rate=self.rate),
            ImuSpec(name="imu", entity="robot", frame="base", rate=50.0, delay=0.02, noise=noise),
            JointSensorSpec(name="encoders", entity="robot", rate=100.0, delay=0.01, noise=noise),
            FrameSensorSpec(name="base", entity="robot", frame="base", noise=noise),
            scan,
            TactileSpec(name="pad", entity="robot", frame="LF_FOOT", pose=_SOLE, taxels=(4, 4), rate=50.0, noise=noise),
        ]
        if self.camera:
            view = Pose((0.3, 0.0, 0.1)) @ look_at((0.0, 0.0, 0.0), (1.0, 0.0, -0.5))
            channels = (Channel.RGB, Channel.DEPTH, Channel.SEMANTIC)
            place = {"entity": "robot", "frame": "base", "pose": view}
            sensors.append(CameraSpec(name="camera", width=8, height=6, rate=25.0, channels=channels, **place))
        scene = super().scene()
        robot = scene.robots[0]
        late = tuple(_late(group) for group in robot.actuators)
        return replace(scene, sensors=tuple(sensors), robots=(replace(robot, actuators=late), *scene.robots[1:]))


def _late(group: ActuatorConfig) -> IdealPd:
    return IdealPd(joints=group.joints, stiffness=25.0, damping=0.5, min_delay=0, max_delay=3)


def _read(name: str, *values: str) -> ObservationTerm:
    def read(env: Environment) -> Tensor:
        found = [getattr(env.world.sensors[name], value) for value in values]
        return torch.cat([each.view(len(each), -1).nan_to_num() for each in found], 1)

    return ObservationTerm(read)


def _seen(env: Environment) -> Tensor:
    images: dict[Channel, Tensor] = env.world.sensors["camera"].images  # pyright: ignore[reportAttributeAccessIssue]
    return torch.cat([image.flatten(1).float().clamp(-10.0, 300.0) for image in images.values()], 1)


def sensing(**changes: object) -> Sensing:
    task = Sensing(episode_length=0.2, **changes)  # pyright: ignore[reportArgumentType]
    terms = {
        "imu": _read("imu", "angular_velocity", "linear_acceleration"),
        "encoders": _read("encoders", "positions", "velocities"),
        "forces": _read(CONTACTS, "forces"),
        "frame": _read("base", "pose", "velocity"),
        "scan": _read("scan", "distances", "normals"),
        "pad": _read("pad", "normal_forces", "shear_forces", "slip"),
        **({"camera": ObservationTerm(_seen)} if task.camera else {}),
    }
    fields = [(name, ObservationTerm, term) for name, term in terms.items()]
    group = make_dataclass("Sensed", fields, bases=(ObservationGroup,))
    task.observations = make_dataclass("SensedObservations", [("policy", ObservationGroup)])(group())
    task.terminations.fallen = TerminationTerm(lambda env: env.state.last_action[:, 0] > 0.9)
    return task


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("changes", [{}, {"rate": 12.5}, {"camera": True}])
def test_sensors_and_drives_of_every_kind_are_the_same(whole: bool, changes: dict[str, object]) -> None:
    plain, other = Environment(sensing(**changes), 4, BACKEND), Environment(sensing(**changes), 4, BACKEND)
    assert_same_life(plain, closed(other, whole), exact=True)


def test_a_step_is_captured_once_for_each_phase_of_its_schedule() -> None:
    environment = closed(Environment(sensing(rate=12.5), 3, BACKEND), whole=True)
    for _ in range(20):
        environment.step(torch.zeros(3, environment.action_size))
    assert [part.captured for part in environment._closed.parts] == [4]
    environment.close()


def test_a_schedule_of_too_many_phases_is_named() -> None:
    environment = Environment(sensing(rate=200.0 / 131), 1, BACKEND)
    reason = needs_python(environment.world, environment.actions, environment.task.decimation)
    assert reason.startswith("what is due repeats after 131 steps only")
    environment.close()
