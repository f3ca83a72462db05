"""Curves in trackers of experiments: Weights & Biases, and Trackio on this machine."""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError
from orbit_learn.trainer import Progress

# Seconds in which the service must answer; its own patience is a minute and a half.
_PATIENCE = 20.0


class TrackerLog:
    """Run of a tracker that takes a training's curve."""

    _run: Any
    """Run of the tracker's package."""

    def add(self, progress: Progress) -> None:
        """Add an iteration; numbers that do not exist yet are left out."""
        numbers = {
            "episode/return": progress.episode_return,
            "episode/success_rate": progress.success_rate,
            "loss": progress.loss,
            "env_steps": progress.env_steps,
            "env_steps_per_second": progress.env_steps / progress.seconds,
            "diverged": progress.diverged,
            **{f"episode/success_rate_{name}": value for name, value in progress.engines.items()},
            **{f"metrics/{name}": value for name, value in progress.metrics.items()},
        }
        known = {name: value for name, value in numbers.items() if not math.isnan(value)}
        self._run.log(known, step=progress.iteration)

    def close(self) -> None:
        """End the run; what is left is sent or written first."""
        self._run.finish()


class WandbLog(TrackerLog):
    """Run of Weights & Biases that takes a training's curve. With WANDB_MODE=offline nothing leaves the machine.

    Args:
        project: name of the project.
        folder: folder of the training, into which the run's files go; its name is the run's.
        config: settings that the run shows.

    Raises:
        ConfigurationError: the package is not installed, nobody is logged in, or the service does not answer.
    """

    def __init__(self, project: str, folder: Path, config: Mapping[str, Any]) -> None:
        try:
            import wandb  # pyright: ignore[reportMissingImports]
            from wandb.errors import Error  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise ConfigurationError(f"--wandb needs Weights & Biases: {install_extra('wandb')}") from error
        folder.mkdir(parents=True, exist_ok=True)
        settings = wandb.Settings(init_timeout=_PATIENCE, silent=True)
        try:
            self._run = wandb.init(
                project=project, name=folder.name, dir=str(folder), config=dict(config), settings=settings
            )
        except Error as error:
            words = " ".join(str(error).split())
            raise ConfigurationError(
                f"Weights & Biases takes no run ({words}): log in with 'wandb login', or set WANDB_MODE=offline, which "
                f"keeps the run in {folder / 'wandb'} for 'wandb sync'"
            ) from error


class TrackioLog(TrackerLog):
    """Run of Trackio that takes a training's curve, in a database on this machine: TRACKIO_DIR, or the package's own.

    Args:
        project: name of the project.
        folder: folder of the training, whose name is the run's.
        config: settings that the run shows.

    Raises:
        ConfigurationError: the package is not installed, or keeps no project of that name.
    """

    def __init__(self, project: str, folder: Path, config: Mapping[str, Any]) -> None:
        try:
            import trackio  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise ConfigurationError(f"--trackio needs Trackio: {install_extra('trackio')}") from error
        # It leaves other characters out, and so would add the run to a project of another name.
        if not re.fullmatch(r"[\w-]+", project):
            raise ConfigurationError(f"--trackio is a project's name of letters, digits, - and _, not '{project}'")
        # It prints how to look at the run, which would break the bar; the docs say it.
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                self._run = trackio.init(
                    project=project, name=folder.name, config=dict(config), auto_log_gpu=False, auto_log_cpu=False
                )
        except ValueError as error:  # of names that Trackio reserves
            raise ConfigurationError(f"--trackio '{project}': {error}") from error

    def close(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            super().close()
