"""Fields of nested dataclasses are set by path, and held to what they are annotated as."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_core.configuration import assignments, configured
from orbit_core.interfaces import ConfigurationError, UnknownNameError

if TYPE_CHECKING:
    from decimal import Decimal


class Cone(Enum):
    ELLIPTIC = "elliptic"
    PYRAMIDAL = "pyramidal"


@dataclass(frozen=True)
class Term:
    function: Callable[..., float]
    weight: float = 1.0
    interval: tuple[float, float] = (0.0, 0.0)


@dataclass
class Rewards:
    lift: Term | None = Term(max, 15.0)
    reach: Term | None = None


@dataclass
class Owner:
    size: float = 0.5
    count: int = 3
    name: str = "a"
    on: bool = False
    pair: tuple[float, float] = (1.0, 2.0)
    sizes: tuple[int, ...] = (1,)
    cone: Cone = Cone.ELLIPTIC
    limit: float | None = None
    file: Path | None = None
    rewards: Rewards = field(default_factory=Rewards)
    anything: Any = 2
    unresolved: Decimal | int = 1
    table: Mapping[str, Any] = field(default_factory=dict)


PRESETS = {"rewards": {"sparse": lambda: Rewards(lift=None)}}


def typed(pair: str) -> Owner:
    return configured(Owner(), assignments([pair], "task T"), "task T", presets=PRESETS)


@pytest.mark.parametrize(
    ("pair", "name", "value"),
    [
        ("size=1", "size", 1.0),
        ("size=-2.5e-3", "size", -2.5e-3),
        ("count=-4", "count", -4),
        ("name=3", "name", "3"),
        ("name=a=b", "name", "a=b"),
        ("on=true", "on", True),
        ("pair=3,4.5", "pair", (3.0, 4.5)),
        ("pair=[3, 4.5]", "pair", (3.0, 4.5)),
        ("sizes=4,5,6", "sizes", (4, 5, 6)),
        ("sizes=7", "sizes", (7,)),
        ("cone=pyramidal", "cone", Cone.PYRAMIDAL),
        ("limit=2", "limit", 2.0),
        ("limit=none", "limit", None),
        ("file=a/b.txt", "file", Path("a/b.txt")),
        ("anything=5", "anything", 5),
        ("unresolved=7", "unresolved", 7),
    ],
)
def test_a_text_is_read_as_its_field_says(pair: str, name: str, value: object) -> None:
    found = getattr(typed(pair), name)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("pair", "told"),
    [
        ("size=big", "field 'size' of task T is 'big', but must be a number"),
        ("size=nan", "field 'size' of task T is nan: give a finite number"),
        ("size=true", "must be a number"),
        ("size=", "must be a number"),
        ("count=1.5", "must be a whole number"),
        ("count=3000000000", "give at most 2147483647"),
        ("on=yes", "must be true or false"),
        ("pair=a,b", "field 'pair' of task T is 'a,b', but must be a list of 2 (a number, a number)"),
        ("pair=1,2,3", "must be a list of 2"),
        ("cone=round", "must be 'elliptic' or 'pyramidal'"),
        ("size=none", "must be a number"),
        ("rewards=none", "unknown preset 'none' in field 'rewards' of task T"),
        (
            "rewards.lift=3",
            "field 'rewards.lift' of task T cannot be set to '3': set what it holds by its path",
        ),
        ("rewards.lift.function=min", "field 'rewards.lift.function' of task T cannot be set to 'min'"),
        ("rewards.reach.weight=3", "'rewards.reach' of task T is None, with nothing below it: 'rewards.reach.weight'"),
        ("size.big=3", "'size' of task T is 0.5, with nothing below it"),
        ("size", "a field of task T is set as key=value, not 'size'"),
    ],
)
def test_what_does_not_fit_is_refused_by_path(pair: str, told: str) -> None:
    with pytest.raises((ConfigurationError, UnknownNameError)) as raised:
        typed(pair)
    assert told in str(raised.value)


def test_a_wrong_path_offers_the_nearest_at_its_depth() -> None:
    with pytest.raises(UnknownNameError, match="unknown field 'siz' in task T: did you mean 'size'"):
        typed("siz=1")
    with pytest.raises(UnknownNameError, match="unknown field 'lit' in 'rewards' of task T: did you mean 'lift'"):
        typed("rewards.lit.weight=1")
    with pytest.raises(UnknownNameError, match=r"'wieght' in 'rewards.lift' of task T: did you mean 'weight'"):
        typed("rewards.lift.wieght=1")


def test_fields_are_set_at_any_depth_and_the_original_stays() -> None:
    owner = Owner()
    values = {**assignments(["rewards.lift.weight=30", "rewards.lift.interval=1,2"], "T"), "rewards.reach": Term(min)}
    changed = configured(owner, values, "T")
    assert changed.rewards == Rewards(Term(max, 30.0, (1.0, 2.0)), Term(min))
    assert owner == Owner()
    assert typed("rewards.lift=none").rewards.lift is None


def test_tables_set_what_lies_below_their_field() -> None:
    changed = configured(Owner(), {"rewards": {"lift": {"weight": 30}, "reach": None}, "table": {"a": 1}}, "T")
    assert changed.rewards.lift == Term(max, 30.0)
    assert configured(Owner(), {"rewards": {"lift": "none"}, "limit": "none"}, "T").rewards.lift is None
    assert changed.table == {"a": 1}


def test_a_preset_is_chosen_by_name_and_changed_after() -> None:
    assert typed("rewards=sparse").rewards == Rewards(None)
    both = configured(Owner(), {"rewards": "sparse", "rewards.reach": Term(min)}, "T", presets=PRESETS)
    assert both.rewards == Rewards(None, Term(min))
    with pytest.raises(UnknownNameError, match="did you mean 'sparse'"):
        typed("rewards=spars")


@pytest.mark.parametrize(
    ("name", "value"),
    [("size", "1"), ("size", True), ("count", 1.0), ("on", 1), ("pair", 1.0), ("name", 3), ("rewards", 3)],
)
def test_a_python_value_must_be_of_the_fields_kind(name: str, value: object) -> None:
    with pytest.raises((ConfigurationError, UnknownNameError), match=f"'{name}' of task T"):
        configured(Owner(), {name: value}, "task T")


def test_a_whole_number_is_a_real_one_and_a_list_a_tuple() -> None:
    changed = configured(Owner(), {"size": 2, "pair": [1, 2]}, "T")
    assert (changed.size, changed.pair) == (2.0, (1.0, 2.0))


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(-(2**31) + 1, 2**31 - 1), st.booleans())
@settings(max_examples=50, deadline=None)
def test_numbers_survive_the_command_line(size: float, count: int, on: bool) -> None:
    pairs = [f"size={size!r}", f"count={count}", f"on={str(on).lower()}"]
    changed = configured(Owner(), assignments(pairs, "T"), "T")
    assert (changed.size, changed.count, changed.on) == (size, count, on)
