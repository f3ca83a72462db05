"""Patience of these tests, which share their cores with others."""

from __future__ import annotations

import pytest

pytest.importorskip("cyclonedds", reason="ROS over DDS needs cyclonedds: pip install orbit-ros")


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a loop wait for a core longer than a robot's may."""
    for module in ("hosted", "hardware", "unitree.robot"):
        monkeypatch.setattr(f"orbit_ros.{module}._LOST", 10.0)
