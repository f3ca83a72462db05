"""``orbit deploy``: an expert, a learned policy or a person drives a robot through a bridge."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

from tyro.conf import Positional, arg

from orbit_core.cli.making import check_actor, make_actor
from orbit_core.cli.output import console, new_table, write_json
from orbit_core.cli.settings import File, KeyValues, Name, check_output, check_positive, parse_words
from orbit_core.interfaces.errors import ConfigurationError, OrbitError
from orbit_deploy.cli.countdown import check_countdown, count_down

if TYPE_CHECKING:
    from torch import Tensor

    from orbit_core.envs import Environment, Task
    from orbit_core.envs.actors import Actor
    from orbit_deploy.engine import RobotEngine
    from orbit_deploy.link import RobotLink
    from orbit_deploy.messages import RobotState

TELEOP = "teleop"
# Share of the time with limits in the way that is reported
_HELD_BACK = 0.05
_NO_DEVICE = "keyboard"


@dataclass(frozen=True, kw_only=True)
class DeploySettings:
    """Run a task's expert, a learned policy or a person on a robot, which may be a simulated one ('orbit robot')."""

    agent: Annotated[Positional[str], arg(metavar="{POLICY,expert,teleop}")]
    """Who acts: a kept policy ('orbit list policies'), a policy's file or folder, the task's expert, or a person."""
    bridge: Annotated[str, arg(metavar="ADDRESS")] = "zmq://127.0.0.1:5555"
    """Address of the robot's computer."""
    task: Name = None
    """Task that gives observations and actions; the policy's own if left out."""
    robot: Name = None
    """Robot of the catalogue in the place of the task's own."""
    action: Name = None
    """Action space in the place of the task's own."""
    set: KeyValues = ()
    """A field of the task, such as tolerance=0.03."""
    path: Literal["quintic", "drive", "direct"] = "quintic"
    """Way in which commands become motion: through them by quintic polynomials, as the task's drives would move the
    joints, or to the drives as they come, where the robot permits it."""
    keys: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Folder of keys; needed beyond this machine ('orbit robot --make-keys')."""
    episodes: int = 1
    """Episodes to run; the robot goes home slowly between them."""
    seed: int = 0
    """Seed of goals and, on a simulated robot, of starts."""
    countdown: float = 3.0
    """Seconds before the robot moves."""
    dead_man: bool = False
    """Let the robot move only while the space bar is held; not with the keyboard as the device."""
    device: Annotated[str, arg(metavar="{keyboard,gamepad,spacemouse,leader}")] = _NO_DEVICE
    """Device of a person who acts."""
    allow_differences: bool = False
    """Run although gains or limits of the robot are not the task's."""
    table: bool = True
    """Show commanded and measured joints while the robot moves, where the output is a terminal."""
    view: bool = False
    """Show the robot and live plots of commanded and measured joints in the browser."""
    port: int = 8080
    """Port of the page; if taken, the next free one."""
    twin: Annotated[str | None, arg(metavar="BACKEND")] = None
    """Simulate the robot with the same targets on this backend: as a ghost and in the plots of --view, and with its
    difference from the robot in the results. For robots with a fixed base."""
    json: File = None
    """Write results and latencies here."""
    overwrite: bool = False
    """Replace a file of that name if it is there already."""


def main(words: Sequence[str]) -> None:
    """Run on the robot; it rests at the end, at Ctrl-C, at a fault, and when the link is lost."""
    settings = parse_words(DeploySettings, words, "orbit deploy")
    check_positive("episodes", settings.episodes)
    check_output(settings.json, ".json", settings.overwrite)
    check_countdown(settings.countdown)
    if settings.agent != TELEOP:
        check_actor(settings.agent)
    elif settings.dead_man and settings.device == "keyboard":
        raise ConfigurationError("the keyboard is the device: a dead-man key needs another --device")
    deploy(settings)


def deploy(settings: DeploySettings) -> dict[str, Any]:
    """Run on the robot and return results and latencies as plain data.

    Raises:
        OrbitError: the robot is not there, is another one, or has stopped; the message names the cause.
    """
    import torch

    from orbit_core.envs.making import make
    from orbit_deploy.engine import robot_world
    from orbit_deploy.follower import PathKind
    from orbit_deploy.link import connect

    torch.set_num_threads(1)
    out = console()
    task = configured_task(settings)
    period = task.physics_dt * task.decimation
    link = connect(settings.bridge, period, settings.keys, PathKind(settings.path))
    try:
        described = link.description
        kind = f"simulated by {described.simulated}" if described.simulated else "real"
        out.print(
            f"{described.model} at {settings.bridge} ({kind}), {len(described.joints)} joints, loop {described.rate:g} "
            f"Hz, commands {1.0 / period:g} Hz; clocks agree within {1e6 * link.offset.error:.0f} us",
            soft_wrap=True,
        )
        # Before the environment is made, whose first reset runs these events.
        if not described.arranges:
            _leave_placing_to_people(task, out.print)
        _leave_out_learning(task)
        # Joints, their order and units are compared when the world is made, the policy's manifest by its actor.
        # It begins with a reset, and nothing may move before the countdown.
        world = robot_world(link, period, contacts=True, rehearsing=True)
        environment = make(task, 1, world=world, seed=settings.seed)
        try:
            _check_differences(environment, settings)
            with _Pilot(settings, environment) as pilot:
                _rehearse(environment, pilot, settings.agent)
                results = _run(settings, environment, pilot)
        finally:
            _rest(link)
    finally:
        link.close()
    write_json(settings.json, results)
    _report(results)
    return results


class TaskWords(Protocol):
    """Settings that name an agent and its task."""

    @property
    def agent(self) -> str:
        """Name or path of the agent."""
        ...

    @property
    def task(self) -> str | None:
        """Task, or None for the policy's own."""
        ...

    @property
    def robot(self) -> str | None:
        """Robot in the place of the task's own."""
        ...

    @property
    def action(self) -> str | None:
        """Action space in the place of the task's own."""
        ...

    @property
    def set(self) -> tuple[str, ...]:
        """Fields of the task as ``name=value``."""
        ...


def configured_task(settings: TaskWords) -> Task:
    """Return the configured task, the policy's own where none is named."""
    from orbit_core.configuration import assignments
    from orbit_core.envs.actors import ACTORS
    from orbit_core.envs.configuration import configure
    from orbit_core.envs.registry import task_entry
    from orbit_learn.pretrained import policy_fields, policy_path

    name, fields = settings.task, {}
    if settings.agent not in (TELEOP, *ACTORS) and "://" not in settings.agent:
        from orbit_learn.policy import load_policy

        learned = load_policy(policy_path(settings.agent)).description
        name = name or learned.task
        fields = {"robot": learned.robot, "action": learned.action, **policy_fields(settings.agent)}
    if name is None:
        raise ConfigurationError("name a task: orbit deploy expert --task Lift")
    entry = task_entry(name)
    fields |= {key: value for key, value in (("robot", settings.robot), ("action", settings.action)) if value}
    return configure(entry.task_type(), {**fields, **assignments(settings.set, f"task {entry.name}")})


def _leave_placing_to_people(task: Task, tell: Callable[[str], object]) -> None:
    """Switch off the events that write states, which a real robot's world refuses."""
    from orbit_core.envs.terms import EventTerm, terms_of

    names = list(terms_of(task.events, EventTerm))
    for name in names:
        setattr(task.events, name, None)
    if names:
        tell(f"a real robot: {', '.join(names)} are switched off, place things by hand")


def _leave_out_learning(task: Task) -> None:
    """Switch off rewards and curriculum, which may read what a robot does not measure."""
    from orbit_core.envs.terms import CurriculumTerm, RewardTerm, terms_of

    # A robot's episodes are counted by success and metrics, which nobody learns from.
    for collection, kind in ((task.rewards, RewardTerm), (task.curriculum, CurriculumTerm)):
        for name in terms_of(collection, kind):
            setattr(collection, name, None)


def _rehearse(environment: Environment, pilot: _Pilot, agent: str) -> None:
    """Run one step if the task has contact sensors, to see that the agent does without them; the robot stays still.

    Raises:
        ConfigurationError: it reads contact forces.
    """
    import torch

    from orbit_core.scene import ContactSensorSpec

    sensors = [spec.name for spec in environment.world.scene.sensors if isinstance(spec, ContactSensorSpec)]
    if not sensors or agent == TELEOP:
        return
    # The sensors hold zeros until the first step.
    environment.step(torch.zeros(1, environment.action_size))
    action = pilot.rehearse()
    if not bool(action.isfinite().all()):
        raise ConfigurationError(
            f"{agent} reads contact forces ({', '.join(sensors)}), which the robot's computer does not measure: use a "
            "policy whose observations have none"
        )
    console().print(
        f"contact forces ({', '.join(sensors)}) are not measured: terminations and metrics never see a touch",
        soft_wrap=True,
    )


def _check_differences(environment: Environment, settings: DeploySettings) -> None:
    engine: RobotEngine = environment.world.engine  # pyright: ignore[reportAssignmentType]
    if engine.differences and not settings.allow_differences:
        raise ConfigurationError(
            f"the robot differs from the task's: {'; '.join(engine.differences)}; --allow-differences runs all the same"
        )
    for line in engine.differences:
        console().print(f"warning: {line}", soft_wrap=True)


class _Pilot:
    """Actor on the robot, with what a person holds in their hands, released at the end."""

    def __init__(self, settings: DeploySettings, environment: Environment) -> None:
        from orbit_deploy.dead_man import DeadManKey

        self._device = self._key = None
        if settings.agent == TELEOP:
            from orbit_data.teleoperation.device import Speeds
            from orbit_data.teleoperation.devices import check_device, open_device
            from orbit_data.teleoperation.driver import Driver

            check_device(settings.device)
            driver = Driver(environment)
            self._device = open_device(settings.device, Speeds(), driver, 0)
            self._actor: Actor = _Person(environment, driver, self._device.read)
        else:
            self._actor = make_actor(settings.agent, environment, settings.seed)
        if settings.dead_man:
            self._key = DeadManKey()

    def __enter__(self) -> _Pilot:
        return self

    def __exit__(self, *error: object) -> None:
        for each in (self._device, self._key):
            if each is not None:
                each.close()

    def check(self) -> None:
        """Raise if the dead-man key is not held.

        Raises:
            ReleasedError: it is not.
        """
        if self._key is not None:
            self._key.check()

    def act(self) -> Tensor:
        """Return the next action (1, A).

        Raises:
            ReleasedError: the dead-man key was released.
        """
        self.check()
        return self._actor.act()

    def rehearse(self) -> Tensor:
        """Return the next action (1, A) without asking for the dead-man key."""
        return self._actor.act()

    def wait(self) -> None:
        """Wait until the dead-man key is held."""
        if self._key is not None:
            console().print("hold the space bar")
            self._key.wait()


class _Person:
    """Actor of a person with a device."""

    def __init__(self, environment: Environment, driver: Any, read: Callable[[], Any]) -> None:
        self._environment, self._driver, self._read = environment, driver, read

    def act(self) -> Tensor:
        if int(self._environment.state.episode_step[0]) == 0:
            self._driver.restart()
        return self._driver.act(self._read())


def _run(settings: DeploySettings, environment: Environment, pilot: _Pilot) -> dict[str, Any]:
    from orbit_core.rollout.stepping import EpisodeCounter, roll_out
    from orbit_deploy.display import JointTable
    from orbit_deploy.realtime import prioritized

    engine: RobotEngine = environment.world.engine  # pyright: ignore[reportAssignmentType]
    counter = EpisodeCounter(settings.episodes, 1, environment.device)
    # The page and the twin take seconds to start, in which nobody waits for the robot to move.
    with _Watch(settings, environment) as watch:
        count_down(settings.countdown)
        pilot.wait()
        engine.rehearsing = False
        engine.link.permit = pilot.check
        # The loop of commands only: threads of libraries exist by now, and later ones do not inherit the priority.
        with prioritized(inherited=False), JointTable(engine.link, settings.table) as table:
            environment.reset(settings.seed)

            def show(state: RobotState) -> None:
                table.show(state)
                watch.show(state)

            engine.on_step = show
            roll_out(environment, pilot, (counter,), lambda: counter.complete)
    episodes, link, state = counter.episodes(), engine.link, engine.link.state()
    return {
        "task": type(environment.task).__name__,
        "agent": settings.agent,
        "bridge": settings.bridge,
        "model": link.description.model,
        "episodes": len(episodes.env_ids),
        "success_rate": episodes.success_rate.value,
        "metrics": {name: values.mean().item() for name, values in episodes.metrics.items()},
        "steps": engine.times.steps,
        "overruns": engine.times.overruns,
        "round_trip_ms": [1e3 * value for value in link.round_trips.percentiles()],
        "state_age_ms": [1e3 * value for value in link.ages.percentiles()],
        "clock_error_us": 1e6 * link.offset.error,
        "clamped": state.clamped,
        "held_back": state.limited / (link.description.rate * max(engine.times.steps * environment.step_dt, 1e-9)),
        "late": state.late,
        "stops": state.stops,
        **watch.results(),
    }


class _Watch:
    """Live page and twin of the robot, each if it is wanted."""

    def __init__(self, settings: DeploySettings, environment: Environment) -> None:
        engine: RobotEngine = environment.world.engine  # pyright: ignore[reportAssignmentType]
        (spec,) = environment.world.scene.robots
        self._page = self._twin = None
        self._begin, self._squares, self._states = engine.link.now(), 0.0, 0
        self._engine, self._link = engine, engine.link
        if settings.twin is not None:
            from orbit_deploy.twin import LiveTwin

            self._twin = LiveTwin(spec, settings.twin)
        if settings.view:
            from orbit_viewer.robot_page import RobotPage

            series = ("commanded", "measured", *(() if self._twin is None else (f"simulated by {settings.twin}",)))
            self._page = RobotPage(spec, series, port=settings.port)
            console().print(f"live plots at {self._page.url}", soft_wrap=True)

    def __enter__(self) -> _Watch:
        return self

    def __exit__(self, *error: object) -> None:
        for each in (self._page, self._twin):
            if each is not None:
                each.close()

    def show(self, state: RobotState) -> None:
        """Take the state of a step."""
        import numpy as np

        lines, ghost, text = [state.targets, state.positions], None, f"{state.mode}, {self._link.round_trips}"
        # In the step's own time: the world of a Panda takes about 1 ms for 20 ms.
        if self._twin is not None:
            if self._engine.placed:
                self._twin.restart(state)
            away = self._twin.follow(state)
            self._squares += float(np.mean(away**2))
            self._states += 1
            ghost = self._twin.positions
            lines.append(ghost.tolist())
            text += f", twin {np.abs(away).max():.3g} rad or m away"
        if self._page is not None:
            self._page.show(self._link.now() - self._begin, np.array(state.positions), np.array(lines), ghost, text)

    def results(self) -> dict[str, float]:
        """Return the difference between twin and robot, rad or m (rms)."""
        return {} if not self._states else {"twin_rms": math.sqrt(self._squares / self._states)}


def _rest(link: RobotLink) -> None:
    """Bring the robot to rest; it does so by itself where the link is lost."""
    link.permit = None
    try:
        link.stop()
        link.finish_motion(2.0)
    except OrbitError:
        return


def _report(results: dict[str, Any]) -> None:
    table = new_table("", "value", title=f"{results['task']} on {results['model']} at {results['bridge']}")
    table.add_row("episodes", str(results["episodes"]))
    table.add_row("success rate", f"{100.0 * results['success_rate']:.1f} %")
    for name, value in results["metrics"].items():
        table.add_row(name, f"{value:.4g}")
    for name, what in (("round_trip_ms", "round trip of a command"), ("state_age_ms", "age of a state")):
        table.add_row(what, "/".join(f"{value:.2f}" for value in results[name]) + " ms (p50/p99/p99.9)")
    if "twin_rms" in results:
        table.add_row("twin minus robot", f"{results['twin_rms']:.3g} rad or m (rms)")
    table.add_row("steps", f"{results['steps']}, {results['overruns']} of them late")
    table.add_row("commands", f"{results['clamped']} clamped, {results['late']} late, {results['stops']} stops")
    console().print(table)
    if results["held_back"] > _HELD_BACK:
        share = f"{100.0 * results['held_back']:.0f} %"
        console().print(
            f"warning: for {share} of the time the robot's limits held the joints back from what was commanded: a "
            "policy that was trained without them may fail",
            soft_wrap=True,
        )
