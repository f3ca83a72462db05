"""The arrays that core and simulations share, each with a row per environment."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from orbit_core.interfaces import SceneLayout
from orbit_core.plugin_kit.shared_arrays import Shapes, shared_arrays

FloatArray = npt.NDArray[np.float32]


@dataclass(eq=False)
class Buffers:
    """Commands, then what the engine measures. Particles of all deformables stand one after another."""

    position_targets: FloatArray
    """(N, J) rad or m."""
    velocity_targets: FloatArray
    """(N, J) rad/s or m/s."""
    efforts: FloatArray
    """(N, J) commanded, N m or N."""
    joint_positions: FloatArray
    """(N, J) rad or m."""
    joint_velocities: FloatArray
    """(N, J) rad/s or m/s."""
    joint_efforts: FloatArray
    """(N, J) applied in the last step, N m or N."""
    link_poses: FloatArray
    """(N, L, 7) in the environment's frame."""
    link_velocities: FloatArray
    """(N, L, 6) m/s and rad/s, world axes."""
    contact_forces: FloatArray
    """(N, Q, 3) N of each contact query."""
    joint_wrenches: FloatArray
    """(N, W, 6) N and N m of each wrench link."""
    particle_positions: FloatArray
    """(N, P, 3) m."""
    particle_velocities: FloatArray
    """(N, P, 3) m/s."""

    def rows(self, start: int, stop: int) -> Buffers:
        """Views of some environments."""
        # Views and no copies: what a worker writes is what the core reads.
        return Buffers(**{field.name: getattr(self, field.name)[start:stop] for field in fields(self)})


def shapes_of(layout: SceneLayout, num_envs: int) -> Shapes:
    """The shape of each buffer."""
    joints, links = len(layout.joints), len(layout.links)
    particles = sum(len(deformable.rest_positions) for deformable in layout.scene.deformables)
    per_joint = dict.fromkeys(
        ("position_targets", "velocity_targets", "efforts", "joint_positions", "joint_velocities", "joint_efforts"),
        (num_envs, joints),
    )
    return per_joint | {
        "link_poses": (num_envs, links, 7),
        "link_velocities": (num_envs, links, 6),
        "contact_forces": (num_envs, len(layout.contact_queries), 3),
        "joint_wrenches": (num_envs, len(layout.wrench_links), 6),
        "particle_positions": (num_envs, particles, 3),
        "particle_velocities": (num_envs, particles, 3),
    }


def private_buffers(shapes: Shapes) -> Buffers:
    """Buffers of this process alone."""
    return Buffers(**{name: np.zeros(shape, dtype=np.float32) for name, shape in shapes.items()})


def shared_buffers(shapes: Shapes, path: Path) -> Buffers:
    """Create buffers in a file that several processes map; the last of them frees its memory."""
    return Buffers(**shared_arrays(shapes, path))
