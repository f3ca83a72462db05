"""Classics of reinforcement learning: a pole on a cart, and Gymnasium's Ant and Humanoid, driven by efforts."""

from __future__ import annotations

import math

import numpy as np

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames
from orbit_assets.mjcf.reader import read_mjcf
from orbit_assets.options import ReadOptions, Unsupported
from orbit_assets.robot_parts import PartKind, RobotPart
from orbit_assets.sources import model_folder
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    EndEffector,
    Frame,
    IdealPd,
    Joint,
    JointType,
    Link,
    Pose,
    RobotSpec,
    Shape,
)

# Metres and kg.
RAIL_HEIGHT = 1.0
CART_MASS, CART_HALF = 1.0, (0.1, 0.15, 0.06)
POLE_MASS, POLE_LENGTH, POLE_RADIUS = 0.1, 1.0, 0.02


def cartpole() -> RobotSpec:
    """Build the cart in the middle of its rail, along x and 1 m up, the pole upright at position zero.

    Masses and lengths are those of Barto, Sutton and Anderson, Neuronlike adaptive elements (1983).
    """
    x, y, z = (4 * half * half for half in CART_HALF)
    cart_inertia = CART_MASS / 12 * np.diag([y + z, x + z, x + y])
    across, along = POLE_MASS * (POLE_LENGTH**2 / 12 + POLE_RADIUS**2 / 4), POLE_MASS * POLE_RADIUS**2 / 2
    middle = (0.0, 0.0, POLE_LENGTH / 2)
    rail = Shape(Box((2.5, 0.02, 0.02)), color=(0.4, 0.4, 0.45, 1.0))
    cart = Shape(Box(CART_HALF), color=(0.1, 0.3, 0.7, 1.0))
    pole = Shape(Capsule(POLE_RADIUS, POLE_LENGTH / 2 - POLE_RADIUS), Pose(middle), color=(0.85, 0.5, 0.1, 1.0))
    links = (
        Link("rail", visuals=(rail,)),
        Link("cart", CART_MASS, inertia=cart_inertia, visuals=(cart,)),
        Link("pole", POLE_MASS, middle, np.diag([across, across, along]), visuals=(pole,)),
    )
    # Gymnasium's limits of the track, and a motor that no policy saturates.
    slider = Joint("slider", JointType.PRISMATIC, "rail", "cart", axis=(1.0, 0.0, 0.0), lower_limit=-2.4,
                   upper_limit=2.4, effort_limit=100.0, velocity_limit=20.0)  # fmt: skip
    hinge = Joint("hinge", JointType.CONTINUOUS, "cart", "pole", axis=(0.0, 1.0, 0.0), velocity_limit=8 * math.pi)
    return RobotSpec(
        name="cartpole",
        articulation=Articulation("cartpole", links, (slider, hinge)),
        pose=Pose((0.0, 0.0, RAIL_HEIGHT)),
        fixed_base=True,
        actuators=(IdealPd(joints=("slider",)),),
        semantic_label="robot",
        licence="BSD-3-Clause",
        source="orbit-core",
    )


SOURCE = "gymnasium"
LICENCE = "MIT"
# The Ant's legs end in capsules without a body of their own: frames mark the ends.
_FEET = {
    "front_left_foot": Frame("front_left_foot", "body_4", Pose((0.4, 0.4, 0.0))),
    "front_right_foot": Frame("front_right_foot", "body_7", Pose((-0.4, 0.4, 0.0))),
    "back_left_foot": Frame("back_left_foot", "body_10", Pose((-0.4, -0.4, 0.0))),
    "back_right_foot": Frame("back_right_foot", "body_13", Pose((0.4, -0.4, 0.0))),
}
_SIDES = ("left", "right")


def ant() -> Articulation:
    """Read the Ant, with a frame at the end of each leg."""
    return add_frames(_read("ant"), *_FEET.values())


def humanoid() -> Articulation:
    """Read the Humanoid, with a frame under the sphere of each foot and one in each hand."""
    feet = (Frame(f"{side}_sole", f"{side}_shin", Pose((0.0, 0.0, -0.425))) for side in _SIDES)
    hands = (
        Frame(f"{side}_hand", f"{side}_lower_arm", Pose((0.18, across, 0.18)))
        for side, across in zip(_SIDES, (-0.18, 0.18), strict=True)
    )
    return add_frames(_read("humanoid"), *feet, *hands)


def _read(name: str) -> Articulation:
    (path,) = model_folder(SOURCE).glob(f"gymnasium/envs/*/assets/{name}.xml")
    # Actuators and keyframes of the files are dropped: efforts command the joints.
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
