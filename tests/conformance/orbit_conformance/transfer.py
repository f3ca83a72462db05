"""Learned policies on backends that they were not learned on, and on pictures that others draw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from orbit_conformance.episodes import FirstEpisodes, TaskResult
from orbit_conformance.verdict import Status
from orbit_core.rollout.estimates import Estimate
from orbit_learn.policy import PolicyActor, PolicyDescription, load_policy
from orbit_learn.pretrained import PretrainedPolicy, pretrained_policy


@dataclass(frozen=True)
class TransferResult:
    """The outcome of a learned policy on a backend, held against the success rate required of it."""

    status: Status
    """Pass, declared gap or failure."""
    reason: str
    """The reason for anything but a pass."""
    result: TaskResult
    """Success and metrics of the policy's episodes."""


@cache
def learned(policy: str) -> PolicyDescription:
    """The description of the pretrained policy of that name: its task and its backend.

    Raises:
        UnknownNameError: there is none.
        ConfigurationError: its folder holds no policy.
    """
    return load_policy(pretrained_policy(policy).folder).description


def transfer(
    policy: str,
    backend: str,
    *,
    num_envs: int,
    seed: int = 0,
    device: str = "cpu",
    settings: Mapping[str, Any] | None = None,
    renderer: str | None = None,
) -> TransferResult:
    """One episode of a kept policy in each environment of the task that it was learned for.

    Args:
        policy: name of a kept policy.
        backend: name of an installed backend.
        num_envs: episodes.
        seed: of the environments.
        device: where tensors live.
        settings: of the backend, by field name.
        renderer: name of what draws; the backend if None.

    Raises:
        UnsupportedCapabilityError: the backend, or the renderer, lacks what the task needs.
        ConfigurationError: the task is no longer what the policy was learned for.
    """
    kept, description = pretrained_policy(policy), learned(policy)
    fields = {**kept.fields, "robot": description.robot, "action": description.action}
    with FirstEpisodes(description.task, backend, num_envs, seed, fields, device, settings, renderer) as episodes:
        episodes.run(PolicyActor(episodes.environment, kept.folder), tracked_envs=0)
        result = episodes.result()
    return TransferResult(*judge(kept, backend, result.success, renderer), result)


def judge(policy: PretrainedPolicy, backend: str, success: Estimate, renderer: str | None = None) -> tuple[Status, str]:
    """Status and reason. A miss, or that there is none where one is declared, counts only if it is beyond chance: if
    the whole interval is below, or above, the rate that the policy is held to.
    """
    gap, least = policy.gap_on(backend, renderer), policy.least_success
    told = f"success is {success.percent()}"
    # A few dozen episodes leave intervals of 20 %: only a miss of the whole interval is one.
    if success.high < (gap.least_success if gap else least):
        held_to = f"the declared {gap.least_success:g}" if gap else f"{least:g}"
        return Status.FAIL, f"{told}, below {held_to}"
    if gap is None:
        return Status.PASS, ""
    # The declared gap is stale only if chance cannot explain the better result.
    if success.low >= least:
        return Status.STALE, f"{told}, not below {least:g}: take the declared gap back"
    if success.value < least:
        return Status.GAP, f"{told}, below {least:g}: {gap.reason}"
    return Status.PASS, ""
