"""Robots of an installed ``mani-skill`` package, read from its own folder each time and kept nowhere else.

Homes and gains are those of ManiSkill's agents, but that the two arms of five joints open their jaws sideways, as tasks
take things; limits are the URDFs' where these have any. Of the package's other robots, some need files that it would
download (ANYmal C, UR10e, Unitree H1 and Go2, WidowX, xArm 6, Robotiq, Stompy, Google's, XLeRobot, two Panda hands and
the mobile Pandas), and some are not what a body can be (Allegro's inertias, Fetch's massless links, Inspire's chained
mimics); neither are offered.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace

from orbit_assets.compose import add_frames, edit_joints, simplify_collisions
from orbit_assets.options import ReadOptions
from orbit_assets.sources import model_folder
from orbit_assets.urdf import read_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, EndEffector, Frame, Gripper, ImplicitPd, Pose, RobotSpec, Workspace

SOURCE = "mani-skill"
ASSETS_LICENCE = "CC BY-NC 4.0 (no commercial use)"
OWN_LICENCE = "Apache-2.0"

_PANDA_ARM = ("panda_joint[1-7]",)
_PANDA_HOME = {
    "panda_joint2": math.pi / 8,
    "panda_joint4": -5 * math.pi / 8,
    "panda_joint6": 3 * math.pi / 4,
    "panda_joint7": math.pi / 4,
}
_PANDA_GRIPPER = Gripper(("panda_finger_joint1",), 0.04, 0.0)
# Gains of ManiSkill's controllers.
_STIFF, _DAMPED = 1e3, 1e2
_NO_LIMITS = "effort limit of 100 N m is ManiSkill's controllers', armature of 0.01 kg m^2 the catalogue's choice"


def panda() -> RobotSpec:
    """Read the arm with its hand, pointing straight down."""
    return _panda("panda", "panda_v2")


def panda_wristcam() -> RobotSpec:
    """Read the same with a camera's body at its wrist; the frame ``camera_link`` is where it looks from, along x."""
    return _panda("panda_wristcam", "panda_v3")


def panda_stick() -> RobotSpec:
    """Read the arm with a stick in the place of its hand."""
    note = "armature of 0.1 kg m^2 is the catalogue's choice: the URDF has none"
    arm = edit_joints(_articulation("panda_stick", "panda/panda_stick.urdf"), (".*",), note, armature=0.1)
    drives = (ImplicitPd(joints=_PANDA_ARM, stiffness=_STIFF, damping=_DAMPED),)
    return _robot(arm, _PANDA_HOME, drives, EndEffector("panda_hand_tcp", _PANDA_ARM, workspace=Workspace()))


def xarm7_ability() -> RobotSpec:
    """Read the UFACTORY arm with a PSYONIC hand, whose palm carries the end effector's frame ``base``."""
    note = "armature of 0.1 kg m^2 (arm) and 0.02 (hand, for its mimics) is the catalogue's choice: the URDF has none"
    body = _articulation("xarm7_ability", "xarm7/xarm7_ability_right_hand.urdf")
    body = edit_joints(edit_joints(body, ("joint[1-7]",), note, armature=0.1), (".*_q[12]",), note, armature=0.02)
    arm = ("joint[1-7]",)
    fingers = ("(index|middle|ring|pinky)_q1", "thumb_q[12]")
    drives = tuple(ImplicitPd(joints=names, stiffness=_STIFF, damping=_DAMPED) for names in (arm, fingers))
    home = {"joint2": -0.4, "joint4": 0.5, "joint6": 0.9, "joint7": -3.0}
    gripper = Gripper((*fingers[:1], "thumb_q2"), 0.0, 1.2)
    return _robot(body, home, drives, EndEffector("base", arm, gripper))


def so100() -> RobotSpec:
    """Read a 5-joint arm with one moving jaw. The frame ``tcp`` is the fixed jaw's tip."""
    turn = (0.5, 0.5, 0.5, -0.5)  # the jaw points along -y and opens along x
    home = {
        "shoulder_lift": -math.pi / 2,
        "elbow_flex": math.pi / 2,
        "wrist_flex": 0.66,
        "wrist_roll": math.pi / 2,
        "gripper": -1.1,
    }
    arm = ("shoulder_.*", "elbow_flex", "wrist_.*")
    body = _articulation("so100", "so100/so100.urdf")
    return _jaw_arm(body, home, arm, Gripper(("gripper",), 1.1, -1.1), "Fixed_Jaw_tip", turn)


def koch() -> RobotSpec:
    """Read a 5-joint arm with one moving jaw. The frame ``tcp`` is the fixed jaw's tip."""
    turn = (0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0)  # the jaw points along -z and opens along x
    home = {"joint_2": 2.2, "joint_3": 3.017, "joint_4": -0.25, "joint_5": math.pi / 2, "joint_6": 0.6044}
    body = _articulation("koch", "koch/follower_arm_v1.1.urdf")
    return _jaw_arm(body, home, ("joint_[1-5]",), Gripper(("joint_6",), 1.6, 0.0), "gripper_tcp", turn)


def _panda(name: str, file: str) -> RobotSpec:
    note = "armature of 0.1 kg m^2 (arm) and 0.1 kg (fingers) is the catalogue's choice: the URDF has none"
    body = edit_joints(_articulation(name, f"panda/{file}.urdf"), (".*",), note, armature=0.1)
    groups = _PANDA_ARM, _PANDA_GRIPPER.joints
    drives = tuple(ImplicitPd(joints=names, stiffness=_STIFF, damping=_DAMPED) for names in groups)
    home = {**_PANDA_HOME, "panda_finger_joint.*": 0.04}
    return _robot(body, home, drives, EndEffector("panda_hand_tcp", _PANDA_ARM, _PANDA_GRIPPER, workspace=Workspace()))


def _jaw_arm(
    body: Articulation,
    home: dict[str, float],
    arm: tuple[str, ...],
    gripper: Gripper,
    tip: str,
    turn: tuple[float, float, float, float],
) -> RobotSpec:
    body = edit_joints(body, (".*",), _NO_LIMITS, effort_limit=100.0, velocity_limit=math.inf, armature=0.01)
    body = add_frames(body, Frame("tcp", tip, Pose((0.0, 0.0, 0.0), turn)))
    drives = (ImplicitPd(joints=(".*",), stiffness=_STIFF, damping=_DAMPED),)
    # These arms face their root's -y, tasks lie along x.
    turned = Pose.from_euler(0.0, 0.0, math.pi / 2)
    return replace(_robot(body, home, drives, EndEffector("tcp", arm, gripper), OWN_LICENCE), pose=turned)


def _robot(
    body: Articulation,
    home: dict[str, float],
    drives: tuple[ImplicitPd, ...],
    effector: EndEffector,
    licence: str = ASSETS_LICENCE,
) -> RobotSpec:
    return RobotSpec(
        name=body.name,
        articulation=body,
        fixed_base=True,
        home=home,
        actuators=drives,
        semantic_label="robot",
        gravity_compensation=True,
        end_effectors=(effector,),
        licence=licence,
        source=SOURCE,
    )


@functools.cache
# Cached, for reading takes seconds and several entries share one file.
def _articulation(name: str, file: str) -> Articulation:
    folder = model_folder(SOURCE)  # robots share hands' meshes
    source = read_urdf(folder / file, name=f"maniskill_{name}", options=ReadOptions(allow_outside=(folder,)))
    return simplify_collisions(validate(merge_fixed_links(validate(source))))
