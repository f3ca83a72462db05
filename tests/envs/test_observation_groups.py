"""Observation groups: what they show, of which shape, with which past, and what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest
import torch
from torch import Tensor

from orbit_core.envs import Environment, ObservationGroup, ObservationTerm, make
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.envs.configuration import configure
from orbit_core.envs.observation_layout import one_tensor
from orbit_core.interfaces import ConfigurationError, NonFiniteError, ShapeError, UnknownNameError
from orbit_core.mdp import common
from orbit_core.mdp import sensing as images
from orbit_core.mdp import sensing as scans
from orbit_core.scene import CameraSpec, Channel, RayCasterSpec, look_at
from orbit_tasks.reach import Reach, ReachObservations, ReachState

BACKEND = "mujoco"
CAMERA = CameraSpec(
    name="eye",
    width=20,
    height=16,
    channels=(Channel.RGB, Channel.DEPTH, Channel.SEMANTIC),
    pose=look_at(eye=(1.4, 0.8, 0.8), target=(0.3, 0.0, 0.2)),
)
RAYS = RayCasterSpec(
    name="rays",
    entity="robot",
    frame="panda_hand",
    directions=((0.0, 0.0, -1.0), (0.1, 0.0, -1.0), (0.0, 0.0, 1.0)),
    yaw_only=True,
    max_distance=3.0,
)


def steps_taken(env: Environment[Reach]) -> Tensor:
    """(N, 1) of the episode."""
    return env.state.episode_step[:, None].float()


def elapsed(**keywords: object) -> ObservationTerm:
    return ObservationTerm(steps_taken, **keywords)  # pyright: ignore[reportArgumentType]


@dataclass
class Pictures(ObservationGroup):
    concatenate: bool = False
    color: ObservationTerm | None = images.camera_color(CAMERA)
    depth: ObservationTerm | None = images.camera_depth(CAMERA)
    labels: ObservationTerm | None = images.camera_segmentation(CAMERA)
    scan: ObservationTerm | None = scans.height_scan(RAYS)
    steps: ObservationTerm | None = field(default_factory=lambda: elapsed(history=3))
    reached: ObservationTerm | None = ObservationTerm(lambda env: env.task.success(env))


@dataclass
class PixelObservations:
    policy: Pictures = field(default_factory=Pictures)
    critic: ReachState = field(default_factory=ReachState)


@dataclass
class Single(ObservationGroup):
    first: ObservationTerm | None = None
    second: ObservationTerm | None = None


@dataclass
class Singles:
    policy: Single
    critic: Single | None = None


def reach(observations: object, num_envs: int = 3, **keywords: object) -> Environment:
    task = Reach(observations=observations, episode_length=0.12)  # pyright: ignore[reportArgumentType]
    return make(task, num_envs, BACKEND, seed=3, **keywords)  # pyright: ignore[reportArgumentType]


def without_python(environment: Environment, whole: bool) -> None:
    """As compiled steps and those on a GPU are made, but for the compiler."""
    environment._closed = CapturedStep(environment, compile=False, whole=whole)


def still(environment: Environment) -> Tensor:
    return torch.zeros(environment.num_envs, environment.action_size)


def test_terms_of_any_shape_keep_shape_and_dtype_in_a_dictionary() -> None:
    environment = reach(PixelObservations())
    observation, _ = environment.reset(seed=1)
    seen = observation["policy"]
    assert isinstance(seen, dict)
    assert {name: (tuple(value.shape), value.dtype) for name, value in seen.items()} == {
        "color": ((3, 16, 20, 3), torch.uint8),
        "depth": ((3, 16, 20, 1), torch.float32),
        "labels": ((3, 16, 20, 1), torch.int32),
        "scan": ((3, 3), torch.float32),
        "steps": ((3, 3, 1), torch.float32),
        "reached": ((3,), torch.bool),
    }
    for name, layout in environment.observation["policy"].terms.items():
        assert layout.shape == tuple(seen[name].shape[1:])
        assert layout.dtype == seen[name].dtype
        assert layout.low <= seen[name].min()
        assert seen[name].max() <= layout.high
    assert seen["color"].float().std() > 5.0  # a picture of something
    assert 0.5 < seen["depth"].min() < 3.0
    assert (seen["scan"][:, 2] == 3.0).all()  # upwards there is nothing
    assert one_tensor(observation, "critic").shape == (3, environment.observation["critic"].size)
    environment.close()


def test_the_same_term_in_two_groups_shows_the_same_and_is_measured_once() -> None:
    calls: list[int] = []

    def counted(env: Environment[Reach]) -> Tensor:
        calls.append(1)
        return env.commands["goal"]

    noisy = ObservationTerm(counted, noise_std=0.1)
    environment = reach(Singles(Single(first=noisy), Single(first=noisy, second=ObservationTerm(counted))))
    environment.reset(seed=2)
    calls.clear()
    observation = environment.step(still(environment))[0]
    assert len(calls) == 1
    policy, critic = one_tensor(observation), one_tensor(observation, "critic")
    assert torch.equal(policy, critic[:, :7])
    assert torch.equal(critic[:, 7:], environment.commands["goal"])
    assert not torch.equal(policy, environment.commands["goal"])
    environment.close()


def test_history_shows_the_last_steps_oldest_first_and_begins_anew_with_an_episode() -> None:
    groups = Singles(Single(first=elapsed(), second=elapsed(history=1), history=3))
    environment = reach(groups, num_envs=2)  # episodes of 6 steps
    first, _ = environment.reset()
    assert one_tensor(first).tolist() == [[0.0, 0.0, 0.0, 0.0]] * 2
    seen = [one_tensor(environment.step(still(environment))[0]) for _ in range(4)]
    assert seen[0].tolist() == [[0.0, 0.0, 1.0, 1.0]] * 2
    assert seen[3].tolist() == [[2.0, 3.0, 4.0, 4.0]] * 2
    environment.reset(env_ids=torch.tensor([1]))
    assert one_tensor(environment.observe()).tolist() == [[2.0, 3.0, 4.0, 4.0], [0.0, 0.0, 0.0, 0.0]]
    after = one_tensor(environment.step(still(environment))[0])
    assert after.tolist() == [[3.0, 4.0, 5.0, 5.0], [0.0, 0.0, 1.0, 1.0]]
    *_, info = environment.step(still(environment))  # the first environment's episode ends
    assert one_tensor(info["final"].observation).tolist() == [[4.0, 5.0, 6.0, 6.0]]
    assert one_tensor(environment.observe()).tolist() == [[0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 2.0, 2.0]]
    environment.close()


def test_histories_come_late_where_terms_do() -> None:
    environment = reach(Singles(Single(first=elapsed(history=2, delay=(2, 2)))), num_envs=1)
    environment.reset()
    seen = [one_tensor(environment.step(still(environment))[0])[0].tolist() for _ in range(4)]
    assert seen == [[0.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, 2.0]]
    environment.close()


def test_noise_and_bias_of_a_picture_differ_in_each_pixel_and_saturate_at_its_bounds() -> None:
    depth = images.camera_depth(CAMERA)
    noisy = replace(depth, noise_std=50.0, bias_std=10.0)
    group = Single(first=depth, second=noisy, concatenate=False)
    environment = reach(Singles(group))
    observation, _ = environment.reset(seed=5)
    seen = observation["policy"]
    assert isinstance(seen, dict)
    errors = (seen["second"] - seen["first"]).flatten()
    assert errors.unique().numel() > 0.3 * errors.numel()
    assert seen["second"].min() == 0.0
    assert seen["second"].max() <= CAMERA.far
    environment.close()


@pytest.mark.parametrize("num_envs", [1, 4])
def test_what_the_first_environment_sees_is_the_same_however_many_there_are(num_envs: int) -> None:
    term = ObservationTerm(common.joint_positions, noise_std=0.1, bias_std=0.2, delay=(0, 3), history=2)
    several, two = (reach(Singles(Single(first=term)), num_envs=count) for count in (num_envs, 2))
    for environment in (several, two):
        environment.reset(seed=7)
    for _ in range(8):
        ours, theirs = (one_tensor(e.step(still(e))[0])[0] for e in (several, two))
        assert torch.equal(ours, theirs)
    several.close()
    two.close()


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("dictionary", [False, True])
def test_a_step_without_its_python_gives_the_same_groups(dictionary: bool, whole: bool) -> None:
    critic = ReachState(history=2, concatenate=not dictionary)
    policy = ReachState(joint_positions=ObservationTerm(common.joint_positions, noise_std=0.1, delay=(0, 2), history=3))
    plain, parts = (reach(ReachObservations(policy, critic)) for _ in range(2))
    without_python(parts, whole)
    for environment in (plain, parts):
        environment.reset(seed=2)
    generator = torch.Generator().manual_seed(0)
    for _ in range(14):
        action = 2.0 * torch.rand(3, plain.action_size, generator=generator) - 1.0
        mine, its = plain.step(action), parts.step(action)
        torch.testing.assert_close(its[0], mine[0], rtol=0.0, atol=0.0)
        assert ("final" in its[4]) == ("final" in mine[4])
        if "final" in mine[4]:
            torch.testing.assert_close(its[4]["final"].observation, mine[4]["final"].observation, rtol=0.0, atol=0.0)
    plain.close()
    parts.close()


def test_what_is_returned_does_not_change_with_the_world() -> None:
    velocities = ObservationTerm(lambda env: env.world.robots["robot"].joint_velocities)
    environment = reach(Singles(Single(first=velocities, concatenate=False)))
    environment.reset(seed=1)
    kept = environment.step(still(environment))[0]["policy"]
    assert isinstance(kept, dict)
    before = kept["first"].clone()
    environment.step(torch.ones(3, environment.action_size))
    assert torch.equal(kept["first"], before)
    environment.close()


@dataclass
class Bare:
    goal: ObservationTerm | None = ObservationTerm(steps_taken)


@dataclass
class OnlyCritic:
    critic: ReachState = field(default_factory=ReachState)


def picture(env: Environment[Reach]) -> Tensor:
    return torch.zeros(env.num_envs, 8, 8, 3, dtype=torch.uint8)


def term(function: Callable[..., object], **keywords: object) -> Singles:
    return Singles(Single(first=ObservationTerm(function, **keywords)))  # pyright: ignore[reportArgumentType]


REFUSED = {
    "a group alone": (ReachState(), "must be a dataclass of ObservationGroup, not one group: .* field 'policy'"),
    "no group": (Bare(), "'goal' must be an ObservationGroup, but is of type ObservationTerm"),
    "no dataclass": ("pixels", "must be a dataclass of ObservationGroup"),
    "no policy": (OnlyCritic(), "have no group 'policy', which a policy sees: there are critic"),
    "no terms": (Singles(Single()), "group 'policy' .* has no terms"),
    "no term": (Singles(Single(first=picture)), "'first' must be an ObservationTerm"),  # pyright: ignore
    "history": (term(steps_taken, history=0), "term 'first': history is 0, but must be a whole number"),
    "picture": (term(picture), r"term 'first' of group 'policy' is a picture.* give the group concatenate=False"),
    "scaled picture": (
        Singles(Single(first=ObservationTerm(picture, scale=0.1), concatenate=False)),
        "gives torch.uint8: scale, noise and bias need torch.float32",
    ),
    "no tensor": (term(lambda env: 3.0), "gives a float: its function must return a torch.Tensor"),
    "rows": (term(lambda env: torch.zeros(2, 3)), r"has shape \(2, 3\), but must have \(3, \.\.\.\)"),
    "dtype": (term(lambda env: torch.zeros(3, 1, dtype=torch.float64)), "gives torch.float64: convert it"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_observed_is_refused_when_the_environment_is_made(case: str) -> None:
    observations, message = REFUSED[case]
    with pytest.raises((ConfigurationError, ShapeError), match=message):
        reach(observations)


def test_two_different_sensors_of_one_name_are_refused() -> None:
    other = images.camera_color(replace(CAMERA, width=24))
    both = Single(first=images.camera_depth(CAMERA), second=other, concatenate=False)
    expected = "'second' of group 'policy' needs a sensor 'eye' that differs from that of .*'first' of group 'policy'"
    with pytest.raises(ConfigurationError, match=expected):
        reach(Singles(both))
    with pytest.raises(ConfigurationError, match=r"no normals channel: add Channel.NORMALS"):
        images._check_channel(CAMERA, Channel.NORMALS)


@pytest.mark.parametrize("concatenate", [True, False])
@pytest.mark.parametrize("python", [True, False])
def test_a_number_that_is_not_finite_is_refused_with_term_and_environment(concatenate: bool, python: bool) -> None:
    def spoilt(env: Environment[Reach]) -> Tensor:
        late = (env.state.episode_step > 2)[:, None] & torch.tensor([[False], [True], [False]])
        return torch.where(late, torch.nan, env.commands["goal"])

    group = Single(first=ObservationTerm(common.joint_positions), second=ObservationTerm(spoilt))
    environment = reach(Singles(replace(group, concatenate=concatenate)))
    if not python:
        without_python(environment, whole=False)
    environment.reset(seed=0)
    for _ in range(2):
        environment.step(still(environment))
    expected = "term 'second' of group 'policy' is not finite in environment 1: component 0 of environment 1 is nan"
    with pytest.raises(NonFiniteError, match=expected):
        environment.step(still(environment))
    environment.close()


def test_a_term_that_changes_its_shape_is_refused() -> None:
    def growing(env: Environment[Reach]) -> Tensor:
        return torch.zeros(3, 2 + int(env.state.episode_step.max() > 1))

    environment = reach(term(growing))
    environment.reset(seed=0)
    environment.step(still(environment))
    with pytest.raises(ShapeError, match=r"term 'first' of group 'policy' has shape \(3, 3\).* but had \(3, 2\)"):
        environment.step(still(environment))
    environment.close()


def test_a_dictionary_is_not_taken_for_one_tensor() -> None:
    environment = reach(Singles(Single(first=elapsed(), concatenate=False)))
    for read in (lambda: environment.observation_size, lambda: one_tensor(environment.observe())):
        with pytest.raises(ConfigurationError, match=r"group 'policy' is a dictionary of its terms \(first\)"):
            read()
    environment.close()


def test_a_word_takes_a_tasks_preset_of_observations() -> None:
    @dataclass(kw_only=True)
    class Seeing(Reach):
        observation_presets = {"pixels": PixelObservations}  # noqa: RUF012 - a task's own

    assert isinstance(configure(Seeing, {"observations": "pixels"}).observations, PixelObservations)
    assert configure(Seeing, {"observations": "state"}).observations == ReachObservations()
    with pytest.raises(UnknownNameError, match=r"'pixel'.*did you mean 'pixels'"):
        configure(Seeing, {"observations": "pixel"})
