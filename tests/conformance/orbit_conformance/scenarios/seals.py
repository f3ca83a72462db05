"""Active models of objects: a magnetic seal holds, lets go and pulls shut as its law says."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch

from orbit_conformance.bodies import WEIGHTLESS, body, scene
from orbit_conformance.scenario import FIRST_ORDER, Metric, Scenario, Trial
from orbit_core.interfaces import Capability, World
from orbit_core.scene import Articulation, Joint, JointType, MagneticSeal, ObjectSpec, Pose

_MASS, _FORCE, _DECAY = 2.0, 30.0, 0.01
# Metres from the hinge to the seal; kg m^2 about the hinge.
_ARM, _INERTIA = 0.5, 0.1
# Share of the seal's force by which a pull is weaker, or stronger, than what pulls it off.
_MARGIN = 0.02
# Metres of gap from which it is let go, to be pulled shut.
_AJAR = 0.05


# Metres of gap up to which speeds are compared: there the motion is still free.
_FARTHEST = 0.35


@dataclass(frozen=True)
class _Part:
    """Body that a seal holds shut: inertia and arm as the seal sees them, and its closed position."""

    name: str
    mass: float
    """kg: of a door, its inertia over the arm's square."""
    arm: float
    shut: float
    way: float
    """1 where the joint's position grows as it opens, else -1."""


_PARTS = (_Part("drawer", _MASS, 1.0, 0.0, 1.0), _Part("door", _INERTIA / _ARM**2, _ARM, 0.3, -1.0))


def _drawer(name: str) -> ObjectSpec:
    """A carriage on a rail along x, shut at zero."""
    seal = MagneticSeal(name="seal", joint="rail", force=_FORCE, decay=_DECAY)
    rail = Joint("rail", JointType.PRISMATIC, "case", "drawer", axis=(1.0, 0.0, 0.0), lower_limit=0.0, upper_limit=1.0)
    articulation = Articulation(name, (body("case"), body("drawer", _MASS)), (rail,))
    return ObjectSpec(name=name, articulation=articulation, fixed_base=True, active=(seal,))


def _door(name: str) -> ObjectSpec:
    """A leaf on a hinge about z at x = 0, its centre of mass on the hinge; it opens to negative angles, shut at 0.3."""
    seal = MagneticSeal(name="seal", joint="hinge", force=_FORCE, decay=_DECAY, arm=_ARM, opens_up=False)
    hinge = Joint("hinge", JointType.REVOLUTE, "frame", "leaf", lower_limit=-1.5, upper_limit=0.3)
    articulation = Articulation(name, (body("frame"), body("leaf", inertia=_INERTIA)), (hinge,))
    home = {"hinge": 0.3}
    return ObjectSpec(
        name=name, articulation=articulation, fixed_base=True, active=(seal,), home=home, pose=Pose((0.0, 2.0, 0.0))
    )


def _work(gap: float) -> float:
    """J that the seal takes up from no gap to this one, the integral of its force."""
    return _FORCE * _DECAY * gap / (gap + _DECAY)


def _seals(trial: Trial) -> Mapping[str, float]:
    world = trial.world(scene(_drawer("drawer"), _door("door"), gravity=WEIGHTLESS, terrain=()), num_envs=3)
    return {**_pulled(trial, world), **_pulled_shut(trial, world)}


def _pulled(trial: Trial, world: World) -> dict[str, float]:
    """Two environments whose pulls are a little weaker and stronger than the seals; the third's seals are half as
    strong. How far the first opens, and how fast the others are at each gap, against the work done on them."""
    drawer, door = world.objects["drawer"], world.objects["door"]
    strength = torch.tensor([1.0, 1.0, 0.5], device=world.device)
    for thing in (drawer, door):
        # The third environment shows that a parameter set for one environment acts there only.
        thing.active["seal"].set_parameter("force", _FORCE * strength)
    # On both sides of the force that holds, so that the limit itself is tested.
    pull = _FORCE * torch.tensor([1.0 - _MARGIN, 1.0 + _MARGIN, 1.0], device=world.device)
    wrench = torch.zeros(3, 1, 6, device=world.device)
    wrench[:, 0, 0] = pull
    drawer.set_wrenches(wrench, [1])
    wrench = torch.zeros(3, 1, 6, device=world.device)
    wrench[:, 0, 5] = -_ARM * pull
    door.set_wrenches(wrench, [1])
    crept, slow, curve = 0.0, 0.0, []
    for time, part, before, after in _gaps(trial, world, 0.5):
        crept = max(crept, after[0])
        for row in (1, 2):
            gap, speed = 0.5 * (before[row] + after[row]), (after[row] - before[row]) / trial.time_step
            # Nearer, the speed is little and the start of the motion, which is a step's, is most of it.
            if _DECAY < gap < _FARTHEST:
                work = float(pull[row]) * gap - float(strength[row]) * _work(gap)
                # Work done on the part is its kinetic energy, at any time step.
                truth = math.sqrt(2.0 * work / part.mass)
                slow = max(slow, abs(speed / truth - 1.0))
                if part is _PARTS[0] and row == 1:
                    curve.append((time, speed, truth))
    trial.trace("speed of a drawer that is pulled off its seal", "m/s", *zip(*curve, strict=True))
    return {"hold": crept, "released": slow}


def _pulled_shut(trial: Trial, world: World) -> dict[str, float]:
    """Let go where it is ajar: the speed at each gap, against what the seal has done."""
    world.reset()
    for part in _PARTS:
        thing = world.objects[part.name]
        thing.active["seal"].set_parameter("force", torch.full((3,), _FORCE, device=world.device))
        ajar = part.shut + part.way * _AJAR / part.arm
        thing.set_joint_state(torch.full((3, 1), ajar, device=world.device))
    off, shut = 0.0, set()
    for _, part, before, after in _gaps(trial, world, 1.0):
        gap = 0.5 * (before[0] + after[0])
        if gap < 0.2 * _DECAY:
            shut.add(part.name)
        elif part.name not in shut and gap < 0.8 * _AJAR:
            truth = math.sqrt(2.0 * (_work(_AJAR) - _work(gap)) / part.mass)
            off = max(off, abs((before[0] - after[0]) / trial.time_step / truth - 1.0))
    return {"shut": off if len(shut) == len(_PARTS) else math.inf}


def _gaps(trial: Trial, world: World, seconds: float) -> Iterator[tuple[float, _Part, list[float], list[float]]]:
    """Time, and each part with its gaps (m) in all environments before and after the last step."""
    last: dict[str, list[float]] = {}
    for time in trial.advance(world, seconds):
        for part in _PARTS:
            positions = world.objects[part.name].joint_positions[:, 0]
            now = (part.way * part.arm * (positions - part.shut)).tolist()
            if part.name in last:
                yield time, part, last[part.name], now
            last[part.name] = now


SCENARIOS = (
    Scenario(
        name="magnetic_seal",
        group="Joints",
        question="Does an object's own force law act in each step: does a magnet hold, let go and pull shut?",
        truth="holds below F0; m v^2 / 2 = P g - F0 d g / (g + d)",
        source="Fitzgerald, Kingsley and Umans, Electric Machinery, 6th ed., sections 1.1 and 3.5",
        needs=(Capability.ARTICULATIONS, Capability.EXTERNAL_WRENCHES),
        run=_seals,
        metrics=(
            Metric(
                name="hold",
                unit="m",
                tolerance=1e-4,
                meaning=f"how far it opens in half a second, pulled by {100 * _MARGIN:g} % less than holds it",
                looser_because="a tenth of a millimetre is a seal that is shut",
            ),
            Metric(
                name="released",
                unit="",
                tolerance=0.02,
                meaning=f"speed at each gap, pulled by {100 * _MARGIN:g} % more and by twice the seal's, relative",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="shut",
                unit="",
                tolerance=0.025,
                meaning="speed at each gap as it is pulled shut from being ajar, relative",
                looser_because=FIRST_ORDER,
            ),
        ),
    ),
)
