"""Viewer's page as a device: a gizmo for the hand, sliders for joints, keys, and a second page with sticks."""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from orbit_data.teleoperation.device import Device, Event, EventQueue, Reading, Speeds, within_reach
from orbit_data.teleoperation.driver import Driver, Hand
from orbit_viewer.guard import Page
from orbit_viewer.scene_view import SceneView

if TYPE_CHECKING:
    from viser import ViserServer
    from viser._messages import HotkeyKey

PATH = "/pad"
# Seconds that sticks count as held after their last message; a held pad sends 20 messages a second.
_PAD_HELD = 0.25
# Period in s of messages about the session's state.
_TOLD = 0.2
# Limit of a frame's bytes; pads send fewer.
_LONGEST = 1024
_REST = (0.0,) * 6, (0.0,) * 3


class PadFrame(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Frame of a pad: shares in [-1, 1] of the hand's twist and of the base's (forward, left, turn), and an event."""

    hand: tuple[float, float, float, float, float, float]
    """Shares of the greatest linear and angular velocities, along and about x, y and z."""
    base: tuple[float, float, float]
    """Shares of the base's greatest velocities: forward, left, turn."""
    event: Event | None = None
    """Button pressed since the last frame."""


class Pad:
    """Page of the pad, and the last state of its sticks.

    Args:
        heard: called in the web server's thread with the event of each frame, after the sticks' state was updated.
    """

    def __init__(self, heard: Callable[[Event | None], None]) -> None:
        self._heard = heard
        self._lock = threading.Lock()
        self._shares: tuple[tuple[float, ...], tuple[float, ...]] = _REST
        self._time = -math.inf
        self.rows: Mapping[str, str] = {}
        """State of the session, for the person."""
        html = Path(__file__).with_name("pad.html").read_bytes()
        self.page = Page(PATH, html, self._listen)
        """Page for the viewer's web server."""

    @property
    def shares(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Six shares of the hand's twist and three of the base's speeds; zeros while no stick is held."""
        with self._lock:
            return self._shares if time.perf_counter() - self._time < _PAD_HELD else _REST

    async def _listen(self, connection: ServerConnection) -> None:
        telling = asyncio.create_task(self._tell(connection))
        try:
            async for message in connection:
                if fault := self._take(message):
                    await connection.send(msgspec.json.encode({"error": fault}).decode())
        except ConnectionClosed:
            pass
        finally:
            telling.cancel()

    async def _tell(self, connection: ServerConnection) -> None:
        with suppress(ConnectionClosed):
            while True:
                await connection.send(msgspec.json.encode(dict(self.rows)).decode())
                await asyncio.sleep(_TOLD)

    def _take(self, message: str | bytes) -> str:
        """Apply a frame, and return why it is refused; empty if it is not."""
        if len(message) > _LONGEST:
            return f"a frame has {_LONGEST} bytes at most"
        try:
            frame = msgspec.json.decode(message, type=PadFrame)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return f"invalid frame: {error}"
        if not all(abs(share) <= 1.0 for share in (*frame.hand, *frame.base)):
            return "shares must be from -1 to 1"
        with self._lock:
            self._shares, self._time = (frame.hand, frame.base), time.perf_counter()
        self._heard(frame.event)
        return ""


# Seconds that a button counts as held after its last message; a held one sends 30 messages a second.
_HELD = 0.12
# Seconds after a person's last action until gizmo and sliders follow the robot again.
_RESTS = 0.4
# Period in s of updates of sliders: each is a message to the page.
_SHOWN = 0.1
_PAD = f'<iframe src="{PATH}" title="gamepad" style="width:100%;height:22em;border:0;border-radius:6px"></iframe>'
# Range in rad of the slider of a joint without limits: a turn either way.
_TURN = 6.28
_HAND_BUTTONS = (
    ("Forward", 0, 1.0), ("Back", 0, -1.0), ("Left", 1, 1.0), ("Right", 1, -1.0), ("Up", 2, 1.0), ("Down", 2, -1.0),
    ("Turn left", 5, 1.0), ("Turn right", 5, -1.0), ("Tilt down", 4, 1.0), ("Tilt up", 4, -1.0), ("Roll left", 3, -1.0),
    ("Roll right", 3, 1.0),
)  # fmt: skip
_BASE_BUTTONS = (
    ("Drive forward", 0, 1.0), ("Drive back", 0, -1.0), ("Drive left", 1, 1.0), ("Drive right", 1, -1.0),
    ("Swing left", 2, 1.0), ("Swing right", 2, -1.0),
)  # fmt: skip
_EVENTS: dict[Event, tuple[str, HotkeyKey, str]] = {
    Event.RECORD: ("Record", "R", "Begin a new episode, and record it"),
    Event.SAVE: ("Save", "V", "End the recorded episode, and keep it"),
    Event.DISCARD: ("Discard", "X", "Forget the recorded episode"),
    Event.RESET: ("Start over", "Z", "Begin the episode again"),
    Event.SUCCESS: ("Mark success", "M", "Say that the episode succeeded, or take it back"),
    Event.GRIPPER: ("Open or close", "G", "The gripper"),
    Event.NEXT: ("Next hand", "N", "Drive another end effector or robot"),
}


class Browser(Device):
    """Device on the viewer's page; :meth:`attach` adds it there.

    Args:
        speeds: speeds of the hand while buttons are held.
        driver: driver of the robots.
    """

    def __init__(self, speeds: Speeds, driver: Driver) -> None:
        self._speeds, self._driver = speeds, driver
        self._lock = threading.Lock()
        self._pose: tuple[float, ...] | None = None
        self._joints: dict[str, float] | None = None
        self._events = EventQueue()
        self._held: dict[tuple[str, int, float], float] = {}
        self._moved: float | None = None
        self._last = -_RESTS
        self._dragging = False
        self._server: Any = None
        self._gizmo: Any = None
        # Sliders by the names of the driven choice and of the joint.
        self._sliders: dict[str, dict[str, Any]] = {}
        self._folders: dict[str, Any] = {}
        self._shown = -_SHOWN
        self._pad = Pad(self._padded)
        self.pages = (self._pad.page,)
        """Pages in addition to the viewer's: the gamepad, which a phone can show alone."""

    def read(self) -> Reading:
        now = time.perf_counter()
        hand, base = map(list, self._pad.shares)
        with self._lock:
            for (kind, axis, sign), heard in self._held.items():
                if now - heard < _HELD:
                    (hand if kind == "hand" else base)[axis] += sign
            reading = Reading(
                twist=self._speeds.twist(hand),
                pose=self._pose,
                joints=self._joints,
                base=(base[0], base[1], base[2]),
                events=self._events.take(),
                moved_at=self._moved,
            )
            self._pose = self._joints = self._moved = None
        return reading

    def attach(self, server: ViserServer, scene: SceneView) -> Browser:
        """Add everything to the page, and return the tool that the viewer updates."""
        self._server = server
        self._gizmo = server.scene.add_transform_controls(
            "/teleoperation/gizmo", scale=0.15, visible=False, depth_test=False
        )
        self._gizmo.on_update(self._dragged)
        gui = server.gui
        with gui.add_folder("Teleoperation", order=-1.0):
            for event, (label, key, hint) in _EVENTS.items():
                if event is Event.NEXT and len(self._driver.choices) < 2:
                    continue
                button = gui.add_button(label, hint=f"{hint} ({key})", color="gray")
                button.on_click(lambda _, event=event: self._ask(event))
                command = gui.add_command(label, description=hint, hotkey=key)
                command.on_trigger(lambda _, event=event: self._ask(event))
            with gui.add_folder("Gamepad", expand_by_default=False):
                gui.add_html(_PAD)
            if self._driver.hands:
                self._add_held(gui, "Hand", "hand", _HAND_BUTTONS)
            self._add_held(gui, "Base", "base", _BASE_BUTTONS)
            for name, hand in self._driver.hands.items():
                title = "Joints" if len(self._driver.hands) == 1 else f"Joints of {name}"
                self._folders[name] = gui.add_folder(title, expand_by_default=False)
                with self._folders[name]:
                    self._sliders[name] = self._add_sliders(gui, hand)
        return self

    def tell(self, rows: Mapping[str, str]) -> None:
        self._pad.rows = rows

    def update(self) -> None:
        """Move gizmo and sliders with the robot while no person moves them; called in the simulation's thread."""
        now, hand = time.perf_counter(), self._driver.hand
        if self._gizmo is None or self._dragging or now - self._last < _RESTS:
            return
        with self._server.atomic():
            self._gizmo.visible = hand is not None and bool(hand.arm)
            if hand is not None:
                pose = hand.target[0].cpu().numpy()
                self._gizmo.position, self._gizmo.wxyz = pose[:3], pose[3:]
            if now - self._shown >= _SHOWN:
                self._shown = now
                self._show_joints()

    def _show_joints(self) -> None:
        for name, folder in self._folders.items():
            folder.visible = name == self._driver.active
        if (hand := self._driver.hand) is not None:
            positions = hand.robot.joint_positions[0].tolist()
            for name, slider in self._sliders[self._driver.active].items():
                at = positions[hand.robot.joint_names.index(name)]
                slider.value = round(min(max(at, slider.min), slider.max), 2)

    # What the person does, in the web server's threads

    def _dragged(self, event: Any) -> None:
        with self._lock:
            self._dragging = event.phase != "end"
            pose = (*map(float, self._gizmo.position), *map(float, self._gizmo.wxyz))
            if not within_reach(pose) or not any(pose[3:]):  # a page other than ours sent it: no gizmo does
                return
            self._pose, self._joints = pose, None
            self._heard()

    def _slid(self, name: str, event: Any) -> None:
        # Without a client this program moved the slider. No slider sends values out of reach.
        if event.client is None or not within_reach((event.target.value,)):
            return
        with self._lock:
            self._joints = {**(self._joints or {}), name: float(event.target.value)}
            self._heard()

    def _ask(self, event: Event) -> None:
        with self._lock:
            self._events.add(event)
            self._heard()

    def _padded(self, event: Event | None) -> None:
        with self._lock:
            if event:
                self._events.add(event)
            self._pose = self._joints = None  # sticks take over from gizmo and sliders
            self._heard()

    def _hold(self, which: tuple[str, int, float]) -> None:
        with self._lock:
            self._held[which] = time.perf_counter()
            self._heard()

    def _heard(self) -> None:
        self._last = time.perf_counter()
        self._moved = self._moved or self._last

    # Making the page

    def _add_held(self, gui: Any, title: str, kind: str, buttons: tuple[tuple[str, int, float], ...]) -> None:
        with gui.add_folder(title, expand_by_default=kind == "hand"):
            for label, axis, sign in buttons:
                button = gui.add_button(label, color="gray", hint="Hold it")
                button.on_hold(lambda _, which=(kind, axis, sign): self._hold(which), callback_hz=30.0)

    def _add_sliders(self, gui: Any, hand: Hand) -> dict[str, Any]:
        """Add sliders for the joints of the arm, and for the fingers of hands that have finger tips."""
        fingers = hand.fingers if hand.effector.finger_tips or not hand.arm else []
        sliders: dict[str, Any] = {}
        for joint in (*hand.arm, *fingers):
            name = hand.robot.joint_names[joint]
            low, high = (max(-_TURN, min(_TURN, float(each))) for each in hand.robot.position_limits[joint])
            at = min(max(float(hand.robot.joint_positions[0, joint]), low), high)
            slider = gui.add_slider(name, round(low, 2), round(high, 2), 0.01, round(at, 2))
            slider.on_update(lambda event, name=name: self._slid(name, event))
            sliders[name] = slider
        return sliders
