"""Panel of the editor: tabs for what is in the scene, what can be added, physics, the task and files."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from orbit_core.scene import DirectionalLight
from orbit_core.scene.scene import MAX_DIRECTIONAL_LIGHTS
from orbit_scenes.document.build import SceneBuilder
from orbit_scenes.document.model import SceneDocument, TaskPlan
from orbit_scenes.editor.catalogue import Entry
from orbit_scenes.editor.library import Library
from orbit_scenes.editor.pictures import Picture
from orbit_scenes.editor.properties import ORDER, Edit, Properties

if TYPE_CHECKING:
    from viser import ViserServer

GOAL = "the goal region"
"""Choice of the task's goal region."""
NOTHING = "nothing"
"""Choice of nothing."""


class Actions(Protocol):
    """Interface of the effects of the panel's inputs; all methods may be called from any thread and return at once."""

    def do(self, label: str, edit: Edit) -> None:
        """Make an edit."""
        ...

    def select(self, name: str) -> None:
        """Select an item, a sensor or the goal region; empty selects nothing."""
        ...

    def add(self, entry: Entry) -> None:
        """Add an entry of the catalogue."""
        ...

    def add_file(self, name: str) -> None:
        """Add all entities of a USD or MJCF file."""
        ...

    def undo(self) -> None:
        """Take the last edit back."""
        ...

    def redo(self) -> None:
        """Make the edit again that was taken back last."""
        ...

    def duplicate(self) -> None:
        """Copy what is selected."""
        ...

    def delete(self) -> None:
        """Remove what is selected."""
        ...

    def drop(self) -> None:
        """Let what is selected fall until it rests."""
        ...

    def play(self) -> None:
        """Start physics, or stop it and restore what was edited."""
        ...

    def keep(self) -> None:
        """Stop physics and keep where things are as an edit."""
        ...

    def try_task(self, agent: str) -> None:
        """Save, and run the task with a scripted agent until it is stopped."""
        ...

    def make_task(self) -> None:
        """Make a task for what is selected."""
        ...

    def save(self) -> None:
        """Save the document."""
        ...

    def save_usd(self) -> None:
        """Save the scene as USD."""
        ...

    def wake(self) -> None:
        """Have the editor look at the panel."""
        ...


@dataclass(frozen=True)
class Snap:
    """Steps of places and turns."""

    grid: float
    """m; zero: any."""
    angle: float
    """rad; zero: any."""


class Panel:
    """Panel of the editor.

    Args:
        server: viser's server.
        actions: what inputs do.
        builder: of the document.
        backends: names of engines; the first one is chosen.
        renderer: name of what draws pictures.
        title: title of the panel.
        command: words that run the task from a terminal.
    """

    def __init__(
        self,
        server: ViserServer,
        actions: Actions,
        builder: SceneBuilder,
        backends: list[str],
        renderer: str,
        title: str,
        command: str,
    ) -> None:
        self._server, self._actions = server, actions
        self._command = command
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.set_panel_label(title)
        self._status = gui.add_markdown("")
        steps = gui.add_button_group("Edit", ("Undo", "Redo", "Save"))
        pressed = {"Undo": actions.undo, "Redo": actions.redo, "Save": actions.save}
        steps.on_click(lambda _: pressed[steps.value]())
        tabs = gui.add_tab_group()
        self._scene = tabs.add_tab("Scene")
        with self._scene:
            self._add_scene(builder)
        with tabs.add_tab("Add"):
            self.library = Library(server, renderer, actions.add, actions.wake)
            """Entries that can be added."""
        with tabs.add_tab("Play"):
            self._add_play(backends)
        with tabs.add_tab("Task"):
            self._add_task()
        with tabs.add_tab("File"):
            self._add_file()
        self._add_keys()

    @property
    def backend(self) -> str:
        """Engine that the person has chosen."""
        return self._backend.value

    @property
    def snap(self) -> Snap:
        """Steps of places and turns that the person has chosen."""
        if not self._snaps.value:
            return Snap(0.0, 0.0)
        return Snap(float(self._grid.value), math.radians(float(self._angle.value)))

    def show(self, document: SceneDocument, selected: str) -> None:
        """Show a document and what is selected."""
        names = {
            "Robots": [item.name for item in document.items if item.robot],
            "Objects": [item.name for item in document.items if not item.robot],
            "Sensors": [sensor.name for sensor in document.sensors],
        }
        choices = (NOTHING, *(name for group in names.values() for name in group), *((GOAL,) if document.task else ()))
        if tuple(self._selected.options) != choices:
            self._selected.options = choices
        wanted = selected if selected in choices else NOTHING
        if self._selected.value != wanted:
            self._selected.value = wanted
        self._show_tree(names)
        self._properties.show(document, selected, self._scene)
        self._show_lights(document)
        self._show_task(document)

    def show_status(self, file: str, saved: bool, note: str, playing: str) -> None:
        """Show the file's state, the last message and what runs.

        Args:
            file: name of the document's file.
            saved: whether it holds all edits.
            note: last message.
            playing: state of what runs; empty if nothing does.
        """
        from viser import Icon

        state = "saved" if saved else "not saved, kept for recovery"
        content = f"**{file}** {state}  \n{_plain(note)}"
        if self._status.content != content:
            self._status.content = content
        if self._play.label != (label := "Stop, and restore" if playing else "Play"):
            self._play.label = label
            self._play.icon = Icon.PLAYER_STOP if playing else Icon.PLAYER_PLAY
        if self._time.content != playing:
            self._time.content = playing
        self._keep.disabled = not playing

    def show_picture(self, picture: Picture | None) -> None:
        """Show what the selected camera sees, or nothing."""
        self._picture.visible = picture is not None
        if picture is not None:
            self._picture.image = picture

    # Tabs

    def _add_scene(self, builder: SceneBuilder) -> None:
        gui, actions = self._server.gui, self._actions
        self._selected: Any = gui.add_dropdown(
            "Selected", (NOTHING,), initial_value=NOTHING, hint="Or click a thing", order=1.0
        )
        self._selected.on_update(
            lambda event: (
                actions.select("" if self._selected.value == NOTHING else self._selected.value)
                if event.client_id is not None
                else None
            )
        )
        act = gui.add_button_group("Selection", ("Duplicate", "Drop", "Delete"), order=2.0)
        pressed = {"Duplicate": actions.duplicate, "Drop": actions.drop, "Delete": actions.delete}
        act.on_click(lambda _: pressed[act.value]())
        self._picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), label="Live picture", visible=False, order=3.0)
        self._properties = Properties(self._server, builder, actions.do, actions.select)
        with gui.add_folder("Snap", expand_by_default=False, order=ORDER + 1.0):
            self._snaps = gui.add_checkbox("Snap", True)
            self._grid = gui.add_number("Grid, m", 0.05, min=0.0, max=10.0, step=0.01)
            self._angle = gui.add_number("Angle, deg", 15.0, min=0.0, max=180.0, step=5.0)
        self._tree = gui.add_folder("Tree", expand_by_default=False, order=ORDER + 2.0)
        self._branches: dict[str, tuple[Any, dict[str, Any]]] = {}
        self._lights = gui.add_folder("Light", expand_by_default=False, order=ORDER + 3.0)
        self._light_inputs: list[Any] = []
        self._light_key: tuple[Any, ...] | None = None

    def _show_tree(self, names: dict[str, list[str]]) -> None:
        gui = self._server.gui
        for group, members in names.items():
            if group not in self._branches:
                with self._tree:
                    self._branches[group] = (gui.add_folder(group), {})
            folder, buttons = self._branches[group]
            for name in set(buttons) - set(members):
                buttons.pop(name).remove()
            for name in members:
                if name not in buttons:
                    with folder:
                        buttons[name] = gui.add_button(name, color="gray")
                    buttons[name].on_click(lambda _, name=name: self._actions.select(name))
            label = f"{group} ({len(members)})"
            if folder.label != label:
                folder.label = label

    def _show_lights(self, document: SceneDocument) -> None:
        key = (document.ambient, document.suns, document.ground)
        if key == self._light_key:
            return
        # Inputs that a person is using stay: only another number of lights needs other inputs.
        rebuilt = self._light_key is None or len(self._light_key[1]) != len(document.suns)
        self._light_key = key
        if rebuilt:
            for made in reversed(self._light_inputs):
                made.remove()
            self._light_inputs = []
            with self._lights:
                self._add_lights(document)

    def _add_lights(self, document: SceneDocument) -> None:
        gui, do = self._server.gui, self._actions.do

        def made(handle: Any) -> Any:
            self._light_inputs.append(handle)
            return handle

        ambient = made(gui.add_rgb("From all around", _bytes(document.ambient)))
        ambient.on_update(
            lambda event: (
                do("change light", lambda document: replace(document, ambient=_unit(ambient.value)))
                if event.client_id is not None
                else None
            )
        )
        for index, sun in enumerate(document.suns):
            with made(gui.add_folder(f"Sun {index + 1}", expand_by_default=index == 0)):
                self._add_sun(index, sun, made)
        more = made(gui.add_button_group("Suns", ("More", "Fewer")))

        def change(document: SceneDocument) -> SceneDocument:
            suns = document.suns
            if more.value == "Fewer":
                return replace(document, suns=suns[:-1])
            return (
                replace(document, suns=(*suns, DirectionalLight())) if len(suns) < MAX_DIRECTIONAL_LIGHTS else document
            )

        more.on_click(lambda _: do("change light", change))

    def _add_sun(self, index: int, sun: DirectionalLight, made: Callable[[Any], Any]) -> None:
        gui = self._server.gui
        x, y, z = sun.unit_direction
        azimuth = made(gui.add_slider("From, deg", -180, 180, 5, round(math.degrees(math.atan2(-y, -x)) / 5) * 5))
        height = made(gui.add_slider("Height, deg", 5, 90, 5, max(5, round(math.degrees(math.asin(-z)) / 5) * 5)))
        strength = made(gui.add_slider("Strength", 0.0, 1.5, 0.05, sun.intensity))
        color = made(gui.add_rgb("Colour", _bytes(sun.color)))
        shadows = made(gui.add_checkbox("Shadows", sun.shadows))

        def change(event: Any) -> None:
            if event.client_id is None:
                return
            around, up = math.radians(azimuth.value), math.radians(height.value)
            flat = math.cos(up)
            direction = (-flat * math.cos(around), -flat * math.sin(around), -math.sin(up))
            changed = DirectionalLight(direction, _unit(color.value), float(strength.value), bool(shadows.value))

            def edit(document: SceneDocument) -> SceneDocument:
                suns = tuple(changed if number == index else each for number, each in enumerate(document.suns))
                return replace(document, suns=suns)

            self._actions.do("change light", edit)

        for handle in (azimuth, height, strength, color, shadows):
            handle.on_update(change)

    def _add_play(self, backends: list[str]) -> None:
        from viser import Icon

        gui, actions = self._server.gui, self._actions
        self._backend = gui.add_dropdown("Engine", backends, initial_value=backends[0])
        self._play = gui.add_button("Play", icon=Icon.PLAYER_PLAY, color="green")
        self._keep = gui.add_button("Stop, and keep where things are", color="gray", disabled=True)
        self._time = gui.add_markdown("")
        self._play.on_click(lambda _: actions.play())
        self._keep.on_click(lambda _: actions.keep())

    def _add_task(self) -> None:
        gui, actions = self._server.gui, self._actions
        self._task_words = gui.add_markdown("")
        self._make_task = gui.add_button("Make a task of what is selected")
        self._make_task.on_click(lambda _: actions.make_task())
        self._task_folder = gui.add_folder("Task", visible=False)
        with self._task_folder:
            self._task_objects = gui.add_text("Objects", "", hint="Names with commas")
            self._task_goal = gui.add_vector3("Goal, m", (0.0, 0.0, 0.0), step=0.01)
            self._task_size = gui.add_vector3("Size, m", (0.2, 0.2, 0.2), step=0.01, min=(0.01, 0.01, 0.01))
            self._task_action = gui.add_text("Action", "joint_position", hint="'orbit list actions'")
            self._task_length = gui.add_number("Episode, s", 5.0, min=0.1, step=0.5)
            self._task_spread = gui.add_number("Starts vary, m", 0.02, min=0.0, step=0.01)
            apply = gui.add_button("Apply", color="gray")
            remove = gui.add_button("Remove the task", color="gray")
            runs = gui.add_button_group("Try it", ("random", "zero"))
        apply.on_click(lambda _: actions.do("change the task", self._edited_task))
        remove.on_click(lambda _: actions.do("remove the task", lambda document: replace(document, task=None)))
        runs.on_click(lambda _: actions.try_task(runs.value))
        self._task_shown: TaskPlan | None = None

    def _edited_task(self, document: SceneDocument) -> SceneDocument:
        if document.task is None:
            return document
        task = replace(
            document.task,
            objects=tuple(name.strip() for name in self._task_objects.value.split(",") if name.strip()),
            goal=self._task_goal.value,
            size=self._task_size.value,
            action=self._task_action.value.strip(),
            episode_length=float(self._task_length.value),
            spread=float(self._task_spread.value),
        )
        return replace(document, task=task)

    def _show_task(self, document: SceneDocument) -> None:
        task = document.task
        self._task_folder.visible = task is not None
        self._make_task.visible = task is None
        if task is None:
            words = "A task brings objects into a region. Select an object that can move, in a scene with a robot."
        else:
            words = f"**{task.robot}** brings what is named below into the green region.\n\n`{self._command}`"
        if self._task_words.content != words:
            self._task_words.content = words
        if task is not None and task != self._task_shown:
            self._task_objects.value = ", ".join(task.objects)
            self._task_goal.value, self._task_size.value = task.goal, task.size
            self._task_action.value, self._task_length.value = task.action, task.episode_length
            self._task_spread.value = task.spread
        self._task_shown = task

    def _add_file(self) -> None:
        gui, actions = self._server.gui, self._actions
        save = gui.add_button("Save as TOML", hint="Ctrl+S")
        usd = gui.add_button("Save as USD", color="gray")
        save.on_click(lambda _: actions.save())
        usd.on_click(lambda _: actions.save_usd())
        with gui.add_folder("Add a scene"):
            file = gui.add_text("File", "", hint="USD or MJCF, in the folder of this scene")
            load = gui.add_button("Add all of it", color="gray")
        load.on_click(lambda _: actions.add_file(file.value.strip()))
        with gui.add_folder("Keys", expand_by_default=False):
            gui.add_markdown("\n".join(f"- {key}: {label.lower()}" for label, key in _KEY_WORDS))

    def _add_keys(self) -> None:
        actions = self._actions
        keys: list[tuple[str, Any, Any, Callable[[], None]]] = [
            ("Undo", "Z", "cmd/ctrl", actions.undo),
            ("Redo", "Z", "cmd/ctrl+shift", actions.redo),
            ("Redo (Y)", "Y", "cmd/ctrl", actions.redo),
            ("Save", "S", "cmd/ctrl", actions.save),
            ("Duplicate", "D", "cmd/ctrl", actions.duplicate),
            ("Delete", "delete", None, actions.delete),
            ("Drop", "G", None, actions.drop),
            ("Play or stop", "space", None, actions.play),
            ("Select nothing", "escape", None, lambda: actions.select("")),
        ]
        for label, key, modifier, act in keys:
            self._server.gui.add_command(label, hotkey=key, modifier=modifier).on_trigger(lambda _, act=act: act())


_KEY_WORDS = (
    ("Undo", "Ctrl+Z"), ("Redo", "Ctrl+Shift+Z or Ctrl+Y"), ("Save", "Ctrl+S"), ("Duplicate", "Ctrl+D"),
    ("Delete", "Delete"), ("Drop until it rests", "G"), ("Play or stop", "Space"), ("Select nothing", "Escape"),
    ("All commands", "Ctrl+K"),
)  # fmt: skip


def _bytes(color: tuple[float, ...]) -> tuple[int, int, int]:
    r, g, b = (round(255.0 * min(1.0, part)) for part in color)
    return (r, g, b)


def _unit(color: tuple[int, int, int]) -> tuple[float, float, float]:
    r, g, b = (round(part / 255.0, 4) for part in color)
    return (r, g, b)


def _plain(words: str) -> str:
    """Return words that Markdown shows as they are: a file's names may hold its signs."""
    return "".join(f"\\{character}" if character in r"\`*_{}[]<>#+-!|~" else character for character in words)
