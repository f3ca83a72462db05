"""Policies cloned from recorded demonstrations: learned for real, at the smallest size."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.cli import main
from orbit_core.dynamics.transforms import quat_to_matrix
from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError, OrbitError, UnknownNameError
from orbit_data.hdf5 import Hdf5Dataset
from orbit_data.manifest.manifest import Manifest
from orbit_learn.cli.trained import PlaySettings, restore
from orbit_learn.cloning.corrections import gather_corrections
from orbit_learn.cloning.demonstrations import load_demonstrations
from orbit_learn.cloning.encoding import (
    FINE,
    Encoder,
    Encoding,
    Labels,
    encoding_for,
    quarter_features,
    rotation_features,
)
from orbit_learn.cloning.networks import ClonedDiffusion, ClonedRecurrent, ClonedTransformer, Planner
from orbit_learn.cloning.steps import shifted
from orbit_learn.cloning.trainer import ALGORITHMS, ImitationSettings, ImitationTrainer
from orbit_learn.description import Part, group_parts
from orbit_learn.memory import Remembering
from orbit_learn.policy import PolicyActor, load_policy
from orbit_learn.training import Training

BACKEND = default_backend()
QUICK = ImitationSettings(iterations=1, updates_per_iteration=3, batch_size=32, hidden_size=32, chunk=8, executed=4)


def reach(count: int = 4, action: str = "joint_position") -> Environment:
    return make("Reach", num_envs=count, backend=BACKEND, action=action, episode_length=1.0)


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("demos") / "reach.hdf5"
    words = f"record Reach --backend {BACKEND} --num-envs 8 --episodes 16 --set episode_length=1.0 --noise 0.02"
    assert main([*words.split(), "--output", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def environment() -> Iterator[Environment]:
    environment = reach()
    yield environment
    environment.close()


def train(environment: Environment, demos: Path, folder: Path, settings: ImitationSettings = QUICK) -> None:
    trainer = ImitationTrainer(environment, replace(settings, dataset=(str(demos),)), folder, 0)
    Training(trainer, "Reach", {}).run(settings.iterations, 1, lambda progress: None)


def actions_of(environment: Environment, folder: Path, steps: int) -> list[Tensor]:
    environment.reset(3)
    actor, made = PolicyActor(environment, folder), []
    for _ in range(steps):
        made.append(actor.act())
        environment.step(made[-1])
    return made


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_cloned_policy_is_written_played_and_repeats_itself(
    algorithm: str, demos: Path, environment: Environment, tmp_path: Path
) -> None:
    train(environment, demos, tmp_path, replace(QUICK, algorithm=algorithm))
    first, again = (actions_of(environment, tmp_path, 6) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        assert one.shape == (4, environment.action_size)
        assert bool((one.abs() <= 1.0).all())
        torch.testing.assert_close(one, other, rtol=0.0, atol=1e-6)
    assert not torch.equal(first[0], first[5])


def test_cloning_brings_a_reaching_hand_nearer(demos: Path, tmp_path: Path) -> None:
    environment = reach(16)
    settings = replace(QUICK, dataset=(str(demos),), iterations=2, updates_per_iteration=150, hidden_size=64)
    trainer = ImitationTrainer(environment, settings, tmp_path, 0)
    losses: list[float] = []
    distances: list[float] = []

    def look(progress: object) -> None:
        losses.append(progress.loss)  # pyright: ignore[reportAttributeAccessIssue]
        distances.append(progress.metrics.get("position_error_m", float("nan")))  # pyright: ignore

    trainer.learn(2, look)
    environment.close()
    assert losses[1] < 0.8 * losses[0]
    assert distances[1] < 0.1


def test_memory_begins_again_with_each_environments_episode() -> None:
    part = Part("seen", 3)
    module = ClonedRecurrent(encoding=Encoding((part,)), chunk=4, executed=2, hidden_size=8).build(3, 2).eval()
    acting, alone = Remembering(module, 2, "cpu"), Remembering(module, 2, "cpu")
    never = torch.zeros(2, dtype=torch.bool)
    torch.manual_seed(0)
    before = torch.randn(3, 2, 3)
    for seen in before:
        acting.act(seen, never)
    after = torch.randn(2, 3)
    mixed = acting.act(after, torch.tensor([True, False]))
    fresh = alone.act(after, ~never)
    torch.testing.assert_close(mixed[0], fresh[0])
    assert not torch.allclose(mixed[1], fresh[1])


def test_plans_are_executed_as_far_as_the_settings_say() -> None:
    part = Part("seen", 3)
    module = ClonedRecurrent(encoding=Encoding((part,)), chunk=4, executed=2, hidden_size=8).build(3, 2).eval()
    memory = module.initial_memory(1, "cpu")
    torch.manual_seed(0)
    with torch.no_grad():
        first, memory = module.act(torch.randn(1, 3), memory)
        plan = memory["plan"].clone()
        second, memory = module.act(torch.randn(1, 3), memory)
        third, _ = module.act(torch.randn(1, 3), memory)
    torch.testing.assert_close(first, plan[:, 0])
    torch.testing.assert_close(second, plan[:, 1])
    assert not torch.allclose(third, plan[:, 2])


def test_ensembled_plans_are_averaged_by_age() -> None:
    part, rate = Part("seen", 2), 0.5
    network = ClonedTransformer(encoding=Encoding((part,)), chunk=3, executed=1, width=8, heads=2, ensemble=rate)
    module = network.build(2, 1).eval()
    assert isinstance(module, Planner)
    memory, plans, actions = module.initial_memory(1, "cpu"), [], []
    torch.manual_seed(0)
    with torch.no_grad():
        for _ in range(4):
            seen = torch.randn(1, 2)
            plans.append(module.labels.actions(module.outputs(module.encoder(seen), memory), seen)[0])
            action, memory = module.act(seen, memory)
            actions.append(action)
    # Step 3 is planned by steps 1 (its third action), 2 and 3.
    weights = torch.tensor([1.0, np.exp(-rate), np.exp(-2 * rate)])
    expected = (weights[0] * plans[1][2] + weights[1] * plans[2][1] + weights[2] * plans[3][0]) / weights.sum()
    torch.testing.assert_close(actions[3][0], expected.float())


def test_plans_of_a_diffusion_policy_land_on_all_that_demonstrators_do() -> None:
    torch.manual_seed(0)
    # Half of the demonstrators pass on the left, half on the right; their mean runs into the obstacle.
    side = torch.where(torch.rand(256, 1, 1) < 0.5, -0.5, 0.5)
    actions, seen = side + 0.02 * torch.randn(256, 4, 1), torch.zeros(256, 1)
    module = ClonedDiffusion(encoding=Encoding((Part("seen", 1),)), chunk=4, executed=1, width=64, layers=2).build(1, 1)
    assert isinstance(module, Planner)
    module.labels.fit(actions, seen)
    optimizer = torch.optim.Adam(module.parameters(), 3e-3)
    for _ in range(300):
        optimizer.zero_grad()
        module.loss(seen, actions, torch.ones(256, 4, dtype=torch.bool)).backward()
        optimizer.step()
    memory, plans = module.initial_memory(1, "cpu"), []
    with torch.no_grad():
        for _ in range(64):
            _, memory = module.act(seen[:1], memory)
            plans.append(memory["plan"][0])
    first = torch.stack(plans)
    assert (first.abs() - 0.5).abs().max() < 0.2, "no plan lies between the modes"
    assert 16 <= int((first[:, 0, 0] > 0.0).sum()) <= 48, "both are planned in one state"
    _, memory = module.act(seen[:1], module.initial_memory(1, "cpu"))
    torch.testing.assert_close(memory["plan"][0], plans[0], msg="an episode repeats")


def test_labels_are_relative_to_the_present_joint_positions() -> None:
    encoding = Encoding((Part("joints", 2),), joints=(1, -1), gains=(0.5, 0.0), biases=(0.1, 0.0), binary=(False, True))
    labels = Labels(encoding, 2)
    seen = torch.tensor([[9.0, 0.4]])
    actions = torch.tensor([[[0.5, -1.0], [0.25, 1.0]]])
    made = labels.normalised(actions, seen)
    torch.testing.assert_close(made[0], torch.tensor([[0.2, -1.0], [-0.05, 1.0]]))
    torch.testing.assert_close(labels.actions(made, seen), actions)


def test_the_encoding_follows_from_what_the_manifest_says(demos: Path, environment: Environment) -> None:
    dataset = Hdf5Dataset(demos)
    manifest = dataset.known()
    dataset.close()
    parts = group_parts(environment.observation["policy"])
    encoding = encoding_for(manifest, "policy", parts, True)
    assert len(encoding.joints) == environment.action_size
    assert all(column >= 0 for column in encoding.joints[:7])
    assert encoding.vectors, "the goal is a position"
    begins = {part.name: sum(each.size for each in parts[:i]) for i, part in enumerate(parts)}
    poses = {begins[part.name] + 3 for part in parts if part.size == 7 and "pose" in part.name}
    assert poses, "Reach shows poses"
    assert poses <= set(encoding.rotations)
    assert all(first + i in encoding.replaced for first in encoding.rotations for i in range(4))
    columns = [name for part in parts for name in [part.name] * part.size]
    assert {columns[column] for column in encoding.hidden} == {"last_action", "joint_velocities"}
    velocities = [columns[column] for column in encoding.hidden].count("joint_velocities")
    assert velocities == 2, "those of the two fingers"
    # What the joint's position commands is where the joint is: the robot rests at it.
    for column, gain, bias in zip(encoding.joints[:7], encoding.gains, encoding.biases, strict=False):
        assert gain == pytest.approx(1.0 / manifest.action_terms["joint_position"].scale[0])  # pyright: ignore
        assert bias == pytest.approx(0.0, abs=1e-6)
        assert columns[column] == "joint_positions"
    assert pytest.approx(0.03) == FINE


def test_a_policy_is_judged_by_starts_that_no_recording_showed(
    demos: Path, environment: Environment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds: list[int | None] = []
    reset = environment.reset

    def noted(seed: int | None = None) -> Any:
        seeds.append(seed)
        return reset(seed)

    monkeypatch.setattr(environment, "reset", noted)
    train(environment, demos, tmp_path, QUICK)
    assert seeds
    assert min(seed for seed in seeds if seed is not None) >= 20_000


def test_key_points_are_positions_of_their_own_and_no_pairs_of_each_other(
    demos: Path, environment: Environment
) -> None:
    """The way from the hand to a cloth's middle is what its pinch is learned from."""
    dataset = Hdf5Dataset(demos)
    manifest = dataset.known()
    dataset.close()
    known = manifest.observations["policy"].terms
    points = replace(known["goal"], shape=(9,), unit="m", formula="positions of the key points of 'cloth'")
    lengths = replace(points, formula="lengths of the key points")
    many = replace(points, shape=(39,))
    terms = {"points": points, "lengths": lengths, "many": many, "hand_pose": known["hand_pose"]}
    group = replace(manifest.observations["policy"], terms=terms)
    parts = (Part("points", 9), Part("lengths", 9), Part("many", 39), Part("hand_pose", 7))
    encoding = encoding_for(replace(manifest, observations={"policy": group}, action_terms={}), "policy", parts, True)
    assert encoding.vectors == (0, 3, 6, 57)
    assert encoding.rotations == (60,)
    assert encoding.pairs == ((0, 3), (1, 3), (2, 3))
    features = Encoder(encoding).features(torch.arange(64.0)[None])
    assert features.shape == (1, encoding.feature_size)
    ways = features[0, -3 * (4 + 2 * 3) : -3 * (4 + 3)].view(3, 3)
    torch.testing.assert_close(ways[:, 0], torch.tensor([57.0, 54.0, 51.0]))


def test_rotations_are_shown_without_sign_and_by_half_and_quarter_turns() -> None:
    torch.manual_seed(0)
    turned = torch.nn.functional.normalize(torch.randn(5, 4), dim=1)
    shown = rotation_features(turned)
    torch.testing.assert_close(rotation_features(-turned), shown)
    torch.testing.assert_close(shown[:, :6].unflatten(1, (3, 2)), quat_to_matrix(turned)[:, :, :2])
    yaw = torch.tensor([0.3, 0.3 + math.pi / 2, 0.3 + math.pi])
    half = 0.5 * yaw[:, None]
    upright = rotation_features(torch.cat((half.cos(), torch.zeros(3, 2), half.sin()), 1))
    torch.testing.assert_close(upright[:, 10], (4.0 * yaw).cos())
    torch.testing.assert_close(upright[0, 10:], upright[1, 10:])
    torch.testing.assert_close(upright[0, 6:10], upright[2, 6:10])
    assert not torch.allclose(upright[0, 6:10], upright[1, 6:10])


def test_a_turn_within_a_quarter_grows_evenly_and_jumps_at_an_eighth_of_a_turn() -> None:
    yaw = torch.tensor([0.0, 0.3, -0.3, 0.78, 0.79, 0.3 + math.pi / 2, 0.3 - math.pi])
    half = 0.5 * yaw[:, None]
    turned = torch.cat((half.cos(), torch.zeros(7, 2), half.sin()), 1)
    expected = torch.zeros(7, 3)
    expected[:, 2] = 2.0 * (yaw - math.pi / 2 * torch.round(yaw / (math.pi / 2)))
    torch.testing.assert_close(quarter_features(turned), expected, atol=1e-5, rtol=0.0)
    torch.testing.assert_close(quarter_features(-turned), expected, atol=1e-5, rtol=0.0)


def test_a_grippers_positions_are_blurred_in_training_and_its_velocities_are_hidden() -> None:
    environment = make("Lift", num_envs=1, backend=BACKEND)
    layout = environment.observation["policy"]
    encoding = encoding_for(Manifest.of(environment, "Lift", 0), "policy", group_parts(layout), True)
    joints = environment.world.robots["robot"].joint_names
    fingers = [place for place, name in enumerate(joints) if "finger" in name]
    environment.close()
    positions, velocities = (layout.columns[name].start for name in ("joint_positions", "joint_velocities"))
    assert fingers
    assert encoding.blurred == tuple(positions + place for place in fingers)
    assert {velocities + place for place in fingers} == encoding.replaced & set(range(velocities, velocities + 9))
    encoder, seen = Encoder(encoding).train(), torch.zeros(512, encoding.vector_size)
    spread = (encoder(seen) - encoder.eval()(seen)).std(0)
    places = [encoder.shown.tolist().index(column) for column in encoding.blurred]
    assert spread.nonzero().flatten().tolist() == places
    assert 0.0015 < float(spread[places].mean()) < 0.0025


def test_policies_that_were_shown_quaternions_are_still_shown_them() -> None:
    parts, seen = (Part("pose", 7),), torch.randn(4, 7)
    before, now = Encoding(parts, vectors=(0,)), Encoding(parts, vectors=(0,), rotations=(3,))
    torch.testing.assert_close(Encoder(before).features(seen)[:, :7], seen)
    assert Encoder(now).features(seen).shape == (4, now.feature_size) == (4, 3 + 14 + 3)
    with pytest.raises(ValueError, match="columns are 0 to 6"):
        Encoding(parts, rotations=(4,))


def test_noise_disturbs_the_executed_actions_and_leaves_the_labels(demos: Path) -> None:
    dataset = Hdf5Dataset(demos)
    spreads = []
    for position in range(len(dataset.episodes)):
        arrays = dataset.read(position).arrays
        difference = arrays["actions"] - arrays["clean_actions"]
        spreads.append(np.abs(difference).max())
        held = np.isclose(difference[1:], difference[:-1], atol=1e-6).all(1).mean()
        assert held > 0.6, "noise is held for ten steps on average"
    dataset.close()
    assert max(spreads) > 0.02
    assert len({round(float(each), 5) for each in spreads}) > 8, "each episode has its own"


@pytest.mark.parametrize(
    ("algorithm", "own"),
    [("bc-rnn", ["hidden", "cell", "seen"]), ("bc-gmm", []), ("act", []), ("diffusion", ["drawn"])],
)
def test_a_graph_with_memory_acts_as_its_module(
    demos: Path, environment: Environment, tmp_path: Path, algorithm: str, own: list[str]
) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    train(environment, demos, tmp_path, replace(QUICK, algorithm=algorithm))
    assert main(["export", str(tmp_path), "--output", str(tmp_path / "out")]) == 0
    policy = load_policy(tmp_path / "out" / "policy.safetensors")
    assert [part.name for part in policy.description.memory] == ["plan", "step", *own]
    session = onnxruntime.InferenceSession(str(tmp_path / "out" / "policy.onnx"))
    assert isinstance(policy.module, Planner)
    memory = policy.module.initial_memory(3, "cpu")
    graph = {name: value.numpy() for name, value in memory.items()}
    torch.manual_seed(0)
    for _ in range(7):
        seen = torch.randn(3, policy.description.observation_size)
        with torch.no_grad():
            action, memory = policy.module.act(seen, memory)
        outputs = session.run(None, {"observation": seen.numpy(), **graph})
        np.testing.assert_allclose(outputs[0], action.numpy(), atol=1e-5)
        graph = dict(zip(graph, outputs[1:], strict=True))
    with pytest.raises(ConfigurationError, match="policy with memory"):
        load_policy(tmp_path / "out" / "policy.onnx")


def test_a_training_goes_on_where_it_was_cut_off(demos: Path, environment: Environment, tmp_path: Path) -> None:
    settings = replace(QUICK, dataset=(str(demos),), iterations=2)
    Training(ImitationTrainer(environment, settings, tmp_path, 0), "Reach", {}).run(1, 1, lambda progress: None)
    resumed = ImitationTrainer(environment, settings, tmp_path, 0)
    policy = Training(resumed, "Reach", {}).run(2, 1, lambda progress: None, resume=True)
    assert policy.description.iteration == 1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--library imitation", "give --dataset"),
        ("--library imitation --dataset nowhere.hdf5", "nowhere.hdf5"),
        ("--library imitation --algorithm bcc --dataset {demos}", "did you mean 'bc'"),
        ("--library imitation --distillation batch_size=3 --dataset {demos}", "takes no --distillation"),
        ("--library rsl-rl --dataset {demos}", "takes no --dataset"),
        (
            "--library imitation --dataset {demos} --imitation chunk=4 --imitation executed=8",
            "'executed' is 1 to chunk",
        ),
        ("--algorithm act --dataset {demos} --imitation hidden_size=30", "fit no network of act: width 7"),
        ("--library imitation --dataset {demos} --imitation chunk=1000", "chunk at most 512"),
        ("--library imitation --dataset {demos} --imitation ensemble=0.1", "averages plans of act, and not of bc"),
        ("--library imitation --dataset {demos} --action ik_relative", "action_terms"),
        ("--library imitation --dataset {demos} --robot ur10", "joint_names"),
        ("--library imitation --dataset {demos} --set actions.joint_position.scale=0.5", "scale was 2"),
        ("--library imitation --dataset {demos} --set physics_dt=0.01", "step_dt was 0.02 and is 0.04"),
    ],
)
def test_bad_calls_are_told(
    words: str, told: str, demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"train Reach --backend {BACKEND} --num-envs 2 --iterations 1 " + words.format(demos=demos)
    assert main([*line.split(), "--output", str(tmp_path / "out")]) != 0
    assert told in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("clean_actions", lambda value: value[:, :1], r"episode 0 of .* actions of shape \(50, 1\) .* \(steps, 8\)"),
        ("clean_actions", lambda value: value.astype(np.int32), "type int32: cloning needs real numbers"),
        ("clean_actions", lambda value: 100.0 * value, r"within \[-1, 1\]: divide them by their scale"),
        ("obs/goal", lambda value: (10.0 * value).astype(np.uint8), "'goal' of episode 1 .* holds float32, .* uint8"),
    ],
)
def test_arrays_that_would_be_cut_or_copied_in_silence_are_refused(
    name: str,
    change: Callable[[np.ndarray], np.ndarray],
    told: str,
    demos: Path,
    environment: Environment,
    tmp_path: Path,
) -> None:
    path = tmp_path / "wrong.hdf5"
    shutil.copy(demos, path)
    with h5py.File(path, "r+") as file:
        value = change(np.asarray(file[f"data/demo_0/{name}"]))
        del file[f"data/demo_0/{name}"]
        file[f"data/demo_0/{name}"] = value
    with pytest.raises(ConfigurationError, match=told):
        load_demonstrations(path, environment, only_successes=False)


def test_a_dataset_that_is_too_small_says_how_small(
    environment: Environment, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = f"record Reach --backend {BACKEND} --num-envs 1 --episodes 1 --set episode_length=1.0"
    assert main([*words.split(), "--output", str(tmp_path / "one.hdf5")]) == 0
    with pytest.raises(ConfigurationError, match="50 steps in 1 episodes to clone, and cloning needs 64: record more"):
        ImitationTrainer(environment, replace(QUICK, dataset=(str(tmp_path / "one.hdf5"),)), tmp_path, 0)


def test_a_dataset_with_pictures_of_another_size_names_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "pictures.hdf5"
    line = f"record Lift --backend {BACKEND} --num-envs 1 --episodes 1 --set episode_length=0.1 --cameras front:16x16"
    assert main([*line.split(), "--output", str(path)]) == 0
    line = f"train Lift --backend {BACKEND} --num-envs 1 --iterations 1 --library imitation --cameras front:24x20"
    assert main([*line.split(), "--dataset", str(path), "--output", str(tmp_path / "out")]) != 0
    told = " ".join(capsys.readouterr().err.split())
    assert re.search(r"shape was 16, 16, 3 and is 20, 24, 3", told), told


def test_a_dataset_of_another_task_is_named(demos: Path, tmp_path: Path) -> None:
    environment = make("Lift", num_envs=2, backend=BACKEND)
    with pytest.raises(ConfigurationError, match=r"hand_pose was there and is absent.*cube_pose was absent"):
        ImitationTrainer(environment, replace(QUICK, dataset=(str(demos),)), tmp_path, 0)
    environment.close()


def test_each_algorithm_begins_with_its_own_step_size_unless_one_is_given() -> None:
    assert ImitationSettings(algorithm="bc").first_learning_rate(pictures=False) == 3e-3
    assert ImitationSettings(algorithm="bc").first_learning_rate(pictures=True) == 1e-3
    assert ImitationSettings(algorithm="act").first_learning_rate(pictures=False) == 1e-3
    assert ImitationSettings(algorithm="bc", learning_rate=5e-4).first_learning_rate(pictures=True) == 5e-4
    with pytest.raises(ConfigurationError, match="'learning_rate' is at least 0, not -1"):
        ImitationSettings(learning_rate=-1.0)


def test_unknown_algorithms_tell_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="diffusion"):
        ImitationSettings(algorithm="diffusio")


def test_pictures_are_shifted_by_a_few_pixels_and_vectors_are_not() -> None:
    torch.manual_seed(0)
    rows = torch.arange(20, dtype=torch.uint8)[None, :, None, None].expand(64, 20, 10, 3).clone()
    moved = shifted(rows)
    steps = moved.int().diff(dim=1)
    assert bool(((steps == 0) | (steps == 1)).all()), "rows stay in order, and edges repeat"
    assert set((moved[:, 10, 0, 0].int() - 10).tolist()) == set(range(-4, 5))
    sequences = rows[:8].unflatten(0, (2, 4))
    moved = shifted(sequences)
    assert moved.shape == sequences.shape
    assert len(set(moved[:, :, 10, 0, 0].flatten().tolist())) > 1, (
        "each picture of a sequence is shifted, not its order"
    )
    assert bool((moved.int().diff(dim=2) <= 1).all())
    vector = torch.rand(4, 7)
    assert shifted(vector) is vector


def test_a_device_that_torch_lacks_is_named(demos: Path, environment: Environment, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="setting 'device' is 'nowhere'"):
        train(environment, demos, tmp_path, replace(QUICK, device="nowhere"))
    train(environment, demos, tmp_path, replace(QUICK, device="cpu"))


def test_playing_shows_a_policy_the_pictures_that_it_learned_from() -> None:
    record = {"task": "Lift", "cameras": ["front:84x84"]}
    assert restore(PlaySettings(policy=Path("p")), record, "Lift").settings.cameras == ("front:84x84",)
    other = restore(PlaySettings(policy=Path("p"), cameras=("front:64x64",)), record, "Lift")
    assert other.settings.cameras == ("front:64x64",)
    assert any("cameras" in line for line in other.differences)


class Still(torch.nn.Module):
    """A student that asks for nothing."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self._size = size

    def forward(self, observation: Tensor) -> Tensor:
        return observation.new_zeros(len(observation), self._size)


def test_a_teacher_is_learned_from_where_it_leads_and_nowhere_else(environment: Environment) -> None:
    taken: list[tuple[Tensor, Tensor]] = []
    step = environment.step

    def told(seen: dict[str, Tensor]) -> Tensor:
        taken.append((seen["policy"].clone(), torch.full((4, environment.action_size), 0.1)))
        return taken[-1][1]

    still = Still(environment.action_size)
    found = gather_corrections(environment, told, still, 7)
    assert len(taken) == environment.max_episode_steps
    length = torch.diff(found.ends.unique(), prepend=torch.tensor([-1]))
    assert int(length.sum()) == found.steps == len(found.ends)
    # Each stretch is the last of its environment's episode, as it was seen.
    for env, (end, count) in enumerate(zip(found.ends.unique().tolist(), length.tolist(), strict=True)):
        shown = torch.stack([seen[env] for seen, _ in taken[-count:]])
        torch.testing.assert_close(found.observed(torch.arange(end - count + 1, end + 1)), shown)
    assert (found.actions == 0.1).all()
    whole = gather_corrections(environment, told, None, 7)
    assert whole.steps == 4 * environment.max_episode_steps
    again = gather_corrections(environment, told, still, 7)
    torch.testing.assert_close(again.observation, found.observation)
    assert environment.step == step


def test_a_policy_is_corrected_by_the_expert_and_goes_on_with_its_corrections(
    environment: Environment, tmp_path: Path
) -> None:
    settings = replace(QUICK, iterations=3, teacher="expert", rounds=2, evaluate_every=3)
    trainer = ImitationTrainer(environment, settings, tmp_path / "whole", 0)
    begun = trainer._demonstrations.steps
    assert begun == 4 * environment.max_episode_steps
    Training(trainer, "Reach", {}).run(3, 1, lambda progress: None)
    assert len(trainer._corrections) == 2
    resumed = ImitationTrainer(environment, settings, tmp_path / "whole", 0)
    for name in ("policy_2.safetensors", "checkpoint_2.safetensors"):
        (tmp_path / "whole" / name).unlink()
    Training(resumed, "Reach", {}).run(3, 1, lambda progress: None, resume=True)
    assert len(resumed._corrections) == 2
    assert resumed._demonstrations.steps == trainer._demonstrations.steps > begun
    torch.testing.assert_close(resumed._corrections[0].actions, trainer._corrections[0].actions)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"teacher": "exprt"}, "exprt"),
        ({"teacher": "expert", "rounds": 0}, "'rounds' is at least 1, not 0"),
        ({}, "give --dataset FILE .* or --teacher expert"),
    ],
)
def test_teachers_that_are_none_are_told(
    settings: dict, message: str, environment: Environment, tmp_path: Path
) -> None:
    with pytest.raises(OrbitError, match=message):
        ImitationTrainer(environment, replace(QUICK, **settings), tmp_path, 0)
