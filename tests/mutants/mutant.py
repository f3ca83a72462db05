"""What a mutant is: the engine of the example backend, or of MuJoCo, with one thing broken."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar

import torch
from orbit_torch.engine import TorchEngine

from orbit_core.interfaces import Engine, JointParameters, SceneLayout
from orbit_core.scene import Articulation, Joint, Link, Shape

_Engine = TypeVar("_Engine", bound=Engine)


@dataclass(frozen=True)
class Mutant:
    """An engine broken in one named way."""

    name: str
    group: str
    broken: str
    """What it does wrong, in a sentence."""
    caught_by: tuple[str, ...]
    """Each must fail for it: a scenario, or ``state::test_x`` of a contract test."""
    engine: type[Engine]

    @property
    def of_example(self) -> bool:
        """Whether it is the example that is broken, and not MuJoCo."""
        return issubclass(self.engine, TorchEngine)


MUTANTS: list[Mutant] = []
"""All of them, in the order of their definition."""


def mutant(*caught_by: str) -> Callable[[type[_Engine]], type[_Engine]]:
    """Register an engine as a mutant, whose docstring says what is broken and whose module is its group."""

    def register(engine: type[_Engine]) -> type[_Engine]:
        group = engine.__module__.rpartition(".")[2]
        MUTANTS.append(Mutant(engine.__name__, group, inspect.getdoc(engine) or "", caught_by, engine))
        return engine

    return register


class Misread(TorchEngine):
    """Builds from another layout than it was given; a mutant says which."""

    misread: ClassVar[Callable[[SceneLayout], SceneLayout]]

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device) -> None:
        super().__init__(type(self).misread(layout), num_envs, device)
        self.layout = layout


def with_joints(change: Callable[[Joint], Joint]) -> Callable[[SceneLayout], SceneLayout]:
    """Every joint read otherwise, with actuator groups and homes as they were."""
    return with_articulations(lambda a: replace(a, joints=tuple(map(change, a.joints))))


def with_links(change: Callable[[Link], Link]) -> Callable[[SceneLayout], SceneLayout]:
    """Every link read otherwise."""
    return with_articulations(lambda a: replace(a, links=tuple(map(change, a.links))))


def with_shapes(change: Callable[[Shape], Shape]) -> Callable[[SceneLayout], SceneLayout]:
    """Every link's collision shape read otherwise."""
    return with_links(lambda link: replace(link, collisions=tuple(map(change, link.collisions))))


def with_parameters(**changes: Callable[[JointParameters], Any]) -> Callable[[SceneLayout], SceneLayout]:
    """Some of the joints' numbers read otherwise."""

    def read(layout: SceneLayout) -> SceneLayout:
        parameters = layout.joint_parameters
        changed = {name: change(parameters) for name, change in changes.items()}
        return replace(layout, joint_parameters=replace(parameters, **changed))

    return read


def with_actuators(**changes: None) -> Callable[[SceneLayout], SceneLayout]:
    """Some of the actuator groups' overrides left out."""

    def read(layout: SceneLayout) -> SceneLayout:
        def changed(entity: Any) -> Any:
            return replace(entity, actuators=tuple(replace(group, **changes) for group in entity.actuators))

        return SceneLayout.of(replace(layout.scene, robots=tuple(map(changed, layout.scene.robots))))

    return read


def with_articulations(change: Callable[[Articulation], Articulation]) -> Callable[[SceneLayout], SceneLayout]:
    """Every articulation read otherwise."""

    def read(layout: SceneLayout) -> SceneLayout:
        def changed(entity: Any) -> Any:
            return replace(entity, articulation=change(entity.articulation))

        scene = layout.scene
        robots, objects = tuple(map(changed, scene.robots)), tuple(map(changed, scene.objects))
        return SceneLayout.of(replace(scene, robots=robots, objects=objects))

    return read
