"""What the plugin registers. SAPIEN is imported only when an engine or a renderer is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_core.interfaces import Backend, Capabilities, ConfigurationError
from orbit_sapien.capabilities import CAPABILITIES
from orbit_sapien.config import SapienConfig

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec


class SapienBackend(Backend):
    """PhysX 5 on the CPU."""

    name: ClassVar[str] = "sapien"
    config_type: ClassVar[type] = SapienConfig

    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def versions(self) -> dict[str, str]:
        import importlib.metadata

        return {"sapien": importlib.metadata.version("sapien")}

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: SapienConfig) -> Engine:
        if device.type != "cpu":
            raise ConfigurationError(f"backend '{self.name}' simulates on device 'cpu' only, not on '{device}'")
        from orbit_sapien.engine import SapienEngine

        return SapienEngine(layout, num_envs, device, config)

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: SapienConfig) -> Renderer:
        from orbit_sapien.renderer import SapienRenderer

        return SapienRenderer(layout, cameras, config)
