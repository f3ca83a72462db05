"""Results of an evaluation as a file that grows block by block, so that one that was cut off goes on."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import msgspec

from orbit_core.files import append_line, as_path, read_bytes
from orbit_core.interfaces import ConfigurationError

_MOST_BYTES = 1 << 28
BASE = "as it is"
"""Name of the variant without changes."""


@dataclass(frozen=True)
class Plan:
    """Plan of an evaluation; a file of results holds one plan."""

    task: str
    """Name of the task."""
    policies: tuple[str, ...]
    """Kept policies or paths of policy files."""
    backends: tuple[str, ...]
    """Names of the engines."""
    variants: dict[str, tuple[str, ...]]
    """Changes of the task by the variant's name, each ``key=value``; :data:`BASE` has none."""
    seeds: tuple[int, ...]
    """Seeds of the random streams; equal seeds give equal starts."""
    episodes: int
    """Episodes of each policy, engine, variant and seed."""
    settings: dict[str, str] = field(default_factory=dict)
    """Other settings of the environment from the command line."""
    disturbances: dict[str, tuple[str, int]] = field(default_factory=dict)
    """Axis and level of the variants that are levels of an axis (:mod:`orbit_learn.evaluation.disturbances`)."""
    digests: dict[str, str] = field(default_factory=dict)
    """Digest of each policy's file; files of results that were begun without have none."""
    recipes: dict[str, str] = field(default_factory=dict)
    """Name of what each policy is a training of; trainings of one recipe differ in their seed."""

    def recipe(self, policy: str) -> str:
        """Return the recipe of a policy; a policy without one is its own."""
        return self.recipes.get(policy, policy)

    def blocks(self) -> Iterator[BlockKey]:
        """Yield all blocks, those of one environment one after another."""
        # Engine and variant outermost: an environment is built once for all policies and seeds.
        for backend in self.backends:
            for variant in self.variants:
                for policy in self.policies:
                    for seed in self.seeds:
                        yield BlockKey(policy, backend, variant, seed)


@dataclass(frozen=True)
class BlockKey:
    """Episodes that are run together."""

    policy: str
    """One of the plan's policies."""
    backend: str
    """One of its engines."""
    variant: str
    """Name of one of its variants."""
    seed: int
    """One of its seeds."""


@dataclass(frozen=True)
class Block:
    """Results of a block: a value for each start, in the order of starts."""

    key: BlockKey
    """Policy, engine, variant and seed."""
    engine: str
    """Names and versions of the packages that the engine depends on."""
    success: tuple[bool, ...]
    """True for episodes that succeeded."""
    returns: tuple[float, ...]
    """Sum of each episode's rewards."""
    steps: tuple[int, ...]
    """Length of each episode."""
    metrics: dict[str, tuple[float, ...]]
    """Metrics of the task at each episode's end, by name."""
    rewards: dict[str, tuple[float, ...]]
    """Each term's contribution to the return."""
    failed: tuple[bool, ...]
    """Episodes in which the policy did not answer, or the simulation diverged; they count as failures."""
    reached: tuple[int, ...] = ()
    """Steps until success, from which on it lasted to the end; of a failure the episode's steps."""
    fingerprint: str = ""
    """Digest of the first observations, rounded: blocks of one seed begin alike."""


class ResultFile:
    """Reads and extends a file of results: a line for the plan, and one for each block.

    Args:
        path: of the file (JSON lines).
        plan: that it must hold.

    Raises:
        ConfigurationError: the file holds results of another plan, or is none.
    """

    def __init__(self, path: Path | str, plan: Plan) -> None:
        self.path = as_path(path)
        self.plan = plan
        self.blocks: dict[BlockKey, Block] = {}
        """Results so far, by key."""
        if not self.path.exists():
            append_line(self.path, json.dumps({"plan": asdict(plan)}))
            return
        recorded, blocks = read_results(self.path)
        if recorded != plan and not blocks:
            # Left by a call that failed before its first block ended, such as one with a wrong robot.
            self.path.unlink()
            append_line(self.path, json.dumps({"plan": asdict(plan)}))
            return
        changed = [name for name, digest in recorded.digests.items() if plan.digests.get(name, digest) != digest]
        if changed:
            raise ConfigurationError(
                f"{self.path} holds results of '{changed[0]}' before it was trained again: give another --output, or "
                "remove the file"
            )
        if replace(recorded, digests=plan.digests) != plan:
            differing = [name for name in asdict(plan) if getattr(plan, name) != getattr(recorded, name)]
            differing = [name for name in differing if name != "digests"]
            raise ConfigurationError(
                f"{self.path} holds another evaluation, which differs in {', '.join(differing)}: give another "
                "--output, or the words that it was begun with"
            )
        self.blocks = {block.key: block for block in blocks}
        # The next block would continue a line that was cut off, and neither could be read.
        whole = read_bytes(self.path, _MOST_BYTES).rfind(b"\n") + 1
        if whole < self.path.stat().st_size:
            os.truncate(self.path, whole)

    def add(self, block: Block) -> None:
        """Append a block; the line is whole on disk when this returns."""
        append_line(self.path, json.dumps({"block": asdict(block)}))
        self.blocks[block.key] = block

    def left(self) -> list[BlockKey]:
        """Return the blocks that are not there yet."""
        return [key for key in self.plan.blocks() if key not in self.blocks]


def read_results(path: Path | str) -> tuple[Plan, list[Block]]:
    """Read a file of results; a last line that was cut off is left out.

    Raises:
        ConfigurationError: it is no such file.
    """
    path = as_path(path)
    lines = read_bytes(path, _MOST_BYTES).split(b"\n")
    try:
        plan = msgspec.convert(msgspec.json.decode(lines[0])["plan"], Plan)
        # The last line is empty, or was cut off in the middle of a write; its block is run again.
        blocks = [msgspec.convert(msgspec.json.decode(line)["block"], Block) for line in lines[1:-1] if line]
    except (msgspec.DecodeError, msgspec.ValidationError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path} holds no results of an evaluation: {error}") from None
    return plan, blocks


def read_beside(path: Path | str, plan: Plan) -> list[Block]:
    """Read the results of a plan that was run elsewhere, such as with other versions of the engines.

    Raises:
        ConfigurationError: they are of another plan, or not all there.
    """
    recorded, blocks = read_results(path)
    # What a policy is called differs from machine to machine; its digest does not.
    names = dict(zip(recorded.policies, plan.policies, strict=False))
    digests = {names.get(name, name): digest for name, digest in recorded.digests.items()}
    same = replace(
        recorded,
        policies=tuple(names.get(name, name) for name in recorded.policies),
        digests=digests,
        recipes=plan.recipes,
    )
    if differing := [name for name in asdict(plan) if getattr(plan, name) != getattr(same, name)]:
        raise ConfigurationError(
            f"{path} holds another evaluation, which differs in {', '.join(differing)}: run the same words there"
        )
    moved = {each.key: each for each in (replace(b, key=replace(b.key, policy=names[b.key.policy])) for b in blocks)}
    if missing := [key for key in plan.blocks() if key not in moved]:
        raise ConfigurationError(f"{path} lacks {len(missing)} blocks: the same command goes on with it there")
    return list(moved.values())
