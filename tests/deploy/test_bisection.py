"""Bisection finds the differences that decide, and a changed scene has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_deploy.bisection import (
    KINDS,
    Bisector,
    DelayedActor,
    Difference,
    changed_scene,
    changed_world,
    delay_steps,
)
from tests.deploy.rig import scene

MANY = tuple(Difference.parse(f"{kind}=0.5") for kind in KINDS if kind != "backend")


def deciding(*kinds: str) -> tuple[set[str], int]:
    """Kinds that are found where those given make an agent fail only together, and the number of runs."""
    runs: list[Sequence[Difference]] = []

    def evaluate(chosen: tuple[Difference, ...]) -> float:
        runs.append(chosen)
        return 0.1 if {*kinds} <= {each.kind for each in chosen} else 0.9

    found = Bisector(evaluate).run(MANY, halvings=0)
    return {each.kind for each in found.deciding}, len(runs)


@pytest.mark.parametrize("kind", [each.kind for each in MANY])
def test_one_deciding_difference_is_found_by_halving(kind: str) -> None:
    found, runs = deciding(kind)
    assert found == {kind}
    assert runs <= 2 + 2 * 3


@pytest.mark.parametrize("kinds", [("contact_friction", "delay"), ("gain", "armature", "joint_damping")])
def test_differences_that_decide_together_are_found_together(kinds: tuple[str, ...]) -> None:
    assert deciding(*kinds)[0] == {*kinds}


def test_the_value_from_which_the_agent_fails_is_found() -> None:
    found = Bisector(lambda chosen: float(all(each.value > 0.4 for each in chosen))).run(
        [Difference("contact_friction", 0.2)], halvings=5
    )
    assert found.threshold == pytest.approx(0.4, abs=0.8 / 2**5)
    assert found.tried[()] == 1.0


def test_differences_that_do_not_decide_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="is 90 % without the differences and 85 % with them"):
        Bisector(lambda chosen: 0.85 if chosen else 0.9).run(MANY)
    with pytest.raises(UnknownNameError, match="friktion"):
        Difference.parse("friktion=1")
    for text in ("gain=soft", "gain=-1", "gain=nan"):
        with pytest.raises(ConfigurationError):
            Difference.parse(text)
    with pytest.raises(ConfigurationError, match=r"no multiple of the task's step of 0\.02 s"):
        delay_steps([Difference("delay", 0.03)], 0.02)


def test_a_changed_scene_has_its_differences_and_nothing_else() -> None:
    given = scene()
    texts = ("contact_friction=0.5", "robot_mass=2", "object_mass=3", "gain=0.8", "armature=0.1", "joint_friction=0.1")
    changed = changed_scene(given, [Difference.parse(text) for text in (*texts, "joint_damping=1.5")])
    (robot,), (cube,) = changed.robots, changed.objects
    own, own_cube = given.robots[0], given.objects[0]
    assert changed.terrain[0].material.dynamic_friction == 0.5 * given.terrain[0].material.dynamic_friction
    assert cube.articulation.links[0].collisions[0].material.static_friction == 0.5
    assert robot.articulation.links[1].mass == 2.0 * own.articulation.links[1].mass
    assert np.allclose(cube.articulation.links[0].inertia, 3.0 * own_cube.articulation.links[0].inertia)
    assert robot.actuators[0].stiffness == 0.8 * own.actuators[0].stiffness
    joint = robot.articulation.joints[0]
    assert (joint.armature, joint.friction, joint.damping) == (0.1, 5.0, 1.5)
    assert changed_scene(given, []) == given
    assert changed_scene(given, [Difference("delay", 0.02)]) == given
    assert replace(changed, robots=(), objects=(), terrain=()) == replace(given, robots=(), objects=(), terrain=())


class Counting:
    """Actor and environment at once, whose action is the number of its step."""

    def __init__(self) -> None:
        self.state, self.step = self, 0

    @property
    def episode_step(self) -> torch.Tensor:
        return torch.tensor([self.step, self.step % 5])

    def act(self) -> torch.Tensor:
        return torch.full((2, 1), float(self.step))


def test_a_delayed_actor_acts_late_and_holds_the_first_action_of_each_episode() -> None:
    environment = Counting()
    actor = DelayedActor(environment, environment, 2)  # pyright: ignore[reportArgumentType]
    seen = []
    for environment.step in range(8):
        seen.append(actor.act()[:, 0].tolist())
    assert [one for one, _ in seen] == [0, 0, 0, 1, 2, 3, 4, 5]
    assert [other for _, other in seen] == [0, 0, 0, 1, 2, 5, 5, 5]


def test_a_world_with_differences_is_made_on_the_backend_that_one_of_them_names() -> None:
    differences = [Difference.parse(f"backend={default_backend()}"), Difference.parse("robot_mass=2")]
    worlds = [changed_world(each, default_backend())(scene(), 2, torch.device("cpu"), 0) for each in (differences, [])]
    masses = [world.robots["arm"].nominal_masses for world in worlds]
    assert torch.allclose(masses[0], 2.0 * masses[1])
    for world in worlds:
        world.close()
    with pytest.raises(UnknownNameError, match="unknown backend 'none'"):
        changed_world([Difference.parse("backend=none")], None)(scene(), 1, torch.device("cpu"), 0)
