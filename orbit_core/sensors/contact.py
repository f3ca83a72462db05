"""Contact forces per link, in all and per other entity, with the times of touching and of flight."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import write_rows
from orbit_core.interfaces.layout import contact_queries_of
from orbit_core.scene import ContactSensorSpec
from orbit_core.sensors.timed import AveragingSensor, SensorContext, Values


class ContactSensor(AveragingSensor):
    """Net contact forces on links, world axes, averaged over the sensor's period.

    Forces are zero after a reset until the environment has stepped. Noise, in newtons, goes on every component.
    """

    noisy = ("forces", "filtered")

    def __init__(self, spec: ContactSensorSpec, context: SensorContext) -> None:
        layout = context.layout
        queries = contact_queries_of(spec, {entity.name: entity for entity in layout.entities})
        # Columns of a link: its net force, then the force of each filter.
        per_link = 1 + len(spec.filters)
        count = len(queries) // per_link
        super().__init__(spec, context, (count, per_link, 3))
        columns = [layout.contact_queries.index(query) for query in queries]
        self.filters = spec.filters
        """Names of the entities along the third dimension of :attr:`filtered_forces`."""
        self.link_names = tuple(layout.links[query.link].name for query in queries[::per_link])
        """Names of the links along the second dimension of all values."""
        self._columns = torch.tensor(columns, dtype=torch.int64, device=self.device)
        self._timers: dict[float, ContactTimer] = {}

    @property
    def forces(self) -> Tensor:
        """Forces (N, links, 3), newtons."""
        return self._read("forces")

    @property
    def filtered_forces(self) -> Tensor:
        """Filtered forces (N, links, filters, 3), newtons, of each of :attr:`filters`."""
        return self._read("filtered")

    def in_contact(self, threshold: float = 1.0) -> Tensor:
        """Return a mask (N, links) of the links whose net force exceeds ``threshold`` newtons."""
        return self.forces.norm(dim=-1) > threshold

    def timer(self, threshold: float = 1.0) -> ContactTimer:
        """Return a stopwatch per link, that runs from its first asking; the same threshold gives the same one."""
        # Made on request; they advance whenever the engine steps, also between measurements.
        if threshold not in self._timers:
            self._timers[threshold] = ContactTimer(self.num_envs, len(self.link_names), threshold, self.device)
        return self._timers[threshold]

    def _forget(self, env_ids: Tensor | None) -> None:
        super()._forget(env_ids)
        for timer in self._timers.values():
            timer.reset(env_ids)

    def save_state(self) -> dict[str, Any]:
        return super().save_state() | {"timers": {key: timer.times.clone() for key, timer in self._timers.items()}}

    def load_state(self, state: dict[str, Any]) -> None:
        super().load_state(state)
        for threshold, times in state["timers"].items():
            self.timer(threshold).times.copy_(times)

    def _integrate(self, steps: int) -> Tensor:
        forces = self.engine.contact_forces.index_select(1, self._columns).unflatten(1, self._sum.shape[1:3])
        for timer in self._timers.values():
            timer.advance(forces[:, :, 0], steps * self.physics_dt)
        return forces * steps

    def _measure(self, env_ids: Tensor | None) -> Values:
        mean = self._mean(env_ids)
        return {"forces": mean[:, :, 0], "filtered": mean[:, :, 1:]}


class ContactTimer:
    """A stopwatch of how long links have touched something, and how long they have not.

    It sees forces without noise or delay, as often as the world steps its engine.
    """

    def __init__(self, num_envs: int, links: int, threshold: float, device: torch.device) -> None:
        self.threshold = threshold
        """N of net force above which a link counts as touching."""
        self.times = torch.zeros(4, num_envs, links, device=device)
        """Seconds: contact, air, last contact, last air; a reset starts all at zero."""

    @property
    def contact_time(self) -> Tensor:
        """Seconds (N, links) since the touch-down; zero in the air."""
        return self.times[0]

    @property
    def air_time(self) -> Tensor:
        """Seconds (N, links) since the lift-off; zero in contact."""
        return self.times[1]

    @property
    def last_contact_time(self) -> Tensor:
        """Duration (N, links) of the last contact that has ended, s."""
        return self.times[2]

    @property
    def last_air_time(self) -> Tensor:
        """Duration (N, links) of the last flight that has ended, s."""
        return self.times[3]

    def touched_down(self, within: float) -> Tensor:
        """Return a mask (N, links) of the links that touched down during the last ``within`` seconds."""
        # The margin absorbs rounding of sums of time steps.
        return (self.contact_time > 0.0) & (self.contact_time <= within + 1e-6)

    def advance(self, forces: Tensor, duration: float) -> None:
        """Account for ``duration`` seconds of forces (N, links, 3)."""
        # One rule for touch and flight, so that each link is always in exactly one of the two.
        contact = forces.norm(dim=-1) > self.threshold
        touching, flying, last_touch, last_flight = self.times
        times = (
            torch.where(contact, touching + duration, 0.0),
            torch.where(contact, 0.0, flying + duration),
            torch.where(~contact & (touching > 0.0), touching, last_touch),
            torch.where(contact & (flying > 0.0), flying, last_flight),
        )
        self.times.copy_(torch.stack(times))

    def reset(self, env_ids: Tensor | None = None) -> None:
        """Start some environments at zero."""
        write_rows(self.times.transpose(0, 1), 0.0, env_ids)
