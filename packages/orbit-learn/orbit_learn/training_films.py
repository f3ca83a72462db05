"""Videos of the policies that a training writes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch

from orbit_core.cli.making import make_environment
from orbit_core.cli.settings import EnvironmentSettings, make_folder
from orbit_core.envs.environment import Environment
from orbit_core.rollout.pictures import video_recorder
from orbit_core.rollout.stepping import roll_out

FOLDER = "videos"
_SIZE = (400, 304)


class TrainingFilms:
    """Films an episode of each policy in an environment that it makes for the first of them.

    Args:
        settings: of the training's environment.
        folder: of the training, into whose folder ``videos`` they go.
    """

    def __init__(self, settings: EnvironmentSettings, folder: Path) -> None:
        # One environment steps for seconds, which compiling its step would take alone.
        self._settings, self._folder = replace(settings, compile=False), folder
        self._environment: Environment | None = None

    def film(self, policy: Path) -> Path:
        """Film an episode of a policy's file, always from the same start, and return the video.

        Raises:
            ConfigurationError: the backend draws no pictures, or the encoder is not installed.
        """
        from orbit_learn.policy import PolicyActor

        path = self._folder / FOLDER / f"{policy.stem}.mp4"
        make_folder(path)
        devices = list(range(torch.cuda.device_count())) if self._settings.device.startswith("cuda") else []
        # A training with videos explores as one without them.
        with torch.random.fork_rng(devices):
            if self._environment is None:
                self._environment = make_environment(self._settings, 1, reset_diverged=True)
            environment, actor = self._environment, PolicyActor(self._environment, policy)
            environment.reset(self._settings.seed)
            with video_recorder(environment, path, 1, *_SIZE) as recorder:
                roll_out(environment, actor, (recorder,), max_steps=environment.max_episode_steps)
        return path

    def close(self) -> None:
        """Free the environment."""
        if self._environment is not None:
            self._environment.close()
