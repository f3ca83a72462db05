"""Countdown before a robot moves."""

from __future__ import annotations

import math
import time

from orbit_core.cli.output import console
from orbit_core.interfaces.errors import ConfigurationError


def check_countdown(seconds: float) -> None:
    """Check the length of a countdown.

    Raises:
        ConfigurationError: it is negative or no finite number.
    """
    if not 0.0 <= seconds < math.inf:
        raise ConfigurationError(f"countdown must be zero or more seconds, not {seconds}")


def count_down(seconds: float) -> None:
    """Print the seconds that are left until the robot moves, and wait for them."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0:
        console().print(f"the robot moves in {math.ceil(left)} s (Ctrl-C ends)")
        time.sleep(min(left, 1.0))
