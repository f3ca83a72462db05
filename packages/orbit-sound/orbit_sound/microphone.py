"""Microphones: pressure of the air where bodies are hit or slide, by their vibration modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows, write_rows
from orbit_core.interfaces import TERRAIN, ConfigurationError, SceneLayout
from orbit_core.interfaces.layout import contact_queries_of
from orbit_core.scene import Box, Capsule, Cylinder, Link, Mesh, Shape, Sphere
from orbit_core.sensors.proprioception import Mount, pose_tensor
from orbit_core.sensors.sound import SoundSensor
from orbit_core.sensors.timed import SensorContext, Values
from orbit_sound.bank import ModalBank
from orbit_sound.modes import Modes, shape_modes
from orbit_sound.propagation import Propagation
from orbit_sound.reverberation import Reverberation
from orbit_sound.rooms import room_responses
from orbit_sound.specification import MicrophoneSpec, SoundSource

# Seconds over which a force counts as one that rests, which makes no sound. Soft contacts of engines spread an impact
# over up to 10 ms, and must stay well below.
_RESTING = 0.03
# A force must exceed the resting one by half before it is a hit: solvers let resting forces tremble.
_MARGIN = 1.5
_TOUCHING = 1e-4  # N
_QUIETEST = 20e-6  # Pa: zero dB


@dataclass(frozen=True)
class _Body:
    """A link that sounds."""

    link: int
    """Index in (N, L, ...) tensors."""
    modes: Modes
    scrape: float
    """Share of friction's power that becomes vibration."""
    net: int
    """Column of its net contact force."""
    pairs: tuple[tuple[int, int], ...]
    """Column of each pair force, with the link that it slides on, or TERRAIN."""


class Microphone(SoundSensor):
    """Pressure of the air at a point, from impacts and sliding of some bodies.

    The engine stops after each physics step, whose contact forces start the bodies' modes: the part of a net force that
    does not rest is a hit, and the power that a pair's resting force loses to sliding feeds noise. Each body's sound
    arrives late and weaker by its distance, and a room's reflections follow.
    """

    noisy = ("sound",)

    def __init__(self, spec: MicrophoneSpec, context: SensorContext) -> None:
        """Derive modes, delays and the room's response.

        Raises:
            ConfigurationError: the sampling rate is no multiple of the physics rate, a source has no shape to derive
                modes from, or something is outside of the room.
        """
        super().__init__(spec, context)
        self._microphone = spec
        self.sampling_rate = spec.sampling_rate
        """Hz."""
        self._chunk = _samples_per_step(spec, context.physics_dt)
        bodies = [body for source in spec.sources for body in _bodies(source, spec.name, context.layout)]
        self.link_names = tuple(context.layout.links[body.link].name for body in bodies)
        """Names of the links that are heard."""
        device, count, num_envs = self.device, len(bodies), self.num_envs
        self._mount: Mount | None = None
        if spec.entity is not None and spec.frame is not None:
            place = (context.engine, context.layout, spec.entity, spec.frame, spec.name)
            self._mount = Mount(*place, spec.pose)
        self._fixed = pose_tensor(spec.pose, device)[:3].repeat(num_envs, 1)
        self._bank = ModalBank([body.modes for body in bodies], num_envs, spec.sampling_rate, self._chunk, device)
        self._propagation = Propagation(num_envs, count, spec.sampling_rate, self._chunk, spec.reach, device)
        self._links = torch.tensor([body.link for body in bodies], device=device)
        self._columns = torch.tensor([body.net for body in bodies], device=device)
        self._sliding = _Sliding(bodies, spec.sampling_rate, device) if any(body.pairs for body in bodies) else None
        assert self.period is not None
        window = self.period * self._chunk
        self._heard = torch.zeros(num_envs, window, device=device)
        self._emitted = torch.zeros(num_envs, count, window, device=device)
        self._reverberation: Reverberation | None = None
        if spec.room is not None:
            responses = self._room_responses(spec)
            self._reverberation = Reverberation(responses, num_envs, window)
        pairs = 0 if self._sliding is None else len(self._sliding.columns)
        self._resting = torch.zeros(num_envs, count, 3, device=device)
        self._pressing = torch.zeros(num_envs, pairs, 3, device=device)
        self._touching = torch.zeros(num_envs, count, dtype=torch.bool, device=device)
        # True until an environment has stepped after a reset: what touches then has not been hit.
        self._new = torch.ones(num_envs, dtype=torch.bool, device=device)

    @property
    def sound(self) -> Tensor:
        """Pressure (N, samples) in Pa over the last period, at :attr:`sampling_rate`."""
        return self._read("sound")

    @property
    def level(self) -> Tensor:
        """Level (N,) of the last period in dB over 20 uPa; at least zero."""
        mean = self.sound.square().mean(1).sqrt()
        return 20.0 * torch.log10((mean / _QUIETEST).clamp_min(1.0))

    @property
    def stretch(self) -> int:
        """One physics step: the engine averages contact forces over each run."""
        return 1

    def advance(self, steps: int) -> None:
        assert steps == 1, "the world steps by the shortest stretch of its sensors"
        emitted = self._emit()
        begin = self._elapsed * self._chunk
        position = self._fixed if self._mount is None else self._mount.pose()[:, :3]
        bodies = self.engine.link_poses.index_select(1, self._links)[..., :3]
        distance = (bodies - position[:, None]).norm(dim=-1)
        arrived = self._propagation.carry(emitted, distance)
        self._heard[:, begin : begin + self._chunk] = arrived.sum(1)
        if self._reverberation is not None:
            self._emitted[:, :, begin : begin + self._chunk] = emitted
            if self._elapsed + steps == self.period:
                self._heard += self._reverberation.add(self._emitted)
        super().advance(steps)

    def save_state(self) -> dict[str, Any]:
        return super().save_state() | {"sound": tuple(each.clone() for each in self._state)}

    def load_state(self, state: dict[str, Any]) -> None:
        super().load_state(state)
        for own, saved in zip(self._state, state["sound"], strict=True):
            own.copy_(saved)

    @property
    def _state(self) -> tuple[Tensor, ...]:
        tails = () if self._reverberation is None else (self._reverberation.tail,)
        own = (self._heard, self._emitted, self._resting, self._pressing, self._touching, self._new)
        return (*own, self._bank.amplitudes, *self._propagation.state, *tails)

    def _forget(self, env_ids: Tensor | None) -> None:
        super()._forget(env_ids)
        for each in (self._heard, self._emitted, self._resting, self._pressing):
            write_rows(each, 0.0, env_ids)
        write_rows(self._touching, False, env_ids)
        write_rows(self._new, True, env_ids)
        self._bank.reset(env_ids)
        self._propagation.reset(env_ids)
        if self._reverberation is not None:
            self._reverberation.reset(env_ids)

    def _measure(self, env_ids: Tensor | None) -> Values:
        return {"sound": take_rows(self._heard, env_ids).clone()}

    def _emit(self) -> Tensor:
        """Return the pressures (N, S, K) at 1 m of each body over the last physics step, Pa."""
        forces = self.engine.contact_forces.index_select(1, self._columns)
        size = forces.norm(dim=-1)
        over = (size - _MARGIN * self._resting.norm(dim=-1)).clamp_min(0.0)
        hits = torch.where(self._new[:, None], 0.0, over * self.physics_dt)
        scrapes = None if self._sliding is None else self._scrape(self._sliding)
        sound = self._bank.ring(hits, ~self._touching, scrapes)
        self._resting.copy_(self._smooth(self._resting, forces))
        self._touching.copy_(size > _TOUCHING)
        self._new.zero_()
        return sound

    def _scrape(self, sliding: _Sliding) -> Tensor:
        """Return impulses (N, S, K) of sliding, N s."""
        self._pressing.copy_(self._smooth(self._pressing, self.engine.contact_forces.index_select(1, sliding.columns)))
        size = sliding.impulses(self._pressing, self.engine.link_velocities[..., :3])
        return size[..., None] * self._random.normal((*self._links.shape, self._chunk))

    def _smooth(self, held: Tensor, forces: Tensor) -> Tensor:
        """Return forces (N, X, 3) averaged over the time that a force rests."""
        moved = held + min(1.0, self.physics_dt / _RESTING) * (forces - held)
        return torch.where(self._new[:, None, None], forces, moved)

    def _room_responses(self, spec: MicrophoneSpec) -> Tensor:
        assert spec.room is not None
        position = self._fixed if self._mount is None else self._mount.pose()[:, :3]
        bodies = self.engine.link_poses[0, self._links, :3]
        try:
            responses = room_responses(spec.room, bodies.cpu().numpy(), position[0].cpu().tolist(), spec.sampling_rate)
        except ConfigurationError as error:
            raise ConfigurationError(f"microphone '{spec.name}': {error}") from error
        return torch.as_tensor(responses, dtype=torch.float32, device=self.device)


class _Sliding:
    """Pair forces that may slide, and the impulses that their friction feeds into modes."""

    def __init__(self, bodies: list[_Body], sampling_rate: float, device: torch.device) -> None:
        pairs = [(row, *pair) for row, body in enumerate(bodies) for pair in body.pairs]
        rows, columns, partners = (torch.tensor(each, device=device) for each in zip(*pairs, strict=True))
        self.columns = columns
        """Columns (P,) of the pair forces."""
        self._own = torch.tensor([body.link for body in bodies], device=device)[rows]
        self._partner = partners.clamp_min(0)
        self._partner_moves = (partners != TERRAIN).float()[:, None]
        self._sum = torch.nn.functional.one_hot(rows, len(bodies)).float()
        # Impulses of this variance at each sample give all of a body's modes, which share its mass, that power.
        shares = [2.0 * b.modes.mass * b.scrape / (sampling_rate * max(len(b.modes.gains), 1)) for b in bodies]
        self._scale = torch.tensor(shares, device=device)

    def impulses(self, forces: Tensor, velocities: Tensor) -> Tensor:
        """Return the deviation (N, S) in N s of each sample's impulse.

        Args:
            forces: (N, P, 3) N on the bodies.
            velocities: (N, L, 3) m/s of all links.
        """
        partner = velocities.index_select(1, self._partner) * self._partner_moves
        power = -(forces * (velocities.index_select(1, self._own) - partner)).sum(-1)
        return ((power.clamp_min(0.0) @ self._sum) * self._scale).sqrt()


def _samples_per_step(spec: MicrophoneSpec, physics_dt: float) -> int:
    exact = spec.sampling_rate * physics_dt
    samples = round(exact)
    if samples < 1 or abs(exact - samples) > 1e-4 * exact:
        rate = 1.0 / physics_dt
        near = f"{max(int(exact), 1) * rate:g} or {(int(exact) + 1) * rate:g}"
        raise ConfigurationError(
            f"microphone '{spec.name}' samples at {spec.sampling_rate} Hz, which is no multiple of the physics rate of "
            f"{rate:g} Hz: take {near} Hz"
        )
    return samples


def _bodies(source: SoundSource, sensor: str, layout: SceneLayout) -> list[_Body]:
    """Return the links of a source that sound, with the columns of their forces."""
    entities = {entity.name: entity for entity in layout.entities}
    spec = MicrophoneSpec(name=sensor, sources=(source,)).contacts[0]
    queries = contact_queries_of(spec, entities)
    partners = [TERRAIN if name == "terrain" else entities[name].links.start for name in source.slides_on]
    stride = 1 + len(partners)
    bodies = []
    for first in range(0, len(queries), stride):
        net, *pairs = (layout.contact_queries.index(query) for query in queries[first : first + stride])
        link = queries[first].link
        modes = source.modes or _link_modes(layout.links[link], source)
        if modes is not None:
            slides = tuple(zip(pairs, partners, strict=True))
            bodies.append(_Body(link, modes, source.material.scrape, net, slides))
    if not bodies:
        raise ConfigurationError(
            f"microphone '{sensor}' hears nothing of '{source.entity}', whose links have no collision shapes: give the "
            "source its 'modes'"
        )
    return bodies


def _link_modes(link: Link, source: SoundSource) -> Modes | None:
    return shape_modes(max(link.collisions, key=_extent), source.material) if link.collisions else None


def _extent(shape: Shape) -> float:
    """Return a measure of a shape's size, m."""
    match shape.geometry:
        case Sphere(radius=radius):
            return radius
        case Cylinder(radius=radius, half_length=half) | Capsule(radius=radius, half_length=half):
            return radius + half
        case Box(half_extents=half):
            return sum(half)
        case Mesh(vertices=vertices):
            return 0.5 * float((vertices.max(0) - vertices.min(0)).sum())
        case _:
            return 0.0
