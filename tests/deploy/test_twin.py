"""A twin follows what a robot is commanded, live and from logs, and says how far it is off; pages show both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError
from orbit_deploy.cli.twin import TwinSettings
from orbit_deploy.cli.twin import run as run_twin
from orbit_deploy.description import RobotDescription
from orbit_deploy.log_replay import placements, predict
from orbit_deploy.messages import Arrangement
from orbit_deploy.motion_log import MotionLog
from orbit_deploy.simulated import Imperfections
from orbit_deploy.twin import LiveTwin, TwinResult, play, replay_twin
from tests.deploy.rig import PERIOD, arm, lockstep

BACKEND = default_backend()


def differences(imperfections: Imperfections | None) -> list[float]:
    """Largest difference of a twin from the robot after each command."""
    found: list[float] = []
    with lockstep(imperfections) as link:
        twin = LiveTwin(arm(), BACKEND, dt=0.001)
        for step in range(40):
            link.send([0.3 * float(np.sin(0.1 * step))] * 3, [0.0] * 3, [0.0] * 3)
            link.wait(link.now() + PERIOD)
            found.append(float(np.abs(twin.follow(link.state())).max()))
        twin.close()
    return found


def test_a_live_twin_stays_with_a_robot_that_is_as_described_and_shows_friction() -> None:
    assert max(differences(None)) < 2e-3
    assert max(differences(Imperfections(friction=0.1))) > 5e-3


def test_a_twin_goes_along_with_a_robot_that_was_put_elsewhere() -> None:
    with lockstep() as link:
        twin = LiveTwin(arm(), BACKEND)
        twin.follow(link.state())
        state = link.arrange(Arrangement(positions=[0.5, -0.5, 0.2]))
        twin.restart(state)
        assert twin.positions == pytest.approx([0.5, -0.5, 0.2], abs=1e-5)
        link.wait(link.now() + 1.0)
        assert np.abs(twin.follow(link.state())).max() < 1e-3
        twin.close()


def moved_log() -> MotionLog:
    times = np.arange(0.0, 0.5, 0.004)
    target = np.stack([0.2 * np.sin(5.0 * times + joint) for joint in range(3)], 1)
    zero = np.zeros_like(target)
    log = MotionLog(("joint0", "joint1", "joint2"), times, target, zero, zero, target, zero, zero, "made")
    position = predict(log, arm(), BACKEND)
    return MotionLog(
        log.joints, times, target, zero, zero, position, np.gradient(position, 0.004, axis=0), zero, "made"
    )


def test_a_replayed_log_says_how_far_each_joint_is_off() -> None:
    log = moved_log()
    assert replay_twin(log, arm(), BACKEND).rms < 5e-3
    log.position[:, 1] += np.linspace(0.0, 0.2, len(log.times))
    result = replay_twin(log, arm(), BACKEND)
    assert result.by_joint["joint1"] == pytest.approx(0.2 / np.sqrt(3.0), rel=0.1)
    assert result.by_joint["joint2"] < 0.01


def test_a_robot_that_was_put_elsewhere_takes_the_replay_along() -> None:
    log = moved_log()
    half = len(log.times) // 2
    log.position[half:] += 0.4
    log.target[half:] += 0.4
    assert placements(log, RobotDescription.of(arm())) == [half]
    assert replay_twin(log, arm(), BACKEND).rms < 0.01


def test_playing_shows_rows_at_their_times() -> None:
    log, rows, waits = moved_log(), [], []
    result = TwinResult(BACKEND, log.position, 0.0, {}, 0.0)
    play(log, result, lambda when, row: rows.append((when, row)), waits.append, speed=2.0, rate=20.0)
    assert [log.times[row] for _, row in rows] == pytest.approx([when for when, _ in rows], abs=0.005)
    assert rows[1][0] == pytest.approx(0.1)
    assert sum(waits) == pytest.approx(0.25, abs=0.06)


def test_the_command_replays_a_csv_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orbit_assets.catalogue.robot", lambda name: arm())
    moved_log().write_csv(tmp_path / "arm.csv")
    settings = TwinSettings(
        log=tmp_path / "arm.csv", robot="three_joints", backend=(BACKEND,), dt=0.004, csv=tmp_path / "again.csv"
    )
    found = run_twin(settings)
    assert found[BACKEND]["joint1"] < 0.01
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "arm.csv").read_text()


def test_a_twin_of_a_robot_that_walks_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="base of 'three_joints' moves"):
        LiveTwin(replace(arm(), fixed_base=False), BACKEND)


def test_a_page_shows_the_robot_its_ghost_and_the_lines_of_the_chosen_joint() -> None:
    pytest.importorskip("viser", reason="the extra orbit-core[viewer] is not installed")
    from orbit_viewer.robot_page import RobotPage

    with RobotPage(arm(), ("commanded", "measured"), seconds=1.05, port=8390) as page:
        for step in range(30):
            position = np.array([0.1, 0.2, 0.3]) * step
            page.show(0.1 * step, position, np.stack((position + 0.01, position)), position)
        shown = page.series()
        assert shown["time"][0] == pytest.approx(1.9)
        assert shown["commanded"] - shown["measured"] == pytest.approx(0.01)
        assert page.url.startswith("http://127.0.0.1:")
