"""A learned policy: its file, its fit to an environment, and the node and the actor that it becomes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from orbit_core.files import as_path
from orbit_core.interfaces import ConfigurationError, Node, Port
from orbit_data.manifest.compare import check_manifest, renamed_group
from orbit_data.manifest.manifest import Manifest
from orbit_learn import onnx_file
from orbit_learn.description import Part, PolicyDescription
from orbit_learn.networks import ActorNetwork, Network
from orbit_learn.policy_file import SUFFIX, newest_file, read_policy, write_policy

if TYPE_CHECKING:
    from orbit_core.agent import AgentGraph
    from orbit_core.envs.environment import Environment

__all__ = ["Part", "Policy", "PolicyActor", "PolicyDescription", "PolicyNode", "load_policy", "whole_agent"]


@dataclass(frozen=True)
class Policy:
    """A policy with its description."""

    module: nn.Module
    """Observation, as the description's group gives it, -> action (N, A) in [-1, 1], without exploration."""
    network: Network | None
    """What built the module; None if it was read from ONNX, where a graph stands for it."""
    description: PolicyDescription
    manifest: Manifest | None = None
    """Of the environment that it was learned in; None where its file holds none."""

    def fit(self, environment: Environment) -> str:
        """Return the group of an environment that shows what the policy sees; warns where the environment leads
        elsewhere.

        Raises:
            ConfigurationError: the policy was learned for another environment; names what differs.
        """
        group = self.description.find_group(environment)
        if self.manifest is not None:
            recorded = renamed_group(self.manifest, self.description.group, group)
            check_manifest(recorded, environment, f"the policy of {self.description.task}", {group})
        return group

    def save(self, path: Path | str) -> None:
        """Write weights, network and description into one safetensors file, which appears whole or not at all.

        Raises:
            ConfigurationError: the policy was read from ONNX, or its network is not registered.
        """
        if self.network is None:
            raise ConfigurationError(f"a policy that was read from ONNX has no network that {path} could name")
        write_policy(path, ActorNetwork(self.network, self.module), self.description, self.manifest)

    def export_onnx(self, path: Path | str) -> None:
        """Write ONNX, the description in its metadata: input ``observation`` (N, O), output ``action`` (N, A).

        Raises:
            ConfigurationError: the exporter is not installed, or the policy was read from ONNX.
        """
        if self.network is None:
            raise ConfigurationError(f"the policy was read from ONNX: copy its file to {path}")
        onnx_file.write_onnx(path, self.module, self.description, self.manifest)


def load_policy(path: Path | str, device: torch.device | str = "cpu") -> Policy:
    """Return a policy from its file, safetensors or ONNX, or the latest of a training's folder. Nothing in it is
    executed.

    Raises:
        OrbitError: there is no such file, or it is no policy; names the file and what is wrong.
    """
    path = as_path(path)
    if path.is_dir():
        newest = newest_file(path, "policy")
        if newest is None:
            raise ConfigurationError(f"folder {path} holds no policy_<iteration>{SUFFIX}: is it a training's folder?")
        path = newest
    if path.suffix == onnx_file.SUFFIX:
        description, manifest, module = onnx_file.read_onnx(path)
        return Policy(module.to(device), None, description, manifest)
    if path.suffix != SUFFIX:
        raise ConfigurationError(
            f"{path} is no policy: policies are {SUFFIX} and {onnx_file.SUFFIX} files, for others, such as pickles and "
            "TorchScript, may run code when they are read"
        )
    description, manifest, actor = read_policy(path)
    return Policy(actor.module.to(device), actor.network, description, manifest)


class PolicyNode(Node):
    """A learned policy as a node: its observation group -> action (N, A).

    The ports of its inputs are named as the observation's tensors are: ``policy`` for a concatenated group (N, O),
    ``policy/<term>`` (N, ...) for each term of a dictionary.

    Args:
        policy: that acts.
        name: of the node.
        inputs: what its place in an agent offers, other groups too; the policy's own alone if None.
        group: that it sees; the one that it was learned with if None.
    """

    def __init__(
        self,
        policy: Policy,
        name: str = "policy",
        inputs: tuple[Port, ...] | None = None,
        group: str | None = None,
    ) -> None:
        self.name = name
        self._description = description = policy.description
        self._group = group or description.group
        self.inputs = self._own_inputs() if inputs is None else inputs
        self.outputs = (Port("action", (policy.description.action_size,)),)
        self._module = policy.module

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        with torch.no_grad():
            if self._description.concatenated:
                return {"action": self._module(inputs[self._group])}
            terms = {part.name: inputs[f"{self._group}/{part.name}"] for part in self._description.observation_parts}
            return {"action": self._module(terms)}

    def _own_inputs(self) -> tuple[Port, ...]:
        if self._description.concatenated:
            return (Port(self._group, (self._description.observation_size,)),)
        return tuple(
            Port(f"{self._group}/{part.name}", part.shape or ()) for part in self._description.observation_parts
        )


def whole_agent(environment: Environment, policy: Policy) -> AgentGraph:
    """Return the environment's agent with the policy in the cut's place, from the observation to the actuators.

    ``agent.step()`` and then ``environment.world.step(task.decimation)`` moves the robot as ``environment.step`` does
    with the policy's actions; rewards, ends of episodes and resets are the environment's step's alone. Where
    environments are reset, reset the agent too.

    Raises:
        ConfigurationError: the policy was learned for another environment.
    """
    group, place = policy.fit(environment), environment.cut.node
    return environment.cut.graph.replace(place.name, PolicyNode(policy, inputs=place.inputs, group=group))


class PolicyActor:
    """A learned policy, acting in any environment of which a group shows what it was learned with."""

    def __init__(self, environment: Environment, path: Path | str) -> None:
        policy = load_policy(path, environment.device)
        self._group = policy.fit(environment)
        self._module = policy.module
        self._environment = environment

    def act(self) -> Tensor:
        """(N, A) the next action."""
        with torch.no_grad():
            return self._module(self._environment.observe()[self._group])
