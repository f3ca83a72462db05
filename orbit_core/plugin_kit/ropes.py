"""What is known of ropes before they move."""

from __future__ import annotations

from orbit_core.scene import Rope, Scene

STANDARD_GRAVITY = 9.81
"""m/s^2."""


def hanging_weight(rope: Rope, scene: Scene) -> float:
    """Newtons that the rope and the free bodies that are attached to it weigh together, on Earth; 0 without any."""
    held = {attachment.entity for attachment in rope.attachments}
    loads = [
        sum(link.mass for link in entity.articulation.links)
        for entity in scene.entities
        if entity.name in held and not entity.fixed_base
    ]
    return STANDARD_GRAVITY * (sum(loads) + rope.mass) if loads else 0.0
