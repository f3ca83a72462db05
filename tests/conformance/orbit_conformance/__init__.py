"""Measurements of accuracy and speed of each backend, from physics with known answers up to whole tasks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

if TYPE_CHECKING:
    from orbit_conformance.results import Record, Result, load
    from orbit_conformance.runner import run
    from orbit_conformance.scenario import Metric, Scenario, Trace, Trial
    from orbit_conformance.scenarios import SCENARIOS
    from orbit_conformance.settings import Settings
    from orbit_conformance.verdict import Status, Verdict, run_scenario

__all__ = [
    "SCENARIOS",
    "Metric",
    "Record",
    "Result",
    "Scenario",
    "Settings",
    "Status",
    "Trace",
    "Trial",
    "Verdict",
    "load",
    "run",
    "run_scenario",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "results": (
            "Record",
            "Result",
            "load",
        ),
        "runner": ("run",),
        "scenario": (
            "Metric",
            "Scenario",
            "Trace",
            "Trial",
        ),
        "scenarios": ("SCENARIOS",),
        "settings": ("Settings",),
        "verdict": (
            "Status",
            "Verdict",
            "run_scenario",
        ),
    },
)
