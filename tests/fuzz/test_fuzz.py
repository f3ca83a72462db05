"""Bad calls get errors of ours, on every backend: none crashes, hangs, or lets in what is not finite."""

from __future__ import annotations

import subprocess
import sys

import pytest

from orbit_core.backends import backend_names
from tests.fuzz.run import fuzz

CALLS = 120
FILES = 300
DATA_FILES = 60
SECONDS_PER_CALL = 2.0


@pytest.mark.parametrize("backend", backend_names())
def test_bad_calls_are_refused_and_leave_the_rest_usable(backend: str, request: pytest.FixtureRequest) -> None:
    calls = request.config.getoption("calls", default=None) or CALLS
    seed = request.config.getoption("fuzz_seed", default=None) or 0
    command = [sys.executable, "-m", "tests.fuzz.worker", backend, f"--calls={calls}", f"--seed={seed}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120 + SECONDS_PER_CALL * calls)
    failures = [line for line in done.stdout.splitlines() if not line.startswith("call ")]
    last = done.stdout.splitlines()[-1:]
    assert done.returncode == 0, "\n".join([*failures[:40], f"last: {last}", done.stderr[-2000:]])


def test_spoilt_files_are_refused_in_our_words_or_read_soundly() -> None:
    failures = [outcome for outcome in fuzz(FILES) if outcome.verdict == "failed"]
    assert not failures, "\n".join(f"{failure.number}: {failure.why}" for failure in failures)


def test_spoilt_datasets_policies_and_recordings_are_refused_in_our_words_or_read_soundly() -> None:
    failures = [outcome for outcome in fuzz(DATA_FILES, kind="data") if outcome.verdict == "failed"]
    assert not failures, "\n".join(f"{failure.number}: {failure.why}" for failure in failures)
