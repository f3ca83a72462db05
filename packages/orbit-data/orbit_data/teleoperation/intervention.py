"""Interventions: a policy acts until a person moves the device, and again once the person has let go."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_data.augmentation import opens_gripper
from orbit_data.teleoperation.device import Event, Reading
from orbit_data.teleoperation.driver import Driver

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment

# rad or m within which a leader's joint counts as still: encoders flicker, and so do the hands that rest on them.
_STILL = 0.01
# Seconds without a request after which the policy acts again: a person pauses while looking.
_RELEASED = 1.0


class Intervention:
    """Policy that a person corrects: Kelly et al., HG-DAgger: Interactive Imitation Learning with Human Experts (2019).

    Args:
        environment: a single environment.
        driver: driver of its robots, for the person.
        make_policy: makes the actor of the policy, at the beginning of an episode and after each intervention.
    """

    def __init__(self, environment: Environment, driver: Driver, make_policy: Callable[[], Actor]) -> None:
        self._environment, self._driver, self._make_policy = environment, driver, make_policy
        self._patience = max(1, round(_RELEASED / environment.step_dt))
        self._policy = make_policy()
        self._still = 0
        self._last: Tensor | None = None
        self._placed: tuple[bool | None, Mapping[str, float]] = (None, {})
        self.leads = False
        """True if the person led the last step."""

    @property
    def led(self) -> Tensor:
        """(1,) bool, whether the person led the last step."""
        return torch.tensor([self.leads], device=self._environment.device)

    def begin(self) -> None:
        """Let the policy act from the beginning of an episode."""
        self._policy, self.leads, self._last = self._make_policy(), False, None

    def act(self, reading: Reading) -> Tensor:
        """Return the action (1, A) of whoever leads."""
        if self._asks(reading):
            if not self.leads:
                self._take_over()
            self.leads, self._still = True, 0
        elif self.leads:
            self._still += 1
            if self._still >= self._patience:
                self.begin()  # the policy's plan and memory are of before the intervention
        self._last = self._driver.act(reading) if self.leads else self._policy.act()
        return self._last

    def _take_over(self) -> None:
        """Hold everything where it is, and the gripper as the policy commanded it."""
        self._driver.restart()
        if self._driver.hand is not None and self._last is not None:
            self._driver.hand.gripper_open = bool(opens_gripper(self._environment, self._last)[0])

    def _asks(self, reading: Reading) -> bool:
        """Return True if the person asks for a motion or for the gripper."""
        moves = any(reading.twist or ()) or any(reading.base)
        placed = reading.moved_at is not None and not reading.events and self._displaced(reading)
        return moves or placed or Event.GRIPPER in reading.events

    def _displaced(self, reading: Reading) -> bool:
        """Return True if absolute requests differ from those of the last motion: a leader arm repeats them at rest."""
        if reading.pose is not None:
            return True
        joints, (gripper, before) = reading.joints or {}, self._placed
        near = all(abs(value - before.get(name, inf)) < _STILL for name, value in joints.items())
        if near and reading.gripper_open == gripper and (joints or gripper is not None):
            return False
        self._placed = reading.gripper_open, joints
        return True
