"""Touch and hearing: tactile pads under known loads, and microphones near a known impact."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from orbit_assets.objects import box
from orbit_conformance.bodies import SMOOTH_GROUND, G, marble, scene, smooth_material
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability, World
from orbit_core.scene import ObjectSpec, PhysicsMaterial, Pose, TactileSpec
from orbit_core.sensors import TactileSensor
from orbit_sound import MATERIALS, Microphone, MicrophoneSpec, Modes, SoundSource, shape_modes

_ROUGH = PhysicsMaterial(1.0, 1.0)
_YOUNG, _POISSON = 2.0e5, 0.48
_MODULUS = _YOUNG / (1.0 - _POISSON**2)
_SIDE, _TAXELS = 0.02, 16
_PAD = TactileSpec(
    name="pad", entity="finger", frame="finger", pose=Pose((0.0, 0.0, 0.02)), size=(_SIDE, _SIDE),
    taxels=(_TAXELS, _TAXELS), young=_YOUNG, poisson=_POISSON,
)  # fmt: skip
_BALL, _MASS = 0.015, 0.2


def _on_the_pad(trial: Trial, *things: ObjectSpec) -> World:
    """Things that have come to rest on a fixed finger, whose pad faces up."""
    finger = box("finger", (0.04, 0.04, 0.04), pose=Pose((0.0, 0.0, 0.02)), fixed_base=True, material=_ROUGH)
    world = trial.world(scene(finger, *things, terrain=SMOOTH_GROUND, sensors=(_PAD,)))
    # The last step only, so that the mean force is that of rest.
    trial.step(world, trial.steps(0.5) - 1)
    trial.step(world)
    return world


def _pad(world: World) -> TactileSensor:
    sensor = world.sensors["pad"]
    assert isinstance(sensor, TactileSensor)
    return sensor


def _pressed(trial: Trial) -> Mapping[str, float]:
    """A ball rests on one pad, and a block whose edge is 4 mm from the middle of another."""
    ball = _pad(_on_the_pad(trial, marble("ball", _BALL, _ROUGH, Pose((0.0, 0.0, 0.055)), _MASS)))
    forces, weight = ball.normal_forces[0].double().cpu(), _MASS * G
    contact = (3.0 * weight * _BALL / (4.0 * _MODULUS)) ** (1.0 / 3.0)
    peak = 3.0 * weight / (2.0 * math.pi * contact**2)
    cell = (_SIDE / _TAXELS) ** 2
    area = float((forces > 0.02 * forces.max()).sum()) * cell
    block = box("block", (0.05, 0.03, 0.02), mass=0.3, pose=Pose((0.029, 0.0, 0.05)), material=_ROUGH)
    rest = box("rest", (0.02, 0.04, 0.04), pose=Pose((0.045, 0.0, 0.02)), fixed_base=True, material=_ROUGH)
    columns = _pad(_on_the_pad(trial, block, rest)).normal_forces[0].sum(0).cpu()
    first = int(torch.nonzero(columns > 1e-6).flatten()[0]) if bool((columns > 1e-6).any()) else 0
    return {
        "force": abs(float(forces.sum()) / weight - 1.0),
        "peak": abs(float(forces.max()) / cell / peak - 1.0),
        "radius": abs(math.sqrt(area / math.pi) / contact - 1.0),
        "edge": abs((first / _TAXELS - 0.5) * _SIDE - 0.004),
    }


def _sheared(trial: Trial) -> Mapping[str, float]:
    """A block on the pad is pushed aside by a third of its weight."""
    mass, share = 0.2, torch.tensor([0.3, -0.1])
    world = _on_the_pad(
        trial, box("block", (0.03, 0.03, 0.01), mass=mass, pose=Pose((0.0, 0.0, 0.045)), material=_ROUGH)
    )
    wrench = torch.zeros(1, 1, 6, device=world.device)
    wrench[..., :2] = share.to(world.device) * mass * G
    # At the height of the pad, so that the block does not tip: r x f with r half of its height down.
    wrench[..., 3:5] = 0.005 * mass * G * torch.stack((share[1], -share[0])).to(world.device)
    world.objects["block"].set_wrenches(wrench)
    trial.step(world, trial.steps(0.2) - 1)
    trial.step(world)
    pad = _pad(world)
    shear, normal = pad.shear_forces[0].cpu(), pad.normal_forces[0].cpu()
    return {
        "normal": abs(float(normal.sum()) / (mass * G) - 1.0),
        "shear": float((shear.sum((0, 1)) / (mass * G) - share).norm()),
    }


_HEIGHT, _RATE, _FAR = 0.2, 16_000, 3.44
_RESTITUTION = 0.5


def _impact(trial: Trial) -> Mapping[str, float]:
    """A ball falls on a steel plate, which a microphone hears from above."""
    material = smooth_material(0.0, _RESTITUTION)
    plate = box("plate", (0.4, 0.3, 0.01), pose=Pose((0.0, 0.0, 0.005)), fixed_base=True, material=material)
    ball = marble("ball", 0.02, material, Pose((0.0, 0.0, 0.03 + _HEIGHT)), 0.1)
    steel = MATERIALS["steel"]
    microphone = MicrophoneSpec(
        name="microphone", pose=Pose((0.0, 0.0, 0.005 + _FAR)), sampling_rate=_RATE,
        sources=(SoundSource(entity="plate", material=steel),),
    )  # fmt: skip
    world = trial.world(scene(plate, ball, terrain=(), sensors=(microphone,)))
    sensor, heard = world.sensors["microphone"], []
    assert isinstance(sensor, Microphone)
    for _ in range(round(0.3 * microphone.rate)):
        trial.step(world, trial.steps(1.0 / microphone.rate))
        heard.append(sensor.sound[0].double().cpu())
    sound = torch.cat(heard)
    (shape,) = world.scene.objects[0].articulation.links[0].collisions
    speed = math.sqrt(2.0 * G * _HEIGHT)
    modes = shape_modes(shape, steel)
    ring = _ring(modes, (1.0 + _RESTITUTION) * 0.1 * speed, round(0.05 * _RATE)) / _FAR
    loud = torch.nonzero(sound.abs() > 0.01 * ring.abs().max()).flatten()
    if not len(loud):
        return {"time": math.inf, "level": math.inf}
    begin = int(loud[0])
    trial.trace(
        "pressure",
        "Pa",
        [i / _RATE for i in range(len(ring))],
        sound[begin : begin + len(ring)].tolist(),
        ring.tolist(),
    )
    # From 10 ms after the onset on, when soft contacts too have given all of the impulse.
    late = slice(round(0.01 * _RATE), None)
    power = sound[begin : begin + len(ring)][late].square().mean() / ring[late].square().mean()
    return {
        "time": abs(begin / _RATE - speed / G - _FAR / 343.0),
        "level": abs(10.0 * math.log10(float(power))),
    }


def _ring(modes: Modes, impulse: float, samples: int) -> Tensor:
    """Pressure (samples,) at 1 m after a hit, the sum of damped sines, Pa."""
    time = torch.arange(samples, dtype=torch.float64) / _RATE
    rows = [row for row in zip(modes.frequencies, modes.decays, modes.gains, strict=True) if row[0] < 0.5 * _RATE]
    sines = [gain * torch.exp(-decay * time) * torch.sin(2.0 * math.pi * hertz * time) for hertz, decay, gain in rows]
    return impulse * torch.stack(sines).sum(0)


_GRID = "taxels of 1.25 mm sample the pressure; rays and forces of all engines are alike"

SCENARIOS = (
    Scenario(
        name="pressed_tactile_pad",
        group="Sensors",
        question="Does a tactile pad feel a ball's pressure and a block's edge?",
        truth="the weight; Hertz's peak 3 F / (2 pi a^2) and radius a = (3 F R / 4 E)^(1/3); an edge 4 mm off",
        source="Johnson, Contact Mechanics, 1985, section 4.2",
        needs=(Capability.CONTACT_FORCES, Capability.RAY_CASTS),
        judges=(Capability.CONTACT_FORCES, Capability.RAY_CASTS),
        run=_pressed,
        metrics=(
            Metric(
                name="force",
                unit="",
                tolerance=0.02,
                meaning="relative error of the taxels' sum against the ball's weight",
                looser_because="a bar for touch; the best is at rounding error",
            ),
            Metric(
                name="peak",
                unit="",
                tolerance=0.06,
                meaning="relative error of the largest pressure",
                looser_because=_GRID,
            ),
            Metric(
                name="radius",
                unit="",
                tolerance=0.08,
                meaning="relative error of the radius of the area that is pressed",
                looser_because=_GRID,
            ),
            Metric(
                name="edge",
                unit="m",
                tolerance=0.00125,
                meaning="distance of the first loaded column from the edge",
                looser_because="one taxel",
            ),
        ),
    ),
    Scenario(
        name="sheared_tactile_pad",
        group="Sensors",
        question="Does a tactile pad feel a block that is pushed aside?",
        truth="the sum of normal forces is the weight, that of shear the push: (0.3, -0.1) of the weight",
        source="Goldstein, Classical Mechanics, 3rd ed., section 1.1 (Newton's second and third laws)",
        needs=(Capability.CONTACT_FORCES, Capability.RAY_CASTS),
        judges=(Capability.CONTACT_FORCES,),
        run=_sheared,
        metrics=(
            Metric(
                name="normal",
                unit="",
                tolerance=0.02,
                meaning="relative error of the sum of normal forces",
                looser_because="a bar for touch; the best is at rounding error",
            ),
            Metric(
                name="shear",
                unit="",
                tolerance=0.02,
                meaning="length of the error of the sum of shear, over the weight",
                looser_because="a bar for touch; the best is at rounding error",
            ),
        ),
    ),
    Scenario(
        name="impact_sound",
        group="Sensors",
        question="Is a ball that falls on a plate heard at the right time and as loud as its impulse makes it?",
        truth="after sqrt(2 h / g) + r / c; the damped sines of the plate's modes for the impulse (1 + e) m v, over r",
        source="Rossing and Fletcher, Principles of Vibration and Sound, 2nd ed., chapters 1 and 3",
        needs=(Capability.CONTACT_FORCES, Capability.RESTITUTION),
        judges=(Capability.CONTACT_FORCES, Capability.RESTITUTION),
        run=_impact,
        metrics=(
            Metric(
                name="time",
                unit="s",
                tolerance=0.0055,
                meaning="error of the time of the first sample that is heard",
                looser_because="a hit sounds from the beginning of the physics step that it falls into",
            ),
            Metric(
                name="level",
                unit="dB",
                tolerance=1.0,
                meaning="error of the level from 10 to 50 ms after the onset",
                looser_because="an ear tells a decibel; soft contacts count a part of the impulse as rest",
            ),
        ),
    ),
)
