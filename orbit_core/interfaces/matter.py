"""What a matter solver registers under the entry-point group ``orbit.matter``: cloth, rope and the like for any engine.

The core couples one with a physics engine at every physics step: poses of links go in, wrenches on links come out
(:mod:`orbit_core.world.coupling`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from orbit_core.interfaces.capabilities import Capabilities
from orbit_core.interfaces.errors import UnsupportedCapabilityError
from orbit_core.interfaces.gaps import Gap

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from orbit_core.interfaces.built import Approximation
    from orbit_core.interfaces.layout import SceneLayout
    from orbit_core.interfaces.renderer import Image
    from orbit_core.scene import CameraSpec

NATIVE = "native"
"""Stands for the physics engine's own matter where the name of a solver is expected."""


class Matter(ABC):
    """The deformables of N environments of one scene.

    State tensors are float32 on the world's device, in each environment's own world frame, and may be the solver's own
    buffers: read only, valid until the next step or write. ``env_ids`` are int64 indices (n,), a mask (N,) bool with
    values of all environments, or None for all. The solver trusts its caller, as an engine does.
    """

    @abstractmethod
    def positions(self, deformable: int) -> Tensor:
        """(N, P, 3) m of the scene's deformable of that index."""

    @abstractmethod
    def velocities(self, deformable: int) -> Tensor:
        """(N, P, 3) m/s."""

    @abstractmethod
    def write(self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None) -> None:
        """Set (n, P, 3) positions and velocities."""

    @abstractmethod
    def anchor(
        self, deformable: int, particles: Tensor, link: int | None, link_poses: Tensor, env_ids: Tensor | None = None
    ) -> None:
        """Hold particles (k,) where they are to a link, at ``link_poses`` (N, L, 7), or to the world if None."""

    @abstractmethod
    def release(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        """Let particles (k,) go, of which some may not be held."""

    @abstractmethod
    def set_parameter(self, deformable: int, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        """Set (n,) of one of :data:`PARAMETERS`; outlasts resets."""

    @abstractmethod
    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        """Gravity (n, 3) in m/s^2."""

    @abstractmethod
    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        """Friction (n, k) of all shapes of links (k,); index TERRAIN sets the terrain's."""

    @abstractmethod
    def reset(self, link_poses: Tensor, env_ids: Tensor | None = None) -> None:
        """Put environments, with links at ``link_poses`` (N, L, 7), into the initial state; what is held stays held."""

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        """Masses (n, k) in kg of links (k,), with which inertias scale; for who reckons with those of free bodies."""

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        """Centres of mass (n, k, 3) in the link frames of links (k,); the same."""

    @abstractmethod
    def step(
        self,
        before: Tensor,
        after: Tensor,
        velocities: tuple[Tensor, Tensor] | None = None,
        wrenches: Tensor | None = None,
    ) -> None:
        """Advance by one physics step.

        Args:
            before: poses of links at its beginning, (N, L, 7).
            after: poses of links at its end, (N, L, 7).
            velocities: at its beginning and end, (N, L, 6) each as of :attr:`Engine.link_velocities`; given in scenes
                with free bodies.
            wrenches: that users have set, (N, L, 6) about the links' centres of mass in world axes.
        """

    @property
    @abstractmethod
    def wrenches(self) -> Tensor:
        """(N, L, 6) wrench about the link frame's origin, world axes, that the engine applies in its next step.

        Of links that the solver moves with its own equations it is the wrench that makes the engine's follow; of
        others the mean that matter exerted in the last step.
        """

    @property
    @abstractmethod
    def contact_forces(self) -> Tensor:
        """(N, D, L, 3) newtons that each deformable exerts on each link, in world axes, mean of the last step."""

    @abstractmethod
    def diverged(self) -> Tensor:
        """(N, D) bool: which deformables are beyond the bounds of :mod:`orbit_core.interfaces.divergence`."""

    @abstractmethod
    def save_state(self) -> Any:
        """Everything that the continuation depends on, detached."""

    @abstractmethod
    def load_state(self, state: Any) -> None:
        """Return to a saved state."""

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        """What the solver could not take exactly as the scene asked."""
        return ()

    def close(self) -> None:
        """Free what it holds; idempotent."""


class MatterPainter(ABC):
    """Paints deformables into the pictures of any renderer."""

    @abstractmethod
    def paint(self, camera: CameraSpec, camera_poses: Tensor, vertices: Sequence[Tensor], image: Image) -> Image:
        """The image with deformables over what lies behind them.

        Args:
            camera: that took it.
            camera_poses: (n, 7) in each environment's frame, -z forward, y up.
            vertices: (n, V, 3) of each deformable's surface
                (:class:`orbit_core.plugin_kit.deformable_surface.DeformableSurface`), in the environment's frame.
            image: with depth; its other fields may be None, and stay so. In ``links`` a deformable has the number of
                links plus its own index.
        """


PARAMETERS = ("density", "stiffness", "bending", "friction")
"""Of a deformable in one environment: scales of mass, of membrane or axial stiffness and of bending stiffness, whose
nominal value is 1, and the coefficient of friction itself."""


class MatterSolver(ABC):
    """A plugin that makes :class:`Matter`. Importing and making one must not import what it computes with."""

    name: ClassVar[str]
    contract: ClassVar[tuple[int, int]]
    """Version of the contract that the plugin was written for, as of a :class:`~orbit_core.interfaces.Backend`."""
    config_type: ClassVar[type]
    """The dataclass of the solver's own settings; every field has a default."""

    @abstractmethod
    def capabilities(self) -> Capabilities:
        """What of :data:`~orbit_core.interfaces.capabilities.MATTER` it can do, with reasons."""

    def gaps(self) -> tuple[Gap, ...]:
        """Metrics of the conformance scenarios of matter that it is known to miss, on every engine."""
        return ()

    def settings_at(self, substep: float) -> Mapping[str, Any]:
        """Its settings that make it compute in steps of at most ``substep`` seconds; empty where it has no such steps.

        The conformance suite shows by them what accuracy costs.
        """
        return {}

    def versions(self) -> dict[str, str]:
        """Installed distributions that results depend on, with their versions."""
        return {}

    def create_painter(self, layout: SceneLayout, device: torch.device) -> MatterPainter:
        """What paints deformables into other renderers' pictures.

        Raises:
            UnsupportedCapabilityError: the solver draws nothing.
        """
        raise UnsupportedCapabilityError(f"matter solver '{self.name}' draws no deformables")

    @abstractmethod
    def create(self, layout: SceneLayout, num_envs: int, device: torch.device, config: Any) -> Matter:
        """Make the deformables of ``num_envs`` copies of the scene. ``config`` is of ``config_type``."""
