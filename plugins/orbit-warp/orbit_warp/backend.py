"""Backend that the plugin registers. Warp is imported only when an engine or a renderer is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_core.interfaces import Backend, Capabilities, ConfigurationError, Gap
from orbit_warp.capabilities import CAPABILITIES
from orbit_warp.config import WarpConfig
from orbit_warp.gaps import GAPS

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec

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
