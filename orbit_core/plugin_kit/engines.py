"""Scaffold of an engine: state and parameters in parts of their own, velocities at other points, contact signs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import torch
from torch import Tensor

from orbit_core.interfaces import Engine

if TYPE_CHECKING:
    from orbit_core.interfaces.layout import ContactQuery


class StatePart(Protocol):
    """Positions and velocities, as the contract has them."""

    @property
    def joint_positions(self) -> Tensor:
        """(N, J) rad or m."""
        ...

    @property
    def joint_velocities(self) -> Tensor:
        """(N, J) rad/s or m/s."""
        ...

    @property
    def link_poses(self) -> Tensor:
        """(N, L, 7) positions and quaternions, world axes."""
        ...

    @property
    def link_velocities(self) -> Tensor:
        """(N, L, 6) linear and angular, world axes."""
        ...


class ParametersPart(Protocol):
    """Sets parameters; indices, values and rows come in the engine's own form, as :class:`PartedEngine` makes them."""

    def set_masses(self, links: Any, masses: Any, rows: Any) -> None:
        """Set links' masses in kg."""
        ...

    def set_centers_of_mass(self, links: Any, centers: Any, rows: Any) -> None:
        """Set links' centres of mass in m, in the links' frames."""
        ...

    def set_friction(self, links: Any, coefficients: Any, rows: Any) -> None:
        """Set the friction coefficients of links' surfaces."""
        ...

    def set_gravity(self, gravity: Any, rows: Any) -> None:
        """Set gravity in m/s^2, world axes."""
        ...


_State = TypeVar("_State", bound=StatePart)
_Parameters = TypeVar("_Parameters", bound=ParametersPart)


# Four plugins had these forwarding methods word for word.
class PartedEngine(Engine, Generic[_State, _Parameters]):
    """Reads from the one part and sets in the other; a derived class makes both, and writes and steps by itself."""

    _state: _State
    _parameters: _Parameters

    @abstractmethod
    def _rows(self, env_ids: Tensor | None) -> Any:
        """Return the index of environments in the parts' own form; all environments for None."""

    def _own(self, tensor: Tensor) -> Any:
        """Return indices or values in the parts' own form."""
        return tensor

    @property
    def joint_positions(self) -> Tensor:
        return self._state.joint_positions

    @property
    def joint_velocities(self) -> Tensor:
        return self._state.joint_velocities

    @property
    def link_poses(self) -> Tensor:
        return self._state.link_poses

    @property
    def link_velocities(self) -> Tensor:
        return self._state.link_velocities

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_masses(self._own(links), self._own(masses), self._rows(env_ids))

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_centers_of_mass(self._own(links), self._own(centers), self._rows(env_ids))

    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_friction(self._own(links), self._own(coefficients), self._rows(env_ids))

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        self._parameters.set_gravity(self._own(gravity), self._rows(env_ids))


def velocity_at(velocity: Tensor, arm: Tensor) -> Tensor:
    """Return the velocity (..., 6) of a point of a body at ``arm`` (..., 3) from the point whose velocity is given.

    Linear, then angular, as ``arm`` in world axes: ``v + omega x arm``. From a link's origin to its centre of mass the
    arm is the rotated ``center_of_mass``; from the centre of mass back to the origin, its negative.
    """
    linear, angular = velocity[..., :3], velocity[..., 3:]
    return torch.cat((linear + torch.linalg.cross(*torch.broadcast_tensors(angular, arm)), angular), -1)


def contact_signs(queries: Sequence[ContactQuery], pairs: Iterable[tuple[int, int]]) -> Tensor:
    """Return the sign with which the force on the first link of each pair counts in each query.

    With the forces (N, C, 3) on the first link of each pair, ``contact_signs(...) @ forces`` is
    ``Engine.contact_forces``.

    Args:
        queries: K contact queries.
        pairs: C pairs of links that may touch; ``TERRAIN`` is the terrain.

    Returns:
        (K, C) float64 of 1, -1 or 0.
    """
    # Read once: an iterator would be exhausted after the first query.
    known = list(pairs)
    signs = [
        [_sign(query, first, second) - _sign(query, second, first) for first, second in known] for query in queries
    ]
    # view keeps the shape where there are no queries or no pairs.
    return torch.tensor(signs, dtype=torch.float64).view(len(signs), len(known))


def _sign(query: ContactQuery, felt_by: int, exerted_by: int) -> float:
    # None means everything, terrain included.
    return float(felt_by == query.link and (query.others is None or exerted_by in query.others))
