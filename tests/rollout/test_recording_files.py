"""Files of recorded episodes: what was saved is loaded, and what cannot be is one error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbit_conformance.recording import Recording
from orbit_core.interfaces import AssetError
from orbit_data.reading.budget import ReadBudget

HEADER = {"task": "Reach", "backend": "an_engine", "seed": 0, "step_dt": 0.02, "fields": {"tolerance": 0.1}}


def recording() -> Recording:
    tracks = {"robot/hand": np.full((9, 2, 7), np.nan, np.float32)}
    actions = np.ones((9, 2, 3), np.float32)
    return Recording(**HEADER, actions=actions, lengths=np.array([9, 4]), tracks=tracks)  # pyright: ignore[reportArgumentType]


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    recording().save(tmp_path / "a.npz")
    loaded = Recording.load(tmp_path / "a.npz")
    assert (loaded.task, loaded.fields, loaded.tracks.keys()) == ("Reach", {"tolerance": 0.1}, {"robot/hand"})
    np.testing.assert_array_equal(loaded.actions, recording().actions)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"header": json.dumps({**HEADER, "seed": "x"})}, "seed"),
        ({"header": json.dumps({**HEADER, "more": 1})}, "more"),
        ({"header": "[" * 5000}, "nested too deeply|cannot"),
        ({"header": "[]"}, "no object but a list"),
        ({"actions": None}, "actions"),
        ({"actions": np.ones((9, 2, 3), np.complex64)}, "other than real numbers"),
        ({"actions": np.ones(9, np.float32)}, r"actions of shape \(9,\)"),
        ({"lengths": np.array([9, 40])}, "episodes of 9 to 40 steps, of 9 recorded"),
        ({"lengths": np.array([9, 0])}, "episodes of 0 to 9 steps"),
        ({"lengths": np.array([9.5, 1.0])}, "other than real numbers"),
        ({"track:robot/hand": np.ones((3, 2, 7), np.float32)}, r"track of shape \(3, 2, 7\)"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    whole = {"header": json.dumps(HEADER), "actions": recording().actions, "lengths": np.array([9, 4])}
    arrays: dict[str, Any] = {name: value for name, value in {**whole, **change}.items() if value is not None}
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(AssetError, match=message):
        Recording.load(tmp_path / "a.npz")


def test_the_budget_holds(tmp_path: Path) -> None:
    recording().save(tmp_path / "a.npz")
    with pytest.raises(AssetError, match="--read-bytes"):
        Recording.load(tmp_path / "a.npz", ReadBudget(bytes=100))
