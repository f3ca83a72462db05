"""Tasks of cloth, rope and solids: grips, other arms, folds that are none, crumpled starts."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from orbit_assets.catalogue import robot
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.mdp import common
from orbit_tasks import cloth, cloth_folding, cloth_spreading
from orbit_tasks.mdp.matter import with_grip_force


@pytest.mark.parametrize(("name", "travel"), [("franka_panda", 1.0), ("ur10_robotiq_2f85", 0.0531)])
def test_a_gripper_that_turns_closes_with_the_force_that_is_asked(name: str, travel: float) -> None:
    """The jaws of a 2F-85 go 42.5 mm each in 0.8 rad: its motor gives force times 53 mm."""
    spec = with_grip_force(robot(name), 15.0)
    gripper = spec.end_effector.gripper
    assert gripper is not None
    groups = [group for group in spec.actuators if group.joints == gripper.joints]
    assert groups[0].effort_limit == pytest.approx(15.0 * travel, rel=0.1)


@pytest.mark.parametrize("backend", ["mujoco", "sapien", "bullet"])
def test_fingers_close_at_their_velocity_limit_on_every_engine(backend: str) -> None:
    """A Panda's go 20 mm in 0.1 s: without their damping 50 N closed them within 40 ms where no limit is enforced."""
    pytest.importorskip(f"orbit_{backend}", reason=f"capability: the backend '{backend}' is not installed")
    environment = make("Rope-Reshaping", 1, backend, seed=0, grip_force=50.0)
    opening = common.GripperOpening(environment.world)
    environment.reset(seed=0)
    robot = environment.world.robots["robot"]
    before, targets = float(opening()), robot.joint_positions.clone()
    targets[:, -2:] = 0.0
    for _ in range(round(0.1 / environment.world.physics_dt)):
        robot.set_position_targets(targets)
        environment.world.step()
    way = 0.04 * (before - float(opening()))
    environment.close()
    assert way == pytest.approx(0.02, rel=0.15), "metres in 0.1 s at 0.2 m/s"


def test_an_arm_whose_fingers_close_on_arcs_lifts_cloth() -> None:
    environment = make("Cloth-Lifting", 1, "mujoco", seed=0, robot="ur10_robotiq_2f85")
    expert = environment.task.expert(environment)
    environment.reset(seed=0)
    for _ in range(150):
        environment.step(expert.compute({})["action"])
    assert environment.task.success(environment).all()
    environment.close()


def test_fingers_rest_on_the_cloth_before_they_close_to_lift_it() -> None:
    """A clone closes them some steps too soon: without the rest, above the cloth."""
    environment = make("Cloth-Lifting", 1, "mujoco", seed=0)
    expert = environment.task.expert(environment)
    environment.reset(seed=0)
    heights: list[float] = []
    while (action := expert.compute({})["action"])[0, -1] > 0.0:
        heights.append(float(common.hand_pose(environment)[0, 2]))
        environment.step(action)
        assert len(heights) < 120, "the fingers never closed"
    environment.close()
    assert max(heights[-15:]) < 0.032, "the fingers touch the cloth with the hand at 31.5 mm"
    assert max(heights) > 0.3


def test_a_hand_lifts_a_soft_block_by_friction_and_hardly_squeezes_it() -> None:
    environment = make("Soft-Lifting", 1, "mujoco", seed=0)
    task = environment.task
    expert = task.expert(environment)
    environment.reset(seed=0)
    assert task.metrics(environment)["squeeze"].abs().max() < 0.01
    for _ in range(140):
        environment.step(expert.compute({})["action"])
    assert task.success(environment).all()
    assert 0.0 < task.metrics(environment)["squeeze"] < 0.08
    environment.close()


def _grasped(robot: str = "franka_panda", **fields: float) -> tuple[float, float, bool]:
    """Largest pressure, final distance to the goal and success of an expert's episode of Soft-Grasp."""
    environment = make("Soft-Grasp", 1, "mujoco", seed=0, robot=robot, **fields)
    task = environment.task
    expert = task.expert(environment)
    environment.reset(seed=0)
    most = 0.0
    for _ in range(200):
        _, _, terminated, *_ = environment.step(expert.compute({})["action"])
        if bool(terminated.any()):
            environment.close()
            return most, float("inf"), False
        found = task.metrics(environment)
        most = max(most, float(found["pressure_pa"]))
    done = float(found["goal_distance_m"]), bool(task.success(environment))
    environment.close()
    return most, *done


@pytest.mark.parametrize("robot", ["franka_panda", "ur10_robotiq_2f85"])
def test_soft_fingers_on_any_gripper_lift_a_fragile_fruit(robot: str) -> None:
    most, away, reached = _grasped(robot)
    assert reached
    assert away < 0.005
    assert 1e4 < most < 3.8e4


def test_fingers_that_close_too_hard_crush_the_fruit() -> None:
    most, _, reached = _grasped(grip_force=25.0)
    assert not reached
    assert most < 3.8e4, "the episode ends where the fruit is crushed"


def test_soft_fingers_need_a_gripper() -> None:
    with pytest.raises(ConfigurationError, match="has no gripper"):
        make("Soft-Grasp", 1, "mujoco", seed=0, robot="ur10")


@pytest.mark.parametrize(
    ("name", "metric", "steps"),
    [
        ("Soft-Stacking", "stack_distance_m", 240),
        ("Soft-Placing", "place_distance_m", 220),
        ("Soft-Dropping", "container_distance_m", 260),
    ],
)
def test_a_hand_puts_a_soft_block_where_it_belongs_and_lets_go(name: str, metric: str, steps: int) -> None:
    environment = make(name, 1, "mujoco", seed=0)
    task = environment.task
    expert = task.expert(environment)
    environment.reset(seed=0)
    assert not task.success(environment).any()
    assert task.metrics(environment)[metric].min() > 0.05
    for _ in range(steps):
        environment.step(expert.compute({})["action"])
    assert task.success(environment).all()
    assert task.metrics(environment)["squeeze"].abs().max() < 0.01, "it has its shape again"
    environment.close()


def test_a_hand_threads_a_soft_ring_onto_a_rod() -> None:
    environment = make("Tower-Of-Hanoi", 1, "mujoco", seed=0)
    task = environment.task
    expert = task.expert(environment)
    environment.reset(seed=0)
    assert task.metrics(environment)["in_order"].max() == 0.0
    for _ in range(350):
        environment.step(expert.compute({})["action"])
    assert task.metrics(environment)["in_order"].min() == 1.0
    environment.close()


def test_a_flat_cloth_is_not_folded() -> None:
    environment = make("Cloth-Folding", 2, "mujoco", seed=0)
    task = environment.task
    environment.reset(seed=0)
    apart = task.metrics(environment)["pair_distance_m"]  # a diagonal, and two halves of one
    torch.testing.assert_close(apart, torch.full_like(apart, 2.0 * 2.0**0.5 * task.size), atol=0.002, rtol=0.0)
    assert not task.success(environment).any()
    environment.close()


def test_a_cloth_begins_crumpled_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ORBIT_CACHE_DIR", str(tmp_path))
    coarse = {"particles": 9, "size": 0.16}
    first, again = (make("Cloth-Spreading", 2, "mujoco", seed=0, **coarse) for _ in range(2))
    assert len(list((tmp_path / "crumpled").iterdir())) == 1
    assert torch.equal(first.state.starts, again.state.starts)
    first.reset(seed=0)
    assert (first.task.metrics(first)["covered"] < 0.9).any()
    before = first.world.deformables["cloth"].positions.clone()
    first.world.step(100)
    assert (first.world.deformables["cloth"].positions - before).norm(dim=2).amax() < 0.01  # it is at rest
    first.close(), again.close()


def test_corners_are_drawn_outwards_whichever_side_of_the_cloth_is_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cloth_spreading, "crumpled", lambda world, name: torch.zeros(1, 81, 3))
    environment = make("Cloth-Spreading", 2, "mujoco", seed=0, particles=9, size=0.16)
    environment.reset(seed=0)
    body = environment.world.deformables["cloth"]
    rest = torch.as_tensor(body.spec.rest_positions, dtype=torch.float32)
    turned = common.turned(torch.tensor([0.7])).expand(2, len(rest), 4)
    # One with its upper side up, one that was turned over, which mirrors it as seen from above.
    mirrored = quat_rotate(turned, torch.stack((rest, rest * torch.tensor([1.0, -1.0, 1.0]))))
    body.set_state(mirrored + torch.tensor(body.spec.pose.position))
    for name in cloth_spreading.STROKES:
        way = (body.key_point(name) - body.key_point("middle"))[:, :2]
        place = cloth_spreading.place_of(name)(environment) - body.key_point("middle")
        torch.testing.assert_close(place[:, :2], cloth_spreading.FURTHER * way, atol=1e-4, rtol=0.0)
    environment.close()


def test_a_hand_that_spreads_a_cloth_leaves_it_on_the_tray(monkeypatch: pytest.MonkeyPatch) -> None:
    # Flat from the start, and never spread enough for the expert: it draws two corners outwards, one after the other.
    monkeypatch.setattr(cloth_spreading, "crumpled", _flat)
    monkeypatch.setattr(cloth_spreading, "DONE", 2.0)
    environment = make("Cloth-Spreading", 2, "mujoco", seed=0)
    expert = environment.task.expert(environment)
    environment.reset(seed=0)
    body, tops = environment.world.deformables["cloth"], []
    for _ in range(280):
        environment.step(expert.compute({})["action"])
        raised = common.hand_pose(environment)[:, 2] > cloth.TRAY + 0.045
        tops.append(torch.where(raised, body.positions[..., 2].amax(1), 0.0))
    assert torch.stack(tops).amax() < cloth.TRAY + 0.025
    assert cloth_spreading.covered(environment).amin() > 0.9
    environment.close()


def _flat(world: World, name: str) -> torch.Tensor:
    rest = torch.as_tensor(world.deformables[name].spec.rest_positions, dtype=torch.float32)
    return (rest + torch.tensor([0.0, 0.0, cloth.TRAY + 0.002]))[None]


@pytest.mark.parametrize(
    ("name", "lead", "pressed"), [("franka_panda", 0.04, 0.001), ("ur10_robotiq_2f85", 0.016, 0.0)]
)
def test_a_cloth_is_folded_at_one_speed_by_fingers_that_the_mat_does_not_jam(
    name: str, lead: float, pressed: float
) -> None:
    """An arm of stiffer drives leads by less, and fingers that close on arcs are not sent below the mat's top."""
    environment = make("Cloth-Folding", 1, "mujoco", robot=name, particles=9)
    world = environment.world
    found = cloth_folding.lead(world), cloth.pressed(world, cloth_folding.PRESSED)
    environment.close()
    assert found == pytest.approx((lead, pressed), abs=2e-4)
