"""Peg-In-The-Dark and Gentle-Lift: pads of a gripper, what a policy sees, experts with and without touch."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from orbit_assets.catalogue import robot
from orbit_core.backends import backend, backend_names, check_scene
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.envs import Environment, make
from orbit_core.envs.observation_layout import terms_of_group
from orbit_core.interfaces import ConfigurationError, UnsupportedCapabilityError
from orbit_core.mdp import common
from orbit_tasks import gentle_lift
from orbit_tasks.gentle_lift import GentleLift
from orbit_tasks.mdp import touch
from orbit_tasks.peg_in_the_dark import PegInTheDark


def test_pads_of_a_gripper_face_each_other_where_its_fingers_meet() -> None:
    pads = touch.finger_pads(robot("franka_panda", name="robot"), size=(0.016, 0.018), taxels=(4, 4))
    assert [spec.links for spec in pads.specs] == [("panda_leftfinger",), ("panda_rightfinger",)]
    out, up = (quat_rotate(pads.turns, torch.tensor(axis)) for axis in ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)))
    # The left finger closes along -y of the hand; both pads have up against where the hand points.
    assert torch.allclose(out, torch.tensor([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]), atol=1e-5)
    assert torch.allclose(up, torch.tensor([0.0, 0.0, -1.0]).expand(2, 3), atol=1e-5)
    # At the end of the finger, 4.5 cm out of its own frame, on the plane where the two meet.
    assert pads.specs[0].pose.position == pytest.approx((0.0, 0.0, 0.045), abs=1e-4)
    with pytest.raises(ConfigurationError, match="choose one with a parallel gripper"):
        touch.finger_pads(robot("ur10", name="robot"), size=(0.01, 0.01), taxels=(2, 2))


def test_a_policy_in_the_dark_is_told_a_place_near_the_hole_and_sees_neither_block_nor_board() -> None:
    env = make("Peg-In-The-Dark", 16, "mujoco", seed=0)
    assert isinstance(env.task, PegInTheDark)
    env.reset(seed=0)
    off = env.state.stated - env.world.objects["board"].root_pose[:, :2]
    assert off.abs().max() <= env.task.uncertainty
    assert off.abs().amax(0).min() > 0.5 * env.task.uncertainty
    seen = set(terms_of_group(env.task.observations.policy))
    assert {"stated_place", *touch.PADS} < seen
    assert not {"block_poses", "seats", "offsets", "hand_to_knobs"} & seen
    env.close()


@pytest.mark.parametrize("task", ["Peg-In-The-Dark", "Gentle-Lift"])
def test_touch_may_be_taken_away(task: str) -> None:
    env = make(task, 1, "mujoco", seed=0, touch=False)
    assert not {*touch.PADS} & {*env.world.sensors}
    env.close()


@pytest.mark.skipif("sapien" not in backend_names(), reason="needs orbit-sapien")
@pytest.mark.parametrize("task", [PegInTheDark, GentleLift])
def test_an_engine_without_forces_of_friction_refuses_shear(task: type) -> None:
    with pytest.raises(UnsupportedCapabilityError, match="contact forces with those of friction"):
        check_scene(backend("sapien"), task().scene())
    if task is PegInTheDark:
        check_scene(backend("sapien"), task(touch=False).scene())


def finished(task: str, num_envs: int, touches: bool) -> Environment:
    """Return an environment whose expert has acted for an episode."""
    env = make(task, num_envs, "mujoco", seed=0, touch=touches)
    expert = env.expert()
    env.reset(seed=0)
    for _ in range(env.max_episode_steps - 1):
        env.step(expert.compute({})["action"])
    return env


def test_a_block_finds_its_hole_by_touch_and_not_without() -> None:
    env = finished("Peg-In-The-Dark", 2, True)
    assert env.task.success(env).all()
    env.close()
    env = finished("Peg-In-The-Dark", 2, False)
    assert not env.task.success(env).any()
    env.close()


def test_boxes_of_all_weights_are_lifted_by_a_grip_that_slip_tightens() -> None:
    env = finished("Gentle-Lift", 3, True)
    assert env.task.success(env).all()
    mass, grip = env.state.mass, gentle_lift.grip_force(env)
    assert float(mass.max() / mass.min()) > 2.0
    # Each finger presses with 1.3 to 2 times what its friction, of coefficient 1, needs for half of the weight.
    ratio = grip / (0.5 * 9.81 * mass)
    assert torch.allclose(ratio, gentle_lift.grip_ratio(env))
    assert (ratio > 1.2).all()
    env.close()


@pytest.mark.parametrize(("shears", "slips"), [((0.9, 0.0), False), ((0.9, 0.9), True), ((0.2, 0.2), False)])
def test_a_box_slips_where_both_pads_are_at_their_limit(
    shears: tuple[float, float], slips: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Rigid bodies leave undetermined how a weight is shared between two pads: an engine may hang it on one.
    pads = [
        SimpleNamespace(normal_forces=torch.ones(1, 4, 4), shear_forces=torch.full((1, 4, 4, 2), each / 2**0.5))
        for each in shears
    ]
    monkeypatch.setattr(gentle_lift.touch, "sensors", lambda world: pads)
    grip, apart, near = gentle_lift.touched(cast(Any, SimpleNamespace(world=None)))
    assert (float(grip), bool(apart), bool(near)) == (16.0, False, slips)


def test_a_fixed_grip_drops_heavy_boxes_and_squeezes_light_ones() -> None:
    env = finished("Gentle-Lift", 6, False)
    mass, up = env.state.mass, gentle_lift.raised(env) > 0.05
    ratio = gentle_lift.grip_ratio(env)
    assert not up[mass > 0.9].any()
    assert (ratio[mass < 0.3] > 2.5).all()
    assert not env.task.success(env).all()
    env.close()


def test_a_grip_is_what_the_last_component_of_the_action_sets() -> None:
    env = make("Gentle-Lift", 2, "mujoco", seed=0)
    action = torch.zeros(2, env.actions.size)
    action[:, -1] = torch.tensor([0.0, -0.25])
    for _ in range(40):
        env.step(action)
    fingers = env.world.robots[common.ROBOT].joint_positions[:, -2]
    assert fingers.tolist() == pytest.approx([0.04, 0.03], abs=1e-3)
    env.close()


def test_masses_and_bounds_out_of_range_are_refused() -> None:
    for fields in ({"masses": (1.0, 0.5)}, {"masses": (0.0, 1.0)}, {"most_grip": 0.5}, {"height": 1.0}):
        with pytest.raises(ConfigurationError, match=f"field '{next(iter(fields))}' of task GentleLift"):
            GentleLift(**fields).scene()  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match="field 'uncertainty' of task PegInTheDark"):
        PegInTheDark(uncertainty=0.1).scene()
    with pytest.raises(ConfigurationError, match="has 2 shapes: give one"):
        PegInTheDark(shapes=("square", "round")).scene()
