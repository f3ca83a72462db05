"""Stepping rate of an environment against its raw engine, time to start, and memory.

The environment takes random actions and does all that it does in learning: actions to joint targets, physics,
observations, rewards, terminations, resets (episodes are staggered, so that some end in most blocks). After each block
of its steps, the raw stepper starts from the state that the block began in and takes the very commands that the
environment gave, so that both simulate the same motions and contacts; every way of stepping that the backend's package
offers in its module ``native_baseline`` is tried, and the fastest is the yardstick. Blocks alternate, and the median of
their ratios counts. A package without that module is measured alone.
"""

from __future__ import annotations

import importlib.util
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch

from orbit_conformance.hardware import device_label
from orbit_core.backends import backend as find_backend
from orbit_core.envs import Environment, make
from orbit_core.envs.actors import RandomActor
from orbit_core.interfaces import Capability
from orbit_core.rollout.pictures import OverviewCamera

# Stopwatch around the parts of an environment's step: each part's time without the parts inside it --------------------

STATE_READS = (
    "joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities", "contact_forces",
)  # fmt: skip


class Stopwatch:
    """Seconds by part. A part's time stops while one inside it runs."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        """Seconds so far by part."""
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


# Width and height in pixels of the picture whose cost is measured.
PICTURE = 84
# The stopwatch's parts that are the engine's own work.
_ENGINE = ("engine step", "state reads")
_ENVIRONMENT = "environment"
# Seconds of a block, beyond which it has fewer steps; steps that show how long one takes.
_BLOCK_SECONDS, _TRIAL_STEPS = 1.5, 2
# A way of stepping that takes this many times as long as the fastest is not measured further.
_HOPELESS = 1.5
# Number of environments that are drawn, and how often each is drawn.
_DRAWN = 4


@dataclass(frozen=True)
class RawRate:
    """The rate of the engine without ORBIT around it, measured in the same run."""

    way: str
    """The fastest of all ways of stepping."""
    env_steps_per_second: float
    """Steps of single environments per second."""
    milliseconds_per_step: float
    """Time of one step of all environments together."""
    ratio: float
    """The environment's rate over the raw engine's: median over the blocks."""
    ratio_quartiles: tuple[float, float]
    """Quartiles of the ratio over the blocks."""


@dataclass(frozen=True)
class Throughput:
    """The speed of a task for one number of environments."""

    num_envs: int
    """Number of environments."""
    env_steps_per_second: float
    """Steps of single environments per second: median over the blocks."""
    milliseconds_per_step: float
    """Wall time of one step of all environments together."""
    raw: RawRate | None
    """Rate of the raw engine; None where the backend's package has no module ``native_baseline``."""
    parts_milliseconds: dict[str, float]
    """Own time of each part in one step, by a stopwatch that itself costs some microseconds."""
    picture_milliseconds: float | None
    """Time to draw one colour picture of 84 x 84 pixels of one environment; None where the backend draws none."""
    start_seconds: float
    """Time from the call to the end of the first step, with the engine's import where it was not imported."""
    memory_mib: float
    """Growth of the resident memory of the process and its children; meaningful in a fresh process alone."""
    hardware: str = ""
    """Processor or GPU that stepped the environments; empty in results of versions that did not keep it."""

    @property
    def shares(self) -> dict[str, float]:
        """Shares of "engine", "layer" and "rendering" in a step that also draws that picture of every environment."""
        engine = sum(self.parts_milliseconds.get(part, 0.0) for part in _ENGINE)
        layer = sum(self.parts_milliseconds.values()) - engine
        times = {"engine": engine, "layer": layer, "rendering": self.num_envs * (self.picture_milliseconds or 0.0)}
        return {name: milliseconds / sum(times.values()) for name, milliseconds in times.items()}


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A stepping rate measured outside of a run, by a command of ``benchmarks/`` or of a plugin's."""

    task: str
    """Name of the task."""
    robot: str = ""
    """Robot, where it is not the task's own."""
    action: str
    """Action space."""
    backend: str
    """Name of the backend."""
    num_envs: int
    """Number of environments."""
    env_steps_per_second: int
    """Steps of single environments per second."""
    ratio: float | None = None
    """Rate as a share of the engine's own, stepped through the same motions; None where that was not measured."""
    hardware: str
    """Processor or GPU."""
    command: str
    """Command that repeats the measurement."""


def measure_once(
    task: str,
    backend: str,
    num_envs: int,
    blocks: int = 8,
    block_steps: int = 50,
    seed: int = 0,
    fields: Mapping[str, Any] | None = None,
    device: str = "cpu",
    settings: Mapping[str, Any] | None = None,
    compile: bool = False,
) -> Throughput:
    """Measure one number of environments in this process. Run no other job meanwhile.

    Args:
        task: name of a registered task.
        backend: name of an installed backend.
        num_envs: number of environments.
        blocks: number of blocks of the environment's steps; as many steps of the raw engine follow each.
        block_steps: most environment steps in a block; fewer where they would take more than 1.5 s.
        seed: of the environments and of the actions.
        fields: of the task, by name.
        device: where tensors live.
        settings: of the backend, by field name.
        compile: whether to compile the environment's step, as one would for learning.

    Raises:
        UnsupportedCapabilityError: the backend lacks what the task needs.
    """
    torch.set_num_threads(1)  # as the command line does: small tensors gain nothing, and the engine needs the cores
    # Before the engine's import, which is a part of start and memory.
    memory, begin = _resident_mib(), time.perf_counter()
    environment = make(task, num_envs, backend, device, seed, settings=settings, compile=compile, **(fields or {}))
    try:
        agent = RandomActor(environment, seed)
        stagger(environment, seed)
        environment.step(agent.act())
        _wait(environment)
        start = time.perf_counter() - begin
        grown = _resident_mib() - memory
        raw = raw_steppers(environment)
        trials = [_block(environment, agent, raw, min(_TRIAL_STEPS, block_steps)) for _ in range(2)]
        trial = trials[1]  # because kernels compile in the first
        block_steps = max(1, min(block_steps, round(_BLOCK_SECONDS / trial[_ENVIRONMENT])))
        fastest = min((trial[name] for name in raw), default=0.0)
        raw = {name: stepper for name, stepper in raw.items() if trial[name] <= _HOPELESS * fastest}
        _block(environment, agent, raw, block_steps)  # caches fill
        measured = [_block(environment, agent, raw, block_steps) for _ in range(blocks)]
        # A run of its own: the stopwatch itself costs some microseconds a part.
        parts = _parts(environment, agent, block_steps * max(1, blocks // 4))
        picture = _picture_milliseconds(environment)
    finally:
        environment.close()
    own = statistics.median(block[_ENVIRONMENT] for block in measured)
    return Throughput(
        num_envs=num_envs,
        env_steps_per_second=num_envs / own,
        milliseconds_per_step=1e3 * own,
        raw=_raw_rate(num_envs, measured) if raw else None,
        parts_milliseconds=parts,
        picture_milliseconds=picture,
        start_seconds=start,
        memory_mib=grown,
        hardware=device_label(environment.device),
    )


def _raw_rate(num_envs: int, blocks: list[dict[str, float]]) -> RawRate:
    medians = {name: statistics.median(block[name] for block in blocks) for name in blocks[0] if name != _ENVIRONMENT}
    best = min(medians, key=lambda name: medians[name])
    ratios = sorted(block[best] / block[_ENVIRONMENT] for block in blocks)
    return RawRate(
        way=best,
        env_steps_per_second=num_envs / medians[best],
        milliseconds_per_step=1e3 * medians[best],
        ratio=statistics.median(ratios),
        ratio_quartiles=(ratios[len(ratios) // 4], ratios[-1 - len(ratios) // 4]),
    )


def raw_steppers(environment: Environment) -> dict[str, Any]:
    """The ways of stepping in the module ``native_baseline`` of the backend's package, by name; empty without it."""
    name = f"{type(find_backend(environment.world.backend)).__module__.partition('.')[0]}.native_baseline"
    if importlib.util.find_spec(name) is None:
        return {}
    return importlib.import_module(name).raw_steppers(environment.world.engine)


def stagger(environment: Environment, seed: int) -> None:
    """Set random ages of the first episodes, so that resets spread over all steps."""
    generator = torch.Generator().manual_seed(seed)
    steps = torch.randint(environment.max_episode_steps, (environment.num_envs,), generator=generator)
    environment.reset()
    environment.state.episode_step[:] = steps.to(environment.device)


def _block(environment: Environment, agent: RandomActor, raw: dict[str, Any], steps: int) -> dict[str, float]:
    """Seconds per step of the environment and of each raw stepper, over the same stretch of motion."""
    actions = [agent.act() for _ in range(steps)]
    for stepper in raw.values():
        stepper.synchronize()
    recorder = next(iter(raw.values()), None)
    commands: list[Any] = []

    def step_environment(action: torch.Tensor) -> None:
        environment.step(action)
        if recorder is not None:
            commands.append(recorder.command())

    seconds = {_ENVIRONMENT: _seconds(environment, step_environment, actions)}
    decimation = environment.task.decimation
    for name, stepper in raw.items():
        step = lambda command, stepper=stepper: stepper.step(command, decimation)  # noqa: E731
        seconds[name] = _seconds(environment, step, commands)
    return {name: total / steps for name, total in seconds.items()}


def _seconds(environment: Environment, function: Callable[[Any], object], arguments: list[Any]) -> float:
    _wait(environment)
    start = time.perf_counter()
    for argument in arguments:
        function(argument)
    _wait(environment)
    return time.perf_counter() - start


def _wait(environment: Environment) -> None:
    """Wait until the device has finished its work."""
    if environment.device.type != "cpu":
        torch.accelerator.synchronize(environment.device)


def _parts(environment: Environment, agent: RandomActor, steps: int) -> dict[str, float]:
    """Wall time in milliseconds of each part of one step."""
    with timed_parts(environment) as watch:
        for _ in range(steps):
            environment.step(agent.act())
    return {part: 1e3 * seconds / steps for part, seconds in sorted(watch.seconds.items(), key=lambda item: -item[1])}


def _picture_milliseconds(environment: Environment) -> float | None:
    """Median time to draw an environment once."""
    if not find_backend(environment.world.backend).capabilities().has(Capability.RGB):
        return None
    camera = OverviewCamera(environment.world, PICTURE, PICTURE, environment.task.metadata.view)
    rows = torch.arange(min(_DRAWN, environment.num_envs), device=environment.device)
    try:
        times = [_seconds(environment, camera.pictures, [rows]) for _ in range(1 + _DRAWN)]
    finally:
        camera.close()
    return 1e3 * statistics.median(times[1:]) / len(rows)  # the first makes what the others use again


def _resident_mib() -> float:
    """Resident memory in MiB of this process and its children."""
    import psutil

    own = psutil.Process()
    return sum(process.memory_info().rss for process in (own, *own.children(recursive=True))) / 2**20
