"""What a task takes for granted when an episode begins: checked in the engine at hand, and told by name."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
import torch
from torch import Tensor

from orbit_conformance.tasks import run_task
from orbit_core.backends import backend as find_backend
from orbit_core.cli.run import _table, run
from orbit_core.cli.settings import RunSettings
from orbit_core.envs import Environment, EventTerm, PremiseTerm
from orbit_core.interfaces import Capability, ConfigurationError, Level, PremiseError, World
from orbit_tasks.hockey import Hockey, HockeyEvents, HockeyPremises, place_puck

ENGINES = ("mujoco", "sapien")


def fallen(world: World, task: Hockey) -> Tensor:
    """(N,) bool: the puck lies on the ice."""
    return world.objects["puck"].root_pose[:, 2] < 0.021


def place_puck_high(odds: float) -> Callable[[World, Hockey, Tensor], None]:
    """A puck that floats ten centimetres above the ice in a share of all starts."""

    def place(world: World, task: Hockey, env_ids: Tensor) -> None:
        place_puck(world, task, env_ids)
        pose = world.objects["puck"].root_pose[env_ids].clone()
        pose[:, 2] += 0.1 * (world.random.uniform((), env_ids=env_ids) < odds)
        world.objects["puck"].set_root_pose(pose, env_ids)

    return place


@dataclass
class OnIce(HockeyPremises):
    still: PremiseTerm | None = None
    fallen: PremiseTerm | None = PremiseTerm(fallen, "the puck floats above the ice")


@dataclass(kw_only=True)
class HighHockey(Hockey):
    odds: float = 0.5
    premise_time: float = 0.1
    episode_length: float = 0.2
    premises: OnIce = field(default_factory=OnIce)  # pyright: ignore[reportIncompatibleVariableOverride]

    def __post_init__(self) -> None:
        self.events = HockeyEvents(place_puck=EventTerm(place_puck_high(self.odds)))


def lenient(task: Hockey, num_envs: int, backend: str = "mujoco", **settings: int) -> Environment:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return Environment(task, num_envs, backend, **settings)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("backend", ENGINES)
def test_a_premise_that_never_holds_is_an_error_by_name(backend: str) -> None:
    with pytest.raises(
        PremiseError, match=f"'{backend}', premise 'fallen' of task HighHockey holds in none of 9 "
    ) as e:
        Environment(HighHockey(odds=1.1), 3, backend)
    assert "the puck floats above the ice" in str(e.value)
    assert "premises.fallen=None" in str(e.value)


def test_a_premise_that_fails_in_some_starts_warns_and_each_episode_names_it() -> None:
    with pytest.warns(
        RuntimeWarning, match=r"premise 'fallen' of task HighHockey fails in \d+ of 16 starts: the puck fl"
    ):
        environment = Environment(HighHockey(), 16, "mujoco")
    outside, fell = environment.premises.checks
    assert (outside.name, outside.failed, outside.starts) == ("outside", 0, 16)
    assert (fell.name, fell.starts) == ("fallen", 16)
    assert 0 < fell.failed < 16
    on_ice = fallen(environment.world, environment.task)  # pyright: ignore[reportArgumentType]
    assert on_ice.any()
    assert not on_ice.all()
    began = on_ice.float().clone()
    info = {}
    for _ in range(environment.max_episode_steps):
        *_, info = environment.step(torch.zeros(16, environment.action_size))
    assert torch.equal(info["final"].metrics["premise_fallen"], began)
    assert torch.equal(info["final"].metrics["premise_outside"], torch.ones(16))
    # The next episodes have starts of their own.
    now = fallen(environment.world, environment.task)  # pyright: ignore[reportArgumentType]
    assert torch.equal(environment.metrics()["premise_fallen"], now.float())
    assert not torch.equal(now.float(), began)
    environment.close()


@pytest.mark.parametrize("backend", ["mujoco", "bullet", "sapien"])
def test_time_passes_in_environments_that_begin_and_in_no_other(backend: str) -> None:
    environment = lenient(HighHockey(settle_time=0.5, odds=1.1, episode_length=1.0), 3, backend)
    world = environment.world
    assert fallen(world, environment.task).all()  # pyright: ignore[reportArgumentType]
    assert environment.premises.checks[1].failed == 0
    for _ in range(4):
        environment.step(torch.full((3, environment.action_size), 0.2))
    engine, steps = world.engine, world.clock.steps
    others = torch.tensor([0, 2])
    before = [getattr(engine, name)[others].clone() for name in ("joint_positions", "joint_velocities", "link_poses")]
    environment.reset(env_ids=torch.tensor([1]))
    after = [getattr(engine, name)[others] for name in ("joint_positions", "joint_velocities", "link_poses")]
    assert all(torch.equal(new, old) for new, old in zip(after, before, strict=True))
    assert world.clock.steps == steps
    # The arm stayed where its reset put it, but for what its drive gives way.
    robot = world.robots["robot"]
    torch.testing.assert_close(
        robot.joint_positions[1], engine.position_targets[1, : len(robot.joint_names)], atol=0.02, rtol=0.0
    )
    assert float(world.objects["puck"].root_velocity[1].norm()) < 0.05
    environment.close()


@pytest.mark.parametrize("backend", ENGINES)
def test_settled_environments_do_the_same_whatever_their_number(backend: str) -> None:
    exact = find_backend(backend).capabilities()[Capability.SNAPSHOTS].level is Level.EXACT
    few, many = (lenient(HighHockey(settle_time=0.1), count, backend, seed=4) for count in (1, 3))
    few.reset(seed=4), many.reset(seed=4)
    generator = torch.Generator().manual_seed(0)
    for step in range(22):
        if step == 5:
            many.reset(env_ids=torch.tensor([2]))
        action = 2.0 * torch.rand(3, many.action_size, generator=generator) - 1.0
        one, three = few.step(action[:1])[0]["policy"], many.step(action)[0]["policy"]
        torch.testing.assert_close(one, three[:1], rtol=0.0, atol=0.0 if exact else 1e-4)
    few.close(), many.close()


def test_the_starts_that_are_sampled_change_nothing_after_them() -> None:
    sampled, plain = (Hockey(episode_length=0.2) for _ in range(2))
    plain.premises = None  # pyright: ignore[reportAttributeAccessIssue]
    one, other = (Environment(task, 2, "mujoco", seed=1) for task in (sampled, plain))
    assert one.premises.checks
    assert not other.premises.checks
    for _ in range(15):
        action = torch.full((2, one.action_size), 0.3)
        torch.testing.assert_close(one.step(action)[0], other.step(action)[0], rtol=0, atol=0)
    one.close(), other.close()


def test_a_run_and_the_conformance_suite_say_how_often_a_premise_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = RunSettings(task="Hockey", backend="mujoco", num_envs=8, episodes=8, agent="zero")
    monkeypatch.setattr("orbit_tasks.hockey.HockeyPremises", OnIce)
    monkeypatch.setattr("orbit_core.cli.run.make_environment", lambda *_: lenient(HighHockey(), 8))
    result = run(settings)
    failed = result.premises[1].failed
    assert 0 < failed < 8
    assert result.as_json()["premises"][1]["failed"] == failed
    cells = [str(cell) for column in _table(result).columns for cell in column.cells]
    assert "premise 'fallen'" in cells
    assert f"fails in {failed} of 8 sampled starts: the puck floats above the ice" in cells
    monkeypatch.setattr("orbit_conformance.episodes.make", lambda *_, **__: lenient(HighHockey(), 8))
    assert run_task("Hockey", "mujoco", num_envs=8).premises[1].failed == failed


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"settle_time": -1.0}, "settle_time must be zero seconds or more, not -1"),
        ({"premise_time": float("nan")}, "premise_time must be zero seconds or more, not nan"),
        ({"premises": OnIce(fallen=PremiseTerm(lambda world, task: task.nearest, "it is far"))}, "gives torch.float32"),
    ],
)
def test_premises_that_cannot_be_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        Environment(HighHockey(**changes), 2, "mujoco")  # pyright: ignore[reportArgumentType]
