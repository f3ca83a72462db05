"""``orbit deploy`` runs an agent on a robot that measures no contacts, and refuses an agent that needs them."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from torch import Tensor

from orbit_core.backends import default_backend
from orbit_core.envs import Environment
from orbit_core.envs.configuration import configure
from orbit_core.envs.registry import task_entry
from orbit_core.interfaces import ConfigurationError
from orbit_core.sensors import ContactSensor
from orbit_deploy.cli.deploy import DeploySettings, deploy
from orbit_deploy.follower import PathKind
from orbit_deploy.local import LocalLink
from orbit_deploy.simulated import SimulatedHardware

SETTINGS = DeploySettings(
    agent="velocity_flat_go2", path="direct", countdown=0.0, set=("episode_length=1.0",), table=False
)


@pytest.fixture
def links(monkeypatch: pytest.MonkeyPatch) -> list[LocalLink]:
    """Every address leads to a Go2 in this process, whose task has a contact sensor."""
    made: list[LocalLink] = []

    def connect(address: str, period: float, keys: None, path: PathKind) -> LocalLink:
        task = configure(task_entry("Velocity-Flat").task_type(), {"robot": "unitree_go2"})
        hardware = SimulatedHardware(task.scene(), default_backend(), 500.0, direct=True)
        made.append(LocalLink(hardware, period, path=path))
        return made[-1]

    monkeypatch.setattr("orbit_deploy.link.connect", connect)
    return made


def test_a_task_whose_rewards_and_terminations_read_contacts_runs_on_a_robot_without_them(
    links: list[LocalLink], capsys: pytest.CaptureFixture[str]
) -> None:
    results = deploy(SETTINGS)
    assert results["success_rate"] == 1.0
    assert results["metrics"]["linear_error_m_s"] < 0.25
    assert results["steps"] == 50
    assert "contact forces (contacts) are not measured" in capsys.readouterr().out


@dataclass
class Feeler:
    """Actor whose action follows what the legs touch."""

    environment: Environment

    def act(self) -> Tensor:
        sensor = self.environment.world.sensors["contacts"]
        assert isinstance(sensor, ContactSensor)
        return sensor.forces[:, :12, 2]


def test_an_agent_that_reads_contacts_is_refused_before_the_robot_moves(
    links: list[LocalLink], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orbit_deploy.cli.deploy.make_actor", lambda agent, environment, seed: Feeler(environment))
    with pytest.raises(ConfigurationError, match=r"reads contact forces \(contacts\), which the robot's computer"):
        deploy(SETTINGS)
    assert links[0].computer.follower.accepted == -1
