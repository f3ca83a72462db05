"""Pinocchio's model of an articulation, built from the description, without a file in between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Articulation, JointType, Pose

ROOT_JOINT = "root_joint"
"""Name by which crocoddyl finds the joint of a floating base, which no actuator drives."""


def libraries() -> tuple[Any, Any]:
    """Return the modules pinocchio and crocoddyl.

    Raises:
        ConfigurationError: they are not installed; says what to install.
    """
    try:
        return import_module("pinocchio"), import_module("crocoddyl")
    except ImportError:
        raise ConfigurationError(
            "model-predictive control needs crocoddyl and the release of Pinocchio that it was made with: "
            f"{install_extra('mpc')} and pip install --no-deps crocoddyl==3.2.1 libcrocoddyl==3.2.1"
        ) from None


def pinocchio_model(articulation: Articulation, floating: bool = False) -> tuple[Any, dict[str, int]]:
    """Return the model, and pinocchio's index of each movable joint; joints that follow others count as free.

    Every link and named frame is a frame of the model. A floating base has the joint :data:`ROOT_JOINT` at the root
    link's frame.

    Args:
        articulation: in topological order.
        floating: True if the root link moves.
    """
    pinocchio: Any = import_module("pinocchio")

    def placement(pose: Pose) -> Any:
        matrix = pose.matrix()
        return pinocchio.SE3(matrix[:3, :3], matrix[:3, 3])

    def add_body(name: str, parent: int, frame: Any) -> None:
        link = articulation.links[names.index(name)]
        parents[name], frames[name] = parent, frame
        own = pinocchio.Inertia(link.mass, np.asarray(link.center_of_mass), np.asarray(link.inertia))
        model.appendBodyToJoint(parent, own, frame)

    model, names = pinocchio.Model(), articulation.link_names
    parents: dict[str, int] = {}
    frames: dict[str, Any] = {}
    ids: dict[str, int] = {}
    identity = pinocchio.SE3.Identity()
    root = model.addJoint(0, pinocchio.JointModelFreeFlyer(), identity, ROOT_JOINT) if floating else 0
    if floating:
        model.addJointFrame(root)
    add_body(names[0], root, identity)
    kinds = {JointType.PRISMATIC: pinocchio.JointModelPrismaticUnaligned}
    for joint in articulation.joints:
        before = frames[joint.parent] * placement(joint.parent_pose)
        parent = parents[joint.parent]
        if joint.movable:
            kind = kinds.get(joint.type, pinocchio.JointModelRevoluteUnaligned)
            parent = model.addJoint(parent, kind(np.asarray(joint.axis)), before, joint.name)
            model.addJointFrame(parent)
            # A link's body is placed in its joint's frame, in which pinocchio has it.
            ids[joint.name], before = parent, identity
        add_body(joint.child, parent, before * placement(joint.child_pose).inverse())
    for name in names:
        model.addFrame(pinocchio.Frame(name, parents[name], frames[name], pinocchio.FrameType.OP_FRAME))
    # Frames with a link's name exist already.
    for frame in articulation.frames:
        if frame.name not in names:
            at = frames[frame.link] * placement(frame.pose)
            model.addFrame(pinocchio.Frame(frame.name, parents[frame.link], at, pinocchio.FrameType.OP_FRAME))
    return model, ids


def reduced_model(
    articulation: Articulation,
    joints: Sequence[str],
    positions: Mapping[str, float],
    gravity: Sequence[float],
    floating: bool,
) -> tuple[Any, list[int]]:
    """Return the model of some joints, and the index of each among its joints.

    Args:
        articulation: the description.
        joints: names of those that move.
        positions: rad or m at which all others are held, by name.
        gravity: m/s^2, world axes.
        floating: True if the root link moves.
    """
    pinocchio: Any = import_module("pinocchio")
    model, ids = pinocchio_model(articulation, floating)
    held = [name for name in articulation.joint_names if name not in joints]
    reference = pinocchio.neutral(model)
    for name in held:
        reference[model.joints[ids[name]].idx_q] = positions[name]
    model = pinocchio.buildReducedModel(model, [ids[name] for name in held], reference)
    model.gravity.linear = np.asarray(gravity, dtype=np.float64)
    # A floating base has six velocity coordinates before the joints.
    base = 6 if floating else 0
    return model, [model.joints[model.getJointId(name)].idx_v - base for name in joints]
