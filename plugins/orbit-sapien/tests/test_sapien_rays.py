"""Rays on cylinders, which PhysX has as prisms of 32 sides."""

from __future__ import annotations

import math

import torch

from orbit_assets.objects import cylinder
from orbit_core import backends
from orbit_core.interfaces import SceneLayout
from orbit_core.scene import Pose, Scene

_RADIUS, _HALF = 0.2, 0.3


def test_rays_meet_a_cylinder_and_not_the_prism_within() -> None:
    """From all around and aslant on the side, and from above on the end; the cylinder lies along y."""
    pose = Pose.from_euler(-math.pi / 2, 0.0, 0.0, (0.5, 0.0, 1.0))
    plugin = backends.backend("sapien")
    layout = SceneLayout.of(Scene(objects=(cylinder("drum", _RADIUS, 2 * _HALF, mass=1.0, pose=pose),), terrain=()))
    engine = plugin.create_engine(layout, 1, torch.device("cpu"), plugin.config_type())

    angles = torch.arange(0.0, 2 * math.pi, 0.05)
    outwards = torch.stack((angles.cos(), torch.zeros_like(angles), angles.sin()), -1)
    slope = torch.tensor([0.0, 0.1, 0.0])
    directions = torch.cat(((slope - outwards), torch.tensor([[0.0, -1.0, 0.0]])))
    center = torch.tensor([0.5, 0.0, 1.0])
    origins = torch.cat((center + outwards, center[None] + torch.tensor([[0.1, 1.0, 0.0]])))
    lengths = directions.norm(dim=-1)
    hits = engine.cast_rays(origins[None], (directions / lengths[:, None])[None], 5.0)

    expected = torch.cat(((1.0 - _RADIUS) * lengths[:-1], torch.tensor([1.0 - _HALF])))
    normals = torch.cat((outwards, torch.tensor([[0.0, 1.0, 0.0]])))
    torch.testing.assert_close(hits.distances[0], expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(hits.normals[0], normals, rtol=0, atol=1e-5)
