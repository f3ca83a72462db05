"""Page of one robot: its measured posture, a simulated one as a ghost, and plots of its joints over time."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import SceneLayout
from orbit_core.scene import RobotSpec, Scene
from orbit_viewer.plots import add_plot
from orbit_viewer.scene_view import Frame, Ghost, SceneView
from orbit_viewer.viewer import FRAME_PERIOD, PANEL_PERIOD, start_server

FloatArray = npt.NDArray[np.float64]
_COLORS = ("#1c7ed6", "#e8590c", "#2f9e44", "#9c36b5")


class RobotPage:
    """Page in a browser that a program updates while it drives or replays a robot.

    Args:
        spec: robot.
        series: names of what is plotted of each joint, such as ``("commanded", "measured")``.
        seconds: length of the plot.
        host: network address to listen on; any other than the default requires the token that :attr:`url` carries.
        port: if taken, the next free one is used.

    Raises:
        ConfigurationError: the web server's library is not installed.
    """

    def __init__(
        self,
        spec: RobotSpec,
        series: tuple[str, ...],
        seconds: float = 10.0,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        # The robot alone, without what stands around it: a log does not know that.
        layout = SceneLayout.of(Scene(robots=(spec,)))
        self._tree, self._seconds, self._series = KinematicTree(spec.articulation), seconds, series
        self._joints = [joint.name for joint in spec.articulation.movable_joints]
        root = torch.tensor((*spec.pose.position, *spec.pose.orientation))
        self._root = root
        self._server, token = start_server(host, port, spec.articulation.name, ())
        self.url = f"http://{host}:{self._server.get_port()}" + (f"/?token={token}" if token else "")
        """Address of the page."""
        self._scene, self._ghost = SceneView(self._server, layout), Ghost(self._server, spec)
        gui = self._server.gui
        self._text = gui.add_markdown("")
        self._joint = gui.add_dropdown("Joint", self._joints, initial_value=self._joints[0])
        self._plot: Any = add_plot(gui, dict(zip(series, _COLORS, strict=False)), 1.6)
        self._difference: Any = add_plot(gui, {"difference of the last two": "#c92a2a"}, 2.2)
        self._rows: deque[tuple[float, FloatArray]] = deque()
        self._drawn = self._plotted = -math.inf

    def show(
        self, when: float, posture: FloatArray, values: FloatArray, ghost: FloatArray | None = None, text: str = ""
    ) -> None:
        """Take a state, and draw what is due.

        Args:
            when: time of the state, s.
            posture: (J,) positions that the robot is drawn at, rad or m.
            values: (S, J) what is plotted, in the order of the page's series.
            ghost: (J,) positions of the ghost; none if None.
            text: Markdown next to the plots.
        """
        # Every state is kept, and only some are drawn: browsers take some tens of pictures a second.
        self._rows.append((when, np.asarray(values, np.float64)))
        while self._rows[0][0] < when - self._seconds:
            self._rows.popleft()
        now = time.perf_counter()
        if now - self._drawn >= FRAME_PERIOD:
            self._drawn = now
            self._draw(posture, ghost)
        if now - self._plotted >= PANEL_PERIOD:
            self._plotted = now
            self._text.content = text
            self._draw_plots()

    def series(self) -> Mapping[str, FloatArray]:
        """Return what the plots show of the chosen joint: ``time`` and each series, (T,)."""
        # One joint at a time: a plot of all of them shows none.
        column = self._joints.index(self._joint.value)
        values = np.stack([row[:, column] for _, row in self._rows])
        return {"time": np.array([when for when, _ in self._rows]), **dict(zip(self._series, values.T, strict=True))}

    def close(self) -> None:
        """Stop the web server; idempotent."""
        self._server.stop()

    def __enter__(self) -> RobotPage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _draw(self, posture: FloatArray, ghost: FloatArray | None) -> None:
        # Links follow from joints, so that a page needs no simulation.
        poses = self._tree.forward(self._root[None], torch.as_tensor(posture, dtype=torch.float32)[None])
        self._scene.update(Frame(poses.numpy(), np.zeros((1, 0, 7), np.float32)))
        if ghost is None:
            self._ghost.hide()
        else:
            self._ghost.place(self._root, torch.as_tensor(ghost, dtype=torch.float32))

    def _draw_plots(self) -> None:
        shown = list(self.series().values())
        # A browser needs no more points than its plot has pixels.
        step = max(1, len(shown[0]) // 500)
        lines = tuple(np.ascontiguousarray(line[::step]) for line in shown)
        self._plot.data = lines
        if len(lines) > 2:
            self._difference.data = (lines[0], lines[-1] - lines[-2])
