"""What an environment makes of bad actions, seeds and choices, and what it says when it is closed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from orbit_core.backends import backend, backend_config, default_backend
from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ArgumentError, ClosedError, ConfigurationError, NonFiniteError, OrbitError, ShapeError
from orbit_learn.gymnasium import SingleEnvironment, VectorEnvironment

BACKEND = default_backend()
N = 3


@pytest.fixture(scope="module")
def reach() -> Iterator[Environment]:
    environment = make("Reach", N, BACKEND)
    yield environment
    environment.close()


@pytest.fixture(scope="module")
def vector() -> Iterator[VectorEnvironment]:
    environment = VectorEnvironment("Reach", N, backend=BACKEND)
    yield environment
    environment.close()


KINDS: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
    "float64": torch.Tensor.double,
    "half": torch.Tensor.half,
    "with gradient": lambda action: action.clone().requires_grad_(),
    "not contiguous": lambda action: action.t().contiguous().t(),
}


@pytest.mark.parametrize("kind", KINDS)
def test_other_kinds_of_actions_do_the_same(reach: Environment, kind: str) -> None:
    action = torch.full((N, reach.action_size), 0.25)  # which all of them hold exactly
    reach.reset(seed=1)
    expected = reach.step(action)[0]["policy"].clone()
    reach.reset(seed=1)
    observation = reach.step(KINDS[kind](action))[0]["policy"]
    assert torch.equal(observation, expected)
    assert not observation.requires_grad


def test_actions_that_cannot_be_are_refused_with_the_remedy(reach: Environment) -> None:
    action = torch.zeros(N, reach.action_size)
    with pytest.raises(ArgumentError, match=r"sparse tensor: give action\.to_dense\(\)"):
        reach.step(action.to_sparse())
    with pytest.raises(ArgumentError, match=r"must be a torch tensor on cpu.*use torch\.as_tensor"):
        reach.step(action.numpy())  # pyright: ignore[reportArgumentType]
    with pytest.raises(ArgumentError, match=r"on meta, and the world on cpu"):
        reach.step(action.to("meta"))
    far = action.double()
    far[2, 1] = 1e300  # which single precision does not hold
    with pytest.raises(NonFiniteError, match="action component 1 of environment 2 is inf"):
        reach.step(far)


@pytest.mark.parametrize(
    ("seed", "env_ids"),
    [(-1, None), (2**63, None), (1.5, None), (1, torch.tensor([N])), (1, torch.tensor([0, 0])), (None, [1])],
)
def test_a_refused_reset_changes_nothing(reach: Environment, seed: Any, env_ids: Any) -> None:
    action = torch.zeros(N, reach.action_size)
    reach.reset(seed=3), reach.step(action)
    expected = [reach.step(action)[0]["policy"].clone(), reach.reset()[0]["policy"].clone()]
    reach.reset(seed=3), reach.step(action)
    with pytest.raises(OrbitError):
        reach.reset(seed=seed, env_ids=env_ids)
    for one, other in zip(expected, [reach.step(action)[0]["policy"], reach.reset()[0]["policy"]], strict=True):
        assert torch.equal(one, other)


def test_an_environment_lives_on_after_a_reset_failed(reach: Environment, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(state: object, env_ids: torch.Tensor | None) -> None:
        raise KeyError("the task's own mistake")

    expected = reach.reset(seed=4)[0]["policy"].clone()
    monkeypatch.setattr(type(reach.state), "reset", failing)
    with pytest.raises(KeyError):
        reach.reset(seed=0, env_ids=torch.tensor([1]))
    monkeypatch.undo()
    assert torch.equal(reach.reset(seed=4)[0]["policy"], expected)
    reach.step(torch.zeros(N, reach.action_size))


def test_reset_takes_gymnasiums_mask_and_no_other_option(vector: VectorEnvironment) -> None:
    vector.reset(seed=0)
    for _ in range(2):
        vector.step(torch.zeros(N, vector.environment.action_size))
    vector.reset(options={"reset_mask": np.array([True, False, True])})
    assert vector.environment.state.episode_step.tolist() == [0, 2, 0]
    with pytest.raises(ConfigurationError, match="reset has no option 'speed', but 'reset_mask'"):
        vector.reset(options={"speed": 1})
    with pytest.raises(ShapeError, match=r"a mask \(3,\)"):
        vector.reset(options={"reset_mask": np.array([True])})
    with pytest.raises(ArgumentError, match="action must be a tensor or an array of numbers"):
        vector.step("left")  # pyright: ignore[reportArgumentType]


def test_what_is_closed_says_so() -> None:
    environment = make("Reach", 1, BACKEND)
    action = torch.zeros(1, environment.action_size)
    environment.close(), environment.close()
    uses: list[Callable[[], object]] = [
        lambda: environment.step(action),
        lambda: environment.reset(),
        lambda: environment.observe(),
        lambda: environment.expert(),
    ]
    for use in uses:
        with pytest.raises(ClosedError, match="the environment is closed: make another"):
            use()
    with pytest.raises(ClosedError, match="the world is closed"):
        environment.world.step()


@pytest.mark.parametrize("kind", [SingleEnvironment, VectorEnvironment])
def test_closed_gymnasium_environments_say_so(kind: type[gymnasium.Env]) -> None:
    environment = kind("Reach", backend=BACKEND)
    environment.close(), environment.close()
    assert environment.unwrapped is environment
    uses: list[Callable[[], object]] = [
        lambda: environment.reset(),
        lambda: environment.render(),
        lambda: environment.step(np.zeros(3)),
    ]
    for use in uses:
        with pytest.raises(ClosedError, match="the environment is closed"):
            use()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"tolerance": float("nan")}, "tolerance.* is nan: give a finite number"),
        ({"physics_dt": float("inf")}, "physics_dt.* is inf"),
        ({"decimation": 10**30}, "decimation.* give at most 2147483647"),
    ],
)
def test_fields_of_tasks_are_finite(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make("Lift", 1, BACKEND, **fields)


@pytest.mark.parametrize("value", [float("nan"), 2**40, "many", None, [1]])
def test_settings_of_backends_are_of_their_defaults_kind(value: Any) -> None:
    plugin = backend(BACKEND)
    name = next(f.name for f in plugin.config_type.__dataclass_fields__.values() if type(f.default) is int)
    with pytest.raises(ConfigurationError, match=f"setting '{name}' of backend '{BACKEND}' is"):
        backend_config(plugin, {name: value})
