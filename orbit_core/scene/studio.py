"""Look of a spectator's pictures, next to the plain pictures that a scene's own cameras take."""

from __future__ import annotations

from dataclasses import dataclass, field

from orbit_core.scene.scene import AmbientLight, DirectionalLight, Light, Sky


@dataclass(frozen=True)
class Studio:
    """Look of a spectator's pictures. Lights, sky and finishes that a scene sets itself stay as they are."""

    samples: int = 2
    """Pictures that are averaged for each one."""
    softness: float = 0.02
    """Radius of directional lights as seen from the scene, in radians: how wide the edges of shadows are."""
    lights: tuple[Light, ...] = (
        AmbientLight((0.42, 0.43, 0.46)),
        DirectionalLight((-0.55, 0.45, -1.0), (1.0, 0.97, 0.93), 0.56),
        DirectionalLight((0.7, -0.3, -0.6), (0.85, 0.92, 1.0), 0.12, shadows=False),
    )
    """Lights of scenes that have the default ones."""
    sky: Sky = field(default_factory=lambda: Sky(above=(0.70, 0.80, 0.92), below=(0.97, 0.97, 0.97)))
    """Sky of scenes that have the default one."""


STUDIO = Studio()
"""Look of videos and of pictures for people."""
