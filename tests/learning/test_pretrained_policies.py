"""The policies that come with the tasks still fit them, and still act as on the day they were kept."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from orbit_core.backends import default_backend
from orbit_core.cli.making import make_actor, make_environment
from orbit_core.cli.run import run
from orbit_learn.cli.play import played
from orbit_learn.cli.trained import PlaySettings
from orbit_learn.policy import load_policy
from orbit_learn.pretrained import policy_path, pretrained_policies

KEPT_ACTIONS = sorted(Path(__file__).with_name("kept_actions").iterdir())
"""``<policy>_<iteration>.safetensors``: an observation (16, O), or the terms of one (4, ...) of a policy that sees
pictures, and the action (N, A) that the file in which the policy was first kept made of it.
A policy that is learned anew leaves its file without a purpose: delete it."""


@pytest.mark.parametrize("path", KEPT_ACTIONS, ids=lambda path: path.stem)
def test_a_kept_policy_acts_as_when_it_was_kept(path: Path) -> None:
    name, _, iteration = path.stem.rpartition("_")
    policy, kept = load_policy(policy_path(name)), load_file(path)
    assert policy.description.iteration == int(iteration)
    assert (kept["action"].abs() < 1.0).sum() > 8, "clipped components alone would say little"
    if policy.description.concatenated:
        torch.testing.assert_close(policy.module(kept["observation"]), kept["action"], atol=1e-6, rtol=0.0)
        return
    terms = {part.name: kept[f"observation/{part.name}"] for part in policy.description.observation_parts}
    torch.testing.assert_close(policy.module(terms), kept["action"], atol=1e-5, rtol=0.0)  # sums of thousands of pixels


PICTURES = [name for name in pretrained_policies() if load_policy(policy_path(name)).description.sees_pictures]


# Made before a gripper of a given force kept its velocity limit: who plays them is told so. With it they do as well.
OF_FASTER_GRIPPERS = ("cloth_lifting", "cloth_lifting_cloned", "soft_lifting")


@pytest.mark.rotates
@pytest.mark.parametrize("name", sorted({*pretrained_policies()} - {*PICTURES}))
def test_a_kept_policy_still_fits_its_task(name: str) -> None:
    """Played by its name, with the assets of then; how well it does is for the suite's transfers to hold."""
    settings = played(PlaySettings(policy=Path(name), backend=default_backend(), num_envs=2))
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "the policy of .* was made with other settings")
        if name in OF_FASTER_GRIPPERS:
            warnings.filterwarnings(
                "ignore", r"the policy of .* was made with other settings: assets\.robot was [^;]*$"
            )
        environment = make_environment(settings, settings.num_envs)
        actor = make_actor(settings.agent, environment, seed=0)
    environment.reset(seed=0)
    for _ in range(3):
        action = actor.act()
        environment.step(action)
    environment.close()
    assert action.isfinite().all()
    assert (action.abs().amax(1) > 0.0).all()


@pytest.mark.parametrize("name", PICTURES)
def test_a_kept_policy_does_its_task_on_pictures_of_another_renderer(name: str) -> None:
    """Played by its name alone on what draws fastest without a GPU: at least 3 of 4 episodes."""
    settings = PlaySettings(policy=Path(name), backend="mujoco", renderer="warp", num_envs=4, episodes=4)
    assert run(played(settings)).success_rate.value >= 0.75
