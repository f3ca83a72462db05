"""The folder of a run: records on disk as they come, so that a run that was killed goes on where it was."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from orbit_conformance.courses import Course
from orbit_conformance.execution import Outcome
from orbit_conformance.results import RESULT_FILE, Header, Parting, Record, Result, decode, encode, save
from orbit_conformance.sources import CORE, sources_of
from orbit_core.files import append_line, storage_faults, sweep, written_whole
from orbit_core.interfaces import ConfigurationError
from orbit_data.folder_lock import LOCK, FolderLock

JOURNAL = "journal.jsonl"
PREVIOUS, DROPPED = "previous.json", "previous.jsonl"
"""Result of the finished run, and journal of the unfinished one, that another has taken the place of."""
LOG = "log.txt"


def now() -> str:
    """The time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


class Journal:
    """Journal of records in a file of JSON lines, flushed to the disk; the first line is the run's header.

    An unfinished run is resumed, without the records of a backend, a task, a policy or scenarios whose source has
    changed since; a finished one starts again, and its result is kept as ``previous.json``. No other process may write
    into the folder until the journal is closed.

    Args:
        folder: of the run.
        header: of the run.
        fresh: start again instead of resuming an unfinished run, whose journal is kept as ``previous.jsonl``.

    Raises:
        ConfigurationError: the folder holds other things and no run, an unfinished run of other settings, versions or
            another core, or the journal of one is no journal; or another process writes into it.
        StorageError: then and later, the disk is full, or the folder cannot be written.
    """

    def __init__(self, folder: Path, header: Header, fresh: bool = False) -> None:
        self.folder = folder
        self.header = header
        self.records: dict[str, Record] = {}
        """Records so far by the job's key."""
        self.dropped = ""
        """What has changed, and how many records were dropped for it, in words; empty if none was."""
        self._path = folder / JOURNAL
        with storage_faults(folder):
            folder.mkdir(parents=True, exist_ok=True)
            _check_folder(folder)
            sweep(folder)
            self._lock = FolderLock(folder)
        try:
            self._begin(fresh)
        except BaseException:
            self._lock.release()
            raise

    def add(self, outcome: Outcome) -> None:
        """Keep an outcome: its files first, so that a record's files are always there."""
        record = outcome.record
        own = self.folder / record.job.key
        with storage_faults(self._path):
            for name, content in outcome.files.items():
                own.mkdir(parents=True, exist_ok=True)
                with written_whole(own / name) as path:
                    path.write_bytes(content)
            append_line(self._path, encode(record))
        self.records[record.job.key] = record

    def finish(self, partings: Iterable[Parting] = (), courses: Iterable[Course] = ()) -> Result:
        """Write the result; the journal has done its work."""
        records = tuple(self.records.values())
        taken = {"partings": tuple(partings), "courses": tuple(courses)}
        result = Result(header=self.header, records=records, **taken, finished=now())
        save(result, self.folder)
        self._path.unlink()
        return result

    def close(self) -> None:
        """Release the folder and leave the run as it is, to be resumed."""
        self._lock.release()

    def _begin(self, fresh: bool) -> None:
        result = self.folder / RESULT_FILE
        with storage_faults(self._path):
            finished = result.exists()
            if not finished and self._path.exists() and fresh:
                with written_whole(self.folder / DROPPED) as path:
                    path.write_bytes(self._path.read_bytes())
            elif not finished and self._path.exists():
                self._resume()
            lines = [encode(self.header), *map(encode, self.records.values())]
            with written_whole(self._path) as path:
                path.write_text("".join(f"{line}\n" for line in lines))
            if finished:  # once the new run has begun
                result.replace(self.folder / PREVIOUS)

    def _resume(self) -> None:
        """Take over the records of an unfinished run, except those that other code made."""
        lines = self._path.read_bytes().splitlines(keepends=True)
        whole = [line for line in lines if line.endswith(b"\n")]  # a kill may have torn the last one
        if not whole:
            return
        try:
            old = decode(whole[0], Header)
            records = [decode(line, Record) for line in whole[1:]]
        except ValueError as error:
            raise ConfigurationError(f"{self._path} is no journal of this version ({error}): {_REMEDY}") from error
        if differing := _differing(old, self.header):
            raise ConfigurationError(f"folder {self.folder} holds an unfinished run of other {differing}: {_REMEDY}")
        changed = {name for name, digest in old.sources.items() if self.header.sources.get(name) != digest}
        kept = [record for record in records if not changed & sources_of(record.job)]
        if len(kept) < len(records):
            again = f"{len(records) - len(kept)} of {len(records)} jobs"
            self.dropped = f"{', '.join(sorted(changed))} changed: to be done again are {again}"
        self.records = {record.job.key: record for record in kept}
        self.header = replace(self.header, started=old.started)


def _check_folder(folder: Path) -> None:
    """Reject a folder that holds things, but no run: files of theirs could have the names of ours."""
    # A folder with a lock or a log only is one of a run that ended before its first record.
    found = {path.name for path in folder.iterdir()}
    if found - {LOCK, LOG} and not found & {JOURNAL, RESULT_FILE, PREVIOUS}:
        raise ConfigurationError(f"folder {folder} holds other things and no run of this suite: give another --output")
    if (folder / LOG).is_symlink():
        raise ConfigurationError(f"{folder / LOG} is a link, which is not written through: remove it first")


_REMEDY = "--fresh begins anew, another --output keeps it"


def _differing(old: Header, new: Header) -> str:
    """The settings in which two headers differ, in words; empty if they are of the same run."""
    pairs = {
        "settings": (encode(old.settings), encode(new.settings)),  # as JSON has them: lists for tuples
        "versions": (old.versions, new.versions),
        "hardware": (old.hardware, new.hardware),
        f"source of {CORE}": (old.sources.get(CORE), new.sources.get(CORE)),
    }
    return " and ".join(name for name, (before, after) in pairs.items() if before != after)
