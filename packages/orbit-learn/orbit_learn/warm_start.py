"""A learned policy as the start of a training in an environment that shows more than it saw, such as a walker's on
terrain that it now sees.
"""  # fmt: skip

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_groups import POLICY
from orbit_core.envs.observation_layout import GroupLayout, one_tensor
from orbit_core.interfaces import ConfigurationError
from orbit_learn.networks import ActorNetwork, NormalizedActor, Perceptron
from orbit_learn.policy import Policy

LAST_ACTION = "last_action"
# At first, of what the environment shows now and the policy did not see: robots that begin on level ground see the
# same everywhere, and will see more than that.
_LEAST_STD = 0.2


def started_from(policy: Policy, environment: Environment) -> ActorNetwork:
    """Return a network that acts in the environment as the policy acts, whatever is shown there beside what the policy
    saw.

    Terms of the observation are matched by their names. What is new weighs nothing, and is normalised by what the
    environment shows now, on which a training that goes on improves. Where joints' targets are
    ``offset + scale * command``, commands are of the environment's own scale, and so is the last action among what is
    seen.

    Raises:
        ConfigurationError: the policy was learned for another robot, action or rate; it saw what the environment does
            not show, or something other than one tensor; or its network is no perceptron.
    """
    description, layout, module = policy.description, environment.observation[POLICY], policy.module
    if not isinstance(policy.network, Perceptron) or not isinstance(module, NormalizedActor) or not layout.concatenated:
        raise ConfigurationError("a training begins with a policy whose network is a perceptron that sees one tensor")
    description.check_action(environment)
    columns = columns_seen(policy, layout)
    shown = one_tensor(environment.observe(), POLICY)
    mean, std = shown.mean(0).cpu(), shown.std(0, unbiased=False).clamp_min(_LEAST_STD).cpu()
    mean[columns], std[columns] = module.mean.cpu(), module.std.cpu()
    ratio, shift = _rescaled(policy, environment)
    if LAST_ACTION in layout.columns:
        last = layout.columns[LAST_ACTION]
        mean[last], std[last] = mean[last] * ratio + shift, std[last] * ratio
    weights = {name: value.detach().cpu().clone() for name, value in module.state_dict().items()}
    first = torch.zeros(len(weights["layers.0.weight"]), layout.size)
    first[:, columns] = weights["layers.0.weight"]
    end = f"layers.{2 * len(policy.network.hidden_sizes)}"
    weights[f"{end}.weight"] *= ratio[:, None]
    weights[f"{end}.bias"] = weights[f"{end}.bias"] * ratio + shift
    started = policy.network.build(layout.size, description.action_size)
    started.load_state_dict({**weights, "layers.0.weight": first, "mean": mean, "std": std})
    return ActorNetwork(policy.network, started.requires_grad_(False).eval())


def columns_seen(policy: Policy, layout: GroupLayout) -> list[int]:
    """Where the environment shows the components that the policy saw, in their order.

    Raises:
        ConfigurationError: the policy saw what the environment does not show.
    """
    columns: list[int] = []
    for part in policy.description.observation_parts:
        found = layout.columns.get(part.name)
        if found is None or found.stop - found.start != part.size:
            raise ConfigurationError(f"the policy to begin with saw {part}, which the environment does not show so")
        columns += range(found.start, found.stop)
    return columns


def _rescaled(policy: Policy, environment: Environment) -> tuple[Tensor, Tensor]:
    """Ratio (A,) and shift (A,) that turn the policy's command into one by which the environment does the same."""
    ratio, shift = torch.ones(policy.description.action_size), torch.zeros(policy.description.action_size)
    if policy.manifest is None:
        return ratio, shift
    begin = 0
    for part, generator in zip(policy.description.action_parts, environment.actions.generators, strict=True):
        place = slice(begin, begin + part.size)
        begin += part.size
        learned = policy.manifest.action_terms.get(part.name)
        if learned is None or learned.scale is None or learned.offset is None or generator.affine is None:
            continue
        offset, scale = (value.cpu() for value in generator.affine)
        ratio[place] = torch.tensor(learned.scale) / scale
        shift[place] = (torch.tensor(learned.offset) - offset) / scale
    return ratio, shift
