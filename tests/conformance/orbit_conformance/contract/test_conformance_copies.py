"""One environment's state in others: their continuation is its own, bit for bit where that is declared exact."""

from __future__ import annotations

import torch

from orbit_conformance.bodies import index
from orbit_conformance.contract.fixtures import MakeEngine, Needs
from orbit_conformance.contract.test_conformance_reset import busy_scene, drive
from orbit_core.interfaces import Backend, Capability, Level

# rad and m, rad/s and m/s, where copies are approximate.
NEAR = {"joint_positions": 2e-3, "link_poses": 2e-3, "joint_velocities": 0.2, "link_velocities": 0.2}


def test_a_copy_goes_on_as_what_it_was_copied_from(make_engine: MakeEngine, needs: Needs, backend: Backend) -> None:
    """Copy in the middle of motion, where an arm strikes cubes; environments that are no targets are unchanged."""
    needs(Capability.COPIED_STATES)
    exact = backend.capabilities()[Capability.COPIED_STATES].level is Level.EXACT
    engine = make_engine(busy_scene(backend), num_envs=4)
    drive(engine, index(0, 1, 2, 3), 10)
    before = engine.joint_positions.clone()
    # From one environment of the engine itself: source and target share memory.
    engine.copy_state(engine, 1, index(0, 3))
    torch.testing.assert_close(engine.joint_positions[2], before[2], rtol=0.0, atol=0.0)
    for steps in (0, 1, 6):
        if steps:
            engine.step(steps)
        for name, near in NEAR.items():
            value = getattr(engine, name)
            # Contacts that begin again are found within a step; written state is there at once.
            allowed = 0.0 if exact else near if steps else 1e-5
            copies = value[1].expand(2, *value.shape[1:])
            torch.testing.assert_close(value[[0, 3]], copies, rtol=0.0, atol=allowed)
