"""Programs in processes of their own that are forked from one that has loaded torch, which takes most of a start."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import tempfile
import types
from collections.abc import Mapping, Sequence
from pathlib import Path

_LOADED = ["torch", "tests.forked", "orbit_core.cli", "orbit_core.envs", "orbit_core.world"]
"""Modules that the server imports. It calls nothing in them, so that a program finds no entry point cached."""


def run_forked(
    code: str, *words: str, path: Sequence[Path] = (), timeout: float = 60.0, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run ``python -c code words...`` and return its exit code and output.

    Use a real process where the test is of imports, of signals, of threads or of what a program does as it ends.

    Args:
        code: of the program.
        words: its arguments.
        path: folders that come first on its module path, as in ``PYTHONPATH``.
        timeout: seconds after which the program is killed and the test fails.
        variables: that its environment has besides this process's.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_LOADED)
    with tempfile.TemporaryDirectory() as folder:
        outputs = (f"{folder}/stdout", f"{folder}/stderr")
        environment = {**os.environ, **variables}
        process = context.Process(
            target=_run, args=(code, words, [str(each) for each in path], environment, os.getcwd(), outputs)
        )
        process.start()
        process.join(timeout)
        if process.exitcode is None:
            process.kill()
            process.join()
            raise subprocess.TimeoutExpired(code, timeout)
        told = [Path(each).read_text() for each in outputs]
    return subprocess.CompletedProcess(["-c", *words], process.exitcode, *told)


def _run(
    code: str,
    words: Sequence[str],
    path: Sequence[str],
    environment: Mapping[str, str],
    folder: str,
    outputs: Sequence[str],
) -> None:
    """Become the program: its output, environment, folder, arguments and module path."""
    for stream, output in zip((1, 2), outputs, strict=True):
        os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT), stream)
    sys.stdout, sys.stderr = (os.fdopen(stream, "w", closefd=False) for stream in (1, 2))
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    sys.path[:0] = path
    sys.argv = ["-c", *words]
    main = sys.modules["__main__"] = types.ModuleType("__main__")
    exec(compile(code, "<string>", "exec"), main.__dict__)
