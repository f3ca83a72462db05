"""What the contract gives plugins so that each need not write it."""

from __future__ import annotations

import torch

from orbit_core import backends
from orbit_core.conformance.bodies import pendulum, scene
from orbit_core.interfaces import TERRAIN, ContactQuery, SceneLayout, contact_signs, velocity_at


def test_velocities_at_another_point_are_those_of_a_turning_body() -> None:
    """A point 0.5 m along x of a body that turns at 2 rad/s about z moves at 1 m/s along y more, and back again."""
    velocity = torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0, 2.0]])
    arm = torch.tensor([[0.5, 0.0, 0.0]])
    moved = velocity_at(velocity, arm)
    assert moved.tolist() == [[1.0, 1.0, 0.0, 0.0, 0.0, 2.0]]
    assert torch.equal(velocity_at(moved, -arm), velocity)


def test_contact_signs_count_both_sides_of_a_pair() -> None:
    queries = (ContactQuery(0), ContactQuery(0, frozenset({TERRAIN})), ContactQuery(1, frozenset({0})))
    signs = contact_signs(queries, [(0, TERRAIN), (0, 1), (1, 2)])
    assert signs.tolist() == [[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]


def test_saved_commands_are_copies_and_come_back_in_place() -> None:
    plugin = backends.backend("mujoco")
    engine = plugin.create_engine(SceneLayout.of(scene(pendulum())), 2, torch.device("cpu"), plugin.config_type())
    buffer = engine.efforts
    engine.efforts.fill_(2.0)
    saved = engine.saved_commands()
    engine.efforts.zero_()
    engine.load_commands(saved)
    assert engine.efforts is buffer
    assert buffer.tolist() == [[2.0, 2.0], [2.0, 2.0]]
    engine.close()
