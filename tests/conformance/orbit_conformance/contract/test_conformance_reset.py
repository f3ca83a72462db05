"""Resets and repeatability, bit for bit."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from orbit_conformance.bodies import cube, index, pendulum, scene
from orbit_conformance.contract.fixtures import MakeEngine, Needs, assert_near
from orbit_core.interfaces import Backend, Capability, Engine, SimulationError
from orbit_core.scene import ImplicitPd, Pose, Scene, SensorSpec

STATE = ("joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities")
COMMANDS = ("position_targets", "velocity_targets", "efforts")


def busy_scene(backend: Backend, *sensors: SensorSpec) -> Scene:
    """An arm, driven where the backend has drives, that strikes a cube and a second one, where it has friction."""
    has = backend.capabilities().has
    drives = (ImplicitPd(joints=(".*",), stiffness=50.0, damping=5.0),) if has(Capability.IMPLICIT_DRIVES) else ()
    # Impacts and friction make any state that a reset forgets visible within a few steps.
    arm = pendulum(actuators=drives, base=Pose((0.0, 0.0, 0.3)))
    cubes = (cube("one", pose=Pose((0.3, 0.0, 0.06))), cube("two", pose=Pose((0.35, 0.0, 0.2))))
    if has(Capability.FRICTION):
        return scene(arm, *cubes, sensors=sensors)
    return scene(arm, cubes[0], sensors=sensors, terrain=())


def drive(engine: Engine, env_ids: Tensor, steps: int) -> None:
    """Commands that depend on the environment's number alone."""
    for step in range(steps):
        phase = (env_ids + 1)[:, None] * 0.1 * (step + 1)
        engine.position_targets[env_ids] = torch.cat((torch.sin(phase), torch.cos(phase)), -1)
        engine.efforts[env_ids] = 0.3 * torch.cat((torch.cos(phase), torch.sin(phase)), -1)
        engine.step(4)


def everything(engine: Engine, *others: str) -> dict[str, Tensor]:
    return {name: getattr(engine, name).clone() for name in (*STATE, *others)}


def assert_same(measured: dict[str, Tensor], truth: dict[str, Tensor]) -> None:
    """Bit for bit."""
    for name, values in truth.items():
        try:
            assert_near(measured[name], values)
        except AssertionError as error:
            raise AssertionError(f"{name}: {error}") from None


def test_a_reset_is_complete(make_engine: MakeEngine, needs: Needs, backend: Backend) -> None:
    """An environment that was driven, pushed and reset repeats a fresh one's life."""
    needs(Capability.DETERMINISTIC)
    used, fresh = make_engine(busy_scene(backend), num_envs=2), make_engine(busy_scene(backend), num_envs=2)
    drive(used, index(0, 1), 15)
    used.velocity_targets.fill_(2.0)
    used.efforts.fill_(3.0)
    if backend.capabilities().has(Capability.EXTERNAL_WRENCHES):
        used.set_wrenches(index(1), torch.full((2, 1, 6), 2.0))
    used.step(3)
    used.reset(index(1, 0))
    # At once, before a step: warm starts and caches show only in the steps after it.
    assert_same(everything(used, *COMMANDS), everything(fresh, *COMMANDS))
    for engine in (used, fresh):
        engine.step(50)
    assert_same(everything(used), everything(fresh))


def test_a_reset_reaches_only_the_environments_named(make_engine: MakeEngine, backend: Backend) -> None:
    engine = make_engine(busy_scene(backend), num_envs=3)
    drive(engine, index(0, 1, 2), 3)
    before = everything(engine, *COMMANDS)
    engine.reset(index(1))
    after, others = everything(engine, *COMMANDS), index(0, 2)
    assert_same({name: a[others] for name, a in after.items()}, {name: b[others] for name, b in before.items()})
    assert_near(after["joint_velocities"][1], torch.zeros(2))


def test_steps_may_be_taken_together_or_apart(make_engine: MakeEngine, needs: Needs, backend: Backend) -> None:
    needs(Capability.DETERMINISTIC)
    together, apart = make_engine(busy_scene(backend), num_envs=2), make_engine(busy_scene(backend), num_envs=2)
    together.step(30)
    for _ in range(30):
        apart.step(1)
        apart.link_poses  # noqa: B018 - reading must not disturb
    assert_same(everything(apart), everything(together))


def test_divergence_names_the_environments(make_engine: MakeEngine, backend: Backend) -> None:
    engine = make_engine(busy_scene(backend), num_envs=4)
    # A NaN command diverges every engine at once, at a known environment.
    engine.efforts[2] = torch.nan
    with pytest.raises(SimulationError, match=r"\b2\b") as error:
        engine.step(5)
    assert not set("013") & set(str(error.value).split(" diverged")[0]), "environments that are well are named"
    # After a reset the world has to be as good as new, or a run of days would end with one bad environment.
    engine.reset()
    engine.step(5)
    for name in STATE:
        assert getattr(engine, name).isfinite().all(), name
