"""Loops are part of the state: snapshots repeat, and steps add up."""

from __future__ import annotations

import torch

from orbit_conformance.bodies import scene
from orbit_conformance.contract.fixtures import MakeEngine, Needs
from orbit_conformance.scenarios.linkages import PARALLELOGRAM, four_bar
from orbit_core.interfaces import Capability

START = (-1.0, 1.0, -1.0)


def test_a_snapshot_of_a_swinging_loop_repeats(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.LOOP_JOINTS, Capability.SNAPSHOTS)
    engine = make_engine(scene(four_bar("loop", PARALLELOGRAM, START), terrain=()), num_envs=2)
    engine.step(60)
    saved = engine.save_state()
    engine.step(40)
    expected = engine.joint_positions.clone()
    engine.load_state(saved)
    engine.step(40)
    assert torch.equal(engine.joint_positions, expected)


def test_steps_of_a_swinging_loop_add_up(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.LOOP_JOINTS)
    # Loops are closed by iterations in some engines: a call must not start them from zero.
    one, many = (make_engine(scene(four_bar("loop", PARALLELOGRAM, START), terrain=())) for _ in range(2))
    many.step(50)
    for _ in range(50):
        one.step(1)
    assert torch.equal(one.joint_positions, many.joint_positions)
