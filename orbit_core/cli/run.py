"""``orbit run``: run the episodes of a task and report success, metrics, return and speed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from orbit_core.backends import versions_of
from orbit_core.cli.making import actor_digest, check_actor, make_actor, make_environment
from orbit_core.cli.output import console, new_table, progress_bar, write_json
from orbit_core.cli.settings import RunSettings, check_output, check_positive, check_size, parse_settings
from orbit_core.envs.actors import Actor, RemoteSource
from orbit_core.rollout.estimates import Estimate, Statistic, statistic
from orbit_core.rollout.pictures import Recorder, video_recorder
from orbit_core.rollout.stepping import EpisodeCounter, Pace, ReachWatch, StepObserver, roll_out

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.envs.environment import Environment, EpisodeEnd
    from orbit_core.envs.premises import PremiseCheck

# Share of looks at hands' targets that must find one out of reach for the table to report it
_REPORTED_SHARE = 0.01
_OUTPUTS = ("json", "video", "overwrite", "config")


@dataclass(frozen=True)
class RunResult:
    """Result of a run."""

    task: str
    """Name of the task."""
    backend: str
    """Name of the physics backend."""
    robot: str
    """Name of the robot in the catalogue."""
    action: str
    """Name of the action space."""
    agent: str
    """Actor: ``expert``, ``random``, ``zero``, a policy's name or file, or a server's address."""
    seed: int
    """Seed of the world's random streams."""
    num_envs: int
    """Number N of environments."""
    versions: dict[str, str]
    """Versions of ORBIT, of what the backend depends on, of torch and of Python."""
    episodes: int
    """Number of episodes in the averages."""
    success_rate: Estimate
    """Success rate in [0, 1], with its 95 % interval."""
    metrics: dict[str, Statistic]
    """Means and deviations of the task's metrics by name; the first leads."""
    episode_return: Statistic
    """Sum of an episode's rewards."""
    episode_steps: Statistic
    """Steps of an episode."""
    premises: tuple[PremiseCheck, ...]
    """Premises of the task about an episode's start, and the number of sampled starts in which each failed."""
    unanswered: int
    """Episodes in which a policy server did not answer; they count as failures."""
    failures: dict[str, int]
    """What policy servers did in place of an answer, and how often."""
    out_of_reach: float
    """In [0, 1]: of looks at what hands were asked for, those that found it out of reach."""
    farthest_out_of_reach: float
    """m by which the nearest pose missed it, at most."""
    env_steps_per_second: float
    """Steps of single environments over the time spent acting and stepping; building and filming left out."""
    wall_seconds: float
    """Seconds from the settings to the result, building and filming included."""
    settings: dict[str, Any]
    """All settings but files that the run writes, for ``orbit rerun``."""
    agent_digest: str
    """SHA-256 of the policy's file; empty if no policy's file acted."""

    def as_json(self) -> dict[str, Any]:
        """Return all fields for a file, the rate's interval apart, and ``metric``, the leading one with its name."""
        # Tasks state their leading metric first.
        name, leading = next(iter(self.metrics.items()))
        rate = self.success_rate
        success = {"success_rate": rate.value, "success_interval": [rate.low, rate.high]}
        return {**asdict(self), **success, "metric": {"name": name, **asdict(leading)}}


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
    # All settings are checked before the environment is built, which may take minutes.
    check_actor(settings.agent)
    check_positive("episodes", settings.episodes)
    check_output(settings.json, ".json", settings.overwrite)
    check_output(settings.video, ".mp4", settings.overwrite)
    check_size("video_size", settings.video_size)
    start = time.perf_counter()
    environment = make_environment(settings, settings.num_envs)
    try:
        counter, actor, pace, reach = _episodes(environment, settings, progress)
    finally:
        environment.close()
    episodes = counter.episodes()
    return RunResult(
        task=settings.task or "",
        backend=environment.world.backend,
        robot=environment.task.robot,
        action=environment.task.action,
        agent=settings.agent,
        seed=settings.seed,
        num_envs=settings.num_envs,
        versions=versions_of(environment.world.backend, settings.renderer),
        episodes=len(episodes.env_ids),
        success_rate=episodes.success_rate,
        metrics={name: statistic(values.tolist()) for name, values in episodes.metrics.items()},
        episode_return=statistic(episodes.returns.tolist()),
        episode_steps=statistic(episodes.steps.tolist()),
        premises=environment.premises.checks,
        unanswered=counter.unanswered,
        failures=dict(actor.failures) if isinstance(actor, RemoteSource) else {},
        out_of_reach=reach.share,
        farthest_out_of_reach=reach.farthest,
        env_steps_per_second=pace.env_steps_per_second,
        wall_seconds=time.perf_counter() - start,
        settings=_plain(settings),
        agent_digest=actor_digest(settings.agent),
    )


def _plain(settings: RunSettings) -> dict[str, Any]:
    """Return the settings as JSON takes them, the files that a run writes left out."""
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    kept = {name: value for name, value in values.items() if name not in _OUTPUTS}
    # What a TOML file gave is in the fields already.
    plain = {name: str(value) if isinstance(value, Path) else value for name, value in kept.items()}
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in plain.items()}


class _ProgressReporter(StepObserver):
    """Reports the progress of a run."""

    def __init__(self, counter: EpisodeCounter, recorder: Recorder | None, progress: Progress) -> None:
        self._counter = counter
        self._recorder = recorder
        self._progress = progress

    def after_step(self, action: Tensor, info: Mapping[str, EpisodeEnd]) -> None:
        self._progress(self._counter.counted, 0.0 if self._recorder is None else self._recorder.filmed)


def _episodes(
    environment: Environment, settings: RunSettings, progress: Progress
) -> tuple[EpisodeCounter, Actor, Pace, ReachWatch]:
    """Step until every environment's share of the episodes is in."""
    actor = make_actor(settings.agent, environment, settings.seed)
    counter = EpisodeCounter(settings.episodes, settings.num_envs, environment.device, actor)
    reach = ReachWatch(environment)
    # Seeded last, so that draws made while building do not change the episodes.
    environment.reset(settings.seed)
    with _video(environment, settings) as recorder:
        # The recorder is the first observer: it films the state before the step.
        filming = () if recorder is None else (recorder,)
        observers = (*filming, counter, reach, _ProgressReporter(counter, recorder, progress))
        pace = roll_out(environment, actor, observers, lambda: counter.complete)
    return counter, actor, pace, reach


def _video(environment: Environment, settings: RunSettings) -> AbstractContextManager[Recorder | None]:
    """Return the recorder of the video that the settings ask for, or None."""
    if settings.video is None:
        return nullcontext()
    width, height = settings.video_size
    return video_recorder(environment, settings.video, width=width, height=height, frames=settings.frames)


def main(words: Sequence[str]) -> None:
    """Run what the words of the command line say."""
    show_run(parse_settings(RunSettings, words, "orbit run"))


def show_run(settings: RunSettings) -> None:
    """Run the episodes, print a table and write the result."""
    with progress_bar() as bar:
        counting = bar.add_task(f"{settings.task} episodes", total=settings.episodes)
        filming = bar.add_task("video, %", total=100, visible=settings.video is not None)

        def show(episodes: int, filmed: float) -> None:
            bar.update(counting, completed=episodes)
            bar.update(filming, completed=round(100.0 * filmed))

        result = run(settings, show)
    write_json(settings.json, result.as_json())
    console().print(_table(result))


def _table(result: RunResult) -> Table:
    title = f"{result.task} on {result.backend}: {result.robot}, {result.action}, {result.agent} agent"
    table = new_table("", "value", title=title)
    table.add_row("episodes", f"{result.episodes} in {result.num_envs} environments, seed {result.seed}")
    table.add_row("success rate", result.success_rate.percent())
    for name, metric in result.metrics.items():
        table.add_row(name, _words(metric))
    if result.unanswered:
        reason = max(result.failures, key=lambda name: result.failures[name])
        table.add_row("episodes without an answer", f"{result.unanswered}, counted as failures: {reason}")
    for check in result.premises:
        if check.failed:
            failures = f"fails in {check.failed} of {check.starts} sampled starts: {check.reason}"
            table.add_row(f"premise '{check.name}'", failures)
    if result.out_of_reach >= _REPORTED_SHARE:
        looks = f"in {100.0 * result.out_of_reach:.0f} % of looks, by up to {result.farthest_out_of_reach:.2f} m"
        table.add_row("poses asked for out of reach", looks)
    table.add_row("return", _words(result.episode_return))
    table.add_row("episode steps", _words(result.episode_steps))
    table.add_row("environment steps per second", f"{result.env_steps_per_second:,.0f}")
    table.add_row("wall time", f"{result.wall_seconds:.1f} s")
    table.add_row("versions", ", ".join(f"{name} {version}" for name, version in result.versions.items()))
    return table


def _words(statistic: Statistic) -> str:
    return f"{statistic.mean:.4g} ± {statistic.deviation:.3g}"
