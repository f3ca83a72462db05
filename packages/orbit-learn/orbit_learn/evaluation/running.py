"""Blocks of an evaluation: episodes of a policy on an engine, from the same starts for all."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TYPE_CHECKING

import torch

from orbit_core.backends import backend
from orbit_core.cli.making import make_actor, make_environment
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.envs.actors import RemoteSource
from orbit_core.envs.observation_layout import leaves_of
from orbit_core.interfaces import OrbitError
from orbit_learn.evaluation.disturbances import Disturbance
from orbit_learn.evaluation.results import Block, BlockKey, Plan

if TYPE_CHECKING:
    from multiprocessing.queues import SimpleQueue

    from orbit_core.envs.environment import Environment
    from orbit_core.envs.episode import EpisodeEnd


def run_blocks(
    plan: Plan,
    keys: Sequence[BlockKey],
    settings: Mapping[tuple[str, str], EnvironmentSettings],
    jobs: int,
    done: Callable[[Block], None],
) -> None:
    """Run some blocks of a plan, those of one engine, variant and kind of environment in one environment.

    Args:
        plan: that they are of.
        keys: to run, those of one environment one after another.
        settings: of the environment of each policy on each engine, but for the variant.
        jobs: processes side by side; 1 for none but this.
        done: is given each block as it ends.

    Raises:
        OrbitError: of many kinds, or a process was ended from outside.
    """
    groups: dict[tuple[str, str, str], tuple[list[BlockKey], EnvironmentSettings]] = {}
    for key in keys:
        own = settings[key.policy, key.backend]
        groups.setdefault((key.backend, key.variant, repr(own)), ([], own))[0].append(key)
    if jobs == 1:
        for group, own in groups.values():
            for block in run_group(plan, group, own):
                done(block)
        return
    # Engines and torch keep threads, which a fork would leave locked.
    context = get_context("spawn")
    ended: SimpleQueue[Block | None] = context.SimpleQueue()
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_report_to, initargs=(ended,)) as pool:
        running = [pool.submit(_report_group, plan, group, own) for group, own in groups.values()]
        for future in running:
            future.add_done_callback(lambda _: ended.put(None))
        try:
            # Block by block: a group may take an hour, which must not be lost with this process.
            for _ in running:
                while (block := ended.get()) is not None:
                    done(block)
                for future in running:
                    if future.done():
                        future.result()
        except BrokenProcessPool:
            pool.shutdown(wait=False, cancel_futures=True)
            raise OrbitError(
                f"one of {jobs} processes was ended from outside, perhaps for its memory: the same command goes on "
                "with what has not ended, and a smaller --jobs takes less memory"
            ) from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


_ended: SimpleQueue[Block | None] | None = None
"""Queue that a process of the pool puts its blocks into."""


def _report_to(ended: SimpleQueue[Block | None]) -> None:
    """Let this process put its blocks into a queue, and end with the process that started it."""
    global _ended
    _ended = ended
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    # A killed parent closes no pool: its processes would finish their groups for nobody, and wait for ever then.
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _report_group(plan: Plan, keys: Sequence[BlockKey], settings: EnvironmentSettings) -> None:
    assert _ended is not None
    for block in run_group(plan, keys, settings):
        _ended.put(block)


def run_group(plan: Plan, keys: Sequence[BlockKey], settings: EnvironmentSettings) -> Iterable[Block]:
    """Yield the blocks of one engine and variant, whose policies act in one kind of environment."""
    with block_environment(plan, keys[0], settings) as (environment, disturbance):
        for key in keys:
            yield run_block(environment, key, disturbance)


@contextmanager
def block_environment(
    plan: Plan, key: BlockKey, settings: EnvironmentSettings
) -> Iterator[tuple[Environment, Disturbance | None]]:
    """Yield the environment of a block, and the disturbance that its variant is; it is closed after that."""
    own = replace(settings, set=(*settings.set, *plan.variants[key.variant]))
    found = plan.disturbances.get(key.variant)
    disturbance = None if found is None else Disturbance(*found)
    change = None if disturbance is None else disturbance.prepare
    environment = make_environment(own, plan.episodes, reset_diverged=True, change=change)
    try:
        if disturbance is not None:
            disturbance.apply(environment)
        yield environment, disturbance
    finally:
        environment.close()


def run_block(
    environment: Environment,
    key: BlockKey,
    disturbance: Disturbance | None,
    before_step: Callable[[], None] = lambda: None,
) -> Block:
    """Run an episode in every environment.

    Args:
        environment: that the policy acts in.
        key: of the block.
        disturbance: of the environment.
        before_step: is called before each step.
    """
    name = key.policy if disturbance is None else disturbance.reword(key.policy, environment)
    actor = make_actor(name, environment, key.seed)
    seen, _ = environment.reset(key.seed)
    fingerprint = fingerprint_of(leaves_of(seen))
    ends: dict[int, tuple[EpisodeEnd, int]] = {}
    none = (False,) * environment.num_envs
    failed = [False] * environment.num_envs
    # Last step without success: an episode that succeeds has reached its goal in the step after it.
    outside = torch.zeros(environment.num_envs, dtype=torch.int64, device=environment.device)
    reached = [0] * environment.num_envs
    for step in range(1, environment.max_episode_steps + 1):
        before_step()
        *_, info = environment.step(actor.act())
        if "final" in info:
            end = info["final"]
            unanswered = actor.unanswered if isinstance(actor, RemoteSource) else none
            lost = none if environment.lost is None else environment.lost.now.tolist()
            for row, index in enumerate(end.env_ids.tolist()):
                if index not in ends:
                    ends[index] = end, row
                    reached[index] = int(outside[index]) + 1 if bool(end.success[row]) else step
                    failed[index] = bool(unanswered[index] or lost[index])
        if len(ends) == environment.num_envs:
            break
        outside = torch.where(environment.success(), outside, step)
    rows = [ends[index] for index in range(environment.num_envs)]

    def each(value: Callable[[EpisodeEnd], torch.Tensor]) -> tuple[float, ...]:
        return tuple(float(value(end)[row]) for end, row in rows)

    some = rows[0][0]
    rewards = {name: each(lambda end, name=name: end.rewards[name]) for name in some.rewards}
    metrics = {name: each(lambda end, name=name: end.metrics[name]) for name in some.metrics}
    success = [bool(value) and not bad for value, bad in zip(each(lambda end: end.success), failed, strict=True)]
    close = getattr(actor, "close", None)
    if close is not None:
        close()
    return Block(
        key=key,
        engine=", ".join(f"{name} {version}" for name, version in backend(key.backend).versions().items()),
        success=tuple(success),
        returns=tuple(map(sum, zip(*rewards.values(), strict=True))) if rewards else (0.0,) * len(rows),
        steps=tuple(int(value) for value in each(lambda end: end.steps)),
        reached=tuple(reached),
        metrics=metrics,
        rewards=rewards,
        failed=tuple(failed),
        fingerprint=fingerprint,
    )


def fingerprint_of(seen: Iterable[torch.Tensor]) -> str:
    """Return a digest of the first observations (N, ...), equal for equal starts."""
    # Without pictures (N, H, W, C): a moved camera sees another depth of the same start. Engines differ in the last
    # bits; a start is the same where it agrees to a millimetre.
    kept = [value for value in seen if value.is_floating_point() and value.dim() < 4]
    rounded = [(value.double() * 1e3).round().long().cpu().numpy() for value in kept]
    return hashlib.sha256(b"".join(value.tobytes() for value in rounded)).hexdigest()[:16]
