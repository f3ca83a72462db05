"""The folder of a run: records on disk as they come, so that a run that was killed goes on where it was."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from orbit_core.conformance.execution import Outcome
from orbit_core.conformance.results import RESULT_FILE, Header, Parting, Record, Result, decode, encode, save
from orbit_core.interfaces import ConfigurationError

JOURNAL = "journal.jsonl"
PREVIOUS = "previous.json"
LOG = "log.txt"


def now() -> str:
    """UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


class Journal:
    """Appends each record to a file of JSON lines, flushed to the disk; the first line is the run's header.

    A folder whose run is unfinished goes on; one whose run is finished begins anew, and its result is kept as
    ``previous.json``.

    Raises:
        ConfigurationError: the folder holds an unfinished run of other settings or versions, or cannot be written.
    """

    def __init__(self, folder: Path, header: Header) -> None:
        self.folder = folder
        self.header = header
        self.records: dict[str, Record] = {}
        self._path = folder / JOURNAL
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / RESULT_FILE).exists():
                (folder / RESULT_FILE).replace(folder / PREVIOUS)
                self._path.unlink(missing_ok=True)
            kept = self._resume() if self._path.exists() else 0
            self._file = self._path.open("r+b" if kept else "wb")
        except OSError as error:
            raise ConfigurationError(f"cannot write into folder {folder}: {error.strerror}") from error
        self._file.seek(kept)
        self._file.truncate()
        if not kept:
            self._append(encode(header))

    def add(self, outcome: Outcome) -> None:
        """Keep an outcome: its files first, so that a record's files are always there."""
        record = outcome.record
        own = self.folder / record.job.key
        for name, content in outcome.files.items():
            own.mkdir(parents=True, exist_ok=True)
            (own / name).write_bytes(content)
        self.records[record.job.key] = record
        self._append(encode(record))

    def finish(self, partings: Iterable[Parting] = ()) -> Result:
        """Write the result; the journal has done its work."""
        self._file.close()
        records = tuple(self.records.values())
        result = Result(header=self.header, records=records, partings=tuple(partings), finished=now())
        save(result, self.folder)
        self._path.unlink()
        return result

    def close(self) -> None:
        """Leave the run as it is."""
        self._file.close()

    def _append(self, line: str) -> None:
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _resume(self) -> int:
        """Read the records of an unfinished run; the number of bytes that are whole."""
        lines = self._path.read_bytes().splitlines(keepends=True)
        whole = [line for line in lines if line.endswith(b"\n")]  # the last one may be torn
        if not whole:
            return 0
        self._go_on_from(decode(whole[0], Header))
        records = [decode(line, Record) for line in whole[1:]]
        self.records = {record.job.key: record for record in records}
        return sum(map(len, whole))

    def _go_on_from(self, old: Header) -> None:
        differing = _differing(old, self.header)
        if differing:
            raise ConfigurationError(
                f"folder {self.folder} holds an unfinished run of other {differing}: "
                "give another --output, or delete it"
            )
        self.header = replace(self.header, started=old.started)


def _differing(old: Header, new: Header) -> str:
    """What makes them different runs, in words; empty if nothing does."""
    pairs: Mapping[str, tuple[object, object]] = {
        "settings": (old.settings, new.settings),
        "policies": (old.policies, new.policies),
        "versions": ((old.versions, old.backends), (new.versions, new.backends)),
        "hardware": (old.hardware, new.hardware),
    }
    return " and ".join(name for name, (before, after) in pairs.items() if before != after)
