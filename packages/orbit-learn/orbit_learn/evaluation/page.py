"""Page of an evaluation: success, differences on the same starts, sources of variance, and how episodes fail."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import combinations

from orbit_core.rollout.estimates import Estimate
from orbit_learn.evaluation.films import Film
from orbit_learn.evaluation.results import BASE, Block, Plan
from orbit_learn.evaluation.statistics import failure_kinds, paired_difference, success_of, variance_shares

STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;margin:1rem 0;display:block;overflow-x:auto}
th,td{padding:.3rem .8rem;border-bottom:1px solid #ddd;text-align:left;white-space:nowrap}
.bar{display:inline-block;height:.6rem;background:#2a7;vertical-align:middle}
figure{margin:1rem 0}video{max-width:100%}
.interval{color:#666}.sure{font-weight:600}
"""
_SURE = 0.05


def page(
    plan: Plan, blocks: Sequence[Block], films: Mapping[str, Film] | None = None, beside: Sequence[Block] = ()
) -> str:
    """Return the page as HTML, which needs no other file but the films.

    Args:
        plan: that the blocks are of.
        blocks: all results.
        films: of kinds of failures.
        beside: results of the same plan with other versions of engines.
    """
    engines = sorted({f"{block.key.backend} ({block.engine})" for block in blocks})
    parts = [
        f"<h1>{escape(plan.task)}</h1>",
        f"<p>{plan.episodes} episodes of each policy, engine, variant and seed ({len(plan.seeds)} seeds), from the "
        f"same starts for all. Engines: {escape(', '.join(engines))}. Intervals are of 95 % (Wilson).</p>",
        *_different_starts(blocks),
        "<h2>Success</h2>",
        table(("policy", "variant", *plan.backends), _success_rows(plan, blocks)),
        *_differences(plan, blocks),
        "<h2>Where success varies</h2>",
        *_spread_of_trainings(plan, blocks),
        table(("source", "share of the variance"), _variance_rows(plan, (*blocks, *beside))),
        *([table(("engine", "version", "success"), _version_rows((*blocks, *beside)))] if beside else []),
        "<h2>How episodes fail</h2>",
        "<p>Named by the first reward term that brought less than a tenth of what it brings in a success.</p>",
        table(("kind", "episodes", "where (policy, engine, variant, seed: starts)"), _failure_rows(blocks)),
        *_films(films or {}),
    ]
    title = f"Evaluation of {escape(plan.task)}"
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{title}</title><style>{STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )


def _different_starts(blocks: Sequence[Block]) -> Iterable[str]:
    """Yield a warning for each seed whose blocks of one variant show other first observations."""
    for seed, variant in sorted({(block.key.seed, block.key.variant) for block in blocks}):
        found: dict[str, str] = {}
        for block in (each for each in blocks if (each.key.seed, each.key.variant) == (seed, variant)):
            # By the digest of the first observations: engines that start alike are in one group.
            found.setdefault(block.fingerprint, f"{block.key.policy} on {block.key.backend}, {block.key.variant}")
        if len(found) > 1:
            told = escape("; ".join(found.values()))
            yield f'<p class="sure">Seed {seed} begins differently for: {told}. Differences are of these too.</p>'


def _success_rows(plan: Plan, blocks: Sequence[Block]) -> Iterable[Sequence[str]]:
    for policy in plan.policies:
        for variant in plan.variants:
            row = [block for block in blocks if (block.key.policy, block.key.variant) == (policy, variant)]
            cells = (_rate(success_of(b for b in row if b.key.backend == name)) for name in plan.backends)
            yield escape(policy), escape(variant), *cells


def _differences(plan: Plan, blocks: Sequence[Block]) -> list[str]:
    """Return the section of paired differences; empty where there is nothing to compare, such as one policy."""
    rows = list(_difference_rows(plan, blocks))
    if not rows:
        return []
    return [
        "<h2>Differences on the same starts</h2>",
        "<p>Second minus first, in percentage points; p by McNemar's test with mid-p. Many comparisons stand side by "
        "side: one in twenty is below 0.05 by chance.</p>",
        table(("first", "second", "difference", "only first", "only second", "p"), rows),
    ]


def _difference_rows(plan: Plan, blocks: Sequence[Block]) -> Iterable[Sequence[str]]:
    base = [block for block in blocks if block.key.variant == BASE]
    for name in plan.backends:
        for one, other in combinations(plan.policies, 2):
            # Only the base variant: pairs of all variants would fill pages.
            sets = [[b for b in base if b.key.policy == policy and b.key.backend == name] for policy in (one, other)]
            yield _difference(f"{one} on {name}", f"{other} on {name}", *sets)
    for policy in plan.policies:
        for one, other in combinations(plan.backends, 2):
            sets = [[b for b in base if b.key.policy == policy and b.key.backend == name] for name in (one, other)]
            yield _difference(f"{policy} on {one}", f"{policy} on {other}", *sets)


def _difference(first: str, second: str, one: Sequence[Block], other: Sequence[Block]) -> Sequence[str]:
    found = paired_difference(one, other)
    low, high = 100.0 * found.low, 100.0 * found.high
    told = f'{100.0 * found.difference:+.1f} <span class="interval">[{low:+.1f}, {high:+.1f}]</span>'
    # Marked if it is unlikely to be chance, as most pairs differ a little.
    if found.p_value < _SURE:
        told = f'<span class="sure">{told}</span>'
    discordant = str(found.only_first), str(found.only_second)
    return escape(first), escape(second), told, *discordant, f"{found.p_value:.3f}"


def _spread_of_trainings(plan: Plan, blocks: Sequence[Block]) -> Iterable[str]:
    """Yield a sentence for each recipe of several trainings: their mean success, least and most."""
    for recipe in dict.fromkeys(map(plan.recipe, plan.policies)):
        policies = [policy for policy in plan.policies if plan.recipe(policy) == recipe]
        if len(policies) > 1:
            rates = [100.0 * success_of(b for b in blocks if b.key.policy == policy).value for policy in policies]
            yield (
                f"<p>{escape(recipe)}: {len(rates)} trainings, {sum(rates) / len(rates):.1f} % in the mean, from "
                f"{min(rates):.1f} to {max(rates):.1f} %.</p>"
            )


def _variance_rows(plan: Plan, blocks: Sequence[Block]) -> Iterable[Sequence[str]]:
    shares = variance_shares(blocks, plan.recipes)
    if not shares:
        yield "none: all episodes end alike", ""
    for name, share in shares.items():
        yield escape(name), f'<span class="bar" style="width:{10.0 * share:.2f}rem"></span> {100.0 * share:.1f} %'


def _version_rows(blocks: Sequence[Block]) -> Iterable[Sequence[str]]:
    for backend, version in sorted({(block.key.backend, block.engine) for block in blocks}):
        of_it = [block for block in blocks if (block.key.backend, block.engine) == (backend, version)]
        yield escape(backend), escape(version), success_of(of_it).percent()


def _failure_rows(blocks: Sequence[Block]) -> Iterable[Sequence[str]]:
    for kind, found in failure_kinds(blocks).items():
        places: dict[str, list[int]] = {}
        for block, index in found:
            key = block.key
            places.setdefault(f"{key.policy}, {key.backend}, {key.variant}, {key.seed}", []).append(index)
        told = "<br>".join(f"{escape(place)}: {_listed(indices)}" for place, indices in places.items())
        yield escape(kind), str(len(found)), told


def _films(films: Mapping[str, Film]) -> Iterable[str]:
    for kind, film in films.items():
        yield (
            f'<figure><video controls preload="metadata" src="{escape(film.path)}"></video>'
            f"<figcaption>{escape(kind)}: {escape(film.caption)}.</figcaption></figure>"
        )


def _listed(indices: Sequence[int], most: int = 12) -> str:
    shown = ", ".join(map(str, indices[:most]))
    return shown if len(indices) <= most else f"{shown} and {len(indices) - most} more"


def _rate(estimate: Estimate) -> str:
    width = 6.0 * estimate.value
    interval = f"[{100.0 * estimate.low:.0f}, {100.0 * estimate.high:.0f}]"
    return (
        f'<span class="bar" style="width:{width:.2f}rem"></span> {100.0 * estimate.value:.1f} % '
        f'<span class="interval">{interval}</span>'
    )


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of HTML; cells are HTML already."""
    head = "".join(f"<th>{escape(each)}</th>" for each in heads)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
