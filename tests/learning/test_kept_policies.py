"""The policies that come with the tasks still fit them, and still do them."""

from __future__ import annotations

import pytest

from orbit_core.backends import default_backend
from orbit_core.cli.runner import run
from orbit_core.cli.settings import RunSettings
from orbit_core.learning.policy import load_policy
from orbit_core.policies import kept_policies, policy_path


@pytest.mark.parametrize("name", kept_policies())
def test_a_kept_policy_does_its_task(name: str) -> None:
    """Learned on one engine, played on another by its name: at least 3 of 4 episodes."""
    learned = load_policy(policy_path(name)).description
    settings = RunSettings(
        task=learned.task, action=learned.action, backend=default_backend(), agent=name, num_envs=24, episodes=24
    )
    assert run(settings).success_rate >= 0.75
