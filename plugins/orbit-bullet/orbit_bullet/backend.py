"""Backend that the plugin registers. Bullet is imported only when an engine or a renderer is made."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_bullet.capabilities import CAPABILITIES
from orbit_bullet.config import BulletConfig
from orbit_bullet.gaps import GAPS
from orbit_core.interfaces import Backend, Capabilities, ConfigurationError, Gap

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec

DISTRIBUTIONS = ("pybullet", "pybullet-arm64")
"""Any of them brings the module ``pybullet``."""


class BulletBackend(Backend):
    """Bullet on the CPU, one process per core."""

    name: ClassVar[str] = "bullet"
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = BulletConfig

    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def gaps(self) -> tuple[Gap, ...]:
        return GAPS

    def versions(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for name in DISTRIBUTIONS:
            try:
                found[name] = importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                continue
        return found

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: BulletConfig) -> Engine:
        if device.type != "cpu":
            raise ConfigurationError(f"backend 'bullet' simulates on device 'cpu' only, not on '{device}'")
        from orbit_bullet.engine import BulletEngine

        return BulletEngine(layout, num_envs, device, config)

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: BulletConfig) -> Renderer:
        from orbit_bullet.renderer import BulletRenderer

        return BulletRenderer(layout, cameras, config)
