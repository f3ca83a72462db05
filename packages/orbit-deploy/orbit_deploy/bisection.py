"""Transfer bisector: the differences between two simulations that decide whether an agent still succeeds.

The scene is changed before an engine sees it, so that every engine can be compared with every other. The search is
delta debugging (Zeller and Hildebrandt, Simplifying and Isolating Failure-Inducing Input, 2002): halves of what differs
are tried, then their complements, until nothing can be left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import Environment
from orbit_core.envs.actors import Actor
from orbit_core.interfaces import ConfigurationError, UnknownNameError, World
from orbit_core.scene import ActuatorConfig, Articulation, Joint, Link, RobotSpec, Scene, Shape
from orbit_core.world import WorldFactory, simulate

KINDS = {
    "contact_friction": "factor of the friction of all shapes",
    "robot_mass": "factor of the robots' masses and inertias",
    "object_mass": "factor of the objects' masses and inertias",
    "gain": "factor of the drives' stiffness and damping",
    "armature": "kg m^2 (kg) added to the armature of the robots' joints",
    "joint_friction": "share of its effort limit added to each joint's friction",
    "joint_damping": "N m s/rad (N s/m) added to the damping of the robots' joints",
    "delay": "s between an action and its effect, in whole steps",
    "backend": "physics backend",
}
"""Kinds of differences, and the meaning of their value."""
# Value of each kind that changes nothing
_NEUTRAL = dict.fromkeys(KINDS, 0.0) | dict.fromkeys(("contact_friction", "robot_mass", "object_mass", "gain"), 1.0)


@dataclass(frozen=True)
class Difference:
    """One difference between the simulation where an agent succeeds and the one where it fails."""

    kind: str
    """Of :data:`KINDS`."""
    value: float = 0.0
    """Value in the unit of its kind; unused for a backend."""
    backend: str = ""
    """Name of the backend, of a difference of that kind."""

    def __str__(self) -> str:
        return f"{self.kind}={self.backend or f'{self.value:g}'}"

    @staticmethod
    def parse(text: str) -> Difference:
        """Read ``kind=value``.

        Raises:
            UnknownNameError: there is no such kind.
            ConfigurationError: the value is no number, or negative.
        """
        kind, _, value = text.partition("=")
        if kind not in KINDS:
            raise UnknownNameError("difference", kind, [*KINDS])
        if kind == "backend":
            return Difference(kind, backend=value)
        try:
            number = float(value)
        except ValueError:
            raise ConfigurationError(f"difference '{text}' needs a number: {kind}=VALUE, {KINDS[kind]}") from None
        if not 0.0 <= number < math.inf:
            raise ConfigurationError(f"the value of '{text}' must be zero or more")
        return Difference(kind, number)


@dataclass(frozen=True)
class Bisection:
    """Result of a search."""

    tried: dict[tuple[Difference, ...], float]
    """Success rate of each set of differences that was tried."""
    deciding: tuple[Difference, ...]
    """Smallest set found that makes the agent fail; each of them is needed for it."""
    threshold: float | None
    """Value from which the deciding difference makes the agent fail, if there is one and it has a number."""


class Bisector:
    """Search for the differences that decide.

    Args:
        evaluate: returns the success rate in [0, 1] under a set of differences.
        report: called with a line about each set.
    """

    def __init__(
        self,
        evaluate: Callable[[tuple[Difference, ...]], float],
        report: Callable[[str], object] = lambda text: None,
    ) -> None:
        self._evaluate, self._report = evaluate, report
        self._tried: dict[tuple[Difference, ...], float] = {}
        self._bar = 0.5

    def run(self, differences: Sequence[Difference], halvings: int = 4) -> Bisection:
        """Search.

        Args:
            differences: of the two simulations.
            halvings: of the deciding value's range, for its threshold.

        Raises:
            ConfigurationError: the agent does not succeed without, or does not fail with all of them.
        """
        every = tuple(differences)
        good, bad = self._rate(()), self._rate(every)
        # Half-way between: a rate that drops little by little has no sharper border.
        self._bar = 0.5 * (good + bad)
        # A smaller drop may be chance: 40 episodes leave a standard error of up to 8 %.
        if good - bad < 0.1:
            raise ConfigurationError(
                f"the success rate is {100.0 * good:.0f} % without the differences and {100.0 * bad:.0f} % with them: "
                "they do not decide"
            )
        deciding = self._least(every)
        threshold = None
        # A backend has no number, and a delay comes in whole steps.
        if len(deciding) == 1 and deciding[0].kind not in ("backend", "delay"):
            threshold = self._threshold(deciding[0], halvings)
        return Bisection(self._tried, deciding, threshold)

    # The names are those of the algorithm's paper: parts, chunks and their complements.
    def _least(self, failing: tuple[Difference, ...]) -> tuple[Difference, ...]:
        """Return a subset of differences that still fails, and does not without any one of them."""
        parts = 2
        while len(failing) > 1:
            size = math.ceil(len(failing) / parts)
            chunks = [failing[begin : begin + size] for begin in range(0, len(failing), size)]
            rests = [tuple(each for each in failing if each not in chunk) for chunk in chunks]
            # A chunk that fails by itself rules out all others at once, so chunks come before complements.
            smaller = next((chunk for chunk in chunks if self._fails(chunk)), None)
            if smaller is not None:
                failing, parts = smaller, 2
                continue
            # Of two halves the complements are the halves themselves.
            rest = next((rest for rest in rests if rest and self._fails(rest)), None) if parts > 2 else None
            if rest is not None:
                failing, parts = rest, max(parts - 1, 2)
            elif size == 1:
                break
            else:
                parts = min(2 * parts, len(failing))
        return failing

    def _threshold(self, difference: Difference, halvings: int) -> float:
        # Rates need not fall evenly in between: this finds one border, the one next to the failing value.
        working, failing = _NEUTRAL[difference.kind], difference.value
        for _ in range(halvings):
            middle = 0.5 * (working + failing)
            if self._fails((replace(difference, value=middle),)):
                failing = middle
            else:
                working = middle
        return failing

    def _fails(self, differences: tuple[Difference, ...]) -> bool:
        return self._rate(differences) <= self._bar

    def _rate(self, differences: tuple[Difference, ...]) -> float:
        # Each set costs minutes of simulation, and complements come up again.
        if differences not in self._tried:
            rate = self._tried[differences] = self._evaluate(differences)
            self._report(f"{', '.join(map(str, differences)) or 'no difference'}: {100.0 * rate:.1f} %")
        return self._tried[differences]


def changed_world(differences: Sequence[Difference], backend: str | None) -> WorldFactory:
    """Return the factory of a world with differences, for ``orbit_core.envs.make(..., world=...)``.

    Args:
        differences: of any kind; a delay concerns the actor (:class:`DelayedActor`).
        backend: where none of the differences names one; the default one if None.
    """
    name = next((each.backend for each in differences if each.kind == "backend"), backend) or default_backend()

    def factory(scene: Scene, num_envs: int, device: torch.device, seed: int) -> World:
        return simulate(changed_scene(scene, differences), num_envs, name, device=device, seed=seed)

    return factory


def changed_scene(scene: Scene, differences: Sequence[Difference]) -> Scene:
    """Return a scene with differences applied."""
    for each in differences:
        value = each.value
        match each.kind:
            case "contact_friction":
                terrain = tuple(_slippery(shape, value) for shape in scene.terrain)
                scene = _with_links(replace(scene, terrain=terrain), lambda link, value=value: _smooth(link, value))
            case "robot_mass":
                scene = replace(scene, robots=tuple(_heavier(robot, value) for robot in scene.robots))
            case "object_mass":
                scene = replace(scene, objects=tuple(_heavier(thing, value) for thing in scene.objects))
            case "gain":
                scene = replace(scene, robots=tuple(_geared(robot, value) for robot in scene.robots))
            case "armature" | "joint_friction" | "joint_damping":
                robots = tuple(_with_joints(robot, each.kind, value) for robot in scene.robots)
                scene = replace(scene, robots=robots)
            case _:
                # A backend and a delay change no scene: the world's factory and the actor take them.
                pass
    return scene


class DelayedActor:
    """Actor whose actions take effect some steps later; the first action of an episode is held until then.

    Args:
        actor: that acts.
        environment: that it acts in.
        steps: of delay.
    """

    def __init__(self, actor: Actor, environment: Environment, steps: int) -> None:
        self._actor, self._environment, self._steps = actor, environment, steps
        self._past: list[Tensor] = []

    def act(self) -> Tensor:
        """Return the action (N, A) of some steps ago."""
        action = self._actor.act().clone()
        # Each environment begins its episodes at its own time.
        begun = (self._environment.state.episode_step == 0)[:, None]
        self._past = [torch.where(begun, action, past) for past in self._past] or [action] * self._steps
        self._past.append(action)
        return self._past.pop(0)


def delay_steps(differences: Sequence[Difference], step_dt: float) -> int:
    """Return the delay of actions in steps.

    Raises:
        ConfigurationError: it is no multiple of a step.
    """
    delay = sum(each.value for each in differences if each.kind == "delay")
    steps = round(delay / step_dt)
    if abs(steps * step_dt - delay) > 1e-6:
        raise ConfigurationError(f"a delay of {delay:g} s is no multiple of the task's step of {step_dt:g} s")
    return steps


def _with_links(scene: Scene, change: Callable[[Link], Link]) -> Scene:
    def entity(each: Any) -> Any:
        changed = replace(each, articulation=_links(each.articulation, change))
        if variants := getattr(each, "variants", ()):
            changed = replace(changed, variants=tuple(_links(variant, change) for variant in variants))
        return changed

    return replace(
        scene,
        robots=tuple(entity(each) for each in scene.robots),
        objects=tuple(entity(each) for each in scene.objects),
    )


def _links(articulation: Articulation, change: Callable[[Link], Link]) -> Articulation:
    return replace(articulation, links=tuple(change(link) for link in articulation.links))


def _smooth(link: Link, factor: float) -> Link:
    return replace(link, collisions=tuple(_slippery(shape, factor) for shape in link.collisions))


def _slippery(shape: Shape, factor: float) -> Shape:
    material = shape.material
    # All coefficients: a sphere that rolls freely on ice would be another difference.
    friction = {
        name: getattr(material, name) * factor
        for name in ("static_friction", "dynamic_friction", "torsional_friction", "rolling_friction")
    }
    return replace(shape, material=replace(material, **friction))


def _heavier(entity: Any, factor: float) -> Any:
    def change(link: Link) -> Link:
        # Inertia grows with the mass, as of a denser material.
        return replace(link, mass=link.mass * factor, inertia=link.inertia * factor)

    changed = replace(entity, articulation=_links(entity.articulation, change))
    if variants := getattr(entity, "variants", ()):
        changed = replace(changed, variants=tuple(_links(variant, change) for variant in variants))
    return changed


def _geared(robot: RobotSpec, factor: float) -> RobotSpec:
    def change(group: ActuatorConfig) -> ActuatorConfig:
        return replace(group, stiffness=group.stiffness * factor, damping=group.damping * factor)

    return replace(robot, actuators=tuple(change(group) for group in robot.actuators))


def _with_joints(robot: RobotSpec, kind: str, value: float) -> RobotSpec:
    def change(joint: Joint) -> Joint:
        if not joint.movable or joint.mimic is not None:
            return joint
        if kind == "joint_friction":
            # Joints without a limit have no scale that a share could be taken of.
            limit = joint.effort_limit if math.isfinite(joint.effort_limit) else 0.0
            return replace(joint, friction=joint.friction + value * limit)
        field = "armature" if kind == "armature" else "damping"
        return replace(joint, **{field: getattr(joint, field) + value})

    joints = tuple(change(joint) for joint in robot.articulation.joints)
    return replace(robot, articulation=replace(robot.articulation, joints=joints))
