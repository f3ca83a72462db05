"""What callers hand to a world is checked once, before any engine, with the culprit and the remedy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch

from orbit_assets.catalogue import robot
from orbit_assets.objects import box
from orbit_core.backends import backend_names, default_backend
from orbit_core.dynamics.random import RandomStreams
from orbit_core.interfaces import (
    ArgumentError,
    ClosedError,
    ConfigurationError,
    NonFiniteError,
    OrbitError,
    ShapeError,
    UnknownNameError,
    World,
)
from orbit_core.scene import CameraSpec, JointSensorSpec, MarkerSpec, Pose, Scene
from orbit_core.world import simulate

N = 3
CUBE = box("cube", size=(0.1, 0.1, 0.1), mass=0.5, pose=Pose((0.6, 0.0, 0.05)))
SCENE = Scene(
    robots=(robot("franka_panda", name="arm"),),
    objects=(CUBE,),
    sensors=(JointSensorSpec(name="joints", entity="arm"),),
    markers=(MarkerSpec("goal"),),
)
POSE = torch.tensor([0.5, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    world = simulate(SCENE, N, default_backend())
    yield world
    world.close()


BAD_IDS = [
    (torch.tensor([1_000_000]), ArgumentError, "environment 1000000 and there are 3"),
    (torch.tensor([3]), ArgumentError, "environment 3 and there are 3"),
    (torch.tensor([0, -1]), ArgumentError, "environment -1 and there are 3"),
    (torch.tensor([2, 1, 2]), ArgumentError, "environment 2 twice"),
    (torch.tensor([1.0]), ArgumentError, "int64 indices or a bool mask, not torch.float32"),
    (torch.tensor([1], dtype=torch.uint8), ArgumentError, "not torch.uint8"),
    (torch.tensor([[1]]), ShapeError, r"a vector \(n,\), not of shape \(1, 1\)"),
    (torch.ones(2, dtype=torch.bool), ShapeError, r"a mask \(3,\), not of shape \(2,\)"),
    (torch.tensor([1], device="meta"), ArgumentError, "on meta, and the world on cpu"),
    ([1], ArgumentError, "must be a torch tensor, not"),
]


@pytest.mark.parametrize(("env_ids", "error", "message"), BAD_IDS)
def test_environments_that_are_not_there_are_refused(
    world: World, env_ids: Any, error: type[OrbitError], message: str
) -> None:
    before = world.link_poses.clone()
    draws = world.random.save_state()
    calls: list[Callable[[], object]] = [
        lambda: world.reset(env_ids),
        lambda: world.set_gravity(torch.zeros(1, 3), env_ids),
        lambda: world.objects["cube"].set_root_pose(POSE[None], env_ids),
        lambda: world.robots["arm"].set_joint_state(torch.zeros(1, 9), env_ids=env_ids),
        lambda: world.markers["goal"].set_pose(POSE[None], env_ids),
        lambda: world.sensors["joints"].reset(env_ids),
        lambda: world.random.uniform((2,), env_ids=env_ids),
        lambda: world.random.seed(1, env_ids),
    ]
    for call in calls:
        with pytest.raises(error, match=message):
            call()
    assert torch.equal(world.link_poses, before)
    for one, other in zip(world.random.save_state(), draws, strict=True):
        assert torch.equal(one, other)


def test_indices_that_change_after_they_were_found_good_are_looked_at_anew(world: World) -> None:
    env_ids = torch.tensor([1])
    world.reset(env_ids)
    env_ids += 7
    with pytest.raises(ArgumentError, match="environment 8"):
        world.reset(env_ids)


def test_a_mask_stands_for_its_environments_and_takes_their_rows(world: World) -> None:
    world.reset()
    poses = POSE.repeat(N, 1)
    poses[:, 2] = torch.tensor([torch.nan, 0.7, 0.8])
    world.objects["cube"].set_root_pose(poses, torch.tensor([False, True, True]))
    torch.testing.assert_close(world.objects["cube"].root_pose[:, 2], torch.tensor([0.05, 0.7, 0.8]))
    world.reset(torch.tensor([False, True, False]))
    torch.testing.assert_close(world.objects["cube"].root_pose[:, 2], torch.tensor([0.05, 0.05, 0.8]))


def changed(value: torch.Tensor, number: float) -> torch.Tensor:
    value = value.clone()
    value.view(-1)[-1] = number
    return value


def rows(*shape: int) -> torch.Tensor:
    return torch.full((N, *shape), 0.5)


Call = Callable[[World, torch.Tensor], object]
VALUES: dict[str, tuple[Call, torch.Tensor, bool]] = {
    "root pose": (lambda w, v: w.objects["cube"].set_root_pose(v), POSE.repeat(N, 1), False),
    "root velocity": (lambda w, v: w.objects["cube"].set_root_velocity(v), rows(6), False),
    "joint positions": (lambda w, v: w.robots["arm"].set_joint_state(v), rows(9), False),
    "joint velocities": (lambda w, v: w.robots["arm"].set_joint_state(velocities=v), rows(9), False),
    "position targets": (lambda w, v: w.robots["arm"].set_position_targets(v), rows(9), False),
    "velocity targets": (lambda w, v: w.robots["arm"].set_velocity_targets(v), rows(9), False),
    "effort targets": (lambda w, v: w.robots["arm"].set_effort_targets(v), rows(9), False),
    "masses": (lambda w, v: w.objects["cube"].set_masses(v), rows(1), True),
    "centres of mass": (lambda w, v: w.objects["cube"].set_centers_of_mass(v), rows(1, 3), False),
    "friction of 'cube'": (lambda w, v: w.objects["cube"].set_friction(v), rows(1), True),
    "friction of the terrain": (lambda w, v: w.set_terrain_friction(v), rows(), True),
    "wrenches": (lambda w, v: w.objects["cube"].set_wrenches(v), rows(1, 6), False),
    "stiffness": (lambda w, v: w.robots["arm"].set_gains(v, rows(8), list(range(8))), rows(8), True),
    "damping": (lambda w, v: w.robots["arm"].set_gains(rows(8), v, list(range(8))), rows(8), True),
    "gravity": (lambda w, v: w.set_gravity(v), rows(3), False),
    "pose of marker 'goal'": (lambda w, v: w.markers["goal"].set_pose(v), POSE.repeat(N, 1), False),
}


@pytest.mark.parametrize("what", VALUES)
def test_numbers_that_cannot_be_are_refused_with_the_environment(world: World, what: str) -> None:
    call, good, positive = VALUES[what]
    for number in (torch.nan, torch.inf, -torch.inf):
        with pytest.raises(NonFiniteError, match=f"{what}.* of environment 2 is {number}"):
            call(world, changed(good, number))
    with pytest.raises(ArgumentError, match=rf"{what}.* of environment 2 is 1e\+30: give"):
        call(world, changed(good, 1e30))
    if positive:
        with pytest.raises(ArgumentError, match=f"{what}.* of environment 2 is -1: give 0 to"):
            call(world, changed(good, -1.0))
    with pytest.raises(ShapeError, match=f"{what}.* must have shape"):
        call(world, good[:1])
    with pytest.raises(ArgumentError, match=f"{what}.* is a sparse tensor: give .*to_dense"):
        call(world, good.to_sparse())
    with pytest.raises(ArgumentError, match=f"{what}.* is on meta, and the world on cpu"):
        call(world, good.to("meta"))
    with pytest.raises(ArgumentError, match=f"{what}.* must be a torch tensor on cpu, not"):
        call(world, good.numpy())  # pyright: ignore[reportArgumentType]
    with pytest.raises(ArgumentError, match=f"{what}.* must hold real numbers, not torch.complex64"):
        call(world, good.to(torch.complex64))


@pytest.mark.parametrize("what", VALUES)
def test_other_dtypes_and_gradients_work(world: World, what: str) -> None:
    call, good, _ = VALUES[what]
    call(world, good.double())
    call(world, good.clone().requires_grad_())
    world.reset()
    world.step(2)
    assert torch.isfinite(world.link_poses).all()
    assert not world.link_poses.requires_grad


@pytest.mark.parametrize(("scale", "length"), [(0.0, "0"), (0.5, "0.5")])
def test_quaternions_have_length_one(world: World, scale: float, length: str) -> None:
    poses = POSE.repeat(N, 1)
    poses[1, 3:] *= scale
    for call in (world.objects["cube"].set_root_pose, world.markers["goal"].set_pose):
        with pytest.raises(ArgumentError, match=f"environment 1 has a quaternion of length {length}: give"):
            call(poses)


def test_a_moving_link_keeps_a_mass(world: World) -> None:
    with pytest.raises(ArgumentError, match=r"masses of 'cube'.* is 0: give 1e-09 to 1e\+09 kg"):
        world.objects["cube"].set_masses(torch.zeros(N, 1))


@pytest.mark.parametrize("joints", [[99], [-1], [0, 0], ["panda_joint1"], [0.5], 3, torch.tensor([0])])
def test_joints_and_links_are_indices(world: World, joints: Any) -> None:
    arm = world.robots["arm"]
    some = torch.zeros(N, 2 if joints == [0, 0] else 1)
    calls: list[Callable[[], object]] = [
        lambda: arm.set_joint_state(some, joints=joints),
        lambda: arm.set_position_targets(some, joints),
        lambda: arm.set_gains(some, some, joints),
        lambda: arm.set_masses(some + 1.0, joints),
        lambda: arm.jacobian("panda_hand", joints),
    ]
    for call in calls:
        with pytest.raises(ArgumentError, match=r"joints of 'arm'|links of 'arm'"):
            call()


@pytest.mark.parametrize("steps", [0, -1, 1.0, True, None, "1", 10**12])
def test_steps_are_counted_in_whole_numbers(world: World, steps: Any) -> None:
    with pytest.raises(ArgumentError, match="steps must be"):
        world.step(steps)


@pytest.mark.parametrize("seed", [-1, 2**63, 1.5, "one", None, True])
def test_seeds_are_whole_numbers_of_63_bits(seed: Any) -> None:
    streams = RandomStreams(2, 2**63 - 1, torch.device("cpu"))
    with pytest.raises(ArgumentError, match="a seed must be"):
        streams.seed(seed)


def test_the_state_of_another_world_is_refused(world: World) -> None:
    other = simulate(SCENE, N + 1, default_backend())
    with pytest.raises(ArgumentError, match="not one that save_state"):
        world.load_state(other.save_state())
    with pytest.raises(ArgumentError, match="not one that save_state"):
        world.load_state(None)  # pyright: ignore[reportArgumentType]
    other.close()


@pytest.mark.parametrize("name", ["nothing", ["cube"], {}, None])
def test_a_frame_of_no_such_name_is_refused_with_those_that_there_are(world: World, name: Any) -> None:
    with pytest.raises(UnknownNameError, match="frame"):
        world.objects["cube"].frame_pose(name)
    with pytest.raises(KeyError):
        world.objects["cube"].spec.articulation.frame(name)


def test_a_closed_world_says_so_at_every_use() -> None:
    world = simulate(SCENE, 1, default_backend())
    cube, arm, marker, sensor = (
        world.objects["cube"],
        world.robots["arm"],
        world.markers["goal"],
        world.sensors["joints"],
    )
    cube.frame_pose("cube")
    world.close()
    world.close()
    uses: list[Callable[[], object]] = [
        lambda: world.step(),
        lambda: world.reset(),
        lambda: world.native,
        lambda: world.save_state(),
        lambda: world.engine.step(1),
        lambda: cube.root_pose,
        lambda: cube.frame_pose("cube"),
        lambda: cube.set_root_pose(POSE[None]),
        lambda: arm.set_position_targets(torch.zeros(1, 9)),
        lambda: arm.nominal_masses,
        lambda: marker.set_pose(POSE[None]),
        lambda: sensor.reset(),
        lambda: world.random.uniform(()),
    ]
    for use in uses:
        with pytest.raises(ClosedError, match="the world is closed: make another"):
            use()
    assert world.num_envs == 1


def test_worlds_beyond_memory_say_how_many_fit() -> None:
    with pytest.raises(ConfigurationError, match=r"2000000000 environments take .* GiB or more, .* at most \d+ fit"):
        simulate(SCENE, 2_000_000_000, default_backend())
    camera = CameraSpec(name="eye", width=20_000, height=20_000)
    with pytest.raises(ConfigurationError, match=r"GiB of it for the cameras' pictures.*\d+ fit.*smaller pictures"):
        simulate(replace(SCENE, sensors=(camera,)), 1000, default_backend())


@pytest.mark.parametrize("device", ["quantum", "cuda:99", 3.5, 2**80])
def test_devices_that_are_not_there_are_refused(device: Any) -> None:
    with pytest.raises(ConfigurationError, match=r"device .* cannot be used"):
        simulate(SCENE, 1, default_backend(), device=device)


@pytest.mark.parametrize("backend", backend_names())
def test_no_environments_are_a_choice_too(backend: str) -> None:
    world = simulate(Scene(objects=(CUBE,)), 2, backend)
    cube, none = world.objects["cube"], torch.tensor([], dtype=torch.int64)
    world.step()
    before = world.link_poses.clone()
    world.reset(none)
    cube.set_root_pose(torch.zeros(0, 7), none)
    cube.set_masses(torch.zeros(0, 1), env_ids=none)
    cube.set_friction(torch.zeros(0, 1), env_ids=none)
    cube.set_wrenches(torch.zeros(0, 1, 6), env_ids=none)
    assert torch.equal(world.link_poses, before)
    world.close()
