"""Snapshots hold all that the continuation depends on, commands, readings and parameters with it, bit for bit."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from orbit_conformance.bodies import cube, index, pendulum, scene
from orbit_conformance.contract.fixtures import MakeEngine, Needs, assert_near
from orbit_conformance.contract.test_conformance_reset import (
    COMMANDS,
    STATE,
    assert_same,
    busy_scene,
    drive,
    everything,
)
from orbit_core.interfaces import TERRAIN, Backend, Capability, Engine, Level
from orbit_core.scene import ContactSensorSpec, ForceTorqueSpec


@pytest.fixture(autouse=True)
def snapshots_needed(needs: Needs) -> None:
    needs(Capability.SNAPSHOTS)


def test_a_snapshot_repeats(make_engine: MakeEngine, backend: Backend) -> None:
    """Saved in the midst of motion, continued, loaded, continued: the same.

    Where snapshots are approximate, loaded runs repeat one another; how far they part from the one that was saved is
    held by the scenario ``snapshot``.
    """
    engine = make_engine(busy_scene(backend), num_envs=3)
    drive(engine, index(0, 1, 2), 10)
    saved, at_save = engine.save_state(), everything(engine)
    if backend.capabilities()[Capability.SNAPSHOTS].level is not Level.EXACT:
        engine.load_state(saved)
    engine.step(7)
    first = everything(engine)
    # Anything may happen after saving: motion, other commands, the reset of one environment.
    drive(engine, index(0, 1, 2), 5)
    engine.reset(index(1))
    for _ in range(2):
        engine.load_state(saved)
        assert_same(everything(engine), at_save)
        engine.step(7)
        assert_same(everything(engine), first)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_snapshot_holds_commands(make_engine: MakeEngine, command: str) -> None:
    """Each environment has its own commands, those at the time of saving."""
    engine = make_engine(scene(pendulum(), terrain=()), num_envs=2)
    given = torch.tensor([[0.1, -0.2], [0.3, 0.4]])
    getattr(engine, command)[:] = given
    saved = engine.save_state()
    # Overwritten in place, as tasks do: a snapshot that kept a reference would change with it.
    getattr(engine, command)[:] = 7.0
    engine.step(1)
    engine.load_state(saved)
    assert_same(everything(engine, command), {command: given})


def test_a_snapshot_continues_under_its_commands(make_engine: MakeEngine) -> None:
    """Loaded after other commands, and after a reset that cleared them: what was commanded goes on."""
    engine = make_engine(scene(pendulum(), terrain=()), num_envs=2)
    engine.efforts[:] = torch.tensor([[2.0, 0.0], [0.0, 1.0]])
    engine.step(5)
    saved = engine.save_state()
    engine.load_state(saved)
    engine.step(5)
    expected = everything(engine)
    engine.reset()
    engine.step(2)
    engine.load_state(saved)
    engine.step(5)
    assert_same(everything(engine), expected)


def test_a_snapshot_holds_the_efforts_of_the_last_step(make_engine: MakeEngine) -> None:
    """The reading is of the step before saving, not of what was stepped or commanded since."""
    engine = make_engine(scene(pendulum(), terrain=()), num_envs=2)
    engine.efforts[:] = torch.tensor([[2.0, -1.0], [0.5, 1.0]])
    engine.step(3)
    saved, before = engine.save_state(), engine.joint_efforts.clone()
    engine.efforts.zero_()
    engine.step(3)
    engine.load_state(saved)
    assert_same({"joint_efforts": engine.joint_efforts}, {"joint_efforts": before})


def test_a_snapshot_holds_contact_forces(make_engine: MakeEngine, needs: Needs) -> None:
    """Contact forces of a cube at rest are reported again after it was lifted off and the state loaded."""
    needs(Capability.CONTACT_FORCES)
    engine = make_engine(scene(cube(), sensors=(ContactSensorSpec(name="c", entity="cube"),)), num_envs=2)
    engine.step(60)
    saved, before = engine.save_state(), engine.contact_forces.clone()
    engine.write_root_state(0, torch.tensor([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]] * 2), None)
    engine.step(3)
    assert engine.contact_forces.abs().max() == 0
    engine.load_state(saved)
    assert_same({"contact_forces": engine.contact_forces}, {"contact_forces": before})


def test_a_snapshot_holds_joint_wrenches(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.JOINT_WRENCHES)
    sensor = ForceTorqueSpec(name="w", entity="pendulum", link="link0")
    engine = make_engine(scene(pendulum(), sensors=(sensor,), terrain=()), num_envs=2)
    engine.step(10)
    saved, before = engine.save_state(), engine.joint_wrenches.clone()
    engine.step(30)
    engine.load_state(saved)
    assert_same({"joint_wrenches": engine.joint_wrenches}, {"joint_wrenches": before})


Change = Callable[[Engine], None]
PARAMETERS: dict[Capability, Change] = {
    Capability.RANDOMIZE_MASS: lambda engine: engine.set_masses(index(3), torch.tensor([[3.0]]), index(1)),
    Capability.RANDOMIZE_CENTER_OF_MASS: lambda engine: engine.set_centers_of_mass(
        index(2), torch.tensor([[[0.1, 0.0, 0.02]]]), index(1)
    ),
    Capability.RANDOMIZE_FRICTION: lambda engine: engine.set_friction(
        index(3, 4, TERRAIN), torch.zeros(1, 3), index(1)
    ),
    Capability.RANDOMIZE_GAINS: lambda engine: engine.set_drive_gains(
        index(1), torch.tensor([[5.0]]), torch.tensor([[0.5]]), index(1)
    ),
    Capability.RANDOMIZE_JOINTS: lambda engine: engine.set_joint_parameters(
        index(1), torch.tensor([[0.5]]), None, torch.tensor([[0.1]]), None, index(1)
    ),
    Capability.RANDOMIZE_GRAVITY: lambda engine: engine.set_gravity(torch.tensor([[0.5, 0.0, -3.0]]), index(1)),
    Capability.EXTERNAL_WRENCHES: lambda engine: engine.set_wrenches(
        index(3), torch.tensor([[[5.0, 0.0, 0.0, 0.0, 0.0, 0.1]]]), index(1)
    ),
}


@pytest.mark.parametrize("capability", PARAMETERS, ids=lambda capability: capability.key)
def test_a_snapshot_holds_what_was_set_per_environment(
    make_engine: MakeEngine, needs: Needs, backend: Backend, capability: Capability
) -> None:
    """Saved before and after a change of environment 1: each continues as it did, and there the change matters.

    Tolerances allow for sums in any order, as a GPU takes them.
    """
    needs(capability)
    engine = make_engine(busy_scene(backend), num_envs=2)
    engine.velocity_targets[:] = torch.tensor([0.5, -0.5])
    plain, unchanged = _lived(engine)
    engine.load_state(plain)
    PARAMETERS[capability](engine)
    altered, changed = _lived(engine)
    for saved, expected in ((plain, unchanged), (altered, changed), (plain, unchanged)):
        engine.load_state(saved)
        engine.step(30)
        for name, measured in everything(engine).items():
            assert_near(measured, expected[name], rtol=1e-5, atol=1e-5)
    # Without this the test would pass for an engine that ignores the parameter.
    assert any(not torch.equal(unchanged[name][1], changed[name][1]) for name in STATE), "the change does nothing"


def _lived(engine: Engine) -> tuple[object, dict[str, Tensor]]:
    """A snapshot, and everything 30 steps after it is loaded."""
    saved = engine.save_state()
    engine.load_state(saved)
    engine.step(30)
    return saved, everything(engine)
