"""A policy as a file: loaded, exported, refused where it does not fit, and as a node of the agent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from torch import nn

from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError
from orbit_core.learning.networks import NormalizedActor, perceptron
from orbit_core.learning.policy import ClippedPolicy, Policy, PolicyAgent, PolicyDescription, load_policy, whole_agent
from orbit_core.tasks import Environment, make

BACKEND = default_backend()


def untrained(environment: Environment) -> Policy:
    """Strong enough to move the robot, and clipped at times."""
    torch.manual_seed(0)
    size = environment.observation_size
    layers = nn.Sequential(perceptron(size, (32,), environment.action_size), nn.Hardtanh(-3.0, 3.0))
    actor = NormalizedActor(torch.randn(size), 0.1 + torch.rand(size), 5.0, layers)
    return Policy(ClippedPolicy(actor), PolicyDescription.of(environment, "Reach", "rsl-rl", 7))


def test_a_file_needs_no_orbit_and_says_what_it_is_for(tmp_path: Path) -> None:
    """TorchScript, ONNX and the policy itself do the same, for any number of environments."""
    environment = make("Reach", 2, BACKEND)
    policy = untrained(environment)
    policy.save(tmp_path / "policy_7.pt")
    policy.export_onnx(tmp_path / "policy.onnx")
    assert load_policy(tmp_path).description == policy.description
    assert policy.description.observation_size == environment.observation_size
    environment.close()

    script = torch.jit.load(tmp_path / "policy_7.pt")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    for count in (1, 7):
        observation = torch.randn(count, policy.description.observation_size)
        expected = policy.module(observation)
        assert expected.abs().max() == 1.0
        torch.testing.assert_close(script(observation), expected)
        (action,) = session.run(["action"], {"observation": observation.numpy()})
        np.testing.assert_allclose(action, expected.detach().numpy(), atol=1e-5)


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
        assert torch.equal(whole.observer(), stepped.observe()["policy"])
    assert (stepped.observe()["policy"] - start).abs().max() > 0.1
    stepped.close()
    whole.close()


def test_a_policy_refuses_what_it_was_not_learned_for(tmp_path: Path) -> None:
    environment = make("Reach", 1, BACKEND, action="ik_relative")
    untrained(environment).save(tmp_path / "policy_0.pt")
    environment.close()
    other = make("Reach", 1, BACKEND)
    with pytest.raises(ConfigurationError, match="ik_relative"):
        PolicyAgent(other, tmp_path)
    with pytest.raises(ConfigurationError, match="ik_relative"):
        whole_agent(other, load_policy(tmp_path))
    other.close()


def test_bad_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no policy_<iteration>"):
        load_policy(tmp_path)
    with pytest.raises(ConfigurationError, match="there is no policy"):
        load_policy(tmp_path / "policy_1.pt")
    (tmp_path / "policy_1.pt").write_bytes(b"no archive")
    with pytest.raises(ConfigurationError, match="is no policy of ORBIT"):
        load_policy(tmp_path)
