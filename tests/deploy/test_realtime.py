"""Real-time priority is held for a block only, and passed on only where that is wanted."""

from __future__ import annotations

import os
import threading

import pytest

from orbit_deploy.realtime import RealtimeLoop, prioritized


def _in_thread() -> int:
    found: list[int] = []
    thread = threading.Thread(target=lambda: found.append(os.sched_getscheduler(0)))
    thread.start()
    thread.join()
    return found[0]


@pytest.mark.parametrize("inherited", [True, False])
def test_priority_ends_with_its_block_and_is_inherited_only_if_wanted(inherited: bool) -> None:
    before = os.sched_getscheduler(0)
    with prioritized(inherited) as missing:
        if any("priority" in sentence for sentence in missing):
            pytest.skip("capability 'real-time priority' is not permitted to this process")
        assert os.sched_getscheduler(0) & os.SCHED_FIFO
        assert _in_thread() == (os.SCHED_FIFO if inherited else os.SCHED_OTHER)
    assert os.sched_getscheduler(0) == before
    assert _in_thread() == before


def test_a_loop_counts_its_cycles_and_how_late_they_were() -> None:
    left = [20]

    def going() -> bool:
        left[0] -= 1
        return left[0] >= 0

    loop = RealtimeLoop(1000.0)
    loop.run(lambda: None, going)
    assert loop.times.cycles == 20
    assert 0.0 <= loop.times.within_half_ms <= 1.0
    assert loop.times.percentiles[0] >= 0.0
