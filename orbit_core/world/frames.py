"""Axes at the frames by which a robot meets the world: its base, end effectors, finger tips, feet and wheels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.meshes import marker_shapes
from orbit_core.scene import Articulation, Link, MarkerShape, MarkerSpec, RobotSpec, Shape

_OPAQUE = (0.0, 0.0, 0.0, 1.0)
_BASE, _LARGE, _SMALL = 0.25, 0.12, 0.04
"""Lengths of axes in metres: of the base, of end effectors, feet and wheels, and of finger tips."""


def frame_lengths(robot: RobotSpec) -> dict[str, float]:
    """Names of the links and frames whose axes are drawn, each with the axes' length in metres."""
    tips = [tip for effector in robot.end_effectors for tip in effector.finger_tips]
    large = [*(effector.frame for effector in robot.end_effectors), *robot.feet, *robot.wheels]
    return {robot.base_link: _BASE} | dict.fromkeys(tips, _SMALL) | dict.fromkeys(large, _LARGE)


def frame_shapes(robot: RobotSpec) -> dict[str, tuple[Shape, ...]]:
    """The axes as shapes, in the frame of the link that they are fixed to, by that link's name.

    x is red, y green and z blue.
    """
    shapes: dict[str, tuple[Shape, ...]] = {}
    for name, length in frame_lengths(robot).items():
        frame = robot.articulation.frame(name)
        axes = marker_shapes(MarkerSpec(name, MarkerShape.FRAME, length, _OPAQUE))
        placed = tuple(replace(axis, pose=frame.pose @ axis.pose) for axis in axes)
        shapes[frame.link] = (*shapes.get(frame.link, ()), *placed)
    return shapes


def with_frames(layout: SceneLayout) -> SceneLayout:
    """The layout with the robots' axes among what is seen of their links; what collides and moves is the same."""
    robots = tuple(replace(robot, articulation=_marked(robot)) for robot in layout.scene.robots)
    return SceneLayout.of(replace(layout.scene, robots=robots))


def _marked(robot: RobotSpec) -> Articulation:
    axes = frame_shapes(robot)

    def links() -> Iterator[Link]:
        for link in robot.articulation.links:
            seen = link.visuals or link.collisions
            yield replace(link, visuals=(*seen, *axes[link.name])) if link.name in axes else link

    return replace(robot.articulation, links=tuple(links()))
