"""At which joint positions a gripper closes on a thing."""

from __future__ import annotations

from orbit_core.assets.convex import convex_shape, within
from orbit_core.audit.robots.postures import frame_pose, gripper_posture, gripping_links, placed_shapes
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Geometry, RobotSpec, Shape

_HALVINGS = 16


def closed_on(spec: RobotSpec, geometry: Geometry) -> dict[str, float]:
    """Positions (rad, m) by name, of all joints that move a gripper's links, at which it touches a convex thing.

    The thing lies at the first end effector's frame, along its axes.

    Raises:
        ConfigurationError: the robot has no gripper; or it touches the thing when wide open, or not even when closed.
    """
    effector = spec.end_effectors[0] if spec.end_effectors else None
    if effector is None or effector.gripper is None:
        raise ConfigurationError(f"robot '{spec.name}' has no gripper to hold something with")
    gripper, fingers = effector.gripper, gripping_links(spec, effector.gripper)
    opened, closed = (
        value if isinstance(value, tuple) else (value,) * len(gripper.joints)
        for value in (gripper.open_position, gripper.closed_position)
    )

    def posture(share: float) -> dict[str, float]:
        between = tuple((1.0 - share) * first + share * last for first, last in zip(opened, closed, strict=True))
        return gripper_posture(spec, gripper, between)

    def touches(share: float) -> bool:
        positions = posture(share)
        thing = convex_shape(Shape(geometry), frame_pose(spec, effector.frame, positions))
        shapes = placed_shapes(spec, positions)
        return thing is not None and any(within(thing, shape, 0.0) for link in fingers for shape in shapes[link.name])

    apart, touching = 0.0, 1.0
    if touches(apart) or not touches(touching):
        raise ConfigurationError(f"the gripper of '{spec.name}' does not close on a {type(geometry).__name__.lower()}")
    for _ in range(_HALVINGS):
        middle = 0.5 * (apart + touching)
        apart, touching = (apart, middle) if touches(middle) else (middle, touching)
    moved = {joint.name for joint in spec.articulation.movable_joints if joint.child in {link.name for link in fingers}}
    return {name: position for name, position in posture(touching).items() if name in moved}
