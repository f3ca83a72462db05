"""The active models of a scene's objects, computed before each physics step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from orbit_core.active import ActiveLaw, create_law
from orbit_core.dynamics.indexing import RowSelector, write_columns, write_rows
from orbit_core.interfaces import ConfigurationError, Engine, EntityLayout, NamedThings
from orbit_core.world.entities import SimulatedObject


@dataclass(frozen=True)
class ActiveState:
    """A snapshot of what laws remember, their parameters, and the wrenches that callers set on links they push."""

    tensors: tuple[Tensor, ...]
    """Copies, in the order of the laws."""


class ActiveModels:
    """All laws of a scene, in the order of its objects.

    Args:
        objects: by name; each gets its own laws.
        engine: that takes efforts and wrenches.
        selector: which environments a call is for.

    Raises:
        ConfigurationError: two laws of an object share a name, or a law cannot be.
    """

    def __init__(self, objects: Mapping[str, SimulatedObject], engine: Engine, selector: RowSelector) -> None:
        self._engine = engine
        self._laws: list[ActiveLaw] = []
        self.laws: dict[str, ActiveLaw] = {}
        """Laws by the names of model and object."""
        names: list[NamedThings] = []
        for thing in objects.values():
            models = {model.name: model for model in thing.active_specs}
            if len(models) < len(thing.active_specs):
                raise ConfigurationError(f"two active models of '{thing.name}' share a name: give each its own")
            laws = {n: create_law(m, thing, engine.num_envs, engine.device, selector) for n, m in models.items()}
            thing.active = NamedThings(laws, "active model", f"'{thing.name}'", names)
            self._laws += laws.values()
            self.laws |= {f"active model '{name}' of '{thing.name}'": law for name, law in laws.items()}
        device = engine.device
        self._joints = [_indices([_layout(law).joints.start + j for j in law.joints], device) for law in self._laws]
        # Each link once, even if several laws push it: the engine takes one wrench per link.
        pushed = sorted({_layout(law).links.start + link for law in self._laws for link in law.links})
        # (k,) links of the scene that laws push
        self._pushed = _indices(pushed, device)
        self._columns = [
            _indices([pushed.index(_layout(law).links.start + link) for link in law.links], device)
            for law in self._laws
        ]
        # What callers of set_wrenches want, of all links where laws push any
        self._asked = torch.zeros(engine.num_envs, len(engine.layout.links) if pushed else 0, 6, device=device)
        for law in self._laws:
            if law.links:
                _object(law).write_wrenches = self._take

    def __bool__(self) -> bool:
        return bool(self._laws)

    def apply(self) -> None:
        """Add the laws' efforts to those that the engine holds, and hand it their wrenches with those that are set."""
        pushing = len(self._pushed) > 0
        # Indexing copies, so that the laws' wrenches do not stay in what the callers set.
        total = self._asked[:, self._pushed] if pushing else self._asked
        for law, joints, columns in zip(self._laws, self._joints, self._columns, strict=True):
            if law.joints:
                self._engine.efforts.index_add_(1, joints, law.efforts())
            if law.links:
                total.index_add_(1, columns, law.wrenches())
        if pushing:
            self._engine.set_wrenches(self._pushed, total)

    def _take(self, links: Tensor, wrenches: Tensor, env_ids: Tensor | None = None) -> None:
        """Wrenches (n, k, 6) that a caller sets on links (k,) of an object some of whose links laws push."""
        self._engine.set_wrenches(links, wrenches, env_ids)
        write_columns(self._asked, links, wrenches, env_ids)

    def reset(self, env_ids: Tensor | None) -> None:
        """Forget some environments' past, by index or mask; parameters stay."""
        for law in self._laws:
            law.reset(env_ids)
        write_rows(self._asked, 0.0, env_ids)

    def copy(self, origin: ActiveModels, source: int, rows: Tensor | None) -> None:
        """Have some environments remember what environment ``source`` of another world's laws does."""
        for own, other in zip(self._laws, origin._laws, strict=True):
            for name, kept in own.memory.items():
                write_rows(kept, other.memory[name][source].clone().to(kept.device), rows)

    @property
    def _kept(self) -> tuple[Tensor, ...]:
        own = (t for law in self._laws for t in (*law.memory.values(), *law.parameters.values()))
        return (self._asked, *own)

    def save_state(self) -> ActiveState:
        """A detached copy."""
        return ActiveState(tuple(tensor.clone() for tensor in self._kept))

    def load_state(self, state: ActiveState) -> None:
        """Return to a saved state."""
        for own, saved in zip(self._kept, state.tensors, strict=True):
            own.copy_(saved)


def _object(law: ActiveLaw) -> SimulatedObject:
    assert isinstance(law.thing, SimulatedObject)  # of such alone are laws made here
    return law.thing


def _layout(law: ActiveLaw) -> EntityLayout:
    return _object(law).layout


def _indices(numbers: Sequence[int], device: torch.device) -> Tensor:
    return torch.tensor(numbers, dtype=torch.int64, device=device)
