"""Session: environments of one project in a worker process, stepped, drawn and compared with their bare engine.

Imported in the peers' own virtual environments, where ORBIT and its packages are absent: standard library only.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

# Drawing numbers is no part of a step, and takes ORBIT and its peers different times.
ACTIONS = 64
"""Random actions that are drawn before, and repeated."""
PICTURE = 84
"""Width and height in pixels of the pictures that are drawn."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """Environments that a worker makes."""

    adapter: str
    """Module of ``adapters`` that makes them."""
    environment: str
    """Name that the project gives the environment."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Further arguments of the adapter."""
    way: str = "batched"
    """Way of stepping several environments."""
    num_envs: int = 1
    """Number of environments."""
    device: str = "cpu"
    """Device that they are stepped on."""
    seed: int = 0
    """Seed of the environments and of the actions."""


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Properties of an environment, read from the project while it runs."""

    engine: str
    """Physics engine and its version."""
    physics_dt: float
    """Seconds of a physics step."""
    decimation: int
    """Physics steps of an environment's step."""
    action_size: int
    """Components of the action of one environment."""
    degrees_of_freedom: int
    """Velocity coordinates of the simulated model of one environment; 0 where the project does not report them."""


@dataclass(frozen=True)
class Block:
    """Uninterrupted work that was timed."""

    count: int
    """Steps of single environments, or pictures."""
    seconds: float
    """Wall time of all of them."""


class Session(ABC):
    """Environments that step with random actions and begin a new episode where one ends.

    Attributes:
        facts: properties of the environments.
        num_envs: number of environments.
    """

    facts: Facts
    num_envs: int

    @abstractmethod
    def step(self) -> None:
        """Step all environments once."""

    def settle(self) -> None:
        """Do what the first steps do once, such as compiling."""
        self.step()

    def stepped(self, seconds: float) -> Block:
        """Step for about that many seconds."""
        self.wait()
        calls, taken = repeated(self.step, seconds)
        _, rest = repeated(self.wait, 0.0)
        return Block(calls * self.num_envs, taken + rest)

    def wait(self) -> None:
        """Wait until the device has finished its work."""

    def stepped_raw(self, seconds: float) -> Block | None:
        """Step the bare engine through the same kind of motion; None where there is no such measurement."""
        return None

    def draw(self) -> None:
        """Draw one colour picture of one environment.

        Raises:
            NotImplementedError: the adapter draws none.
        """
        raise NotImplementedError("no pictures on this device")

    def close(self) -> None:
        """Free the environments."""


def repeated(function: Callable[[], object], seconds: float) -> tuple[int, float]:
    """Call a function until the time is over, once at least.

    Returns:
        Number of calls, and seconds that they took.
    """
    calls, start = 0, time.perf_counter()
    while True:
        function()
        calls += 1
        taken = time.perf_counter() - start
        if taken >= seconds:
            return calls, taken
