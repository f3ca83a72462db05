"""Panel next to the scene: buttons, the choice of environment, the reward's curve, camera pictures.

Buttons act in the web server's threads, the simulation in its own: :class:`Controls` connects the two, and sets the
pace at which the simulation runs.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from viser import GuiImageHandle, ViserServer


@dataclass(frozen=True)
class Selection:
    """Choice of what is drawn: ``count`` environments from number ``first`` on."""

    first: int = 0
    count: int = 1
    collisions: bool = False
    """Whether collision shapes are drawn instead of visual ones."""
    markers: bool = True
    """True to draw goals and other markers."""
    frames: bool = False
    """Axes at the robots' bases, end effectors, finger tips, feet and wheels."""


class Controls:
    """Requests of the person at the panel, safe to set from any thread."""

    def __init__(self, num_envs: int, paused: bool = False) -> None:
        self._num_envs = num_envs
        self._lock = threading.Lock()
        # Both share one lock, so that waiting and taking see the same requests.
        self._changed = threading.Condition(self._lock)
        self._paused = paused
        self._single_steps = 0
        self._reset_wanted = False
        self._stopped = False
        self._selection = Selection()
        self.speed = 1.0
        """Simulated seconds per second; infinite runs as fast as it can."""

    @property
    def paused(self) -> bool:
        """True while no steps are taken, except single ones, until :meth:`play`."""
        return self._paused

    @property
    def stopped(self) -> bool:
        """True once the viewer must end."""
        return self._stopped

    @property
    def selection(self) -> Selection:
        """Choice of the person of what is drawn."""
        return self._selection

    def play(self) -> None:
        """Run until :meth:`pause`."""
        with self._changed:
            self._paused = False
            self._single_steps = 0
            self._changed.notify_all()

    def pause(self) -> None:
        """Pause before the next step."""
        with self._changed:
            self._paused = True
            self._changed.notify_all()

    def single_step(self) -> None:
        """Pause, and take one more step."""
        with self._changed:
            self._paused = True
            self._single_steps += 1
            self._changed.notify_all()

    def reset(self) -> None:
        """Reset all environments before the next step."""
        with self._changed:
            self._reset_wanted = True
            self._changed.notify_all()

    def stop(self) -> None:
        """End the run."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def select(
        self,
        first: int | None = None,
        count: int | None = None,
        collisions: bool | None = None,
        markers: bool | None = None,
        frames: bool | None = None,
    ) -> None:
        """Change what is drawn.

        Args:
            first: number of the first environment; it is moved so that ``count`` environments fit.
            count: number of environments.
            collisions: draw collision shapes instead of visual ones.
            markers: draw markers.
            frames: draw axes of the robots.

        None leaves a choice as it is.
        """
        with self._changed:
            old = self._selection
            count = min(max(1, old.count if count is None else count), self._num_envs)
            first = min(max(0, old.first if first is None else first), self._num_envs - count)
            self._selection = Selection(
                first,
                count,
                old.collisions if collisions is None else collisions,
                old.markers if markers is None else markers,
                old.frames if frames is None else frames,
            )
            self._changed.notify_all()

    def take_reset(self) -> bool:
        """Return whether a reset is due, and clear the request."""
        with self._lock:
            # However often it was requested, one reset is due.
            wanted, self._reset_wanted = self._reset_wanted, False
            return wanted

    def take_step(self) -> bool:
        """Return whether a step is due; while paused, use up one of the single steps."""
        with self._lock:
            if not self._paused:
                return True
            if self._single_steps == 0:
                return False
            self._single_steps -= 1
            return True

    def wait(self, seconds: float) -> None:
        """Sleep until a request comes, at most ``seconds``."""
        with self._changed:
            self._changed.wait(seconds)


class Pacer:
    """Pacer of a loop to real time; a late loop does not hurry afterwards to catch up."""

    def __init__(
        self, clock: Callable[[], float] = time.perf_counter, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock = clock
        self._sleep = sleep
        self._due = -math.inf

    def wait(self, period: float) -> None:
        """Return ``period`` seconds after the last return, or at once if that has passed."""
        now = self._clock()
        self._due += period
        if self._due <= now:
            self._due = now  # the debt is dropped: after a slow step the picture must not race to catch up
        else:
            self._sleep(self._due - now)


SPEEDS = {"1/10": 0.1, "1/4": 0.25, "1/2": 0.5, "real time": 1.0, "2 times": 2.0, "as fast as it can": math.inf}
MOST_ENVIRONMENTS = 36
"""Limit of environments drawn at once: each costs the browser time."""
NO_PICTURE, ALL_PICTURES = "none", "all"
_HISTORY = 400


class Panel:
    """Panel of controls and displays. Each action of a person only sets ``controls``.

    Args:
        server: viser's server.
        controls: takes the requests.
        num_envs: number of the world's environments.
        pictures: names of the pictures that cameras offer.
        title: title at the top.
        pictures_first: show all pictures at first, above the rest of the panel.
    """

    def __init__(
        self,
        server: ViserServer,
        controls: Controls,
        num_envs: int,
        pictures: Sequence[str],
        title: str,
        pictures_first: bool = False,
    ) -> None:
        self._server = server
        self._controls = controls
        self._reward: deque[tuple[float, float]] = deque(maxlen=_HISTORY)
        # No share button: it would ask for a public tunnel, which the viewer refuses.
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.gui.set_panel_label(title)
        self._status = server.gui.add_markdown("", order=-2.0)
        self._add_buttons()
        if num_envs > 1:
            self._add_choice(num_envs)
        self._add_switches()
        with server.gui.add_folder("Reward"):
            self._plot = self._add_plot()
        self._pictures: dict[str, GuiImageHandle] = {}
        self._picture_choice: Any = None
        if pictures:
            with server.gui.add_folder("Cameras", order=-1.5 if pictures_first else None):
                several = pictures_first and len(pictures) > 1
                self._add_pictures(pictures, ALL_PICTURES if several else pictures[0])

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of the pictures to show."""
        name = self._picture_choice.value if self._picture_choice else NO_PICTURE
        # The choice names one picture, all or none.
        return tuple(self._pictures) if name == ALL_PICTURES else () if name == NO_PICTURE else (name,)

    def show_status(self, rows: Mapping[str, str]) -> None:
        """Show a table of names and values above the buttons."""
        lines = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
        self._status.content = f"| | |\n|:--|--:|\n{lines}"

    def show_picture(self, name: str, picture: npt.NDArray[np.uint8]) -> None:
        """Show a picture (H, W, 3) under the choice of cameras."""
        self._pictures[name].image = picture

    def add_reward(self, seconds: float, reward: float) -> None:
        """Add a point to the curve; :meth:`show_reward` draws it."""
        self._reward.append((seconds, reward))

    def clear_reward(self) -> None:
        """Clear the curve."""
        self._reward.clear()

    def show_reward(self) -> None:
        """Draw the curve as it now is."""
        if self._reward:
            points = np.array(self._reward, dtype=np.float64)
            self._plot.data = (points[:, 0].copy(), points[:, 1].copy())

    def show_paused(self) -> None:
        """Show the button, play or pause, that has an effect now."""
        if self._play.visible != self._controls.paused:
            self._play.visible = self._controls.paused
            self._pause.visible = not self._controls.paused

    # Making the panel

    def _add_buttons(self) -> None:
        from viser import Icon

        gui, controls = self._server.gui, self._controls
        self._play = gui.add_button("Play", icon=Icon.PLAYER_PLAY, color="green", visible=controls.paused)
        self._pause = gui.add_button("Pause", icon=Icon.PLAYER_PAUSE, visible=not controls.paused)
        step = gui.add_button("Step", icon=Icon.PLAYER_SKIP_FORWARD, color="gray", hint="Pause, and take one step")
        reset = gui.add_button("Reset", icon=Icon.REFRESH, color="gray", hint="Reset all environments")
        speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="real time")
        self._play.on_click(lambda _: controls.play())
        self._pause.on_click(lambda _: controls.pause())
        step.on_click(lambda _: controls.single_step())
        reset.on_click(lambda _: controls.reset())

        @speed.on_update
        def _(_: object) -> None:
            controls.speed = SPEEDS[speed.value]

    def _add_choice(self, num_envs: int) -> None:
        gui, controls = self._server.gui, self._controls
        first = gui.add_slider("Environment", 0, num_envs - 1, 1, controls.selection.first)
        count = gui.add_slider("Shown", 1, min(num_envs, MOST_ENVIRONMENTS), 1, controls.selection.count)
        first.on_update(lambda _: controls.select(first=int(first.value)))
        count.on_update(lambda _: controls.select(count=int(count.value)))

    def _add_switches(self) -> None:
        collisions = self._server.gui.add_checkbox("Collision shapes", False)
        markers = self._server.gui.add_checkbox("Markers", True)
        frames = self._server.gui.add_checkbox(
            "Frames", self._controls.selection.frames, hint="Axes at base, end effectors, finger tips, feet and wheels"
        )
        collisions.on_update(lambda _: self._controls.select(collisions=collisions.value))
        markers.on_update(lambda _: self._controls.select(markers=markers.value))
        frames.on_update(lambda _: self._controls.select(frames=frames.value))

    def _add_pictures(self, names: Sequence[str], chosen: str) -> None:
        gui = self._server.gui
        together = [ALL_PICTURES] if len(names) > 1 else []
        self._picture_choice = gui.add_dropdown("View", [*names, *together, NO_PICTURE], initial_value=chosen)
        # A placeholder, which pictures replace once they are drawn.
        nothing = np.zeros((2, 2, 3), dtype=np.uint8)
        self._pictures = {name: gui.add_image(nothing, label=name, visible=False) for name in names}

        def show(_: object = None) -> None:
            shown = self.pictures
            for name, handle in self._pictures.items():
                handle.visible = name in shown

        self._picture_choice.on_update(show)
        show()

    def _add_plot(self) -> Any:
        from viser import uplot

        nothing = np.zeros(1)
        return self._server.gui.add_uplot(
            (nothing, nothing),
            (uplot.Series(label="s"), uplot.Series(label="reward", stroke="#1c7ed6", width=2)),
            scales={"x": uplot.Scale(time=False)},
            aspect=1.8,
        )
