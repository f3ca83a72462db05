"""Environment with the keys of LeRobot's evaluation, all environments stepped by one engine; it imports no LeRobot.

LeRobot renames them: ``agent_pos`` to ``observation.state``, ``environment_state`` to
``observation.environment_state``, ``pixels`` to ``observation.images.<term>``. Each has the terms that datasets of
LeRobot's layout have in that column (:mod:`orbit_data.lerobot`), so that a policy trained on one acts in the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.envs.observation_layout import POLICY, Observation, TermLayout
from orbit_core.envs.task import instruction_of
from orbit_core.interfaces import ArgumentError
from orbit_core.rollout.pictures import OverviewCamera
from orbit_data.lerobot import STATE, joint_terms, state_column
from orbit_data.manifest.manifest import Manifest
from orbit_learn.ends import all_ends
from orbit_learn.gymnasium import as_tensor

_SIZE = (320, 240)
JOINTS, STATE_OF_SCENE, PICTURES = "agent_pos", "environment_state", "pixels"
Arrays = dict[str, npt.NDArray[Any] | dict[str, npt.NDArray[Any]]]
"""Observation by LeRobot's keys: numbers (N, K), and pictures (N, H, W, 3) by name."""


class LeRobotEnvironment(gymnasium.vector.VectorEnv[Arrays, npt.NDArray[np.float32], npt.NDArray[Any]]):
    """N environments as LeRobot's evaluation steps them. An environment begins again in the step that ends it.

    Args:
        environment: that is stepped; it is closed with this one.
        task: name that it was made by.
        instruction: the task in words, for policies of vision and language; the task's own if None.
        scene_state: whether numbers other than those of joints are shown; policies of pictures do without.
    """

    def __init__(
        self, environment: Environment, task: str, instruction: str | None = None, scene_state: bool = True
    ) -> None:
        self.environment, self.task = environment, task
        self.task_description = instruction_of(environment.task, task, instruction)
        self.num_envs = environment.num_envs
        self._max_episode_steps = environment.max_episode_steps
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": round(1.0 / environment.step_dt),
            "autoreset_mode": AutoresetMode.SAME_STEP,
        }
        self.render_mode = "rgb_array"
        self._numbers, self._films = _shown(environment, task, scene_state)
        boxes: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(-np.inf, np.inf, (_size(environment, terms),), np.float32)
            for key, terms in self._numbers.items()
        }
        if self._films:
            layouts = environment.observation[POLICY].terms
            films: dict[str, spaces.Space[Any]] = {
                name: spaces.Box(0, 255, layouts[name].shape, np.uint8) for name in self._films
            }
            boxes[PICTURES] = spaces.Dict(films)
        self.single_observation_space = spaces.Dict(boxes)
        self.single_action_space = spaces.Box(-1.0, 1.0, (environment.action_size,), np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, self.num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, self.num_envs)
        self._camera: OverviewCamera | None = None

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride] - Gymnasium types infos loosely
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Begin new episodes in all environments.

        Args:
            seed: a seed, or one for each environment, of which the first counts: environment i of a seed begins alike
                for any number of environments.
            options: not used; LeRobot names here that the episodes are those of a new rollout.
        """
        first = seed[0] if isinstance(seed, Sequence) else seed
        observation, _ = self.environment.reset(first)
        return self._arrays(observation), {}

    def step(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, actions: npt.ArrayLike
    ) -> tuple[Arrays, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Take a step; where episodes ended, ``info["final_info"]["is_success"]`` (N,) has their success."""
        action = as_tensor(actions, torch.float32, self.environment.device, "action")
        if action.shape != (self.num_envs, self.environment.action_size):
            raise ArgumentError(
                f"action must have shape ({self.num_envs}, {self.environment.action_size}), not {tuple(action.shape)}"
            )
        observation, reward, terminated, truncated, info = self.environment.step(action.clamp(-1.0, 1.0))
        results = tuple(value.cpu().numpy() for value in (reward, terminated, truncated))
        found = all_ends(info, self.num_envs)
        final = {} if found is None else {"final_info": {"is_success": found[0].success.cpu().numpy()}}
        return self._arrays(observation), *results, final  # pyright: ignore[reportReturnType]

    def call(self, name: str, *args: Any, **keywords: Any) -> Sequence[Any]:
        """Return an attribute, or what a method gives, once for each environment."""
        value: Any = getattr(self, name)
        if not callable(value):
            return (value,) * self.num_envs
        if value == self.render:
            return self.render()
        return (value(*args, **keywords),) * self.num_envs

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute once for each environment."""
        return (getattr(self, name),) * self.num_envs

    def render(self) -> Pictures:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the task's own view of each environment, (240, 320, 3), drawn as it is taken."""
        if self._camera is None:
            # On first use, for a renderer takes memory that evaluations without videos do not need.
            self._camera = OverviewCamera(self.environment.world, *_SIZE, self.environment.task.metadata.view)
        return Pictures(self._camera, self.num_envs)

    def close_extras(self, **keywords: Any) -> None:
        """Close the environment."""
        if self._camera is not None:
            self._camera.close()
        self.environment.close()

    def _arrays(self, observation: Observation) -> Arrays:
        terms = _terms(self.environment, observation)
        shown: Arrays = {
            key: torch.cat([terms[name].float().flatten(1) for name in names], 1).cpu().numpy()
            for key, names in self._numbers.items()
        }
        if self._films:
            shown[PICTURES] = {name: terms[name].cpu().numpy() for name in self._films}
        return shown


class Pictures(Sequence[npt.NDArray[np.uint8]]):
    """Pictures of all environments, of which only those are drawn that are taken: LeRobot films a few of a batch.

    Args:
        camera: that draws.
        count: number of environments.
    """

    def __init__(self, camera: OverviewCamera, count: int) -> None:
        self._camera, self._count = camera, count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, place: int | slice) -> Any:
        rows = range(self._count)[place]
        chosen = torch.tensor([rows] if isinstance(rows, int) else [*rows])
        pictures = [*self._camera.pictures(chosen).numpy()]
        return pictures[0] if isinstance(rows, int) else pictures


def _shown(environment: Environment, task: str, scene_state: bool) -> tuple[dict[str, list[str]], list[str]]:
    """Return the terms of each key of numbers, and the terms that are pictures."""
    layouts = environment.observation[POLICY].terms
    joints = joint_terms(Manifest.of(environment, task, 0))
    numbers: dict[str, list[str]] = {}
    # By name, in the order of a dataset's columns.
    for name in sorted(name for name, layout in layouts.items() if len(layout.shape) < 3):
        key = JOINTS if state_column(name, joints) == STATE else STATE_OF_SCENE
        if key == JOINTS or scene_state:
            numbers.setdefault(key, []).append(name)
    return numbers, [name for name, layout in layouts.items() if _is_picture(layout)]


def _is_picture(layout: TermLayout) -> bool:
    return layout.dtype == torch.uint8 and len(layout.shape) == 3 and layout.shape[2] == 3


def _size(environment: Environment, terms: Sequence[str]) -> int:
    layouts = environment.observation[POLICY].terms
    return sum(int(np.prod(layouts[name].shape)) for name in terms)


def _terms(environment: Environment, observation: Observation) -> Mapping[str, Tensor]:
    """Return the terms (N, ...) of what the policy sees, by name."""
    value = observation[POLICY]
    if isinstance(value, Mapping):
        return value
    return {name: value[:, columns] for name, columns in environment.observation[POLICY].columns.items()}
