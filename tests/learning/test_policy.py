"""A policy as a file: loaded, exported, refused where it does not fit, and as a node of the agent."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import safetensors
import torch

from orbit_core.backends import default_backend
from orbit_core.envs import Environment, make
from orbit_core.interfaces import ConfigurationError
from orbit_learn.networks import Perceptron, perceptron, perceptron_actor
from orbit_learn.policy import Policy, PolicyActor, PolicyDescription, load_policy, whole_agent

BACKEND = default_backend()


def untrained(environment: Environment) -> Policy:
    """Strong enough to move the robot, and clipped at times."""
    torch.manual_seed(0)
    size = environment.observation_size
    layers = perceptron(size, (32,), environment.action_size)
    actor = perceptron_actor(layers, torch.randn(size), 0.1 + torch.rand(size), 5.0)
    description = PolicyDescription.of(environment, "Reach", "rsl-rl", 7, {"torch": "2.0"})
    return Policy(actor.module, actor.network, description)


def test_a_policy_its_file_and_its_onnx_act_alike(tmp_path: Path) -> None:
    """Read by ORBIT, or by ONNX's own runtime, for any number of environments."""
    environment = make("Reach", 2, BACKEND)
    policy = untrained(environment)
    environment.close()
    policy.save(tmp_path / "policy_7.safetensors")
    policy.export_onnx(tmp_path / "policy.onnx")
    read, converted = load_policy(tmp_path), load_policy(tmp_path / "policy.onnx")
    assert read.description == converted.description == policy.description
    assert read.network == Perceptron((32,), observation_limit=5.0)

    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    for count in (1, 7):
        observation = torch.randn(count, policy.description.observation_size)
        expected = policy.module(observation)
        assert 1.0 == expected.abs().max() > expected.abs().min() + 0.5
        assert torch.equal(read.module(observation), expected)
        torch.testing.assert_close(converted.module(observation), expected, atol=1e-6, rtol=0.0)
        (action,) = session.run(["action"], {"observation": observation.numpy()})
        np.testing.assert_allclose(action, expected.detach().numpy(), atol=1e-5)
    with pytest.raises(ConfigurationError, match="read from ONNX"):
        converted.save(tmp_path / "policy_8.safetensors")
    assert {path.name for path in tmp_path.iterdir()} == {"policy_7.safetensors", "policy.onnx"}


def test_a_file_can_be_read_without_orbit(tmp_path: Path) -> None:
    """As the documentation says: the weights by safetensors alone, and the description as JSON beside them."""
    environment = make("Reach", 1, BACKEND)
    policy = untrained(environment)
    environment.close()
    policy.save(tmp_path / "policy_7.safetensors")
    with safetensors.safe_open(tmp_path / "policy_7.safetensors", framework="pt") as file:
        document = json.loads(file.metadata()["orbit"])
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no dictionary
    assert document["policy"]["versions"] == {"torch": "2.0"}
    assert document["network"] == {
        "name": "perceptron",
        "settings": {"hidden_sizes": [32], "activation": "elu", "observation_limit": 5.0, "squashed": False},
    }
    assert {*weights} == {*policy.module.state_dict()}


@pytest.mark.parametrize("task", ["Lift", "Velocity-Flat"])
def test_the_whole_agent_moves_the_robot_as_the_environments_step_does(task: str) -> None:
    """The policy in the cut's place, and nobody outside: the same trajectory, bit for bit."""
    stepped = make(task, 3, BACKEND, seed=4)
    whole = make(task, 3, BACKEND, seed=4)
    policy = untrained(stepped)
    agent = whole_agent(whole, policy)
    start = stepped.observe()["policy"].clone()
    for _ in range(12):
        with torch.no_grad():
            stepped.step(policy.module(stepped.observe()["policy"]))
        agent.step()
        whole.world.step(whole.task.decimation)
        assert torch.equal(whole.observer()["policy"], stepped.observe()["policy"])
    assert (stepped.observe()["policy"] - start).abs().max() > 0.1
    stepped.close()
    whole.close()


def test_a_policy_refuses_what_it_was_not_learned_for(tmp_path: Path) -> None:
    environment = make("Reach", 1, BACKEND, action="ik_relative")
    untrained(environment).save(tmp_path / "policy_0.safetensors")
    environment.close()
    other = make("Reach", 1, BACKEND)
    with pytest.raises(ConfigurationError, match="ik_relative"):
        PolicyActor(other, tmp_path)
    with pytest.raises(ConfigurationError, match="ik_relative"):
        whole_agent(other, load_policy(tmp_path))
    other.close()


def test_a_copy_of_an_actor_draws_no_random_numbers() -> None:
    """Else how often a training is saved would change what it learns."""
    layers, before = perceptron(3, (4,), 2), torch.get_rng_state()
    actor = perceptron_actor(layers)
    assert torch.equal(torch.get_rng_state(), before)
    observation = torch.full((1, 3), 0.1)
    assert torch.equal(actor.module(observation), layers(observation).clamp(-1.0, 1.0))
    with torch.no_grad():
        layers[0].weight.zero_()
    assert not torch.equal(actor.module(observation), layers(observation).clamp(-1.0, 1.0)), "a copy"
