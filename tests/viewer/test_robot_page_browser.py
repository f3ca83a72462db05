"""The page of a robot and its twin in a real browser, wide and narrow."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

pytest.importorskip("viser", reason="the extra orbit-core[viewer] is not installed")
pytest.importorskip("playwright", reason="playwright is not installed")

from orbit_core.backends import default_backend
from orbit_deploy.twin import LiveTwin
from orbit_viewer.robot_page import RobotPage
from tests.deploy.rig import PERIOD, arm, lockstep


@pytest.fixture
def running() -> Iterator[RobotPage]:
    """Page of a simulated robot that swings, and of the twin that follows it."""
    ended = threading.Event()
    with RobotPage(arm(), ("commanded", "measured", "simulated"), port=8490) as page:

        def drive() -> None:
            with lockstep() as link:
                twin, step = LiveTwin(arm(), default_backend(), dt=0.005), 0
                while not ended.wait(PERIOD):
                    link.send([0.3 * float(np.sin(0.1 * step))] * 3, [0.0] * 3, [0.0] * 3)
                    link.wait(link.now() + PERIOD)
                    state, step = link.state(), step + 1
                    twin.follow(state)
                    lines = np.array([state.targets, state.positions, twin.positions.tolist()])
                    page.show(link.now(), np.array(state.positions), lines, twin.positions, "following, twin near")
                twin.close()

        thread = threading.Thread(target=drive)
        thread.start()
        yield page
        ended.set()
        thread.join(20.0)


@pytest.mark.parametrize("width", [1400, 600])
def test_plots_and_their_joint_fit_the_page(running: RobotPage, person: ModuleType, width: int) -> None:
    with person.opened_page(width=width, height=800) as page:
        page.goto(f"{running.url}?fixedDpr={person.COARSE}")
        plots = page.locator(".uplot")
        person.until(lambda: plots.count() == 2, page)
        page.get_by_text("following, twin near").wait_for()
        for plot in plots.all():
            box = plot.bounding_box()
            assert box is not None
            assert box["x"] >= 0.0
            assert box["x"] + box["width"] <= width
        assert page.evaluate("document.documentElement.scrollWidth") <= width


# Pixels from the left edge of a plot to its lines, and that its longest number needs with its tick
ROOM = """plot => {
    const pen = document.createElement("canvas").getContext("2d");
    pen.font = "12px system-ui";
    const left = plot.querySelector(".u-over").getBoundingClientRect().left - plot.getBoundingClientRect().left;
    return [left, pen.measureText("-0.00005").width + 15];
}"""


def test_the_sign_of_small_differences_is_not_cut_off(running: RobotPage, person: ModuleType) -> None:
    with person.opened_page(width=1000, height=800) as page:
        page.goto(f"{running.url}?fixedDpr={person.COARSE}")
        plots = page.locator(".uplot")
        # A plot is there before it is laid out.
        person.until(lambda: plots.count() == 2 and all(plot.evaluate(ROOM)[0] for plot in plots.all()), page)
        for plot in plots.all():
            room, needed = plot.evaluate(ROOM)
            assert room >= needed
