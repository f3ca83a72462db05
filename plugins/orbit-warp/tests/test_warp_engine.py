"""What is the Warp backend's own: full buffers, graphs, and what of its settings cannot be."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from orbit_assets.terrain import Rough, TerrainGrid
from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError, SceneLayout, SimulationError
from orbit_core.interfaces.layout import TERRAIN
from orbit_core.scene import Box, ObjectSpec, Pose, Scene, Shape, single_link
from orbit_warp import WarpBackend, WarpConfig
from orbit_warp.engine import WarpEngine
from orbit_warp.native_baseline import raw_steppers


def cubes(count: int) -> Scene:
    """Cubes in a row on the ground."""
    shape = Shape(Box((0.05, 0.05, 0.05)))
    return Scene(
        objects=tuple(
            ObjectSpec(
                name=f"cube{i}",
                articulation=single_link("cube", shape, 1.0, np.eye(3) / 600),
                pose=Pose((0.2 * i, 0.0, 0.05)),
            )
            for i in range(count)
        )
    )


def engine_of(scene: Scene, num_envs: int = 2, **settings: object) -> WarpEngine:
    config = WarpConfig(**settings)  # pyright: ignore[reportArgumentType]
    engine = WarpBackend().create_engine(SceneLayout.of(scene), num_envs, torch.device("cpu"), config)
    assert isinstance(engine, WarpEngine)
    return engine


def test_importing_the_plugin_imports_no_engine() -> None:
    code = "import sys, orbit_warp; print([m for m in ('warp', 'mujoco', 'mujoco_warp', 'torch') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("setting", "remedy"), [({"nconmax": 4}, "nconmax=8"), ({"nconmax": 40, "njmax": 10}, "njmax=20")]
)
def test_a_full_buffer_is_an_error_that_names_the_remedy(setting: dict[str, int], remedy: str) -> None:
    engine = engine_of(cubes(3), **setting)
    with pytest.raises(SimulationError, match=remedy):
        engine.step(5)
    assert engine.overflows == 1


def test_a_full_buffer_may_be_counted_instead() -> None:
    engine = engine_of(cubes(3), nconmax=4, overflow="count")
    with pytest.warns(RuntimeWarning, match="nconmax=8"):
        engine.step(5)
    engine.step(5)
    assert engine.overflows == 2


def test_buffers_fit_the_scene_and_tell_what_they_needed() -> None:
    engine = engine_of(cubes(3))
    engine.step(50)
    assert engine.overflows == 0
    assert 12 <= engine.buffer_peaks.nconmax <= engine.buffer_sizes.nconmax
    assert 48 <= engine.buffer_peaks.njmax <= engine.buffer_sizes.njmax


def test_a_speed_beyond_the_bounds_is_an_error_that_names_its_environment() -> None:
    engine = engine_of(cubes(1))
    engine.write_root_state(0, None, torch.tensor([[0.0, 0.0, 2e4, 0.0, 0.0, 0.0]]), torch.tensor([1]))
    with pytest.raises(SimulationError, match="environments 1 diverged"):
        engine.step(1)
    engine.reset(torch.tensor([1]))
    engine.step(1)


def test_a_replayed_graph_does_what_its_launches_do() -> None:
    recorded, issued = engine_of(cubes(2), capture=True), engine_of(cubes(2), capture=False)
    for engine in (recorded, issued):
        for steps in (3, 2, 3):
            engine.write_root_state(0, None, torch.tensor([[1.0, 0.2, 0.0, 0.0, 0.0, 2.0]] * 2))
            engine.step(steps)
        engine.set_masses(torch.tensor([0]), torch.tensor([[3.0]]), torch.tensor([1]))
        engine.step(3)
    assert torch.equal(recorded.link_poses, issued.link_poses)
    assert torch.equal(recorded.link_velocities, issued.link_velocities)


@pytest.mark.parametrize("task", ["Lift", "Soft-Lifting", "Fluid-Transport"])
def test_no_array_is_made_on_another_device_than_the_worlds(task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An array that names no device is made on a GPU that Warp sees, also for a world on the CPU."""
    made, depth = wp.array.__init__, 0
    enter, leave = wp.ScopedDevice.__enter__, wp.ScopedDevice.__exit__

    def entered(scope: wp.ScopedDevice) -> object:
        nonlocal depth
        depth += 1
        return enter(scope)

    def left(scope: wp.ScopedDevice, *raised: Any) -> None:
        nonlocal depth
        depth -= 1
        leave(scope, *raised)

    def init(array: wp.array, *words: Any, **options: Any) -> None:
        assert depth or options.get("device") is not None or options.get("ptr") is not None
        made(array, *words, **options)

    monkeypatch.setattr(wp.ScopedDevice, "__enter__", entered)
    monkeypatch.setattr(wp.ScopedDevice, "__exit__", left)
    monkeypatch.setattr(wp.array, "__init__", init)
    environment = make(task, 2, "warp")
    environment.reset()
    environment.step(torch.zeros(2, environment.action_size))
    environment.close()


def test_states_are_the_engines_own_memory() -> None:
    environment = make("Reach", 2, "warp")
    engine = environment.world.engine
    assert isinstance(engine, WarpEngine)
    before = engine.joint_positions.data_ptr(), engine.link_poses.data_ptr(), engine.joint_efforts.data_ptr()
    environment.step(torch.ones(2, environment.action_size))
    assert before == (engine.joint_positions.data_ptr(), engine.link_poses.data_ptr(), engine.joint_efforts.data_ptr())
    assert engine.joint_positions.data_ptr() == engine.native.data.qpos.ptr
    environment.close()


def test_raw_stepping_repeats_the_environments_motion() -> None:
    environment = make("Lift", 3, "warp", seed=1)
    generator = torch.Generator().manual_seed(0)
    (raw,) = raw_steppers(environment.world.engine).values()  # pyright: ignore[reportArgumentType]
    raw.synchronize()
    for _ in range(10):
        environment.step(2.0 * torch.rand(3, environment.action_size, generator=generator) - 1.0)
        raw.step(raw.command(), environment.task.decimation)
    mine = environment.world.native.data
    np.testing.assert_array_equal(mine.qpos.numpy(), raw._data.qpos.numpy())
    np.testing.assert_array_equal(mine.qvel.numpy(), raw._data.qvel.numpy())
    environment.close()


@pytest.mark.parametrize(
    "settings", [{"integrator": "verlet"}, {"overflow": "hide"}, {"nconmax": -1}, {"iterations": 0}]
)
def test_settings_that_cannot_be(settings: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(settings))):
        WarpConfig(**settings)  # pyright: ignore[reportArgumentType]


def test_other_devices_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="mps"):
        WarpBackend().create_engine(SceneLayout.of(cubes(1)), 1, torch.device("mps"), WarpConfig())


def test_a_thread_for_each_ray_and_a_block_for_each_measure_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Straight down and slantwise on rough ground with a cube on it, past another cube; one environment of two asks."""
    grid = TerrainGrid(kinds=(Rough(),), levels=1, difficulty=(1.0, 1.0), cell_size=4.0, border=1.0)
    scene = replace(cubes(2), terrain=grid.shapes())
    generator = torch.Generator().manual_seed(0)
    origins = torch.rand(2, 60, 3, generator=generator) * 0.4 + torch.tensor([0.0, -0.2, 1.0])
    directions = torch.tensor([0.0, 0.0, -1.0]).repeat(2, 60, 1)
    directions[:, ::2, :2] = 0.3 * torch.randn(2, 30, 2, generator=generator)
    directions = torch.nn.functional.normalize(directions, dim=2)
    found, blocks, launch_tiled = [], [], wp.launch_tiled
    monkeypatch.setattr(wp, "launch_tiled", lambda *args, **words: blocks.append(1) or launch_tiled(*args, **words))
    for few in (None, 0):  # as it is, and never
        if few is not None:
            monkeypatch.setattr("orbit_warp.rays._FEW", few)
        engine = engine_of(scene)
        assert not blocks, "a grid of terrain with its border and a few things on it are few"
        hits = engine.cast_rays_past(origins, directions, 3.0, range(1), torch.tensor([True, False]))
        found.append((hits.distances[0], hits.normals[0], hits.links[0]))
    assert blocks
    assert set(found[0][2].tolist()) == {TERRAIN, 1}
    for single, block in zip(*found, strict=True):
        torch.testing.assert_close(single, block)
