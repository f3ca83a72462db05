"""Resets, snapshots and repeatability, bit for bit."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from orbit_core.conformance.bodies import cube, index, pendulum, scene
from orbit_core.interfaces import Backend, Capability, Engine, Level, SimulationError
from orbit_core.scene import ContactSensorSpec, ForceTorqueSpec, ImplicitPd, Pose, Scene

from .conftest import MakeEngine, Needs

STATE = ("joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities")


def busy_scene() -> Scene:
    """A driven arm that strikes a cube."""
    arm = pendulum(actuators=(ImplicitPd(joints=(".*",), stiffness=50.0, damping=5.0),), base=Pose((0.0, 0.0, 0.3)))
    return scene(arm, cube("one", pose=Pose((0.3, 0.0, 0.06))), cube("two", pose=Pose((0.35, 0.0, 0.2))))


def measured_scene() -> Scene:
    plain = busy_scene()
    sensors = (ContactSensorSpec(name="c", entity="one"), ForceTorqueSpec(name="w", entity="pendulum", link="link0"))
    return scene(*plain.entities, sensors=sensors)


def drive(engine: Engine, env_ids: Tensor, steps: int) -> None:
    """Commands that depend on the environment's number alone."""
    for step in range(steps):
        phase = (env_ids + 1)[:, None] * 0.1 * (step + 1)
        engine.position_targets[env_ids] = torch.cat((torch.sin(phase), torch.cos(phase)), -1)
        engine.step(4)


def everything(engine: Engine) -> dict[str, Tensor]:
    return {name: getattr(engine, name).clone() for name in STATE}


def test_a_reset_is_complete(make_engine: MakeEngine, needs: Needs, backend: Backend) -> None:
    """An environment that was driven, pushed and reset repeats a fresh one's life."""
    needs(Capability.DETERMINISTIC)
    used, fresh = make_engine(busy_scene(), num_envs=2), make_engine(busy_scene(), num_envs=2)
    drive(used, index(0, 1), 15)
    used.velocity_targets.fill_(2.0)
    used.efforts.fill_(3.0)
    if backend.capabilities().has(Capability.EXTERNAL_WRENCHES):
        used.set_wrenches(index(1), torch.full((2, 1, 6), 2.0))
    used.step(3)
    used.reset(index(1, 0))
    for name in STATE:
        assert torch.equal(getattr(used, name), getattr(fresh, name)), name
    for name in ("position_targets", "velocity_targets", "efforts"):
        assert torch.equal(getattr(used, name), getattr(fresh, name)), name
    for engine in (used, fresh):
        engine.step(50)
    for name in STATE:
        assert torch.equal(getattr(used, name), getattr(fresh, name)), name


def test_a_snapshot_repeats(make_engine: MakeEngine, needs: Needs, backend: Backend) -> None:
    """Saved in the midst of contact, continued, loaded, continued: the same, bit for bit.

    Where snapshots are approximate, loaded runs repeat one another; how far they part from the one that was saved is
    held by the scenario ``snapshot``.
    """
    needs(Capability.SNAPSHOTS, Capability.CONTACT_FORCES, Capability.JOINT_WRENCHES)
    engine = make_engine(measured_scene(), num_envs=3)
    names = (*STATE, "contact_forces", "joint_wrenches", "position_targets")
    drive(engine, index(0, 1, 2), 10)
    saved = engine.save_state()
    at_save = {name: getattr(engine, name).clone() for name in names}
    engine.step(7)
    first = {name: getattr(engine, name).clone() for name in names}
    drive(engine, index(0, 1, 2), 5)
    engine.reset(index(1))
    exact = backend.capabilities()[Capability.SNAPSHOTS].level is Level.EXACT
    for turn in range(3):
        engine.load_state(saved)
        for name in names:
            assert torch.equal(getattr(engine, name), at_save[name]), name
        engine.step(7)
        if turn == 0 and not exact:
            first = {name: getattr(engine, name).clone() for name in names}
        for name in names:
            assert torch.equal(getattr(engine, name), first[name]), name


def test_a_snapshot_holds_randomised_parameters(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.SNAPSHOTS, Capability.RANDOMIZE_MASS, Capability.RANDOMIZE_GRAVITY, Capability.RANDOMIZE_GAINS)
    engine = make_engine(busy_scene(), num_envs=2)
    plain = engine.save_state()
    engine.step(20)
    unchanged = everything(engine)
    engine.load_state(plain)
    engine.set_masses(index(3), torch.tensor([[3.0]]), index(1))
    engine.set_gravity(torch.tensor([[0.0, 0.0, -3.0]]), index(0))
    engine.set_drive_gains(index(1), torch.tensor([[5.0]]), torch.tensor([[0.5]]), index(1))
    heavy = engine.save_state()
    engine.step(20)
    changed = everything(engine)
    for saved, expected in ((plain, unchanged), (heavy, changed), (plain, unchanged)):
        engine.load_state(saved)
        engine.step(20)
        for name in STATE:
            assert torch.equal(getattr(engine, name), expected[name]), name
    assert not torch.equal(unchanged["joint_positions"], changed["joint_positions"])


def test_steps_may_be_taken_together_or_apart(make_engine: MakeEngine, needs: Needs) -> None:
    needs(Capability.DETERMINISTIC)
    together, apart = make_engine(busy_scene(), num_envs=2), make_engine(busy_scene(), num_envs=2)
    together.step(30)
    for _ in range(30):
        apart.step(1)
        apart.link_poses  # noqa: B018 - reading must not disturb
    for name, values in everything(together).items():
        assert torch.equal(values, getattr(apart, name)), name


def test_divergence_names_the_environments(make_engine: MakeEngine) -> None:
    engine = make_engine(busy_scene(), num_envs=4)
    engine.efforts[2] = torch.nan
    with pytest.raises(SimulationError, match=r"\b2\b"):
        engine.step(5)
    engine.reset()
    engine.step(5)
    for name in STATE:
        assert getattr(engine, name).isfinite().all(), name
