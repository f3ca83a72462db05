"""Backend that the plugin registers: its capabilities, its declared gaps, and its engines. MuJoCo is imported only when
an engine or a renderer is made.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_core.interfaces import (
    EXACT,
    Backend,
    Capabilities,
    Capability,
    ConfigurationError,
    Gap,
    approximate,
    unsupported,
)
from orbit_core.plugin_kit.simplify import SIMPLIFIED
from orbit_mjmodel.capabilities import shared_support
from orbit_mjmodel.gaps import CONTACT, MOTION
from orbit_mujoco.config import MujocoConfig

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec

CAPABILITIES = Capabilities(
    shared_support("MuJoCo")
    | {
        Capability.SIGNED_DISTANCE_FIELDS: approximate(
            "distances are interpolated in an octree whose finest cells are 2^-7 of the mesh's box, and contacts are "
            "found by descent from 40 points, other ones from step to step: what rests on them creeps and trembles"
        ),
        Capability.HEIGHT_FIELDS: approximate(
            "prism by prism, whose sides are felt: on a level floor of cells of 0.1 m a ball at 1 m/s loses 0.06 of "
            "its speed and turns by 0.045 rad in 1.2 s, and a box stops after 0.5 to 0.9 of its way; exact where the "
            "whole field has no more than eight planes"
        ),
        Capability.COPIED_STATES: EXACT,
        Capability.DETERMINISTIC: EXACT,
        Capability.SHADOWS: approximate(
            "from a map of 6 mm squares that reaches 3 m around the middle of what moves; beyond, all is lit"
        ),
        Capability.TEXTURES: approximate("highlights are white and computed at corners; metals are drawn as paint"),
        Capability.RAY_TRACED_RGB: unsupported("MuJoCo rasterises"),
        Capability.CLOTH: approximate(
            "a flex that stretches and bends as the scene says, within 5 %; edges of solids poke through between its "
            "particles; its elasticity is integrated implicitly, which takes 9 % of a turning cloth's energy in a "
            "second; its friction creeps, a finger that opens may keep hold of it, and joint wrenches do not feel what "
            "touches it"
        ),
        Capability.ROPES: approximate(
            "a chain of stiff capsules on ball joints, which does not stretch, resists twist as it resists bending, "
            "does not roll, and does not meet the links that it is attached to in the scene; its friction creeps"
        ),
        Capability.SOFT_BODIES: approximate(
            "a flex that follows a grid of trilinear cells with incompatible modes: beams, blocks and grasps "
            "within 2 %; its elasticity is integrated implicitly, which stops a beam's swing in half a second; cells "
            "as coarse as those of a matter solver resist dents twice as much; what is soft on both sides sticks, and "
            "a solid does not meet itself; no contact pressures"
        ),
        Capability.DEPTH: approximate(SIMPLIFIED),
        Capability.GPU: unsupported("this backend simulates on the CPU"),
    }
)

_IMPLICIT = (
    "the elasticity of cloth is integrated implicitly, which damps waves and turning in first order: half as much at "
    "half the step"
)
_EDGE = "it is of first order in the step, with contacts of two steps' time constant: half as much at half the step"
_CORNERS = "a piece that comes on the edge meets it as a chord, and is pushed out over four steps: 3 to 20 % off"
_SOFT = "a rope's edges are constraints that act over several steps: they give way under a swing, and damp it"

_MATTER = (
    Gap("cloth_free", "angular_momentum", 0.9, _IMPLICIT),
    Gap("cloth_free", "energy", 0.14, _IMPLICIT),
    Gap("cloth_edge", "slid", 0.5, _EDGE),
    Gap("rope_edge", "slid", 0.25, _CORNERS),
    Gap("rope_bobs", "energy", 0.07, _SOFT),
    Gap("rope_bobs", "length", 0.04, _SOFT),
    Gap("rope_bobs", "folding", 0.8, _SOFT),
)

_DAMPED = (
    "the elasticity of solids is integrated implicitly, which damps swings in first order: a beam of 6 Hz keeps 0.3 % "
    "of its amplitude in 1.5 s at 5 ms, 6 % at 2.5 ms and 24 % at 1.25 ms"
)
_COARSE = (
    "cells of eight nodes dent in planes: a ball in 3 x 3 x 3 of them by half of what it should, in 4 x 4 x 4 and in "
    "8 x 8 x 8 by 80 %"
)
_CATCHES = "edges of two flexes' triangles catch each other: a soft block on a soft slab sticks where it should slide"
_CHATTERS = "contacts under a block that slides open and close from step to step, which is worth 1 % at 2.5 ms"
_NO_AREA = "MuJoCo's contacts are points, and have no area that a pressure could be of"

_SOLIDS = (
    Gap("solid_vibration", "frequency", 0.06, _DAMPED),
    Gap("solid_vibration", "decay", 1.8, _DAMPED),
    Gap("solid_vibration", "kept", 8.0, _DAMPED),
    Gap("solid_hertz", "approach", 0.65, _COARSE),
    Gap("solid_pressure", "flat", math.inf, _NO_AREA),
    Gap("solid_pressure", "round", math.inf, _NO_AREA),
    Gap("solid_slope", "acceleration", 0.12, _CHATTERS),
    Gap("solid_soft_slope", "acceleration", 1.2, _CATCHES),
    Gap("solid_ring", "open", 0.025, "a ring of 5 x 5 x 1 cells is too stiff to close: its hole is a corner of a cell"),
)

_PRISMS = (
    "MuJoCo collides a height field prism by prism, and feels the sides between them; fields of up to eight planes in "
    "all are made of their flat faces and are as level as a plane"
)

_FIELDS = (
    Gap("level_height_field", "speed", 0.12, _PRISMS),
    Gap("level_height_field", "turn", 0.1, _PRISMS),
    Gap("level_height_field", "way", 0.8, _PRISMS),
    Gap("level_height_field", "aside", 0.25, _PRISMS),
    Gap("height_field_bowl", "amplitude", 0.3, _PRISMS),
)

_IMAGES = (
    Gap("depth_images_of_dense_meshes", "depth", 0.012, SIMPLIFIED),
    Gap("depth_images_of_dense_meshes", "outline", 0.03, SIMPLIFIED),
)

GAPS: tuple[Gap, ...] = (*MOTION, *CONTACT, *_FIELDS, *_MATTER, *_SOLIDS, *_IMAGES)


class MujocoBackend(Backend):
    """MuJoCo on the CPU, one thread per core."""

    name: ClassVar[str] = "mujoco"
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = MujocoConfig

    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def gaps(self) -> tuple[Gap, ...]:
        return GAPS

    def versions(self) -> dict[str, str]:
        import importlib.metadata

        return {"mujoco": importlib.metadata.version("mujoco")}

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: MujocoConfig) -> Engine:
        if device.type != "cpu":
            raise ConfigurationError(f"backend 'mujoco' simulates on device 'cpu' only, not on '{device}'")
        from orbit_mujoco.engine import MujocoEngine

        return MujocoEngine(layout, num_envs, device, config)

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: MujocoConfig) -> Renderer:
        from orbit_mujoco.renderer import MujocoRenderer

        return MujocoRenderer(layout, cameras, config)
