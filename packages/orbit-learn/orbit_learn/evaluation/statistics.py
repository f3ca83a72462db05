"""Statistics of paired results: success with intervals, differences on the same starts, and sources of variance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orbit_core.rollout.estimates import Estimate, proportion
from orbit_learn.evaluation.results import Block


def success_of(blocks: Iterable[Block]) -> Estimate:
    """Return the success rate over all episodes of some blocks, with Wilson's interval."""
    each = [success for block in blocks for success in block.success]
    return proportion(sum(each), len(each))


@dataclass(frozen=True)
class PairedDifference:
    """Difference of two success rates on the same starts."""

    difference: float
    """Second minus first."""
    low: float
    """Lower end of the 95 % interval of the difference."""
    high: float
    """Upper end of the same interval."""
    only_first: int
    """Starts from which only the first succeeds."""
    only_second: int
    """Starts from which only the second succeeds."""
    p_value: float
    """Of no difference: McNemar's test with mid-p."""


def paired_difference(first: Sequence[Block], second: Sequence[Block]) -> PairedDifference:
    """Compare two sets of blocks start by start.

    The test is McNemar's with mid-p (Fagerland, Lydersen and Laake, The McNemar test for binary matched-pairs data,
    2013); the interval is Newcombe's for paired proportions without its correlation (1998, method 8), which is wide
    rather than narrow.

    Args:
        first: of one policy or engine.
        second: of the other; the same variants, seeds and number of episodes, in any order.

    Raises:
        ValueError: they are not of the same starts.
    """
    one, other = _by_start(first), _by_start(second)
    if one.keys() != other.keys():
        raise ValueError("paired results are of the same starts")
    # Starts with the same result on both sides say nothing of the difference: the test looks at the others alone.
    only_first = sum(one[start] and not other[start] for start in one)
    only_second = sum(other[start] and not one[start] for start in one)
    rate_first, rate_second = proportion(sum(one.values()), len(one)), proportion(sum(other.values()), len(other))
    difference = rate_second.value - rate_first.value
    low = difference - math.hypot(rate_second.value - rate_second.low, rate_first.high - rate_first.value)
    high = difference + math.hypot(rate_second.high - rate_second.value, rate_first.value - rate_first.low)
    return PairedDifference(difference, low, high, only_first, only_second, _mid_p(only_first, only_second))


def _by_start(blocks: Iterable[Block]) -> dict[tuple[str, int, int], bool]:
    return {
        (block.key.variant, block.key.seed, index): success
        for block in blocks
        for index, success in enumerate(block.success)
    }


def _mid_p(only_first: int, only_second: int) -> float:
    """Return the two-sided mid-p value of so many discordant pairs."""
    count, fewer = only_first + only_second, min(only_first, only_second)
    if not count:
        return 1.0
    # Half of the point's own probability, which makes the discrete test neither too strict nor too lax.
    tail = sum(math.comb(count, k) for k in range(fewer)) / 2**count
    return min(1.0, 2.0 * (tail + 0.5 * math.comb(count, fewer) / 2**count))


FACTORS = ("start", "policy", "training", "engine", "version", "variant")


def variance_shares(blocks: Sequence[Block], recipes: Mapping[str, str] | None = None) -> Mapping[str, float]:
    """Split the variance of success into shares of start, policy, training, engine, its version, variant, and the rest.

    Sums of squares of the main effects of a balanced table over that of all (Fisher, Statistical Methods for Research
    Workers, 1925). Trainings are nested in the recipe that they share and versions in their engine: their share is zero
    where there is one each. The rest holds what factors do together. Empty where all episodes end alike.

    Args:
        blocks: of all policies, engines, variants and seeds.
        recipes: of the policies that are trainings of one; any other is its own.
    """
    recipes = recipes or {}
    rows = [
        (
            (
                f"{block.key.seed}/{index}",
                recipes.get(block.key.policy, block.key.policy),
                block.key.policy,
                block.key.backend,
                f"{block.key.backend} {block.engine}",
                block.key.variant,
            ),
            float(success),
        )
        for block in blocks
        for index, success in enumerate(block.success)
    ]
    values = np.array([value for _, value in rows])
    total = ((values - values.mean()) ** 2).sum()
    # All episodes end alike, and shares of nothing are not defined.
    if not total:
        return {}
    shares: dict[str, float] = {}
    for place, name in enumerate(FACTORS):
        groups: dict[str, list[float]] = {}
        for levels, value in rows:
            groups.setdefault(levels[place], []).append(value)
        effect = sum(len(group) * (np.mean(group) - values.mean()) ** 2 for group in groups.values())
        shares[name] = float(effect / total)
    # A training's own effect is what its recipe does not have, and a version's what its engine does not.
    shares["training"] = max(0.0, shares["training"] - shares["policy"])
    shares["version"] = max(0.0, shares["version"] - shares["engine"])
    # Rounding may leave a rest below zero.
    shares["together and chance"] = max(0.0, 1.0 - sum(shares.values()))
    return shares


def failure_kinds(blocks: Sequence[Block]) -> dict[str, list[tuple[Block, int]]]:
    """Group failed episodes by how they fail, the most frequent first.

    An episode is named by the first reward term, in the task's order, that brings less than a tenth of what it brings
    in the median success: what has not happened. Without any success to compare with, and where every term brought
    enough, it is named by whether it ended early.
    """
    typical: dict[str, float] = {}
    successes = [(block, i) for block in blocks for i, success in enumerate(block.success) if success]
    if successes:
        # Medians, because a few successes with unusual rewards must not set the bar.
        for name in successes[0][0].rewards:
            typical[name] = float(np.median([block.rewards[name][i] for block, i in successes]))
    found: dict[str, list[tuple[Block, int]]] = {}
    for block in blocks:
        # The time limit is not in the results; the longest episode of a block reached it, if any did.
        longest = max(block.steps, default=0)
        for index, success in enumerate(block.success):
            if not success:
                found.setdefault(_kind(block, index, typical, longest), []).append((block, index))
    return dict(sorted(found.items(), key=lambda item: -len(item[1])))


def _kind(block: Block, index: int, typical: Mapping[str, float], longest: int) -> str:
    # First, because an episode without answers says nothing of what the policy would have done.
    if block.failed[index]:
        return "the policy did not answer, or the simulation diverged"
    for name, usual in typical.items():
        if usual > 0.0 and block.rewards[name][index] < 0.1 * usual:
            return f"no '{name}'"
    return "ended early" if block.steps[index] < longest else "not done in time"
