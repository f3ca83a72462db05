"""Poses of a robot's links and collision shapes in a posture, and postures of its gripper."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import numpy.typing as npt

from orbit_assets.audit.checks import shape_points
from orbit_assets.decomposition import Convex, convex_shape
from orbit_core.interfaces.layout import gripper_positions, home_positions
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import Articulation, EndEffector, Gripper, Link, Pose, RobotSpec

FloatArray = npt.NDArray[np.float64]


def with_followers(articulation: Articulation, positions: FloatArray) -> FloatArray:
    """Return the positions (..., J) with each follower where its leader puts it."""
    placed = positions.copy()
    for index, joint in enumerate(articulation.movable_joints):
        if joint.mimic is not None:
            leader = articulation.joint_names.index(joint.mimic.joint)
            placed[..., index] = joint.mimic.position(placed[..., leader])
    return placed


def home_posture(spec: RobotSpec) -> dict[str, float]:
    """Return the positions of all movable joints at home, by name.

    Raises:
        ConfigurationError: one is outside its joint's limits.
        UnknownNameError: the home names a joint that the robot lacks.
    """
    return dict(zip(spec.articulation.joint_names, home_positions(spec).tolist(), strict=True))


def gripper_posture(spec: RobotSpec, gripper: Gripper, value: float | tuple[float, ...]) -> dict[str, float]:
    """Return positions of all movable joints by name: home, but for a gripper's own, and what follows them."""
    positions = home_positions(spec).copy()
    for joint, position in gripper_positions(spec, gripper, value).items():
        positions[joint] = position
    placed = with_followers(spec.articulation, positions)
    return dict(zip(spec.articulation.joint_names, placed.tolist(), strict=True))


def frame_pose(spec: RobotSpec, name: str, positions: Mapping[str, float]) -> Pose:
    """Return the pose of a link or named frame in the world, at joint positions (rad, m) by name."""
    frame = spec.articulation.frame(name)
    return spec.pose @ link_poses(spec.articulation, positions)[frame.link] @ frame.pose


def gripping_links(spec: RobotSpec, gripper: Gripper) -> list[Link]:
    """Return the links that are elsewhere with the gripper open than with it closed, those of followers among them."""
    values = (gripper.open_position, gripper.closed_position)
    before, after = (link_poses(spec.articulation, gripper_posture(spec, gripper, value)) for value in values)
    return [link for link in spec.articulation.links if before[link.name] != after[link.name]]


def shapes_in_frame(
    spec: RobotSpec, frame: str, links: Iterable[Link], positions: Mapping[str, float]
) -> list[FloatArray]:
    """Return points (P, 3) of each collision shape of links, in a link or named frame, at joint positions (rad, m) by
    name.
    """
    into, poses = frame_pose(spec, frame, positions).inverse() @ spec.pose, link_poses(spec.articulation, positions)
    clouds = ((link, shape_points(shape)) for link in links for shape in link.collisions)
    return [(into @ poses[link.name]).transform(cloud) for link, cloud in clouds if len(cloud)]


def placed_shapes(spec: RobotSpec, positions: Mapping[str, float]) -> dict[str, list[Convex]]:
    """Collision shapes of each link in the world, meshes as their hulls, at joint positions (rad, m) by name."""
    poses = link_poses(spec.articulation, positions)
    placed = {
        link.name: [convex_shape(shape, spec.pose @ poses[link.name]) for shape in link.collisions]
        for link in spec.articulation.links
    }
    return {name: [shape for shape in shapes if shape is not None] for name, shapes in placed.items()}


def all_shapes(spec: RobotSpec, positions: Mapping[str, float]) -> list[Convex]:
    """Collision shapes of all links in the world, at joint positions (rad, m) by name."""
    return [shape for shapes in placed_shapes(spec, positions).values() for shape in shapes]


def lowest_point(spec: RobotSpec) -> float | None:
    """Return height (m) of the lowest point of all collision shapes at home, in the world; ``None`` where there is
    none.
    """
    return min((float(shape.bounds()[0][2]) for shape in all_shapes(spec, home_posture(spec))), default=None)


def gripping(spec: RobotSpec) -> list[tuple[EndEffector, Gripper]]:
    """Return the end effectors that have a gripper."""
    return [(effector, effector.gripper) for effector in spec.end_effectors if effector.gripper is not None]
