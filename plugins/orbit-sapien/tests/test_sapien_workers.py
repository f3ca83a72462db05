"""Worker processes: the same results as in one process, the same errors, and a clean end when one dies."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from orbit_core.interfaces import (
    TERRAIN,
    ConfigurationError,
    Engine,
    SceneLayout,
    SimulationError,
)
from orbit_core.plugin_kit.split_engine import SplitEngine
from orbit_core.scene import (
    Articulation,
    Box,
    ContactSensorSpec,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    Plane,
    Pose,
    RobotSpec,
    Scene,
    Shape,
    single_link,
)
from orbit_sapien import SapienBackend, SapienConfig

STATE = (
    "joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities", "contact_forces",
)  # fmt: skip


def busy_scene() -> Scene:
    """A driven bar that sweeps through a cube on the ground."""
    bar = Shape(Box((0.2, 0.02, 0.02)), Pose((0.2, 0.0, 0.0)))
    links = (Link("base"), Link("bar", 1.0, (0.2, 0.0, 0.0), np.eye(3) * 0.02, (bar,)))
    robot = RobotSpec(
        name="arm",
        articulation=Articulation("arm", links, (Joint("swing", JointType.CONTINUOUS, "base", "bar"),)),
        fixed_base=True,
        pose=Pose((0.0, 0.0, 0.05)),
        actuators=(ImplicitPd(joints=(".*",), stiffness=20.0, damping=2.0, effort_limit=5.0),),
    )
    block = single_link("cube", Shape(Box((0.05, 0.05, 0.05))), 0.5, np.eye(3) * 1e-3)
    cube = ObjectSpec(name="cube", articulation=block, pose=Pose((0.3, 0.12, 0.05)))
    touch = ContactSensorSpec(name="touch", entity="cube")
    return Scene(robots=(robot,), objects=(cube,), sensors=(touch,), terrain=(Shape(Plane()),))


@contextmanager
def made(num_envs: int, workers: int, scene: Scene | None = None, **settings: Any) -> Iterator[Engine]:
    layout = SceneLayout.of(scene or busy_scene())
    config = SapienConfig(workers=workers, **settings)
    engine = SapienBackend().create_engine(layout, num_envs, torch.device("cpu"), config)
    assert isinstance(engine, SplitEngine) == (workers > 1)
    try:
        yield engine
    finally:
        engine.close()


def pids_of(engine: Engine) -> list[int]:
    return engine.native.pids


def is_running(pid: int) -> bool:
    """Return True if the process exists, be it a zombie."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def play(engine: Engine, rows: torch.Tensor | None = None) -> torch.Tensor:
    """Use all that an engine does, and return the state (N, ...) that it led to, step by step."""
    n = engine.num_envs
    goals = torch.linspace(0.5, 2.0, 9)[:n, None]
    picked, cube = (
        torch.tensor([3, 1]),
        torch.tensor([[0.25, 0.14, 0.06, 1.0, 0, 0, 0], [0.3, 0.1, 0.06, 1.0, 0, 0, 0]]),
    )
    engine.set_masses(torch.tensor([2]), torch.linspace(0.4, 0.6, 9)[:n, None])
    engine.set_friction(torch.tensor([TERRAIN]), torch.tensor([[0.3], [0.9]]), picked)
    engine.set_gravity(torch.tensor([[0.0, 0.0, -5.0], [0.0, 0.0, -12.0]]), picked)
    engine.set_drive_gains(torch.tensor([0]), torch.full((2, 1), 15.0), torch.full((2, 1), 1.0), picked)
    engine.set_joint_parameters(
        torch.tensor([0]), torch.full((2, 1), 0.1), None, torch.full((2, 1), 0.01), None, picked
    )
    engine.set_centers_of_mass(torch.tensor([2]), torch.full((2, 1, 3), 0.005), picked)
    engine.set_wrenches(torch.tensor([2]), torch.tensor([[[0.1, 0.0, 0.0, 0.0, 0.0, 0.01]]] * 2), picked)
    engine.write_root_state(1, cube, None, picked)
    found = []

    def look() -> None:
        found.append(torch.cat([getattr(engine, name).flatten(1) for name in STATE], -1).clone())

    look()
    for _ in range(6):
        engine.position_targets[:] = goals
        engine.step(8)
        look()
    engine.write_joint_state(torch.tensor([0]), torch.tensor([[0.2], [0.1]]), None, picked)
    look()
    engine.reset(torch.tensor([4, 1]))
    look()
    saved = engine.save_state()
    for _ in range(2):
        engine.load_state(saved)
        look()
        engine.position_targets[:] = -goals
        engine.step(10)
        look()
    origins = torch.tensor([[[0.3, 0.12, 1.0], [0.3, 0.12, 1.0]], [[0.3, 0.12, 2.0], [9.0, 9.0, 2.0]]])
    down = torch.tensor([0.0, 0.0, -1.0]).expand(2, 2, 3).contiguous()
    hits = engine.cast_rays_past(origins, down, 5.0, range(2, 3), picked)
    rays = torch.zeros(n, 12)
    rays[picked] = torch.cat((hits.distances, hits.normals.flatten(1), hits.links, hits.links), -1)
    return torch.cat((*found, rays), -1)


def test_workers_change_nothing() -> None:
    """One process, and three of uneven shares: bit for bit the same, whatever is done."""
    with made(7, 1, envs_per_world=2) as alone, made(7, 3, envs_per_world=2) as split:
        assert isinstance(split, SplitEngine)
        assert split.ranges == ((0, 2), (2, 6), (6, 7))
        assert split.build_report == alone.build_report
        for one, other in zip(split.built_model(), alone.built_model(), strict=True):
            np.testing.assert_array_equal(one.inertias, other.inertias)
        assert torch.equal(play(alone), play(split))
        saved = dataclasses.replace(split.save_state(), ranges=((0, 4), (4, 7)))
        with pytest.raises(ConfigurationError, match="saved by 2 workers and this engine has 3"):
            split.load_state(saved)
        assert alone.contact_forces.abs().max() > 1.0


def test_an_environment_in_a_world_of_its_own_does_not_depend_on_how_many_there_are() -> None:
    with made(9, 1, envs_per_world=1) as many, made(5, 1, envs_per_world=1) as few:
        assert torch.equal(play(many)[:5], play(few))


def test_a_dead_worker_is_reported_and_nothing_stays() -> None:
    with made(4, 2, envs_per_world=1) as engine:
        pids = pids_of(engine)
        assert not list(Path("/dev/shm").glob(f"orbit-workers-{os.getpid()}-*"))  # no name once the workers have it
        os.kill(pids[1], signal.SIGKILL)
        with pytest.raises(SimulationError, match=rf"process {pids[1]} of environments 2 to 3 died, killed by SIGKILL"):
            engine.step(1)
        assert not any(is_running(pid) for pid in pids)
        for use in (lambda: engine.step(1), engine.reset, lambda: engine.link_poses):
            with pytest.raises(SimulationError, match="environments 2 to 3"):
                use()


def test_errors_of_workers_are_those_of_one_process() -> None:
    with made(5, 1, envs_per_world=1) as alone, made(5, 2, envs_per_world=1) as split:
        told = []
        for engine in (alone, split):
            fast = torch.tensor([[0.0, 0.0, 2e4, 0.0, 0.0, 0.0]] * 2)
            engine.write_root_state(1, None, fast, torch.tensor([4, 0]))
            with pytest.raises(SimulationError) as diverged:
                engine.step(1)
            assert (engine.link_poses[[0, 4], 2, 2] > 10.0).all()  # what became of them can be seen
            engine.raises_divergence = False
            engine.step(1)
            engine.raises_divergence = True
            engine.reset()
            engine.position_targets[3] = torch.nan
            with pytest.raises(SimulationError) as broken:
                engine.step(1)
            engine.reset()
            with pytest.raises(ConfigurationError) as stiff:
                engine.set_joint_parameters(torch.tensor([0]), None, None, None, torch.full((5, 1), 1e9))
            engine.step(2)
            assert engine.link_poses.isfinite().all()
            told.append([str(error.value) for error in (diverged, broken, stiff)])
        assert told[0] == told[1]
        assert "environments 0, 4 diverged" in told[1][0]
