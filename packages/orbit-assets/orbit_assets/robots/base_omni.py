"""The omnidirectional base of PAL Robotics' TIAGo Pro, without its torso: it carries an arm on its top."""

from __future__ import annotations

from dataclasses import replace

from orbit_assets.cache import Model
from orbit_assets.compose import add_frames, attach, simplify_collisions, without
from orbit_assets.installed import installed_urdf
from orbit_assets.parts import PartKind, RobotPart
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Frame, ImplicitPd, Joint, JointType, Link, PlanarBase, Pose

SOURCE = "example-robot-data"
LICENCE = "Apache-2.0"
# The URDF's wheels: radius, half the distance between the front and rear ones and between left and right ones, limits.
RADIUS, LENGTH, WIDTH, WHEEL_EFFORT, WHEEL_RATE = 0.0762, 0.244, 0.223, 6.0, 13.123
# Wheels turn at (|x'| + |y'| + (LENGTH + WIDTH) |yaw'|) / RADIUS (Taheri, Qiao and Ghaeminezhad, Kinematic Model of a
# Four Mecanum Wheeled Mobile Robot, 2015), and push with all four.
SPEED, FORCE = WHEEL_RATE * RADIUS, 4.0 * WHEEL_EFFORT / RADIUS
ARM = LENGTH + WIDTH
WHEELS = tuple(f"wheel_{end}_{side}_link" for end in ("front", "rear") for side in ("left", "right"))


def articulation() -> Articulation:
    """The base on virtual joints ``base_x``, ``base_y`` and ``base_yaw``; an arm's frame is ``mount``."""
    source = installed_urdf(SOURCE, "robots/tiago_pro_description/robots/tiago_pro.urdf")
    body = without(without(source, "torso_base_link"), "torso_fixed_column_link")
    # Its rollers are not in the model: wheels that slid sideways would scrape, so they neither turn nor collide.
    fixed = (replace(joint, type=JointType.FIXED) if joint.child in WHEELS else joint for joint in body.joints)
    links = (replace(link, collisions=()) if link.name in WHEELS else link for link in body.links)
    body = simplify_collisions(merge_fixed_links(replace(body, links=tuple(links), joints=tuple(fixed))))
    body = add_frames(body, Frame("mount", "base_footprint", Pose((0.1, 0.0, 0.307))))
    x, y = (
        Joint(f"base_{name}", JointType.PRISMATIC, parent, f"base_{name}_link", axis=axis,
              effort_limit=FORCE, velocity_limit=SPEED)
        for name, parent, axis in (("x", "base_omni", (1.0, 0.0, 0.0)), ("y", "base_x_link", (0.0, 1.0, 0.0)))
    )  # fmt: skip
    yaw = Joint("base_yaw", JointType.CONTINUOUS, "base_y_link", "base_yaw_link",
                effort_limit=FORCE * ARM, velocity_limit=SPEED / ARM)  # fmt: skip
    chain = Articulation("base_omni", tuple(map(Link, ("base_omni", *(j.child for j in (x, y, yaw))))), (x, y, yaw))
    note = (
        "the base moves by virtual joints x, y and yaw, limits from those of its wheels, which do not turn or collide"
    )
    return merge_fixed_links(replace(attach(chain, body, "base_yaw_link"), notes=(*body.notes, note)))


PART = RobotPart(
    name="base_omni",
    kind=PartKind.BASE,
    model=Model("base_omni", articulation, (SOURCE,), LICENCE),
    drives=(
        # Velocities, which 60 kg reach within 20 ms, as far as the wheels push that much.
        ImplicitPd(joints=("base_[xy]",), stiffness=0.0, damping=3000.0),
        ImplicitPd(joints=("base_yaw",), stiffness=0.0, damping=300.0),
    ),
    mount="mount",
    planar_base=PlanarBase("base_x", "base_y", "base_yaw"),
    wheels=WHEELS,
)
