"""Settings of proximal policy optimisation, which tasks have defaults of."""

from __future__ import annotations

import math
from dataclasses import dataclass

from orbit_core.interfaces import ArgumentError

MOST_UNITS = 2**16
"""Largest number of units of a network's hidden layer."""
_CRITIC_FIRST = 10
_PRECISIONS = ("float32", "tf32", "bfloat16")


@dataclass(frozen=True)
class PpoSettings:
    """Proximal policy optimisation: Schulman et al., Proximal Policy Optimization Algorithms (2017).

    The learning rate follows the Kullback-Leibler divergence between policies where a library can do that.
    """

    iterations: int = 500
    """Number of iterations, each of collecting steps and learning from them."""
    steps_per_iteration: int = 24
    """Environment steps that every environment contributes to an iteration."""
    hidden_sizes: tuple[int, ...] = (256, 128, 64)
    """Units of the hidden layers, of actor and critic each."""
    initial_std: float = 0.5
    """Standard deviation of the actions at first; their range is [-1, 1]."""
    learning_rate: float = 1e-3
    """Step size of Adam, at first where a library adapts it."""
    target_kl: float = 0.01
    """Kullback-Leibler divergence from the last iteration's policy that the learning rate is adapted to."""
    epochs: int = 5
    """Passes over an iteration's steps."""
    minibatches: int = 4
    """Parts of an iteration's steps, each of which makes one gradient step of a pass."""
    discount: float = 0.98
    """Weight of the next step's return, per environment step."""
    gae_lambda: float = 0.95
    """Schulman et al., High-Dimensional Continuous Control Using Generalized Advantage Estimation (2016)."""
    clip: float = 0.2
    """Largest deviation from 1 of the ratio of probabilities."""
    clip_value: bool = True
    """True to stop the critic's learning in an iteration once its estimate has moved by ``clip``, in units of the
    return; it then lags behind large returns that grow fast. Libraries orbit and rsl-rl take it; others never clip."""
    entropy_weight: float = 0.002
    """Weight of the entropy bonus, which keeps exploration alive."""
    normalize_observations: bool = True
    """True to shift and scale observations to mean 0 and deviation 1 by their own statistics."""
    imitation_steps: int = 0
    """Gradient steps in which the actor imitates what the task's expert did on its way, before the first iteration;
    needs ``expert_starts`` of the task, and RSL-RL."""
    start: str = ""
    """A kept policy's name, a policy's file or a training's folder that the actor begins with; it may have seen less.
    Its hidden layers are those of ``hidden_sizes``; needs RSL-RL."""
    critic_first: int | None = None
    """Iterations at first in which the critic alone learns, for a beginner's judgement leads astray an actor that is
    good already (Ramrakhya et al., PIRLNav, 2023); needs RSL-RL. None: 10 where ``start`` is given, else none."""

    precision: str = "float32"
    """Numbers of matrix products in an update: float32, tf32 (10 bits, on a GPU's tensor cores) or bfloat16 (7 bits).
    Others than float32 need library orbit."""
    compile_update: bool = False
    """Whether an update's loss is compiled by torch.compile, which pays after some thousand iterations; needs library
    orbit."""

    def __post_init__(self) -> None:
        """Check the ranges.

        Raises:
            ArgumentError: a setting is out of its range.
        """
        for name in ("iterations", "steps_per_iteration", "epochs", "minibatches"):
            self._check(name, 1, math.inf)
        for name in ("initial_std", "learning_rate", "target_kl", "clip"):
            self._check(name, math.ulp(0.0), math.inf)
        for name in ("discount", "gae_lambda"):
            self._check(name, 0.0, 1.0)
        self._check("entropy_weight", 0.0, math.inf)
        self._check("imitation_steps", 0, math.inf)
        if self.critic_first is not None:
            self._check("critic_first", 0, math.inf)
        if self.precision not in _PRECISIONS:
            raise ArgumentError(f"precision is {self.precision!r}: give one of {', '.join(_PRECISIONS)}")
        if not self.hidden_sizes or not all(1 <= units <= MOST_UNITS for units in self.hidden_sizes):
            raise ArgumentError(f"hidden_sizes are {self.hidden_sizes}: give each layer 1 to {MOST_UNITS} units")

    @property
    def iterations_of_critic(self) -> int:
        """Iterations at first in which the critic alone learns."""
        if self.critic_first is None:
            return _CRITIC_FIRST if self.start else 0
        return self.critic_first

    def _check(self, name: str, least: float, most: float) -> None:
        value = getattr(self, name)
        if not least <= value <= most:
            wanted = {math.inf: f"at least {least:g}"}.get(most, f"{least:g} to {most:g}")
            wanted = "a number above zero" if least == math.ulp(0.0) else wanted
            raise ArgumentError(f"{name} is {value!r}: give {wanted}")
