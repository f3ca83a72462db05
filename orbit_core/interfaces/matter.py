"""Interface of a matter solver, which registers under ``orbit.matter``: cloth, rope and the like for any engine.

The core couples one with a physics engine at every physics step: poses of links go in, wrenches on links come out
(:mod:`orbit_core.world.matter`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from orbit_core.interfaces.capabilities import Capabilities, Gap
from orbit_core.interfaces.errors import UnsupportedCapabilityError

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from orbit_core.interfaces.layout import Approximation, SceneLayout
    from orbit_core.interfaces.renderer import Image, LightTable
    from orbit_core.scene import CameraSpec

# A plugin that registers under this name can never be chosen.
NATIVE = "native"
"""Name of the physics engine's own deformables where the name of a solver is expected."""


class Matter(ABC):
    """The deformables of N environments of one scene.

    State tensors are float32 on the world's device, in each environment's own world frame, and may be the solver's own
    buffers: read only, valid until the next step or write. ``env_ids`` are int64 indices (n,), a mask (N,) bool with
    values of all environments, or None for all. The solver trusts its caller, as an engine does.
    """

    @abstractmethod
    def positions(self, deformable: int) -> Tensor:
        """Return (N, P, 3) m of the scene's deformable of that index."""

    @abstractmethod
    def velocities(self, deformable: int) -> Tensor:
        """Return (N, P, 3) m/s."""

    @abstractmethod
    def write(self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None) -> None:
        """Set (n, P, 3) positions and velocities."""

    @abstractmethod
    def anchor(
        self, deformable: int, particles: Tensor, link: int | None, link_poses: Tensor, env_ids: Tensor | None = None
    ) -> None:
        """Hold particles where they are to a link, or to the world.

        Args:
            deformable: index in the scene.
            particles: (k,) indices.
            link: index of the layout; the world if None.
            link_poses: (N, L, 7) present poses of all links.
            env_ids: environments; all if None.
        """

    @abstractmethod
    def release(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        """Release particles (k,), some of which may not be held."""

    @abstractmethod
    def set_parameter(self, deformable: int, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        """Set (n,) of one of :data:`PARAMETERS`; outlasts resets."""

    @abstractmethod
    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        """Set gravity (n, 3) in m/s^2."""

    @abstractmethod
    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        """Set friction (n, k) of all shapes of links (k,); index TERRAIN sets the terrain's."""

    @abstractmethod
    def reset(self, link_poses: Tensor, env_ids: Tensor | None = None) -> None:
        """Put environments, with links at ``link_poses`` (N, L, 7), into the initial state; what is held stays held."""

    # Not abstract: solvers without free bodies need neither masses nor centres of mass.
    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        """Set masses (n, k) in kg of links (k,); inertias scale with them. Solvers that move free bodies need them."""

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        """Set centres of mass (n, k, 3) in the link frames of links (k,). Solvers that move free bodies need them."""

    @abstractmethod
    def step(
        self,
        # Both ends of the step, so that a solver with smaller steps can interpolate the links' motion.
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
        """Wrenches (N, L, 6) that the engine applies in its next step, about the links' origins, world axes.

        For links that the solver moves with its own equations it is the wrench that makes the engine's follow; for
        others the mean that matter exerted in the last step.
        """

    @property
    @abstractmethod
    def contact_forces(self) -> Tensor:
        """Forces (N, D, L, 3) of each deformable on each link, mean of the last step: newtons, world axes."""

    # Not abstract: only solvers whose contacts have an area have pressures.
    def contact_pressures(self, deformable: int) -> Tensor:
        """Return (N, L) Pa with which a deformable presses on each link: normal force over area, last step's end.

        Raises:
            UnsupportedCapabilityError: the solver has none of this deformable.
        """
        raise UnsupportedCapabilityError(
            f"{type(self).__name__} computes no pressure of deformable {deformable}: it is no soft body, or the solver "
            "reports forces only"
        )

    @abstractmethod
    def diverged(self) -> Tensor:
        """Return (N, D) bool: which deformables are beyond the bounds of :mod:`orbit_core.interfaces.errors`."""

    @abstractmethod
    def save_state(self) -> Any:
        """Return a detached copy of all that the continuation depends on."""

    @abstractmethod
    def load_state(self, state: Any) -> None:
        """Return to a saved state."""

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        """Parts of the scene that the solver approximates."""
        # Empty by default: a report lists differences only.
        return ()

    def close(self) -> None:
        """Free its resources; idempotent."""


@dataclass(frozen=True, eq=False)
class LightView:
    """Depth image of everything but deformables, as one directional light that casts shadows meets it."""

    light: int
    """Index among the scene's directional lights."""
    camera: CameraSpec
    """So far away that its rays are all but parallel."""
    poses: Tensor
    """(n, 7) of the camera in each environment's frame."""
    depth: Tensor
    """(n, H, W, 1) m, infinite where nothing is met."""


# Separate from the solver: renderers of other plugins know rigid shapes only.
class MatterPainter(ABC):
    """Paints deformables into the pictures of any renderer."""

    @abstractmethod
    def paint(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        vertices: Sequence[Tensor],
        image: Image,
        lights: LightTable,
        views: Sequence[LightView] = (),
    ) -> Image:
        """Return the image with deformables drawn over what is behind them, and their shadows.

        Args:
            camera: that took it.
            camera_poses: (n, 7) in each environment's frame, -z forward, y up.
            vertices: (n, V, 3) of each deformable's surface
                (:class:`orbit_core.plugin_kit.rendering.DeformableSurface`), in the environment's frame.
            image: with depth; its other fields may be None, and stay so. In ``links`` a deformable has the number of
                links plus its own index.
            lights: of the n environments.
            views: of the lights whose shadows deformables cast and receive; the image then has colour, normals and
                albedo.
        """


PARAMETERS = ("density", "stiffness", "bending", "friction")
"""Parameters of a deformable in one environment: scales of mass, of membrane or axial stiffness and of bending
stiffness, whose nominal value is 1, and the coefficient of friction."""


class MatterSolver(ABC):
    """A plugin that makes :class:`Matter`. Importing and making one must not import the solver's libraries."""

    name: ClassVar[str]
    """Name in commands, settings and entry points."""
    contract: ClassVar[tuple[int, int]]
    """Version of the contract that the plugin was written for, as of a :class:`~orbit_core.interfaces.Backend`."""
    config_type: ClassVar[type]
    """The dataclass of the solver's own settings; every field has a default."""

    @abstractmethod
    def capabilities(self) -> Capabilities:
        """Return its capabilities among :data:`~orbit_core.interfaces.capabilities.MATTER`, with reasons."""

    def gaps(self) -> tuple[Gap, ...]:
        """Return metrics of the conformance scenarios of matter that it is known to miss, on every engine."""
        return ()

    def settings_at(self, substep: float) -> Mapping[str, Any]:
        """Return settings with which it computes in steps of at most ``substep`` seconds; empty if it has no steps.

        The conformance suite shows by them what accuracy costs.
        """
        return {}

    def versions(self) -> dict[str, str]:
        """Return installed distributions that results depend on, with their versions."""
        return {}

    def create_painter(self, layout: SceneLayout, device: torch.device) -> MatterPainter:
        """Return a painter of deformables for the pictures of other renderers.

        Raises:
            UnsupportedCapabilityError: the solver draws nothing.
        """
        # The engine's own renderer may draw them, so that a solver without a painter is still of use.
        raise UnsupportedCapabilityError(f"matter solver '{self.name}' draws no deformables")

    @abstractmethod
    def create(self, layout: SceneLayout, num_envs: int, device: torch.device, config: Any) -> Matter:
        """Make the deformables of all environments.

        Args:
            layout: of the scene.
            num_envs: copies of the scene.
            device: of all tensors.
            config: settings, an instance of ``config_type``.
        """
