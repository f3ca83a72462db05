"""Links that touch at home are found exactly and taken out of collision, and no others."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orbit_assets.compose import attach
from orbit_assets.decomposition import convex_shape, distance, within, without_home_contacts
from orbit_core.interfaces.errors import ConfigurationError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Joint,
    JointType,
    Link,
    Mesh,
    Plane,
    Pose,
    Shape,
    Sphere,
)

CORNER = 0.1 * math.sqrt(0.5)


def apart(first: Geometry, second: Geometry, place: Pose) -> float:
    one, other = convex_shape(Shape(first), Pose()), convex_shape(Shape(second), place)
    assert one is not None
    assert other is not None
    found = distance(one, other)
    assert distance(other, one) == pytest.approx(found, abs=1e-8)
    assert within(one, other, found + 1e-7)
    assert not found or not within(one, other, found - 1e-7)
    return found


@pytest.mark.parametrize(
    ("first", "second", "place", "truth"),
    [
        (Sphere(0.1), Sphere(0.2), Pose((0.0, 0.4, 0.0)), 0.1),
        (Box((0.1, 0.2, 0.3)), Sphere(0.1), Pose((0.1 + CORNER, 0.2 + CORNER, 0.0)), 0.0),
        (Box((0.1, 0.2, 0.3)), Sphere(0.1), Pose((0.4, 0.6, 0.3)), 0.4),
        (Box((0.1, 0.1, 0.1)), Capsule(0.05, 0.2), Pose((0.0, 0.0, 0.4)), 0.05),
        (Cylinder(0.1, 0.2), Cylinder(0.1, 0.2), Pose((0.25, 0.0, 0.0)), 0.05),
        (Cylinder(0.1, 0.2), Sphere(0.01), Pose((0.1 * 0.6 + 0.3, 0.1 * 0.8 + 0.4, 0.2)), 0.49),
        (Box((0.1, 0.1, 0.1)), Box((0.01, 0.01, 0.01)), Pose(), 0.0),
    ],
)
def test_distances_are_those_of_geometry(first: Geometry, second: Geometry, place: Pose, truth: float) -> None:
    assert apart(first, second, place) == pytest.approx(truth, abs=1e-7)


def test_the_end_of_a_lying_cylinder_meets_the_side_of_a_standing_one_between_all_corners() -> None:
    place = Pose.from_euler(0.0, math.pi / 2, 0.7, (0.5, 0.42, 0.0))
    axis = np.array([math.cos(0.7), math.sin(0.7), 0.0])
    end = sampled_disc(np.array(place.position) - 0.3 * axis, axis, 0.05)
    truth = float(np.linalg.norm(end[:, :2], axis=1).min()) - 0.1
    assert apart(Cylinder(0.1, 0.2), Cylinder(0.05, 0.3), place) == pytest.approx(truth, abs=1e-5)


def sampled_disc(center: np.ndarray, axis: np.ndarray, radius: float) -> np.ndarray:
    """Points (P, 3) all over a disc."""
    across = np.cross(axis, [0.0, 0.0, 1.0])
    up = np.cross(across, axis)
    angle, share = (a.ravel() for a in np.meshgrid(np.linspace(0, 2 * np.pi, 721), np.linspace(0, 1, 101)))
    return center + radius * share[:, None] * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * up)


def test_hulls_of_meshes_are_as_far_apart_as_their_points_say() -> None:
    # Against the distance of a dense sampling of both hulls, which cannot be less than the true one.
    random = np.random.default_rng(0)
    for _ in range(20):
        clouds = random.normal(size=(2, 12, 3)) * 0.1
        clouds[1] += random.normal(size=3) * 0.4
        meshes = [Mesh(cloud, np.array([[0, 1, 2]])) for cloud in clouds]
        found = apart(*meshes, Pose())
        weights = random.dirichlet(np.full(12, 0.15), size=(2, 4000))
        inside = np.einsum("swp,spc->swc", weights, clouds)
        sampled = float(np.linalg.norm(inside[0] - inside[1], axis=1).min())
        assert found <= sampled + 1e-9
        separated = linear_program_separates(*clouds)
        assert (found > 1e-6) == separated


def linear_program_separates(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether no point is a convex combination of both clouds (P, 3)."""
    from scipy.optimize import linprog

    equal = np.block([[first.T, -second.T], [np.ones((1, len(first))), np.zeros((1, len(second)))],
                      [np.zeros((1, len(first))), np.ones((1, len(second)))]])  # fmt: skip
    found = linprog(np.zeros(equal.shape[1]), A_eq=equal, b_eq=[0, 0, 0, 1, 1], bounds=(0, None))
    return found.status == 2


def finger(**changes: Any) -> Articulation:
    """Three bars in a row, each 0.2 m long, hinged to the one before it, and colliding a little beyond its hinges."""
    shape = Shape(Box((0.11, 0.02, 0.02)), Pose((0.1, 0.0, 0.0)))
    bars = tuple(Link(f"bar{i}", 0.1, (0.1, 0.0, 0.0), np.eye(3) * 1e-3, (shape,)) for i in range(3))
    place = Pose((0.2, 0.0, 0.0))
    joints = tuple(
        Joint(f"hinge{i}", JointType.REVOLUTE, f"bar{i}", f"bar{i + 1}", place, axis=(0.0, 0.0, 1.0),
              lower_limit=-3.0, upper_limit=3.0)
        for i in range(2)
    )  # fmt: skip
    return replace(Articulation("finger", bars, joints, self_collisions=True), **changes)


def test_only_what_touches_at_home_is_taken_out_and_noted() -> None:
    straight = finger()
    assert without_home_contacts(straight, {}) is straight
    bent = without_home_contacts(finger(), {"hinge.*": 2.5})
    assert bent.collision_exclusions == (("bar0", "bar2"),)
    assert bent.notes == ("links that touch each other at home do not collide: bar0 with bar2",)
    assert without_home_contacts(bent, {"hinge.*": 2.5}) is bent


def test_links_that_fixed_joints_connect_count_as_one() -> None:
    model = finger()
    pad = Link("pad", 0.01, inertia=np.eye(3) * 1e-6, collisions=(Shape(Sphere(0.03)),))
    hung = Joint("glue", JointType.FIXED, "bar2", "pad", Pose((-0.2, 0.0, 0.05)))
    model = replace(model, links=(*model.links, pad), joints=(*model.joints, hung))
    assert without_home_contacts(model, {}).collision_exclusions == (("bar0", "bar2"),)


def test_ground_is_no_part_of_a_robot_that_touches_itself() -> None:
    assert convex_shape(Shape(Plane()), Pose()) is None


def test_a_home_beyond_limits_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="'hinge0' of 'finger' is outside of its limits"):
        without_home_contacts(finger(), {"hinge0": 4.0})


def test_a_part_that_does_not_collide_with_itself_does_not_when_a_hand_that_does_is_attached() -> None:
    arm = finger(self_collisions=False)
    both = attach(arm, finger(), "bar2", Pose((0.2, 0.0, 0.0)), prefix="hand_")
    assert both.self_collisions
    assert set(both.collision_exclusions) == {("bar0", "bar1"), ("bar0", "bar2"), ("bar1", "bar2")}
    assert attach(finger(), finger(), "bar2", prefix="hand_").collision_exclusions == ()
    assert attach(arm, arm, "bar2", prefix="hand_").collision_exclusions == ()
