"""Mimic joints as PhysX's fixed tendons.

A tendon is a spring on a weighted sum of joint positions. It pulls each of its links along the axis of the link's
joint, and the reaction acts on the link at its root, across all joints between. So that these feel nothing, their
links are pulled as well.
"""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# The links of an articulation are kept as bodies, which some of them alone are.

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import Approximation
from orbit_core.scene import Articulation, Joint, JointType
from orbit_sapien.native import physx

FloatArray = npt.NDArray[np.float64]


def add_mimic_tendon(
    native: physx.PhysxArticulation,
    bodies: dict[str, physx.PhysxRigidBaseComponent],
    articulation: Articulation,
    joint: Joint,
    stiffness: float,
) -> None:
    """``q = multiplier q(leader) + offset``, with bodies by link name."""
    assert joint.mimic is not None
    root, *chain = _chain(articulation, joint)
    weight = {_leader(articulation, joint).child: -joint.mimic.multiplier, joint.child: 1.0}
    weights = np.array([weight.get(link, 0.0) for link in chain])
    pulls = np.linalg.solve(_leverage(articulation, chain)[0], weights)
    native.create_fixed_tendon(
        [bodies[link] for link in (root, *chain)],
        [0.0, *weights.tolist()],
        [0.0, *pulls.tolist()],
        rest_length=joint.mimic.offset,
        stiffness=stiffness,
    )


def mimic_approximations(articulation: Articulation, subject: str, joint: Joint) -> list[Approximation]:
    """The approximations in the tendon of a mimic joint."""
    if _leverage(articulation, _chain(articulation, joint)[1:])[1]:
        return []
    why = "PhysX's tendons react on the link at their root, and the joints between are not parallel to the follower"
    return [Approximation(subject, "a load on its leader alone", "a load on the joints between too", why)]


def _leader(articulation: Articulation, joint: Joint) -> Joint:
    assert joint.mimic is not None
    return articulation.movable_joints[articulation.joint_names.index(joint.mimic.joint)]


def _leverage(articulation: Articulation, chain: list[str]) -> tuple[FloatArray, bool]:
    """Effort on the joint above link j for a unit pull of link i, and whether it stays so as the joints move."""
    axes = _axes(articulation)
    incoming = {joint.child: joint for joint in articulation.joints}
    leverage, constant = np.eye(len(chain)), True
    for i, link in enumerate(chain):
        for j, other in enumerate(chain):
            if i == j or other not in _downwards(articulation, link):
                continue
            turns, hinged = (incoming[name].type is not JointType.PRISMATIC for name in (link, other))
            along = float(axes[link] @ axes[other])
            leverage[j, i] = along if turns == hinged else 0.0
            # A hinge feels the part of a twist along its axis, and a straight pull by a lever arm that changes.
            constant &= turns and abs(along) > 1 - 1e-6 if hinged else True
    return leverage, constant


def _axes(articulation: Articulation) -> dict[str, FloatArray]:
    """Axis of the joint above each link, in the root's axes, with all joints at zero."""
    turned = {articulation.root.name: np.eye(3)}
    axes: dict[str, FloatArray] = {}
    for joint in articulation.joints:
        above = turned[joint.parent] @ joint.parent_pose.rotation_matrix()
        axes[joint.child] = above @ np.asarray(joint.axis)
        turned[joint.child] = above @ joint.child_pose.rotation_matrix().T
    return axes


def _downwards(articulation: Articulation, link: str) -> list[str]:
    """The links from the root to this one."""
    parent = {joint.child: joint.parent for joint in articulation.joints}
    way = [link]
    while way[0] in parent:
        way.insert(0, parent[way[0]])
    return way


def _chain(articulation: Articulation, joint: Joint) -> list[str]:
    """The last link that both joints hang on, then the links from there to either, parents first."""
    ends = _leader(articulation, joint).child, joint.child
    ways = [_downwards(articulation, end) for end in ends]
    above = [way[:-1] for way in ways]  # a moving link's parent is on its way
    shared = [a for a, b in zip(*above, strict=False) if a == b]
    return [shared[-1], *dict.fromkeys(link for way in ways for link in way[len(shared) :])]
