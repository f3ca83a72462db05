"""Joints of several degrees of freedom as chains of simple ones, with links between them that have no mass.

A ball joint is three revolute joints about x, y and z of the joint's frame, in that order: the orientation of the child
is ``R_x(a) R_y(b) R_z(c)``, which is singular at ``b = +-pi/2``, as any three angles are somewhere.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from orbit_core.scene import Joint, JointType, Link, Pose
from orbit_core.scene.pose import Vector3

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Freedom:
    """One degree of freedom of a compound joint: its axis in the joint's frame, and its limits in rad or m.

    ``suffix`` is appended to the joint's name to name the simple joint.
    """

    suffix: str
    type: JointType
    axis: Vector3
    lower_limit: float = -math.inf
    upper_limit: float = math.inf


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
    """The links without mass and the simple joints, in order, that together let ``joint``'s child move so.

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
    """Joints that act one after another between the same two links, as a chain with links without mass between them.

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
