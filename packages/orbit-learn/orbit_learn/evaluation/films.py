"""Videos of failures: episodes of each kind, run again and filmed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from orbit_core.cli.settings import EnvironmentSettings, make_folder
from orbit_core.rollout.pictures import video_recorder
from orbit_learn.evaluation.results import Block, Plan
from orbit_learn.evaluation.running import block_environment, run_block
from orbit_learn.evaluation.statistics import failure_kinds

FOLDER = "failures"
_SIZE = (320, 240)


@dataclass(frozen=True)
class Film:
    """Video of some failures of one kind, side by side."""

    path: str
    """Path from the folder of the page."""
    caption: str
    """Sentence below it: policy, engine, seed and starts, and how many failed again."""


def film_failures(
    plan: Plan,
    blocks: Sequence[Block],
    settings: Mapping[tuple[str, str], EnvironmentSettings],
    count: int,
    folder: Path,
    done: Callable[[str], None],
) -> dict[str, Film]:
    """Run one block of each kind of failure again, and film some of its failures.

    Args:
        plan: that the blocks are of.
        blocks: all results.
        settings: of the environment of each policy on each engine, but for the variant.
        count: episodes of each kind, at most.
        folder: of the page.
        done: is given each kind as its film is there.

    Returns:
        The film of each kind.
    """
    films: dict[str, Film] = {}
    for number, (kind, found) in enumerate(failure_kinds(blocks).items()):
        # The block with the most such failures, so that one run shows several.
        places: dict[int, list[int]] = {}
        for block, index in found:
            places.setdefault(blocks.index(block), []).append(index)
        place, indices = max(places.items(), key=lambda item: len(item[1]))
        key, indices = blocks[place].key, indices[:count]
        path = Path(FOLDER) / f"{number}.mp4"
        make_folder(folder / path)
        with (
            block_environment(plan, key, settings[key.policy, key.backend]) as (environment, disturbance),
            video_recorder(environment, folder / path, indices, *_SIZE) as recorder,
        ):
            again = run_block(environment, key, disturbance, recorder.before_step)
        failed = sum(not again.success[index] for index in indices)
        where = f"{key.policy}, {key.backend}, {key.variant}, seed {key.seed}, starts {', '.join(map(str, indices))}"
        # A policy server, or an engine with threads, may do otherwise the second time.
        films[kind] = Film(path.as_posix(), f"{where}; run again, {failed} of {len(indices)} failed again")
        done(kind)
    return films
