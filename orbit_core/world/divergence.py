"""Environments that diverge go back to their start within the step, so that the others go on."""

from __future__ import annotations

import torch

from orbit_core.actuators import Actuators
from orbit_core.interfaces import Engine, diverged
from orbit_core.interfaces.world import WorldClock, WorldSelector


class DivergenceGuard:
    """Looks after each stretch of the engine's steps for environments that diverged, notes them, and resets them.

    The engine raises no error for them from then on. What else is reset where an episode begins is its owner's to do.
    Deformables are not looked at: those that diverge raise as before.

    Args:
        engine: whose environments are watched.
        actuators: that forget what was commanded.
        clock: of the world's state.
        selector: of environments.
    """

    def __init__(self, engine: Engine, actuators: Actuators, clock: WorldClock, selector: WorldSelector) -> None:
        engine.raises_divergence = False
        self._engine, self._actuators, self._clock, self._selector = engine, actuators, clock, selector
        self.lost = torch.zeros(engine.num_envs, dtype=torch.bool, device=engine.device)
        """(N,) which environments have diverged since their owner last set it to False."""

    def look(self) -> None:
        """Reset the environments that diverged in the steps just taken."""
        engine = self._engine
        wrong = diverged(engine.link_poses, engine.link_velocities)
        wrong = wrong | diverged(engine.joint_positions, engine.joint_velocities)
        self.lost.logical_or_(wrong)
        rows = self._selector.where(wrong)
        if rows is not None:
            self._engine.reset(rows)
            self._actuators.reset(rows)
            self._clock.touch()
