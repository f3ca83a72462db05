"""What the plugin registers."""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from orbit_core.interfaces import (
    EXACT,
    Backend,
    Capabilities,
    Capability,
    ConfigurationError,
    Gap,
    approximate,
    unsupported,
)

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import Engine, SceneLayout

_EXACT = (
    Capability.ARTICULATIONS, Capability.EFFORT_LIMITS, Capability.JOINT_DAMPING, Capability.JOINT_SPRINGS,
    Capability.MASSLESS_LINKS,
    Capability.JOINT_FRICTION, Capability.ARMATURE, Capability.SELF_COLLISIONS, Capability.GRAVITY_COMPENSATION,
    Capability.CONTACT_FORCES, Capability.FRICTION_FORCES, Capability.EXTERNAL_WRENCHES, Capability.RAY_CASTS,
    Capability.RANDOMIZE_MASS, Capability.RANDOMIZE_CENTER_OF_MASS, Capability.RANDOMIZE_FRICTION,
    Capability.RANDOMIZE_GAINS, Capability.RANDOMIZE_GRAVITY, Capability.SNAPSHOTS,
)  # fmt: skip
_FIRST_ORDER = "drives are integrated by implicit Euler, whose error is in proportion to the time step"
_MIDPOINT = (
    "the midpoint rule keeps the angular momentum and not the energy; a turn of 1.5 rad in a step is too much for it"
)
_ITERATIONS = "its descent ends after 60 iterations, which leave some creep where much weight hangs on a grip"
_SETTLING = (
    "its descent begins each step with the impulses of the one before, and still moves under loads that are uneven"
)
_ROUNDED = "a run repeats with the same number of environments; with another, sums may be rounded another way"
_LANES = "sums are rounded by an environment's place in the batch, so a copy may part from its source in the last bit"
_BALLS = (
    "shapes meet at balls, ends, corners and middles of edges; two edges that cross elsewhere pass through each other, "
    "and cylinders and meshes are refused"
)


@dataclass(frozen=True)
class TorchConfig:
    """The engine's own settings: none."""


class TorchBackend(Backend):
    """Free bodies and fixed-base articulations with drives, stops, friction and contacts."""

    name: ClassVar[str] = "torch"
    contract: ClassVar[tuple[int, int]] = (1, 0)
    config_type: ClassVar[type] = TorchConfig

    def capabilities(self) -> Capabilities:
        declared = {capability: unsupported("the example does without") for capability in Capability}
        declared |= dict.fromkeys(_EXACT, EXACT)
        declared[Capability.DETERMINISTIC] = approximate(_ROUNDED)
        declared[Capability.COPIED_STATES] = approximate(_LANES)
        declared[Capability.FRICTION] = approximate(_BALLS)
        declared[Capability.IMPLICIT_DRIVES] = approximate(_FIRST_ORDER)
        return Capabilities(declared)

    def gaps(self) -> tuple[Gap, ...]:
        return (
            Gap("implicit_drive", "under", 0.06, _FIRST_ORDER),
            Gap("implicit_drive", "damped", 0.03, _FIRST_ORDER),
            Gap("implicit_drive", "final", 0.015, _FIRST_ORDER),
            Gap("drive_frequencies", "response", 0.45, _FIRST_ORDER),
            Gap("velocity_told", "resting", 0.05, _SETTLING),
            Gap("fast_spin", "energy", 3.0, _MIDPOINT),
            Gap("fast_spin", "axis", 3.2, _MIDPOINT),
            Gap("pivot_in_a_grip", "slip", 0.006, _ITERATIONS),
            Gap("alone_and_among_seven", "difference", 1e-6, _ROUNDED),
        )

    def versions(self) -> dict[str, str]:
        return {"orbit-torch": importlib.metadata.version("orbit-torch")}

    def create_engine(self, layout: SceneLayout, num_envs: int, device: torch.device, config: TorchConfig) -> Engine:
        if device.type != "cpu":
            raise ConfigurationError(f"backend 'torch' simulates on device 'cpu' only, not on '{device}'")
        from orbit_torch.engine import TorchEngine

        return TorchEngine(layout, num_envs, device)
