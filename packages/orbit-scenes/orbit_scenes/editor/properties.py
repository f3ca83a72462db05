"""Properties of what is selected, in the panel: inputs that set fields of the document."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from orbit_core.configuration import Text, configured, field_types
from orbit_core.interfaces.layout import home_positions
from orbit_core.objects import object_config
from orbit_core.scene import CameraSpec, Entity, Pose, SensorSpec
from orbit_core.scene.pose import Quaternion, Vector3
from orbit_scenes.document import edits
from orbit_scenes.document.build import NO_TEXTURE, TEXTURES, SceneBuilder
from orbit_scenes.document.model import Item, SceneDocument

if TYPE_CHECKING:
    from viser import ViserServer

Edit = Callable[[SceneDocument], SceneDocument]
Do = Callable[[str, Edit], None]
"""Takes an edit's label and the edit, in any thread."""
OWN = "as it is"
"""Choice that leaves a look as its source has it."""
ORDER = 10.0
"""Place of the folder among what else is in its container."""
SCENE = "the scene"
"""Carrier of a camera that does not move."""
# Fields of sensors that have inputs of their own, or none.
_NO_TEXT = ("name", "pose", "noise", "entity", "directions", "origins")


@dataclass(frozen=True)
class _Shown:
    """An input, with the function that reads its value from the document."""

    handle: Any
    read: Callable[[], Any]


class Properties:
    """Inputs for one selected item or sensor, rebuilt when another is selected.

    Args:
        server: viser's server; inputs are added to the current container.
        builder: of the document.
        do: makes edits.
        selected: renames follow the selection through it.
    """

    def __init__(self, server: ViserServer, builder: SceneBuilder, do: Do, selected: Callable[[str], None]) -> None:
        self._gui, self._builder, self._do, self._select = server.gui, builder, do, selected
        self._inputs: list[_Shown] = []
        self._made: list[Any] = []
        self._key: tuple[str, ...] = ()
        self._document = SceneDocument()

    def show(self, document: SceneDocument, name: str, tab: Any) -> None:
        """Show the values of an item or sensor.

        Args:
            document: that holds it.
            name: of it; empty shows nothing.
            tab: container of the folder of inputs.
        """
        self._document = document
        found = _found(document, name)
        # Inputs are made again only where others are needed: making them takes the focus from what is typed in.
        key = () if found is None else (name, type(found).__name__, _structure(found))
        if key != self._key:
            self._clear()
            self._key = key
            if found is not None:
                # A new folder: the page keeps the height of an old one, and hides what is added to it later.
                with tab, self._keep(self._gui.add_folder(name, order=ORDER)):
                    self._add_name(name)
                    if isinstance(found, Item):
                        self._add_item(found)
                    else:
                        self._add_sensor(found)
            return
        for shown in self._inputs:
            value = shown.read()
            if shown.handle.value != value:
                shown.handle.value = value

    def _clear(self) -> None:
        # Inputs before the folders that hold them.
        for made in reversed(self._made):
            made.remove()
        self._made, self._inputs = [], []

    # Parts of the panel

    def _add_name(self, name: str) -> None:
        text = self._keep(self._gui.add_text("Name", name))
        button = self._keep(self._gui.add_button("Rename", color="gray"))

        def rename(_: object) -> None:
            new = text.value.strip()
            self._do(f"rename {name} to {new}", lambda document: edits.rename(document, name, new))
            self._select(new)

        button.on_click(rename)

    def _add_item(self, item: Item) -> None:
        name, entity = item.name, self._builder.entity(item)
        self._add_pose(lambda: self._item(name).pose, lambda d, pose: edits.place(d, name, pose), name)
        self._input(
            self._gui.add_checkbox("Fixed", entity.fixed_base),
            lambda: self._entity(name).fixed_base,
            name,
            "fixed",
            bool,
        )
        # A body of several links has the mass that its item says in all, in the proportions of its links.
        mass = sum(link.mass for link in entity.articulation.links)
        self._input(
            self._gui.add_number("Mass, kg", round(mass, 6), min=0.0, step=0.01),
            lambda: round(sum(link.mass for link in self._entity(name).articulation.links), 6),
            name, "mass", float,
        )  # fmt: skip
        self._input(
            self._gui.add_slider("Friction", 0.0, 2.0, 0.01, _friction(entity)),
            lambda: _friction(self._entity(name)), name, "friction", float,
        )  # fmt: skip
        with self._folder("Looks"):
            self._add_looks(item)
        if item.object:
            with self._folder(f"Parameters of {item.object}", False):
                self._add_parameters(item)
        # Joints that mimic follow others and have no home or drive of their own.
        movable = [joint for joint in entity.articulation.movable_joints if joint.mimic is None]
        if movable:
            with self._folder("Joints", False):
                self._add_joints(name, entity)

    def _add_pose(
        self, read: Callable[[], Pose], place: Callable[[SceneDocument, Pose], SceneDocument], name: str
    ) -> None:
        position = self._keep(self._gui.add_vector3("Position, m", read().position, step=0.01))
        turn = self._keep(self._gui.add_vector3("Rotation, deg", euler(read().orientation), step=5.0))
        # Read from the document, not the inputs: a drag of the gizmo changes it as well.
        self._inputs += [_Shown(position, lambda: read().position), _Shown(turn, lambda: euler(read().orientation))]

        def move(_: object) -> None:
            pose = Pose(position.value, read().orientation)
            self._do(f"move {name}", lambda document: place(document, pose))

        def rotate(_: object) -> None:
            roll, pitch, yaw = (math.radians(angle) for angle in turn.value)
            pose = Pose.from_euler(roll, pitch, yaw, read().position)
            self._do(f"turn {name}", lambda document: place(document, pose))

        _by_person(position, move)
        _by_person(turn, rotate)

    def _add_looks(self, item: Item) -> None:
        name = item.name
        self._input(
            self._gui.add_rgb("Colour", _color(self._builder.entity(item))),
            lambda: _color(self._entity(name)), name, "color",
            lambda rgb: tuple(round(part / 255.0, 4) for part in rgb),
        )  # fmt: skip
        self._input(
            self._gui.add_dropdown("Texture", (OWN, *TEXTURES, NO_TEXTURE), initial_value=item.texture or OWN),
            lambda: self._item(name).texture or OWN, name, "texture", lambda word: None if word == OWN else word,
        )  # fmt: skip
        for field, default in (("roughness", 1.0), ("metallic", 0.0)):
            value = getattr(item, field)
            self._input(
                self._gui.add_slider(field.capitalize(), 0.0, 1.0, 0.05, default if value is None else value),
                lambda field=field, default=default: default if (v := getattr(self._item(name), field)) is None else v,
                name, field, float,
            )  # fmt: skip

    def _add_parameters(self, item: Item) -> None:
        defaults = object_config(item.object, **item.parameters)
        texts = {
            name: self._keep(self._gui.add_text(name, _words(getattr(defaults, name))))
            for name in field_types(type(defaults))
            if _is_plain(getattr(defaults, name))
        }
        # Only what was changed is written, so that the file holds no defaults, which may change.
        before = {name: text.value for name, text in texts.items()}
        button = self._keep(self._gui.add_button("Apply parameters", color="gray"))

        def apply(_: object) -> None:
            given = {name: Text(text.value) for name, text in texts.items() if text.value != before[name]}

            def edit(document: SceneDocument) -> SceneDocument:
                # Read by the kind's own annotations, so that a wrong value is refused with the field's name.
                made = configured(defaults, given, f"object '{item.object}'", "parameter")
                values = {name: _plain(getattr(made, name)) for name in given}
                return edits.change(document, item.name, parameters={**item.parameters, **values})

            self._do(f"change parameters of {item.name}", edit)

        button.on_click(apply)

    def _add_joints(self, name: str, entity: Entity) -> None:
        body = entity.articulation
        names = [joint.name for joint in body.movable_joints if joint.mimic is None]
        chosen = self._keep(self._gui.add_dropdown("Joint", names, initial_value=names[0]))
        rows: dict[str, Any] = {
            field: self._keep(self._gui.add_number(label, 0.0, step=0.05))
            for field, label in (
                ("home", "Home, rad or m"), ("lower", "Lower limit"), ("upper", "Upper limit"),
                ("stiffness", "Drive stiffness"), ("damping", "Drive damping"), ("effort", "Effort limit"),
            )
        }  # fmt: skip

        def read(field: str) -> float:
            return joint_value(self._entity(name), chosen.value, field)

        def update(_: object = None) -> None:
            for field, handle in rows.items():
                value = read(field)
                # Infinite limits and missing drives have no number to show.
                handle.disabled = not math.isfinite(value) and field in ("stiffness", "damping", "effort")
                handle.value = round(value, 4) if math.isfinite(value) else 0.0

        for field, handle in rows.items():
            self._inputs.append(
                _Shown(handle, lambda field=field: round(v, 4) if math.isfinite(v := read(field)) else 0.0)
            )

            def change(_: object, field: str = field, handle: Any = handle) -> None:
                joint, value = chosen.value, float(handle.value)
                self._do(
                    f"change {field} of {joint} of {name}",
                    lambda document: edits.change_joint(document, name, joint, **{field: value}),
                )

            _by_person(handle, change)
        chosen.on_update(update)
        update()

    def _add_sensor(self, sensor: SensorSpec) -> None:
        name = sensor.name
        if isinstance(sensor, CameraSpec):
            self._add_pose(
                lambda: self._document.sensor(name).pose,  # pyright: ignore[reportAttributeAccessIssue]
                lambda document, pose: edits.replace_sensor(document, name, pose=pose), name,
            )  # fmt: skip
            carriers = [SCENE, *(item.name for item in self._document.items)]
            mount = self._keep(self._gui.add_dropdown("On", carriers, initial_value=sensor.entity or SCENE))

            def carry(_: object) -> None:
                entity = None if mount.value == SCENE else mount.value
                self._do(f"mount {name} on {mount.value}", lambda d: mounted(d, self._builder, name, entity))

            _by_person(mount, carry)
        texts = {
            field: self._keep(self._gui.add_text(field, _words(getattr(sensor, field))))
            for field in field_types(type(sensor))
            if field not in _NO_TEXT and _is_plain(getattr(sensor, field))
        }
        before = {field: text.value for field, text in texts.items()}
        button = self._keep(self._gui.add_button("Apply settings", color="gray"))

        def apply(_: object) -> None:
            given = {field: Text(text.value) for field, text in texts.items() if text.value != before[field]}

            def edit(document: SceneDocument) -> SceneDocument:
                made = configured(document.sensor(name), given, f"sensor '{name}'", "setting")
                return edits.replace_sensor(document, name, **{field: getattr(made, field) for field in given})

            self._do(f"change settings of {name}", edit)

        button.on_click(apply)

    # Helpers

    def _item(self, name: str) -> Item:
        return self._document.item(name)

    def _entity(self, name: str) -> Entity:
        return self._builder.entity(self._item(name))

    def _keep(self, handle: Any) -> Any:
        self._made.append(handle)
        return handle

    def _folder(self, label: str, open_first: bool = True) -> Any:
        return self._keep(self._gui.add_folder(label, expand_by_default=open_first))

    def _input(self, handle: Any, read: Callable[[], Any], name: str, field: str, value: Callable[[Any], Any]) -> None:
        """Connect an input with a field of an item."""
        self._keep(handle)
        self._inputs.append(_Shown(handle, read))

        def change(_: object) -> None:
            # Taken now: the edit may be done again later, when the input shows something else.
            given = value(handle.value)
            self._do(f"change {field} of {name}", lambda document: edits.change(document, name, **{field: given}))

        _by_person(handle, change)


def _by_person(handle: Any, act: Callable[[object], None]) -> None:
    """Call ``act`` when a person changes an input, and not when the program does."""
    handle.on_update(lambda event: act(event) if event.client_id is not None else None)


def mounted(document: SceneDocument, builder: SceneBuilder, name: str, entity: str | None) -> SceneDocument:
    """Return the document with a camera on another carrier: half a metre behind and above its frame, or free.

    Args:
        document: that holds the camera.
        builder: of the document.
        name: of the camera.
        entity: name of the item that carries it; None fixes it to the scene.
    """
    from orbit_scenes.editor.catalogue import sensor_for

    if entity is None:
        return edits.replace_sensor(document, name, entity=None, frame=None)
    # The frame that other sensors take as well: the hand's of an arm, else the root.
    frame = getattr(sensor_for("frame", name, builder.entity(document.item(entity)), Pose()), "frame")  # noqa: B009
    return edits.replace_sensor(document, name, entity=entity, frame=frame)


def euler(orientation: Quaternion) -> Vector3:
    """Return roll, pitch and yaw in degrees, rounded to a thousandth."""
    m = Pose(orientation=orientation).rotation_matrix()
    pitch = math.asin(max(-1.0, min(1.0, -m[2, 0])))
    if abs(m[2, 0]) > 1.0 - 1e-9:  # roll and yaw turn about the same axis: all of it counts as yaw
        roll, yaw = 0.0, math.atan2(-m[0, 1], m[1, 1])
    else:
        roll, yaw = math.atan2(m[2, 1], m[2, 2]), math.atan2(m[1, 0], m[0, 0])
    # Adding zero makes of -0.0, which a person would wonder about, 0.0.
    a, b, c = (round(math.degrees(angle), 3) + 0.0 for angle in (roll, pitch, yaw))
    return (a, b, c)


def joint_value(entity: Entity, joint: str, field: str) -> float:
    """Return a value of a joint as an item's :class:`~orbit_scenes.document.model.JointChange` names it.

    Args:
        entity: that has the joint.
        joint: name of the joint.
        field: of the change; a gain is infinite where the joint has no drive.
    """
    body = entity.articulation
    found = next(each for each in body.joints if each.name == joint)
    if field == "home":
        return float(home_positions(entity)[body.joint_names.index(joint)])
    if field in ("lower", "upper"):
        return getattr(found, f"{field}_limit")
    for group in entity.actuators:
        if any(re.fullmatch(pattern, joint) for pattern in group.joints):
            if field == "effort":
                return found.effort_limit if group.effort_limit is None else group.effort_limit
            return getattr(group, field)
    return math.inf


def _found(document: SceneDocument, name: str) -> Item | SensorSpec | None:
    return next((each for each in (*document.items, *document.sensors) if each.name == name), None)


def _structure(found: Item | SensorSpec) -> str:
    """Return a text that changes where other inputs are needed."""
    if isinstance(found, Item):
        return repr((found.object, sorted(found.parameters.items())))
    return repr(replace(found, pose=Pose()) if isinstance(found, CameraSpec) else found)


def _friction(entity: Entity) -> float:
    shapes = [shape for link in entity.articulation.links for shape in link.collisions]
    return round(min(2.0, shapes[0].material.static_friction), 4) if shapes else 0.0


def _color(entity: Entity) -> tuple[int, int, int]:
    shapes = [shape for link in entity.articulation.links for shape in link.visuals or link.collisions]
    r, g, b = (round(255.0 * part) for part in (shapes[0].color[:3] if shapes else (0.5, 0.5, 0.5)))
    return (r, g, b)


def _is_plain(value: Any) -> bool:
    return (
        value is None
        or isinstance(value, bool | int | float | str | Enum)
        or (isinstance(value, tuple) and all(isinstance(part, bool | int | float | str | Enum) for part in value))
    )


def _words(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_words, value))
    if isinstance(value, Enum):
        return str(value.value)
    return "none" if value is None else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    return [_plain(part) for part in value] if isinstance(value, tuple) else value
