"""How a task is learned unless told otherwise."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PpoSettings:
    """Proximal policy optimisation: Schulman et al., Proximal Policy Optimization Algorithms (2017).

    The learning rate follows the Kullback-Leibler divergence between policies where a library can do that.
    """

    iterations: int = 500
    """Of collecting and learning."""
    steps_per_iteration: int = 24
    """Environment steps that every environment contributes to an iteration."""
    hidden_sizes: tuple[int, ...] = (256, 128, 64)
    """Units of the hidden layers, of actor and critic each."""
    initial_std: float = 0.5
    """Of the actions, whose range is [-1, 1]."""
    learning_rate: float = 1e-3
    target_kl: float = 0.01
    epochs: int = 5
    minibatches: int = 4
    discount: float = 0.98
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.002
    normalize_observations: bool = True
