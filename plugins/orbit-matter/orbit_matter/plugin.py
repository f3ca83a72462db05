"""Matter solver registered under the ``orbit.matter`` entry point."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from orbit_core.interfaces.capabilities import EXACT, Capabilities, Capability, Gap, approximate
from orbit_core.interfaces.matter import Matter, MatterPainter, MatterSolver
from orbit_matter.config import MatterConfig

if TYPE_CHECKING:
    import torch

    from orbit_core.interfaces import SceneLayout

_DECLARED = {
    Capability.CLOTH: approximate(
        "solids meet its particles and not its triangles, so that edges and corners finer than the mesh poke through; "
        "it is flat at rest, and one that touches itself is kept apart by its particles' distances"
    ),
    Capability.ROPES: approximate(
        "it does not resist twist, and solids meet its particles only; free bodies are solved together with it, and "
        "links of articulations and bodies that the engine holds feel it one physics step late; what goes slack and "
        "folds loses energy: with a bob let go at 90 degrees 4 % in 3 s where the rope weighs a twentieth of it, up to "
        "half where it weighs more"
    ),
    Capability.SOFT_BODIES: approximate(
        "a beam of the default resolution droops 2 % too much at most, and strains of more than 30 % are too soft; it "
        "meets links, terrain, other soft bodies and itself by points of its surface, and particles of cloth and "
        "ropes; links feel it one physics step late, and free bodies lighter than a third of it may hop on it"
    ),
    Capability.FLUIDS: approximate(
        "a liquid is particles of one spacing: of six layers of them the volume at rest is within 2 %, forces on floor "
        "and sides within 1 %, sloshing loses a seventh of its amplitude in half a period, holes should be four "
        "spacings wide; it does not wet, has no surface tension, is at least as thick as 0.15 Pa s at a spacing of 1 "
        "cm and meets no cloth, rope or soft body; a ball sinks in honey by a quarter too slowly; links feel it one "
        "physics step late; the draught of a raft is within a tenth; curved links of robots, and curved objects longer "
        "than 24 spacings, feel it as by the planes behind their nearest points, 30 % too strongly on balls 3 spacings "
        "wide"
    ),
    Capability.GPU: EXACT,
    Capability.SNAPSHOTS: EXACT,
}

_GAPS = (
    Gap(
        "solid_pressure",
        "round",
        0.6,
        "elements twice as wide as the contact's radius carry it on fewer of the surface's points than Hertz' law",
    ),
    Gap(
        "rope_bobs",
        "folding",
        0.8,
        "folds that are finer than a rope's edges, and its contacts with itself, lose energy",
    ),
)


class OrbitMatter(MatterSolver):
    """Cloth and rope by small-step XPBD, elastic solids by implicit finite elements, liquids by particles."""

    name = "orbit-matter"
    """Name in ``orbit list``, in settings and in the ``orbit.matter`` entry points."""
    contract = (1, 0)
    config_type = MatterConfig

    def capabilities(self) -> Capabilities:
        return Capabilities(_DECLARED)

    def gaps(self) -> tuple[Gap, ...]:
        return _GAPS

    def settings_at(self, substep: float) -> Mapping[str, Any]:
        return {"substep": substep}

    def versions(self) -> dict[str, str]:
        return {"warp-lang": version("warp-lang")}

    def create_painter(self, layout: SceneLayout, device: torch.device) -> MatterPainter:
        # Imported here: Warp starts when a world is made, not when plugins are listed.
        from orbit_matter.painting import Painter

        return Painter(layout, device)

    def create(self, layout: SceneLayout, num_envs: int, device: torch.device, config: MatterConfig) -> Matter:
        from orbit_matter.matter import ParticleMatter

        return ParticleMatter(layout, num_envs, device, config)
