"""Wishes reach the simulation, from any thread, and the pace is real time."""

from __future__ import annotations

import threading

import pytest

from orbit_viewer.panel import Controls, Pacer, Selection


def test_paused_takes_only_the_steps_asked_for() -> None:
    controls = Controls(num_envs=1)
    assert controls.take_step()
    controls.pause()
    assert not controls.take_step()
    controls.single_step()
    controls.single_step()
    assert [controls.take_step() for _ in range(3)] == [True, True, False]
    controls.single_step()
    controls.play()
    controls.pause()
    assert not controls.take_step(), "playing uses up the single steps"


def test_a_single_step_pauses() -> None:
    controls = Controls(num_envs=1)
    controls.single_step()
    assert controls.paused


def test_a_reset_is_granted_once() -> None:
    controls = Controls(num_envs=1)
    assert not controls.take_reset()
    controls.reset()
    assert [controls.take_reset() for _ in range(2)] == [True, False]


def test_the_selection_stays_within_the_world() -> None:
    controls = Controls(num_envs=8)
    controls.select(first=7)
    assert controls.selection == Selection(7, 1)
    controls.select(count=3)
    assert controls.selection == Selection(5, 3)
    controls.select(count=100, markers=False)
    assert controls.selection == Selection(0, 8, markers=False)
    controls.select(frames=True)
    assert controls.selection == Selection(0, 8, markers=False, frames=True)


def test_a_wish_wakes_the_one_who_waits() -> None:
    controls = Controls(num_envs=1, paused=True)
    thread = threading.Timer(0.05, controls.play)
    thread.start()
    controls.wait(30.0)
    assert not controls.paused
    thread.join()


def test_the_pace_is_kept_but_lost_time_is_not_made_up() -> None:
    now = [10.0]
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    pacer = Pacer(clock=lambda: now[0], sleep=sleep)
    pacer.wait(0.1)
    now[0] += 0.03
    pacer.wait(0.1)
    assert slept == pytest.approx([0.07])
    now[0] += 5.0
    pacer.wait(0.1)
    pacer.wait(0.1)
    assert slept == pytest.approx([0.07, 0.1])
