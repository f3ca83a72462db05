"""What plugins may share and need not use: rotations, velocities, contact signs, markers, a scaffold for renderers."""

from orbit_core.plugin_kit.velocities import contact_signs, velocity_at

__all__ = ["contact_signs", "velocity_at"]
