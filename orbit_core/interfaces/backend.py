"""What a plugin registers under the entry-point group ``orbit.backends``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from orbit_core.interfaces.capabilities import Capabilities, DriveIntegration
from orbit_core.interfaces.errors import UnsupportedCapabilityError
from orbit_core.interfaces.gaps import Gap

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces.engine import Engine
    from orbit_core.interfaces.layout import SceneLayout
    from orbit_core.interfaces.renderer import Renderer
    from orbit_core.scene import CameraSpec


class Backend(ABC):
    """A physics engine, a renderer, or both. Importing and making one must not import the engine itself."""

    name: ClassVar[str]
    contract: ClassVar[tuple[int, int]]
    """Version of the contract (:data:`~orbit_core.interfaces.CONTRACT`) that the plugin was written for, as numbers of
    its own: ``contract = (1, 0)``. Checked when the plugin is loaded."""
    config_type: ClassVar[type]
    """The dataclass of the engine's own settings; every field has a default."""
    drive_integration: ClassVar[DriveIntegration] = DriveIntegration.IMPLICIT
    """How the engine integrates its own drives (:class:`~orbit_core.scene.ImplicitPd`), which the contract asks to be
    stable at any gain. The core refuses unstable gains of an engine that declares otherwise."""

    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What the engine can do, with reasons."""

    def gaps(self) -> tuple[Gap, ...]:
        """Metrics of the conformance scenarios that the engine is known to miss."""
        return ()

    def versions(self) -> dict[str, str]:
        """Installed distributions that results depend on, with their versions."""
        return {}

    @abstractmethod
    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: Any) -> Engine:
        """Build ``num_envs`` copies of the scene. ``config`` is of ``config_type``."""

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: Any) -> Renderer:
        """Build a renderer for the scene's looks.

        Raises:
            UnsupportedCapabilityError: the backend draws nothing.
        """
        raise UnsupportedCapabilityError(f"backend '{self.name}' has no renderer: choose another with renderer=...")
