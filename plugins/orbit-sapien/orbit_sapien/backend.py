"""Backend that the plugin registers. SAPIEN is imported only when an engine or a renderer is made."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_core.interfaces import Backend, Capabilities, ConfigurationError, Gap, UnsupportedCapabilityError
from orbit_sapien.capabilities import CAPABILITIES, FAST_IMAGES, PBR_IMAGES, TRACED_IMAGES
from orbit_sapien.config import PathConfig, RasterConfig, SapienConfig
from orbit_sapien.gaps import GAPS

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec


class SapienBackend(Backend):
    """PhysX 5 on the CPU."""

    name: ClassVar[str] = "sapien"
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = SapienConfig

    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def gaps(self) -> tuple[Gap, ...]:
        return GAPS

    def versions(self) -> dict[str, str]:
        import importlib.metadata

        return {"sapien": importlib.metadata.version("sapien")}

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: SapienConfig) -> Engine:
        if device.type == "cuda":
            from orbit_sapien.gpu_engine import SapienGpuEngine

            return SapienGpuEngine(layout, num_envs, device, config)
        if device.type != "cpu":
            raise ConfigurationError(f"backend '{self.name}' simulates on device 'cpu' or 'cuda', not on '{device}'")
        from orbit_sapien.engine import SapienEngine

        return SapienEngine(layout, num_envs, device, config)

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: SapienConfig) -> Renderer:
        from orbit_sapien.renderer import SapienRenderer

        return SapienRenderer(layout, cameras, config)


class _Tier(SapienBackend):
    """One tier of the renderer under a separate name, for worlds that any backend simulates."""

    tier: ClassVar[str]
    config_type: ClassVar[type] = RasterConfig

    def capabilities(self) -> Capabilities:
        return FAST_IMAGES

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: SapienConfig) -> Engine:
        raise UnsupportedCapabilityError(f"'{self.name}' draws and simulates nothing: use backend 'sapien' for physics")

    def create_renderer(
        self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: RasterConfig | PathConfig
    ) -> Renderer:
        return super().create_renderer(layout, cameras, SapienConfig(tier=self.tier, **dataclasses.asdict(config)))


class SapienFast(_Tier):
    """Rasterised, by Lambert's law, with shadows."""

    name, tier = "sapien-fast", "fast"


class SapienPbr(_Tier):
    """Rasterised with physically based materials."""

    name, tier = "sapien-pbr", "pbr"

    def capabilities(self) -> Capabilities:
        return PBR_IMAGES


class SapienRt(_Tier):
    """Traced paths."""

    name, tier = "sapien-rt", "rt"
    config_type: ClassVar[type] = PathConfig

    def capabilities(self) -> Capabilities:
        return TRACED_IMAGES
