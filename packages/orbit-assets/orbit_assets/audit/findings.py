"""What an audit says of a description."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Severity(Enum):
    """How much a finding matters."""

    FAULT = "fault"
    """The simulation would be wrong."""
    WARNING = "warning"
    """Unlike real machines, or likely to surprise; look at it."""
    NOTE = "note"
    """What was changed or left out, or what the file does not say."""


@dataclass(frozen=True)
class Finding:
    """One thing that an audit found, with its figures and, where there is one, the remedy."""

    severity: Severity
    element: str
    """The link, joint or pair, or ``"model"``."""
    text: str


_SHOWN = 6


def names_in_short(names: Iterable[str]) -> str:
    """Names with commas, the first six and how many follow."""
    listed = list(names)
    more = f" and {len(listed) - _SHOWN} more" if len(listed) > _SHOWN else ""
    return ", ".join(listed[:_SHOWN]) + more
