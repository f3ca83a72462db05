"""Sound of contacts: vibration modes of bodies, microphones as sensors, and acoustics of rooms."""

from orbit_sound.materials import MATERIALS, SoundMaterial
from orbit_sound.microphone import Microphone
from orbit_sound.modes import Modes, bar_modes, disc_modes, plate_modes, rod_modes, shape_modes, sphere_modes
from orbit_sound.rooms import Room, reverberation_time, room_responses, sabine_time
from orbit_sound.specification import MicrophoneSpec, SoundSource
from orbit_sound.terms import heard

__all__ = [
    "MATERIALS", "Microphone", "MicrophoneSpec", "Modes", "Room", "SoundMaterial", "SoundSource", "bar_modes",
    "disc_modes", "heard", "plate_modes", "reverberation_time", "rod_modes", "room_responses", "sabine_time",
    "shape_modes", "sphere_modes",
]  # fmt: skip
