"""``orbit evaluate``: policies on the same starts, over engines, seeds and disturbances."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.table import Table
from tyro.conf import Positional, UseAppendAction, arg

from orbit_core.backends import backend, default_backend
from orbit_core.cli.making import check_actor, configured_task
from orbit_core.cli.output import console, new_table, progress_bar
from orbit_core.cli.settings import EnvironmentSettings, check_positive, make_folder, parse_settings
from orbit_core.configuration import assignments
from orbit_core.envs.actors import ACTORS
from orbit_core.envs.registry import task_entry
from orbit_core.files import read_bytes, written_whole
from orbit_core.interfaces.errors import ConfigurationError
from orbit_learn.acting import SCHEMES
from orbit_learn.cli.trained import PlaySettings

if TYPE_CHECKING:
    from orbit_learn.evaluation.films import Film
    from orbit_learn.evaluation.results import Block, Plan

_RESULTS, _PAGE = "results.jsonl", "index.html"
# A film of nine is as wide as a page.
_MOST_FILMED = 9
_NAMED = re.compile(r"(?P<recipe>[\w.-]+)=(?P<policy>.+)")


@dataclass(frozen=True, kw_only=True)
class EvaluateSettings(EnvironmentSettings):
    """Evaluate policies from the same starts, on several engines and under disturbances, with intervals."""

    policies: Annotated[Positional[tuple[str, ...]], arg(metavar="POLICY")]
    """Policies' files, trainings' folders, names of kept policies, expert, or addresses of policy servers (ws://);
    NAME=POLICY for several trainings of one recipe, each with another seed."""
    task: Annotated[str | None, arg(metavar="NAME")] = None
    """Task; that of the first policy if left out."""
    backend: Annotated[tuple[str, ...], arg(metavar="NAME")] = ()  # pyright: ignore[reportIncompatibleVariableOverride]
    """Engines ('orbit list backends'); the one that is installed if left out."""
    seeds: int = 1
    """Seeds of starts, from --seed on."""
    episodes: int = 100
    """Episodes of each policy, engine, variant and seed, all stepped together."""
    variant: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME:KEY=VALUE,...")] = ()
    """A disturbance, evaluated beside the task as it is, such as 'slippery:cube.friction=0.3'; repeatable."""
    axis: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME[:LEVEL]")] = ()
    """A disturbance in levels 1 to 3, all if none is named: light, texture, camera, start, appearance (of the robot) or
    language; repeatable."""
    videos: int = 0
    """Failures of each kind to film, by running one block of the kind again; the films are on the page."""
    jobs: Annotated[int | None, arg(metavar="INT")] = None
    """Processes side by side, each with environments of its own; one for each core if left out."""
    output: Annotated[Path, arg(metavar="FOLDER")] = Path("out/evaluation")
    """Takes results.jsonl, which another call of the same words goes on with, and index.html."""


def main(words: Sequence[str]) -> None:
    """Evaluate, with a progress bar, and print success rates and differences."""
    evaluate(parse_settings(EvaluateSettings, words, "orbit evaluate"))


def evaluate(settings: EvaluateSettings) -> None:
    """Run what is not in the file of results yet, and write the page.

    Raises:
        OrbitError: of many kinds; each names the setting.
    """
    from orbit_learn.evaluation.page import page
    from orbit_learn.evaluation.results import ResultFile
    from orbit_learn.evaluation.running import run_blocks

    check_positive("episodes", settings.episodes)
    check_positive("seeds", settings.seeds)
    if settings.jobs is not None:
        check_positive("jobs", settings.jobs)
    if not 0 <= settings.videos <= _MOST_FILMED:
        raise ConfigurationError(f"videos must be from 0 to {_MOST_FILMED}, not {settings.videos}")
    recipes, policies = _recipes(settings.policies)
    settings = replace(settings, policies=policies)
    if len(set(settings.policies)) != len(settings.policies):
        raise ConfigurationError("a policy is named twice: name each once")
    for policy in settings.policies:
        check_actor(policy)
    settings = replace(settings, backend=tuple(settings.backend or (default_backend(),)))
    for name in settings.backend:
        backend(name)
    own = {(policy, name): _settings_of(policy, name, settings) for policy in policies for name in settings.backend}
    plan = _plan(settings, own, recipes)
    make_folder(settings.output / _RESULTS)
    results = ResultFile(settings.output / _RESULTS, plan)
    left = results.left()
    # A job runs all blocks of one engine and variant in one world: more jobs than those would idle.
    jobs = min(settings.jobs or os.cpu_count() or 1, max(1, len({(key.backend, key.variant) for key in left})))
    with progress_bar() as bar:
        line = bar.add_task(f"{plan.task}: blocks", total=len(list(plan.blocks())), completed=len(results.blocks))

        def done(block: Block) -> None:
            results.add(block)
            bar.update(line, advance=1)

        try:
            run_blocks(plan, left, own, jobs, done)
        except KeyboardInterrupt:
            console().print(f"{results.path} keeps what has ended: the same command goes on", soft_wrap=True)
            raise
    blocks = [results.blocks[key] for key in plan.blocks()]
    films = _filmed(plan, blocks, own, settings) if settings.videos else {}
    with written_whole(settings.output / _PAGE) as written:
        written.write_text(page(plan, blocks, films), encoding="utf-8")
    console().print(_table(plan, blocks))
    console().print(f"{settings.output / _PAGE} shows differences and how episodes fail", soft_wrap=True)


def _recipes(words: Sequence[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the recipes of the policies that are given as NAME=POLICY, and all policies."""
    parted = [(match["recipe"], match["policy"]) if (match := _NAMED.fullmatch(each)) else ("", each) for each in words]
    return {policy: recipe for recipe, policy in parted if recipe}, tuple(policy for _, policy in parted)


def _filmed(
    plan: Plan, blocks: Sequence[Block], own: Mapping[tuple[str, str], EnvironmentSettings], settings: EvaluateSettings
) -> dict[str, Film]:
    """Film failures of each kind, with a progress bar."""
    from orbit_learn.evaluation.films import film_failures
    from orbit_learn.evaluation.statistics import failure_kinds

    with progress_bar() as bar:
        line = bar.add_task(f"{plan.task}: films of failures", total=len(failure_kinds(blocks)))
        return film_failures(
            plan, blocks, own, settings.videos, settings.output, lambda kind: bar.update(line, advance=1)
        )


def _settings_of(policy: str, engine: str, settings: EvaluateSettings) -> EnvironmentSettings:
    """Return the settings of a policy's environment on an engine: those that it was learned with, under what the user
    sets."""  # fmt: skip
    common = {field.name: getattr(settings, field.name) for field in fields(EnvironmentSettings)}
    common["backend"] = engine
    # Built-in actors and servers have no file that says how they were learned.
    if policy in ACTORS or policy.startswith(SCHEMES):
        return EnvironmentSettings(**common)
    from orbit_learn.cli.play import restored_settings

    played = restored_settings(PlaySettings(**{**common, "policy": Path(policy)})).settings
    return EnvironmentSettings(**{field.name: getattr(played, field.name) for field in fields(EnvironmentSettings)})


def _plan(settings: EvaluateSettings, own: dict[tuple[str, str], EnvironmentSettings], recipes: dict[str, str]) -> Plan:
    from orbit_core.envs.configuration import configure
    from orbit_learn.evaluation.results import BASE, Plan

    tasks = {each.task for each in own.values()} - {None}
    if len(tasks) != 1:
        told = ", ".join(sorted(str(task) for task in tasks))
        raise ConfigurationError(f"policies are of the tasks {told}: give --task" if tasks else "give --task")
    (task,) = tasks
    for key, each in own.items():
        own[key] = replace(each, task=task)
    variants: dict[str, tuple[str, ...]] = {BASE: ()}
    for told in settings.variant:
        name, colon, changes = told.partition(":")
        if not colon or not name or not changes or name in variants:
            raise ConfigurationError(
                f"variant '{told}' is NAME:KEY=VALUE,..., each name once, such as 'slippery:cube.friction=0.3'"
            )
        variants[name] = tuple(changes.split(","))
        # Before anything runs: a slip in the last variant must not show after hours.
        configure(task_entry(str(task)).task_type(), assignments(variants[name], f"variant '{name}'"))
    disturbances = _disturbances(settings, own, variants)
    told = {
        field.name: repr(getattr(settings, field.name))
        for field in fields(EnvironmentSettings)
        if field.name not in ("task", "backend", "seed", "config")
    }
    seeds = tuple(range(settings.seed, settings.seed + settings.seeds))
    return Plan(str(task), settings.policies, tuple(settings.backend), variants, seeds, settings.episodes, told,
                disturbances, _digests(settings.policies), recipes)  # fmt: skip


def _digests(policies: Sequence[str]) -> dict[str, str]:
    """Return the digest of each policy's file, by which one that was trained again is found."""
    from orbit_learn.policy_file import newest_file
    from orbit_learn.pretrained import policy_path

    found: dict[str, str] = {}
    for policy in policies:
        # Built-in actors and servers have no file.
        if policy in ACTORS or policy.startswith(SCHEMES):
            continue
        path = policy_path(policy)
        file = newest_file(path, "policy") if path.is_dir() else path
        if file is not None:
            found[policy] = hashlib.sha256(read_bytes(file)).hexdigest()[:16]
    return found


def _disturbances(
    settings: EvaluateSettings,
    own: Mapping[tuple[str, str], EnvironmentSettings],
    variants: dict[str, tuple[str, ...]],
) -> dict[str, tuple[str, int]]:
    """Return axis and level of each disturbance by its name, and add each to the variants.

    Raises:
        ConfigurationError: an axis is given twice, or does not apply to a policy.
    """
    from orbit_learn.evaluation.disturbances import LANGUAGE, Disturbance

    found: dict[str, tuple[str, int]] = {}
    for each in (level for words in settings.axis for level in Disturbance.parse(words)):
        if str(each) in variants:
            raise ConfigurationError(f"'{each}' is named twice among --axis and --variant: name each once")
        found[str(each)], variants[str(each)] = (each.axis, each.level), ()
        for (policy, _), made in own.items():
            if each.axis == LANGUAGE and not policy.startswith(SCHEMES):
                raise ConfigurationError(
                    f"axis '{LANGUAGE}' rewords the prompt of policy servers (ws://), and '{policy}' reads none: leave "
                    "it out"
                )
            # Before anything runs: what does not apply to the last policy must not show after hours.
            each.prepare(configured_task(made))
    return found


def _table(plan: Plan, blocks: Sequence[Block]) -> Table:
    from orbit_learn.evaluation.statistics import success_of

    table = new_table("policy", "variant", *plan.backends, title=f"{plan.task}: success [95 %]")
    for policy in plan.policies:
        for variant in plan.variants:
            row = [block for block in blocks if block.key.policy == policy and block.key.variant == variant]
            cells = [success_of(b for b in row if b.key.backend == name).percent() for name in plan.backends]
            table.add_row(policy, variant, *cells)
    return table
