"""The policies that come with the tasks still fit them, and still do them."""

from __future__ import annotations

from pathlib import Path

import pytest

from orbit_core.backends import default_backend
from orbit_core.cli.runner import run
from orbit_core.cli.settings import RunSettings
from orbit_core.learning.policy import load_policy

POLICIES = Path(__file__).parents[2] / "orbit_tasks/policies"


@pytest.mark.parametrize("name", sorted(folder.name for folder in POLICIES.iterdir()))
def test_a_kept_policy_does_its_task(name: str) -> None:
    """Learned on one engine, played on another: at least 3 of 4 episodes."""
    folder = POLICIES / name
    learned = load_policy(folder).description
    settings = RunSettings(
        task=learned.task, action=learned.action, backend=default_backend(), agent=str(folder), num_envs=24, episodes=24
    )
    assert run(settings).success_rate >= 0.75
