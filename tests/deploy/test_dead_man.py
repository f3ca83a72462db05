"""The dead-man key on a real terminal, and a robot that moves only after the countdown and while the key is held."""

from __future__ import annotations

import os
import pty
from collections.abc import Iterator

import pytest
from msgspec import structs

from orbit_core.backends import default_backend
from orbit_core.envs.configuration import configure
from orbit_core.envs.registry import task_entry
from orbit_core.interfaces import ConfigurationError
from orbit_deploy import dead_man
from orbit_deploy.cli.deploy import DeploySettings, deploy
from orbit_deploy.dead_man import DeadManKey, ReleasedError
from orbit_deploy.follower import PathKind
from orbit_deploy.local import LocalLink
from orbit_deploy.messages import Arrangement
from orbit_deploy.simulated import SimulatedHardware


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """Ends of a terminal: the one that types, and the one that is read."""
    typing, read = pty.openpty()
    yield typing, read
    os.close(read)


def test_a_key_is_held_from_its_first_character_until_shortly_after_the_last_one(
    terminal: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [100.0]
    monkeypatch.setattr(dead_man.time, "monotonic", lambda: clock[0])
    key = DeadManKey(terminal[1])
    assert not key.held
    os.write(terminal[0], b"x")
    assert not key.held
    os.write(terminal[0], b" ")
    assert key.held
    # The terminal repeats after half a second, then every 30 ms.
    clock[0] += 0.5
    os.write(terminal[0], b" ")
    assert key.held
    clock[0] += 0.2
    assert key.held
    clock[0] += 0.1
    assert not key.held
    with pytest.raises(ReleasedError, match="was released: the robot stops"):
        key.check()
    key.close()
    os.close(terminal[0])


def test_a_terminal_that_is_closed_is_a_released_key(terminal: tuple[int, int]) -> None:
    key = DeadManKey(terminal[1])
    os.write(terminal[0], b" ")
    assert key.held
    os.close(terminal[0])
    with pytest.raises(ReleasedError, match="terminal of the dead-man key is closed"):
        key.check()
    with pytest.raises(ConfigurationError, match="standard input is none"):
        DeadManKey(os.open(os.devnull, os.O_RDONLY))


def _link(period: float, path: PathKind) -> LocalLink:
    task = configure(task_entry("Reach").task_type(), {})
    link = LocalLink(SimulatedHardware(task.scene(), default_backend(), 250.0), period, path=path)
    # Away from home, and as a real robot, which nobody puts elsewhere.
    link.arrange(Arrangement(positions=[*(0.2 + value for value in link.description.home[:7]), 0.02, 0.02]))
    link.description = structs.replace(link.description, arranges=False)
    return link


def test_a_real_robot_does_not_move_before_the_countdown_and_stops_when_the_key_is_released(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[LocalLink] = []
    still: list[float] = []

    def connect(address: str, period: float, keys: None, path: PathKind) -> LocalLink:
        made.append(_link(period, path))
        return made[-1]

    class Key:
        """Key that is released in the way home."""

        def wait(self) -> None:
            still.append(abs(made[0].state().positions[0] - made[0].description.home[0]))

        def check(self) -> None:
            moved = abs(made[0].state().positions[0] - made[0].description.home[0])
            if moved < 0.15:
                raise ReleasedError("released")

        def close(self) -> None:
            """Do nothing, because nothing is open."""

    monkeypatch.setattr("orbit_deploy.link.connect", connect)
    monkeypatch.setattr(dead_man, "DeadManKey", Key)
    settings = DeploySettings(agent="expert", task="Reach", countdown=0.0, dead_man=True, table=False)
    with pytest.raises(ReleasedError):
        deploy(settings)
    assert still[0] == pytest.approx(0.2, abs=0.01)
    state = made[0].state()
    assert made[0].computer.follower.limiter.at_rest
    assert 0.02 < abs(state.positions[0] - made[0].description.home[0]) < 0.16
