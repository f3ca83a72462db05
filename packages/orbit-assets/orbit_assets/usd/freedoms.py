"""The directions in which a USD joint lets its bodies move, and the places that it gives them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbit_assets.usd.stage import Reading, attribute, number
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Pose
from orbit_core.scene.pose import Vector3

_AXES: dict[str, Vector3] = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
_GENERIC = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")
"""Axes of a generic joint: it moves along the first three of its first frame, then turns about x, y and z in turn."""


@dataclass(frozen=True)
class Direction:
    """One degree of freedom: the axis in the joint's frames, limits in rad or m, and what the stage calls it.

    ``instance`` names it in the schemas of drives, limits and friction: ``angular``, ``linear``, ``rotX`` and so on.
    """

    instance: str
    angular: bool
    axis: Vector3
    lower: float
    upper: float

    @property
    def locked(self) -> bool:
        """Whether the stage says so, by a lower limit above the upper."""
        return self.lower > self.upper


def directions(prim: Any, reading: Reading) -> tuple[Direction, ...] | None:
    """Those in which a joint lets its bodies move, the outermost first; ``None`` for what is no such joint.

    Raises:
        AssetError: the joint's type or axis is unknown.
    """
    kind = prim.GetTypeName()
    match kind:
        case "PhysicsFixedJoint":
            return ()
        case "PhysicsRevoluteJoint" | "PhysicsPrismaticJoint":
            return (_simple(prim, reading, angular=kind == "PhysicsRevoluteJoint"),)
        case "PhysicsSphericalJoint":
            if max(number(prim, f"physics:coneAngle{side}Limit", -1.0) for side in "01") >= 0:
                reading.lack(f"{prim.GetPath()} limits its ball joint by a cone")
            # The cone stands about the joint's own axis, which therefore tells nothing where there is none.
            return tuple(Direction(f"rot{name}", True, axis, -math.inf, math.inf) for name, axis in _AXES.items())
        case "PhysicsJoint":
            if attribute(prim, "limit:distance:physics:high") is not None:
                reading.lack(f"{prim.GetPath()} limits a distance")
            found = (_generic(prim, reading, name) for name in _GENERIC)
            return tuple(each for each in found if not each.locked)
        case "PhysicsDistanceJoint":
            reading.lack(f"{prim.GetPath()} is a distance joint")
            return None
        case _:
            raise AssetError(f"{prim.GetPath()} is a {kind}: give it one of UsdPhysics' types of joints")


def _simple(prim: Any, reading: Reading, *, angular: bool) -> Direction:
    name = attribute(prim, "physics:axis", "X")
    if name not in _AXES:
        raise AssetError(f"{prim.GetPath()}.physics:axis is {name!r}: give X, Y or Z")
    unit = reading.units.position(angular)
    lower = number(prim, "physics:lowerLimit", -math.inf) * unit
    upper = number(prim, "physics:upperLimit", math.inf) * unit
    return Direction("angular" if angular else "linear", angular, _AXES[name], lower, upper)


def _generic(prim: Any, reading: Reading, name: str) -> Direction:
    angular = name.startswith("rot")
    unit = reading.units.position(angular)
    lower = number(prim, f"limit:{name}:physics:low", -math.inf) * unit
    upper = number(prim, f"limit:{name}:physics:high", math.inf) * unit
    return Direction(name, angular, _AXES[name[-1]], lower, upper)


def coordinates(directions: tuple[Direction, ...], relative: Pose) -> tuple[list[float], Pose]:
    """The joint's positions (rad or m) where its second frame has the pose ``relative`` in the first, and the rest.

    The rest is the pose of the second frame in the one where those positions would bring it.
    """
    turning = [each for each in directions if each.angular]
    if len(turning) == 1:
        _, *vector = relative.orientation
        angles = [2.0 * math.atan2(float(np.dot(vector, turning[0].axis)), relative.orientation[0])]
    else:
        m = relative.rotation_matrix()
        euler = (
            math.atan2(-m[1, 2], m[2, 2]),
            math.asin(max(-1.0, min(1.0, float(m[0, 2])))),
            math.atan2(-m[0, 1], m[0, 0]),
        )
        angles = [euler[each.axis.index(1.0)] for each in turning]
    along = [float(np.dot(relative.position, each.axis)) for each in directions if not each.angular]
    # Along the axes of the first frame before any turn: a generic joint's order.
    reached = Pose()
    for each, value in zip(directions, [*along, *angles], strict=True):
        x, y, z = each.axis
        moved = Pose.from_axis_angle(each.axis, value) if each.angular else Pose((value * x, value * y, value * z))
        reached = reached @ moved
    return [*along, *angles], reached.inverse() @ relative
