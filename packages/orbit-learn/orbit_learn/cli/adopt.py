"""``orbit adopt``: an ONNX model that was learned elsewhere as a policy of a task."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from orbit_core.cli.making import make_environment
from orbit_core.cli.output import console, new_table
from orbit_core.cli.settings import EnvironmentSettings, Name, check_output, make_folder, parse_settings
from orbit_core.files import check_apart
from orbit_core.interfaces.errors import ConfigurationError

if TYPE_CHECKING:
    from orbit_core.envs.environment import Environment
    from orbit_learn.adoption import Shown


@dataclass(frozen=True, kw_only=True)
class AdoptSettings(EnvironmentSettings):
    """Write an ONNX model that was learned elsewhere as a policy of a task, which is played and evaluated like others.

    Inputs that no option describes are asked for where a person sits at a terminal.
    """

    model: Annotated[Positional[Path], arg(metavar="MODEL")]
    """The ONNX file; its inputs and outputs have shape (environments, numbers)."""
    task: Name = None
    """Task that it is for."""
    input: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=TERM,...")] = ()
    """Observation terms that make up an input of the model, in order, such as
    'state=joint_positions,cube_pose[0:3]*2'; repeatable."""
    action_from: Name = None
    """Output of the model that is the action; may be left out where there is one."""
    action_scale: float = 1.0
    """Factor of that output to the action in [-1, 1]."""
    output: Annotated[Path, arg(metavar="FILE")] = Path("out/adopted.onnx")
    """The policy."""
    overwrite: bool = False
    """Replace an existing file of that name."""


def main(words: Sequence[str]) -> None:
    """Ask what is not said, and write the policy."""
    from orbit_learn.adoption import Shown, adopt, signature_of

    settings = parse_settings(AdoptSettings, words, "orbit adopt")
    make_folder(settings.output)
    check_apart(settings.output, [settings.model])
    check_output(settings.output, ".onnx", settings.overwrite)
    signature = signature_of(settings.model)
    inputs: dict[str, tuple[Shown, ...]] = {}
    for word in settings.input:
        name, equals, text = word.partition("=")
        if not equals or name in inputs:
            raise ConfigurationError(f"--input is NAME=TERM,..., each name once, not '{word}'")
        inputs[name] = Shown.of_text(text)
    environment = make_environment(settings, 1)
    try:
        for name in signature.inputs.keys() - inputs.keys() if sys.stdin.isatty() else ():
            inputs[name] = _asked(name, signature.inputs[name], environment)
        adopt(
            settings.model, settings.output, environment, settings.task or "", inputs, settings.action_from,
            settings.action_scale,
        )  # fmt: skip
    finally:
        environment.close()
    console().print(f"{settings.output} is a policy: orbit play {settings.output}", soft_wrap=True)


def _asked(name: str, size: int, environment: Environment) -> tuple[Shown, ...]:
    """Ask which terms an input is made of, until the answer can be read."""
    from orbit_learn.adoption import Shown

    table = new_table("term", "numbers", "bounds", title="what the policy may see")
    for term, layout in environment.observation["policy"].terms.items():
        table.add_row(term, "x".join(map(str, layout.shape)), f"{layout.low:g} to {layout.high:g}")
    console().print(table)
    while True:
        text = console().input(f"input '{name}' has {size} numbers; its terms in order, separated by commas: ")
        try:
            return Shown.of_text(text)
        except ConfigurationError as error:
            console().print(str(error), soft_wrap=True)
