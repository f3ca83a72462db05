"""Interface of a backend plugin, which registers under the entry-point group ``orbit.backends``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from orbit_core.interfaces.capabilities import Capabilities, DriveIntegration, Gap
from orbit_core.interfaces.errors import UnsupportedCapabilityError

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces.engine import Engine
    from orbit_core.interfaces.layout import SceneLayout
    from orbit_core.interfaces.renderer import Renderer
    from orbit_core.scene import CameraSpec


# Version of the contract between the core and plugins -----------------------------------------------------------------
# A plugin states the version that it was written for, as plain numbers: ``contract = (1, 0)``. The core checks it
# when the plugin is loaded, before any engine is built.

CONTRACT = (1, 0)
"""Version of this core, major and minor: it accepts plugins of the same major number and of no later minor number.

The major number grows with a change that breaks plugins, the minor with an addition that plugins may need.
"""


def contract_text(version: tuple[int, int]) -> str:
    """Return a version as text, such as ``"1.0"``."""
    return ".".join(map(str, version))


class Backend(ABC):
    """A physics engine, a renderer, or both. Importing and making one must not import the engine itself."""

    name: ClassVar[str]
    """Name in commands, settings and entry points."""
    contract: ClassVar[tuple[int, int]]
    """Version of the contract (:data:`~orbit_core.interfaces.CONTRACT`) that the plugin was written for, as numbers of
    its own: ``contract = (1, 0)``. Checked when the plugin is loaded."""
    simulates: ClassVar[bool] = True
    """False for a robot's computer: what it drives is built already, and is not compared with the scene."""
    # A class and not an instance, so that commands list its fields without making a backend.
    config_type: ClassVar[type]
    """The dataclass of the engine's own settings; every field has a default."""
    # Declared by the class, so that the core can refuse unstable gains before it builds anything.
    drive_integration: ClassVar[DriveIntegration] = DriveIntegration.IMPLICIT
    """How the engine integrates its own drives (:class:`~orbit_core.scene.ImplicitPd`), which the contract asks to be
    stable at any gain. The core refuses unstable gains of an engine that declares otherwise."""

    @abstractmethod
    def capabilities(self) -> Capabilities:
        """Return the capabilities of the engine, with reasons for what is missing or approximate."""

    def gaps(self) -> tuple[Gap, ...]:
        """Return metrics of the conformance scenarios that the engine is known to miss."""
        return ()

    def versions(self) -> dict[str, str]:
        """Return installed distributions that results depend on, with their versions."""
        return {}

    @abstractmethod
    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: Any) -> Engine:
        """Build an engine.

        Args:
            layout: of the scene.
            num_envs: copies of the scene to build.
            device: where state tensors live.
            config: settings, an instance of ``config_type``.
        """

    def create_renderer(self, layout: SceneLayout, cameras: Sequence[CameraSpec], config: Any) -> Renderer:
        """Build a renderer of the scene.

        Args:
            layout: of the scene.
            cameras: that pictures will be rendered for.
            config: settings, an instance of ``config_type``.

        Raises:
            UnsupportedCapabilityError: the backend draws nothing.
        """
        # Not abstract: an engine without a renderer is complete, and its scenes are drawn by another plugin.
        raise UnsupportedCapabilityError(f"backend '{self.name}' has no renderer: choose another with renderer=...")
