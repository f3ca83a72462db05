"""Whatever asks a command to end, it closes what it opened: files, folders and worker processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

CODE = "import sys; from orbit_core.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_command_that_is_told_to_end_cleans_up(tmp_path: Path, number: signal.Signals, code: int) -> None:
    """With workers of its own, a folder for them, and a video half done."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    video = tmp_path / "reach.mp4"
    words = [
        "run", "Reach", "--backend", "bullet", "--num-envs", "4", "--setting", "workers=2", "--episodes", "100000",
        "--agent", "zero", "--video", str(video), "--video-size", "64", "64",
    ]  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-c", CODE, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "TMPDIR": str(temporary)}, start_new_session=True,
    )  # fmt: skip
    try:
        _await(lambda: list(tmp_path.glob(".*mp4")), process)  # the video has begun: all is made
        workers = psutil.Process(process.pid).children(recursive=True)
        assert len(workers) >= 2
        os.killpg(process.pid, number) if number is signal.SIGINT else process.send_signal(number)
        _, told = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == code, told
    assert "Traceback" not in told
    assert not psutil.wait_procs(workers, timeout=10)[1], "workers are left"
    assert not list(temporary.iterdir())
    assert not list(tmp_path.glob(".*")), "a piece of the video is left"


def _await(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end
        time.sleep(0.05)


def test_an_interrupt_while_workers_start_prints_no_traceback() -> None:
    words = ["run", "Reach", "--backend", "bullet", "--num-envs", "4", "--setting", "workers=2", "--agent", "zero"]
    process = subprocess.Popen(
        [sys.executable, "-c", CODE, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        _await(lambda: len(psutil.Process(process.pid).children()) >= 2, process)
        os.killpg(process.pid, signal.SIGINT)
        _, told = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130, told
    assert "Traceback" not in told
