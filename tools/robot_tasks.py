"""Runs tasks with the catalogue's arms on several engines, and writes the figures into docs/robots-tasks.md.

    python tools/robot_tasks.py                                                write the page from the figures kept
    python tools/robot_tasks.py --task Lift --robot jaco2 --backend bullet     make some figures again before

Figures are kept in docs/figures/robots_tasks.jsonl, a line of JSON for each task, robot and engine: a run replaces the
line that there is. ``--missing`` runs only what has no line yet.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from orbit_core.cli.run import RunResult, run
from orbit_core.cli.settings import RunSettings
from orbit_core.rollout.estimates import proportion

DOCS = Path(__file__).parents[1] / "docs"
PAGE, FIGURES = DOCS / "robots-tasks.md", DOCS / "figures" / "robots_tasks.jsonl"
START, END = "<!-- robot tasks -->\n", "<!-- end -->"
ARMS = (
    "ur5", "ur10", "jaco2", "franka_panda", "kinova_gen3", "xarm7", "kuka_iiwa7", "baxter_arm", "tiago_arm",
    "tiago_pro_arm",
)  # fmt: skip
USUAL = (
    "ur5+robotiq_2f85", "ur10+robotiq_2f85", "jaco2", "franka_panda", "kinova_gen3", "xarm7+robotiq_2f85",
    "kuka_iiwa7+robotiq_2f85", "baxter_arm", "tiago_arm", "tiago_pro_arm",
)  # fmt: skip
"""Every arm with its usual gripper, its own where it has one."""
PAIRS = (
    "kuka_iiwa7+wsg50", "kinova_gen3+panda_hand", "franka_panda+robotiq_2f85", "ur5+wsg50", "xarm7+panda_hand",
    "xarm7+rethink_gripper",
)  # fmt: skip
"""Arms with other grippers."""


@dataclass(frozen=True)
class Goal:
    """A task, and what is asked of it."""

    robots: tuple[str, ...]
    num_envs: int
    episodes: int
    success: float
    """Least success rate in [0, 1]."""


GOALS: Mapping[str, Goal] = {"Reach": Goal(ARMS, 40, 200, 0.95), "Lift": Goal(USUAL + PAIRS, 32, 64, 0.9)}
Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")]
Key = tuple[str, str, str]
"""Task, robot, backend."""


@dataclass(frozen=True, kw_only=True)
class TableSettings:
    """Run tasks with the catalogue's arms on several engines, and write the page from all figures kept."""

    backend: Names = ()
    """Engines to run on; none if left out."""
    task: Names = tuple(GOALS)
    """Tasks to run."""
    robot: Names = ()
    """Robots to run with; the task's own list if left out."""
    episodes: int | None = None
    """Episodes of each run; the task's own number if left out."""
    num_envs: int | None = None
    """Environments stepped together; the task's own number if left out."""
    missing: bool = False
    """Run only what has no figure yet."""


def main(settings: TableSettings) -> None:
    """Run, keep, and write."""
    for backend in settings.backend:
        for task in settings.task:
            for robot in settings.robot or GOALS[task].robots:
                if not (settings.missing and (task, robot, backend) in kept()):
                    figure = measured(task, robot, backend, settings)
                    keep(figure)
                    print(task, robot, backend, told(figure), f"{figure['wall_seconds']:.0f} s", flush=True)
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), kept()), encoding="utf-8")


def page(text: str, figures: Mapping[Key, Mapping[str, Any]]) -> str:
    """The page with its tables of these figures."""
    before, rest = text.split(START)
    return before + START + tables(figures) + END + rest.split(END, 1)[1]


def measured(task: str, robot: str, backend: str, settings: TableSettings) -> dict[str, Any]:
    """The figure of a run: how many episodes succeeded, and with what."""
    goal = GOALS[task]
    num_envs, episodes = settings.num_envs or goal.num_envs, settings.episodes or goal.episodes
    result = run(RunSettings(task=task, robot=robot, backend=backend, num_envs=num_envs, episodes=episodes))
    return {"task": task, "robot": robot, "backend": backend, **_kept(result)}


def _kept(result: RunResult) -> dict[str, Any]:
    successes = round(result.success_rate.value * result.episodes)
    name, metric = next(iter(result.metrics.items()))
    return {
        "successes": successes,
        "episodes": result.episodes,
        "num_envs": result.num_envs,
        "seed": result.seed,
        name: round(metric.mean, 6),
        "versions": result.versions,
        "wall_seconds": round(result.wall_seconds, 1),
    }


def kept() -> dict[Key, dict[str, Any]]:
    """All figures there are."""
    lines = FIGURES.read_text(encoding="utf-8").splitlines() if FIGURES.exists() else ()
    figures = map(json.loads, lines)
    return {(figure["task"], figure["robot"], figure["backend"]): figure for figure in figures}


def keep(figure: Mapping[str, Any]) -> None:
    """Put a figure among those kept, in the place of the one before it."""
    figures = {**kept(), (figure["task"], figure["robot"], figure["backend"]): figure}
    FIGURES.write_text("".join(f"{json.dumps(figures[key])}\n" for key in sorted(figures)), encoding="utf-8")


def tables(figures: Mapping[Key, Mapping[str, Any]]) -> str:
    """A table for each task, a column for each engine."""
    lines = list[str]()
    for task, goal in GOALS.items():
        own = {key[1:]: figure for key, figure in figures.items() if key[0] == task}
        backends = sorted({backend for _, backend in own})
        robots = [*goal.robots, *sorted({robot for robot, _ in own} - {*goal.robots})]
        lines += [f"### {task}", "", *_table(own, robots, backends, goal.success), ""]
    return "\n".join([*lines, f"With {_versions(figures.values())}.", ""])


def _table(
    figures: Mapping[tuple[str, str], Mapping[str, Any]], robots: Sequence[str], backends: Sequence[str], least: float
) -> Iterable[str]:
    yield f"| robot | {' | '.join(backends)} |"
    yield "|---" * (len(backends) + 1) + "|"
    for robot in robots:
        found = [figures.get((robot, backend)) for backend in backends]
        yield f"| `{robot}` | {' | '.join(told(figure, least) for figure in found)} |"


def told(figure: Mapping[str, Any] | None, least: float = 0.0) -> str:
    """Successes of episodes and the rate's interval; bold where the rate is below what is asked."""
    if figure is None:
        return "not run"
    rate = proportion(figure["successes"], figure["episodes"])
    words = f"{figure['successes']} of {figure['episodes']} [{rate.low:.3f}, {rate.high:.3f}]"
    return f"**{words}**" if rate.value < least else words


def _versions(figures: Iterable[Mapping[str, Any]]) -> str:
    found = {name: version for figure in figures for name, version in figure["versions"].items()}
    return ", ".join(f"{name} {version}" for name, version in sorted(found.items()))


if __name__ == "__main__":
    main(tyro.cli(TableSettings))
