"""What a policy was learned for, as data that travels with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from orbit_core.interfaces import ConfigurationError
from orbit_core.learning.plain import from_plain

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment

FORMAT = 1
"""Of the documents in policies' files; one of another number is refused."""
_MOST_COMPONENTS = 2**20


@dataclass(frozen=True)
class Part:
    """A stretch of the observation or of the action."""

    name: str
    size: int

    def __post_init__(self) -> None:
        if not 0 <= self.size <= _MOST_COMPONENTS:
            raise ValueError(f"a part has 0 to {_MOST_COMPONENTS:,} components, not {self.size}")


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
    versions: dict[str, str] = field(default_factory=dict)
    """Of the distributions that took part in learning."""

    def __post_init__(self) -> None:
        if not (0 < self.observation_size <= _MOST_COMPONENTS and 0 < self.action_size <= _MOST_COMPONENTS):
            raise ValueError(f"observation and action have 1 to {_MOST_COMPONENTS:,} components each")

    @staticmethod
    def of(
        environment: Environment, task: str, library: str, iteration: int, versions: Mapping[str, str] | None = None
    ) -> PolicyDescription:
        """Of a policy for this environment."""
        return PolicyDescription(
            task=task,
            robot=environment.task.robot,
            action=environment.task.action,
            observation_parts=tuple(
                Part(name, part.stop - part.start) for name, part in environment.observation["policy"].columns.items()
            ),
            action_parts=tuple(Part(g.name, g.command_size) for g in environment.task.generators),
            step_dt=environment.step_dt,
            backend=environment.world.backend,
            library=library,
            iteration=iteration,
            versions=dict(versions or {}),
        )

    @property
    def observation_size(self) -> int:
        return sum(part.size for part in self.observation_parts)

    @property
    def action_size(self) -> int:
        return sum(part.size for part in self.action_parts)

    def check(self, environment: Environment) -> None:
        """Refuse an environment that the policy was not learned for.

        Raises:
            ConfigurationError: names what differs.
        """
        other = PolicyDescription.of(environment, self.task, "", 0)
        for name in ("robot", "action", "observation_parts", "action_parts"):
            learned, given = getattr(self, name), getattr(other, name)
            if learned != given:
                raise ConfigurationError(f"the policy was learned with {name} {learned}, not with {given}")
        if abs(self.step_dt - other.step_dt) > 1e-9:
            raise ConfigurationError(
                f"the policy acts every {self.step_dt:g} s, the environment every {other.step_dt:g} s"
            )

    def document(self) -> dict[str, Any]:
        """For a file, as plain data."""
        return {"format": FORMAT, "policy": asdict(self)}

    @staticmethod
    def of_document(document: Mapping[str, Any], where: str) -> PolicyDescription:
        """What :meth:`document` gave.

        Args:
            document: plain data that a file says.
            where: the file, for messages.

        Raises:
            ConfigurationError, UnknownNameError: it says something else; names what.
        """
        if document.get("format") != FORMAT:
            raise ConfigurationError(
                f"{where} is no policy of format {FORMAT}, the one that is read: learn or export it again"
            )
        return from_plain(PolicyDescription, document.get("policy"), f"policy of {where}")
