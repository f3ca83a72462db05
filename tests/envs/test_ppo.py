"""What of a training's settings is refused, and where it is told."""

from __future__ import annotations

from typing import Any

import pytest

from orbit_core.envs import PpoSettings
from orbit_core.envs.configuration import configure
from orbit_core.interfaces import ArgumentError, ConfigurationError
from orbit_tasks.reach import Reach


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"iterations": 0}, "iterations is 0: give at least 1"),
        ({"epochs": -1}, "epochs is -1: give at least 1"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0: give a number above zero"),
        ({"clip": float("nan")}, "clip is nan: give a number above zero"),
        ({"discount": 1.5}, "discount is 1.5: give 0 to 1"),
        ({"entropy_weight": -0.1}, "entropy_weight is -0.1: give at least 0"),
        ({"hidden_sizes": ()}, r"hidden_sizes are \(\): give each layer 1 to 65536 units"),
        ({"hidden_sizes": (64, 0)}, r"hidden_sizes are \(64, 0\): give each layer 1 to 65536 units"),
    ],
)
def test_settings_out_of_range_are_named(settings: dict[str, Any], told: str) -> None:
    with pytest.raises(ArgumentError, match=told):
        PpoSettings(**settings)


def test_a_setting_of_a_task_is_named_with_its_place() -> None:
    with pytest.raises(ConfigurationError, match=r"'metadata.ppo' of task Reach: learning_rate is -1"):
        configure(Reach, {"metadata.ppo.learning_rate": -1.0})
