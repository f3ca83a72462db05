"""A learned policy as one file that needs no learning library, and none of ORBIT, to run again."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from orbit_core.interfaces import ConfigurationError, Node, Port

if TYPE_CHECKING:
    from orbit_core.agent import AgentGraph
    from orbit_core.tasks.environment import Environment

SUFFIX = ".pt"
_DESCRIPTION = "orbit.json"


@dataclass(frozen=True)
class Part:
    """A stretch of the observation or of the action."""

    name: str
    size: int


@dataclass(frozen=True)
class PolicyDescription:
    """What a policy was learned for: what it must be given and what its output means."""

    task: str
    robot: str
    action: str
    """Name of the action space."""
    observation_parts: tuple[Part, ...]
    """The task's observation terms, side by side."""
    action_parts: tuple[Part, ...]
    """The motion generators' commands, side by side, each component in [-1, 1]."""
    step_dt: float
    """Seconds between two actions."""
    backend: str
    """Where it was learned."""
    library: str
    """Which learned it."""
    iteration: int

    @staticmethod
    def of(environment: Environment, task: str, library: str, iteration: int) -> PolicyDescription:
        """Of a policy for this environment."""
        terms, world = environment.observer.terms, environment.world
        return PolicyDescription(
            task=task,
            robot=environment.task.robot,
            action=environment.task.action,
            observation_parts=tuple(
                Part(name, term.function(world, environment.task).shape[1]) for name, term in terms.items()
            ),
            action_parts=tuple(Part(g.name, g.command_size) for g in environment.task.generators),
            step_dt=environment.step_dt,
            backend=environment.world.backend,
            library=library,
            iteration=iteration,
        )

    @property
    def observation_size(self) -> int:
        return sum(part.size for part in self.observation_parts)

    @property
    def action_size(self) -> int:
        return sum(part.size for part in self.action_parts)

    def as_json(self) -> str:
        return json.dumps(asdict(self), indent=2)

    @staticmethod
    def from_json(text: str) -> PolicyDescription:
        values: dict[str, Any] = json.loads(text)
        for key in ("observation_parts", "action_parts"):
            values[key] = tuple(Part(**part) for part in values[key])
        return PolicyDescription(**values)


class ClippedPolicy(nn.Module):
    """Observation (N, O) -> action (N, A) in [-1, 1], without exploration."""

    def __init__(self, actor: nn.Module) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: Tensor) -> Tensor:
        return self.actor(observation).clamp(-1.0, 1.0)


@dataclass(frozen=True)
class Policy:
    """A policy with its description."""

    module: nn.Module
    """Observation (N, O) -> action (N, A)."""
    description: PolicyDescription

    def save(self, path: Path) -> None:
        """Write TorchScript, the description inside. The file appears whole or not at all."""
        module = self.module.cpu().eval()
        example = torch.zeros(2, self.description.observation_size)
        with torch.no_grad():
            traced = module if isinstance(module, torch.jit.ScriptModule) else torch.jit.trace(module, example)
        assert isinstance(traced, torch.jit.ScriptModule)
        written = path.with_name(path.name + ".writing")
        torch.jit.save(traced, str(written), _extra_files={_DESCRIPTION: self.description.as_json()})
        written.replace(path)

    def export_onnx(self, path: Path) -> None:
        """Write ONNX: input ``observation`` (N, O), output ``action`` (N, A).

        Raises:
            ConfigurationError: the exporter is not installed.
        """
        try:
            import onnx  # noqa: F401 - the exporter's own need, asked for here to be told in one line
        except ImportError as error:
            raise ConfigurationError(f"ONNX needs {error.name}: pip install 'orbit-core[onnx]'") from None
        example = torch.zeros(2, self.description.observation_size)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an older exporter's age; the newer one takes no TorchScript
            torch.onnx.export(
                self.module.cpu().eval(),
                (example,),
                str(path),
                input_names=["observation"],
                output_names=["action"],
                dynamic_axes={"observation": {0: "environments"}, "action": {0: "environments"}},
                dynamo=False,
            )

    def check(self, environment: Environment) -> None:
        """Refuse an environment that the policy was not learned for.

        Raises:
            ConfigurationError: names what differs.
        """
        other = PolicyDescription.of(environment, self.description.task, "", 0)
        for field in ("robot", "action", "observation_parts", "action_parts"):
            learned, given = getattr(self.description, field), getattr(other, field)
            if learned != given:
                raise ConfigurationError(f"the policy was learned with {field} {learned}, not with {given}")
        if abs(self.description.step_dt - other.step_dt) > 1e-9:
            raise ConfigurationError(
                f"the policy acts every {self.description.step_dt:g} s, the environment every {other.step_dt:g} s"
            )


def load_policy(path: Path, device: torch.device | str = "cpu") -> Policy:
    """A policy from its file, or the latest of a training's folder.

    Raises:
        ConfigurationError: there is no such file, or it is no policy.
    """
    if path.is_dir():
        found = sorted(path.glob(f"policy_*{SUFFIX}"), key=lambda file: int(file.stem.removeprefix("policy_")))
        if not found:
            raise ConfigurationError(f"folder {path} holds no policy_<iteration>{SUFFIX}: is it a training's folder?")
        path = found[-1]
    if not path.is_file():
        raise ConfigurationError(f"there is no policy {path}")
    files = {_DESCRIPTION: ""}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # what is to follow TorchScript needs more than a file
            module = torch.jit.load(str(path), map_location=device, _extra_files=files)
        description = PolicyDescription.from_json(files[_DESCRIPTION])
    except (RuntimeError, ValueError, TypeError, KeyError) as error:
        raise ConfigurationError(f"{path} is no policy of ORBIT: {str(error).splitlines()[0]}") from error
    module.eval()
    return Policy(module, description)


class PolicyNode(Node):
    """A learned policy as a node: observation (N, O) -> action (N, A)."""

    def __init__(self, policy: Policy, name: str = "policy") -> None:
        self.name = name
        self.inputs = (Port("observation", (policy.description.observation_size,)),)
        self.outputs = (Port("action", (policy.description.action_size,)),)
        self._module = policy.module

    def compute(self, inputs: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        with torch.no_grad():
            return {"action": self._module(inputs["observation"])}


def whole_agent(environment: Environment, policy: Policy) -> AgentGraph:
    """The environment's agent with the policy in the cut's place, from the observation to the actuators.

    ``agent.step()`` and then ``environment.world.step(task.decimation)`` moves the robot as ``environment.step`` does
    with the policy's actions; rewards, ends of episodes and resets are the environment's step's alone. Where
    environments are reset, reset the agent too.

    Raises:
        ConfigurationError: the policy was learned for another environment.
    """
    policy.check(environment)
    return environment.cut.graph.replace(environment.cut.node.name, PolicyNode(policy))


class PolicyAgent:
    """A learned policy, acting in the environments that it was learned for."""

    def __init__(self, environment: Environment, path: Path) -> None:
        policy = load_policy(path, environment.device)
        policy.check(environment)
        self._module = policy.module
        self._environment = environment

    def act(self) -> Tensor:
        """(N, A) the next action."""
        with torch.no_grad():
            return self._module(self._environment.observe()["policy"])
