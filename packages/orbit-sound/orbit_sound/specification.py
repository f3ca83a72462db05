"""Specification of microphones and of the bodies that they hear."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from orbit_core.scene import ContactSensorSpec, Pose, SensorSpec
from orbit_sound.materials import MATERIALS, SoundMaterial
from orbit_sound.modes import Modes
from orbit_sound.rooms import Room


@dataclass(frozen=True, kw_only=True)
class SoundSource:
    """Links of an entity that sound where they are hit, or slide over something."""

    entity: str
    """Name of the robot or object."""
    links: tuple[str, ...] = (".*",)
    """Regular expressions over link names (full match); links without collision shapes are silent."""
    material: SoundMaterial = MATERIALS["wood"]
    """Material of the links; ORBIT's scenes say nothing of elasticity."""
    modes: Modes | None = None
    """Modes of each link; None derives them from its largest collision shape and ``material``."""
    slides_on: tuple[str, ...] = ()
    """Entities, or ``"terrain"``, over which the links are heard to slide. Each is as fast as its root link."""


@dataclass(frozen=True, kw_only=True)
class MicrophoneSpec(SensorSpec):
    """A microphone that hears impacts and sliding of ``sources``, alike from all directions.

    It is at ``pose`` in the environment's frame, or in that of ``frame`` of ``entity`` where these are given. Each
    reading holds the samples of one period of ``rate``; noise, in Pa, goes on every sample.

    Raises:
        ValueError: it hears nothing, or a number is out of its range.
    """

    # A reading has a fixed number of samples, so that the rate may not be left out.
    rate: float = 50.0  # pyright: ignore[reportIncompatibleVariableOverride]
    sources: tuple[SoundSource, ...] = ()
    """Bodies that are heard."""
    sampling_rate: int = 16_000
    """Hz; a multiple of the physics rate."""
    pose: Pose = field(default_factory=Pose)
    """Pose in the frame; only its position matters."""
    entity: str | None = None
    """Entity that carries the microphone."""
    frame: str | None = None
    """Link or named frame that carries it."""
    reach: float = 20.0
    """m from which on bodies are not heard."""
    room: Room | None = None
    """Room whose walls reflect the sound, as from where sources and microphone are at first; None is free air."""

    def __post_init__(self) -> None:
        if not self.sources:
            raise ValueError(f"microphone '{self.name}' hears nothing: give it sources, a SoundSource for each entity")
        if self.rate is None:
            raise ValueError(f"microphone '{self.name}' needs a rate: its readings have a fixed number of samples")
        if (self.entity is None) != (self.frame is None):
            raise ValueError(f"microphone '{self.name}' needs both an entity and a frame to sit on, or neither")
        if self.sampling_rate <= 0 or not 0.0 < self.reach < math.inf:
            raise ValueError(
                f"microphone '{self.name}' has a sampling rate of {self.sampling_rate} Hz and a reach of {self.reach} "
                "m: give numbers above zero"
            )

    @property
    def contacts(self) -> tuple[ContactSensorSpec, ...]:
        """Contact forces on the links of each source."""
        return tuple(
            ContactSensorSpec(name=self.name, entity=each.entity, links=each.links, filters=each.slides_on)
            for each in self.sources
        )
