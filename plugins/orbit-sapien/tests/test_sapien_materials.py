"""Coefficients of pairs as PhysX's averages, and torsional friction as its patches."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_core import backends
from orbit_core.interfaces import Engine, SceneLayout
from orbit_core.scene import Articulation, Link, ObjectSpec, PhysicsMaterial, Plane, Pose, Scene, Shape, Sphere
from orbit_sapien.materials import PairRule

_RADIUS, _INERTIA = 0.1, 4e-3


def ball(name: str, friction: float, torsional: float, x: float = 0.0) -> ObjectSpec:
    """Of 1 kg."""
    material = PhysicsMaterial(friction, friction, torsional_friction=torsional)
    shapes = (Shape(Sphere(_RADIUS), material=material),)
    link = Link(name, 1.0, inertia=_INERTIA * np.eye(3), collisions=shapes)
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), pose=Pose((x, 0.0, _RADIUS)))


def ground(friction: float, torsional: float) -> Shape:
    return Shape(Plane(), material=PhysicsMaterial(friction, friction, torsional_friction=torsional))


def engine_of(scene: Scene, num_envs: int = 1, **settings: object) -> Engine:
    plugin = backends.backend("sapien")
    config = backends.backend_config(plugin, settings)
    return plugin.create_engine(SceneLayout.of(scene), num_envs, torch.device("cpu"), config)


def coefficients(engine: Engine) -> torch.Tensor:
    """(N, L) metres: the torque that slows each ball's spin about the vertical, over its weight."""
    links = len(engine.layout.links)
    engine.step(20)
    for entity in range(links):
        engine.write_root_state(entity, None, torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, 10.0]] * engine.num_envs))
    engine.step(20)
    slower = 10.0 - engine.link_velocities[..., 5]
    return slower * _INERTIA / (20 * engine.layout.scene.physics_dt * 9.81)


@pytest.mark.parametrize(("friction", "torsional", "expected"), [(1.0, 0.004, 0.008), (0.1, 0.012, 0.012)])
def test_a_pair_has_the_larger_torsional_friction_whatever_slides(
    friction: float, torsional: float, expected: float
) -> None:
    scene = Scene(objects=(ball("ball", friction, torsional),), terrain=(ground(0.2, 0.008),))
    found = coefficients(engine_of(scene))
    torch.testing.assert_close(found, torch.tensor([[expected]]), rtol=0.01, atol=0.0)


def test_torsional_friction_stays_when_sliding_friction_changes() -> None:
    engine = engine_of(Scene(objects=(ball("ball", 0.3, 0.01),), terrain=(ground(0.3, 0.0),)), 2)
    engine.set_friction(torch.tensor([0]), torch.tensor([[0.9]]), torch.tensor([1]))
    torch.testing.assert_close(coefficients(engine), torch.full((2, 1), 0.01), rtol=0.01, atol=0.0)


def test_radii_never_give_a_pair_more_than_it_asks() -> None:
    """Two sliding coefficients that one ball meets, and only one radius for it."""
    things = ball("ball", 0.1, 0.01), ball("other", 1.0, 0.0, x=1.0)
    layout = SceneLayout.of(Scene(objects=things, terrain=(ground(0.1, 0.0),)))
    radii = PairRule(layout).patch_radii(np.array([0.1, 0.1, 1.0]))
    np.testing.assert_allclose(radii, [0.0, 0.01, 0.0])


@pytest.mark.parametrize(
    ("things", "settings", "why"),
    [
        ((ball("ball", 0.1, 0.01), ball("other", 1.0, 0.0, x=1.0)), {}, "no radii meet every pair"),
        ((ball("ball", 1.0, 0.01),), {"temporal_gauss_seidel": False}, "PGS"),
    ],
)
def test_torsional_friction_that_is_not_met_is_reported(
    things: tuple[ObjectSpec, ...], settings: dict[str, object], why: str
) -> None:
    report = engine_of(Scene(objects=things, terrain=(ground(0.1, 0.0),)), 1, **settings).build_report
    assert any("torsional friction" in line.asked and why in line.why for line in report), report


@pytest.mark.parametrize(("offset", "lines"), [(0.001, 0), (0.002, 0), (0.01, 1)])
def test_contacts_that_are_looked_for_too_far_away_have_no_friction_and_that_is_reported(
    offset: float, lines: int
) -> None:
    scene = Scene(objects=(ball("ball", 0.5, 0.0),), terrain=(ground(0.5, 0.0),))
    report = engine_of(scene, contact_offset=offset).build_report
    assert [line.got for line in report] == ["none of contacts found beyond 4 mm"] * lines


def test_a_ball_that_lands_fast_gets_coulombs_friction_at_any_part_of_a_step() -> None:
    slippery = ball("ball", 0.15, 0.0)
    engine = engine_of(Scene(objects=(slippery,), terrain=(ground(0.0, 0.0),), gravity=(0.0, 0.0, 0.0)), 8)
    pose, parts = torch.tensor([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]).repeat(8, 1), torch.arange(8) / 8
    pose[:, 2] = _RADIUS + 0.06 + 0.015 * parts  # of a step at 3 m/s
    engine.write_root_state(0, pose, torch.tensor([[3.0, 0.0, -3.0, 0.0, 0.0, 0.0]]).repeat(8, 1))
    engine.step(12)
    lost = 3.0 - engine.link_velocities[:, 0, 0]
    torch.testing.assert_close(lost, torch.full((8,), 0.45), rtol=0.02, atol=0.0)
