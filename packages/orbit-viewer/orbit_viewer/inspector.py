"""Inspection of a scene in the viewer: selection, tree of entities, contact forces, pulling, following."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch

from orbit_core.interfaces import EntityLayout, OrbitError, SceneLayout
from orbit_core.scene import ContactSensorSpec
from orbit_core.sensors import ContactSensor

if TYPE_CHECKING:
    from viser import ViserServer

    from orbit_viewer.panel import Controls
    from orbit_viewer.scene_view import Frame, SceneView

NOTHING = "nothing"
"""Choice of no entity."""
# Natural frequency (Hz) of the spring by which a person pulls, critically damped: quick, and no tug.
_PULL = 1.5
# Newtons that an arrow of a metre shows.
_NEWTONS = 100.0
# Forces below this many newtons are not drawn.
_LEAST = 0.1


@dataclass(frozen=True)
class Choices:
    """Choices of the person about inspection, taken over as one."""

    selected: str = NOTHING
    """Name of the selected entity."""
    follow: bool = False
    """Whether the camera moves with it."""
    forces: bool = False
    """Whether contact forces are drawn."""
    pull: bool = False
    """Whether the selected entity may be dragged."""


class Inspector:
    """Folder of the panel that inspects the scene.

    Args:
        server: viser's server.
        world: the viewed world.
        scene: drawing of it, whose entities a person clicks.
        controls: requests of the person; a change wakes the simulation's thread.
        follow: entity that the camera follows at first; empty follows nothing.
    """

    def __init__(self, server: ViserServer, world: Any, scene: SceneView, controls: Controls, follow: str = "") -> None:
        self._server, self._world, self._scene, self._controls = server, world, scene, controls
        self._layout: SceneLayout = world.layout
        self.choices = Choices(selected=follow or NOTHING, follow=bool(follow))
        """Choices of the person, set from the web server's threads."""
        self._followed: npt.NDArray[np.float64] | None = None
        self._arrows: Any = None
        self._pulled = ""
        self._grip: Any = None
        self._note = ""
        with server.gui.add_folder("Scene"):
            self._add_choices()
            self._state = server.gui.add_markdown("")
            with server.gui.add_folder("Tree", expand_by_default=False):
                for entity in self._layout.entities:
                    self._add_branch(entity)
        scene.let_click([entity.name for entity in self._layout.entities], self.select)

    def select(self, name: str) -> None:
        """Select an entity, in any thread."""
        if self._selected.value != name:
            self._selected.value = name
        self._change(selected=name)

    def update(self, frame: Frame) -> None:
        """Show the selected entity's state, forces and grip, and move the camera; in the simulation's thread."""
        entity = self._entity()
        self._state.content = self._text(entity, frame)
        self._follow(entity, frame)
        self._show_forces(frame)
        self._show_grip(entity, frame)

    def before_step(self, index: int) -> None:
        """Pull the selected entity of an environment towards where the person holds the grip."""
        entity = self._entity() if self.choices.pull else None
        if self._pulled and (entity is None or entity.name != self._pulled):
            self._apply(self._pulled, torch.zeros(1, 1, 6), index)
            self._pulled = ""
        if entity is None or self._grip is None or entity.spec.fixed_base:
            return
        thing = self._thing(entity.name)
        place, speed = thing.root_pose[index, :3].cpu(), thing.root_velocity[index, :3].cpu()
        target = torch.tensor(np.asarray(self._grip.position) - self._scene.offset, dtype=torch.float32)
        # Scaled by mass, so that light and heavy things follow alike.
        mass, rate = float(thing.nominal_masses[index].sum()), 2.0 * math.pi * _PULL
        force = mass * (rate * rate * (target - place) - 2.0 * rate * speed)
        self._pulled = entity.name
        self._apply(entity.name, torch.cat((force, torch.zeros(3)))[None, None], index)

    # The panel

    def _add_choices(self) -> None:
        gui, choices = self._server.gui, self.choices
        names = [NOTHING, *(entity.name for entity in self._layout.entities)]
        self._selected = gui.add_dropdown("Selected", names, initial_value=choices.selected, hint="Or click a thing")
        follow = gui.add_checkbox("Follow", choices.follow, hint="The camera moves with what is selected")
        forces = gui.add_checkbox("Contact forces", False, hint="Arrows of the forces that contact sensors measure")
        pull = gui.add_checkbox("Pull", False, hint="Drag what is selected by its arrows, against physics")
        self._selected.on_update(lambda _: self._change(selected=self._selected.value))
        follow.on_update(lambda _: self._change(follow=follow.value))
        forces.on_update(lambda _: self._change(forces=forces.value))
        pull.on_update(lambda _: self._change(pull=pull.value))
        self.follow_switch = follow

    def _change(self, selected: str | None = None, **switches: bool) -> None:
        old = self.choices
        self.choices = Choices(
            old.selected if selected is None else selected,
            switches.get("follow", old.follow),
            switches.get("forces", old.forces),
            switches.get("pull", old.pull),
        )
        # Another thing is followed from where it is, without a jump of the camera.
        self._followed = None
        # The person is in another thread, and the scene belongs to the simulation's.
        self._controls.refresh()

    def _add_branch(self, entity: EntityLayout) -> None:
        articulation = entity.spec.articulation
        with self._server.gui.add_folder(entity.name, expand_by_default=False):
            button = self._server.gui.add_button(f"Select {entity.name}", color="gray")
            button.on_click(lambda _: self.select(entity.name))
            links = "".join(f"\n- {link.name}: {link.mass:.3g} kg" for link in articulation.links)
            joints = "".join(f"\n- {joint.name}: {joint.type.value}" for joint in articulation.movable_joints)
            self._server.gui.add_markdown(f"links{links}" + (f"\n\njoints{joints}" if joints else ""))

    # What is shown

    def _entity(self) -> EntityLayout | None:
        name = self.choices.selected
        return None if name == NOTHING else self._layout.entity(name)

    def _thing(self, name: str) -> Any:
        return self._world.robots.get(name) or self._world.objects[name]

    def _text(self, entity: EntityLayout | None, frame: Frame) -> str:
        rows: dict[str, str] = {}
        if entity is not None:
            rows["position, m"] = ", ".join(f"{part:.3f}" for part in frame.link_poses[0, entity.root_link, :3])
            # The past is kept as poses only: what else the world holds is of now.
            if not self._controls.rewound and entity.name in {**self._world.robots, **self._world.objects}:
                speed = self._thing(entity.name).root_velocity[frame.first].tolist()
                rows["velocity, m/s"] = ", ".join(f"{part:.3f}" for part in speed[:3])
            if self.choices.pull and entity.spec.fixed_base:
                rows["pull"] = "its base is fixed"
        if self._note:
            rows["pull"] = self._note
        if self.choices.forces and not self._contact_sensors:
            rows["forces"] = "the scene has no contact sensor (ContactSensorSpec)"
        elif self.choices.forces and self._controls.rewound:
            rows["forces"] = "not kept of the past"
        lines = "\n".join(f"| {name} | {value} |" for name, value in rows.items())
        return f"| | |\n|:--|--:|\n{lines}" if rows else ""

    @property
    def _contact_sensors(self) -> list[ContactSensor]:
        return [sensor for sensor in self._world.sensors.values() if isinstance(sensor, ContactSensor)]

    def _follow(self, entity: EntityLayout | None, frame: Frame) -> None:
        if entity is None or not self.choices.follow:
            self._followed = None
            return
        place = frame.link_poses[0, entity.root_link, :3].astype(np.float64)
        moved = np.zeros(3) if self._followed is None else place - self._followed
        if self._followed is None or float(np.abs(moved).max()) > 1e-4:
            self._followed = place
        for client in self._server.get_clients().values():
            if float(np.abs(moved).max()) > 1e-4:
                client.camera.position = np.asarray(client.camera.position) + moved

    def _show_forces(self, frame: Frame) -> None:
        arrows: list[npt.NDArray[np.floating]] = []
        shown = self.choices.forces and not self._controls.rewound
        for sensor in self._contact_sensors if shown else ():
            assert isinstance(sensor.spec, ContactSensorSpec)
            entity = self._layout.entity(sensor.spec.entity)
            names = entity.spec.articulation.link_names
            for name, force in zip(sensor.link_names, sensor.forces[frame.first].tolist(), strict=True):
                if math.hypot(*force) > _LEAST:
                    start = frame.link_poses[0, entity.links.start + names.index(name), :3] + self._scene.offset
                    arrows.append(np.stack((start, start + np.asarray(force) / _NEWTONS)))
        if self._arrows is not None:
            self._arrows.remove()
            self._arrows = None
        if arrows:
            self._arrows = self._server.scene.add_arrows(
                "/forces", np.asarray(arrows, np.float32), (230, 60, 50), shaft_radius=0.006, head_radius=0.016,
                head_length=0.03,
            )  # fmt: skip

    def _show_grip(self, entity: EntityLayout | None, frame: Frame) -> None:
        wanted = entity is not None and self.choices.pull and not entity.spec.fixed_base
        if not wanted:
            if self._grip is not None:
                self._grip.remove()
                self._grip = None
            return
        assert entity is not None
        place = frame.link_poses[0, entity.root_link, :3] + self._scene.offset
        if self._grip is None:
            self._grip = self._server.scene.add_transform_controls(
                "/grip", scale=0.25, disable_rotations=True, depth_test=False, position=place
            )
            # Let go of, the grip is where the thing is; while it is held, it stays with the pointer.
            self._held = False
            self._grip.on_update(lambda event: self._hold(event.phase != "end"))
        elif not self._held:
            self._grip.position = place

    def _hold(self, held: bool) -> None:
        self._held = held

    def _apply(self, name: str, wrench: torch.Tensor, index: int) -> None:
        thing = self._thing(name)
        try:
            ids = torch.tensor([index], device=self._world.link_poses.device)
            thing.set_wrenches(wrench.to(ids.device), [0], ids)
            self._note = ""
        except OrbitError as error:  # an engine without external wrenches says so in the panel
            self._note = str(error)
