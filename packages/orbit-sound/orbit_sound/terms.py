"""Observation terms of sound."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from torch import Tensor

from orbit_core.envs.terms import Meaning, ObservationTerm
from orbit_sound.microphone import Microphone
from orbit_sound.specification import MicrophoneSpec

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


def heard(microphone: MicrophoneSpec) -> ObservationTerm:
    """(N, samples) pressure in Pa over the microphone's last period; datasets of the task hold its waveform."""

    def sound(env: Environment) -> Tensor:
        return cast(Microphone, env.world.sensors[microphone.name]).sound

    formula = f"pressure at microphone '{microphone.name}', {microphone.sampling_rate} samples a second"
    return ObservationTerm(sound, sensors=(microphone,), unit="Pa", meaning=Meaning(formula))
