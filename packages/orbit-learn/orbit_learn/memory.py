"""Policies that remember: modules whose action depends on earlier observations or on a plan they still execute."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor, nn

from orbit_learn.description import Part

Memory = dict[str, Tensor]
"""Tensors (N, ...) by name: all that a policy carries from one step to the next."""
Seen = Tensor | Mapping[str, Tensor]
"""An observation group as it is seen: one tensor (N, O), or a dictionary of terms (N, ...)."""


def map_seen(function: Callable[[Tensor], Tensor], seen: Seen) -> Tensor | dict[str, Tensor]:
    """Apply a function to each tensor of an observation group."""
    return function(seen) if isinstance(seen, Tensor) else {name: function(value) for name, value in seen.items()}


class MemoryModule(nn.Module):
    """Module with memory. Its caller keeps the memory and hands it back at the next step.

    :meth:`forward` is the first step of an episode, so that a module with memory is also a module without one.
    """

    @abstractmethod
    def initial_memory(self, count: int, device: torch.device | str) -> Memory:
        """Return the memory of so many environments whose episodes begin."""

    @abstractmethod
    def act(self, observation: Seen, memory: Memory) -> tuple[Tensor, Memory]:
        """Compute one step.

        Args:
            observation: (N, O), or a dictionary of terms (N, ...).
            memory: of the step before, which is left as it is.

        Returns:
            the action (N, A) in [-1, 1], and the memory for the next step.
        """

    def forward(self, observation: Seen) -> Tensor:
        first = observation if isinstance(observation, Tensor) else next(iter(observation.values()))
        return self.act(observation, self.initial_memory(len(first), first.device))[0]


def memory_parts(module: nn.Module) -> tuple[Part, ...]:
    """Return the memory of a module as a policy's description lists it; none for a module without memory."""
    if not isinstance(module, MemoryModule):
        return ()
    return tuple(
        Part(name, value[0].numel(), tuple(value.shape[1:]), str(value.dtype).removeprefix("torch."))
        for name, value in module.initial_memory(1, "cpu").items()
    )


class Remembering:
    """Runs a module, with or without memory, and keeps its memory per environment.

    Args:
        module: that acts.
        count: number of environments.
        device: of the environments.
    """

    def __init__(self, module: nn.Module, count: int, device: torch.device | str) -> None:
        self._module = module
        self.memory: Memory = module.initial_memory(count, device) if isinstance(module, MemoryModule) else {}
        """(N, ...) by name; empty for a module without memory."""
        self._initial = {name: value.clone() for name, value in self.memory.items()}

    def act(self, observation: Seen, begun: Tensor) -> Tensor:
        """Compute the action (N, A).

        Args:
            observation: of the policy's group.
            begun: (N,) bool, environments whose episode begins with this step and whose memory is forgotten.
        """
        with torch.no_grad():
            if not isinstance(self._module, MemoryModule):
                return self._module(observation)
            self.forget(begun)
            action, memory = self._module.act(observation, self.memory)
            # In place, so that a snapshot may write into the tensors that it was given.
            for name, value in memory.items():
                self.memory[name].copy_(value)
            return action

    def forget(self, begun: Tensor) -> None:
        """Write the initial memory where ``begun`` (N,) bool is true."""
        for name, value in self.memory.items():
            rows = begun.view(-1, *(1,) * (value.dim() - 1))
            value.copy_(torch.where(rows, self._initial[name], value))


class StepByStep(nn.Module):
    """A module with memory as a function of tensors alone, for exporters: terms and memory in, action and memory out.

    Args:
        module: that it calls.
        terms: names of the observation's terms; none for an observation that is one tensor.
        memory: names of the memory's parts, in order.
    """

    def __init__(self, module: MemoryModule, terms: Sequence[str], memory: Sequence[str]) -> None:
        super().__init__()
        self.module, self._terms, self._memory = module, list(terms), list(memory)

    def forward(self, *values: Tensor) -> tuple[Tensor, ...]:
        split = max(1, len(self._terms))
        observed = dict(zip(self._terms, values[:split], strict=True)) if self._terms else values[0]
        action, memory = self.module.act(observed, dict(zip(self._memory, values[split:], strict=True)))
        return action, *(memory[name] for name in self._memory)
