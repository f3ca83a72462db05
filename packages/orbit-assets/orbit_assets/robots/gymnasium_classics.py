"""Gymnasium's Ant and Humanoid, whose motors are commanded by efforts."""

from __future__ import annotations

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames
from orbit_assets.mjcf.reader import read_mjcf
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.parts import PartKind, RobotPart
from orbit_assets.sources import model_folder
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, EndEffector, Frame, IdealPd, Pose

SOURCE = "gymnasium"
LICENCE = "MIT"
_FEET = {
    "front_left_foot": Frame("front_left_foot", "body_4", Pose((0.4, 0.4, 0.0))),
    "front_right_foot": Frame("front_right_foot", "body_7", Pose((-0.4, 0.4, 0.0))),
    "back_left_foot": Frame("back_left_foot", "body_10", Pose((-0.4, -0.4, 0.0))),
    "back_right_foot": Frame("back_right_foot", "body_13", Pose((0.4, -0.4, 0.0))),
}
_SIDES = ("left", "right")


def ant() -> Articulation:
    """The Ant, with a frame at the end of each leg."""
    return add_frames(_read("ant"), *_FEET.values())


def humanoid() -> Articulation:
    """The Humanoid, with a frame under the sphere of each foot and in that of each hand."""
    feet = (Frame(f"{side}_sole", f"{side}_shin", Pose((0.0, 0.0, -0.425))) for side in _SIDES)
    hands = (
        Frame(f"{side}_hand", f"{side}_lower_arm", Pose((0.18, across, 0.18)))
        for side, across in zip(_SIDES, (-0.18, 0.18), strict=True)
    )
    return add_frames(_read("humanoid"), *feet, *hands)


def _read(name: str) -> Articulation:
    (path,) = model_folder(SOURCE).glob(f"gymnasium/envs/*/assets/{name}.xml")
    return merge_fixed_links(read_mjcf(path, options=ReadOptions(unsupported=Unsupported.DROP)))


ANT = RobotPart(
    name="ant",
    kind=PartKind.BASE,
    model=Model("ant", ant, (SOURCE,), LICENCE),
    home={"ankle_[14]": 1.0, "ankle_[23]": -1.0},
    drives=(IdealPd(joints=(".*",)),),
    feet=tuple(_FEET),
    pose=Pose((0.0, 0.0, 0.75)),
    fixed_base=False,
)
HUMANOID = RobotPart(
    name="humanoid",
    kind=PartKind.BASE,
    model=Model("humanoid", humanoid, (SOURCE,), LICENCE),
    drives=(IdealPd(joints=(".*",)),),
    feet=tuple(f"{side}_sole" for side in _SIDES),
    end_effectors=tuple(EndEffector(f"{side}_hand", (f"{side}_shoulder.", f"{side}_elbow")) for side in _SIDES),
    pose=Pose((0.0, 0.0, 1.4)),
    fixed_base=False,
)
