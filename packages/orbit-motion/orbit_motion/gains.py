"""Stiffness and damping ratio of a compliant motion, fixed or part of the command.

The two spaces beyond fixed gains are those of Martin-Martin et al., Variable Impedance Control in End-Effector Space,
IROS 2019.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError


class GainCommand(Enum):
    """Gains that a command holds, after its motion components."""

    FIXED = "fixed"
    """None."""
    STIFFNESS = "stiffness"
    """The stiffness of each component; the damping ratio stays."""
    IMPEDANCE = "impedance"
    """The stiffness of each component, then the damping ratio of each."""


@dataclass(frozen=True, kw_only=True)
class GainRange:
    """Values that commands of -1 and 1 mean; in between gains grow by equal factors."""

    low: float
    """Value of a command of -1."""
    high: float
    """Value of a command of 1."""

    def __post_init__(self) -> None:
        if not 0.0 < self.low <= self.high < math.inf:
            raise ConfigurationError(
                f"GainRange: from {self.low} to {self.high} is no range above zero: give finite numbers, low not above "
                "high"
            )


class CommandedGains:
    """Stiffness and damping ratio (N, n) of a compliant motion, which commands may set.

    Args:
        command: which gains commands hold.
        stiffness: (n,) where commands hold none.
        damping_ratio: where commands hold none.
        stiffness_factor: a command's stiffness is this times ``stiffness``.
        ratio_range: of the damping ratio.
        num_envs: N.
        device: where tensors live.
    """

    def __init__(
        self,
        command: GainCommand,
        stiffness: Sequence[float],
        damping_ratio: float,
        stiffness_factor: GainRange,
        ratio_range: GainRange,
        num_envs: int,
        device: torch.device,
    ) -> None:
        self._command, self._size = command, len(stiffness)
        self._nominal = torch.tensor(stiffness, device=device)
        self._factor, self._ratio = stiffness_factor, ratio_range
        self.stiffness = self._nominal.repeat(num_envs, 1)
        """Stiffness (N, n)."""
        self.damping_ratio = torch.full((num_envs, self._size), damping_ratio, device=device)
        """Damping ratio (N, n)."""
        self._given = damping_ratio
        varies = command is not GainCommand.FIXED
        self.stiffest = [value * (stiffness_factor.high if varies else 1.0) for value in stiffness]
        """Largest stiffness of each component over all commands."""
        self.most_damped = ratio_range.high if command is GainCommand.IMPEDANCE else damping_ratio
        """The largest damping ratio over all commands."""

    @staticmethod
    def components(command: GainCommand, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the gains' components of the command, for motions of these names."""
        kinds = {GainCommand.FIXED: (), GainCommand.STIFFNESS: ("stiffness",)}.get(command, ("stiffness", "damping"))
        return tuple(f"{kind} {name}" for kind in kinds for name in names)

    def take(self, command: Tensor) -> None:
        """Set the gains from their part of a command (N, 0, n or 2 n)."""
        if self._command is GainCommand.FIXED:
            return
        self.stiffness.copy_(self._nominal * _geometric(command[:, : self._size], self._factor))
        if self._command is GainCommand.IMPEDANCE:
            self.damping_ratio.copy_(_geometric(command[:, self._size :], self._ratio))

    def varying(self) -> dict[str, Tensor]:
        """Return the gains, by name, where commands set them."""
        return dict(self.memory())

    def of(self, varying: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return stiffness and damping ratio, (N, n) from :meth:`varying`, or (n,) where they are fixed."""
        if self._command is GainCommand.FIXED:
            return self._nominal, torch.full_like(self._nominal, self._given)
        return varying["stiffness"], varying["damping_ratio"]

    def encode(self, num_envs: int) -> Tensor:
        """Return the command (N, 0, n or 2 n) that sets the gains of the configuration."""
        parts: list[float] = []
        if self._command is not GainCommand.FIXED:
            parts += [_position(1.0, self._factor)] * self._size
        if self._command is GainCommand.IMPEDANCE:
            parts += [_position(self._given, self._ratio)] * self._size
        return torch.tensor(parts, device=self._nominal.device).expand(num_envs, -1)

    def memory(self) -> Mapping[str, Tensor]:
        """Return the tensors of :meth:`orbit_core.interfaces.Node.memory`."""
        if self._command is GainCommand.FIXED:
            return {}
        return {"stiffness": self.stiffness, "damping_ratio": self.damping_ratio}


# Geometric: gains matter by their ratio, so that half a command is the same factor everywhere.
def _geometric(command: Tensor, ends: GainRange) -> Tensor:
    return ends.low * (ends.high / ends.low) ** (0.5 * (command + 1.0))


def _position(value: float, ends: GainRange) -> float:
    if ends.high == ends.low or value <= 0.0:
        return -1.0
    place = 2.0 * math.log(value / ends.low) / math.log(ends.high / ends.low) - 1.0
    return min(max(place, -1.0), 1.0)
