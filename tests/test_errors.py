"""Errors that ORBIT raises on purpose, as other processes read them."""

from __future__ import annotations

import pickle

from orbit_core.interfaces import OrbitError, ShapeError, UnknownNameError


def test_errors_arrive_whole_from_another_process() -> None:
    errors: list[OrbitError] = [UnknownNameError("task", "Lft", ("Lift", "Reach")), ShapeError("of shape (2,)")]
    for error in errors:
        error.add_note("as it was raised")
        read = pickle.loads(pickle.dumps(error))
        assert type(read) is type(error)
        assert str(read) == str(error)
        assert vars(read) == vars(error)
