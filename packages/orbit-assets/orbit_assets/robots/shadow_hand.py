"""The Shadow Dexterous Hand, a right hand with forearm: 24 joints, 20 of them driven."""

from __future__ import annotations

import math
from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, edit_joints, edit_links, renamed, simplify_collisions
from orbit_assets.drive_design import DriveDesign
from orbit_assets.mjcf.reader import read_mjcf
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.robots.hands import grasp, on_bracket, opened
from orbit_assets.sources import model_folder
from orbit_core.scene import Articulation, Frame, Mimic, Pose

SOURCE, LICENCE = "gymnasium-robotics", "Apache-2.0 (meshes after Shadow Robot's sr_common)"
# Tips open by 0.08 m. Closed on what is 0.04 m wide, three press with 5 N each against the thumb; the last one touches.
GRASP = {
    "FFJ2": (0.002, 0.254), "FFJ1": (0.776, 0.923), "MFJ2": (0.007, 0.272), "MFJ1": (0.825, 0.962),
    "RFJ2": (0.002, 0.254), "RFJ1": (0.774, 0.923), "LFJ2": (0.02, 0.161), "LFJ1": (0.668, 0.812),
    "THJ4": (0.263, 0.677), "THJ3": (1.222, 1.11), "THJ2": (0.209, 0.076), "THJ1": (-0.252, -0.134),
    "THJ0": (-0.339, -0.363),
}  # fmt: skip


def articulation() -> Articulation:
    """The hand from the lower end of its forearm on; names are the file's without ``robot0:``."""
    folder = model_folder(SOURCE)
    options = ReadOptions(unsupported=Unsupported.DROP, articulation="robot0:hand mount", allow_outside=(folder,))
    source = read_mjcf(folder / "hand/reach.xml", options=options)
    hand = renamed(source, lambda name: name.removeprefix("robot0:").replace(" ", "_"))
    coupling = 0.00805 / 0.00705  # arms of the tendon at a finger's middle and last joint
    note = "a finger's last joint follows the one before and damps and halts it; tendons would let it stray by 0.14 rad"
    hand = edit_joints(hand, (".FJ1",), note, upper_limit=1.571 / coupling, damping=0.1 * (1.0 + coupling**2))
    for finger in ("FF", "MF", "RF", "LF"):
        hand = edit_joints(hand, (f"{finger}J0",), note, mimic=Mimic(f"{finger}J1", coupling), damping=0.0)
    note = "boxes of 2 mm in two joints of the thumb do not collide, nor the hand with itself: the file lets 19 pairs"
    hand = edit_links(hand, ("thbase", "thhub"), note, lambda link: replace(link, collisions=()))
    hand = simplify_collisions(replace(hand, self_collisions=False, collision_exclusions=()), ("forearm",))
    hand = on_bracket(hand, "shadow_hand", (0.0, 0.01, 0.04), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 60.0)
    return add_frames(hand, Frame("shadow_tcp", "palm", Pose.from_euler(math.pi / 3, 0.0, 0.0, (0.011, -0.065, 0.114))))


PART = RobotPart(
    name="shadow_hand",
    kind=PartKind.END_EFFECTOR,
    model=Model("shadow_hand", articulation, (SOURCE,), LICENCE, parts=(on_bracket,)),
    home=opened(GRASP),
    designs=(  # with the file's gains of 1 N m/rad three fingers push the thumb away
        DriveDesign(joints=("WRJ.",)),
        DriveDesign(joints=("[FMR]FJ[123]", "LFJ[1-4]"), natural_frequency=10.0),
        DriveDesign(joints=("THJ.",), natural_frequency=14.0),
    ),
    frame="shadow_tcp",
    gripper=grasp(GRASP),
    finger_tips=("S_fftip", "S_mftip", "S_rftip", "S_lftip", "S_thtip"),
    pose=Pose((0.0, 0.0, 0.5)),
)
