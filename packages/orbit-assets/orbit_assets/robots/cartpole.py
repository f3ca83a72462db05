"""A pole hinged on a cart that a motor pushes along a rail: the classic balancing problem."""

from __future__ import annotations

import math

import numpy as np

from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    IdealPd,
    Joint,
    JointType,
    Link,
    Pose,
    RobotSpec,
    Shape,
)

RAIL_HEIGHT = 1.0
CART_MASS, CART_HALF = 1.0, (0.1, 0.15, 0.06)
POLE_MASS, POLE_LENGTH, POLE_RADIUS = 0.1, 1.0, 0.02


def build() -> RobotSpec:
    """The cart in the middle of its rail, along x and 1 m up, the pole standing; position zero is upright.

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
