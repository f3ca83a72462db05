"""Ground that robots walk on: kinds of surfaces, and a grid of them from easy to difficult."""

from orbit_assets.terrain.grid import (
    Boxes,
    Flat,
    Gap,
    Pit,
    Rough,
    Slope,
    Span,
    Stairs,
    SteppingStones,
    Surface,
    TerrainForm,
    TerrainGrid,
    TerrainKind,
    Waves,
)

__all__ = [
    "Boxes", "Flat", "Gap", "Pit", "Rough", "Slope", "Span", "Stairs", "SteppingStones", "Surface", "TerrainForm",
    "TerrainGrid", "TerrainKind", "Waves",
]  # fmt: skip
