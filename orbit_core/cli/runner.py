"""Runs a task's episodes and sums them up; prints nothing."""

from __future__ import annotations

import contextlib
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from orbit_core import __version__
from orbit_core.backends import renderer
from orbit_core.cli.acting import check_actor, make_actor
from orbit_core.cli.checks import check_output, check_positive, check_size
from orbit_core.cli.making import make_environment
from orbit_core.cli.settings import RunSettings

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment, EpisodeEnd
    from orbit_core.viewer.video import VideoRecorder


@dataclass(frozen=True)
class Statistic:
    """Mean and standard deviation over the counted episodes (of those episodes themselves, not of a population)."""

    mean: float
    deviation: float


@dataclass(frozen=True)
class RunResult:
    """What a run came to."""

    task: str
    backend: str
    robot: str
    action: str
    agent: str
    seed: int
    num_envs: int
    versions: dict[str, str]
    """Of ORBIT, of what the backend depends on, of torch and of Python."""
    episodes: int
    success_rate: float
    metrics: dict[str, Statistic]
    """By name; the first leads."""
    episode_return: Statistic
    episode_steps: Statistic
    env_steps_per_second: float
    """Steps of single environments over the time spent acting and stepping; building and filming left out."""
    wall_seconds: float
    """From the settings to the result, building and filming included."""

    def as_json(self) -> dict[str, Any]:
        """For a file: all fields, and ``metric``, the leading one with its name."""
        name, leading = next(iter(self.metrics.items()))
        return {**asdict(self), "metric": {"name": name, **asdict(leading)}}


class Tally:
    """Counts the first ``quota`` episodes of each environment.

    Environment i counts its first ``episodes // num_envs`` episodes, and one more if i < ``episodes % num_envs``. A
    race for the first ``episodes`` to end would prefer short episodes to long ones, and so failures to successes or
    the reverse.
    """

    def __init__(self, episodes: int, num_envs: int) -> None:
        self._left = [episodes // num_envs + (i < episodes % num_envs) for i in range(num_envs)]
        self.episodes = 0
        self._wanted = episodes
        self._success: list[bool] = []
        self._values: dict[str, list[float]] = {}
        self._returns: list[float] = []
        self._steps: list[int] = []

    @property
    def complete(self) -> bool:
        """Whether all episodes are in."""
        return self.episodes == self._wanted

    def add(self, end: EpisodeEnd) -> None:
        """Count those of the episodes that are within their environment's quota."""
        returns = sum(end.rewards.values()) if end.rewards else end.steps * 0.0
        rows = [row for row, i in enumerate(end.env_ids.tolist()) if self._left[i] > 0]
        for row in rows:
            self._left[int(end.env_ids[row])] -= 1
            self._success.append(bool(end.success[row]))
            self._returns.append(float(returns[row]))  # pyright: ignore[reportIndexIssue]
            self._steps.append(int(end.steps[row]))
            for name, values in end.metrics.items():
                self._values.setdefault(name, []).append(float(values[row]))
        self.episodes += len(rows)

    @property
    def success_rate(self) -> float:
        """In [0, 1]."""
        return sum(self._success) / len(self._success)

    def metrics(self) -> dict[str, Statistic]:
        """Of each metric."""
        return {name: statistic(values) for name, values in self._values.items()}

    def episode_return(self) -> Statistic:
        """Of the sum of an episode's rewards."""
        return statistic(self._returns)

    def episode_steps(self) -> Statistic:
        """Of the number of an episode's steps."""
        return statistic(self._steps)


def statistic(values: list[float] | list[int]) -> Statistic:
    """Mean and standard deviation of the values."""
    mean = sum(values) / len(values)
    return Statistic(mean, (sum((value - mean) ** 2 for value in values) / len(values)) ** 0.5)


Progress = Callable[[int, float], None]
"""Takes the number of episodes counted so far and, in [0, 1], how much of the video is filmed."""


def run(settings: RunSettings, progress: Progress = lambda episodes, filmed: None) -> RunResult:
    """Build the environment, run the episodes and sum them up.

    Args:
        settings: what to run.
        progress: called after each step.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    check_actor(settings.agent)
    check_positive("episodes", settings.episodes)
    check_output(settings.json, ".json", settings.overwrite)
    check_output(settings.video, ".mp4", settings.overwrite)
    check_size("video_size", settings.video_size)
    start = time.perf_counter()
    environment = make_environment(settings, settings.num_envs)
    try:
        tally, rate = _episodes(environment, settings, progress)
    finally:
        environment.close()
    return RunResult(
        task=settings.task or "",
        backend=environment.world.backend,
        robot=environment.task.robot,
        action=environment.task.action,
        agent=settings.agent,
        seed=settings.seed,
        num_envs=settings.num_envs,
        versions=versions_of(environment.world.backend, settings.renderer),
        episodes=tally.episodes,
        success_rate=tally.success_rate,
        metrics=tally.metrics(),
        episode_return=tally.episode_return(),
        episode_steps=tally.episode_steps(),
        env_steps_per_second=rate,
        wall_seconds=time.perf_counter() - start,
    )


def _episodes(environment: Environment, settings: RunSettings, progress: Progress) -> tuple[Tally, float]:
    """Step until every environment's quota is in; also environment steps per second."""
    tally = Tally(settings.episodes, settings.num_envs)
    agent = make_actor(settings.agent, environment, settings.seed)
    environment.reset(settings.seed)
    seconds, steps = 0.0, 0
    with _recording(environment, settings) as recorder:
        while not tally.complete:
            if recorder is not None:
                recorder.add()
            begin = time.perf_counter()
            info = environment.step(agent.act())[4]
            seconds += time.perf_counter() - begin
            steps += environment.num_envs
            if "final" in info:
                tally.add(info["final"])
            progress(tally.episodes, 0.0 if recorder is None else recorder.filmed)
    return tally, steps / seconds


@contextlib.contextmanager
def _recording(environment: Environment, settings: RunSettings) -> Iterator[VideoRecorder | None]:
    """The recorder of the video that the settings ask for, or None."""
    if settings.video is None:
        yield None
        return
    from orbit_core.viewer.video import VideoRecorder

    width, height = settings.video_size
    recorder = VideoRecorder(environment, settings.video, width=width, height=height)
    try:
        yield recorder
    except BaseException:
        recorder.discard()
        raise
    recorder.close()


def versions_of(*backends: str | None) -> dict[str, str]:
    """Of ORBIT, Python, torch, and what the backends depend on."""
    import torch

    versions = {"orbit": __version__, "python": platform.python_version(), "torch": torch.__version__}
    for name in backends:
        if name is not None:
            versions.update(renderer(name).versions())  # which finds backends too
    return versions
