"""What a person inspects in the viewer: signals, selection, the past, videos, the camera."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from playwright.sync_api import Page

from orbit_core.envs import Environment, make
from orbit_core.rollout.pictures import Spectator
from orbit_viewer.history import SECONDS, History
from orbit_viewer.scene_view import Frame
from orbit_viewer.signals import TaskSignals, world_signals
from orbit_viewer.viewer import Viewer


class Still:
    """Holds the action zero."""

    def __init__(self, environment: Environment) -> None:
        self._action = torch.zeros(environment.num_envs, environment.action_size)

    def act(self) -> torch.Tensor:
        return self._action


@pytest.fixture
def lift() -> Iterator[Environment]:
    environment = make("Lift", 2, "mujoco", seed=0)
    yield environment
    environment.close()


def frame(value: float, first: int = 0) -> Frame:
    return Frame(np.full((1, 1, 7), value, np.float32), np.zeros((1, 0, 7), np.float32), (), first)


def test_the_past_is_kept_for_a_minute_and_begins_again_with_another_choice() -> None:
    history = History()
    assert history.before(1.0) is None
    for second in range(int(SECONDS) + 20):
        history.add(float(second), frame(float(second)))
    last = SECONDS + 19
    for ago in (0.0, 5.0, SECONDS):
        seen = history.before(ago)
        assert seen is not None
        assert seen.link_poses[0, 0, 0] == last - ago
    oldest = history.before(10 * SECONDS)
    assert oldest is not None
    assert oldest.link_poses[0, 0, 0] == last - SECONDS
    history.add(last + 1.0, frame(0.5, first=1))
    only = history.before(30.0)
    assert only is not None
    assert only.first == 1


def test_signals_are_the_terms_of_the_reward_and_of_observations(lift: Environment) -> None:
    signals = TaskSignals(lift)
    lift.reset()
    named = signals.all() | world_signals(lift.world)
    assert named["reward terms"].components == tuple(lift.reward_terms)
    total = []
    for _ in range(3):
        observation, reward, *_ = lift.step(torch.zeros(2, lift.action_size))
        signals.after_step(observation)
        total.append((named["reward terms"].read(1).sum(), float(reward[1])))
    for summed, given in total:
        assert summed == pytest.approx(given, abs=1e-5)
    group = lift.observation["policy"]
    read = np.concatenate([named[f"policy: {name}"].read(1) for name in group.terms])
    np.testing.assert_allclose(read, observation["policy"][1].numpy(), atol=1e-6)
    robot = lift.world.robots["robot"]
    np.testing.assert_allclose(named["robot: joint positions, rad, m"].read(0), robot.joint_positions[0].numpy())
    np.testing.assert_allclose(named["cube: position, m"].read(1), lift.world.objects["cube"].root_pose[1, :3].numpy())


def test_curves_do_not_survive_a_reset_and_change_with_the_signal(lift: Environment) -> None:
    with Viewer(lift, Still(lift), port=8190, signals=TaskSignals(lift)) as viewer:
        panel: Any = viewer._panel
        viewer.run(max_steps=4)
        assert [len(column) for column in panel._plot.data] == [4, 4]
        panel._signal.value = "reward terms"
        viewer.run(max_steps=3)
        assert len(panel._plot.data) == 1 + len(lift.reward_terms)
        assert len(panel._plot.data[0]) == 3
        viewer._reset()
        assert [len(column) for column in panel._plot.data] == [1] * (1 + len(lift.reward_terms))


def test_curves_begin_again_with_another_environment(lift: Environment) -> None:
    with Viewer(lift, Still(lift), port=8190) as viewer:
        panel: Any = viewer._panel
        viewer.run(max_steps=4)
        viewer.controls.select(first=1)
        for _ in range(2):
            viewer._step()
        assert len(panel._points) == 2


def test_numbers_of_what_is_selected_are_of_the_moment_that_is_shown(lift: Environment) -> None:
    with Viewer(lift, Still(lift), port=8190) as viewer:
        inspector: Any = viewer._inspector
        inspector.select("cube")
        viewer.run(max_steps=2)
        cube = lift.world.objects["cube"]
        past = cube.root_pose[0, :3].tolist()
        moved = cube.root_pose.clone()
        moved[:, 0] += 0.1
        cube.set_root_pose(moved)
        for _ in range(3):
            viewer._step()
            viewer._show(soon=True)
        assert f"{past[0]:.3f}" not in inspector._state.content
        assert "velocity" in inspector._state.content
        viewer.controls.pause()
        viewer.controls.rewind(3.5 * lift.step_dt)
        viewer._show(soon=True)
        assert f"{past[0]:.3f}" in inspector._state.content
        assert "velocity" not in inspector._state.content


def test_forces_of_a_scene_without_contact_sensors_are_answered_in_words(lift: Environment) -> None:
    with Viewer(lift, Still(lift), port=8190) as viewer:
        inspector: Any = viewer._inspector
        inspector._change(forces=True)
        viewer._show(soon=True)
        assert "no contact sensor" in inspector._state.content


def test_a_pull_moves_what_is_selected_toward_the_grip(lift: Environment) -> None:
    with Viewer(lift, Still(lift), port=8190) as viewer:
        inspector: Any = viewer._inspector
        inspector.select("cube")
        viewer.run(max_steps=1)
        cube = lift.world.objects["cube"]
        start = cube.root_pose[:, :3].clone()
        inspector._change(pull=True)
        viewer._show(soon=True)
        target = start[0].numpy() + np.float32((0.0, 0.1, 0.15))
        inspector._hold(True)
        inspector._grip.position = target + viewer._scene.offset
        for _ in range(60):
            viewer._step()
        reached = cube.root_pose[:, :3]
        # Against gravity the spring gives way by g / omega^2, 0.11 m.
        np.testing.assert_allclose(reached[0, :2], target[:2], atol=0.02)
        assert reached[0, 2] > start[0, 2] + 0.02
        torch.testing.assert_close(reached[1], start[1], atol=0.01, rtol=0.0)
        inspector._change(pull=False)
        for _ in range(60):
            viewer._step()
        assert cube.root_pose[0, 2] == pytest.approx(float(start[0, 2]), abs=0.01)


def test_the_scene_is_there_before_the_first_reset(fakes: ModuleType) -> None:
    environment = fakes.FakeEnvironment()
    with Viewer(environment, fakes.FakeAgent(), port=8190) as viewer:
        assert environment.resets == 0
        assert viewer._scene.count == 1


def test_a_person_selects_by_click_rewinds_and_uses_keys(
    page: Page, person: ModuleType, fakes: ModuleType, tmp_path: Path
) -> None:
    environment = fakes.FakeEnvironment(num_envs=4)
    with Viewer(environment, fakes.FakeAgent(), port=8190, title="Things") as viewer:
        thread = threading.Thread(target=viewer.run)
        thread.start()
        try:
            inspector: Any = viewer._inspector
            page.set_viewport_size({"width": 900, "height": 640})
            page.goto(person.address(viewer))
            person.until(lambda: len(viewer._server.get_clients()) == 1, page)
            page.get_by_role("button", name="Pause").wait_for()
            person.until(lambda: environment.steps > 60, page)
            page.wait_for_timeout(2000)
            page.keyboard.press("Space")
            person.until(lambda: viewer.controls.paused, page)
            held = environment.steps
            page.keyboard.press("s")
            person.until(lambda: environment.steps == held + 1, page)
            page.wait_for_timeout(500)

            box = environment.world.link_poses[0, 0, :3].numpy() + viewer._scene.offset

            def click() -> None:
                page.mouse.click(*person.pixel(viewer, box))

            person.again(click, lambda: inspector.choices.selected == "box", page)
            page.get_by_text("position, m").first.wait_for()

            drawn = viewer._scene._bodies_drawn[0][1].batched_positions.copy()
            page.keyboard.press("ArrowLeft")
            person.until(lambda: viewer.controls.rewound >= 1.0, page)
            person.until(
                lambda: bool(np.abs(viewer._scene._bodies_drawn[0][1].batched_positions - drawn).max() > 0.01), page
            )
            assert environment.steps == held + 1
            page.screenshot(path=tmp_path / "inspected.png")
            page.keyboard.press("Space")
            person.until(lambda: environment.steps > held + 2, page)
            assert viewer.controls.rewound == 0.0

            # The camera goes where the box goes.
            inspector._change(follow=True)
            client = next(iter(viewer._server.get_clients().values()))
            page.wait_for_timeout(500)
            before = np.array(client.camera.position)
            person.until(lambda: bool(np.abs(np.array(client.camera.position) - before).max() > 0.05), page)
        finally:
            viewer.controls.stop()
            thread.join(10.0)


def test_a_recorded_video_goes_to_the_browser(lift: Environment, monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[tuple[str, bytes]] = []
    with Viewer(
        lift, Still(lift), port=8190, title="Lift", record=lambda width, height: Spectator(lift, width, height)
    ) as viewer:
        monkeypatch.setattr(viewer._server, "send_file_download", lambda name, data: saved.append((name, data)))
        viewer.controls.record()
        viewer.run(max_steps=4)
        assert not saved
        viewer.controls.record()
        viewer.run(max_steps=1)
    ((name, data),) = saved
    assert name == "Lift 1.mp4"
    assert data[4:8] == b"ftyp"
