"""Stopwatch around the parts of an environment's step: each part's time without the parts inside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from orbit_core.envs.environment import Environment

STATE_READS = (
    "joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities", "contact_forces",
)  # fmt: skip


class Stopwatch:
    """Seconds by part. A part's time stops while one inside it runs."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._mark = 0.0

    def wrap(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, timed."""

        def timed(*arguments: Any, **keywords: Any) -> Any:
            self._switch()
            self._running.append(part)
            try:
                return function(*arguments, **keywords)
            finally:
                self._switch()
                self._running.pop()

        return timed

    def _switch(self) -> None:
        """Book the time since the last call on the part that ran."""
        now = time.perf_counter()
        if self._running:
            part = self._running[-1]
            self.seconds[part] = self.seconds.get(part, 0.0) + now - self._mark
        self._mark = now


@contextmanager
def timed_parts(environment: Environment) -> Iterator[Stopwatch]:
    """Time the parts of an environment's step while the context lasts; what is left is booked as "the rest"."""
    watch = Stopwatch()
    engine = environment.world.engine
    engine_type = type(engine)
    timed_reads = {name: property(watch.wrap("state reads", getattr(engine_type, name).fget)) for name in STATE_READS}
    parts = {
        "step": "the rest",
        "_reward": "rewards",
        "_terminated": "terminations",
        "_observe": "observations",
        "_everyone": "resets",
        "begin": "resets",
    }
    for name, part in parts.items():
        setattr(environment, name, watch.wrap(part, getattr(environment, name)))
    acting = {"apply": "agent and motion"}
    for name, part in acting.items():
        setattr(environment.actions, name, watch.wrap(part, getattr(environment.actions, name)))
    environment.world.step = watch.wrap("world", environment.world.step)  # pyright: ignore[reportAttributeAccessIssue]
    engine.step = watch.wrap("engine step", engine.step)  # pyright: ignore[reportAttributeAccessIssue]
    engine.__class__ = type(engine_type.__name__, (engine_type,), timed_reads)
    captured = environment._closed.parts if environment._closed else ()
    names = ("compiled: agent, motion, rewards, observations", "resets")
    functions = [(function, name) for part, name in zip(captured, names, strict=False) for function in part.functions]
    replays = [function.replay for function, _ in functions]
    for function, name in functions:
        function.replay = function.replay and watch.wrap(name, function.replay)
    try:
        yield watch
    finally:
        engine.__class__ = engine_type
        for (function, _), replay in zip(functions, replays, strict=True):
            function.replay = replay
        for owner, names in (
            (environment, parts),
            (environment.actions, acting),
            (environment.world, ("step",)),
            (engine, ("step",)),
        ):
            for name in names:
                delattr(owner, name)
