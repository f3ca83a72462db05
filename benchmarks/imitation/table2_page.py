"""Page of the results of table2.py, in Markdown."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from orbit_core.rollout.estimates import proportion

_COLUMNS = {"none": "No change", "goal": "G", "start": "I", "both": "Both"}
# Success and length over 100 trials (Mittal et al. 2023, table II).
_PUBLISHED = {
    "bc": {"none": (1.00, 234), "goal": (0.89, 307), "start": (0.47, 321), "both": (0.43, 324)},
    "bc-rnn": {"none": (1.00, 249), "goal": (1.00, 251), "start": (0.88, 286), "both": (0.87, 293)},
}


@dataclass(frozen=True)
class _Outcome:
    """Evaluation of the trainings of one algorithm in one cell on one engine."""

    cell: str
    action: str
    algorithm: str
    engine: str
    trainings: Sequence[Mapping[str, Any]]

    def text(self, seeds: int) -> str:
        """Return success, interval and length, and the number of trainings if it is not ``seeds``."""
        successes = sum(each["successes"] for each in self.trainings)
        trials = sum(each["trials"] for each in self.trainings)
        rate = proportion(successes, trials)
        length = sum(each["length"] * each["trials"] for each in self.trainings) / trials
        count = len({each["policy"] for each in self.trainings})
        fewer = "" if count == seeds else f", {count} training{'s' * (count > 1)}"
        return f"{rate.value:.2f} [{rate.low:.2f}, {rate.high:.2f}], {length:.0f}{fewer}"


def without(ledger: Mapping[str, Any], algorithms: Sequence[str]) -> dict[str, Any]:
    """Return a ledger without the trainings and evaluations of algorithms."""
    jobs = {name: done for name, done in ledger["jobs"].items() if not set(name.split(".")[3:4]) & set(algorithms)}
    return {**ledger, "jobs": jobs}


def merged(ledgers: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one ledger with the jobs of several; of a job that several have, the one that is done or has more results.

    Evaluations of fewer trainings than the first ledger asks for count as not done: the page shows them until they are.

    Raises:
        SystemExit: their settings differ otherwise.
    """
    settings, jobs = ledgers[0]["settings"], {}
    for ledger in ledgers:
        given = ledger["settings"]
        fewer = given.get("seeds", 0) < settings.get("seeds", 0)
        changed = sorted(name for name in settings if given.get(name) != settings[name])
        if changed and not (fewer and changed == ["seeds"]):
            raise SystemExit(f"results of other {', '.join(changed)} are not merged")
        for name, done in ledger["jobs"].items():
            known = {**done, "ended": done["ended"] and not (fewer and name.startswith("evaluate."))}
            if name not in jobs or _worth(known) > _worth(jobs[name]):
                jobs[name] = known
    return {"settings": settings, "jobs": jobs}


def _worth(done: Mapping[str, Any]) -> tuple[bool, int]:
    return done["ended"], len(done.get("result") or ())


def page(results: Mapping[str, Any]) -> str:
    """Return the page of a ledger as it was read from its file."""
    settings, jobs = results["settings"], results["jobs"]
    parts: dict[tuple[str, ...], list[Any]] = {}
    for name, done in jobs.items():
        kind, *place = name.split(".")
        if kind == "evaluate" and done["result"]:
            parts.setdefault(tuple(place[:4]), []).extend(done["result"])
    found = [_Outcome(*place, trainings) for place, trainings in parts.items()]  # pyright: ignore[reportCallIssue]
    actions = _unique(outcome.action for outcome in found)
    engines = _unique(outcome.engine for outcome in found)
    engines.sort(key=lambda name: name != settings["engine"])
    paragraphs = _HEAD.format(**settings, versions=", ".join(_versions(found))).split("\n\n")
    text = ["\n\n".join(textwrap.fill(each, 120) for each in paragraphs) + "\n"]
    for action in actions:
        for engine in engines:
            where = "the engine of the demonstrations" if engine == settings["engine"] else "transferred"
            own = [outcome for outcome in found if (outcome.action, outcome.engine) == (action, engine)]
            if own:
                text += [f"## `{action}` on {engine}, {where}\n", _table(own, settings["seeds"])]
    text.append("## Cost\n\nCore seconds of one thread on the machine of these figures, mean of a job.\n")
    text.append(_costs(jobs))
    return "\n".join(text)


def _table(outcomes: Sequence[_Outcome], seeds: int) -> str:
    cells = {(outcome.algorithm, outcome.cell): outcome.text(seeds) for outcome in outcomes}
    lines = ["| | " + " | ".join(_COLUMNS.values()) + " |", "|---" * (1 + len(_COLUMNS)) + "|"]
    for algorithm in _unique(outcome.algorithm for outcome in outcomes):
        row = [cells.get((algorithm, cell), "not run") for cell in _COLUMNS]
        lines.append(f"| `{algorithm}` | " + " | ".join(row) + " |")
        if published := _PUBLISHED.get(algorithm):
            row = [f"{published[cell][0]:.2f}, {published[cell][1]}" for cell in _COLUMNS]
            lines.append(f"| `{algorithm}`, published | " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n"


def _costs(jobs: Mapping[str, Any]) -> str:
    costs: dict[tuple[str, ...], list[float]] = {}
    for name, done in jobs.items():
        if done["ended"]:
            kind, _, action, which, *rest = name.split(".")
            key = (
                (kind, action) if kind == "record" else (kind, action, which, *(rest[:1] if kind == "evaluate" else ()))
            )
            costs.setdefault(key, []).append(done["core_seconds"])
    lines = ["| job | number | core seconds each |", "|---|---|---|"]
    for key, values in sorted(costs.items()):
        lines.append(f"| {', '.join(key)} | {len(values)} | {sum(values) / len(values):.0f} |")
    total = sum(done["core_seconds"] for done in jobs.values())
    lines.append(f"| all, interrupted ones included | {len(jobs)} | {total:.0f} in total |")
    return "\n".join(lines) + "\n"


def _versions(found: Sequence[_Outcome]) -> list[str]:
    return sorted({f"{outcome.engine} ({each['engine']})" for outcome in found for each in outcome.trainings})


def _unique(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))


_HEAD = """# Measured: imitation

The paper's table II, repeated by `benchmarks/imitation/table2.py` (Mittal et al., Orbit, 2023): Lift with one start of
the cube or any, and one goal or any. G: goals vary, I: starts vary. {demos} demonstrations of the scripted expert on
{engine}, half of them with noise, {seeds} trainings of each policy where a field names no other number, {episodes}
episodes of each training and engine, all from the same starts. Versions: {versions}.

Each field is success with Wilson's interval of 95 %, and the mean number of steps of 0.02 s until the success that
lasts to the episode's end; failures count with their whole episode. The published figures are success and length over
100 trials, whose task, controller and rate differ from these. The arm's joints start within 0.05 rad everywhere.
Engines and algorithms without a table or a row have not been run.
"""
