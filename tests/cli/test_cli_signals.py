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

from orbit_core.cli import main
from orbit_core.plugin_kit.scratch import ScratchFolder

CODE = "import sys; from orbit_core.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)])
def test_a_command_that_is_told_to_end_cleans_up(tmp_path: Path, number: signal.Signals, code: int) -> None:
    """With workers of its own, a folder for them, and a video half done; after a kill, the next start does."""
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
        _await(lambda: list(tmp_path.glob(".orbit-*.partial/*.mp4")), process)  # the video has begun: all is made
        workers = psutil.Process(process.pid).children(recursive=True)
        assert len(workers) >= 2
        process.send_signal(number)
        _, told = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == code, told
    assert "Traceback" not in told
    assert not psutil.wait_procs(workers, timeout=10)[1], "workers are left"
    if number is signal.SIGKILL:
        assert list(temporary.glob("orbit-*"))
        ScratchFolder("orbit-next-", temporary).remove()
    else:
        assert not list(tmp_path.glob(".*")), "a piece of the video is left"
    assert not list(temporary.iterdir())


def _await(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_request_to_end_while_workers_start_prints_no_traceback(number: signal.Signals, code: int) -> None:
    words = ["run", "Reach", "--backend", "bullet", "--num-envs", "4", "--setting", "workers=2", "--agent", "zero"]
    process = subprocess.Popen(
        [sys.executable, "-c", CODE, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        _await(lambda: len(psutil.Process(process.pid).children()) >= 2, process)
        os.killpg(process.pid, number) if number is signal.SIGINT else process.send_signal(number)
        _, told = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == code, told
    assert "Traceback" not in told


SCRIPTED = """
import hashlib, sys, time
from orbit_core import cli

def swallow(words):
    "Lose the exception as often as the first word says, then clean up for longer than it takes to be raised again."
    for _ in range(int(words[0])):
        try:
            while True:
                print("runs", flush=True)
                time.sleep(0.02)
        except BaseException:
            pass
    try:
        while True:
            time.sleep(0.02)
    finally:
        for _ in range(15):
            time.sleep(0.1)
        print("closed", flush=True)

def give_in(words):
    try:
        while True:
            print("runs", flush=True)
            time.sleep(0.02)
    except KeyboardInterrupt:
        pass

def stick(words):
    print("runs", flush=True)
    hashlib.pbkdf2_hmac("sha1", b"", b"", 2**31 - 1)

for command in (swallow, give_in, stick):
    cli.commands().add(command.__name__, command)
sys.exit(cli.main(sys.argv[1:]))
"""
"""Commands that need no torch, and end as badly as those of a library may."""
TERM, INTERRUPT = signal.SIGTERM, signal.SIGINT


@pytest.mark.parametrize(
    ("words", "signals", "code", "last"),
    [
        (("swallow", "2"), (TERM,), 143, "closed"),
        (("swallow", "1"), (INTERRUPT,), 130, "closed"),
        (("give_in",), (TERM,), 143, "runs"),
        (("give_in",), (INTERRUPT,), 130, "runs"),
        (("swallow", "9"), (TERM, TERM), -TERM, "runs"),
        (("swallow", "9"), (TERM, INTERRUPT), -INTERRUPT, "runs"),
        (("swallow", "9"), (INTERRUPT, TERM), -TERM, "runs"),
        (("swallow", "9"), (INTERRUPT, INTERRUPT), -INTERRUPT, "runs"),
        (("stick",), (TERM, TERM), -TERM, "runs"),
        (("stick",), (INTERRUPT, INTERRUPT), -INTERRUPT, "runs"),
    ],
)
def test_the_first_request_is_heard_and_the_second_ends_the_process(
    words: tuple[str, ...], signals: tuple[signal.Signals, ...], code: int, last: str
) -> None:
    """Whether the exception is swallowed, handled, or never raised since the process is in native code."""
    process = subprocess.Popen([sys.executable, "-c", SCRIPTED, *words], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "runs\n"
        time.sleep(0.1)
        for number in signals:
            process.send_signal(number)
            time.sleep(0.1)
        told, _ = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == code
    assert ["runs", *told.split()][-1] == last


def test_handlers_are_those_from_before_after_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    before = [signal.getsignal(number) for number in (TERM, INTERRUPT)]
    assert main(["--version"]) == 0
    assert [signal.getsignal(number) for number in (TERM, INTERRUPT)] == before
