"""What the commands take, as dataclasses: from them come the command line's options and a TOML file's keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, Suppress, UseAppendAction, arg

Name = Annotated[str | None, arg(metavar="NAME")]
File = Annotated[Path | None, arg(metavar="FILE")]
KeyValues = Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="KEY=VALUE")]


@dataclass(frozen=True, kw_only=True)
class EnvironmentSettings:
    """Which task, and how it is simulated."""

    task: Annotated[Positional[str | None], arg(metavar="TASK")] = None
    """Name of a task ('orbit list tasks'); may stand in the file instead."""
    backend: Name = None
    """Physics backend ('orbit list backends'); may be left out if only one is installed."""
    robot: Name = None
    """Robot of the catalogue ('orbit list robots') in the place of the task's own."""
    action: Name = None
    """Action space in the place of the task's own."""
    renderer: Name = None
    """Renderer ('orbit list renderers') or backend that draws; the physics backend if left out."""
    matter: Name = None
    """Matter solver of cloth and rope ('orbit list matter'), or 'native' for the backend's own; the first installed one
    that does what the task needs if left out."""
    device: Annotated[str, arg(metavar="NAME")] = "cpu"
    """Torch device that holds all state, such as 'cpu' or 'cuda:0'."""
    compile: bool = False
    """Compile the layer's part of a step: seconds at the first steps, and less time in all that follow."""
    capture: bool = True
    """Capture the step once on a GPU and repeat it without its Python; without, a task may count in plain Python, and
    each step waits for the device."""
    check_finite: bool = False
    """Stop at an observation that is NaN or infinite on a GPU too; each step then waits for the device."""
    seed: int = 0
    """Seed of every environment's random stream."""
    set: KeyValues = ()
    """A field of the task, such as tolerance=0.03 ('orbit info TASK')."""
    setting: KeyValues = ()
    """A setting of the physics backend, such as iterations=50 ('orbit info BACKEND')."""
    renderer_setting: KeyValues = ()
    """A setting of what draws, such as samples_per_pixel=4 ('orbit info RENDERER')."""
    matter_setting: KeyValues = ()
    """A setting of the matter solver, such as substep=0.0005."""
    config: File = None
    """TOML file with the same keys as these options, and the tables [fields], [settings], [renderer_settings] and
    [matter_settings]; options win over it."""
    fields: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The task's fields from the file; ``set`` wins over them."""
    settings: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The physics backend's settings from the file; ``setting`` wins over them."""
    renderer_settings: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The renderer's settings from the file; ``renderer_setting`` wins over them."""
    matter_settings: Suppress[Mapping[str, Any]] = field(default_factory=dict)
    """The matter solver's settings from the file; ``matter_setting`` wins over them."""


@dataclass(frozen=True, kw_only=True)
class RunSettings(EnvironmentSettings):
    """Run a task's episodes and report success, metrics, return and speed."""

    num_envs: int = 16
    """Environments stepped together."""
    episodes: int = 200
    """Episodes that count, divided evenly over the environments, so that short ones are not preferred."""
    agent: Annotated[str, arg(metavar="{expert,random,zero,hold,POLICY}")] = "expert"
    """Who acts: one of these, a kept policy ('orbit list policies'), or the file or folder of a learned one."""
    json: File = None
    """Write the result here."""
    video: File = None
    """Write an mp4 of the first episode of up to four environments here."""
    video_size: tuple[int, int] = (400, 304)
    """Width and height of an environment's picture in the video, multiples of 16."""
    frames: bool = False
    """Draw axes in the video at the robot's base, end effectors, finger tips, feet and wheels."""
    overwrite: bool = False
    """Replace files of those names that are there already."""


@dataclass(frozen=True, kw_only=True)
class BenchSettings(EnvironmentSettings):
    """Measure throughput over numbers of environments, with random actions."""

    num_envs: tuple[int, ...] = (1, 4, 16, 64, 256)
    """Numbers of environments to measure at."""
    steps: int = 200
    """Steps of all environments that are timed at each number, after a tenth as many to warm up."""
    json: File = None
    """Write the figures here."""
    plot: File = None
    """Draw the figures here, as PNG."""
    overwrite: bool = False
    """Replace files of those names that are there already."""
