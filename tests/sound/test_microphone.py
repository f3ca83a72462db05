"""Microphones: delay and level over distance, resets, sliding, rooms, and input that cannot be."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch

from orbit_assets.objects import box, sphere
from orbit_core.interfaces import TERRAIN, Capability, ConfigurationError, UnknownNameError, World
from orbit_core.interfaces.requirements import required_capabilities
from orbit_core.scene import PhysicsMaterial, Plane, Pose, Scene, Shape
from orbit_core.world import simulate
from orbit_sound import MATERIALS, Microphone, MicrophoneSpec, Modes, Room, SoundSource
from orbit_sound.bank import ModalBank
from orbit_sound.microphone import _Body, _Sliding
from orbit_sound.propagation import Propagation

RATE, DT, SPEED = 16_000, 0.005, 343.0
BOUNCY = PhysicsMaterial(0.5, 0.5, restitution=0.5)
PLATE = SoundSource(entity="plate", material=MATERIALS["steel"])
MICROPHONE = MicrophoneSpec(name="microphone", pose=Pose((0.0, 0.0, 1.0)), sources=(PLATE,))


def drop(*microphones: MicrophoneSpec, num_envs: int = 1, height: float = 0.05) -> World:
    plate = box("plate", (0.4, 0.3, 0.01), pose=Pose((0.0, 0.0, 0.005)), fixed_base=True, material=BOUNCY)
    ball = sphere("ball", 0.02, mass=0.1, pose=Pose((0.0, 0.0, 0.03 + height)), material=BOUNCY)
    world = simulate(Scene(objects=(plate, ball), sensors=microphones, physics_dt=DT), num_envs, "mujoco")
    world.reset()
    return world


def of(world: World, name: str = "microphone") -> Microphone:
    sensor = world.sensors[name]
    assert isinstance(sensor, Microphone)
    return sensor


def record(world: World, seconds: float, *names: str) -> list[torch.Tensor]:
    heard: list[list[torch.Tensor]] = [[] for _ in names]
    for _ in range(round(seconds * 50)):
        world.step(round(0.02 / DT))
        for part, name in zip(heard, names, strict=True):
            part.append(of(world, name).sound.clone())
    return [torch.cat(part, 1) for part in heard]


def onset(sound: torch.Tensor) -> int:
    return int(torch.nonzero(sound.abs() > 0.02 * sound.abs().max())[0])


def test_a_reading_holds_the_samples_of_a_period() -> None:
    world = drop(MICROPHONE, num_envs=3)
    world.step(4)
    assert of(world).sound.shape == (3, RATE // 50)
    assert not of(world).sound.any()
    assert of(world).level.tolist() == [0.0] * 3
    world.close()


def test_sound_is_late_by_the_distance_and_weaker_by_it() -> None:
    at = [dataclasses.replace(MICROPHONE, name=f"at {z}", pose=Pose((0.0, 0.0, 0.005 + z))) for z in (0.5, 4.0, 8.0)]
    world = drop(*at)
    near, far, farther = (sound[0] for sound in record(world, 0.2, *(spec.name for spec in at)))
    for sound, metres in ((far, 4.0), (farther, 8.0)):
        delay = round((metres - 0.5) / SPEED * RATE)
        assert onset(sound) - onset(near) == pytest.approx(delay, abs=2)
        length = 1500
        power = [each[onset(each) :][:length].square().sum() for each in (near, sound)]
        assert math.sqrt(power[0] / power[1]) == pytest.approx(metres / 0.5, rel=0.07)
    world.close()


def test_the_time_of_a_hit_is_that_of_the_fall() -> None:
    world = drop(MICROPHONE)
    (sound,) = record(world, 0.2, "microphone")
    assert onset(sound[0]) / RATE == pytest.approx(math.sqrt(2 * 0.05 / 9.81) + 0.995 / SPEED, abs=DT)
    world.close()


def test_a_body_that_comes_nearer_is_heard_higher_by_doppler() -> None:
    chunk, hertz, speed, cpu = 80, 500.0, 34.3, torch.device("cpu")
    path = Propagation(1, 1, RATE, chunk, 20.0, cpu)
    heard = []
    for step in range(40):
        time = (torch.arange(chunk) + step * chunk) / RATE
        distance = 15.0 - speed * (step + 1) * chunk / RATE
        sound = torch.sin(2 * math.pi * hertz * time).view(1, 1, -1)
        heard.append(path.carry(sound, torch.tensor([[distance]]))[0, 0])
    late = torch.cat(heard)[1600:]
    crossings = torch.nonzero((late[1:] >= 0) & (late[:-1] < 0)).flatten().double()
    measured = RATE * (len(crossings) - 1) / float(crossings[-1] - crossings[0])
    assert measured == pytest.approx(hertz * (1 + speed / SPEED), rel=0.01)


def test_a_reset_silences_its_own_environment_only() -> None:
    world = drop(MICROPHONE, num_envs=2)
    record(world, 0.12, "microphone")
    assert of(world).sound.any(1).all()
    world.reset(torch.tensor([0]))
    assert of(world).sound.any(1).tolist() == [False, True]
    world.step(4)
    assert of(world).sound.any(1).tolist() == [False, True]
    world.close()


def test_a_snapshot_holds_what_is_in_the_air() -> None:
    world = drop(MICROPHONE)
    record(world, 0.1, "microphone")
    saved = world.save_state()
    (first,) = record(world, 0.06, "microphone")
    world.load_state(saved)
    (second,) = record(world, 0.06, "microphone")
    assert first.any()
    assert torch.equal(first, second)
    world.close()


def test_a_body_that_has_settled_is_silent() -> None:
    block = box("block", (0.1, 0.1, 0.02), mass=1.0, pose=Pose((0.0, 0.0, 0.01)))
    source = SoundSource(entity="block", material=MATERIALS["steel"], slides_on=("terrain",))
    microphone = dataclasses.replace(MICROPHONE, sources=(source,))
    ground = (Shape(Plane(), name="ground"),)
    world = simulate(Scene(objects=(block,), terrain=ground, sensors=(microphone,), physics_dt=DT), 1, "mujoco")
    world.reset()
    record(world, 0.3, "microphone")
    (sound,) = record(world, 0.1, "microphone")
    # A hit of 1 N s would be heard with 20 Pa.
    assert float(sound.abs().max()) < 0.02
    world.close()


def test_sliding_feeds_a_share_of_the_power_of_friction_into_the_modes() -> None:
    # Without damping, so that the modes keep all energy: half of |z / gain|^2 over the mass.
    modes, share, cpu = Modes((300.0, 900.0, 2000.0), (0.0,) * 3, (1.0, 2.0, 3.0), 2.0), 1e-3, torch.device("cpu")
    sliding = _Sliding([_Body(1, modes, share, 0, ((1, TERRAIN), (2, 0)))], RATE, cpu)
    # Friction of -3 N against 2 m/s over the ground, and of -1 N over a partner that moves along at 1.5 m/s.
    forces = torch.tensor([[[-3.0, 0.0, 9.0], [-1.0, 0.0, 5.0]]])
    velocities = torch.tensor([[[1.5, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    power, environments, chunks = 3.0 * 2.0 + 1.0 * 0.5, 400, 10
    size = sliding.impulses(forces, velocities)
    bank = ModalBank([modes], environments, RATE, 80, cpu)
    generator = torch.Generator().manual_seed(0)
    for _ in range(chunks):
        noise = size[..., None] * torch.randn(environments, 1, 80, generator=generator)
        bank.ring(torch.zeros(environments, 1), torch.zeros(environments, 1, dtype=torch.bool), noise)
    amplitudes = bank.amplitudes.norm(dim=0)[:, 0] / torch.tensor(modes.gains)
    energy = float(amplitudes.square().sum(1).mean()) / (2.0 * modes.mass)
    assert energy == pytest.approx(share * power * chunks * 80 / RATE, rel=0.1)
    # What pulls a body along, rather than holds it up, is no friction.
    assert not sliding.impulses(-forces, velocities).any()


def test_a_block_that_slides_is_heard_by_its_scraping() -> None:
    smooth = PhysicsMaterial(0.1, 0.1)
    block = box("block", (0.4, 0.4, 0.01), mass=1.0, pose=Pose((0.0, 0.0, 0.005)), material=smooth)
    loud, mute = (dataclasses.replace(MATERIALS["wood"], scrape=scrape) for scrape in (1e-2, 0.0))
    ears = [
        dataclasses.replace(
            MICROPHONE, name=name, sources=(SoundSource(entity="block", material=wood, slides_on=("terrain",)),)
        )
        for name, wood in (("loud", loud), ("mute", mute))
    ]
    ground = (Shape(Plane(), material=smooth, name="ground"),)
    # Pulled along by gravity from rest: a push would make it hop, and some engines let what slides rattle.
    gravity = (3.0, 0.0, -9.81)
    world = simulate(
        Scene(objects=(block,), terrain=ground, sensors=tuple(ears), gravity=gravity, physics_dt=DT), 1, "bullet"
    )
    world.reset()
    record(world, 0.4, "loud")
    heard = record(world, 0.2, "loud", "mute")
    # The median of readings, for a hit in between is heard by both.
    scraping, silent = (sound.view(-1, RATE // 50).square().mean(1).median() for sound in heard)
    assert scraping > 4.0 * silent
    world.close()


def test_a_scene_with_a_microphone_needs_contact_forces() -> None:
    needs = required_capabilities(Scene(objects=(box("plate", (0.1, 0.1, 0.1)),), sensors=(MICROPHONE,)))
    assert needs[Capability.CONTACT_FORCES] == "sensor 'microphone'"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sources": ()}, "hears nothing: give it sources"),
        ({"entity": "plate"}, "both an entity and a frame"),
        ({"reach": 0.0}, "a reach of 0.0 m: give numbers above zero"),
        ({"rate": None}, "needs a rate"),
    ],
)
def test_specifications_that_cannot_be_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(MICROPHONE, **changes)  # pyright: ignore[reportArgumentType]


def test_what_a_scene_cannot_have_is_named() -> None:
    with pytest.raises(ConfigurationError, match=r"no multiple of the physics rate of 200 Hz: take 16000 or 16200 Hz"):
        drop(dataclasses.replace(MICROPHONE, sampling_rate=16_100))
    with pytest.raises(UnknownNameError, match="plat"):
        drop(dataclasses.replace(MICROPHONE, sources=(SoundSource(entity="plat"),)))
    with pytest.raises(UnknownNameError, match="floor"):
        drop(dataclasses.replace(MICROPHONE, sources=(dataclasses.replace(PLATE, slides_on=("floor",)),)))
    pytest.importorskip("pyroomacoustics")
    with pytest.raises(ConfigurationError, match=r"microphone 'microphone': the microphone at .* outside of the room"):
        drop(dataclasses.replace(MICROPHONE, room=Room(size=(1.0, 1.0, 0.5))))
