"""Videos of failures: episodes of each kind, run again and filmed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from orbit_core.cli.settings import EnvironmentSettings, make_folder
from orbit_core.files import read_bytes, written_whole
from orbit_core.rollout.pictures import video_recorder
from orbit_learn.evaluation.results import Block, Plan
from orbit_learn.evaluation.running import block_environment, run_block
from orbit_learn.evaluation.statistics import failure_kinds

FOLDER = "failures"
# File in it: caption of each film by its name.
_CAPTIONS = "films.json"
_MOST_BYTES = 1 << 20
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

    Films of the same results that an earlier call left in the folder are kept, and its others deleted.

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
    captions = _captions(folder / FOLDER / _CAPTIONS)
    for kind, found in failure_kinds(blocks).items():
        # The block with the most such failures, so that one run shows several.
        places: dict[int, list[int]] = {}
        for block, index in found:
            places.setdefault(blocks.index(block), []).append(index)
        place, indices = max(places.items(), key=lambda item: len(item[1]))
        key, indices = blocks[place].key, indices[:count]
        own = settings[key.policy, key.backend]
        name = _name(plan, blocks[place], own, indices)
        path = Path(FOLDER) / f"{name}.mp4"
        if name not in captions or not (folder / path).is_file():
            make_folder(folder / path)
            with (
                block_environment(plan, key, own) as (environment, disturbance),
                video_recorder(environment, folder / path, indices, *_SIZE) as recorder,
            ):
                again = run_block(environment, key, disturbance, recorder.before_step)
            failed = sum(not again.success[index] for index in indices)
            where = (
                f"{key.policy}, {key.backend}, {key.variant}, seed {key.seed}, starts {', '.join(map(str, indices))}"
            )
            # A policy server, or an engine with threads, may do otherwise the second time.
            captions[name] = f"{where}; run again, {failed} of {len(indices)} failed again"
            with written_whole(folder / FOLDER / _CAPTIONS) as written:
                written.write_text(json.dumps(captions, indent=1), encoding="utf-8")
        films[kind] = Film(path.as_posix(), captions[name])
        done(kind)
    used = {Path(film.path).name for film in films.values()}
    for path in (folder / FOLDER).glob("*.mp4"):
        if path.stem in captions and path.name not in used:
            path.unlink()
    return films


def _name(plan: Plan, block: Block, settings: EnvironmentSettings, indices: Sequence[int]) -> str:
    """Return a name for the film of some starts of a block; equal results have equal names."""
    key = block.key
    told = {
        "block": asdict(block),
        "starts": indices,
        "policy": plan.digests.get(key.policy, ""),
        "variant": plan.variants[key.variant],
        "disturbance": plan.disturbances.get(key.variant),
        "settings": repr(settings),
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]


def _captions(path: Path) -> dict[str, str]:
    """Return the captions of the films of earlier calls; none where their file is damaged."""
    try:
        return msgspec.json.decode(read_bytes(path, _MOST_BYTES), type=dict[str, str]) if path.exists() else {}
    except msgspec.MsgspecError:
        return {}
