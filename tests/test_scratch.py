"""Temporary folders: gone at the end, and swept by the next start where their owner was killed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from orbit_core.plugin_kit.scratch import ScratchFolder, sweep

_KILLED = """
import os, sys
from pathlib import Path
from orbit_core.plugin_kit.scratch import ScratchFolder
folder = ScratchFolder("orbit-test-", Path(sys.argv[1]))
(folder.path / "state").write_text("held")
print(folder.path.name, flush=True)
sys.stdin.read()
"""


def test_a_folder_is_removed_at_the_end_and_not_by_a_fork(tmp_path: Path) -> None:
    scratch = ScratchFolder("orbit-test-", tmp_path)
    pid = os.fork()
    if pid == 0:
        scratch.remove()
        os._exit(0)
    os.waitpid(pid, 0)
    assert scratch.path.is_dir()
    scratch.remove()
    scratch.remove()
    assert not list(tmp_path.iterdir())


def test_the_next_start_sweeps_what_a_killed_process_left_and_nothing_else(tmp_path: Path) -> None:
    foreign = [tmp_path / "orbit-results", tmp_path / "thesis"]
    for folder in foreign:
        folder.mkdir()
        (folder / "notes").write_text("mine")
    outside = tmp_path / "elsewhere"
    with ScratchFolder("orbit-live-", tmp_path) as live:
        process = subprocess.Popen(
            [sys.executable, "-c", _KILLED, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        left = tmp_path / process.stdout.readline().strip()
        sweep(tmp_path)
        assert (left / "state").read_text() == "held", "its owner lives"
        process.kill()
        process.communicate()
        left.rename(outside)
        left.symlink_to(outside)
        sweep(tmp_path)
        assert (outside / "state").exists(), "links are not followed"
        left.unlink()
        outside.rename(left)
        with ScratchFolder("orbit-next-", tmp_path):
            assert not left.exists()
        assert live.is_dir()
    assert sorted(tmp_path.iterdir()) == sorted(foreign)
    assert all((folder / "notes").read_text() == "mine" for folder in foreign)
