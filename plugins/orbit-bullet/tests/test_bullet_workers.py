"""Worker processes: the same results as in one process, and a clean end when one dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from orbit_bullet import BulletBackend, BulletConfig, pool, progress
from orbit_bullet.engine import BulletEngine
from orbit_bullet.pool import LocalPool, ProcessPool, make_pool
from orbit_bullet.stage import write_scene
from orbit_core.interfaces import AssetError, ConfigurationError, SceneLayout, SimulationError
from orbit_core.scene import (
    Articulation,
    Box,
    ContactSensorSpec,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    Pose,
    RobotSpec,
    Scene,
    Shape,
    single_link,
)


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
    return Scene(robots=(robot,), objects=(cube,), sensors=(ContactSensorSpec(name="touch", entity="cube"),))


def make(num_envs: int, scene: Scene | None = None, **settings: Any) -> BulletEngine:
    layout = SceneLayout.of(scene or busy_scene())
    engine = BulletBackend().create_engine(layout, num_envs, torch.device("cpu"), BulletConfig(**settings))
    assert isinstance(engine, BulletEngine)
    return engine


def shared_blocks() -> set[str]:
    """Of this process: others may be testing at the same time."""
    return {path.name for path in Path("/dev/shm").glob(f"orbit-bullet-{os.getpid()}-*")}


def is_running(pid: int) -> bool:
    """Whether the process exists, be it a zombie."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def pids_of(engine: BulletEngine) -> list[int]:
    assert isinstance(engine.native, ProcessPool)
    return engine.native.pids


def test_workers_change_nothing() -> None:
    """One process, and two of uneven shares: bit for bit the same."""
    engines = [make(5, workers=1), make(5, workers=2)]
    goals = torch.linspace(0.5, 2.0, 5)[:, None]
    for engine in engines:
        engine.write_root_state(1, torch.tensor([[0.25, 0.14, 0.06, 1.0, 0, 0, 0]]), None, torch.tensor([3]))
        engine.position_targets[:] = goals
        engine.step(60)
        engine.reset(torch.tensor([1, 4]))
        engine.position_targets[:] = -goals
        engine.step(40)
    for name in ("joint_positions", "joint_efforts", "link_poses", "link_velocities", "contact_forces"):
        for other in engines[1:]:
            assert torch.equal(getattr(engines[0], name), getattr(other, name)), name
    assert engines[0].contact_forces.abs().max() > 1.0
    for engine in engines:
        engine.close()


def iterations_of(engine: BulletEngine) -> list[int]:
    """Return the iterations that each island of one more step takes."""
    assert isinstance(engine.native, LocalPool)
    clients = [simulation.client for simulation in engine.native.shard.simulations]
    for client in clients:
        client.setPhysicsEngineParameter(reportSolverAnalytics=1)
    return [island["numIterationsUsed"] for client in clients for island in client.stepSimulation()]


def test_all_iterations_are_made_whatever_the_residual() -> None:
    """A bar that is driven and a cube at rest: ended early, contacts of other scenes go wrong."""
    engine = make(2, workers=1, envs_per_client=1)
    engine.position_targets[:] = torch.tensor([[-0.5], [-2.0]])
    engine.step(50)
    assert max(iterations_of(engine)) == 200
    engine.close()


def test_a_dead_worker_is_reported_and_nothing_stays() -> None:
    engine = make(6, workers=3)
    pids = pids_of(engine)
    assert not shared_blocks()  # the block has no name once the workers have it
    os.kill(pids[1], signal.SIGKILL)
    with pytest.raises(SimulationError, match=rf"process {pids[1]} of environments 2 to 3 died, killed by SIGKILL"):
        engine.step(1)
    assert not any(is_running(pid) for pid in pids)
    with pytest.raises(SimulationError, match="environments 2 to 3"):
        engine.step(1)
    with pytest.raises(SimulationError, match="environments 2 to 3"):
        engine.reset()
    engine.close()
    assert not shared_blocks()


def test_a_worker_that_dies_in_the_midst_of_a_step_is_reported() -> None:
    engine = make(4, workers=2)
    pids = pids_of(engine)
    pid = os.fork()
    if pid == 0:
        time.sleep(0.3)
        os.kill(pids[0], signal.SIGKILL)
        os._exit(0)
    with pytest.raises(SimulationError, match="environments 0 to 1 died"):
        engine.step(1_000_000)
    os.waitpid(pid, 0)
    assert not any(is_running(pid) for pid in pids)


def test_closing_ends_the_workers() -> None:
    engine = make(4, workers=2)
    pids = pids_of(engine)
    engine.close()
    engine.close()
    assert not any(is_running(pid) for pid in pids)
    with pytest.raises(SimulationError, match="closed"):
        engine.step(1)


def test_an_engine_that_is_forgotten_ends_its_workers() -> None:
    engine = make(4, workers=2)
    pids = pids_of(engine)
    del engine
    assert not any(is_running(pid) for pid in pids)


def test_an_error_of_a_worker_while_building_is_raised_here() -> None:
    from orbit_core.scene import HeightField

    field = Shape(HeightField(np.zeros((3, 3)), (1.0, 1.0)))
    scene = Scene(objects=(ObjectSpec(name="hill", articulation=single_link("hill", field, 1.0, np.eye(3))),))
    with pytest.raises(ConfigurationError, match="HeightField of link 'hill'"):
        make(4, scene, workers=2)


def test_a_body_that_moves_too_fast_has_diverged() -> None:
    engine = make(4, workers=2)
    engine.write_root_state(1, None, torch.tensor([[0.0, 0.0, 2e4, 0.0, 0.0, 0.0]]), torch.tensor([3]))
    with pytest.raises(SimulationError, match="environments 3 diverged: something moved faster"):
        engine.step(1)
    engine.close()


def test_environments_that_share_a_world_differ_by_rounding_alone() -> None:
    """Free swings in one world of four and in worlds of one: 1e-5 rad after half a second."""
    shared, alone = make(4, workers=1, envs_per_client=4), make(4, workers=1)
    for engine in (shared, alone):
        engine.position_targets[:] = torch.linspace(-0.5, -2.0, 4)[:, None]
        engine.step(100)
    torch.testing.assert_close(shared.joint_positions, alone.joint_positions, rtol=0, atol=1e-5)
    assert shared.joint_positions.abs().min() > 0.1
    for engine in (shared, alone):
        engine.close()


def test_a_model_that_a_worker_cannot_load_is_raised_here(tmp_path: Path) -> None:
    layout, config = SceneLayout.of(busy_scene()), BulletConfig(workers=2)
    files = write_scene(layout, tmp_path)
    files.entities[0].write_text("<robot")
    with pytest.raises(AssetError, match="'arm'"):
        make_pool(layout, files, 4, config)


def test_more_environments_than_memory_are_refused_before_any_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "_available_memory", lambda: 1e9)
    with pytest.raises(ConfigurationError, match=r"2\.9 GB, and 1\.0 GB are available, enough for 34 worlds: envs_per"):
        make(100, workers=1)
    make(100, workers=2, envs_per_client=15).close()


def test_more_worlds_than_bullet_holds_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="a process holds 1000: envs_per_client=15"):
        make(1001, workers=1)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_long_build_tells_how_far_it_is(
    workers: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_SILENT_FOR", 0.0)
    make(4, workers=workers).close()
    told = capsys.readouterr().err.splitlines()
    assert [line.split(",")[0] for line in told] == [
        f"orbit-bullet: built {count} of 4 environments" for count in (2, 3)
    ]
    assert told[0].endswith("s to go; all of them will take 0.1 GB of memory")


def test_threads_may_build_worlds_at_the_same_time() -> None:
    """Each hides the terminal from Bullet for a while; afterwards the process has it again."""
    code = (
        "import threading, torch, orbit_bullet as b\n"
        "from orbit_core.interfaces import SceneLayout\n"
        "from orbit_core.scene import Scene\n"
        "def build():\n"
        "    for _ in range(10):\n"
        "        config = b.BulletConfig(workers=1)\n"
        "        b.BulletBackend().create_engine(SceneLayout.of(Scene()), 2, torch.device('cpu'), config).close()\n"
        "threads = [threading.Thread(target=build) for _ in range(2)]\n"
        "for each in threads: each.start()\n"
        "for each in threads: each.join()\n"
        "print('both built')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("both built\n", "")


def test_a_diverged_environment_is_told_by_its_own_number() -> None:
    engine = make(6, workers=2)
    engine.efforts[4] = torch.nan
    with pytest.raises(SimulationError, match=r"\b4\b"):
        engine.step(1)
    engine.reset()
    engine.step(2)
    assert engine.link_poses.isfinite().all()
    engine.close()


def test_a_worker_starts_without_the_tensor_library() -> None:
    """Which takes seconds of a core to load, for each worker."""
    code = "import sys, orbit_bullet.worker; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
