"""The benchmarks run and write what they promise; what they measure is not judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def measured(tmp_path: Path, script: str, *words: str) -> dict:
    path = tmp_path / "result.json"
    command = [sys.executable, str(BENCHMARKS / script), "--json", str(path), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(path.read_text())


def test_overhead(tmp_path: Path):
    pytest.importorskip("matplotlib")
    plot = tmp_path / "overhead.png"
    words = ["--sweep", "1", "2", "--blocks", "2", "--block-steps", "3", "--no-compile", "--plot", str(plot)]
    result = measured(tmp_path, "overhead.py", *words)
    assert [row["num_envs"] for row in result["overhead"]] == [1, 2]
    for row in result["overhead"]:
        assert 0.0 < row["raw"]["ratio"] < 2.0
        parts = row["parts_milliseconds"]
        assert {"engine step", "agent and motion", "rewards", "state reads"} <= set(parts)
        assert min(parts.values()) >= 0.0
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_soak(tmp_path: Path):
    result = measured(tmp_path, "soak.py", "--task", "Reach", "--steps", "40", "--num-envs", "4")
    (report,) = result["tasks"]
    assert report["actions"] == 40
    assert report["failure"] == ""
