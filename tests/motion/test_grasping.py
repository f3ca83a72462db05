"""Grasp candidates have their points in both friction cones and the hand outside; the best plan lifts the thing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_assets.objects import box
from orbit_core.actions import JointPositionConfig
from orbit_core.dynamics.transforms import quat_to_matrix
from orbit_core.interfaces import ArgumentError, ConfigurationError, PlanningError
from orbit_core.scene import Box, Cylinder, Geometry, Plane, Pose, Shape, Sphere, single_link
from orbit_motion.grasping import GraspConfig, GraspPlanner, HandBoxes, grasp_candidates, surface_of, surface_of_cloud
from orbit_motion.planning import PlannerConfig, StillWorld
from tests.motion.servo_world import BACKENDS, Held, held

UP = torch.tensor([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def hand() -> HandBoxes:
    return HandBoxes.of(catalogue_robot("franka_panda"))


def link_of(geometry: Geometry):
    return single_link("thing", Shape(geometry), 1.0, np.eye(3)).links[0]


def test_the_hand_opens_as_wide_as_its_maker_says(hand: HandBoxes) -> None:
    assert hand.opening == pytest.approx(0.08, abs=2e-3)  # Franka Emika's data sheet: 80 mm


@pytest.mark.parametrize("geometry", [Box((0.02, 0.03, 0.05)), Sphere(0.03), Cylinder(0.025, 0.06)])
def test_candidates_are_force_closures_around_the_thing(hand: HandBoxes, geometry: Geometry) -> None:
    surface = surface_of(link_of(geometry))
    found = grasp_candidates(surface, hand, GraspConfig(friction=0.4), UP)
    assert len(found) > 20
    assert (found.scores[1:] <= found.scores[:-1]).all()
    axis = torch.nn.functional.normalize(found.contacts[:, 1] - found.contacts[:, 0], dim=1)
    torch.testing.assert_close(quat_to_matrix(found.poses[:, 3:])[:, :, 1], axis, atol=1e-5, rtol=0.0)
    for end, sign in ((0, -1.0), (1, 1.0)):
        nearest = torch.cdist(found.contacts[:, end], surface.points).argmin(1)
        cosine = sign * (surface.normals[nearest] * axis).sum(1)
        assert (cosine >= math.cos(math.atan(0.4)) - 1e-5).all(), "within the friction cone"
    assert (found.widths < hand.opening).all()


def test_a_box_is_taken_across_its_faces_from_above(hand: HandBoxes) -> None:
    best = grasp_candidates(surface_of(link_of(Box((0.02, 0.06, 0.05)))), hand, up=UP)
    assert best.widths[0].item() == pytest.approx(0.04, abs=1e-3)  # the one side that fits
    approach = quat_to_matrix(best.poses[:1, 3:])[0, :, 2]
    assert approach[2] < -0.8


def test_a_sphere_is_taken_through_its_middle(hand: HandBoxes) -> None:
    best = grasp_candidates(surface_of(link_of(Sphere(0.03))), hand)
    assert torch.linalg.vector_norm(best.poses[0, :3]) < 4e-3


def test_a_cloud_has_normals_towards_the_camera(hand: HandBoxes) -> None:
    ball = surface_of(link_of(Sphere(0.05)), 1500)
    eye = torch.tensor([0.5, 0.0, 0.3])
    seen = ball.points[(ball.normals * (eye - ball.points)).sum(1) > 0.0]
    guessed = surface_of_cloud(seen, eye)
    truth = torch.nn.functional.normalize(seen, dim=1)
    assert (guessed.normals * truth).sum(1).quantile(0.05) > 0.97


def test_what_cannot_be_grasped_is_told(hand: HandBoxes) -> None:
    with pytest.raises(ArgumentError, match="no two sides"):
        grasp_candidates(surface_of(link_of(Box((0.2, 0.2, 0.2)))), hand)
    with pytest.raises(ArgumentError, match="finite size"):
        surface_of(link_of(Plane()))
    with pytest.raises(ArgumentError, match="16 or more"):
        surface_of_cloud(torch.zeros(3, 3), torch.zeros(3))
    with pytest.raises(ArgumentError, match="friction"):
        GraspConfig(friction=0.0)
    with pytest.raises(ConfigurationError, match="gripper"):
        HandBoxes.of(catalogue_robot("anymal_c"))


def follow(arm: Held, path: torch.Tensor, closed: bool, seconds: float = 1.0) -> None:
    """Drive straight between the rows of a path, the fingers open or closed."""
    steps, gripper = 40, -1.0 if closed else 1.0
    for number in range(steps):
        place = (number + 1) / steps * (len(path) - 1)
        row = min(int(place), len(path) - 2)
        target = path[row] + (place - row) * (path[row + 1] - path[row])
        arm.robot.set_position_targets(target[None], arm.generator.joints)
        fingers = [j for j in range(len(arm.robot.joint_names)) if j not in arm.generator.joints]
        opening = torch.full((1, len(fingers)), 0.04 if gripper > 0 else 0.0)
        arm.robot.set_position_targets(opening, fingers)
        arm.world.step(round(seconds / steps / 0.002))


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_best_plan_lifts_a_box(backend: str, hand: HandBoxes) -> None:
    thing = box("thing", size=(0.04, 0.08, 0.06), mass=0.1, pose=Pose.from_euler(0.0, 0.0, 0.6, (0.5, 0.1, 0.03)))
    arm = held(JointPositionConfig(), backend, num_envs=1, objects=(thing,), terrain=(Shape(Plane()),))
    surface = surface_of(thing.articulation.links[0])
    candidates = grasp_candidates(surface, hand, up=UP)
    planner = GraspPlanner(arm.world, arm.robot, list(arm.generator.joints))
    plan = next(planner.plans(candidates, arm.world.objects["thing"].root_pose[0]))
    follow(arm, plan.reach, closed=False, seconds=2.0)
    follow(arm, plan.approach, closed=False)
    follow(arm, plan.approach[-1:].expand(2, -1), closed=True)
    follow(arm, plan.lift, closed=True, seconds=1.5)
    assert arm.world.objects["thing"].root_pose[0, 2].item() > 0.03 + 0.12
    arm.world.close()


def test_a_thing_out_of_reach_is_told_with_the_reasons(hand: HandBoxes) -> None:
    arm = held(JointPositionConfig(), BACKENDS[0], num_envs=1)
    candidates = grasp_candidates(surface_of(link_of(Sphere(0.03))), hand, GraspConfig(most=6))
    planner = GraspPlanner(arm.world, arm.robot, list(arm.generator.joints))
    with pytest.raises(PlanningError, match="6 cannot be reached"):
        next(planner.plans(candidates, torch.tensor([3.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0])))
    arm.world.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_given_pose_is_planned_or_refused_with_the_reason(backend: str) -> None:
    """From a copy of the world, which what happens meanwhile does not change."""
    thing = box("thing", size=(0.04, 0.08, 0.06), mass=0.1, pose=Pose((0.5, 0.1, 0.03)))
    wall = box("wall", size=(0.1, 0.4, 0.4), pose=Pose((0.5, -0.35, 0.2)), fixed_base=True)
    arm = held(JointPositionConfig(), backend, num_envs=1, objects=(thing, wall), terrain=(Shape(Plane()),))
    joints = list(arm.generator.joints)
    still = StillWorld.of(arm.world, arm.robot)
    positions = still.robot.joint_positions.clone()
    arm.run(torch.full((len(joints),), 0.3), 200)
    assert (arm.robot.joint_positions - positions).abs().max() > 0.05
    torch.testing.assert_close(still.robot.joint_positions, positions, atol=0.0, rtol=0.0)
    planner = GraspPlanner(still, still.robot, joints, config=PlannerConfig(obstacles=("terrain", "wall")))
    down = torch.tensor([0.5, 0.1, 0.03, 0.0, 1.0, 0.0, 0.0])
    plan = planner.plan(down)
    assert plan.candidate is None
    torch.testing.assert_close(plan.reach[0], positions[0, joints], atol=1e-5, rtol=0.0)
    torch.testing.assert_close(plan.reach[-1], plan.approach[0], atol=1e-5, rtol=0.0)
    for position, reason in (
        ((3.0, 0.0, 0.3), "misses the pose by 2\\.[0-9]+ m"),
        ((0.5, 0.1, -0.02), "open hand would be 0\\.0[0-9]+ m inside 'terrain'"),
        ((0.5, -0.35, 0.3), "inside 'wall'"),
    ):
        with pytest.raises(PlanningError, match=reason):
            planner.plan(torch.cat((torch.tensor(position), down[3:])))
    arm.world.close()


def test_an_infinite_scale_is_refused_when_it_is_given() -> None:
    with pytest.raises(ConfigurationError, match="scale is inf: give a finite number"):
        JointPositionConfig(scale=math.inf)
