"""Declared gaps: the scenarios in which a backend is known to miss the truth, by how much and why."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Gap:
    """A declared miss of one metric of one conformance scenario, or of one check of robots.

    The conformance suite fails when the miss grows beyond ``limit``, and also when it is gone: a declaration is held to
    be true both ways.
    """

    scenario: str
    metric: str
    limit: float
    """The largest error that the backend admits to, in the metric's unit: what was measured, with a margin.

    ``math.inf`` where the engine diverges and raises :class:`SimulationError`, or refuses the scene at its time step by
    a :class:`ConfigurationError`.
    """
    reason: str
    """Why the engine cannot do better."""
    robots: tuple[str, ...] = ()
    """Names of the robots that miss it, where ``scenario`` is a check of robots."""
