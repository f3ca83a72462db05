"""``orbit grasp``: a person directs an arm that grasps, in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from orbit_core.cli.making import make_environment
from orbit_core.cli.settings import EnvironmentSettings, check_steps, parse_settings


@dataclass(frozen=True, kw_only=True)
class GraspSettings(EnvironmentSettings):
    """Have an arm grasp what you choose, in the browser."""

    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets other machines take part."""
    port: int = 8080
    """Port to listen on."""
    max_steps: Annotated[int | None, arg(metavar="INT")] = None
    """Stop after that many steps; run until interrupted if left out."""


def main(words: Sequence[str]) -> None:
    """Show the task's scene until interrupted, or for ``max_steps``."""
    settings = parse_settings(GraspSettings, words, "orbit grasp")
    check_steps(settings.max_steps)
    environment = make_environment(settings, 1)
    try:
        from orbit_motion.grasping.tool import GraspedEnvironment, GraspTool
        from orbit_viewer.viewer import Viewer

        grasped = GraspedEnvironment(environment)
        title = f"ORBIT {settings.task} on {environment.world.backend}"
        with Viewer(
            grasped,
            grasped,
            settings.host,
            settings.port,
            title,
            tool=lambda server, scene: GraspTool(grasped.workflow, server, scene),
        ) as viewer:
            print(f"grasp at {viewer.url}", flush=True)
            viewer.run(settings.max_steps)
        grasped.workflow.close()
    finally:
        environment.close()
