"""Objects' own force laws: their closed form, parameters per environment, memory, snapshots, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from orbit_conformance.bodies import WEIGHTLESS, cube, scene
from orbit_conformance.scenarios.seals import _drawer
from orbit_core.active import ActiveLaw, active_laws
from orbit_core.capture.replay import CapturedFunction
from orbit_core.dynamics.indexing import RowSelector
from orbit_core.interfaces import ArgumentError, ConfigurationError, Object, OrbitError, UnknownNameError, World
from orbit_core.mdp import randomize
from orbit_core.scene import ActiveModel, MagneticSeal, ObjectSpec
from orbit_core.world import simulate

ENGINES = ("mujoco", "bullet", "sapien")
FORCE, DECAY = 30.0, 0.01


@dataclass(frozen=True, kw_only=True)
class Rocket(ActiveModel):
    """Pushes its object upward until its fuel is burnt."""

    thrust: float = 4.0
    fuel: float = 8.0
    """Physics steps."""


class RocketLaw(ActiveLaw):
    def __init__(
        self, model: Rocket, thing: Object, num_envs: int, device: torch.device, selector: RowSelector
    ) -> None:
        super().__init__(model, thing, num_envs, device, selector)
        self.links = (0,)
        self.thrust, self.fuel = self.parameter("thrust", model.thrust), self.parameter("fuel", model.fuel)
        self.memory["burnt"] = torch.zeros(num_envs, device=device)

    def wrenches(self) -> Tensor:
        burns = (self.memory["burnt"] < self.fuel).float()
        self.memory["burnt"] += burns
        wrench = torch.zeros(self.num_envs, 1, 6, device=self.device)
        wrench[:, 0, 2] = self.thrust * burns
        return wrench


@pytest.fixture(autouse=True, scope="module")
def rocket() -> None:
    if Rocket.__name__ not in active_laws().names:
        active_laws().add(Rocket.__name__, RocketLaw)


def rockets(backend: str, num_envs: int = 3) -> World:
    thing = replace(cube(name="rocket", mass=2.0), active=(Rocket(name="engine"),))
    return simulate(scene(thing, gravity=WEIGHTLESS, terrain=()), num_envs, backend)


def drawers(backend: str, num_envs: int = 3) -> World:
    return simulate(scene(_drawer("drawer"), gravity=WEIGHTLESS, terrain=()), num_envs, backend)


@pytest.mark.parametrize("backend", ENGINES)
def test_a_seal_pulls_by_its_law_with_parameters_of_each_environment(backend: str) -> None:
    world = drawers(backend)
    drawer = world.objects["drawer"]
    seal = drawer.active["seal"]
    seal.set_parameter("force", torch.tensor([10.0, 60.0]), torch.tensor([1, 2]))
    seal.set_parameter("decay", torch.tensor([0.02]), torch.tensor([2]))
    assert seal.parameters["force"].tolist() == [30.0, 10.0, 60.0]
    gap = torch.tensor([[0.0], [0.01], [0.04]])
    world.reset()
    drawer.set_joint_state(gap)
    world.step(1)
    # The effort is that of the state before the step: F / (1 + g / d)^2 towards shut.
    torch.testing.assert_close(drawer.joint_efforts[:, 0], -torch.tensor([30.0, 10.0 / 4.0, 60.0 / 9.0]))
    world.close()


@pytest.mark.parametrize("backend", ENGINES)
def test_a_law_adds_to_the_wrenches_that_are_set_and_remembers_by_environment(backend: str) -> None:
    world = rockets(backend)
    thing, dt = world.objects["rocket"], world.physics_dt
    thing.active["engine"].set_parameter("fuel", torch.tensor([2.0]), torch.tensor([1]))
    world.step(5)
    pushed = torch.tensor([5.0, 2.0, 5.0]) * 2.0 * dt
    torch.testing.assert_close(thing.root_velocity[:, 2], pushed, rtol=1e-4, atol=1e-6)
    world.reset(torch.tensor([0]))
    wrench = torch.zeros(3, 1, 6)
    wrench[:, 0, 0] = 6.0
    thing.set_wrenches(wrench)
    before = thing.root_velocity.clone()
    world.step(4)
    gained = (thing.root_velocity - before) / dt
    torch.testing.assert_close(gained[:, 0], torch.full((3,), 12.0), rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(gained[:, 2], 2.0 * torch.tensor([4.0, 0.0, 3.0]), rtol=1e-3, atol=1e-3)
    world.close()


@pytest.mark.parametrize("backend", ENGINES)
def test_snapshots_copies_and_settling_keep_what_a_law_remembers(backend: str) -> None:
    world = rockets(backend)
    thing = world.objects["rocket"]
    memory = world.active.laws["active model 'engine' of 'rocket'"].memory["burnt"]
    world.step(3)
    state = world.save_state()
    world.step(7)
    after = thing.root_velocity.clone()
    world.load_state(state)
    assert memory.tolist() == [3.0] * 3
    world.step(7)
    torch.testing.assert_close(thing.root_velocity, after, rtol=1e-6, atol=1e-7)
    world.reset(torch.tensor([1]))
    assert memory.tolist() == [8.0, 0.0, 8.0]
    world.settle(4, torch.tensor([1]))  # time that counts nowhere
    assert memory.tolist() == [8.0, 0.0, 8.0]
    world.copy_state(0, torch.tensor([1]))
    assert memory.tolist() == [8.0] * 3
    world.close()


def test_a_law_is_part_of_a_captured_step() -> None:
    plain, other = rockets("mujoco"), rockets("mujoco")

    def step() -> tuple[Tensor, ...]:
        other.step(2)
        return (other.objects["rocket"].root_velocity.clone(),)

    captured = CapturedFunction(other, step, compile=False)
    for _ in range(6):
        plain.step(2)
        torch.testing.assert_close(captured()[0], plain.objects["rocket"].root_velocity, rtol=0, atol=0)
    assert captured.replay is not None
    plain.close(), other.close()


@dataclass(frozen=True, kw_only=True)
class Unheard(ActiveModel):
    """Nothing computes it."""


def _changed(**changes: object) -> ObjectSpec:
    seal = replace(_drawer("drawer").active[0], **changes)  # pyright: ignore[reportArgumentType]
    return replace(_drawer("drawer"), active=(seal,))


SEAL = MagneticSeal(name="seal", joint="rail", force=FORCE, decay=DECAY)


@pytest.mark.parametrize(
    ("thing", "error", "message"),
    [
        (_changed(joint="rial"), UnknownNameError, "unknown joint 'rial' in 'drawer': did you mean 'rail'"),
        (_changed(force=0.0), ConfigurationError, "force of active model 'seal' of 'drawer' must be above zero, not 0"),
        (_changed(decay=float("inf")), ConfigurationError, "decay of active model 'seal'"),
        (_changed(closed=float("inf")), ConfigurationError, "say where it is shut"),
        (_changed(force="strong"), ArgumentError, "force"),
        (replace(_drawer("drawer"), active=(SEAL, SEAL)), ConfigurationError, "share a name: give each its own"),
        (replace(_drawer("drawer"), active=(Unheard(name="u"),)), UnknownNameError, "unknown active model 'Unheard'"),
    ],
)
def test_a_model_that_cannot_be_is_refused_by_name(thing: ObjectSpec, error: type[OrbitError], message: str) -> None:
    with pytest.raises(error, match=message):
        simulate(scene(thing, terrain=()), 1, "mujoco")


def test_parameters_that_cannot_be_are_refused() -> None:
    world = drawers("mujoco", 2)
    drawer = world.objects["drawer"]
    with pytest.raises(
        UnknownNameError, match="unknown parameter 'froce' in active model 'seal': did you mean 'force'"
    ):
        drawer.active["seal"].set_parameter("froce", torch.ones(2))
    with pytest.raises(ArgumentError, match="force of active model 'seal' of 'drawer'"):
        drawer.active["seal"].set_parameter("force", torch.tensor([1.0, -1.0]))
    with pytest.raises(UnknownNameError, match="unknown active model 'steal'"):
        drawer.active["steal"]
    world.close()


def handle(world: World) -> Any:
    """What an event asks of an environment."""
    return SimpleNamespace(world=world, state=SimpleNamespace(difficulty=torch.ones(4)))


def test_parameters_are_randomised_between_environments() -> None:
    world = drawers("mujoco", 4)
    event = randomize.active_model("drawer", "seal", "force", randomize.Range(0.5, 1.5))
    event(handle(world), torch.arange(4))
    forces = world.objects["drawer"].active["seal"].parameters["force"]
    assert len(set(forces.tolist())) == 4
    assert 0.5 * FORCE <= float(forces.min()) <= float(forces.max()) < 1.5 * FORCE
    with pytest.raises(UnknownNameError, match="unknown parameter 'strength' in active model 'seal' of 'drawer'"):
        randomize.active_model("drawer", "seal", "strength", randomize.Range(1.0, 1.0))(handle(world), torch.arange(4))
    world.close()
