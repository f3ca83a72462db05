"""Real-time priority of the process that serves or drives a robot."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from orbit_deploy.realtime import prioritize


def _locked() -> str:
    found = re.search(r"VmLck:\s*(\d+)", Path("/proc/self/status").read_text(encoding="utf-8"))
    return found[1] if found else ""


def test_priority_and_locked_memory_end_with_the_block() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, _locked()
    with prioritize() as missing:
        inside = os.sched_getscheduler(0), _locked()
    if not missing:
        assert inside[0] == os.SCHED_FIFO
        assert int(inside[1]) > 0
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, _locked()) == before


def test_they_end_with_a_block_that_fails() -> None:
    before = os.sched_getscheduler(0), _locked()
    with pytest.raises(InterruptedError), prioritize():
        raise InterruptedError
    assert (os.sched_getscheduler(0), _locked()) == before
