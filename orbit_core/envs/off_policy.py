"""Settings of off-policy algorithms, which tasks have defaults of."""

from __future__ import annotations

import math
from dataclasses import dataclass

from orbit_core.envs.ppo import MOST_UNITS
from orbit_core.interfaces import ArgumentError, UnknownNameError

ALGORITHMS = ("sac", "td3")
"""Names of the algorithms."""
_PRECISIONS = ("float32", "tf32")


@dataclass(frozen=True)
class OffPolicySettings:
    """Soft actor-critic, or twin delayed deep deterministic policy gradients."""

    algorithm: str = "sac"
    """sac (stochastic, with a learned temperature) or td3 (deterministic, with noise)."""
    iterations: int = 500
    """Number of iterations, each of collecting steps and learning from them."""
    steps_per_iteration: int = 16
    """Environment steps that every environment contributes to an iteration."""
    updates_per_step: int = 2
    """Gradient steps for one step of all environments."""
    batch_size: int = 0
    """Transitions in a gradient step; 0 for eight of each environment, between 256 and 32,768 (256 in library sb3)."""
    buffer_size: int = 1_000_000
    """Transitions that are kept, of all environments together."""
    warm_up: int = 16
    """Steps of every environment before the first gradient step."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Units of the actor's hidden layers."""
    critic_sizes: tuple[int, ...] = (256, 256)
    """Units of each critic's hidden layers."""
    learning_rate: float = 5e-4
    """Adam's rate for actor, critics and temperature."""
    discount: float | None = None
    """Weight of the next step's return, per environment step; that of the task's PPO settings if None."""
    horizon: int = 3
    """Steps whose rewards are summed before the critic's estimate; more than 1 is biased by older policies, and
    faster."""
    target_rate: float = 0.01
    """Share by which the target critics follow the critics in a gradient step."""
    policy_delay: int = 2
    """Gradient steps of the critics for one of the actor; SAC of library sb3 has one for each."""
    target_entropy: float = -1.0
    """Entropy that SAC's temperature holds, for each component of the action."""
    temperature: float = 0.01
    """SAC's weight of entropy at first; it is learned."""
    noise: tuple[float, float] = (0.05, 0.4)
    """Smallest and largest deviation of TD3's exploration; each environment draws its own for an episode."""
    normalize_observations: bool = True
    """True to shift and scale observations to mean 0 and deviation 1 by their own statistics."""
    precision: str = "tf32"
    """Arithmetic of matrix products on a GPU: tf32 (10 bits of mantissa, on tensor cores) or float32; library
    sb3 leaves that to torch."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            UnknownNameError: there is no such algorithm.
            ArgumentError: a setting is out of its range.
        """
        if self.algorithm not in ALGORITHMS:
            raise UnknownNameError("algorithm", self.algorithm, ALGORITHMS, "library orbit")
        if self.precision not in _PRECISIONS:
            raise UnknownNameError("precision", self.precision, _PRECISIONS, "library orbit")
        positive = ("iterations", "steps_per_iteration", "updates_per_step", "buffer_size", "warm_up", "horizon")
        for name in (*positive, "policy_delay"):
            if getattr(self, name) < 1:
                raise ArgumentError(f"{name} is {getattr(self, name)!r}: give at least 1")
        if self.batch_size < 0:
            raise ArgumentError(f"batch_size is {self.batch_size}: give at least 1, or 0 for the algorithm's own")
        for name in ("learning_rate", "temperature"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ArgumentError(f"{name} is {getattr(self, name)!r}: give a number above zero")
        if not 0.0 < self.target_rate <= 1.0:
            raise ArgumentError(f"target_rate is {self.target_rate!r}: give a share above 0 and up to 1")
        if self.discount is not None and not 0.0 <= self.discount <= 1.0:
            raise ArgumentError(f"discount is {self.discount!r}: give 0 to 1")
        if not 0.0 <= self.noise[0] <= self.noise[1]:
            raise ArgumentError(f"noise is {self.noise}: give two deviations, the smaller first")
        for name in ("hidden_sizes", "critic_sizes"):
            sizes = getattr(self, name)
            if not sizes or not all(1 <= units <= MOST_UNITS for units in sizes):
                raise ArgumentError(f"{name} are {sizes}: give each layer 1 to {MOST_UNITS} units")
