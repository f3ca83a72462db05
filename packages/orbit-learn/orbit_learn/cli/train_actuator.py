"""``orbit train-actuator``: fit a network to what joints of a real, or another, actuator did."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from orbit_core.cli.output import console, new_table, progress_bar
from orbit_core.cli.settings import check_output, check_positive, make_folder, parse_words
from orbit_data.cli.read_budget import ReadSettings


@dataclass(frozen=True, kw_only=True)
class TrainActuatorSettings(ReadSettings):
    """Fit an actuator network to recordings of joints; the last fifth of each is held out to judge it by."""

    recordings: Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE...")]
    """CSV, NPZ or HDF5 files with time, position_target, position, velocity and effort of joints."""
    output: Annotated[Path, arg(metavar="FILE")] = Path("out/actuator.safetensors")
    """File of the network."""
    kind: Literal["mlp", "lstm"] = "lstm"
    """Architecture: a perceptron that sees some steps back, or a recurrent network."""
    hidden_sizes: tuple[int, ...] = ()
    """Units of the hidden layers; 32 32 32 of a perceptron and 8 8 of an LSTM if left out."""
    history: tuple[int, ...] = (0, 2, 4)
    """Steps back that a perceptron sees, the present being 0."""
    unit: Literal["rad", "m"] = "rad"
    """Unit of the joints' positions."""
    passes: int = 150
    """Passes over the recordings."""
    learning_rate: float = 5e-3
    """Initial learning rate; it falls to a hundredth."""
    seed: int = 0
    """Seed of the initial weights."""
    overwrite: bool = False
    """Replace a file of that name."""


def main(words: Sequence[str]) -> None:
    """Fit, write the file, and print the network's error."""
    from orbit_learn.actuators.networks import FitSettings, fit, write_network
    from orbit_learn.actuators.recordings import read_recording

    settings = parse_words(TrainActuatorSettings, words, "orbit train-actuator")
    check_positive("passes", settings.passes)
    recordings = [read_recording(path, settings.budget) for path in settings.recordings]
    make_folder(settings.output)
    check_output(settings.output, ".safetensors", settings.overwrite)
    chosen = FitSettings(
        kind=settings.kind,
        hidden_sizes=settings.hidden_sizes,
        history=settings.history,
        unit=settings.unit,
        passes=settings.passes,
        learning_rate=settings.learning_rate,
        seed=settings.seed,
    )
    with progress_bar() as bar:
        line = bar.add_task("fitting", total=settings.passes)
        found = fit(recordings, chosen, lambda done, loss: bar.update(line, completed=done + 1))
    write_network(settings.output, found.network)
    unit = "N m" if settings.unit == "rad" else "N"
    table = new_table("over the held-out ends", "", title=f"{settings.kind} in {settings.output}")
    table.add_row("rate", f"{found.network.description.rate:g} Hz")
    table.add_row("efforts, root mean square", f"{found.effort:.4g} {unit}")
    table.add_row("error of the network", f"{found.error:.4g} {unit}")
    table.add_row("error of the best PD law", f"{found.line_error:.4g} {unit}")
    console().print(table)
    if found.error >= found.line_error:
        warnings.warn(
            "the network does no better than a PD law: record longer, with targets as the robot will have them",
            stacklevel=2,
        )
