"""Laws of rotations and rigid transforms."""

from __future__ import annotations

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from orbit_core.dynamics import transforms as tf
from orbit_core.scene import Pose

TOLERANCE = {"atol": 2e-5, "rtol": 1e-5}


def _random(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def _rotations(seed: int, *shape: int) -> Tensor:
    return tf.quat_canonical(_random(seed, *shape, 4))


def _poses(seed: int, *shape: int) -> Tensor:
    return torch.cat((_random(seed + 1, *shape, 3), _rotations(seed, *shape)), -1)


def _same_rotation(a: Tensor, b: Tensor) -> None:
    assert_close(a * (a * b).sum(-1, keepdim=True).sign(), b, **TOLERANCE)


law = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 2**31)


@given(seed=seeds)
@law
def test_products_of_quaternions_are_products_of_matrices(seed: int) -> None:
    a, b, v = _rotations(seed, 16), _rotations(seed + 7, 16), _random(seed + 9, 16, 3)
    product = tf.quat_multiply(a, b)
    assert_close(tf.quat_to_matrix(product), tf.quat_to_matrix(a) @ tf.quat_to_matrix(b), **TOLERANCE)
    assert_close(tf.quat_rotate(product, v), tf.quat_rotate(a, tf.quat_rotate(b, v)), **TOLERANCE)
    assert_close(tf.quat_rotate(a, v), (tf.quat_to_matrix(a) @ v[..., None]).squeeze(-1), **TOLERANCE)
    assert_close(tf.quat_rotate_inverse(a, tf.quat_rotate(a, v)), v, **TOLERANCE)


@given(seed=seeds)
@law
def test_matrices_round_trip(seed: int) -> None:
    q = _rotations(seed, 64)
    assert_close(tf.quat_from_matrix(tf.quat_to_matrix(q)), q, **TOLERANCE)


def test_matrices_of_half_turns_round_trip() -> None:
    axes = torch.cat((torch.eye(3), torch.nn.functional.normalize(torch.tensor([[1.0, 1, 0], [0, -1, 2]]), dim=-1)))
    q = torch.cat((torch.zeros(5, 1), axes), -1)
    _same_rotation(tf.quat_from_matrix(tf.quat_to_matrix(q)), q)


@given(seed=seeds, angle=st.sampled_from([0.0, 1e-8, 1e-4, 0.5, 2.0, 3.1]))
@law
def test_rotation_vectors_round_trip(seed: int, angle: float) -> None:
    vectors = angle * torch.nn.functional.normalize(_random(seed, 16, 3), dim=-1)
    q = tf.quat_from_rotation_vector(vectors)
    assert_close(q.norm(dim=-1), torch.ones(16))
    assert_close(tf.quat_to_rotation_vector(q), vectors, atol=1e-5, rtol=1e-5)
    assert_close(tf.quat_to_rotation_vector(-q), vectors, atol=1e-5, rtol=1e-5)


@given(seed=seeds)
@law
def test_canonical_sign_keeps_the_rotation(seed: int) -> None:
    q = 3.0 * _random(seed, 16, 4)
    canonical = tf.quat_canonical(q)
    assert (canonical[..., 0] >= 0).all()
    assert_close(canonical.norm(dim=-1), torch.ones(16))
    _same_rotation(canonical, q / q.norm(dim=-1, keepdim=True))


@given(seed=seeds)
@law
def test_poses_form_a_group(seed: int) -> None:
    a, b, c = _poses(seed, 8), _poses(seed + 11, 8), _poses(seed + 23, 8)
    left, right = tf.pose_multiply(tf.pose_multiply(a, b), c), tf.pose_multiply(a, tf.pose_multiply(b, c))
    assert_close(left[..., :3], right[..., :3], **TOLERANCE)
    _same_rotation(left[..., 3:], right[..., 3:])
    identity = torch.tensor([0.0, 0, 0, 1, 0, 0, 0]).expand(8, 7)
    assert_close(tf.pose_multiply(a, tf.pose_inverse(a)), identity, **TOLERANCE)
    assert_close(tf.pose_multiply(tf.pose_inverse(a), a), identity, **TOLERANCE)
    points = _random(seed + 5, 8, 3)
    composed = tf.transform_points(tf.pose_multiply(a, b), points)
    assert_close(composed, tf.transform_points(a, tf.transform_points(b, points)), **TOLERANCE)


@given(seed=seeds)
@law
def test_pose_error_takes_one_pose_to_the_other(seed: int) -> None:
    a, b = _poses(seed, 8), _poses(seed + 3, 8)
    error = tf.pose_error(a, b)
    assert_close(a[:, :3] + error[:, :3], b[:, :3], **TOLERANCE)
    turned = tf.quat_multiply(tf.quat_from_rotation_vector(error[:, 3:]), a[:, 3:])
    _same_rotation(turned, b[:, 3:])
    assert_close(tf.quat_distance(a[:, 3:], b[:, 3:]), error[:, 3:].norm(dim=-1), **TOLERANCE)


def test_small_angles_are_told_apart() -> None:
    a = _rotations(4, 16)
    b = tf.quat_multiply(tf.quat_from_rotation_vector(torch.tensor([1e-4, 0.0, 0.0])), a)
    assert_close(tf.quat_distance(a, b), torch.full((16,), 1e-4), atol=2e-6, rtol=0)
    assert_close(tf.quat_distance(a, -b), torch.full((16,), 1e-4), atol=2e-6, rtol=0)


@given(seed=seeds)
@law
def test_scene_poses_agree(seed: int) -> None:
    a, b = _poses(seed, 1)[0], _poses(seed + 1, 1)[0]
    first, second = (Pose(tuple(p[:3].tolist()), tuple(p[3:].tolist())) for p in (a, b))
    product = first @ second
    expected = torch.tensor([*product.position, *product.orientation])
    result = tf.pose_multiply(a, b)
    assert_close(result[:3], expected[:3], **TOLERANCE)
    _same_rotation(result[3:], expected[3:])


@given(roll=st.floats(-3, 3), pitch=st.floats(-1.5, 1.5), yaw=st.floats(-3, 3))
@law
def test_euler_angles_and_heading(roll: float, pitch: float, yaw: float) -> None:
    q = tf.quat_from_euler(torch.tensor(roll), torch.tensor(pitch), torch.tensor(yaw))
    _same_rotation(q, torch.tensor(Pose.from_euler(roll, pitch, yaw).orientation))
    heading = tf.quat_to_rotation_vector(tf.quat_yaw(q))
    assert_close(heading[:2], torch.zeros(2))
    assert math.cos(float(heading[2]) - yaw) > 1 - 1e-4


def test_leading_dimensions_broadcast() -> None:
    q, v = _rotations(0, 5, 1), _random(1, 3, 3)
    assert tf.quat_rotate(q, v).shape == (5, 3, 3)
    assert tf.quat_multiply(q, _rotations(2, 3)).shape == (5, 3, 4)
