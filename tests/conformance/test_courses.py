"""Where key points of deformables went is recorded, kept and drawn side by side."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from orbit_conformance.courses import course_of
from orbit_conformance.hardware import Hardware
from orbit_conformance.recording import Recording
from orbit_conformance.report.courses import courses
from orbit_conformance.results import Header, Result
from orbit_conformance.settings import Part, Settings
from orbit_conformance.tasks import run_task
from orbit_core.backends import default_backend


def test_key_points_and_the_metric_of_a_task_with_a_rope_are_recorded(tmp_path: Path) -> None:
    path = tmp_path / "rope.npz"
    run_task("Rope-Reshaping", default_backend(), num_envs=1, fields={"episode_length": 0.2}, recording=path)
    course = course_of(Recording.load(path))
    assert course is not None
    assert list(course.points) == [f"rope/point{number}" for number in range(5)]
    assert course.metric == "shape_distance_m"
    assert len(course.times) == len(course.values) == 10
    ends = np.array(course.points["rope/point4"]) - np.array(course.points["rope/point0"])
    assert abs(np.linalg.norm(ends[0]) - 0.38) < 1e-3, "all but half a centimetre at each end of 0.4 m"


def recording(backend: str, tracks: dict[str, np.ndarray]) -> Recording:
    """Of 300 steps, of which the first environment's episode has 200."""
    values = {"distance_m": np.linspace(1.0, 0.0, 300, dtype=np.float32)[:, None]}
    actions, lengths = np.zeros((300, 1, 1), np.float32), np.array([200])
    return Recording("Bend", backend, 0, {}, 0.02, actions, lengths, tracks, values)


def test_a_course_is_of_the_first_episode_and_is_drawn_beside_the_others() -> None:
    way = np.cumsum(np.full((300, 1, 3), 0.001, np.float32), axis=0)
    found = [course_of(recording(name, {"cloth/corner": way, "robot/hand": np.zeros((300, 1, 7))})) for name in "ab"]
    assert [course is not None and list(course.points) for course in found] == [["cloth/corner"]] * 2
    first = found[0]
    assert first is not None
    assert len(first.times) == 101
    assert math.isclose(first.times[-1], 199 * 0.02)
    settings = Settings(backends=("a", "b"), scenarios=(), tasks=("Bend",), parts=(Part.TASKS,))
    hardware = Hardware("a machine", 2, 1.0, (), "system")
    header = Header(settings=settings, versions={}, hardware=hardware, started="", scenarios=(), backends=())
    drawn = courses(Result(header=header, records=(), courses=tuple(c for c in found if c)), "Bend")
    for words in ("a, from above (m)", "b, height (m)", "distance_m", "corner"):
        assert words in drawn


def test_a_task_without_deformables_has_no_course() -> None:
    assert course_of(recording("a", {"robot/hand": np.zeros((300, 1, 7), np.float32)})) is None
