"""Page of the peers, made of the kept figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from peers import PEERS, Case, Peer
from results import Measurement, Side, Spread

_ORBIT_PACKAGES = ("python", "orbit-core", "torch", "numpy")

_INTRODUCTION = """# Measured: peers

ORBIT and other projects on one machine in one run. The processes of both sides stay alive and step in turns, a block
each; a ratio is that of neighbouring blocks, given as the median over the blocks, with quartiles in brackets. Actions
are random and drawn before; observations, rewards, terminations and resets are made, pictures are not.

* **Way.** "One" is a single environment. Several are stepped by Gymnasium's vector environments, in a process each or
  in turn, and by ORBIT as a batch, plain or compiled. Each side shows the fastest way that was measured.
* **"Of raw"** is the rate as a share of the bare engine of the side's model, stepped through the same motions with the
  same decimation, on all cores where there are several environments. It holds the cost of a project's layer. The ratio
  of the two sides also holds the difference of their models.
* **Absolute figures** are of a machine that other work may have shared: compare within a row.

`benchmarks/peers/run.py` measures and writes this page from `docs/figures/peers.json`:

```sh
python benchmarks/peers/run.py robosuite --environments out/peers
```
"""


_LEARNING = """## Learning on a GPU

Collecting and learning in the steady state, environment steps/s with quartiles: the peer's own trainer by
`benchmarks/peers/learn.py`, ORBIT by `benchmarks/learning/speed.py`, one after the other on one {device}
but where another card is told. Of Brax, which reports seldom, brackets hold the least and the most. Other processes
of the machine slow what waits for Python: the peer, RSL-RL and its update. Versions are those of `peers.py`.

"""


def page(measurements: Sequence[Measurement], learned: Sequence[Mapping[str, Any]] = ()) -> str:
    """Return the page, the same for the same figures.

    Args:
        measurements: of steps.
        learned: lines of ``learn.py`` and ``speed.py``.
    """
    order = list(PEERS)
    ordered = sorted(measurements, key=lambda each: (order.index(each.peer), _position(each), each.num_envs))
    present = [each for each in ordered if each.sides]
    parts = [_INTRODUCTION]
    if present:
        parts += [_rates(present), _starts(present), _models(present), _versions(present)]
    if learned:
        parts.append(_learning(learned))
    parts.append(_absent(measurements))
    return "\n".join(part for part in parts if part)


def _learning(learned: Sequence[Mapping[str, Any]]) -> str:
    """Return the rates of each peer's environment beside those of ORBIT's task."""
    ours: dict[tuple[str, int], dict[str, list[Mapping[str, Any]]]] = {}
    theirs: dict[tuple[str, str, int], list[Mapping[str, Any]]] = {}
    for line in learned:
        if "peer" in line:
            theirs.setdefault((line["peer"], line["environment"], line["num_envs"]), []).append(line)
        else:
            ours.setdefault((line["task"], line["num_envs"]), {}).setdefault(line["variant"], []).append(line)

    def rates(lines: Sequence[Mapping[str, Any]]) -> str:
        told = (f"{each['env_steps_per_s']:,} [{', '.join(f'{q:,}' for q in each['quartiles'])}]" for each in lines)
        return "; ".join(told) or "not run"

    def best(lines: Sequence[Mapping[str, Any]]) -> float:
        return max(each["env_steps_per_s"] for each in lines)

    cards = sorted({line["device"] for line in learned if "task" in line})
    rows: list[list[str]] = []
    for (peer, environment, num_envs), lines in theirs.items():
        case = next(case for case in PEERS[peer].cases if case.environment == environment)
        robot = case.orbit.fields.get("robot")
        task = f"{case.orbit.task}:{robot}" if robot else case.orbit.task
        found = ours.get((task, num_envs), {})
        own, with_rsl = found.get("orbit", []), found.get("rsl-rl", [])
        elsewhere = sorted({line["device"] for line in lines} - {*cards, "cuda"})
        # Rates of different cards have no ratio.
        ratio = f"{best(own) / best(lines):.2f}" if own and not elsewhere else "-"
        told = rates(lines) + "".join(f" on one {card}" for card in elsewhere)
        rows.append([f"{PEERS[peer].title}, {environment}", f"{num_envs:,}", told, task, rates(with_rsl),
                     rates(own), ratio])  # fmt: skip
    headings = ("peer", "environments", "peer", "ORBIT's task", "by RSL-RL", "by ORBIT's PPO", "ORBIT's PPO / peer")
    return _LEARNING.format(device=" and ".join(cards)) + _table(headings, rows)


def case_of(measurement: Measurement) -> tuple[Peer, Case]:
    """Return the peer and the case of a measurement."""
    peer = PEERS[measurement.peer]
    return peer, next(case for case in peer.cases if case.name == measurement.case)


def _position(measurement: Measurement) -> int:
    peer, case = case_of(measurement)
    return peer.cases.index(case)


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _label(peer: Peer, case: Case) -> str:
    """Return the name of a case, with its own name where the peer's environment is in several."""
    alike = [each for each in peer.cases if each.environment == case.environment]
    return f"{peer.title}, {case.environment}" + (f" ({case.name})" if len(alike) > 1 else "")


def _counterpart(case: Case) -> str:
    fields = case.orbit.fields
    words = (case.orbit.task, *(str(fields[key]) for key in ("robot", "action") if key in fields))
    return f"{', '.join(words)} on `{case.orbit.backend}`"


def _ratio(above: Sequence[float], below: Sequence[float]) -> str:
    if not above or not below:
        return "-"
    spread = Spread.of_ratio(above, below)
    return f"{spread.median:.2f} [{spread.low:.2f}, {spread.high:.2f}]"


def _rate(side: Side | None) -> str:
    return "-" if side is None else f"{Spread.of(side.rates).median:,.0f} ({side.way})"


def _raw_rates(measurement: Measurement, project: str) -> Side | None:
    """Return a project's fastest side if its raw engine was measured."""
    side = measurement.fastest(project)
    return side if side is not None and side.raw_rates else None


def _fastest(measurement: Measurement) -> tuple[Side | None, Side]:
    """Return the fastest side of the peer, if it ran, and of ORBIT."""
    ours = measurement.fastest("orbit")
    assert ours is not None  # each measurement has ORBIT's side
    return measurement.fastest(measurement.peer), ours


def _rows(
    measurements: Sequence[Measurement], cells: Callable[[Side | None, Side], Iterable[str]]
) -> list[tuple[str, ...]]:
    """Return a row for each measurement: its case, its number of environments, and the cells of its fastest sides."""
    return [(_label(*case_of(each)), f"{each.num_envs:,}", *cells(*_fastest(each))) for each in measurements]


def _rates(measurements: Sequence[Measurement]) -> str:
    def cells(theirs: Side | None, ours: Side) -> tuple[str, ...]:
        return (
            _rate(theirs),
            _ratio(theirs.rates, theirs.raw_rates) if theirs else "-",
            _rate(ours),
            _ratio(ours.rates, ours.raw_rates),
            _ratio(ours.rates, theirs.rates) if theirs else "-",
        )

    headings = (
        "peer", "environments", "peer, environment steps/s", "of raw", "ORBIT, environment steps/s", "of raw",
        "ORBIT / peer",
    )  # fmt: skip
    return "## Steps\n\n" + _table(headings, _rows(measurements, cells))


def _seconds(side: Side | None, kind: str) -> str:
    if side is None or not getattr(side, kind):
        return "-"
    spread = Spread.of(getattr(side, kind))
    return f"{spread.median:.1f} [{spread.low:.1f}, {spread.high:.1f}]"


def _pictures(side: Side | None) -> str:
    return f"{Spread.of(side.pictures).median:,.0f}" if side is not None and side.pictures else "-"


_STARTS = """## Start, memory, pictures

Start is from the first import to the end of the first step, with warm caches; from the command adds the interpreter's
own start. First steps are ORBIT's second to fifth, which trace and, where the row says so, compile. Memory is that of
the process and its children after the first steps, pages that they share counted once. Pictures are of 84 x 84 pixels,
one environment, drawn in software.

"""


def _starts(measurements: Sequence[Measurement]) -> str:
    def cells(theirs: Side | None, ours: Side) -> tuple[str, ...]:
        sides = theirs, ours
        return (
            *(_seconds(side, kind) for kind in ("start_seconds", "command_seconds") for side in sides),
            f"{ours.settle_seconds:.1f}" if ours.start_seconds else "-",
            *(f"{side.memory_mib:,.0f}" if side else "-" for side in sides),
            *(_pictures(side) for side in sides),
        )

    headings = (
        "peer", "environments", "start, s: peer", "ORBIT", "from the command, s: peer", "ORBIT",
        "ORBIT's first steps, s", "memory, MiB: peer", "ORBIT", "pictures/s: peer", "ORBIT",
    )  # fmt: skip
    notes = {
        f"* {PEERS[each.peer].title if side.project != 'orbit' else 'ORBIT'} drew no pictures: {side.no_pictures}\n"
        for each in measurements
        for side in each.sides
        if side.no_pictures
    }
    return _STARTS + _table(headings, _rows(measurements, cells)) + ("\n" + "".join(sorted(notes)) if notes else "")


def _model(side: Side) -> tuple[str, ...]:
    facts = side.facts
    control = 1.0 / (facts.physics_dt * facts.decimation)
    return (
        f"{control:g} Hz, {1.0 / facts.physics_dt:g} Hz, {facts.decimation}",
        str(facts.action_size),
        str(facts.degrees_of_freedom or "-"),
    )


def _models(measurements: Sequence[Measurement]) -> str:
    first = {(each.peer, each.case): each for each in reversed(measurements)}
    rows = []
    for each in reversed(first.values()):
        peer, case = case_of(each)
        theirs, ours = _fastest(each)
        pairs = (" / ".join(dict.fromkeys(pair)) for pair in zip(_model(theirs or ours), _model(ours), strict=True))
        rows.append((_label(peer, case), case.robot, _counterpart(case), *pairs, case.differs))
    headings = (
        "peer", "robot", "ORBIT's task", "control, physics, decimation", "action components", "degrees of freedom",
        "what differs",
    )  # fmt: skip
    text = "## Models and rates\n\nWhere a cell has two values, the peer's comes first.\n\n"
    return text + _table(headings, rows)


def _versions(measurements: Sequence[Measurement]) -> str:
    rows: dict[tuple[str, ...], None] = {}
    for each in measurements:
        for side in each.sides:
            project = "ORBIT" if side.project == "orbit" else PEERS[side.project].title
            # ORBIT's environment may hold engines and projects that the measurement does not use.
            shown = _ORBIT_PACKAGES if side.project == "orbit" else side.versions
            found = ", ".join(f"{name} {side.versions[name]}" for name in shown if name in side.versions)
            rows[project, f"{side.facts.engine}", found] = None
    machines = sorted({each.hardware for each in measurements})
    lengths = sorted({f"{len(each.sides[0].rates)} blocks of {each.block_seconds:g} s" for each in measurements})
    loads = [each.load for each in measurements]
    text = (
        f"## Machine and versions\n\n{'; '.join(machines)}. {'; '.join(lengths)} on each side. Load average before a "
    )
    text += f"measurement: {min(loads):.1f} to {max(loads):.1f}.\n\n"
    return text + _table(("project", "engine", "versions"), rows)


def _absent(measurements: Sequence[Measurement]) -> str:
    """Return the table of what was not measured: what a run could not, and what no run has tried."""
    kept = {each.key: each.absent for each in measurements}
    sizes: dict[tuple[str, str], list[str]] = {}
    for peer in PEERS.values():
        for case in peer.cases:
            label = _label(peer, case)
            for num_envs in peer.num_envs:
                why = kept.get((peer.name, case.name, num_envs), "no run yet")
                if why:
                    sizes.setdefault((label, why.replace("|", "/")), []).append(f"{num_envs:,}")
    rows = [(label, "; ".join(numbers), why) for (label, why), numbers in sizes.items()]
    return "## Not measured\n\n" + _table(("peer", "environments", "why"), rows) if rows else ""
