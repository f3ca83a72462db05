"""``orbit view``: show a task live in the browser."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from orbit_core.cli.making import check_actor, make_actor, make_environment
from orbit_core.cli.settings import EnvironmentSettings, check_steps, parse_settings

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment


@dataclass(frozen=True, kw_only=True)
class ViewSettings(EnvironmentSettings):
    """Watch a task live in the browser."""

    num_envs: int = 1
    """Environments stepped together."""
    agent: Annotated[str, arg(metavar="{expert,random,zero,hold,POLICY}")] = "expert"
    """Agent that acts: one of these, a kept policy ('orbit list policies'), or the file or folder of a learned one."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets other computers watch."""
    port: int = 8080
    """Port to listen on."""
    frames: bool = False
    """Draw axes at the robot's base, end effectors, finger tips, feet and wheels; the panel has a switch for it."""
    max_steps: Annotated[int | None, arg(metavar="INT")] = None
    """Stop after that many steps; run until interrupted if left out."""


def task_information(environment: Environment) -> Callable[[int], Mapping[str, str]]:
    """Return a function from an environment's index to its episode's seconds, success and the task's metrics."""
    task = environment.task

    def information(index: int) -> Mapping[str, str]:
        seconds = float(environment.state.episode_step[index]) * environment.step_dt
        success = "yes" if bool(task.success(environment)[index]) else "no"
        metrics = {name: f"{float(value[index]):.3g}" for name, value in task.metrics(environment).items()}
        return {"episode": f"{seconds:.2f} of {task.episode_length:g} s", "success": success, **metrics}

    return information


def main(words: Sequence[str]) -> None:
    """Show the task until interrupted, or for ``max_steps``."""
    settings = parse_settings(ViewSettings, words, "orbit view")
    check_actor(settings.agent)
    check_steps(settings.max_steps)
    environment = make_environment(settings, settings.num_envs)
    try:
        from orbit_core.rollout.pictures import Spectator
        from orbit_viewer.signals import TaskSignals
        from orbit_viewer.viewer import Viewer

        agent = make_actor(settings.agent, environment, settings.seed)
        title = f"ORBIT {settings.task} on {environment.world.backend}"
        information = task_information(environment)
        with Viewer(
            environment, agent, settings.host, settings.port, title, information, frames=settings.frames,
            signals=TaskSignals(environment), follow=environment.task.metadata.follow,
            record=lambda width, height: Spectator(environment, width, height),
            mark=lambda: environment.task.mark(environment),
        ) as viewer:  # fmt: skip
            print(f"watch at {viewer.url}", flush=True)
            viewer.run(settings.max_steps)
    finally:
        environment.close()
