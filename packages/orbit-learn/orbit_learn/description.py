"""Description of a policy's task, observation and action, as data in its file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from orbit_core.configuration import from_plain
from orbit_core.interfaces import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.observation_layout import GroupLayout, TermLayout

FORMAT = 1
"""Version of the documents in policies' files; another is refused."""
# Bounds what a file may ask to be allocated before anything else of it is known to be sound.
_MOST_COMPONENTS = 2**20
_FORMS = {True: "side by side", False: "as a dictionary"}
_DTYPES = {
    str(dtype).removeprefix("torch."): dtype
    for dtype in (torch.float32, torch.uint8, torch.int32, torch.int64, torch.bool)
}


@dataclass(frozen=True)
class Part:
    """Term of the observation, or part of the action."""

    name: str
    """Name of the term or generator."""
    size: int
    """Number of components of one environment."""
    shape: tuple[int, ...] | None = None
    """Shape of one environment's value; (size,) if None."""
    dtype: str = "float32"
    """Name of the dtype in torch."""
    # Bounds and cameras describe values, but do not change what a policy can be given: they are not compared.
    low: float | None = field(default=None, compare=False)
    """Least value; None if unbounded."""
    high: float | None = field(default=None, compare=False)
    """Largest value; None if unbounded."""
    camera: str | None = field(default=None, compare=False)
    """Camera that draws the picture."""

    def __post_init__(self) -> None:
        if not 0 <= self.size <= _MOST_COMPONENTS:
            raise ValueError(f"a part has 0 to {_MOST_COMPONENTS:,} components, not {self.size}")
        if self.dtype not in _DTYPES:
            raise ValueError(f"part '{self.name}' is of {self.dtype!r}, which is none of {', '.join(_DTYPES)}")
        if self.shape is None:
            # The usual way to complete a frozen dataclass.
            object.__setattr__(self, "shape", (self.size,))
        assert self.shape is not None
        if any(extent < 0 for extent in self.shape) or math.prod(self.shape) != self.size:
            raise ValueError(f"part '{self.name}' of shape {self.shape} does not have {self.size} components")

    @property
    def is_picture(self) -> bool:
        """True if the part has height, width and channels."""
        return self.shape is not None and len(self.shape) == 3

    def zeros(self, count: int, device: torch.device | str) -> Tensor:
        """Return zeros (count, ...) of the part's shape and dtype."""
        return torch.zeros((count, *(self.shape or ())), dtype=_DTYPES[self.dtype], device=device)

    def __str__(self) -> str:
        shape = "x".join(str(extent) for extent in self.shape or ())
        return f"{self.name} ({shape})" if self.dtype == "float32" else f"{self.name} ({shape} {self.dtype})"


@dataclass(frozen=True)
class PolicyDescription:
    """Description of a policy: the observation that it needs, and the meaning of its output."""

    task: str
    """Name of the task that it was learned on."""
    robot: str
    """Name of the robot in the catalogue."""
    action: str
    """Name of the action space."""
    observation_parts: tuple[Part, ...]
    """Terms of its observation group, in order."""
    action_parts: tuple[Part, ...]
    """Commands of the motion generators in order, each component in [-1, 1]."""
    step_dt: float
    """Seconds between two actions."""
    backend: str
    """Backend that the policy was learned on."""
    library: str
    """Library that learned the policy."""
    iteration: int
    """Iterations of training before the file was written."""
    versions: dict[str, str] = field(default_factory=dict)
    """Versions of the distributions that took part in learning."""
    group: str = "policy"
    """Observation group that the policy sees."""
    concatenated: bool = True
    """Whether the policy sees the terms concatenated to (N, O), or as a dictionary."""
    memory: tuple[Part, ...] = ()
    """Tensors that the policy carries from one step to the next, a row for each environment; empty if it acts only by
    what it sees."""

    def __post_init__(self) -> None:
        if not (0 < self.observation_size <= _MOST_COMPONENTS and 0 < self.action_size <= _MOST_COMPONENTS):
            raise ValueError(f"observation and action have 1 to {_MOST_COMPONENTS:,} components each")

    @staticmethod
    def of(
        environment: Environment, task: str, library: str, iteration: int, versions: Mapping[str, str] | None = None
    ) -> PolicyDescription:
        """Return the description of a policy for this environment's group ``policy``."""
        layout = environment.observation["policy"]
        return PolicyDescription(
            task=task,
            robot=environment.task.robot,
            action=environment.task.action,
            observation_parts=group_parts(layout),
            action_parts=tuple(Part(g.name, g.command_size) for g in environment.actions.generators),
            step_dt=environment.step_dt,
            backend=environment.world.backend,
            library=library,
            iteration=iteration,
            versions=dict(versions or {}),
            concatenated=layout.concatenated,
        )

    @property
    def observation_size(self) -> int:
        """Number of components of all terms that the policy sees."""
        return sum(part.size for part in self.observation_parts)

    @property
    def action_size(self) -> int:
        """Number of components of an action."""
        return sum(part.size for part in self.action_parts)

    @property
    def sees_pictures(self) -> bool:
        """True if any term that the policy sees is a picture."""
        return any(part.is_picture for part in self.observation_parts)

    def zeros(self, count: int, device: torch.device | str = "cpu") -> Tensor | dict[str, Tensor]:
        """Return an observation of ``count`` environments that is zero."""
        if self.concatenated:
            return torch.zeros(count, self.observation_size, device=device)
        return {part.name: part.zeros(count, device) for part in self.observation_parts}

    def find_group(self, environment: Environment) -> str:
        """Return the environment's group with the policy's observation: the same name, else ``teacher``, else any.

        A policy with concatenated terms needs the same terms in the same order; one with a dictionary needs its terms
        by name, and ignores others.

        Raises:
            ConfigurationError: no group fits, or robot, action or rate differ; the message names the differences.
        """
        self.check_action(environment)
        groups = environment.observation
        # The best name first; Python's sort keeps the order of the others.
        names = sorted(groups, key=lambda name: (name != self.group, name != "teacher"))
        faults = {name: self._misfit(groups[name]) for name in names}
        fitting = next((name for name, fault in faults.items() if fault is None), None)
        if fitting is None:
            raise ConfigurationError(
                f"no observation group of the environment shows what the policy of {self.task} was learned with: "
                f"{_told(self.observation_parts)} {_FORMS[self.concatenated]}; "
                + "; ".join(f"group '{name}' {fault}" for name, fault in faults.items())
            )
        return fitting

    def check_action(self, environment: Environment) -> None:
        """Refuse an environment of another robot, action or rate.

        Raises:
            ConfigurationError: the environment differs; the message names the difference.
        """
        other = PolicyDescription.of(environment, self.task, "", 0)
        for name in ("robot", "action", "action_parts"):
            learned, given = getattr(self, name), getattr(other, name)
            if learned != given:
                raise ConfigurationError(
                    f"the policy was learned with {name} {_told(learned)}, not with {_told(given)}"
                )
        # Files keep seconds as decimals, which may differ in the last bits.
        if abs(self.step_dt - other.step_dt) > 1e-9:
            raise ConfigurationError(
                f"the policy acts every {self.step_dt:g} s, the environment every {other.step_dt:g} s"
            )

    def _misfit(self, layout: GroupLayout) -> str | None:
        """Describe how a group differs from the policy's; None if it does not."""
        if layout.concatenated != self.concatenated:
            return f"gives its terms {_FORMS[layout.concatenated]}"
        given = group_parts(layout)
        if not self.concatenated:
            by_name = {part.name: part for part in given}
            # Only the policy's terms, in its order: a dictionary may hold others.
            given = tuple(by_name[part.name] for part in self.observation_parts if part.name in by_name)
        return None if given == self.observation_parts else f"has {_told(group_parts(layout))}"

    def document(self) -> dict[str, Any]:
        """Return the description as plain data, for a file."""
        return {"format": FORMAT, "policy": asdict(self)}

    @staticmethod
    def of_document(document: Mapping[str, Any], where: str) -> PolicyDescription:
        """Read a description from the result of :meth:`document`.

        Args:
            document: plain data of a file.
            where: name of the file for messages.

        Raises:
            ConfigurationError, UnknownNameError: the data is not a description; the message names the place.
        """
        if document.get("format") != FORMAT:
            raise ConfigurationError(
                f"{where} is no policy of format {FORMAT}, the one that is read: learn or export it again"
            )
        return from_plain(PolicyDescription, document.get("policy"), f"policy of {where}")


def group_parts(layout: GroupLayout) -> tuple[Part, ...]:
    """Return the terms of a group as a description lists them."""
    return tuple(_part(name, term) for name, term in layout.terms.items())


def _part(name: str, term: TermLayout) -> Part:
    # JSON has no infinity.
    low, high = (bound if math.isfinite(bound) else None for bound in (term.low, term.high))
    dtype = str(term.dtype).removeprefix("torch.")
    return Part(name, math.prod(term.shape), tuple(term.shape), dtype, low, high, term.camera)


def _told(value: Any) -> str:
    return ", ".join(str(part) for part in value) if isinstance(value, tuple) else f"'{value}'"
