"""Files are whole or not there, and what the file system refuses is one sentence."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from orbit_core.files import written_whole
from orbit_core.interfaces import StorageError


def test_a_file_takes_its_place_at_the_end_and_is_readable_by_others(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    target.write_text("before")
    with written_whole(target) as written:
        written.write_text("after")
        assert target.read_text() == "before"
        assert written.suffix == ".json"
    assert target.read_text() == "after"
    assert target.stat().st_mode & 0o044 == 0o044 & ~_umask()
    assert list(tmp_path.iterdir()) == [target]


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_an_error_leaves_what_was_there_and_no_other_file(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    target.write_text("before")
    with pytest.raises(KeyboardInterrupt), written_whole(target) as written:
        _interrupted(written)
    assert target.read_text() == "before"
    assert list(tmp_path.iterdir()) == [target]


def _interrupted(written: Path) -> None:
    written.write_text("half")
    raise KeyboardInterrupt


def test_what_cannot_be_written_is_named_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"cannot write .*/nowhere/x.json: No such file or directory"):  # noqa: SIM117
        with written_whole(tmp_path / "nowhere" / "x.json") as written:
            written.write_text("")


def test_a_full_disk_is_told_and_leaves_no_piece(tmp_path: Path) -> None:
    """A limit on the size of files is refused by the kernel as a full disk is."""
    code = (
        "import resource, signal, sys; from pathlib import Path; from orbit_core.files import written_whole;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n"
        "    with written_whole(Path(sys.argv[1])) as written: written.write_bytes(bytes(5000))\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    target = tmp_path / "large.bin"
    told = subprocess.run([sys.executable, "-c", code, str(target)], capture_output=True, text=True, check=True).stdout
    assert told.startswith(f"StorageError cannot write {target}: File too large")
    assert not list(tmp_path.iterdir())
