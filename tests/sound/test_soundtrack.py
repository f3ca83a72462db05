"""Sound of videos, in time with their pictures, and waveforms in datasets of every format."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_assets.objects import box, sphere
from orbit_core.envs import Environment, EventTerm, ObservationGroup, ObservationTerm, Task
from orbit_core.envs.actors import scripted_actor
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.scene import PhysicsMaterial, Pose, Scene
from orbit_data.formats import opened
from orbit_data.recording import RecordingFile, record
from orbit_motion import workspace
from orbit_sound import MATERIALS, MicrophoneSpec, SoundSource, heard
from orbit_viewer.video import VideoRecorder

HEIGHT, RADIUS = 0.3, 0.02
BOUNCY = PhysicsMaterial(0.3, 0.3, restitution=0.5)


def microphone(rate: float = 50.0) -> MicrophoneSpec:
    """Return a microphone 0.3 m above a plate."""
    source = SoundSource(entity="plate", material=MATERIALS["steel"])
    return MicrophoneSpec(name="microphone", pose=Pose((0.8, 0.0, 0.32)), rate=rate, sources=(source,))


def drop(env: Environment, env_ids: Tensor) -> None:
    """Hold the ball above the plate."""
    place = torch.tensor([0.8, 0.0, 0.02 + RADIUS + HEIGHT, 0.0], device=env.device)
    env.world.objects["ball"].set_root_pose(common.standing(place.expand(len(env_ids), 4)), env_ids)


@dataclass
class Heard(ObservationGroup):
    """The waveform."""

    sound: ObservationTerm | None = field(default_factory=lambda: heard(microphone()))


@dataclass
class Observations:
    """Return what is heard."""

    policy: ObservationGroup = field(default_factory=Heard)


@dataclass
class Events:
    """The ball is dropped."""

    drop: EventTerm | None = EventTerm(drop)


@dataclass(kw_only=True)
class Falling(Task):
    """A ball falls on a plate next to an arm."""

    robot: str = "franka_panda"
    action: str = "joint_position"
    episode_length: float = 1.0
    observations: Observations = field(default_factory=Observations)
    events: Events = field(default_factory=Events)

    def scene(self) -> Scene:
        plate = box("plate", (0.3, 0.2, 0.02), pose=Pose((0.8, 0.0, 0.01)), fixed_base=True, material=BOUNCY)
        ball = sphere("ball", RADIUS, mass=0.1, pose=Pose((0.8, 0.0, 0.3)), material=BOUNCY)
        return Scene(
            robots=(workspace.arm(self.robot),), objects=(plate, ball), terrain=(common.floor(),),
            physics_dt=self.physics_dt,
        )  # fmt: skip

    def success(self, env: Environment) -> Tensor:
        return torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)

    def metrics(self, env: Environment) -> dict[str, Tensor]:
        return {"height_m": env.world.objects["ball"].root_pose[:, 2]}


def film(path: Path, **fields: Any) -> Environment:
    """Film an episode of zero actions, and return its environment."""
    env = Environment(Falling(**fields), num_envs=2, backend="mujoco", seed=0)
    env.reset(seed=0)
    with VideoRecorder(env, path, environments=2, width=64, height=48) as recorder:
        for _ in range(env.max_episode_steps):
            recorder.before_step()
            env.step(torch.zeros(2, env.actions.size, device=env.device))
    return env


def test_a_video_sounds_when_the_ball_hits_the_plate(tmp_path: Path):
    av = pytest.importorskip("av")
    path = tmp_path / "falling.mp4"
    env = film(path)
    with av.open(str(path)) as container:
        assert [len(container.streams.video), len(container.streams.audio)] == [1, 1]
        frame = 1.0 / float(container.streams.video[0].average_rate)
        chunks = [(float(each.pts * each.time_base), each.to_ndarray()) for each in container.decode(audio=0)]
        rate = container.streams.audio[0].rate
    start, sound = chunks[0][0], np.concatenate([samples[0] for _, samples in chunks])
    onset = start + int(np.flatnonzero(np.abs(sound) > 0.1 * np.abs(sound).max())[0]) / rate
    # It falls for sqrt(2 h / g), and the sound comes 1 ms later.
    assert onset == pytest.approx(math.sqrt(2.0 * HEIGHT / 9.81) + 0.3 / 343.0, abs=frame)
    assert len(sound) / rate == pytest.approx(1.0, abs=0.1)
    assert np.abs(sound).max() > 0.3
    assert list(tmp_path.iterdir()) == [path]
    env.close()


def test_a_microphone_that_is_faster_than_steps_cannot_be_filmed(tmp_path: Path):
    group = Heard(sound=heard(microphone(100.0)))
    with pytest.raises(ConfigurationError, match="microphone 'microphone' measures at 100 Hz, more often than"):
        film(tmp_path / "falling.mp4", observations=Observations(group))
    assert not list(tmp_path.iterdir())


def test_a_slow_microphone_is_heard_whole(tmp_path: Path):
    av = pytest.importorskip("av")
    path = tmp_path / "falling.mp4"
    film(path, observations=Observations(Heard(sound=heard(microphone(10.0))))).close()
    with av.open(str(path)) as container:
        sound = np.concatenate([each.to_ndarray()[0] for each in container.decode(audio=0)])
        rate = container.streams.audio[0].rate
    onset = int(np.flatnonzero(np.abs(sound) > 0.1 * np.abs(sound).max())[0]) / rate
    assert onset == pytest.approx(math.sqrt(2.0 * HEIGHT / 9.81), abs=0.04)


@pytest.mark.parametrize("name", ["falling.hdf5", "falling"])
def test_a_dataset_holds_the_waveform_at_its_rate(tmp_path: Path, name: str):
    path = tmp_path / name
    env = Environment(Falling(episode_length=0.5), num_envs=2, backend="mujoco", seed=0)
    record(env, lambda: scripted_actor("zero", env, 0), RecordingFile(path), "Falling", 2, 0)
    env.close()
    with opened(path) as dataset:
        # A period of the microphone is a step, and each reading has its samples.
        assert dataset.manifest is not None
        rate = 16_000 * dataset.manifest.step_dt
        assert b"16000 samples a second" in dataset.manifest.encode()
        for place in range(2):
            sound = dataset.read(place).arrays["obs/sound"]
            assert sound.shape == (25, round(rate))
            wave = sound.ravel()
            # The first reading is that of before the first step, so that the waveform is one step late.
            onset = int(np.flatnonzero(np.abs(wave) > 0.1 * np.abs(wave).max())[0]) / 16_000 - 0.02
            assert onset == pytest.approx(math.sqrt(2.0 * HEIGHT / 9.81) + 0.3 / 343.0, abs=0.0055)
