"""Environments with Gymnasium's interface: a VectorEnv of torch tensors, and a single environment of NumPy arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.envs.episode import EpisodeEnd
from orbit_core.envs.making import make
from orbit_core.envs.observation_layout import Observation, map_leaves
from orbit_core.envs.task import Task
from orbit_core.interfaces import ArgumentError, ConfigurationError
from orbit_core.rollout.pictures import Spectator as FilmCamera
from orbit_core.scene import STUDIO
from orbit_core.world.lifetime import mark_closed
from orbit_learn.ends import all_ends
from orbit_learn.spaces import action_space, observation_space

Arrays = dict[str, npt.NDArray[Any] | dict[str, npt.NDArray[Any]]]
"""Observation groups by name, each an array or a dictionary of its terms' arrays."""


class VectorEnvironment(gymnasium.vector.VectorEnv[Observation, Tensor, Tensor]):
    """N environments, with torch tensors on the environment's device, reset in the same step as they end.

    Where an episode ended (the mask ``info["_final_obs"]`` (N,)), ``info["final_obs"]`` (N, ...) has its last
    observation, and ``info["final_info"]`` success and metrics. On a GPU they exist at every step, because leaving them
    out would wait for the device.

    Args:
        task: a task or its name.
        num_envs: number N of environments.
        render_mode: ``"rgb_array"`` for pictures, or None.
        numpy: return NumPy arrays instead of tensors, for Gymnasium's own wrappers, which compute with NumPy.
        keywords: those of :func:`orbit_core.envs.make`: backend, device, seed, and the task's own fields.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - Gymnasium looks at the class's own
    """Render modes and rate, and the autoreset mode, as Gymnasium reads them."""

    def __init__(
        self,
        task: str | Task,
        num_envs: int = 1,
        render_mode: str | None = None,
        numpy: bool = False,
        **keywords: Any,
    ) -> None:
        self.environment = make(task, num_envs=num_envs, **keywords)
        """ORBIT's environment, for what Gymnasium's interface lacks."""
        self._numpy = numpy
        # An attribute of the instance, because the frame rate depends on the task.
        self.metadata = _metadata(self.environment, AutoresetMode.SAME_STEP)
        self.render_mode = checked_mode(render_mode)
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self.environment)
        """Space of one environment's observation."""
        self.single_action_space = action_space(self.environment)
        """Space of one environment's action, in [-1, 1]."""
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        """Space of all observations, (N, ...)."""
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        """Space of all actions, (N, A)."""
        self._spectator = Spectator(self.environment, self.render_mode)

    @property
    def device(self) -> torch.device:
        """Device of all tensors."""
        return self.environment.device

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride] - Gymnasium types infos loosely
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin new episodes, in all environments or where ``options["reset_mask"]`` (N,) bool is true.

        Raises:
            ConfigurationError: another option is given.
        """
        given = dict(options or {})
        mask = given.pop("reset_mask", None)
        refuse_options(given, "'reset_mask'")
        env_ids = None if mask is None else as_tensor(mask, None, self.device, "reset_mask")
        return self._given(self.environment.reset(seed, env_ids))

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, actions: Tensor | npt.ArrayLike
    ) -> tuple[Observation, Tensor, Tensor, Tensor, dict[str, Any]]:
        action = as_tensor(actions, torch.float32, self.device, "action")
        observation, reward, terminated, truncated, info = self.environment.step(action)
        found = all_ends(info, self.num_envs)
        final = {} if found is None else _final(*found)
        return self._given((observation, reward, terminated, truncated, final))

    def _given(self, results: Any) -> Any:
        """Return results as tensors or, if requested, as NumPy arrays."""
        return _host_arrays(results) if self._numpy else results

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        pictures = self._spectator.pictures()
        return None if pictures is None else tuple(pictures)

    def close_extras(self, **kwargs: Any) -> None:
        self._spectator.close()
        self.environment.close()
        mark_closed(self, "the environment")


class SingleEnvironment(gymnasium.Env[Arrays, npt.NDArray[np.float32]]):
    """One environment with NumPy arrays, which waits for ``reset`` after an episode, like Gymnasium's.

    Until then it keeps the episode's last state, and a step raises a ConfigurationError.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - Gymnasium looks at the class's own
    """Render modes and rate, and the autoreset mode, as Gymnasium reads them."""

    def __init__(self, task: str | Task, render_mode: str | None = None, **keywords: Any) -> None:
        # Gymnasium's single environments are reset by their user, unlike its vector environments here.
        self.environment = make(task, num_envs=1, autoreset=False, **keywords)
        """ORBIT's environment, for what Gymnasium's interface lacks."""
        self.metadata = _metadata(self.environment, AutoresetMode.DISABLED)
        self.render_mode = checked_mode(render_mode)
        """``"rgb_array"``, or None without pictures."""
        self.observation_space: spaces.Space[Arrays] = observation_space(self.environment)  # pyright: ignore
        """Space of an observation."""
        self.action_space = action_space(self.environment)
        """Space of an action, in [-1, 1]."""
        self._spectator = Spectator(self.environment, self.render_mode)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Arrays, dict[str, Any]]:
        refuse_options(options, "none")
        observation, info = self.environment.reset(seed)
        super().reset(seed=seed)  # which seeds only Gymnasium's own generator
        return arrays_of(observation), info

    def step(self, action: npt.NDArray[np.float32]) -> tuple[Arrays, float, bool, bool, dict[str, Any]]:
        # A batch of one, which the results below lose again.
        batch = as_tensor(action, torch.float32, self.environment.device, "action")[None]
        observation, reward, terminated, truncated, info = self.environment.step(batch)
        return arrays_of(observation), float(reward), bool(terminated), bool(truncated), outcome(info.get("final"), 0)

    def render(self) -> npt.NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        pictures = self._spectator.pictures()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        self._spectator.close()
        self.environment.close()
        mark_closed(self, "the environment")


class Spectator:
    """Source of the pictures of ``render``, from the task's own view; its camera is made on first use."""

    def __init__(self, environment: Environment, render_mode: str | None) -> None:
        self._environment = environment
        self._render_mode = render_mode
        self._camera: FilmCamera | None = None

    def pictures(self) -> npt.NDArray[np.uint8] | None:
        """Draw pictures (N, 480, 640, 3) of all environments; None without a render mode."""
        if self._render_mode is None:
            return None
        # On first use, because a renderer takes memory that environments without pictures do not need.
        if self._camera is None:
            # One sample: render() is called at each step of a training that films itself.
            self._camera = FilmCamera(self._environment, 640, 480, studio=replace(STUDIO, samples=1))
        return self._camera.pictures(seconds=self._environment.step_dt).numpy()

    def close(self) -> None:
        """Close the camera; the environment stays open."""
        if self._camera is not None:
            self._camera.close()


def refuse_options(options: Mapping[str, Any] | None, known: str) -> None:
    """Refuse options that ``reset`` does not have.

    Raises:
        ConfigurationError: there are such options; the message names them.
    """
    if options:
        names = ", ".join(repr(name) for name in options)
        raise ConfigurationError(f"reset has no option {names}, but {known}: set the task's fields when making it")


def as_tensor(values: object, dtype: torch.dtype | None, device: torch.device, what: str) -> Tensor:
    """Convert values of Gymnasium's users to a tensor: a tensor on any device, an array or nested lists.

    Raises:
        ArgumentError: the values are not numbers.
    """
    try:
        return torch.as_tensor(values, dtype=dtype, device=device)
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise ArgumentError(f"{what} must be a tensor or an array of numbers: {error}") from None


def _metadata(environment: Environment, mode: AutoresetMode) -> dict[str, Any]:
    return {"render_modes": ["rgb_array"], "render_fps": round(1.0 / environment.step_dt), "autoreset_mode": mode}


def checked_mode(render_mode: str | None) -> str | None:
    """Check and return the render mode.

    Raises:
        ConfigurationError: the mode is unknown.
    """
    if render_mode not in (None, "rgb_array"):
        raise ConfigurationError(f"render_mode '{render_mode}' is unknown: use 'rgb_array', or 'orbit view' to watch")
    return render_mode


def _final(everyone: EpisodeEnd, ended: Tensor) -> dict[str, Any]:
    information: Mapping[str, Tensor] = {"success": everyone.success, "steps": everyone.steps, **everyone.metrics}
    return {
        "final_obs": everyone.observation,
        "_final_obs": ended,
        "final_info": information,
        "_final_info": ended,
    }


def outcome(end: EpisodeEnd | None, row: int) -> dict[str, Any]:
    """Return success and metrics of one of the ended episodes; empty if none ended."""
    if end is None:
        return {}
    metrics = {name: float(value[row]) for name, value in end.metrics.items()}
    return {"success": bool(end.success[row]), **metrics}


def arrays_of(observation: Observation) -> Arrays:
    """Return the first environment's observation as NumPy arrays."""
    return _host_arrays(map_leaves(lambda value: value[0], observation))


def _host_arrays(values: Any) -> Any:
    """Convert the tensors in a tree of tuples and dictionaries to NumPy arrays."""
    if isinstance(values, Tensor):
        return values.cpu().numpy()
    if isinstance(values, tuple):
        return tuple(map(_host_arrays, values))
    return {name: _host_arrays(value) for name, value in values.items()}
