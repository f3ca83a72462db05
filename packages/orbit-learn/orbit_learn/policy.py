"""Learned policies: their files, their fit to an environment, and their use as nodes and actors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from orbit_core.envs.observation_layout import leaf_shapes
from orbit_core.files import as_path
from orbit_core.interfaces import ConfigurationError, Node, Port
from orbit_data.manifest.manifest import Manifest, check_manifest, renamed_group
from orbit_learn import onnx_file
from orbit_learn.description import Part, PolicyDescription
from orbit_learn.memory import Remembering, Seen
from orbit_learn.networks import ActorNetwork, Network
from orbit_learn.policy_file import SUFFIX, newest_file, read_policy, write_policy

if TYPE_CHECKING:
    from orbit_core.agent import AgentGraph
    from orbit_core.envs.environment import Environment

__all__ = ["Part", "Policy", "PolicyActor", "PolicyDescription", "PolicyNode", "load_policy", "whole_agent"]


@dataclass(frozen=True)
class Policy:
    """Policy with its description."""

    module: nn.Module
    """Module from an observation of the description's group to an action (N, A) in [-1, 1], without exploration."""
    network: Network | None
    """Settings that built the module; None if it was read from ONNX, which contains a graph instead."""
    description: PolicyDescription
    """Observation that it needs, and meaning of its output."""
    manifest: Manifest | None = None
    """Manifest of the environment that it was learned in; None if its file has none."""

    def fit(self, environment: Environment) -> str:
        """Return the environment's group with the policy's observation, and warn of differences in the simulation.

        Raises:
            ConfigurationError: the policy was learned for another environment; the message names the differences.
        """
        group = self.description.find_group(environment)
        if self.manifest is not None:
            recorded = renamed_group(self.manifest, self.description.group, group)
            check_manifest(recorded, environment, f"the policy of {self.description.task}", {group})
        return group

    def save(self, path: Path | str) -> None:
        """Write weights, network and description into one safetensors file, which appears complete or not at all.

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


# Files of a policy's folder that LeRobot writes.
_WEIGHTS, _CONFIG = "model.safetensors", "config.json"
_ELSEWHERE = (
    "export it to ONNX where it was trained, then orbit adopt, or serve it there and give --agent ws://HOST:PORT"
)


def load_policy(path: Path | str, device: torch.device | str = "cpu") -> Policy:
    """Read a policy from safetensors or ONNX, or the latest one of a training's folder, without executing its code.

    Args:
        path: path of the file or folder.
        device: device of the policy.

    Raises:
        OrbitError: the file does not exist or is not a policy; the message names the file and the fault.
    """
    path = as_path(path)
    if path.is_dir():
        newest = newest_file(path, "policy")
        if newest is None:
            if (path / _WEIGHTS).is_file() and (path / _CONFIG).is_file():
                raise ConfigurationError(f"folder {path} holds a checkpoint of LeRobot's: {_ELSEWHERE}")
            raise ConfigurationError(f"folder {path} holds no policy_<iteration>{SUFFIX}: is it a training's folder?")
        path = newest
    if path.suffix == onnx_file.SUFFIX:
        description, manifest, module = onnx_file.read_onnx(path)
        return Policy(module.to(device), None, description, manifest)
    # Refused by the name and before reading: unpickling a file runs what it says.
    if path.suffix != SUFFIX:
        raise ConfigurationError(
            f"{path} is no policy: policies are {SUFFIX} and {onnx_file.SUFFIX} files, because others, such as pickles "
            f"and TorchScript, may run code when they are read. For a checkpoint of another library, {_ELSEWHERE}"
        )
    if path.name == _WEIGHTS and (path.parent / _CONFIG).is_file():
        raise ConfigurationError(f"{path} is a checkpoint of LeRobot's: {_ELSEWHERE}")
    description, manifest, actor = read_policy(path)
    return Policy(actor.module.to(device), actor.network, description, manifest)


class PolicyNode(Node):
    """Node of a learned policy, from its observation group to an action (N, A).

    Its input ports have the names of the observation's tensors: ``policy`` for a concatenated group (N, O),
    ``policy/<term>`` (N, ...) for each term of a dictionary.

    Args:
        policy: policy that acts.
        name: name of the node.
        inputs: ports of its place in an agent, which may include other groups; only the policy's own if None.
        group: group that it sees; the one that it was learned with if None.
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
        """Port of the action, (A,)."""
        self._module = policy.module
        # Made at the first turn, when the number of environments is known.
        self._acting: Remembering | None = None

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        if self._description.concatenated:
            observation: Seen = inputs[self._group]
        else:
            names = [part.name for part in self._description.observation_parts]
            observation = {name: inputs[f"{self._group}/{name}"] for name in names}
        first = next(iter(inputs.values()))
        if self._acting is None:
            self._acting = Remembering(self._module, len(first), first.device)
        # Who runs the agent resets it where episodes begin.
        begun = torch.zeros(len(first), dtype=torch.bool, device=first.device)
        return {"action": self._acting.act(observation, begun)}

    def reset(self, env_ids: Tensor | None = None) -> None:
        if self._acting is not None and (memory := self._acting.memory):
            begun = torch.zeros(len(next(iter(memory.values()))), dtype=torch.bool)
            begun[slice(None) if env_ids is None else env_ids.cpu()] = True
            self._acting.forget(begun.to(next(iter(memory.values())).device))

    def memory(self) -> Mapping[str, Tensor]:
        return {} if self._acting is None else self._acting.memory

    def _own_inputs(self) -> tuple[Port, ...]:
        if self._description.concatenated:
            return (Port(self._group, (self._description.observation_size,)),)
        return tuple(
            Port(f"{self._group}/{part.name}", part.shape or ()) for part in self._description.observation_parts
        )


def whole_agent(environment: Environment, policy: Policy) -> AgentGraph:
    """Build the environment's agent with a policy in it, from the observation to the actuators.

    :meth:`orbit_core.envs.Environment.agent` says how to step it.

    Raises:
        ConfigurationError: the policy was learned for another environment.
    """
    seen = tuple(Port(name, shape) for name, shape in leaf_shapes(environment.observation).items())
    return environment.agent(PolicyNode(policy, inputs=seen, group=policy.fit(environment)))


class PolicyActor:
    """Actor of a learned policy, in any environment with a group of the policy's observation."""

    def __init__(self, environment: Environment, path: Path | str) -> None:
        policy = load_policy(path, environment.device)
        self._group = policy.fit(environment)
        self._acting = Remembering(policy.module, environment.num_envs, environment.device)
        self._environment = environment

    def act(self) -> Tensor:
        """Return the next action (N, A)."""
        # Nobody informs an actor of resets, but the step count of a new episode is zero.
        begun = self._environment.state.episode_step == 0
        return self._acting.act(self._environment.observe()[self._group], begun)
