"""Joints and motors of file formats as a scene describes them.

* A joint of several degrees of freedom is a chain of simple ones, with links between them that have no mass. A ball
  joint is three revolute joints about x, y and z of the joint's frame, in that order: the orientation of the child is
  ``R_x(a) R_y(b) R_z(c)``, which is singular at ``b = +-pi/2``, as any three angles are somewhere.
* A joint that mimics a mimic follows that one's leader.
* A general actuator of MJCF is a spring and a damper with an effort limit, where its law is one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from orbit_core.scene import Articulation, Joint, JointType, Link, Mimic, Pose
from orbit_core.scene.pose import Vector3

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Freedom:
    """One degree of freedom of a compound joint: its axis in the joint's frame, and its limits in rad or m.

    ``suffix`` is appended to the joint's name to name the simple joint.
    """

    suffix: str
    type: JointType
    """Rotation or translation."""
    axis: Vector3
    """Unit vector in the joint's frame."""
    lower_limit: float = -math.inf
    """rad or m."""
    upper_limit: float = math.inf
    """rad or m."""


BALL = (
    Freedom("rx", JointType.CONTINUOUS, _X),
    Freedom("ry", JointType.CONTINUOUS, _Y),
    Freedom("rz", JointType.CONTINUOUS, _Z),
)
"""Rotation about the origin of the joint's frame."""
PLANAR = (
    Freedom("tx", JointType.PRISMATIC, _X),
    Freedom("ty", JointType.PRISMATIC, _Y),
    Freedom("rz", JointType.CONTINUOUS, _Z),
)
"""Motion in the plane whose normal is z of the joint's frame; turn ``parent_pose`` and ``child_pose`` for another."""
FLOATING = (
    Freedom("tx", JointType.PRISMATIC, _X),
    Freedom("ty", JointType.PRISMATIC, _Y),
    Freedom("tz", JointType.PRISMATIC, _Z),
    *BALL,
)
"""Any motion."""


def compound(joint: Joint, freedoms: Sequence[Freedom]) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """Build the massless links and simple joints, in order, that together move ``joint``'s child by ``freedoms``.

    ``joint`` gives everything but type, axis and limits: its frames, and the efforts, damping, friction, armature and
    stiffness that each of the simple joints gets. Its links stay as they are. Without a freedom it is a fixed joint.

    Args:
        joint: between the two links that the compound joint connects.
        freedoms: the outermost, which moves all others, first.
    """
    if not freedoms:
        return (), (replace(joint, type=JointType.FIXED),)
    return chain(
        [
            replace(
                joint,
                name=f"{joint.name}_{freedom.suffix}",
                type=freedom.type,
                axis=freedom.axis,
                lower_limit=freedom.lower_limit,
                upper_limit=freedom.upper_limit,
            )
            for freedom in freedoms
        ]
    )


def chain(joints: Sequence[Joint]) -> tuple[tuple[Link, ...], tuple[Joint, ...]]:
    """Chain joints that act one after another between the same two links, with massless links between them.

    Every joint is given as if it were the only one between the links; the first moves all others along. Where all are
    at zero the child stands where the first of them places it. The link after joint ``a`` is called ``a_link`` and
    its frame is the joint's.

    Args:
        joints: one or more, the outermost first, of one ``parent`` and one ``child``.
    """
    links: list[Link] = []
    linked: list[Joint] = []
    parent, parent_pose = joints[0].parent, joints[0].parent_pose
    for joint, following in itertools.pairwise(joints):
        link = Link(f"{joint.name}_link")
        links.append(link)
        linked.append(replace(joint, parent=parent, child=link.name, parent_pose=parent_pose, child_pose=Pose()))
        # With all joints at zero, the next joint's frame stands in the child as its own ``child_pose`` says.
        parent, parent_pose = link.name, joint.child_pose.inverse() @ following.child_pose
    return tuple(links), (*linked, replace(joints[-1], parent=parent, parent_pose=parent_pose))


def resolve_chains(articulation: Articulation) -> Articulation:
    """Make joints that mimic a mimic follow its leader, by the composed law.

    Laws with higher powers, circles, and leaders that do not exist are left as they are, for validation to name.
    """
    joints = {joint.name: joint for joint in articulation.joints}
    resolved = tuple(_resolved(joint, joints) for joint in articulation.joints)
    changed = [f"'{new.name}'" for old, new in zip(articulation.joints, resolved, strict=True) if new is not old]
    if not changed:
        return articulation
    note = f"joints that mimic a mimic follow its leader instead: {', '.join(changed)}"
    return replace(articulation, joints=resolved, notes=(*articulation.notes, note))


def _resolved(joint: Joint, joints: dict[str, Joint]) -> Joint:
    law, met = joint.mimic, {joint.name}
    while law is not None:
        leader = joints.get(law.joint)
        if leader is None or leader.name in met or not law.linear:
            return joint
        if leader.mimic is None or not leader.mimic.linear:
            break
        met.add(leader.name)
        offset = law.multiplier * leader.mimic.offset + law.offset
        law = Mimic(leader.mimic.joint, law.multiplier * leader.mimic.multiplier, offset)
    return joint if law is joint.mimic else replace(joint, mimic=law)


# Dynamics whose activation is, in the end, the command or its integral.
_PLAIN_DYNAMICS = ("none", "integrator", "filter", "filterexact")

Range = tuple[float, float]
"""The least and the largest value."""


@dataclass(frozen=True)
class ActuatorLaw:
    """``gear * (gain * command + bias)`` on one joint, in the words of MJCF's ``<general>``."""

    gain_type: str
    """``gaintype`` in MJCF: ``fixed``, ``affine`` and so on."""
    bias_type: str
    """``biastype`` in MJCF: ``none``, ``affine`` and so on."""
    dynamics: str
    """``dyntype`` in MJCF: ``none``, ``integrator`` and so on."""
    gain: tuple[float, ...]
    """Parameters of the gain, ``gainprm``."""
    bias: tuple[float, ...]
    """Parameters of the bias, ``biasprm``."""
    gear: float
    """Joint effort by the actuator's force."""
    force_range: Range | None = None
    """Of the actuator itself, before the gear; none if unlimited."""
    command_range: Range | None = None
    """Least and most of the command; none if unlimited."""
    damping: float = 0.0
    """N m s/rad or N s/m of the actuator, before the gear."""

    def gains(self) -> tuple[float, float] | None:
        """Return stiffness and damping at the joint, or None for another law than a spring and a damper."""
        motor, affine = self.bias_type == "none", self.bias_type == "affine"
        if self.gain_type != "fixed" or self.dynamics not in _PLAIN_DYNAMICS or not (motor or affine):
            return None
        # Joint-space values: a gear g multiplies both the effort and the velocity of the actuator: g^2.
        own = self.gear**2 * self.damping
        if motor:
            return 0.0, own
        constant, stiffness, damping = self.bias[0], -self.bias[1], -self.bias[2]
        if constant or stiffness < 0 or damping < 0:
            # A position servo has gain = -bias[1], a velocity servo gain = -bias[2] (MJCF's <position> and <velocity>).
            return None
        position = math.isclose(self.gain[0], stiffness, rel_tol=1e-9)
        velocity = not stiffness and math.isclose(self.gain[0], damping, rel_tol=1e-9)
        if not (position or velocity):
            return None
        # ``+ 0.0`` turns the -0.0 of an absent term into 0.0.
        return self.gear**2 * stiffness + 0.0, self.gear**2 * damping + own

    def effort_range(self) -> Range:
        """Return the least and the largest effort at the joint; infinite where nothing limits it."""
        ranges: list[Range] = []
        if self.force_range is not None:
            ranges.append(_scaled(self.force_range, self.gear))
        # A motor's command is an effort: its range limits the effort.
        if self.command_range is not None and self.bias_type == "none" and self.gain_type == "fixed":
            ranges.append(_scaled(self.command_range, self.gear * self.gain[0]))
        return max((low for low, _ in ranges), default=-math.inf), min((high for _, high in ranges), default=math.inf)


def _scaled(limits: Range, factor: float) -> Range:
    ends = [limit * factor for limit in limits]
    return min(ends), max(ends)
