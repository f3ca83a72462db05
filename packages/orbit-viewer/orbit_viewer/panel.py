"""Panel next to the scene: buttons, the choice of environment, curves of signals, camera pictures.

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

from orbit_viewer.history import SECONDS
from orbit_viewer.plots import add_plot
from orbit_viewer.signals import MOST_COMPONENTS, Numbers, Signal

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
        self._refresh_wanted = False
        self._recording = False
        self._rewound = 0.0
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
            self._rewound = 0.0
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

    @property
    def recording(self) -> bool:
        """True while a video is recorded."""
        return self._recording

    @property
    def rewound(self) -> float:
        """Simulated seconds before the present one that are shown; zero while the simulation runs."""
        return self._rewound if self._paused else 0.0

    def record(self) -> None:
        """Begin a video, or end the one that is recorded."""
        with self._changed:
            self._recording = not self._recording
            self._refresh_wanted = True
            self._changed.notify_all()

    def rewind(self, seconds: float) -> None:
        """Show what was drawn so many simulated seconds ago, while paused."""
        with self._changed:
            self._rewound = max(0.0, seconds)
            self._refresh_wanted = True
            self._changed.notify_all()

    def refresh(self) -> None:
        """Draw everything again, also while paused."""
        with self._changed:
            self._refresh_wanted = True
            self._changed.notify_all()

    def take_refresh(self) -> bool:
        """Return whether everything is to be drawn again, and clear the request."""
        with self._lock:
            wanted, self._refresh_wanted = self._refresh_wanted, False
            return wanted

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
REWARD = "reward"
"""Signal that every environment has."""
_HISTORY = 400
_STROKES = (
    "#1c7ed6", "#e8590c", "#2f9e44", "#9c36b5", "#f08c00", "#0c8599", "#e03131", "#5f3dc4", "#66a80f", "#c2255c",
    "#495057", "#1098ad",
)  # fmt: skip


class Panel:
    """Panel of controls and displays. Each action of a person only sets ``controls``.

    Args:
        server: viser's server.
        controls: takes the requests.
        num_envs: number of the world's environments.
        pictures: names of the pictures that cameras offer.
        title: title at the top.
        pictures_first: show all pictures at first, above the rest of the panel.
        signals: signals by name that may be plotted; the first one is at first.
        keys: keyboard short-cuts for the buttons.
        recordable: whether a video may be recorded.
    """

    def __init__(
        self,
        server: ViserServer,
        controls: Controls,
        num_envs: int,
        pictures: Sequence[str],
        title: str,
        pictures_first: bool = False,
        signals: Mapping[str, Signal] | None = None,
        keys: bool = False,
        recordable: bool = False,
    ) -> None:
        self._server = server
        self._controls = controls
        self._signals = {REWARD: Signal((REWARD,), lambda _: np.zeros(1)), **(signals or {})}
        self._points: deque[tuple[float, Numbers]] = deque(maxlen=_HISTORY)
        # No share button: it would ask for a public tunnel, which the viewer refuses.
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        server.gui.set_panel_label(title)
        self._status = server.gui.add_markdown("", order=-2.0)
        self._add_buttons(recordable)
        if keys:
            self._add_keys(num_envs)
        if num_envs > 1:
            self._add_choice(num_envs)
        self._add_switches()
        self._plots = server.gui.add_folder("Plot")
        self._plot: Any = None
        with self._plots:
            self._signal = server.gui.add_dropdown("Signal", tuple(self._signals), initial_value=REWARD)
            self._signal.on_update(lambda _: controls.refresh())
        self._plotted = ""
        self._plotted_environment = 0
        self._renew_plot()
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

    def add_point(self, seconds: float, index: int, reward: float) -> None:
        """Add a point to the curves of the chosen signal; :meth:`show_plot` draws them.

        Args:
            seconds: simulated time.
            index: environment that is read.
            reward: of it, in the last step.
        """
        self._renew_plot()
        if index != self._plotted_environment:
            # Curves of two environments would join as one.
            self._points.clear()
            self._plotted_environment = index
        signal = self._signals[self._plotted]
        values = np.array([reward]) if self._plotted == REWARD else signal.read(index)[:MOST_COMPONENTS]
        self._points.append((seconds, values))

    def clear_plot(self) -> None:
        """Clear the curves, on the page as well."""
        self._points.clear()
        self._plot.data = tuple(np.zeros(1) for _ in self._plot.data)

    def show_plot(self) -> None:
        """Draw the curves as they now are."""
        self._renew_plot()
        if self._points:
            times = np.array([seconds for seconds, _ in self._points])
            values = np.stack([values for _, values in self._points])
            self._plot.data = (times, *(np.ascontiguousarray(column) for column in values.T))

    def _renew_plot(self) -> None:
        """Make another plot where the person has chosen another signal."""
        if self._signal.value == self._plotted:
            return
        self._plotted = self._signal.value
        self._points.clear()
        if self._plot is not None:
            self._plot.remove()
        with self._plots:
            self._plot = self._add_plot(self._signals[self._plotted].components[:MOST_COMPONENTS])

    def show_paused(self) -> None:
        """Show the button, play or pause, that has an effect now."""
        if self._play.visible != self._controls.paused:
            self._play.visible = self._controls.paused
            self._pause.visible = not self._controls.paused
            self._rewind.visible = self._controls.paused
            if not self._controls.paused:
                self._rewind.value = 0.0

    # Making the panel

    def _add_buttons(self, recordable: bool) -> None:
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

        self._rewind = gui.add_slider("Rewind, s", 0.0, SECONDS, 0.1, 0.0, visible=controls.paused)
        self._rewind.on_update(lambda _: controls.rewind(float(self._rewind.value)))
        if recordable:
            record = gui.add_button("Record", icon=Icon.VIDEO, color="gray", hint="A video, until pressed again")
            record.on_click(lambda _: controls.record())

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

    def _add_plot(self, components: Sequence[str]) -> Any:
        lines = {name: _STROKES[number % len(_STROKES)] for number, name in enumerate(components)}
        return add_plot(self._server.gui, lines, 1.8)

    def _add_keys(self, num_envs: int) -> None:
        """Add the keyboard's short-cuts, which the page's command palette lists."""
        gui, controls = self._server.gui, self._controls

        def toggle() -> None:
            if controls.paused:
                controls.play()
            else:
                controls.pause()

        keys: list[tuple[str, Any, Callable[[], None]]] = [
            ("Play or pause", "space", toggle),
            ("Take one step", "S", controls.single_step),
            ("Reset all environments", "R", controls.reset),
            ("Back by a second", "arrowleft", lambda: self._rewind_by(1.0)),
            ("Forward by a second", "arrowright", lambda: self._rewind_by(-1.0)),
        ]
        if num_envs > 1:
            keys += [
                ("Next environment", "N", lambda: controls.select(first=controls.selection.first + 1)),
                ("Previous environment", "P", lambda: controls.select(first=controls.selection.first - 1)),
            ]
        for label, key, act in keys:
            gui.add_command(label, hotkey=key).on_trigger(lambda _, act=act: act())

    def _rewind_by(self, seconds: float) -> None:
        self._controls.pause()
        self._rewind.value = min(max(self._rewind.value + seconds, 0.0), SECONDS)
        self._controls.rewind(self._rewind.value)
