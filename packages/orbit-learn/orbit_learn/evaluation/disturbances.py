"""Disturbances that a policy has not learned with, in three levels each.

The axes are those of Fei et al., LIBERO-Plus: In-depth Robustness Analysis of Vision-Language-Action Models (2025),
where cameras and the robot's start cost policies most.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import numpy as np
import torch
from torch import Tensor

from orbit_core.dynamics.indexing import take_rows
from orbit_core.envs.observation_layout import POLICY, groups_of, terms_of_group
from orbit_core.envs.task import instruction_of
from orbit_core.envs.terms import EventTerm
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_core.scene import AmbientLight, CameraSpec, DirectionalLight, Pose, Scene, Texture
from orbit_learn.remote.client import ServerAddress

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_core.envs.task import Task
    from orbit_core.scene import Light

LEVELS = (1, 2, 3)
"""Levels of each axis, the gentlest first."""


@dataclass(frozen=True)
class Disturbance:
    """A level of an axis."""

    axis: str
    level: int

    @staticmethod
    def parse(words: str) -> tuple[Disturbance, ...]:
        """Return one disturbance of ``axis:level``, or all levels of ``axis``.

        Raises:
            UnknownNameError: there is no such axis.
            ConfigurationError: there is no such level.
        """
        axis, colon, level = words.partition(":")
        if axis not in AXES:
            raise UnknownNameError("axis", axis, AXES, "orbit evaluate")
        if not colon:
            return tuple(Disturbance(axis, each) for each in LEVELS)
        if level not in map(str, LEVELS):
            raise ConfigurationError(
                f"axis '{words}' is NAME or NAME:LEVEL, with a level of {LEVELS[0]} to {LEVELS[-1]}"
            )
        return (Disturbance(axis, int(level)),)

    def __str__(self) -> str:
        return f"{self.axis} {self.level}"

    def prepare(self, task: Task) -> None:
        """Change a task before its environment is made.

        Raises:
            ConfigurationError: the axis does not apply to the task or to what its policy sees.
        """
        if AXES[self.axis].pictures and not _cameras_of(task):
            raise ConfigurationError(
                f"axis '{self.axis}' changes pictures, and the policy of task {type(task).__name__} sees none: leave "
                "it out, or evaluate a policy of pictures"
            )
        if (change := AXES[self.axis].prepare) is not None:
            change(task, self.level)

    def apply(self, environment: Environment) -> None:
        """Change an environment that was made.

        Raises:
            UnsupportedCapabilityError: the renderer cannot show it; names those that can.
        """
        if (change := AXES[self.axis].apply) is not None:
            change(environment, self.level)

    def reword(self, policy: str, environment: Environment) -> str:
        """Return the name of a policy, with another prompt where the axis is language."""
        if self.axis != LANGUAGE:
            return policy
        address = ServerAddress.parse(policy)
        told = address.prompt or instruction_of(environment.task, type(environment.task).__name__)
        prompt = _WORDINGS[self.level - 1].format(told)
        base, _, query = policy.partition("?")
        kept = [part for part in query.split("&") if part and not part.startswith("prompt=")]
        return f"{base}?{'&'.join([*kept, urlencode({'prompt': prompt})])}"


@dataclass(frozen=True)
class Axis:
    """How one kind of disturbance is made."""

    prepare: Callable[[Task, int], None] | None = None
    """Changes a task, by level."""
    apply: Callable[[Environment, int], None] | None = None
    """Changes an environment, by level."""
    pictures: bool = False
    """True if it changes pictures only."""


def _cameras_of(task: Task) -> list[CameraSpec]:
    """Return the cameras whose pictures the policy sees."""
    terms = terms_of_group(groups_of(task)[POLICY]).values()
    return [sensor for term in terms for sensor in term.sensors if isinstance(sensor, CameraSpec)]


def _light(task: Task, level: int) -> None:
    """Let the sun come from elsewhere, dimmer and yellower."""
    kind = type(task)

    def scene(own: Task) -> Scene:
        made = kind.scene(own)
        return replace(made, lights=tuple(_dimmed(light, level) for light in made.lights))

    # Of the same name, for what is written of the task; a task takes no other attributes than its fields.
    other = type(kind.__name__, (kind,), {"scene": scene, "__doc__": kind.__doc__, "__module__": kind.__module__})
    object.__setattr__(task, "__class__", other)


def _dimmed(light: Light, level: int) -> Light:
    if isinstance(light, AmbientLight):
        red, green, blue = (0.8**level * part for part in light.color)
        return AmbientLight((red, green, 0.9**level * blue))
    if not isinstance(light, DirectionalLight):
        return light
    x, y, z = light.direction
    cosine, sine = math.cos(0.7 * level), math.sin(0.7 * level)
    red, green, blue = light.color
    return replace(
        light,
        direction=(cosine * x - sine * y, sine * x + cosine * y, z),
        color=(red, 0.95**level * green, 0.85**level * blue),
        intensity=0.8**level * light.intensity,
    )


def _camera(task: Task, level: int) -> None:
    """Move each camera by 1 cm and 1.5 degrees a level along and about two of its axes."""
    groups = groups_of(task)
    moved = Pose.from_euler(0.026 * level, -0.026 * level, 0.0, (0.01 * level, -0.01 * level, 0.0)).matrix()
    for name, term in terms_of_group(groups[POLICY]).items():
        sensors = tuple(
            replace(sensor, pose=Pose.from_matrix(sensor.pose.matrix() @ moved))
            if isinstance(sensor, CameraSpec)
            else sensor
            for sensor in term.sensors
        )
        setattr(groups[POLICY], name, replace(term, sensors=sensors))


def _start(task: Task, level: int) -> None:
    """Spread the robots' joints by 0.1 rad (m) more a level when an episode begins."""
    placed: EventTerm | None = getattr(task.events, "place_robot", None)
    if placed is None:
        raise ConfigurationError(
            f"axis 'start' spreads joints after event place_robot, which task {type(task).__name__} lacks: leave it out"
        )
    place = placed.function

    def spread(env: Environment, env_ids: Tensor) -> None:
        place(env, env_ids)
        for name in env.task.agents:
            robot = env.world.robots[name]
            offset = env.world.random.uniform((len(robot.joint_names),), -0.1 * level, 0.1 * level, env_ids)
            limits = robot.position_limits
            spread = take_rows(robot.joint_positions, env_ids) + offset
            robot.set_joint_state(spread.clamp(limits[:, 0], limits[:, 1]), env_ids=env_ids)

    task.events.place_robot = replace(placed, function=spread)


def _texture(environment: Environment, level: int) -> None:
    """Lay a chequered cloth over all objects that stand still, with more contrast a level."""
    bright, dark = 255, 255 - 60 * level
    squares = np.where(np.indices((2, 2)).sum(0) % 2, bright, dark).repeat(16, 0).repeat(16, 1)
    texture = Texture(np.repeat(squares[:, :, None], 3, 2).astype(np.uint8), 0.2)
    fixed = [thing for thing in environment.world.objects.values() if thing.spec.fixed_base]
    if not fixed:
        raise ConfigurationError(
            "axis 'texture' covers objects with a fixed base, and the scene has none: leave it out"
        )
    for thing in fixed:
        chosen = torch.zeros(environment.num_envs, len(thing.link_names), dtype=torch.int64, device=environment.device)
        thing.set_textures((texture,), chosen)


_COLORS = ((0.9, 0.6, 0.3), (0.3, 0.5, 0.9), (0.15, 0.15, 0.15))


def _appearance(environment: Environment, level: int) -> None:
    """Paint the robots that act."""
    for name in environment.task.agents:
        robot = environment.world.robots[name]
        color = torch.tensor(_COLORS[level - 1], device=environment.device)
        robot.set_colors(color.expand(environment.num_envs, len(robot.link_names), 3))


LANGUAGE = "language"
_WORDINGS = ("please {}", "the job of the robot: {}, nothing more", "whatever the weather is like today, {}, then stop")
AXES: Mapping[str, Axis] = {
    "light": Axis(prepare=_light, pictures=True),
    "texture": Axis(apply=_texture, pictures=True),
    "camera": Axis(prepare=_camera, pictures=True),
    "start": Axis(prepare=_start),
    "appearance": Axis(apply=_appearance, pictures=True),
    LANGUAGE: Axis(),
}
"""Axes by name."""
