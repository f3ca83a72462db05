"""Checks of end effectors: where their frames point, how their fingers move, how far they open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from orbit_assets.audit.findings import Finding, Severity
from orbit_assets.audit.geometry import shape_points
from orbit_assets.audit.robots.postures import (
    FloatArray,
    all_shapes,
    frame_pose,
    gripper_posture,
    gripping_links,
    shapes_in_frame,
)
from orbit_assets.convex import Convex, within
from orbit_core.preparation.validation import link_poses
from orbit_core.scene import EndEffector, Gripper, Pose, RobotSpec

_WIDEST = 0.2
"""Metres to either side of the frame, between which fingers are looked for."""
_NOTHING = 2.0 * _WIDEST - 1e-6
"""Metres that are free where nothing is met on either side."""
_PROBE = (0.004, 0.002)
"""Half extents (m) along x and z of what is widened along y until it touches the fingers."""
_NARROW = 0.005
"""Metres: a gripper that opens less has its frame beside its fingers."""
_ASKEW = np.cos(np.radians(20.0))
_SHORT = 0.01
"""Metres from its link's origin within which a frame's direction tells nothing."""
_STILL = 1e-4
"""Metres that a finger must move to count."""


@dataclass(frozen=True)
class HandReport:
    """What was measured of a gripper, in the axes of its end effector's frame."""

    frame: str
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
    """Findings on the frame and the opening."""
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
    if hand.along_y < _ASKEW and not effector.finger_tips:
        angle = np.degrees(np.arccos(np.clip(hand.along_y, -1.0, 1.0)))
        text = f"the fingers move {angle:.0f} degrees from its y: turn the frame, so that they open along y"
        yield Finding(Severity.WARNING, effector.frame, text)


def _nothing_met(effector: EndEffector, hand: HandReport) -> Finding:
    """The finding that there are no fingers to the sides of the frame."""
    where = f"the fingers end {1e3 * hand.overhang:.0f} mm short of it" if hand.overhang > 0.0 else "no finger is there"
    near = f"nothing is within {1e3 * _WIDEST:.0f} mm of it along y when"
    if hand.meets_nothing_closed:
        text = f"{near} open or closed, {where}: put it between the fingers"
        return Finding(Severity.WARNING, effector.frame, text)
    return Finding(Severity.NOTE, effector.frame, f"{near} open, {where}: closing brings them to it")


def check_approach(spec: RobotSpec, effector: EndEffector, home: Mapping[str, float]) -> Iterator[Finding]:
    """Whether z leads out of the arm: away from the origin of the frame's link, or from a bare hand's root."""
    frame = frame_pose(spec, effector.frame, home)
    carrier = spec.articulation.frame(effector.frame).link if effector.arm_joints else spec.articulation.root.name
    out = np.asarray(frame.position) - np.asarray(frame_pose(spec, carrier, home).position)
    if np.linalg.norm(out) > _SHORT and out @ frame.rotation_matrix()[:, 2] < 0.0:
        text = "its z leads back into the arm: turn the frame, so that z is the direction of approach"
        yield Finding(Severity.WARNING, effector.frame, text)


def _gap(shapes: list[Convex], frame: Pose) -> float:
    """Metres along y, about the frame, that are free of shapes."""
    return sum(_free(shapes, frame, side) for side in (1.0, -1.0))


def _free(shapes: list[Convex], frame: Pose, side: float) -> float:
    """Metres from the frame along y to one side until something is met, by bisection."""
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
    """How much of the fingers' motion, where they are nearest to the frame, is along its y: 1 where all is."""
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
