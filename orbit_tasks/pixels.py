"""Cameras for learning from pictures: one that the hand carries, and one that stands before the arm."""

from __future__ import annotations

from orbit_core.envs.task import ROBOT
from orbit_core.scene import END_EFFECTOR, CameraSpec, Channel, look_at

SIZE = 64
"""Pixels, both ways."""

HAND = CameraSpec(
    name="hand",
    width=SIZE,
    height=SIZE,
    vertical_fov=1.2,
    channels=(Channel.RGB, Channel.DEPTH),
    entity=ROBOT,
    frame=END_EFFECTOR,
    pose=look_at(eye=(0.1, 0.0, -0.12), target=(0.045, 0.0, 0.03), up=(1.0, 0.0, 0.0)),
    far=2.0,
)
"""Beside the fingers, which close across the picture; it looks at what lies between and before them."""

FRONT = CameraSpec(
    name="front",
    width=SIZE,
    height=SIZE,
    vertical_fov=0.85,
    channels=(Channel.RGB, Channel.DEPTH),
    pose=look_at(eye=(1.3, 0.0, 0.75), target=(0.45, 0.0, 0.2)),
    far=2.0,
)
"""Looks at the arm over the bench, from the other side."""
