"""The yardstick of the overhead benchmark simulates what the environment simulates."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_core.envs import make
from orbit_mujoco.native_baseline import raw_steppers


@pytest.mark.parametrize("way", ["all cores, persistent", "1 thread, not persistent"])
def test_raw_stepping_repeats_the_environments_motion(way: str):
    environment = make("Lift", 3, "mujoco", seed=1)
    generator = torch.Generator().manual_seed(0)
    raw = raw_steppers(environment.world.engine)[way]  # pyright: ignore[reportArgumentType] - this backend's engine
    raw.synchronize()
    for _ in range(20):
        environment.step(2.0 * torch.rand(3, environment.action_size, generator=generator) - 1.0)
        raw.step(raw.command(), environment.task.decimation)
    mine, theirs = environment.world.native[1], raw._batch
    np.testing.assert_array_equal(mine.qpos, theirs.qpos)
    np.testing.assert_array_equal(mine.qvel, theirs.qvel)
    environment.close()
