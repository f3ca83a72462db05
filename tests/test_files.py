"""Files are whole or not there, and what the file system refuses is one sentence."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from orbit_core import files
from orbit_core.files import Replacement, append_line, check_apart, sweep, written_whole
from orbit_core.interfaces import ConfigurationError, StorageError
from orbit_data.folder_lock import FolderLock
from tests.faults import kills, no_file_beyond


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


# Folders -------------------------------------------------------------------------------------------------------------


def filled(folder: Path, text: str) -> None:
    """A folder of three files that hold the same text."""
    (folder / "inner").mkdir(parents=True)
    for name in ("a", "inner/b", "inner/c"):
        (folder / name).write_text(text)


def texts(folder: Path) -> set[str]:
    return {path.read_text() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(params=["exchanged", "renamed"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """With file systems that exchange two names in one step, and with those that do not."""
    if request.param == "renamed":
        monkeypatch.setattr(files, "_exchange", lambda first, second: False)
    return request.param


def test_a_folder_takes_the_place_of_another_and_leaves_nothing_beside_it(way: str, tmp_path: Path) -> None:
    target = tmp_path / "data"
    for text in ("before", "after"):
        with written_whole(target) as written:
            filled(written, text)
            assert not target.exists() or texts(target) == {"before"}
        assert texts(target) == {text}
        assert [*tmp_path.iterdir()] == [target]


def test_an_error_leaves_the_folder_that_was_there(way: str, tmp_path: Path) -> None:
    target = tmp_path / "data"
    filled(target, "before")
    with pytest.raises(ZeroDivisionError), written_whole(target) as written:
        filled(written, str(1 // (len(texts(target)) - 1)))
    assert texts(target) == {"before"}
    assert [*tmp_path.iterdir()] == [target]


def test_a_kill_at_any_moment_leaves_the_old_folder_or_the_new_one(way: str, tmp_path: Path) -> None:
    target, found = tmp_path / "data", set()

    def replace() -> None:
        with written_whole(target) as written:
            filled(written, "after")

    def prepare() -> None:
        shutil.rmtree(target, ignore_errors=True)
        filled(target, "before")

    for _ in kills(tmp_path, replace, prepare):
        if way == "renamed":
            sweep(tmp_path)  # gives back what a kill between two renamings left without a name
        assert len(texts(target)) == 1
        assert len([path for path in target.rglob("*") if path.is_file()]) == 3
        found |= texts(target)
        sweep(tmp_path)
        assert [*tmp_path.iterdir()] == [target]
    assert found == {"before", "after"}


def test_what_dead_writers_left_is_swept_and_nothing_else(tmp_path: Path) -> None:
    own = {".orbit-notes.partial", ".x.0123abcd.hdf5", ".hidden"}
    for name in own:
        (tmp_path / name).mkdir()
    (tmp_path / ".orbit-01234567.partial").mkdir()
    alive = Replacement(tmp_path / "x")
    sweep(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*own, alive.written.parent.name}
    # As a kill leaves it between two renamings, where the file system does not exchange names.
    filled(tmp_path / ".orbit-89abcdef.partial" / "replaced" / "data", "before")
    filled(tmp_path / ".orbit-89abcdef.partial" / "data", "after")
    sweep(tmp_path)
    assert texts(tmp_path / "data") == {"before"}
    assert not (tmp_path / ".orbit-89abcdef.partial").exists()
    alive.written.write_text("whole")
    alive.take_place()
    assert (tmp_path / "x").read_text() == "whole"


def test_a_line_is_appended_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    append_line(path, "first")
    with no_file_beyond(100), pytest.raises(StorageError, match=r"cannot write .*/lines: File too large"):
        append_line(path, "second" * 100)
    append_line(path, "third")
    assert path.read_text() == "first\nthird\n"


def test_an_output_that_would_destroy_what_is_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, inner = tmp_path / "proj" / "in.hdf5", tmp_path / "proj" / "inner"
    inner.mkdir(parents=True)
    source.touch()
    (tmp_path / "link").symlink_to(tmp_path / "proj")
    monkeypatch.chdir(inner)
    for output, inputs, message in (
        (source, (source,), "is what is read"),
        (Path("../in.hdf5"), (source,), "is what is read"),
        (tmp_path / "link", (source,), "holds .*in.hdf5, which is read"),
        (tmp_path / "link" / "inner" / "out", (tmp_path / "proj",), "is in .*proj, which is read"),
        (Path(), (), "is the working folder, or holds it"),
        (Path(".."), (), "is the working folder, or holds it"),
        (tmp_path, (), "is the working folder, or holds it"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            check_apart(output, inputs)
    check_apart(inner / "out", (source,))


def test_a_lock_follows_no_link(tmp_path: Path) -> None:
    (tmp_path / "thesis").write_text("years")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".lock").symlink_to(tmp_path / "thesis")
    with pytest.raises(OSError, match="symbolic links"):
        FolderLock(tmp_path / "run")
    assert (tmp_path / "thesis").read_text() == "years"
