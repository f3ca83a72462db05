"""A catalogue entry audited: its model, home, motors, hands, stance and origin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from orbit_assets.audit.bodies import check_body, measure_body
from orbit_assets.audit.findings import Finding, Severity, names_in_short
from orbit_assets.audit.joints import check_joints
from orbit_assets.audit.robots.drives import JointRow, check_drives, check_stability, joint_rows
from orbit_assets.audit.robots.ground import StanceReport, check_stance, measure_stance
from orbit_assets.audit.robots.hands import HandReport, check_approach, check_hand, measure_hand
from orbit_assets.audit.robots.postures import gripping, home_posture, lowest_point
from orbit_assets.self_contacts import touching_links
from orbit_core.interfaces.errors import AssetError, ConfigurationError, UnknownNameError
from orbit_core.interfaces.layout import gripper_positions
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate_entity
from orbit_core.robots import RobotEntry, robot_info
from orbit_core.scene import Mesh, MeshCollision, RobotSpec

TIME_STEP = 0.005
"""Seconds, that of the tasks."""
_MANY_POINTS = 100
"""Vertices of a hull that collides, beyond which it costs more than it tells."""
_OWN = ("effort limit", "velocity limit", "no joint has armature")
"""What the check of the motors tells itself, with the actuators' overrides."""
_NEAR = 0.02
"""Share of a joint's range from its limit that counts as near."""


@dataclass(frozen=True, eq=False)
class RobotReport:
    """What an audit of a robot found."""

    entry: RobotEntry
    spec: RobotSpec
    findings: tuple[Finding, ...]
    joints: tuple[JointRow, ...] = ()
    hands: tuple[HandReport, ...] = ()
    stance: StanceReport | None = None

    @property
    def faults(self) -> tuple[Finding, ...]:
        """Those findings that would make a simulation wrong, or the robot unusable."""
        return tuple(finding for finding in self.findings if finding.severity is Severity.FAULT)


def audit_robot(name: str, time_step: float = TIME_STEP) -> RobotReport:
    """Check a robot of the catalogue, or a composition of its parts, without an engine.

    Raises:
        UnknownNameError: there is none of that name.
        ConfigurationError: the parts cannot be mounted on each other, or the module that builds it cannot be imported.
        AssetError: its model cannot be had.
    """
    entry = robot_info(name)
    return audit_spec(entry, entry.load(), time_step)


def audit_spec(entry: RobotEntry, spec: RobotSpec, time_step: float = TIME_STEP) -> RobotReport:
    """Check a robot against what its entry says. Links that cannot move against each other count as one.

    A robot that no world would take has one fault, in the words of the error, and nothing else is measured.
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
    fingers = {index for _, hand in gripping(spec) for index in gripper_positions(spec, hand, hand.open_position)}
    near = [
        joint.name
        for index, joint in enumerate(articulation.movable_joints)
        if joint.mimic is None
        and index not in fingers
        and joint.upper_limit > joint.lower_limit
        and min(home[joint.name] - joint.lower_limit, joint.upper_limit - home[joint.name])
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
