"""Networks of others: what a program or an installed package registers may stand in a policy's file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from torch import nn

from orbit_core.interfaces import OrbitError
from orbit_learn import policy_file
from orbit_learn.description import Part, PolicyDescription
from orbit_learn.policy import Policy, load_policy
from orbit_learn.policy_file import register_network

DESCRIPTION = PolicyDescription(
    "Reach", "a_robot", "joint_position", (Part("seen", 3),), (Part("moved", 2),), 0.02, "an_engine", "a_library", 1
)


@dataclass(frozen=True)
class Linear:
    """A network of somebody else's."""

    name: ClassVar[str] = "somebodys_linear"
    gain: float

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        if self.gain <= 0.0:
            raise RuntimeError("a gain is positive")
        return nn.Sequential(nn.Linear(observation_size, action_size), nn.Hardtanh(-self.gain, self.gain))


@pytest.fixture
def _own_networks() -> Iterator[None]:
    """What a test registers is forgotten after it."""
    policy_file._networks.cache_clear()
    yield
    policy_file._networks.cache_clear()


@pytest.mark.usefixtures("_own_networks")
def test_an_installed_package_brings_networks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By an entry point, as a package would; a file then names it."""
    code = f"from {__name__} import Linear\n\nclass Theirs(Linear):\n    name = 'theirs'\n"
    (tmp_path / "their_networks.py").write_text(code)
    about = tmp_path / "their_networks-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-networks\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[orbit.networks]\nany = their_networks:Theirs\n")
    monkeypatch.syspath_prepend(tmp_path)
    network = policy_file.network_type("theirs")(gain=0.5)  # pyright: ignore[reportCallIssue]
    module = network.build(3, 2)
    Policy(module, network, DESCRIPTION).save(tmp_path / "policy_1.safetensors")
    assert load_policy(tmp_path).network == network
    Policy(module, replace(network, gain=-1.0), DESCRIPTION).save(tmp_path / "policy_1.safetensors")
    with pytest.raises(OrbitError, match="cannot be built"):
        load_policy(tmp_path)


@pytest.mark.usefixtures("_own_networks")
def test_a_program_brings_networks(tmp_path: Path) -> None:
    network = Linear(0.5)
    theirs = Policy(network.build(3, 2), network, DESCRIPTION)
    with pytest.raises(OrbitError, match="unknown network 'somebodys_linear'"):
        theirs.save(tmp_path / "policy_1.safetensors")
    register_network(Linear)
    theirs.save(tmp_path / "policy_1.safetensors")
    read = load_policy(tmp_path)
    observation = torch.randn(5, 3)
    assert read.network == network
    assert torch.equal(read.module(observation), theirs.module(observation))
    with pytest.raises(OrbitError, match="is registered twice"):
        register_network(type("Other", (Linear,), {}))
