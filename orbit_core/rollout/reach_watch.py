"""How often hands are asked to go where their joints cannot bring them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from torch import Tensor

from orbit_core.actions.reach import PoseFollower
from orbit_core.rollout.stepping import StepObserver

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment, EpisodeEnd

_EVERY = 50
"""Steps from one look to the next: searching for a pose takes as long as several steps."""


class ReachWatch(StepObserver):
    """Looks now and then whether a hand rests away from what is asked of it, for it is out of reach.

    Args:
        environment: that is stepped; what it moves by poses is watched.
    """

    def __init__(self, environment: Environment) -> None:
        self._followers = [item for item in environment.actions.generators if isinstance(item, PoseFollower)]
        self._steps, self._looks, self._found = 0, 0, 0
        self.farthest = 0.0
        """m by which the nearest pose misses, at most."""

    @property
    def share(self) -> float:
        """In [0, 1]: of the looks at hands, those that found one out of reach of what was asked."""
        return self._found / max(self._looks, 1)

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        self._steps += 1
        if self._steps % _EVERY:
            return
        for follower in self._followers:
            self._looks += follower.num_envs
            resting = follower.resting_off()
            if bool(resting.any()):
                missing = follower.out_of_reach()[resting]
                self._found += int(missing.any(1).sum())
                self.farthest = max(self.farthest, float(missing[:, 0].max()))
