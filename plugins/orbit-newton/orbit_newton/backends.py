"""Backends that the plugin registers, one for each solver. Newton is imported only when an engine is made."""

from __future__ import annotations

import importlib.metadata
from typing import TYPE_CHECKING, Any, ClassVar

from orbit_core.interfaces import Backend, Capabilities, ConfigurationError, Gap
from orbit_newton.capabilities import FEATHERSTONE, XPBD
from orbit_newton.config import FeatherstoneConfig, NewtonConfig, XpbdConfig
from orbit_newton.gaps import FEATHERSTONE_GAPS, XPBD_GAPS

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, SceneLayout
    from orbit_newton.plant import Dynamics


class NewtonBackend(Backend):
    """One of Newton's solvers, on ``cpu`` or ``cuda``."""

    contract: ClassVar[tuple[int, int]] = (1, 0)
    solver_capabilities: ClassVar[Capabilities]
    """Declared capabilities of the solver."""
    solver_gaps: ClassVar[tuple[Gap, ...]]
    """Declared gaps of the solver."""

    def capabilities(self) -> Capabilities:
        return self.solver_capabilities

    def gaps(self) -> tuple[Gap, ...]:
        return self.solver_gaps

    def versions(self) -> dict[str, str]:
        return {name: importlib.metadata.version(name) for name in ("newton", "warp-lang")}

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: NewtonConfig) -> Engine:
        if device.type not in ("cpu", "cuda"):
            raise ConfigurationError(f"backend '{self.name}' simulates on devices 'cpu' and 'cuda', not on '{device}'")
        from orbit_newton.engine import NewtonEngine

        return NewtonEngine(layout, num_envs, device, config, self.dynamics(), self.capabilities())

    def dynamics(self) -> type[Dynamics]:
        """The solver, which is imported now."""
        raise NotImplementedError


class FeatherstoneBackend(NewtonBackend):
    """Reduced coordinates, explicit contact forces."""

    name: ClassVar[str] = "newton-featherstone"
    config_type: ClassVar[type[Any]] = FeatherstoneConfig
    solver_capabilities = FEATHERSTONE
    solver_gaps = FEATHERSTONE_GAPS

    def dynamics(self) -> type[Dynamics]:
        from orbit_newton.featherstone import FeatherstoneDynamics

        return FeatherstoneDynamics


class XpbdBackend(NewtonBackend):
    """Positions of free bodies, corrected constraint by constraint."""

    name: ClassVar[str] = "newton-xpbd"
    config_type: ClassVar[type[Any]] = XpbdConfig
    solver_capabilities = XPBD
    solver_gaps = XPBD_GAPS

    def dynamics(self) -> type[Dynamics]:
        from orbit_newton.xpbd import XpbdDynamics

        return XpbdDynamics
