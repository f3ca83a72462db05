"""Runs that must agree bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from orbit_conformance.bodies import cube, pendulum, scene
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability, World
from orbit_core.scene import (
    ContactSensorSpec,
    FrameSensorSpec,
    ImplicitPd,
    ImuSpec,
    JointSensorSpec,
    Pose,
    Scene,
    SensorSpec,
)
from orbit_core.sensors import ContactSensor, FrameSensor, ImuSensor, JointSensor

_STATE = ("joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities")
# Number of physics steps for which a command is held.
_STEPS = 4


def _busy_scene(*sensors: SensorSpec) -> Scene:
    """A driven arm that strikes a cube, on which another cube stands."""
    drive = ImplicitPd(joints=(".*",), stiffness=50.0, damping=5.0)
    arm = pendulum(actuators=(drive,), base=Pose((0.0, 0.0, 0.3)))
    # Impacts and stacked contacts amplify any difference, to be seen within a fraction of a second.
    cubes = (cube("one", pose=Pose((0.3, 0.0, 0.06))), cube("two", pose=Pose((0.35, 0.0, 0.2))))
    return scene(arm, *cubes, sensors=sensors)


def _drive(trial: Trial, world: World, seconds: float, begin: int = 0, numbers: Sequence[int] | None = None) -> None:
    """Commands that depend on the time and the environment's number alone, or on ``numbers`` in its place."""
    given = range(world.num_envs) if numbers is None else numbers
    factors = torch.tensor([[1.0 + number] for number in given], device=world.device)
    for turn in range(begin, begin + trial.steps(seconds) // _STEPS):
        phase = 0.1 * factors * (turn + 1)
        world.robots["pendulum"].set_position_targets(torch.cat((phase.sin(), phase.cos()), -1))
        trial.step(world, _STEPS)


def _state(world: World) -> dict[str, Tensor]:
    state = {name: getattr(world.engine, name).clone() for name in _STATE}
    forces = {name: sensor.forces for name, sensor in world.sensors.items() if isinstance(sensor, ContactSensor)}
    return state | {name: force.clone() for name, force in forces.items()}


def _apart(
    first: Mapping[str, Tensor], second: Mapping[str, Tensor], rows: Sequence[int], others: Sequence[int] | None = None
) -> dict[str, float]:
    """Largest difference of environments ``rows`` of the first from the same, or ``others``, of the second."""
    own, other = list(rows), list(rows if others is None else others)
    return {"difference": max(float((first[name][own] - second[name][other]).abs().max()) for name in first)}


def _the_same_run_twice(trial: Trial) -> Mapping[str, float]:
    worlds = [trial.world(_busy_scene(), num_envs=3) for _ in range(2)]
    for world in worlds:
        _drive(trial, world, 0.6)
    return _apart(_state(worlds[0]), _state(worlds[1]), (0, 1, 2))


def _alone_and_among_seven(trial: Trial) -> Mapping[str, float]:
    """Compare environments 0, 3 and 6 each with a separate world that is given the same commands."""
    among = trial.world(_busy_scene(), num_envs=7)
    _drive(trial, among, 0.6)
    told = _state(among)
    difference = 0.0
    # The first, the middle and the last: batches may be split among threads.
    for number in (0, 3, 6):
        alone = trial.world(_busy_scene())
        _drive(trial, alone, 0.6, numbers=(number,))
        difference = max(difference, _apart(told, _state(alone), (number,), (0,))["difference"])
    return {"difference": difference}


def _beside_a_reset(trial: Trial) -> Mapping[str, float]:
    disturbed, calm = (trial.world(_busy_scene(), num_envs=3) for _ in range(2))
    for world in (disturbed, calm):
        _drive(trial, world, 0.2)
    disturbed.reset(torch.tensor([1], device=disturbed.device))
    for world in (disturbed, calm):
        _drive(trial, world, 0.2, begin=100)
    return _apart(_state(disturbed), _state(calm), (0, 2))


def _reset(trial: Trial) -> Mapping[str, float]:
    """A world that was driven, its objects pushed, and reset agrees with a new world."""
    used, fresh = (trial.world(_busy_scene(), num_envs=2) for _ in range(2))
    _drive(trial, used, 0.3)
    used.robots["pendulum"].set_effort_targets(torch.full((2, 2), 3.0, device=used.device))
    trial.step(used, 3)
    used.reset()
    for world in (used, fresh):
        trial.step(world, trial.steps(0.25))
    return _apart(_state(used), _state(fresh), (0, 1))


def _snapshot(trial: Trial) -> Mapping[str, float]:
    """A snapshot taken during contact is continued twice, with other motion between the two continuations."""
    world = trial.world(_busy_scene(ContactSensorSpec(name="touch", entity="one")), num_envs=3)
    _drive(trial, world, 0.2)
    saved = world.save_state()
    _drive(trial, world, 0.2, begin=50)
    first = _state(world)
    _drive(trial, world, 0.1, begin=99)
    world.reset(torch.tensor([1], device=world.device))
    world.load_state(saved)
    _drive(trial, world, 0.2, begin=50)
    return _apart(first, _state(world), (0, 1, 2))


_SENSORS = (
    ContactSensorSpec(name="touch", entity="one", filters=("two", "terrain")),
    FrameSensorSpec(name="frame", entity="pendulum", frame="link1"),
    ImuSpec(name="imu", entity="two", frame="two"),
    JointSensorSpec(name="joints", entity="pendulum"),
)


def _told(world: World) -> dict[str, Tensor]:
    """The state and the measurements of all sensors."""
    touch, frame, imu, joints = (world.sensors[spec.name] for spec in _SENSORS)
    assert isinstance(touch, ContactSensor)
    assert isinstance(frame, FrameSensor)
    assert isinstance(imu, ImuSensor)
    assert isinstance(joints, JointSensor)
    return _state(world) | {
        "filtered": touch.filtered_forces,
        "pose": frame.pose,
        "velocity": frame.velocity,
        "rate": imu.angular_velocity,
        "acceleration": imu.linear_acceleration,
        "positions": joints.positions,
        "velocities": joints.velocities,
    }


def _every_environment(trial: Trial) -> Mapping[str, float]:
    """Command environment 2 as 0 and 3 as 1; writes to 1 and 3 must leave 0 and 2 unchanged."""
    written, calm = (trial.world(_busy_scene(*_SENSORS), num_envs=4) for _ in range(2))
    # Equal commands in pairs: each environment has a twin to be compared with.
    kinds = (0, 1, 0, 1)
    for world in (written, calm):
        _drive(trial, world, 0.2, numbers=kinds)
    # Writes to some environments only: indices that are mixed up show in the others.
    odd = torch.tensor([1, 3], device=written.device)
    thing, arm = written.objects["two"], written.robots["pendulum"]
    pose = thing.root_pose[odd].clone()
    pose[:, 2] += 0.1
    thing.set_root_pose(pose, odd)
    thing.set_root_velocity(torch.tensor([[0.1, 0.2, 0.3, 1.0, 2.0, 3.0]], device=written.device).repeat(2, 1), odd)
    bent = torch.tensor([[0.1, -0.2]], device=written.device).repeat(2, 1)
    arm.set_joint_state(bent, env_ids=odd)
    for world in (written, calm):
        _drive(trial, world, 0.2, begin=50, numbers=kinds)
    ours, theirs = _told(written), _told(calm)
    untouched = _apart(ours, theirs, (0, 2), (0, 0))["difference"]
    return {"difference": max(untouched, _apart(ours, ours, (1,), (3,))["difference"])}


def _saved_in_passing(trial: Trial) -> Mapping[str, float]:
    """One world is saved after every command, and never loaded."""
    saved, plain = (trial.world(_busy_scene(), num_envs=3) for _ in range(2))
    for turn in range(trial.steps(0.6) // _STEPS):
        for world in (saved, plain):
            _drive(trial, world, _STEPS * trial.time_step, begin=turn)
        saved.save_state()
    return _apart(_state(saved), _state(plain), (0, 1, 2))


def _scenario(
    name: str, question: str, truth: str, run: Callable[[Trial], Mapping[str, float]], need: Capability
) -> Scenario:
    contacts = (Capability.CONTACT_FORCES,) if name in ("snapshot", "every_environment") else ()
    return Scenario(
        name=name,
        group="Repeatability",
        question=question,
        truth=truth,
        source="equality",
        run=run,
        judges=(need,),
        needs=(need, Capability.IMPLICIT_DRIVES, *contacts),
        time_steps=(),
        metrics=(
            Metric(
                name="difference", unit="", tolerance=0.0, meaning="largest of any number of the state, in its SI unit"
            ),
        ),
    )


SCENARIOS = (
    _scenario(
        "same_run_twice", "Does the same run come out the same?",
        "every state of the second run is that of the first", _the_same_run_twice, Capability.DETERMINISTIC,
    ),
    _scenario(
        "alone_and_among_seven", "Does an environment do the same however many there are?",
        "environments 0, 3 and 6 of seven do what they do alone", _alone_and_among_seven, Capability.DETERMINISTIC,
    ),
    _scenario(
        "every_environment", "Are all environments alike, and told and written each for itself?",
        "environments of the same commands have the same states and readings; writing some leaves the others alone",
        _every_environment, Capability.DETERMINISTIC,
    ),
    _scenario(
        "beside_a_reset", "Does the reset of one environment leave the others alone?",
        "they do what they do without it", _beside_a_reset, Capability.DETERMINISTIC,
    ),
    _scenario(
        "life_after_a_reset", "Is a reset complete?",
        "an environment that was driven, pushed and reset repeats a fresh one's life", _reset, Capability.DETERMINISTIC,
    ),
    _scenario(
        "snapshot", "Does a saved state continue as it did?",
        "its second continuation is the first", _snapshot, Capability.SNAPSHOTS,
    ),
    _scenario(
        "saved_in_passing", "Does a run go on as it would have without being saved?",
        "a run that is saved after every command is one that never is", _saved_in_passing, Capability.SNAPSHOTS,
    ),
)  # fmt: skip
