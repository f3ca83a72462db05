"""The comparison with other projects: its figures are kept, and its page is made of them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "benchmarks" / "peers"


@pytest.fixture
def scripts(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(str(FOLDER))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", None)).startswith(str(FOLDER)):
            del sys.modules[name]


def measurement(peer: str = "robosuite", case: str = "lift", num_envs: int = 1, **fields: Any) -> Any:
    from results import Measurement, Side  # pyright: ignore[reportMissingImports]
    from session import Facts  # pyright: ignore[reportMissingImports]

    def side(project: str, way: str, rates: list[float]) -> Any:
        facts = Facts(engine="MuJoCo 1", physics_dt=0.002, decimation=25, action_size=7, degrees_of_freedom=15)
        times = {"start_seconds": [2.0, 1.0], "command_seconds": [2.5, 1.5]}
        return Side(
            project=project, way=way, facts=facts, versions={"python": "3"}, settle_seconds=0.5, memory_mib=100.0,
            rates=rates, raw_rates=[400.0, 400.0, 400.0], **times,
        )  # fmt: skip

    sides = [
        side(peer, "in turn", [50.0, 60.0, 70.0]),
        side(peer, "processes", [100.0, 100.0, 200.0]),
        side("orbit", "plain", [300.0, 200.0, 200.0]),
    ]
    values = {"sides": sides, "hardware": "a processor", "block_seconds": 0.5, **fields}
    return Measurement(peer=peer, case=case, num_envs=num_envs, device="cpu", **values)


def test_raw_stepping_is_measured_and_written_to_the_page(scripts: None, tmp_path: Path) -> None:
    from page import page  # pyright: ignore[reportMissingImports]
    from results import read  # pyright: ignore[reportMissingImports]
    from run import Settings, main  # pyright: ignore[reportMissingImports]

    figures, written = tmp_path / "peers.json", tmp_path / "peers.md"
    amount = {"num_envs": (1,), "rounds": 1, "seconds": 0.2, "starts": 1, "ways": ("plain",)}
    main(Settings(peers=("raw",), json=figures, learning=tmp_path / "none.jsonl", page=written, **amount))
    (kept,) = read(figures)
    (side,) = kept.sides
    assert side.rates[0] > 0.0
    assert side.raw_rates[0] > 0.0
    assert (side.facts.physics_dt, side.facts.decimation, side.facts.degrees_of_freedom) == (0.005, 4, 15)
    text = written.read_text(encoding="utf-8")
    assert "| raw MuJoCo, Lift | 1 |" in text
    assert text == page([kept])


def test_an_unknown_peer_or_case_is_named_with_those_that_there_are(scripts: None, tmp_path: Path) -> None:
    from run import Settings, main  # pyright: ignore[reportMissingImports]

    from orbit_core.interfaces.errors import UnknownNameError

    files = {"json": tmp_path / "a.json", "page": tmp_path / "a.md"}
    with pytest.raises(UnknownNameError, match=r"unknown peer 'genesis': known: dm_control, .*robosuite"):
        main(Settings(peers=("genesis",), **files))
    with pytest.raises(UnknownNameError, match="unknown case 'nope' in raw MuJoCo: known: Lift"):
        main(Settings(peers=("raw",), cases=("nope",), **files))
    assert not list(tmp_path.iterdir())


def test_figures_are_read_as_they_were_written(scripts: None, tmp_path: Path) -> None:
    from results import read, write  # pyright: ignore[reportMissingImports]

    kept = [measurement(), measurement(num_envs=16)]
    write(tmp_path / "peers.json", kept)
    assert read(tmp_path / "peers.json") == kept
    assert read(tmp_path / "none.json") == []


def test_a_new_figure_replaces_the_old_and_an_absent_one_does_not(scripts: None) -> None:
    from results import merged  # pyright: ignore[reportMissingImports]

    old, absent = measurement(), measurement(sides=[], absent="no GPU")
    new = measurement(hardware="another processor")
    assert merged([old], [new]) == [new]
    assert merged([old], [absent]) == [old]
    assert merged([absent], [old]) == [old]
    assert merged([], [absent]) == [absent]


def test_a_ratio_is_that_of_neighbouring_blocks_of_the_fastest_ways(scripts: None) -> None:
    from page import page  # pyright: ignore[reportMissingImports]

    text = page([measurement()])
    assert "| 100 (processes) | 0.25 [0.25, 0.50] | 200 (plain) | 0.50 [0.50, 0.75] | 2.00 [1.00, 3.00] |" in text


def test_figures_that_were_not_run_are_absent_with_the_reason(scripts: None) -> None:
    from page import page  # pyright: ignore[reportMissingImports]

    text = page([measurement("mjlab", "lift", 4096, sides=[], absent="not run: no GPU on the machine")])
    assert "| mjlab, Mjlab-Lift-Cube-Yam | 4,096 | not run: no GPU on the machine |" in text
    assert "| mjlab, Mjlab-Lift-Cube-Yam | 1,024 | no run yet |" in text
    assert "## Steps" not in text


def test_a_side_that_cannot_start_says_why(scripts: None) -> None:
    from session import Request  # pyright: ignore[reportMissingImports]
    from turns import Place, Plan, measure  # pyright: ignore[reportMissingImports]

    from orbit_core.interfaces.errors import ConfigurationError

    place = Place("nobody", Path(sys.executable), Request(adapter="nobody", environment="none"))
    with pytest.raises(ConfigurationError, match="nobody ended: ModuleNotFoundError"):
        measure([place], Plan(starts=1))


def test_the_committed_page_is_made_of_the_committed_figures(scripts: None) -> None:
    """Else: python benchmarks/peers/run.py."""
    from page import page  # pyright: ignore[reportMissingImports]
    from results import read, read_learned  # pyright: ignore[reportMissingImports]

    figures = ROOT / "docs" / "figures"
    text = page(read(figures / "peers.json"), read_learned(figures / "peers_learning.jsonl"))
    assert "| mjlab, Mjlab-Velocity-Flat-Unitree-Go1 | 4,096 | 96,132" in text
    assert (ROOT / "docs" / "measured" / "peers.md").read_text(encoding="utf-8") == text
