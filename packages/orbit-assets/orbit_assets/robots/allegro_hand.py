"""The Allegro hand, right and left: three fingers and a thumb of four joints each."""

from __future__ import annotations

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints
from orbit_assets.drive_design import DriveDesign
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots.hands import grasp, on_bracket, opened
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, Pose

SOURCE = "example-robot-data"
LICENCE = "BSD"
# The tips are 0.08 m apart where the hand is open. Closed on what is 0.04 m wide, index and middle finger press with
# 4.2 N each against 8.4 N of the thumb; the ring finger, which nothing opposes, touches.
GRASP = {
    "joint_0.0": (-0.169, -0.124), "joint_1.0": (0.311, 0.561), "joint_2.0": (0.911, 1.076),
    "joint_3.0": (0.641, 0.669), "joint_4.0": (0.087, 0.077), "joint_5.0": (0.295, 0.557),
    "joint_6.0": (0.95, 1.107), "joint_7.0": (0.649, 0.666), "joint_8.0": (0.15, 0.115),
    "joint_9.0": (0.307, 0.476), "joint_10.0": (0.913, 1.024), "joint_11.0": (0.644, 0.654),
    "joint_12.0": (1.396, 1.396), "joint_13.0": (0.305, 0.272), "joint_14.0": (0.227, 0.78),
    "joint_15.0": (0.757, 0.448),
}  # fmt: skip
_SPREAD = ("joint_0.0", "joint_4.0", "joint_8.0")


def _part(side: str, sign: float) -> RobotPart:
    """``sign`` is 1 for the right hand and -1 for the left, its mirror image."""
    name = f"allegro_{side}"

    def articulation() -> Articulation:
        source = installed_urdf(SOURCE, f"robots/allegro_hand_description/urdf/allegro_{side}_hand.urdf", name)
        note = (
            "effort limit of 0.7 N m is the maker's, for the URDF's 15; its damping of 3 to 10 N m s/rad and friction "
            "of 5 to 12 N m, which no motor of the hand could move, are left out; armature of 0.002 kg m^2 is ours"
        )
        source = edit_joints(source, (".*",), note, effort_limit=0.7, damping=0.0, friction=0.0, armature=0.002)
        hand = on_bracket(
            merge_fixed_links(source), name, (-0.03, 0.0, -0.0475), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), 70.0
        )
        tcp = Frame("allegro_tcp", hand.root.name, Pose((0.0218 * sign, 0.0217, 0.138)))
        return add_frames(hand, tcp)

    positions = GRASP | {joint: (sign * a, sign * b) for joint, (a, b) in GRASP.items() if joint in _SPREAD}
    return RobotPart(
        name=name,
        kind=PartKind.END_EFFECTOR,
        model=Model(name, articulation, (SOURCE,), LICENCE, parts=(on_bracket,)),
        home=opened(positions),
        designs=(DriveDesign(joints=(r"joint_\d+\.0",), natural_frequency=7.0),),
        frame="allegro_tcp",
        gripper=grasp(positions),
        finger_tips=("link_3.0_tip", "link_7.0_tip", "link_11.0_tip", "link_15.0_tip"),
        pose=Pose((0.0, 0.0, 0.5)),
    )


RIGHT, LEFT = _part("right", 1.0), _part("left", -1.0)
