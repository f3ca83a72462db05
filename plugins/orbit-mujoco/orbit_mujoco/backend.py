"""Backend that the plugin registers. MuJoCo is imported only when an engine or a renderer is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from orbit_core.interfaces import Backend, Capabilities, ConfigurationError, Gap
from orbit_mujoco.capabilities import CAPABILITIES
from orbit_mujoco.config import MujocoConfig
from orbit_mujoco.gaps import GAPS

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, Renderer, SceneLayout
    from orbit_core.scene import CameraSpec


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
