"""Validation of articulations and entities: one tree, in order, of bodies that could exist."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces.errors import ArgumentError, AssetError
from orbit_core.interfaces.layout import home_positions
from orbit_core.interfaces.names import find_name, match_names
from orbit_core.preparation.merge import link_hosts, merge_fixed_links
from orbit_core.preparation.scene_data import check_data
from orbit_core.scene import (
    Articulation,
    Entity,
    HeightField,
    Joint,
    JointType,
    Link,
    LoopJoint,
    LoopType,
    Plane,
    Pose,
    RobotSpec,
)

# Positions, in rad or m, at which a chain's joints are tried: angles that are singular at zero may be sound there
_ELSEWHERE = (0.3, -0.5, 0.7, 0.4, -0.6, 0.2)
# Share of the largest singular value of the joints' unit motions below which they are dependent
_DEPENDENT = 1e-6
# Tolerance as a share of the largest principal moment: published models round their inertias to three digits
_TRIANGLE_TOLERANCE = 1e-3
# Metres by which a loop may be open at home, and radians by which a weld may be turned
_CLOSED = 1e-3
# rad or m: files round home positions, and those that were recorded in a simulation press on soft limits
_HOME_TOLERANCE = 1e-3
_REPAIR = "compute its inertia from its shape, or repair it with ReadOptions(repair=Repair.BALANCE)"
# Most powers of a mimic joint's law beyond the linear term: the most that an engine's constraint takes
_POWERS = 3
# Largest difference of a quaternion's length from 1; written ones have few digits
_UNIT = 1e-3


def link_poses(articulation: Articulation, positions: Mapping[str, float]) -> dict[str, Pose]:
    """Return the pose of each link by name, in the root link's frame.

    ``positions`` are rad or m by joint, zero where not named; followers stand where it puts them, not where their
    leaders would. Links must be in topological order.
    """
    poses = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        moved = _motion(joint, positions.get(joint.name, 0.0))
        poses[joint.child] = poses[joint.parent] @ joint.parent_pose @ moved @ joint.child_pose.inverse()
    return poses


def _motion(joint: Joint, position: float) -> Pose:
    if joint.type is JointType.PRISMATIC:
        x, y, z = joint.axis
        return Pose((position * x, position * y, position * z))
    return Pose.from_axis_angle(joint.axis, position) if joint.movable else Pose()


def check_massless(articulation: Articulation) -> None:
    """Check that the moving links without mass can be simulated. There must be no fixed joints.

    Such a link has no inertia and collides with nothing, it carries links with mass, and the joints on the way to the
    next of these, those with armature left out, move it in independent ways: otherwise some effort would meet no
    inertia at all.

    Raises:
        AssetError: names the link or the joints.
    """
    joint_of = {joint.child: joint for joint in articulation.joints}
    carried = {joint.parent for joint in articulation.joints}
    massless = {link.name for link in articulation.links[1:] if link.mass == 0}
    for link in articulation.links[1:]:
        if link.name in massless:
            if link.name not in carried:
                fault = "moves but has no mass: give it mass and inertia, or fix its joint"
            elif np.any(link.inertia):
                fault = "has an inertia but no mass: give it mass"
            elif link.collisions:
                fault = "collides but has no mass: give it mass and inertia"
            else:
                continue
            raise _error(articulation, f"link '{link.name}' {fault}")
        if link.name in joint_of and joint_of[link.name].parent in massless:
            _check_independent(articulation, _chain(link.name, joint_of, massless))


def _chain(link: str, joint_of: dict[str, Joint], massless: set[str]) -> list[Joint]:
    """Return the joints from the last link with mass, or the root, to ``link``, the outermost first."""
    joints = [joint_of[link]]
    while joints[-1].parent in massless:
        joints.append(joint_of[joints[-1].parent])
    return joints[::-1]


def _check_independent(articulation: Articulation, joints: list[Joint]) -> None:
    free = [joint.armature == 0 for joint in joints]
    if not any(free):
        return
    # Armature gives a joint its own inertia, so that it may depend on others.
    motions = _unit_motions(joints)[:, free]
    values = np.linalg.svd(motions, compute_uv=False)
    if motions.shape[1] > 6 or values[-1] < _DEPENDENT * values[0]:
        names = ", ".join(f"'{joint.name}'" for joint, each in zip(joints, free, strict=True) if each)
        raise AssetError(
            f"'{articulation.name}': joints {names} move link '{joints[-1].child}' in the same way, with no mass "
            "between them: give the links between them mass, or one of the joints armature"
        )


def _unit_motions(joints: list[Joint]) -> npt.NDArray[np.float64]:
    """Return (6, k) velocity and angular velocity that each joint gives the last link, each column of length one."""
    pose = Pose()
    columns: list[npt.NDArray[np.float64]] = []
    for number, joint in enumerate(joints):
        pose = pose @ joint.parent_pose
        axis = pose.rotation_matrix() @ np.asarray(joint.axis)
        position = _ELSEWHERE[number % len(_ELSEWHERE)]
        if joint.type is JointType.PRISMATIC:
            column = np.concatenate((axis, np.zeros(3)))
        else:
            column = np.concatenate((np.cross(pose.position, axis), axis))
        columns.append(column / np.linalg.norm(column))
        pose = pose @ _motion(joint, position) @ joint.child_pose.inverse()
    return np.stack(columns, axis=1)


def validate(articulation: Articulation) -> Articulation:
    """Return the articulation with joint axes of unit length, checked.

    Inertias are checked per rigid body, links joined by fixed joints taken together: a sensor's own entry may be
    rounded beyond physics while the body that carries it is sound. The root may have no mass, as that of a fixed base,
    and so may links between joints (:func:`orbit_core.preparation.validation.check_massless`).

    Raises:
        AssetError: names repeat or are unknown, links form no single tree, are out of order (``sort_links`` of
            orbit-assets sorts them), a number of a shape, joint or link is impossible (:func:`.scene_data.check_data`),
            a mimic is, a drive or home position is of no movable joint, or a body's mass or inertia is impossible.
    """
    try:
        # Another class of error, as an articulation comes from a file more often than from a caller.
        check_data(articulation, f"'{articulation.name}'")
    except ArgumentError as error:
        raise AssetError(str(error)) from None
    check_structure(articulation)
    _check_order(articulation)
    links = set(articulation.link_names)
    for frame in articulation.frames:
        if frame.link not in links:
            raise _error(articulation, f"frame '{frame.name}' is on unknown link '{frame.link}': name a link")
    for first, second in articulation.collision_exclusions:
        for name in (first, second):
            if name not in links:
                raise _error(articulation, f"a collision exclusion names unknown link '{name}': name a link")
    joints = tuple(_checked_joint(articulation, joint) for joint in articulation.joints)
    by_name = {joint.name: joint for joint in joints}
    for joint in joints:
        _check_mimic(articulation, joint, by_name)
    # Loops are checked between rigid bodies, not between the links of the file.
    hosts = link_hosts(articulation) if articulation.loops else {}
    for loop in articulation.loops:
        _check_loop(articulation, loop, hosts)
    _check_drives(articulation)
    articulation = _checked_home(articulation)
    if any(new is not old for new, old in zip(joints, articulation.joints, strict=True)):
        articulation = replace(articulation, joints=joints)
    # A single entry may be rounded beyond physics while the rigid body that carries it is sound.
    merged = merge_fixed_links(articulation)
    check_massless(merged)
    for link in merged.links:
        if link.mass > 0:
            _check_inertia(articulation, link)
    return articulation


def validate_entity(entity: Entity) -> None:
    """Check the entity's articulation, and that a root that is free to move has mass.

    Raises:
        AssetError: as :func:`validate`, the root of a free base has no mass, a loop is open at the home positions, or a
            variant is no single link like the entity's own.
        UnknownNameError: an end effector, a finger tip, a foot or a wheel of a robot names no link or frame, or an end
            effector's arm or gripper or a planar base no joint; names the nearest.
    """
    validate(entity.articulation)
    if isinstance(entity, RobotSpec):
        _check_robot(entity)
    for variant in entity.alternatives[1:]:
        _check_variant(entity, variant)
        validate_entity(replace(entity, articulation=variant, variants=()))
    if entity.articulation.loops:
        _check_closed(entity)
    if not entity.fixed_base and merge_fixed_links(entity.articulation).root.mass <= 0:
        root = entity.articulation.root.name
        raise AssetError(
            f"'{entity.name}': root link '{root}' moves freely but has no mass: give it one or set fixed_base=True"
        )


def _check_robot(robot: RobotSpec) -> None:
    """Refuse end effectors, feet, wheels and a planar base where the robot has nothing of that name."""
    articulation = robot.articulation
    places = {
        "end effector": [effector.frame for effector in robot.end_effectors],
        "finger tip": [tip for effector in robot.end_effectors for tip in effector.finger_tips],
        "foot": robot.feet,
        "wheel": robot.wheels,
    }
    known = (*articulation.link_names, *(frame.name for frame in articulation.frames))
    for what, names in places.items():
        for name in names:
            find_name(name, known, f"{what} frame", f"robot '{robot.name}'")
    for effector in robot.end_effectors:
        match_names(effector.arm_joints, articulation.joint_names, "joint", f"arm of robot '{robot.name}'")
        if effector.gripper:
            match_names(effector.gripper.joints, articulation.joint_names, "joint", f"gripper of robot '{robot.name}'")
    if robot.planar_base is not None:
        for joint in (robot.planar_base.x, robot.planar_base.y, robot.planar_base.yaw):
            find_name(joint, articulation.joint_names, "joint", f"planar base of robot '{robot.name}'")
    if robot.differential_base is not None:
        for joint in (robot.differential_base.left, robot.differential_base.right):
            find_name(joint, articulation.joint_names, "joint", f"differential base of robot '{robot.name}'")


def _check_variant(entity: Entity, variant: Articulation) -> None:
    """Reject a variant that cannot replace the entity's own articulation."""
    own = entity.articulation
    if len(own.links) > 1 or len(variant.links) > 1:
        raise _error(variant, f"'{entity.name}' has variants, which are for single links: join its links")
    if (variant.link_names, variant.frames) != (own.link_names, own.frames):
        raise _error(variant, f"as a variant of '{entity.name}' it needs its link's name and frames: take them over")
    for link in (own.root, variant.root):
        if any(isinstance(shape.geometry, Plane | HeightField) for shape in (*link.collisions, *link.visuals)):
            raise _error(variant, f"'{entity.name}' has variants, which are for solids: use terrain for ground")


def check_structure(articulation: Articulation) -> None:
    """Check that names are unique and that the joints make one tree of all links, in any order.

    Raises:
        AssetError: they do not.
    """
    if not articulation.links:
        raise _error(articulation, "there is no link: describe at least one")
    links = set(articulation.link_names)
    frames = (frame.name for frame in articulation.frames)
    _check_unique(articulation, "links or frames", (*articulation.link_names, *frames))
    _check_unique(articulation, "joints", (joint.name for joint in (*articulation.joints, *articulation.loops)))
    parent_of: dict[str, Joint] = {}
    for joint in articulation.joints:
        for role, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise _error(articulation, f"joint '{joint.name}' names unknown {role} link '{name}': define the link")
        if joint.child in parent_of:
            other = parent_of[joint.child].name
            raise _error(
                articulation,
                f"link '{joint.child}' has two parents, by joints '{other}' and '{joint.name}': remove one joint",
            )
        parent_of[joint.child] = joint
    _check_tree(articulation, parent_of)


def _check_tree(articulation: Articulation, parent_of: dict[str, Joint]) -> None:
    rooted: set[str] = set()
    for link in articulation.link_names:
        path: list[str] = []
        name = link
        while name in parent_of and name not in rooted:
            if name in path:
                cycle = " -> ".join(reversed([*path[path.index(name) :], name]))
                raise _error(articulation, f"links form a cycle, {cycle}: remove one of its joints")
            path.append(name)
            name = parent_of[name].parent
        # Links whose way to the root is known are not followed again: linear time for long chains.
        rooted.update(path)
    roots = [name for name in articulation.link_names if name not in parent_of]
    if len(roots) > 1:
        listed = ", ".join(f"'{name}'" for name in roots)
        raise _error(articulation, f"there are several roots, {listed}: connect them with joints or split the model")


def _check_order(articulation: Articulation) -> None:
    index = {name: position for position, name in enumerate(articulation.link_names)}
    for position, joint in enumerate(articulation.joints):
        if index[joint.child] != position + 1 or index[joint.parent] > position:
            raise _error(
                articulation,
                f"link '{joint.child}' stands out of order: links go parent before child and joints in the order of "
                "their child links, as orbit_assets.compose.sort_links arranges them",
            )


def _check_unique(articulation: Articulation, kind: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise _error(articulation, f"two {kind} share the name '{name}': rename one")
        seen.add(name)


def _checked_joint(articulation: Articulation, joint: Joint) -> Joint:
    if not joint.lower_limit <= joint.upper_limit:
        raise _error(
            articulation,
            f"joint '{joint.name}' has lower limit {joint.lower_limit} above upper limit {joint.upper_limit}: "
            "exchange them",
        )
    if joint.type is JointType.CONTINUOUS and (joint.lower_limit, joint.upper_limit) != (-math.inf, math.inf):
        limits = f"{joint.lower_limit} to {joint.upper_limit}"
        raise _error(articulation, f"joint '{joint.name}' is continuous and has limits, {limits}: make it revolute")
    if joint.type is JointType.FIXED:
        return joint
    length = math.hypot(*joint.axis)
    if length < 1e-9:
        raise _error(articulation, f"joint '{joint.name}' has an axis of zero length: give a direction")
    if abs(length - 1.0) < 1e-9:
        return joint
    x, y, z = joint.axis
    return replace(joint, axis=(x / length, y / length, z / length))


def _check_mimic(articulation: Articulation, joint: Joint, joints: dict[str, Joint]) -> None:
    if joint.mimic is None:
        return
    leader = joints.get(joint.mimic.joint)
    if leader is None:
        fault = "which does not exist"
    elif leader.name == joint.name:
        fault = "itself"
    elif not leader.movable:
        fault = "which is fixed"
    elif leader.mimic is not None:
        fault = f"which itself mimics '{leader.mimic.joint}'"
    elif not joint.movable:
        fault = "though it is fixed itself"
    elif len(joint.mimic.higher_powers) > _POWERS:
        fault = f"with {len(joint.mimic.higher_powers)} higher powers, of which there may be {_POWERS}"
    elif not all(math.isfinite(coefficient) for coefficient in joint.mimic.coefficients):
        fault = "with a multiplier, offset or coefficient that is not finite"
    else:
        return
    raise _error(
        articulation,
        f"joint '{joint.name}' mimics '{joint.mimic.joint}', {fault}: let a movable joint mimic another free one",
    )


def _check_loop(articulation: Articulation, loop: LoopJoint, hosts: dict[str, tuple[str, Pose]]) -> None:
    for name in (loop.first, loop.second):
        if name not in hosts:
            raise _error(articulation, f"loop '{loop.name}' names unknown link '{name}': define the link")
    if not all(math.isfinite(number) for number in (*loop.first_point, *loop.second_point)):
        raise _error(articulation, f"loop '{loop.name}' has a point that is not finite: give finite numbers")
    if not abs(math.hypot(*loop.orientation) - 1.0) < _UNIT:
        raise _error(articulation, f"loop '{loop.name}' has an orientation that is no unit quaternion: give one")
    if hosts[loop.first][0] == hosts[loop.second][0]:
        raise _error(articulation, f"loop '{loop.name}' holds a rigid body to itself: remove it")


def _check_closed(entity: Entity) -> None:
    """Check that every loop is closed at the home positions."""
    articulation = entity.articulation
    positions = dict(zip(articulation.joint_names, home_positions(entity).tolist(), strict=True))
    poses = link_poses(articulation, positions)
    for loop in articulation.loops:
        ends = [poses[loop.first] @ Pose(loop.first_point), poses[loop.second] @ Pose(loop.second_point)]
        apart = math.dist(ends[0].position, ends[1].position)
        if apart > _CLOSED:
            raise AssetError(
                f"'{entity.name}': loop '{loop.name}' is {apart:.3g} m open at the home positions: give home positions "
                "that close it"
            )
        between = poses[loop.first].inverse() @ poses[loop.second]
        turned = _angle(Pose(orientation=loop.orientation).inverse() @ between) if loop.type is LoopType.WELD else 0.0
        if turned > _CLOSED:
            raise AssetError(
                f"'{entity.name}': weld '{loop.name}' is turned by {turned:.3g} rad at the home positions: give home "
                "positions that close it"
            )


def _angle(pose: Pose) -> float:
    return 2.0 * math.atan2(math.hypot(*pose.orientation[1:]), abs(pose.orientation[0]))


def _check_drives(articulation: Articulation) -> None:
    names = articulation.joint_names
    for drive in articulation.drives:
        if drive.joint not in names:
            raise _error(articulation, f"a drive is on '{drive.joint}', which is no movable joint: name one")
        numbers = (drive.stiffness, drive.damping)
        if not (all(math.isfinite(number) and number >= 0 for number in numbers) and drive.effort_limit >= 0):
            raise _error(
                articulation,
                f"the drive on joint '{drive.joint}' has stiffness {drive.stiffness}, damping {drive.damping} and "
                f"effort limit {drive.effort_limit}: give zero or more",
            )
    _check_unique(articulation, "drives", (drive.joint for drive in articulation.drives))


def _checked_home(articulation: Articulation) -> Articulation:
    """Return the articulation with home positions that a file rounds to just beyond their limits at the limits."""
    names = articulation.joint_names
    limits = {joint.name: (joint.lower_limit, joint.upper_limit) for joint in articulation.joints}
    home: list[tuple[str, float]] = []
    for joint, position in articulation.home:
        if joint not in names:
            raise _error(articulation, f"a home position is of '{joint}', which is no movable joint: name one")
        if not math.isfinite(position):
            raise _error(articulation, f"joint '{joint}' has home position {position}: give a finite number")
        # Clipped only where rounding explains it; a position further out is an error of the file.
        within = min(max(position, limits[joint][0]), limits[joint][1])
        home.append((joint, within if abs(within - position) <= _HOME_TOLERANCE else position))
    _check_unique(articulation, "home positions", (joint for joint, _ in articulation.home))
    moved = [
        f"'{joint}' {old:.7g} -> {new:.7g}"
        for (joint, old), (_, new) in zip(articulation.home, home, strict=True)
        if new != old
    ]
    if not moved:
        return articulation
    note = f"home positions just beyond their limits are at the limits: {', '.join(moved)}"
    return replace(articulation, home=tuple(home), notes=(*articulation.notes, note))


def _check_inertia(articulation: Articulation, link: Link) -> None:
    # eigvalsh reads one triangle only, and would not notice the other.
    if not np.allclose(link.inertia, link.inertia.T, rtol=1e-6, atol=1e-12):
        raise _error(articulation, f"link '{link.name}' has an inertia that is not symmetric: make it so")
    small, middle, large = np.linalg.eigvalsh(link.inertia)
    moments = f"principal moments ({small:.3g}, {middle:.3g}, {large:.3g}) kg m^2"
    if small <= 0:
        raise _error(articulation, f"link '{link.name}' has {moments}, not all positive: {_REPAIR}")
    if small + middle < large * (1 - _TRIANGLE_TOLERANCE):
        raise _error(
            articulation,
            f"link '{link.name}' has {moments}, of which one exceeds the sum of the others as no body's can: {_REPAIR}",
        )


def _error(articulation: Articulation, message: str) -> AssetError:
    return AssetError(f"'{articulation.name}': {message}")
