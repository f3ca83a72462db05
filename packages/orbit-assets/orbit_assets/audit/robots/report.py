"""Audit of a catalogue entry: its model, home, motors, hands, stance and origin.

Hands are checked for the direction of their frame and the opening of their fingers, stances for contact with the ground
and support of the centre of mass, motors for limits, armature, gains and the effort that holds the robot at home.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from orbit_assets.audit.checks import (
    Finding,
    Severity,
    check_body,
    check_joints,
    measure_body,
    names_in_short,
    shape_points,
)
from orbit_assets.audit.robots.postures import (
    FloatArray,
    all_shapes,
    frame_pose,
    gripper_posture,
    gripping,
    gripping_links,
    home_posture,
    lowest_point,
    shapes_in_frame,
)
from orbit_assets.catalogue import RobotEntry, robot_info
from orbit_assets.decomposition import Convex, touching_links, within
from orbit_core.actuators.stability import ExplicitGains, unstable_drive
from orbit_core.dynamics.kinematics import mimic_matrix
from orbit_core.dynamics.rigid_body import DriveResponse, RigidBodyModel, drive_responses, workspace_mass_matrices
from orbit_core.interfaces.errors import AssetError, ConfigurationError, UnknownNameError
from orbit_core.interfaces.layout import JointParameters, SceneLayout, actuator_of_joint, gripper_positions
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import link_poses, validate_entity
from orbit_core.scene import EndEffector, Gripper, ImplicitPd, Mesh, MeshCollision, Pose, RobotSpec, Scene

# Metres that are allowed between the lowest and the highest foot.
_LEVEL = 0.005
# Metres from the ground at which a robot may start: beyond, it falls or is pushed up.
_ABOVE, _BELOW = 0.02, 0.002
# Metres above the lowest point within which shapes count as carrying the robot.
_SUPPORT = 0.02
# Metres from the edge of the support at which a centre of mass is near it.
_INSIDE = 0.01


@dataclass(frozen=True)
class StanceReport:
    """Placement of a robot with a free base on the ground, in metres."""

    clearance: float
    """Of the lowest point of all collision shapes above the ground."""
    uneven: float
    """Between the lowest and the highest of its feet or wheels."""
    margin: float
    """From the centre of mass, seen from above, to the nearest edge of the support; negative outside."""


def measure_stance(spec: RobotSpec, home: Mapping[str, float]) -> StanceReport | None:
    """Measure a robot at home; ``None`` where its base is held, or it collides with nothing."""
    points = _points(spec, home)
    if spec.fixed_base or not len(points):
        return None
    lowest = float(points[:, 2].min())
    heights = [frame_pose(spec, name, home).position[2] for name in (*spec.feet, *spec.wheels)]
    carrying = points[points[:, 2] < lowest + _SUPPORT, :2]
    return StanceReport(
        lowest, max(heights) - min(heights) if heights else 0.0, _margin(carrying, _center_of_mass(spec, home)[:2])
    )


def check_stance(spec: RobotSpec, stance: StanceReport) -> Iterator[Finding]:
    """Yield findings on the pose, the feet and the balance."""
    if not spec.feet and not spec.wheels:
        yield Finding(Severity.WARNING, "model", "its base is free, and it names neither feet nor wheels to stand on")
    if stance.clearance > _ABOVE:
        text = f"starts {1e3 * stance.clearance:.0f} mm above the ground and falls: lower its pose, or its home"
        yield Finding(Severity.WARNING, "pose", text)
    if stance.clearance < -_BELOW:
        text = f"starts {-1e3 * stance.clearance:.0f} mm within the ground and is thrown up: raise its pose"
        yield Finding(Severity.FAULT, "pose", text)
    if stance.uneven > _LEVEL:
        text = f"are {1e3 * stance.uneven:.0f} mm from level at home: it tips when it lands"
        yield Finding(Severity.WARNING, "feet", text)
    if stance.margin < 0.0:
        text = f"lies {-1e3 * stance.margin:.0f} mm outside its support at home: it falls over"
        yield Finding(Severity.FAULT, "centre of mass", text)
    elif stance.margin < _INSIDE:
        text = f"lies {1e3 * stance.margin:.0f} mm from the edge of its support at home: it may fall over"
        yield Finding(Severity.WARNING, "centre of mass", text)


def _points(spec: RobotSpec, home: Mapping[str, float]) -> FloatArray:
    """Return the points (P, 3) of all collision shapes, in the world."""
    poses = link_poses(spec.articulation, home)
    clouds = [
        (spec.pose @ poses[link.name]).transform(shape_points(shape))
        for link in spec.articulation.links
        for shape in link.collisions
    ]
    return np.concatenate(clouds) if clouds else np.zeros((0, 3))


def _center_of_mass(spec: RobotSpec, home: Mapping[str, float]) -> FloatArray:
    poses = link_poses(spec.articulation, home)
    centers = [link.mass * (spec.pose @ poses[link.name]).transform(np.asarray(link.center_of_mass))
               for link in spec.articulation.links]  # fmt: skip
    return np.sum(centers, axis=0) / spec.articulation.mass


def _margin(points: FloatArray, place: FloatArray) -> float:
    """Return metres from a place (2,) to the nearest edge of the hull of points (P, 2); negative outside."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(points).equations  # outward normals and offsets
    except (QhullError, ValueError):  # all in one line
        return -float(np.linalg.norm(points - place, axis=1).min())
    return -float((sides[:, :2] @ place + sides[:, 2]).max())


# Metres to either side of the frame within which fingers are searched.
_WIDEST = 0.2
# Free metres at and above which nothing was found on either side.
_NOTHING = 2.0 * _WIDEST - 1e-6
# Half extents (m) along x and z of the probe that is widened along y until it touches the fingers.
_PROBE = (0.004, 0.002)
# Metres: a gripper that opens less has its frame next to its fingers.
_NARROW = 0.005
_ASKEW = np.cos(np.radians(20.0))
# Metres from its link's origin within which a frame's direction has no meaning.
_SHORT = 0.01
# Metres that a finger must move to count.
_STILL = 1e-4


@dataclass(frozen=True)
class HandReport:
    """Measurements of a gripper, in the axes of its end effector's frame."""

    frame: str
    """Name of the end effector's frame."""
    opening: float
    """Metres along y that are free about the frame when it is open."""
    closing: float
    """The same when it is closed."""
    along_y: float
    """Cosine between y and the direction in which the fingers move against each other."""
    overhang: float
    """Metres along z by which the frame is beyond the ends of the fingers when open; negative where they pass it."""

    @property
    def meets_nothing_open(self) -> bool:
        """True if no shape is near the frame along y when the gripper is open: ``opening`` is then no opening."""
        return self.opening >= _NOTHING

    @property
    def meets_nothing_closed(self) -> bool:
        """True if no shape is near the frame along y when the gripper is closed."""
        return self.closing >= _NOTHING


def measure_hand(spec: RobotSpec, effector: EndEffector, gripper: Gripper) -> HandReport:
    """Open and close a gripper, and measure."""
    opened, closed = (
        gripper_posture(spec, gripper, value) for value in (gripper.open_position, gripper.closed_position)
    )
    gaps = [_gap(all_shapes(spec, at), frame_pose(spec, effector.frame, at)) for at in (opened, closed)]
    fingers = shapes_in_frame(spec, effector.frame, gripping_links(spec, gripper), opened)
    overhang = -max((float(points[:, 2].max()) for points in fingers), default=0.0)
    return HandReport(effector.frame, gaps[0], gaps[1], _along_y(spec, effector, opened, closed), overhang)


def check_hand(effector: EndEffector, hand: HandReport) -> Iterator[Finding]:
    """Yield findings on the frame and the opening."""
    if hand.opening < _NARROW:
        text = f"{1e3 * hand.opening:.1f} mm are free about it along y when open: put it between the fingers"
        yield Finding(Severity.WARNING, effector.frame, text)
    if hand.meets_nothing_open:
        yield _nothing_met(effector, hand)
    elif hand.closing > max(hand.opening - 1e-3, 0.0):
        text = (
            f"closing leaves {1e3 * hand.closing:.1f} mm of {1e3 * hand.opening:.1f} mm: are the positions exchanged?"
        )
        yield Finding(Severity.WARNING, effector.frame, text)
    # Fingers of a hand with tips curl: their direction at the frame means nothing.
    if hand.along_y < _ASKEW and not effector.finger_tips:
        angle = np.degrees(np.arccos(np.clip(hand.along_y, -1.0, 1.0)))
        text = f"the fingers move {angle:.0f} degrees from its y: turn the frame, so that they open along y"
        yield Finding(Severity.WARNING, effector.frame, text)


def _nothing_met(effector: EndEffector, hand: HandReport) -> Finding:
    """Return the finding that there are no fingers to the sides of the frame."""
    where = f"the fingers end {1e3 * hand.overhang:.0f} mm short of it" if hand.overhang > 0.0 else "no finger is there"
    near = f"nothing is within {1e3 * _WIDEST:.0f} mm of it along y when"
    if hand.meets_nothing_closed:
        text = f"{near} open or closed, {where}: put it between the fingers"
        return Finding(Severity.WARNING, effector.frame, text)
    return Finding(Severity.NOTE, effector.frame, f"{near} open, {where}: closing brings them to it")


def check_approach(spec: RobotSpec, effector: EndEffector, home: Mapping[str, float]) -> Iterator[Finding]:
    """Find a z axis that leads into the arm: towards the origin of the frame's link, or a bare hand's root."""
    frame = frame_pose(spec, effector.frame, home)
    carrier = spec.articulation.frame(effector.frame).link if effector.arm_joints else spec.articulation.root.name
    out = np.asarray(frame.position) - np.asarray(frame_pose(spec, carrier, home).position)
    if np.linalg.norm(out) > _SHORT and out @ frame.rotation_matrix()[:, 2] < 0.0:
        text = "its z leads back into the arm: turn the frame, so that z is the direction of approach"
        yield Finding(Severity.WARNING, effector.frame, text)


def _gap(shapes: list[Convex], frame: Pose) -> float:
    """Return metres along y, about the frame, that are free of shapes."""
    return sum(_free(shapes, frame, side) for side in (1.0, -1.0))


def _free(shapes: list[Convex], frame: Pose, side: float) -> float:
    """Return metres from the frame along y to one side until something is met, by bisection."""
    low, high = 0.0, _WIDEST
    if not _meets(shapes, frame, side * high):
        return high
    while high - low > 1e-4:
        middle = (low + high) / 2.0
        low, high = (low, middle) if _meets(shapes, frame, side * middle) else (middle, high)
    return low


def _meets(shapes: list[Convex], frame: Pose, reach: float) -> bool:
    x, z = _PROBE
    corners = np.array([(sx * x, y, sz * z) for sx in (-1.0, 1.0) for y in (0.0, reach) for sz in (-1.0, 1.0)])
    probe = Convex(frame.transform(corners))
    return any(within(probe, shape, 0.0) for shape in shapes)


def _along_y(spec: RobotSpec, effector: EndEffector, opened: Mapping[str, float], closed: Mapping[str, float]) -> float:
    """Return the cosine between the fingers' motion, where they are nearest to the frame, and the frame's y."""
    frame = frame_pose(spec, effector.frame, opened).inverse()
    before, after = link_poses(spec.articulation, opened), link_poses(spec.articulation, closed)
    moves: list[FloatArray] = []
    for link in spec.articulation.links:
        clouds = [cloud for shape in link.collisions if len(cloud := shape_points(shape))]
        if not clouds:
            continue
        points = np.concatenate(clouds)
        start, end = (frame.transform((spec.pose @ poses[link.name]).transform(points)) for poses in (before, after))
        nearest = int(np.argmin(np.linalg.norm(start, axis=1)))
        move = end[nearest] - start[nearest]
        if np.linalg.norm(move) > _STILL:
            moves.append(move)
    if not moves:
        return 0.0
    # The direction in which most of the motion is, whichever way each finger goes.
    weight = np.linalg.eigh(sum(np.outer(move, move) for move in moves))
    return float(abs(weight.eigenvectors[1, -1]))


# Hz: a joint of a lower natural frequency is left hanging.
_SLOW = 1.0
# Damping ratios: below the first a joint rings, beyond the second it creeps.
_LOOSE, _STIFF = 0.3, 10.0
# kg m^2 or kg that a joint without armature moves: less is light. Motors reflect more, see MOTOR_TIME.
_LIGHT = 1e-3
# rad or m that a drive may give way at home.
_SAG = 0.02


@dataclass(frozen=True, eq=False)
class JointRow:
    """One movable joint as the scene has it, after its actuator's overrides. Infinite is unlimited."""

    name: str
    """Name of the joint."""
    effort_limit: float
    """N m or N."""
    velocity_limit: float
    """rad/s or m/s."""
    armature: float
    """kg m^2 or kg."""
    stiffness: float
    """N m/rad or N/m of its drive."""
    damping: float
    """N m s/rad or N s/m of its drive."""
    response: DriveResponse | None
    """Response to a position target over the workspace; None without stiffness."""
    load: float
    """Effort (N m or N) that holds it at home against gravity; zero where that is compensated, or the base is free."""


def joint_rows(spec: RobotSpec) -> tuple[JointRow, ...]:
    """Return all joints that follow no other."""
    parameters = _parameters(spec)
    groups = actuator_of_joint(spec)
    responses = {response.joint: response for response in drive_responses(spec)}
    loads = np.zeros(len(spec.articulation.joint_names)) if _floats(spec) else _gravity_loads(spec, parameters)
    return tuple(
        JointRow(
            joint.name,
            float(parameters.effort_limit[index]),
            float(parameters.velocity_limit[index]),
            float(parameters.armature[index]),
            groups[index].stiffness if index in groups else 0.0,
            groups[index].damping if index in groups else 0.0,
            responses.get(joint.name),
            float(loads[index]),
        )
        for index, joint in enumerate(spec.articulation.movable_joints)
        if joint.mimic is None
    )


def check_drives(spec: RobotSpec, rows: tuple[JointRow, ...]) -> Iterator[Finding]:
    """Yield findings on limits, armatures and gains, alike joints together."""
    driven = {spec.articulation.joint_names[index] for index in actuator_of_joint(spec)}
    idle = [row.name for row in rows if row.name not in driven]
    if idle:
        yield Finding(Severity.WARNING, names_in_short(idle), "no actuator drives it: is it meant to swing freely?")
    motors = [row for row in rows if row.name in driven]
    for words, lacking in (
        ("has no effort limit: give the motor's", [row for row in motors if math.isinf(row.effort_limit)]),
        ("has no velocity limit: give the motor's", [row for row in motors if math.isinf(row.velocity_limit)]),
        ("has an effort limit of 0: it cannot move", [row for row in motors if row.effort_limit == 0.0]),
        (
            "has no armature: give the motor's reflected inertia, or with_armature(); without it light links are "
            "thrown about by their own drives",
            [row for row in motors if row.armature == 0.0],
        ),
    ):
        if lacking:
            yield Finding(Severity.WARNING, names_in_short(row.name for row in lacking), words)
    yield from _check_followers(spec)
    for row in motors:
        yield from _check_response(row)
        yield from _check_load(row)


# Followers have no actuator, so that no drive's response would show a light one.
def _check_followers(spec: RobotSpec) -> Iterator[Finding]:
    """Find joints that follow others and move next to nothing: no drive of their own would show it."""
    armature = _parameters(spec).armature
    bare = [
        index
        for index, joint in enumerate(spec.articulation.movable_joints)
        if joint.mimic is not None and armature[index] == 0.0
    ]
    if not bare:
        return
    # Without their mimics, the mass matrix has a row for each follower as well.
    freed = tuple(replace(joint, mimic=None) for joint in spec.articulation.joints)
    matrices = workspace_mass_matrices(replace(spec.articulation, joints=freed), armature=armature.tolist())
    smallest = np.diagonal(matrices, axis1=1, axis2=2).min(axis=0)
    light = [index for index in bare if smallest[index] < _LIGHT]
    if light:
        text = (
            f"follows another joint, moves as little as {min(smallest[light]):.2g} kg m^2 (kg) and has no armature: "
            "an engine that holds it to its leader by a stiff spring may diverge, at any step and gains; give it some "
            "by edit_joints(..., armature=...), for with_armature() leaves followers out"
        )
        yield Finding(Severity.WARNING, names_in_short(spec.articulation.joint_names[index] for index in light), text)


def check_stability(spec: RobotSpec, time_step: float) -> Iterator[Finding]:
    """Find drives that diverge in steps of ``time_step`` (s), and drives that are stiffer than such steps resolve."""
    parameters, groups = _parameters(spec), actuator_of_joint(spec)
    stiffness, damping = np.zeros(len(parameters.damping)), np.zeros(len(parameters.damping))
    implicit = parameters.damping.copy()
    # Implicit drives are stable at any gain; only their damping takes part.
    for index, group in groups.items():
        if not isinstance(group, ImplicitPd):
            stiffness[index], damping[index] = group.stiffness, group.damping
        else:
            implicit[index] += group.damping
    gains = ExplicitGains(stiffness=stiffness, damping=damping, implicit_damping=implicit)
    found = unstable_drive(spec.articulation, gains, parameters.armature, time_step, fixed_base=spec.fixed_base)
    if found is not None:
        text = (
            f"stiffness {found.stiffness:g} and damping {found.damping:g} diverge in steps of {time_step:g} s: at most "
            f"{found.share:.2g} of these gains are stable, or steps of {found.time_step:.2g} s"
        )
        yield Finding(Severity.FAULT, found.joint, text)
    for response in drive_responses(spec):
        # Beyond one radian per step the integrators of all engines add numerical damping.
        if 2.0 * math.pi * response.fastest * time_step > 1.0:
            text = (
                f"its drive swings at up to {response.fastest:.2g} Hz, more than a radian in a step of "
                f"{time_step:g} s: engines damp it further; less stiffness, or more armature"
            )
            yield Finding(Severity.WARNING, response.joint, text)


def _check_response(row: JointRow) -> Iterator[Finding]:
    found = row.response
    if found is None:
        return
    if found.slowest < _SLOW:
        text = f"natural frequency {found.slowest:.2g} to {found.fastest:.2g} Hz is slow"
        yield Finding(Severity.WARNING, row.name, f"{text}: a design has 4 Hz, see designed_drives()")
    ratio = f"damping ratio {found.least_damped:.2g} to {found.most_damped:.2g}"
    if found.least_damped < _LOOSE:
        yield Finding(Severity.WARNING, row.name, f"{ratio}: it rings; 1 is critical")
    elif found.least_damped > _STIFF:
        yield Finding(Severity.WARNING, row.name, f"{ratio}: it creeps to its target; 1 is critical")


def _check_load(row: JointRow) -> Iterator[Finding]:
    load = abs(row.load)
    if load > row.effort_limit:
        text = f"holding home against gravity takes {load:.3g} N m (N), its limit is {row.effort_limit:.3g}"
        yield Finding(Severity.FAULT, row.name, text)
    elif row.stiffness > 0.0 and load / row.stiffness > _SAG:
        text = f"gives way by {load / row.stiffness:.3g} rad (m) at home under gravity: compensate it, or stiffen it"
        yield Finding(Severity.WARNING, row.name, text)


def _parameters(spec: RobotSpec) -> JointParameters:
    return SceneLayout.of(Scene(robots=(spec,))).joint_parameters


def _floats(spec: RobotSpec) -> bool:
    return spec.gravity_compensation or not spec.fixed_base


def _gravity_loads(spec: RobotSpec, parameters: JointParameters) -> FloatArray:
    """Return the efforts (J,) that hold home, with those of followers added to their leaders'."""
    model = RigidBodyModel(spec.articulation, True, dtype=torch.float64)
    root = torch.tensor([[*spec.pose.position, *spec.pose.orientation]], dtype=torch.float64)
    poses = model.kinematics.forward(root, torch.as_tensor(parameters.home)[None])
    return mimic_matrix(spec.articulation).T @ model.gravity_forces(poses)[0].numpy()


TIME_STEP = 0.005
"""Seconds, that of the tasks."""
# Vertices of a colliding hull beyond which contact gets slower and no more accurate.
_MANY_POINTS = 100
# Findings that the check of the motors reports itself, with the actuators' overrides applied.
_OWN = ("effort limit", "velocity limit", "no joint has armature")
# Share of a joint's range from its limit that counts as near.
_NEAR = 0.02


@dataclass(frozen=True, eq=False)
class RobotReport:
    """Result of an audit of a robot."""

    entry: RobotEntry
    """Entry of the catalogue."""
    spec: RobotSpec
    """Robot as it was built."""
    findings: tuple[Finding, ...]
    """Faults, warnings and notes."""
    joints: tuple[JointRow, ...] = ()
    """Limits, gains and loads of the movable joints."""
    hands: tuple[HandReport, ...] = ()
    """Measurements of the grippers."""
    stance: StanceReport | None = None
    """Standing of a robot on feet or wheels; None for others."""

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Findings that would make a simulation wrong, or the robot unusable."""
        return tuple(finding for finding in self.findings if finding.severity is Severity.FAULT)


def audit_robot(name: str, time_step: float = TIME_STEP) -> RobotReport:
    """Check a robot of the catalogue, or a composition of its parts, without an engine.

    Raises:
        UnknownNameError: there is no robot of that name.
        ConfigurationError: the parts cannot be mounted on each other, or the module that builds it cannot be imported.
    """
    entry = robot_info(name)
    return audit_spec(entry, entry.load(), time_step)


def audit_spec(entry: RobotEntry, spec: RobotSpec, time_step: float = TIME_STEP) -> RobotReport:
    """Check a robot against the metadata of its entry. Links that cannot move against each other count as one.

    A robot that every world would reject has one fault, the text of that error, and no measurements.

    Args:
        entry: the catalogue's entry.
        spec: the robot.
        time_step: physics step (s) at which the gains must be stable.
    """
    try:
        validate_entity(spec)
        spec = _merged(spec)
        home = home_posture(spec)
        rows = joint_rows(spec)
        hands = tuple(measure_hand(spec, effector, gripper) for effector, gripper in gripping(spec))
        stance = measure_stance(spec, home)
    except (AssetError, ConfigurationError, UnknownNameError) as error:
        return RobotReport(entry, spec, (Finding(Severity.FAULT, "model", str(error)),))
    findings = (
        *_check_origin(entry, spec),
        *_check_model(spec),
        *_check_home(spec, home),
        *check_drives(spec, rows),
        *check_stability(spec, time_step),
        *_check_hands(spec, home, hands),
        *(check_stance(spec, stance) if stance else ()),
        *(Finding(Severity.NOTE, "model", note) for note in spec.articulation.notes),
    )
    return RobotReport(entry, spec, findings, rows, hands, stance)


def _merged(spec: RobotSpec) -> RobotSpec:
    return replace(spec, articulation=merge_fixed_links(spec.articulation))


def _check_origin(entry: RobotEntry, spec: RobotSpec) -> Iterator[Finding]:
    for what, told in (("licence", entry.licence or spec.licence), ("source", entry.source or spec.source)):
        if not told.strip():
            yield Finding(Severity.FAULT, "entry", f"names no {what}: nobody knows whether it may be used")
    if not entry.description.strip():
        yield Finding(Severity.WARNING, "entry", "has no description")


def _check_model(spec: RobotSpec) -> Iterator[Finding]:
    articulation = spec.articulation
    for link in articulation.links:
        yield from check_body(link, measure_body(link))
    for finding in check_joints(articulation):
        if not any(words in finding.text for words in _OWN):
            yield finding
    heavy = [
        link.name
        for link in articulation.links
        for shape in link.collisions
        if isinstance(shape.geometry, Mesh)
        and shape.geometry.collision is MeshCollision.CONVEX_HULL
        and len(shape.geometry.vertices) > _MANY_POINTS
    ]
    if heavy:
        text = f"collides by hulls of more than {_MANY_POINTS} points: simplify_collisions() makes contact faster"
        yield Finding(Severity.WARNING, names_in_short(dict.fromkeys(heavy)), text)


def _check_home(spec: RobotSpec, home: Mapping[str, float]) -> Iterator[Finding]:
    articulation = spec.articulation
    touching = [f"{first} with {second}" for first, second in touching_links(articulation, home)]
    if touching:
        acts = articulation.self_collisions
        text = "touch at home that no joint connects" + (
            ": without_home_contacts() takes such pairs out"
            if acts
            else ", which do not collide: self_collisions is off"
        )
        yield Finding(Severity.FAULT if acts else Severity.NOTE, names_in_short(touching), text)
    # A gripper opens to its limits: at its limit at home is where its fingers belong.
    fingers = {index for _, hand in gripping(spec) for index in gripper_positions(spec, hand, hand.open_position)}
    near = [
        joint.name
        for index, joint in enumerate(articulation.movable_joints)
        if joint.mimic is None
        and index not in fingers
        and joint.upper_limit > joint.lower_limit
        and min(home[joint.name] - joint.lower_limit, joint.upper_limit - home[joint.name])
        # A range of more than a turn counts as one turn.
        < _NEAR * min(joint.upper_limit - joint.lower_limit, 6.3)
    ]
    if near:
        yield Finding(Severity.NOTE, names_in_short(near), "is at its limit at home: it can move one way only")
    lowest = lowest_point(spec)
    if spec.fixed_base and spec.has_arm and lowest is not None and lowest < -0.01:
        text = f"reaches {-1e3 * lowest:.0f} mm below the ground at home: raise its pose, or mount it on a table"
        yield Finding(Severity.WARNING, "pose", text)


def _check_hands(spec: RobotSpec, home: Mapping[str, float], hands: tuple[HandReport, ...]) -> Iterator[Finding]:
    for effector in spec.end_effectors:
        yield from check_approach(spec, effector, home)
    for (effector, _), hand in zip(gripping(spec), hands, strict=True):
        yield from check_hand(effector, hand)
