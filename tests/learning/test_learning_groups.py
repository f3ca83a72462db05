"""Actors see the group ``policy``, critics the group ``critic`` where there is one; the rest is refused by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from skrl.utils.spaces.torch import flatten_tensorized_space
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs

from orbit_core.backends import default_backend, renderer_names
from orbit_core.envs import Environment, ObservationGroup, ObservationTerm, PpoSettings
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp import common
from orbit_core.mdp.sensing import camera_color, camera_depth, camera_segmentation
from orbit_core.scene import CameraSpec, Channel, look_at
from orbit_learn.learners import trainer_type
from orbit_learn.networks import Convolutional
from orbit_learn.policy import PolicyActor, load_policy
from orbit_learn.sb3 import seen_arrays
from orbit_learn.spaces import tensors_by_name
from orbit_learn.torchrl import TorchRlEnvironment
from orbit_learn.training import Training, read_checkpoint
from orbit_tasks.reach import Reach, ReachState

BACKEND = default_backend()
RENDERER = "warp" if "warp" in renderer_names() else None
"""Draws fastest on a CPU; any would do."""
SHORT = PpoSettings(iterations=2, steps_per_iteration=3, hidden_sizes=(16,), epochs=2, minibatches=2)
CAMERA = CameraSpec(
    name="front",
    width=9,
    height=8,
    channels=(Channel.RGB, Channel.DEPTH, Channel.SEMANTIC),
    pose=look_at((1.3, 0.0, 0.75), (0.45, 0.0, 0.2)),
    far=2.0,
)


@dataclass
class Joints(ObservationGroup):
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)


@dataclass
class Pictures(ObservationGroup):
    concatenate: bool = False
    front_color: ObservationTerm | None = camera_color(CAMERA)
    front_depth: ObservationTerm | None = camera_depth(CAMERA)
    joint_positions: ObservationTerm | None = ObservationTerm(common.joint_positions)


@dataclass
class Labels(ObservationGroup):
    concatenate: bool = False
    front_labels: ObservationTerm | None = camera_segmentation(CAMERA)


@dataclass
class Groups:
    policy: ObservationGroup = field(default_factory=Joints)
    critic: ObservationGroup | None = None


def reach(policy: ObservationGroup, critic: ObservationGroup | None) -> Environment:
    task = Reach(observations=Groups(policy, critic), episode_length=0.1)
    return Environment(task, 4, BACKEND, renderer=RENDERER)


def learned(library: str, environment: Environment, folder: Path, settings: PpoSettings = SHORT) -> Any:
    made = trainer_type(library)(environment, settings, folder, 0)
    Training(made, "Reach", {}).run(SHORT.iterations, 100, lambda progress: None)
    return made


def value_in_rl_games(made: Any, seen: dict[str, Tensor]) -> Tensor:
    states = {"obs": seen["policy"], "states": seen["critic"], "is_train": False, "rnn_states": None}
    return made._agent.get_central_value({**states, "is_done": False, "actions": None})


VALUES: dict[str, Callable[[Any, dict[str, Tensor]], Tensor]] = {
    "rsl-rl": lambda made, seen: made._runner.alg.critic(TensorDict(seen, batch_size=[4])),
    "skrl": lambda made, seen: made._agent.value.act({"observations": seen["policy"], "states": seen["critic"]})[0],
    "rl-games": value_in_rl_games,
    "torchrl": lambda made, seen: made.critic(TensorDict(seen, batch_size=[4]))["state_value"],
}
"""What each library's own critic makes of both groups."""


@pytest.mark.parametrize("library", VALUES)
def test_a_critic_sees_its_own_group_and_no_other(library: str, tmp_path: Path) -> None:
    environment = reach(Joints(), ReachState())
    made = learned(library, environment, tmp_path)
    seen = tensors_by_name(environment.observe())
    with torch.no_grad():
        before = VALUES[library](made, seen)
        same = VALUES[library](made, {**seen, "policy": seen["policy"] + 1.0})
        other = VALUES[library](made, {**seen, "critic": seen["critic"] + 1.0})
    assert torch.equal(before, same)
    assert not torch.allclose(before, other)
    assert load_policy(tmp_path).description.observation_size == seen["policy"].shape[1]
    environment.close()


@pytest.mark.parametrize("critic", [None, ReachState()])
def test_rsl_rl_learns_from_pictures(critic: ObservationGroup | None, tmp_path: Path) -> None:
    """What is kept acts as RSL-RL's own model does, in ORBIT's network of convolutions."""
    environment = reach(Pictures(), critic)
    made = learned("rsl-rl", environment, tmp_path)
    observation = environment.observe()
    seen = TensorDict(tensors_by_name(observation), batch_size=[4])  # pyright: ignore[reportArgumentType]
    with torch.no_grad():
        expected = made._runner.get_inference_policy()(seen).clamp(-1.0, 1.0)
        blind = {**seen, "policy/front_color": torch.zeros_like(seen["policy/front_color"])}
        unlike = made._runner.get_inference_policy()(TensorDict(blind, batch_size=[4])).clamp(-1.0, 1.0)
    torch.testing.assert_close(PolicyActor(environment, tmp_path).act(), expected, atol=1e-5, rtol=1e-5)
    assert not torch.allclose(expected, unlike, atol=1e-4)
    environment.close()


def said_by_sb3(made: Any, seen: dict[str, Any]) -> Tensor:
    normalized = made._environment.normalize_obs(seen_arrays(seen))
    return made._model.policy.get_distribution(made._model.policy.obs_to_tensor(normalized)[0]).mode()


def said_by_skrl(made: Any, seen: dict[str, Any]) -> Tensor:
    flat = made._agent._observation_preprocessor(flatten_tensorized_space(seen).float())
    return made._agent.policy.act({"observations": flat})[1]["mean_actions"]


def said_by_torchrl(made: Any, seen: dict[str, Any]) -> Tensor:
    return made.policy.get_dist(TensorDict({"policy": seen}, batch_size=[4])).mean


SAID: dict[str, Callable[[Any, dict[str, Any]], Tensor]] = {
    "sb3": said_by_sb3,
    "skrl": said_by_skrl,
    "torchrl": said_by_torchrl,
}
"""What each library's own actor says to the group ``policy``, before it is clipped."""


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("library", SAID)
def test_what_was_learned_from_pictures_acts_as_in_its_library(library: str, normalize: bool, tmp_path: Path) -> None:
    environment = reach(Pictures(), None)
    made = learned(library, environment, tmp_path, replace(SHORT, normalize_observations=normalize))
    seen: Any = environment.observe()["policy"]
    with torch.no_grad():
        expected = SAID[library](made, seen).clamp(-1.0, 1.0)
        blind = SAID[library](made, {**seen, "front_color": torch.zeros_like(seen["front_color"])}).clamp(-1.0, 1.0)
    policy = load_policy(tmp_path)
    assert isinstance(policy.network, Convolutional)
    torch.testing.assert_close(PolicyActor(environment, tmp_path).act(), expected, atol=1e-5, rtol=1e-5)
    assert not torch.allclose(expected, blind, atol=1e-4)
    environment.close()


@pytest.mark.parametrize("library", ["skrl", "torchrl"])
def test_a_critic_may_see_the_state_where_the_policy_sees_pictures(library: str, tmp_path: Path) -> None:
    environment = reach(Pictures(), ReachState())
    learned(library, environment, tmp_path)
    action = PolicyActor(environment, tmp_path).act()
    assert action.shape == (4, environment.action_size)
    environment.step(action)
    environment.close()


def test_torchrls_own_check_passes_with_pictures_and_a_critics_group() -> None:
    environment = reach(Pictures(), ReachState())
    check_env_specs(TorchRlEnvironment(environment))
    environment.close()


@pytest.mark.parametrize("library", SAID)
def test_a_training_from_pictures_goes_on_from_where_it_was_kept(library: str, tmp_path: Path) -> None:
    environment = reach(Pictures(), None)
    learned(library, environment, tmp_path)
    kept = load_policy(tmp_path).module.state_dict()
    made = trainer_type(library)(environment, SHORT, tmp_path, 1)
    made.restore(read_checkpoint(tmp_path / "checkpoint_1.safetensors", library), 1)
    went_on = made.actor().module.state_dict()
    assert kept.keys() == went_on.keys()
    assert all(torch.equal(kept[name], value) for name, value in went_on.items())
    environment.close()


@pytest.mark.parametrize("library", ["sb3"])
def test_a_critics_group_is_refused_where_the_library_has_no_place_for_it(library: str, tmp_path: Path) -> None:
    environment = reach(Joints(), ReachState())
    with pytest.raises(ConfigurationError, match=rf"'{library}' .* group 'critic'.* rl-games or skrl or torchrl"):
        trainer_type(library)(environment, SHORT, tmp_path, 0)
    environment.close()


@pytest.mark.parametrize("library", ["rl-games"])
def test_pictures_are_refused_where_the_library_cannot_take_them(library: str, tmp_path: Path) -> None:
    environment = reach(Pictures(), None)
    with pytest.raises(ConfigurationError, match=rf"'{library}' .* group 'policy' .*front_color.*rsl-rl"):
        trainer_type(library)(environment, SHORT, tmp_path, 0)
    environment.close()


def test_labels_are_no_colours(tmp_path: Path) -> None:
    environment = reach(Labels(), None)
    with pytest.raises(ConfigurationError, match=r"'front_labels' is a picture of int32.* segmentation as one picture"):
        trainer_type("rsl-rl")(environment, SHORT, tmp_path, 0)
    environment.close()
