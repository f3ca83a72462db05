"""A policy's first steps after the task's expert, before it learns by itself.

Why: Rajeswaran et al., Learning Complex Dexterous Manipulation with Deep Reinforcement Learning and Demonstrations
(2018), where imitation comes first and a policy gradient after.
"""

from __future__ import annotations

import torch
from torch import nn

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_groups import POLICY
from orbit_core.envs.ppo import PpoSettings
from orbit_core.interfaces import ConfigurationError

# Moments in a gradient step.
_BATCH = 4096


def imitate_expert(environment: Environment, network: nn.Module, normalizer: nn.Module, settings: PpoSettings) -> float:
    """Fit what the network does to what the expert did where episodes begin on its way (:class:`ExpertStarts`).

    A last action among what the policy sees is taken from other moments: an expert mostly does what it did before, and
    who learns that from it never begins anything, such as to close a gripper (de Haan et al., Causal Confusion in
    Imitation Learning, 2019).

    Args:
        environment: whose expert it is.
        network: from normalised observations (K, O) to the means of actions (K, A).
        normalizer: of observations; takes those on the expert's way into its statistics.
        settings: number of gradient steps, and the learning rate.

    Returns:
        the mean squared error of the last gradient step.

    Raises:
        ConfigurationError: no episodes begin on the expert's way, or the policy sees more than one tensor.
    """
    starts = environment.starts
    if starts is None or not starts.seen.numel():
        raise ConfigurationError(
            f"imitation_steps={settings.imitation_steps} needs what an expert saw and did: set expert_starts of the "
            "task above zero, and let the policy see one tensor, or set imitation_steps=0"
        )
    seen, done = starts.seen, starts.done
    last = environment.observation[POLICY].columns.get("last_action")
    if settings.normalize_observations:
        normalizer.update(seen)  # pyright: ignore[reportCallIssue]
    optimizer = torch.optim.Adam(network.parameters(), settings.learning_rate)
    generator = torch.Generator(seen.device).manual_seed(0)
    loss = torch.zeros((), device=seen.device)
    for _ in range(settings.imitation_steps):
        rows = torch.randint(len(seen), (min(_BATCH, len(seen)),), generator=generator, device=seen.device)
        shown = seen[rows]
        if last is not None:
            shown[:, last] = shown[:, last].roll(1, 0)  # rows are drawn at random
        loss = (network(normalizer(shown)) - done[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return float(loss.detach())
