"""Backend that the plugin registers: its capabilities, its declared gaps, and its engines. Warp is imported only when
an engine or a renderer is made.
"""

from __future__ import annotations

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
from orbit_mjmodel.capabilities import shared_support
from orbit_mjmodel.gaps import CONTACT, MOTION
from orbit_warp.config import WarpConfig

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec

CAPABILITIES = Capabilities(
    shared_support("MuJoCo-Warp")
    | {
        Capability.SIGNED_DISTANCE_FIELDS: approximate(
            "as MuJoCo's, in single precision: contacts are found by descent from 40 points, none left out where they "
            "meet; the lead of a screw of 4 mm came to 4.16 mm, on a CPU; convex meshes of other bodies pass through"
        ),
        Capability.HEIGHT_FIELDS: approximate(
            "balls meet the surface itself; other shapes meet it prism by prism, whose sides are felt: on a level "
            "floor of cells of 0.1 m a box stops after 0.55 to 0.95 of its way; exact where the whole field has no "
            "more than eight planes"
        ),
        Capability.COPIED_STATES: approximate("contacts begin anew: what follows differs a little where things touch"),
        Capability.DETERMINISTIC: approximate(
            "bit for bit on a CPU; on a GPU only with WarpConfig(deterministic=True), for sums run in any order"
        ),
        Capability.SHADOWS: EXACT,
        Capability.TEXTURES: approximate("surfaces have no highlights; of textures, only those of ground are filtered"),
        Capability.RAY_TRACED_RGB: approximate("direct light and its shadows: no reflections, no light from surfaces"),
        Capability.GPU: EXACT,
        Capability.CLOTH: unsupported(
            "MuJoCo-Warp's kernels of flexes had not compiled after 240 s on an H200, and are not connected to this "
            "backend"
        ),
        Capability.ROPES: unsupported(
            "chains of capsules, which could stand for ropes, are not connected to this backend"
        ),
    }
)

_TURNING = (
    "in single precision the contact points of a cylinder on its end turn about its axis from step to step, and it "
    "trembles"
)

_CONTACT = (
    *(gap for gap in CONTACT if gap.scenario != "stick_and_slip"),
    Gap("stick_and_slip", "creep", 0.2, _TURNING),
    Gap("stick_and_slip", "friction", 0.2, _TURNING),
)

_STIFF_NUTATION = (
    "in single precision rounding excites the nutation at each step, which a first-order step of 17 degrees of spin "
    "barely holds"
)

_GYROSCOPE = (
    Gap("gyroscope", "precession", 0.03, _STIFF_NUTATION),
    Gap("gyroscope", "level", 0.05, _STIFF_NUTATION),
    Gap("gyroscope", "spin", 2e-4, _STIFF_NUTATION),
)

_PRISMS = (
    "shapes other than balls meet a height field prism by prism, and feel the sides between them; fields of up to "
    "eight planes in all are made of their flat faces and are as level as a plane"
)
_SINGLE = "a stiff contact is solved in single precision, whose rounding the two of a pair do not share"

_MORE = (
    Gap("level_height_field", "way", 0.7, _PRISMS),
    Gap("level_height_field", "aside", 0.25, _PRISMS),
    Gap("collision_chain", "momentum", 2e-4, _SINGLE),
    Gap("unequal_collision", "momentum", 2e-4, _SINGLE),
)

GAPS: tuple[Gap, ...] = (*MOTION, *_CONTACT, *_MORE, *_GYROSCOPE)

_DEVICES = ("cpu", "cuda")


class WarpBackend(Backend):
    """MuJoCo's dynamics in Warp kernels, on ``cpu`` or ``cuda``."""

    name: ClassVar[str] = "warp"
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = WarpConfig

    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def gaps(self) -> tuple[Gap, ...]:
        return GAPS

    def versions(self) -> dict[str, str]:
        import importlib.metadata

        return {name: importlib.metadata.version(name) for name in ("warp-lang", "mujoco-warp", "mujoco")}

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: WarpConfig) -> Engine:
        if device.type not in _DEVICES:
            raise ConfigurationError(f"backend 'warp' simulates on devices 'cpu' and 'cuda', not on '{device}'")
        from orbit_warp.engine import WarpEngine

        return WarpEngine(layout, num_envs, device, config)

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: WarpConfig) -> Renderer:
        from orbit_warp.renderer import WarpRenderer

        return WarpRenderer(layout, config)
