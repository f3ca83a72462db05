"""Shapes are as large as they say, and stand where they say: each rests at its own height."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from orbit_conformance.bodies import cube, index, scene
from orbit_conformance.contract.fixtures import MakeEngine, Needs, assert_near
from orbit_core.interfaces import Capability
from orbit_core.scene import Articulation, Box, Capsule, Cylinder, ObjectSpec, Pose, Shape, Sphere
from orbit_core.scene.shapes import Geometry

UPRIGHT = Pose()
LYING = Pose.from_axis_angle((0.0, 1.0, 0.0), math.pi / 2)
# A geometry, how it is turned, and the height of its centre at rest in metres.
CASES: dict[str, tuple[Geometry, Pose, float]] = {
    "a box on its broad side": (Box((0.12, 0.08, 0.04)), UPRIGHT, 0.04),
    "a box on its narrow side": (Box((0.12, 0.08, 0.04)), LYING, 0.12),
    "a sphere": (Sphere(0.07), UPRIGHT, 0.07),
    "a capsule on its end": (Capsule(0.05, 0.1), UPRIGHT, 0.15),
    "a capsule on its side": (Capsule(0.05, 0.1), LYING, 0.05),
    "a cylinder on its end": (Cylinder(0.08, 0.1), UPRIGHT, 0.1),
    "a cylinder on its side": (Cylinder(0.08, 0.1), LYING, 0.08),
}


def thing(geometry: Geometry, turned: Pose, height: float, placed: Pose | None = None) -> ObjectSpec:
    """A free body of that shape, 1 kg; ``placed`` is the shape's pose in the link's frame."""
    plain = cube("thing", pose=replace(turned, position=(0.3, -0.2, height)))
    link = replace(plain.articulation.root, collisions=(Shape(geometry, placed or Pose()),))
    return replace(plain, articulation=Articulation("thing", (link,)))


@pytest.mark.parametrize("case", CASES)
def test_a_shape_rests_as_high_as_its_sizes_say(make_engine: MakeEngine, case: str) -> None:
    """Let go 2 mm above its true height, it stands there after 0.2 s; 1.5 mm."""
    geometry, turned, height = CASES[case]
    engine = make_engine(scene(thing(geometry, turned, height + 0.002)), num_envs=2)
    engine.step(40)
    assert_near(engine.link_poses[:, 0, 2], torch.tensor([height, height]), atol=1.5e-3)


def test_a_shape_stands_where_its_pose_in_the_link_says(make_engine: MakeEngine) -> None:
    """A capsule turned about y in its link and moved up by 0.03 m rests with the link's origin below; 1.5 mm."""
    placed = replace(LYING, position=(0.0, 0.0, 0.03))
    engine = make_engine(scene(thing(Capsule(0.05, 0.1), Pose(), 0.022, placed)))
    engine.step(40)
    assert_near(engine.link_poses[0, 0, 2], torch.tensor(0.02), atol=1.5e-3)


@pytest.mark.parametrize("case", CASES)
def test_rays_meet_a_shape_where_its_sizes_say(make_engine: MakeEngine, needs: Needs, case: str) -> None:
    """Rays from straight above, also in a second environment where the shape is 1 m higher; 1e-4 m.

    The normal within 0.1, as some engines have prisms for cylinders; the scenarios of rays measure it.
    """
    needs(Capability.RAY_CASTS)
    geometry, turned, height = CASES[case]
    engine = make_engine(scene(thing(geometry, turned, height)), num_envs=2)
    raised = torch.tensor([[0.3, -0.2, height + 1.0, *turned.orientation]])
    engine.write_root_state(0, raised, None, index(1))
    origins = torch.tensor([0.3, -0.2, 3.0]).expand(2, 1, 3)
    hits = engine.cast_rays(origins, torch.tensor([0.0, 0.0, -1.0]).expand(2, 1, 3), 10.0)
    assert_near(hits.distances[:, 0], torch.tensor([3.0 - 2 * height, 2.0 - 2 * height]), atol=1e-4)
    assert_near(hits.normals[:, 0], torch.tensor([[0.0, 0.0, 1.0]] * 2), atol=0.1)
    assert hits.links.tolist() == [[0], [0]]
