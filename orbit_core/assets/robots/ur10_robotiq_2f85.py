"""Universal Robots UR10 with a Robotiq 2F-85 gripper on its flange."""

from __future__ import annotations

from orbit_core.assets.cache import Model, cached_articulation
from orbit_core.assets.compose import attach, edit_joints, simplify_collisions, subtree
from orbit_core.assets.installed import installed_urdf
from orbit_core.assets.merge import merge_fixed_links
from orbit_core.assets.robots import robotiq_2f85
from orbit_core.assets.robots.universal_robots import UR10
from orbit_core.scene import Articulation, EndEffector, ImplicitPd, RobotSpec

SOURCE = "example-robot-data"
LICENCE = f"BSD (arm); {robotiq_2f85.LICENCE} (gripper)"
ARM_JOINTS = ("shoulder_.*_joint", "elbow_joint", "wrist_[123]_joint")
HOME = {
    "shoulder_pan_joint": -0.277,
    "shoulder_lift_joint": -1.739,
    "elbow_joint": 1.910,
    "wrist_1_joint": -1.742,
    "wrist_2_joint": -1.571,
    "wrist_3_joint": -0.277,
}
# Damping near critical for the inertia that each joint moves with the arm half outstretched.
SHOULDER = ImplicitPd(joints=("shoulder_.*_joint",), stiffness=1500.0, damping=180.0)
ELBOW = ImplicitPd(joints=("elbow_joint",), stiffness=1000.0, damping=90.0)
WRIST = ImplicitPd(joints=("wrist_[123]_joint",), stiffness=400.0, damping=20.0)


def build() -> RobotSpec:
    """The arm with its gripper open, pointing straight down, 0.6 m before the base and 0.4 m above its foot."""
    packages = (SOURCE, robotiq_2f85.SOURCE)
    model = Model("ur10_robotiq_2f85", _articulation, packages, LICENCE, parts=(robotiq_2f85.gripper,))
    return RobotSpec(
        name="ur10_robotiq_2f85",
        articulation=cached_articulation(model),
        fixed_base=True,
        home=HOME,
        actuators=(SHOULDER, ELBOW, WRIST, robotiq_2f85.DRIVE),
        semantic_label="robot",
        gravity_compensation=True,
        end_effectors=(EndEffector(robotiq_2f85.TCP, ARM_JOINTS, robotiq_2f85.GRIPPER, workspace=UR10.workspace),),
        licence=LICENCE,
        source=", ".join(packages),
    )


def _articulation() -> Articulation:
    source = installed_urdf(SOURCE, "robots/ur_description/urdf/ur10_robot.urdf", "ur10_robotiq_2f85")
    arm = simplify_collisions(merge_fixed_links(subtree(source, "base_link", source.name)))
    note = "armature of 0.1 kg m^2 on the UR10's joints is the catalogue's choice: the URDF has none"
    return attach(edit_joints(arm, (".*",), note, armature=0.1), robotiq_2f85.gripper(), "tool0")
