"""Page of the peers, made of the kept figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from peers import PEERS, Case, Peer
from results import Measurement, Side, Spread

_INTRODUCTION = """# Measured: peers

ORBIT and other projects on one machine in one run. Both sides' processes stay alive and step in turns, a block each;
a ratio is that of neighbouring blocks, given as the median over the blocks, with quartiles in brackets. Each project
has its own virtual environment. Actions are random; observations, rewards, terminations and resets are made, pictures
are not. Of several ways of stepping, each side shows its fastest. "Of raw" is the rate as a share of the bare engine of
the side's own model, stepped through the same motions with the same decimation: it holds the cost of a project's
layer, while the ratio of the two sides also holds the difference of their models.

`benchmarks/peers/run.py` writes this page from `docs/figures/peers.json`:

```sh
python benchmarks/peers/run.py robosuite --environments out/peers
```
"""


def page(measurements: Sequence[Measurement]) -> str:
    """Return the page, the same for the same figures."""
    order = list(PEERS)
    ordered = sorted(measurements, key=lambda each: (order.index(each.peer), _position(each), each.num_envs))
    present = [each for each in ordered if each.sides]
    parts = [_INTRODUCTION]
    if present:
        parts += [_rates(present), _starts(present), _models(present), _versions(present)]
    parts.append(_absent([each for each in ordered if not each.sides]))
    return "\n".join(part for part in parts if part)


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


def _label(measurement: Measurement) -> str:
    peer, case = case_of(measurement)
    return f"{peer.title}, {case.environment}" if peer.packages else f"{peer.title}, {case.name}"


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


def _rates(measurements: Sequence[Measurement]) -> str:
    rows = []
    for each in measurements:
        theirs, ours = each.fastest(each.peer), each.fastest("orbit")
        assert ours is not None  # each measurement has ORBIT's side
        rows.append(
            (
                _label(each),
                f"{each.num_envs:,}",
                _rate(theirs),
                _ratio(theirs.rates, theirs.raw_rates) if theirs else "-",
                _rate(ours),
                _ratio(ours.rates, ours.raw_rates),
                _ratio(ours.rates, theirs.rates) if theirs else "-",
            )
        )
    headings = (
        "peer", "environments", "peer, environment steps/s", "of raw", "ORBIT, environment steps/s", "of raw",
        "ORBIT / peer",
    )  # fmt: skip
    return "## Steps\n\n" + _table(headings, rows)


def _seconds(side: Side | None, kind: str) -> str:
    if side is None:
        return "-"
    spread = Spread.of(getattr(side, kind))
    return f"{spread.median:.1f} [{spread.low:.1f}, {spread.high:.1f}]"


def _pictures(side: Side | None) -> str:
    return f"{Spread.of(side.pictures).median:,.0f}" if side is not None and side.pictures else "-"


def _starts(measurements: Sequence[Measurement]) -> str:
    text = (
        "## Start, memory, pictures\n\nStart is from the first import to the end of the first step, with warm caches; from the "
        "command adds the interpreter's own start. Memory is that of the process and its children after the first steps, pages "
        "that they share counted once. Pictures are of 84 x 84 pixels, one environment, drawn in software. ORBIT is not compiled "
        "here.\n\n"
    )
    rows = []
    for each in measurements:
        theirs = next((side for side in each.sides if side.project == each.peer), None)
        ours = next(side for side in each.sides if side.project == "orbit")
        rows.append(
            (
                _label(each),
                f"{each.num_envs:,}",
                *(_seconds(side, kind) for kind in ("start_seconds", "command_seconds") for side in (theirs, ours)),
                *(f"{side.memory_mib:,.0f}" if side else "-" for side in (theirs, ours)),
                *(_pictures(side) for side in (theirs, ours)),
            )
        )
    headings = (
        "peer", "environments", "start, s: peer", "ORBIT", "from the command, s: peer", "ORBIT", "memory, MiB: peer", "ORBIT",
        "pictures/s: peer", "ORBIT",
    )  # fmt: skip
    notes = {
        f"* {PEERS[each.peer].title if side.project != 'orbit' else 'ORBIT'} drew no pictures: {side.no_pictures}\n"
        for each in measurements
        for side in each.sides
        if side.no_pictures
    }
    return text + _table(headings, rows) + ("\n" + "".join(sorted(notes)) if notes else "")


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
        _, case = case_of(each)
        ours = each.fastest("orbit")
        theirs = each.fastest(each.peer) or ours
        assert ours is not None
        assert theirs is not None
        fields = case.orbit.fields
        counterpart = ", ".join((case.orbit.task, *(str(fields[key]) for key in ("robot", "action") if key in fields)))
        pairs = (" / ".join(dict.fromkeys(pair)) for pair in zip(_model(theirs), _model(ours), strict=True))
        rows.append((_label(each), case.robot, f"{counterpart} on `{case.orbit.backend}`", *pairs, case.differs))
    headings = (
        "peer", "robot", "ORBIT's task", "control, physics, decimation", "action components", "degrees of freedom", "what differs",
    )  # fmt: skip
    text = "## Models and rates\n\nWhere a cell has two values, the peer's comes first.\n\n"
    return text + _table(headings, rows)


def _versions(measurements: Sequence[Measurement]) -> str:
    rows: dict[tuple[str, ...], None] = {}
    for each in measurements:
        for side in each.sides:
            project = "ORBIT" if side.project == "orbit" else PEERS[side.project].title
            found = ", ".join(f"{name} {version}" for name, version in side.versions.items())
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
    """Return the table of what was not measured, with cases that no run has tried."""
    if not measurements:
        return ""
    rows = [(_label(each), f"{each.num_envs:,}", each.absent.replace("|", "/")) for each in measurements]
    return "## Not measured\n\n" + _table(("peer", "environments", "why"), rows)
