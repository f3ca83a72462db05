"""What tasks of manipulation refuse before anything is simulated, by the field's name and its range."""

from __future__ import annotations

import pytest

from orbit_core.envs import make
from orbit_core.interfaces import ConfigurationError


@pytest.mark.parametrize(
    ("task", "name", "value"),
    [
        ("Jenga", "penalty", -0.01),
        ("Jenga", "layers", 0),
        ("Nut-Bolt", "tolerance", 0.0),
        ("Nut-Bolt", "lead", -0.002),
        ("Dishwasher", "door_goal", 10.0),
        ("Dishwasher", "tolerance", -1.0),
        ("Beat-The-Buzz", "penalty", -1.0),
        ("In-Hand-Repose", "tolerance", 0.0),
        ("In-Hand-Repose", "goals", 0),
        ("Stack-Pyramid", "blocks", 4),
        ("Peg-In-Hole", "tolerance", 1.0),
    ],
)
def test_a_value_out_of_range_is_refused_by_name(task: str, name: str, value: float) -> None:
    with pytest.raises(ConfigurationError, match=rf"field '{name}' of task \w+ must be .* to .*, not {value:g}"):
        make(task, 1, "mujoco", **{name: value})
