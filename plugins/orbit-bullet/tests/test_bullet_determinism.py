"""An environment of a real task does the same whatever the number of environments beside it."""

from __future__ import annotations

import gymnasium
import torch

import orbit_learn  # noqa: F401 -- registers the environments


def test_lift_repeats_alone_what_it_does_among_eight() -> None:
    """A second of random actions, with contact between gripper, cube and table: bit for bit the same."""
    alone, among = (
        gymnasium.make_vec(
            "orbit/Lift-v0", num_envs=count, backend="bullet", robot="franka_panda", settings={"workers": 1}
        )
        for count in (1, 8)
    )
    first, others = alone.reset(seed=3)[0], among.reset(seed=3)[0]
    draws = torch.Generator().manual_seed(0)
    for _ in range(50):
        torch.testing.assert_close(first["policy"][0], others["policy"][0], rtol=0, atol=0)
        actions = 2 * torch.rand(among.action_space.shape, generator=draws) - 1
        first, others = alone.step(actions[:1])[0], among.step(actions)[0]
    alone.close()
    among.close()
