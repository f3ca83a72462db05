"""Live table of a robot's commanded and measured joints."""

from __future__ import annotations

import time

from rich.live import Live
from rich.table import Table

from orbit_core.cli.output import console, new_table
from orbit_deploy.link import RobotLink
from orbit_deploy.messages import RobotState

# Seconds between pictures: the table must not take the time of the commands
_INTERVAL = 0.25


class JointTable:
    """Table that is drawn a few times a second in a terminal, and not at all elsewhere.

    Args:
        link: session with the robot, whose latencies it shows.
        shown: False for none.
    """

    def __init__(self, link: RobotLink, shown: bool) -> None:
        self._link = link
        out = console()
        self._live = Live(console=out, auto_refresh=False) if shown and out.is_terminal else None
        self._next = 0.0

    def __enter__(self) -> JointTable:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, state: RobotState) -> None:
        """Draw a state if it is time."""
        now = time.monotonic()
        if self._live is not None and now >= self._next:
            self._next = now + _INTERVAL
            self._live.update(joint_table(self._link, state), refresh=True)


def joint_table(link: RobotLink, state: RobotState) -> Table:
    """Return the table of one state: commanded and measured positions, their difference as a bar, speeds, efforts."""
    title = f"{link.description.model}: {state.mode}, round trip {link.round_trips}, state {link.ages} old"
    table = new_table("joint", "commanded", "measured", "difference", "", "speed", "effort", title=title)
    rows = zip(link.description.joints, state.targets, state.positions, state.velocities, state.efforts, strict=True)
    for name, target, position, velocity, effort in rows:
        off = target - position
        # A full bar is 0.2 rad or m.
        bar = ("+" if off > 0 else "-") * min(10, round(50.0 * abs(off)))
        table.add_row(
            name, f"{target:+.4f}", f"{position:+.4f}", f"{off:+.4f}", bar, f"{velocity:+.3f}", f"{effort:+.2f}"
        )
    return table
