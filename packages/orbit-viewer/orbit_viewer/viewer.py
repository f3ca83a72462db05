"""Live viewer: a simulation in this thread, a person in a browser."""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.envs.actors import Actor
from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, Deformable, Marker, Object, Robot, SceneLayout, Sensor
from orbit_core.rollout.estimates import proportion
from orbit_core.scene import CameraSpec, Channel
from orbit_core.sensors import CameraSensor
from orbit_viewer.film import Film, FilmCamera
from orbit_viewer.history import History
from orbit_viewer.inspector import Inspector
from orbit_viewer.panel import Controls, Pacer, Panel, Selection
from orbit_viewer.scene_view import FloatArray, Frame, SceneView
from orbit_viewer.signals import TaskSignals, world_signals

if TYPE_CHECKING:
    from viser import ViserServer

    from orbit_viewer.guard import Page

Picture = npt.NDArray[np.uint8]


def picture_of(channel: Channel, image: Tensor) -> Picture:
    """Convert one camera's image (H, W, channels) to a picture (H, W, 3) for people.

    Depth runs from near, bright, to far, dark; normals and positions show x, y, z as red, green, blue; every index of
    a segmentation has its own colour.
    """
    match channel:
        case Channel.RGB | Channel.ALBEDO:
            return image.cpu().numpy()
        case Channel.DEPTH:
            return _depth(image).cpu().numpy()
        case Channel.POSITION:
            return _position(image).cpu().numpy()
        case Channel.NORMALS:
            return ((image + 1.0) * 127.5).to(torch.uint8).cpu().numpy()
        case Channel.INSTANCE | Channel.SEMANTIC:
            return _indices(image[..., 0].cpu().numpy())


def _depth(depth: Tensor) -> Tensor:
    seen = torch.isfinite(depth)
    if not bool(seen.any()):
        return torch.zeros(*depth.shape[:2], 3, dtype=torch.uint8)
    near, far = depth[seen].min(), depth[seen].max()
    # Even the farthest surface stays brighter than the black of pixels that see nothing.
    brightness = 230.0 - 200.0 * (depth - near) / (far - near).clamp_min(1e-6)
    return torch.where(seen, brightness, 0.0).to(torch.uint8).expand(-1, -1, 3)


def _position(position: Tensor) -> Tensor:
    """Colour positions; colours repeat every metre."""
    seen = torch.isfinite(position)
    return torch.where(seen, 255.0 * (torch.where(seen, position, 0.0) % 1.0), 0.0).to(torch.uint8)


def _indices(indices: npt.NDArray[np.integer]) -> Picture:
    # Hues a golden angle apart are all well apart, however many there are.
    hue = (indices * 0.381966) % 1.0  # 1 minus the golden ratio's reciprocal
    channels = [np.abs((hue * 6.0 - shift) % 6.0 - 3.0) - 1.0 for shift in (0.0, 2.0, 4.0)]
    colors = 60.0 + 180.0 * np.clip(np.stack(channels, axis=-1), 0.0, 1.0)
    return np.where(indices[..., None] < 0, 30.0, colors).astype(np.uint8)


FRAME_PERIOD = 1.0 / 30.0
"""Least seconds from one frame of the scene to the next."""
PANEL_PERIOD = 0.2
"""Least seconds from one update of the panel's text, curve and picture to the next."""
# Share of the time that the panel's pictures may take; where drawing is slow they are fewer.
_DRAWING = 0.1


class ViewedWorld(Protocol):
    """Interface of a world that the viewer reads."""

    @property
    def layout(self) -> SceneLayout:
        """Layout of the scene's entities in the world's tensors."""
        ...

    @property
    def link_poses(self) -> Tensor:
        """Poses (N, L, 7): positions in metres and quaternions (w, x, y, z), in each environment's frame."""
        ...

    @property
    def markers(self) -> Mapping[str, Marker]:
        """Markers drawn for people, by name."""
        ...

    @property
    def sensors(self) -> Mapping[str, Sensor]:
        """Sensors of the scene, by name."""
        ...

    @property
    def robots(self) -> Mapping[str, Robot]:
        """Robots, by name."""
        ...

    @property
    def objects(self) -> Mapping[str, Object]:
        """Objects, by name."""
        ...

    @property
    def deformables(self) -> Mapping[str, Deformable]:
        """Cloths, ropes and soft bodies, by name."""
        ...


class ViewedEnvironment(Protocol):
    """Interface of an environment that the viewer steps."""

    num_envs: int
    """Number N of environments."""
    step_dt: float
    """Seconds of a step."""

    @property
    def world(self) -> ViewedWorld:
        """World that the environment simulates."""
        ...

    def reset(self) -> Any:
        """Begin new episodes in all environments."""
        ...

    def step(self, action: Tensor) -> tuple[Any, Tensor, Tensor, Tensor, Mapping[str, Any]]:
        """Take one step with actions (N, A), and return observation, reward, terminated, truncated and info."""
        ...


class ViewerTool(Protocol):
    """Extra part of a page, next to the scene and the panel."""

    def update(self) -> None:
        """Update the page; called in the simulation's thread before each step, and regularly while paused."""
        ...


class Viewer:
    """Viewer of an environment that an actor drives, in real time, at a web address of this computer.

    Args:
        env: environment to show.
        agent: actor that gives the actions.
        host: network address to listen on; the default is not reachable from other computers. Any other one requires
            the token that :attr:`url` carries.
        port: if taken, the next free one is used.
        title: title of the panel.
        information: more rows for the panel's table, given an environment's number;
            :func:`orbit_viewer.cli.view.task_information` makes one.
        paused: wait for the person to press play.
        frames: begin with axes at the robots' bases, end effectors, finger tips, feet and wheels.
        tool: makes an extra part of the page, given its server and scene.
        pages: more pages of the server.
        signals: signals of the task, which the panel plots next to those of robots and contacts.
        follow: entity that the camera follows at first; empty follows nothing.
        record: makes a camera that films environments of the given width and height in pixels, for videos.
        mark: places markers for people, called before the scene is drawn.
        views: functions by name that draw pictures (H, W, 3) of the first environment. The panel shows them at first,
            together with what the scene's cameras see. They are called in the simulation's thread.

    Raises:
        ConfigurationError: the web server's library is not installed.
    """

    def __init__(
        self,
        env: ViewedEnvironment,
        agent: Actor,
        host: str = "127.0.0.1",
        port: int = 8080,
        title: str = "ORBIT",
        information: Callable[[int], Mapping[str, str]] | None = None,
        paused: bool = False,
        frames: bool = False,
        tool: Callable[[ViserServer, SceneView], ViewerTool] | None = None,
        pages: Sequence[Page] = (),
        views: Mapping[str, Callable[[], Picture]] | None = None,
        signals: TaskSignals | None = None,
        follow: str = "",
        record: Callable[[int, int], FilmCamera] | None = None,
        mark: Callable[[], None] | None = None,
    ) -> None:
        self._env = env
        self._agent = agent
        self._information = information
        self._views = _camera_views(env.world)
        extra = {name: lambda _, draw=draw: draw() for name, draw in (views or {}).items()}
        self._views |= extra
        self.controls = Controls(env.num_envs, paused)
        """Pause, speed and chosen environments, as the panel sets them."""
        self.controls.select(frames=frames)
        self._server, token = start_server(host, port, title, pages)
        root, query = f"http://{host}:{self._server.get_port()}", f"?token={token}" if token else ""
        self.url = f"{root}/{query}" if token else root
        """Address of the page, with a token where other computers reach it."""
        self.page_urls = tuple(f"{root}{page.path}{query}" for page in pages)
        """Addresses of the other pages, with the same token."""
        self._scene = SceneView(self._server, env.world.layout)
        self._signals, self._mark_scene = signals, mark
        plotted = (signals.all() if signals else {}) | (world_signals(env.world) if tool is None else {})
        self._panel = Panel(
            self._server, self.controls, env.num_envs, list(self._views), title, bool(extra), plotted,
            keys=tool is None, recordable=record is not None,
        )  # fmt: skip
        # A tool takes clicks and keys for itself.
        self._inspector = (
            Inspector(self._server, env.world, self._scene, self.controls, follow) if tool is None else None
        )
        self._history = History()
        self._film = Film(self._server, title, record) if record is not None else None
        self._tool = tool(self._server, self._scene) if tool else None
        self._pacer = Pacer()
        self._drawn = Selection()
        self._frame_time = self._panel_time = self._picture_time = -math.inf
        self._drawn_picture = 0
        self._mark = (time.perf_counter(), 0.0)
        self.steps = 0
        """Steps since the last reset of all environments."""
        self._reward = 0.0
        self._episodes = self._successes = 0
        self._speed = 0.0
        # Before the first reset, which may take seconds: a page that is opened meanwhile shows the scene.
        self._show_scene(self.controls.selection)

    def run(self, max_steps: int | None = None) -> None:
        """Simulate until the interrupt key, :meth:`Controls.stop`, or ``max_steps``.

        A step is one step of all environments. The environment is reset first.
        """
        left = math.inf if max_steps is None else max_steps
        self._reset()
        # What was shown before the reset stood where the scene's description has it.
        self._scene.aim()
        try:
            while left > 0 and not self.controls.stopped:
                if self._tool:
                    self._tool.update()
                if self.controls.take_reset():
                    self._reset()
                if self.controls.take_step():
                    self._step()
                    left -= 1
                    self._show(soon=self.controls.paused)
                    self._pacer.wait(self._env.step_dt / self.controls.speed)
                else:
                    self._show(soon=self.controls.take_refresh() or self.controls.selection != self._drawn)
                    # Sleep instead of drawing: a request wakes the loop, and tools still update 20 times a second.
                    self.controls.wait(0.05)
        except KeyboardInterrupt:
            self.controls.stop()
        self._show(soon=True)

    def close(self) -> None:
        """Stop the web server; idempotent."""
        self.controls.stop()
        if self._film:
            self._film.discard()
        self._server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # The simulation

    def _reset(self) -> None:
        self._env.reset()
        self.steps = 0
        self._reward = 0.0
        self._mark = (time.perf_counter(), 0.0)
        self._panel.clear_plot()
        self._history.clear()
        self._show(soon=True)

    def _step(self) -> None:
        # Environments begin new episodes by themselves, so that ends only count.
        index = self.controls.selection.first
        if self._inspector:
            self._inspector.before_step(index)
        observation, reward, _, _, info = self._env.step(self._agent.act())
        self.steps += 1
        self._reward = float(reward[index])
        if self._signals:
            self._signals.after_step(observation)
        self._panel.add_point(self.steps * self._env.step_dt, index, self._reward)
        if self._film:
            self._film.after_step(self.controls.recording, index, self._env.step_dt)
        if final := info.get("final"):
            self._episodes += len(final.success)
            self._successes += int(final.success.sum())

    # Showing it

    def _show(self, soon: bool) -> None:
        """Draw what is due; ``soon`` draws it now."""
        now = time.perf_counter()
        # The scene, the panel and pictures each have their own period, because their costs differ.
        if soon or now - self._frame_time >= FRAME_PERIOD:
            self._frame_time = now
            self._show_scene(self.controls.selection)
        if soon or now - self._panel_time >= PANEL_PERIOD:
            self._panel_time = now
            self._show_panel(now)
        self._show_pictures(now, soon)

    def _show_scene(self, selection: Selection) -> None:
        self._scene.show_collisions(selection.collisions)
        self._scene.show_markers(selection.markers)
        self._scene.show_frames(selection.frames)
        frame = self._frame(slice(selection.first, selection.first + selection.count))
        if self.controls.rewound:
            frame = self._history.before(self.controls.rewound) or frame
        else:
            self._history.add(self.steps * self._env.step_dt, frame)
        self._scene.update(frame)
        if self._inspector:
            self._inspector.update(frame)
        self._drawn = selection

    def _frame(self, rows: slice) -> Frame:
        world = self._env.world
        if self._mark_scene:
            self._mark_scene()
        links = _array(world.link_poses[rows])
        markers = [_array(marker.pose[rows]) for marker in world.markers.values()]
        return Frame(
            links,
            np.stack(markers, axis=1) if markers else np.zeros((len(links), 0, 7), dtype=np.float32),
            tuple(_array(deformable.positions[rows]) for deformable in world.deformables.values()),
            rows.start,
        )

    def _show_panel(self, now: float) -> None:
        index = self.controls.selection.first
        seconds = self.steps * self._env.step_dt
        self._panel.show_paused()
        self._panel.show_status(self._status(index, seconds, now))
        self._panel.show_plot()

    def _show_pictures(self, now: float, soon: bool) -> None:
        """Draw the next picture that is due; they take turns, so that no step waits for all of them."""
        names = self._panel.pictures
        if not names or not (soon or now >= self._picture_time):
            return
        self._drawn_picture += 1
        # After a reset or a change all pictures are drawn, so that none shows an old state.
        for name in names if soon else (names[self._drawn_picture % len(names)],):
            self._panel.show_picture(name, self._views[name](self.controls.selection.first))
        taken = time.perf_counter() - now
        # A picture that takes long to draw is drawn less often, so that the simulation keeps its pace.
        self._picture_time = now + max(PANEL_PERIOD / len(names), taken / _DRAWING)

    def _status(self, index: int, seconds: float, now: float) -> dict[str, str]:
        marked, simulated = self._mark
        # The speed is a mean over a second: that of single steps would flicker too fast to read.
        if now - marked >= 1.0:
            self._speed = (seconds - simulated) / (now - marked)
            self._mark = (now, seconds)
        rows = {
            "time": f"{seconds:.2f} s",
            "step": str(self.steps),
            "speed": f"{0.0 if self.controls.paused else self._speed:.2f} x real time",
            "reward": f"{self._reward:.4f}",
        }
        if self._episodes:
            rate = proportion(self._successes, self._episodes).percent()
            rows["episodes"] = f"{self._episodes}, {rate} successful"
        return rows | dict(self._information(index) if self._information else {})


def start_server(host: str, port: int, title: str, pages: Sequence[Page]) -> tuple[ViserServer, str]:
    """Return a server that answers only its own pages and is never shared over the internet, and its token."""
    try:
        from viser import ViserServer

        from orbit_viewer.guard import Guard, guarded
    except ImportError:
        raise ConfigurationError(f"the viewer needs viser: {install_extra('viewer')}") from None
    if not 0 <= port <= 65535:
        raise ConfigurationError(f"port must be from 0 to 65535, not {port}")
    try:  # viser waits for ever for a server that cannot start
        socket.create_server((host, 0), family=socket.getaddrinfo(host, None)[0][0]).close()
    except OSError as error:
        raise ConfigurationError(f"the viewer cannot listen at '{host}': {error}") from None
    guard = Guard(host, pages)
    with guarded(guard):
        server = ViserServer(host, port, label=title, verbose=False)
    # Any page may send this request, and a public tunnel would bypass the guard of loopback addresses.
    server.request_share_url = _share_nothing
    return server, guard.token


def _share_nothing(verbose: bool = True) -> None:
    """Replace viser's request of a public tunnel to this computer, which any shown page may send."""


def _camera_views(world: ViewedWorld) -> dict[str, Callable[[int], Picture]]:
    """Return functions that draw an environment's picture, by camera and channel."""
    return {
        f"{name}: {channel.value}": partial(_seen, sensor, channel)
        for name, sensor in world.sensors.items()
        if isinstance(sensor, CameraSensor) and isinstance(sensor.spec, CameraSpec)
        for channel in sensor.spec.channels
    }


def _seen(camera: CameraSensor, channel: Channel, index: int) -> Picture:
    return picture_of(channel, camera.image(channel)[index])


def _array(tensor: Tensor) -> FloatArray:
    return tensor.detach().cpu().numpy()
