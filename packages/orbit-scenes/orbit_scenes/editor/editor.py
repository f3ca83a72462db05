"""Editor: one thread that owns document, pictures and physics, and takes what a person does from a queue."""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np
from torch import Tensor

from orbit_core.interfaces.errors import ConfigurationError, OrbitError
from orbit_core.scene import CameraSpec, Entity, ObjectSpec, Pose, RayCameraSpec, RobotSpec, Scene, look_at
from orbit_core.scene.pose import Quaternion, Vector3
from orbit_scenes.document import edits
from orbit_scenes.document.files import imported
from orbit_scenes.document.model import SceneDocument, TaskPlan
from orbit_scenes.document.session import RECOVERED, Session
from orbit_scenes.editor.catalogue import Entry, Group, sensor_for
from orbit_scenes.editor.panel import GOAL, Actions, Panel
from orbit_scenes.editor.pictures import Eye, camera_pose, entity_poses, scene_poses
from orbit_scenes.editor.playing import PhysicsPlay, Playing, TaskPlay
from orbit_scenes.editor.properties import Edit
from orbit_scenes.editor.stage import Stage
from orbit_viewer.panel import Pacer
from orbit_viewer.scene_view import FIELD_OF_VIEW, VIEW_DIRECTION
from orbit_viewer.viewer import start_server

# Seconds between edits that count as one, where they are of the same kind: strokes of a key in a number's field.
_TYPING = 1.0
# Share of the time that live pictures may take, and least seconds between two of them.
_DRAWING, _PICTURE_PERIOD = 0.3, 0.2
# Seconds after which the loop looks at the panel without being woken.
_IDLE = 0.2
# Corners of what a page shows of an empty scene, m.
_START_VIEW = ((-1.0, -1.0, 0.0), (1.0, 1.0, 0.8))


class Editor(Actions):
    """Editor of a scene at a web address of this computer.

    Args:
        session: the scene file's session; the caller closes it.
        backends: names of engines; the first one is chosen.
        renderer: name of what draws pictures.
        host: network address to listen on. Any other than this computer's own requires the token that :attr:`url`
            carries.
        port: if taken, the next free one is used.

    Raises:
        ConfigurationError: the web server's library is not installed, or it cannot listen.
    """

    def __init__(
        self, session: Session, backends: list[str], renderer: str, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        self.session = session
        """Session whose document is edited."""
        self._queue: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._renderer = renderer
        title = f"ORBIT editor: {session.path.name}"
        self._server, token = start_server(host, port, title, ())
        root = f"http://{host}:{self._server.get_port()}"
        self.url = f"{root}/?token={token}" if token else root
        """Address of the page, with a token where other computers reach it."""
        self.selected = ""
        """Name of the selected item, sensor or goal region; empty: nothing."""
        self.playing: Playing | None = None
        """Physics or task that runs; None while the scene is edited."""
        self.pictures_drawn = 0
        """Number of pictures that cameras of the scene have taken."""
        self._stopped = False
        self._note = f"{RECOVERED}: undo goes back to the file" if session.recovered else ""
        self._stage = Stage(self._server, self.select)
        self._panel = Panel(
            self._server, self, session.builder, backends, renderer, title, f"orbit run {session.path} --agent random"
        )
        self._gizmo: Any = None
        self._grip = ("", 0.0)
        self._dragged: Pose | None = None
        self._eye: tuple[tuple[Any, ...], Eye] | None = None
        self._picture_time, self._picture_turn = -math.inf, 0
        self._edited = ("", -math.inf)
        self._pacer = Pacer()
        self._scene = session.builder.scene(session.document)
        self._aim()
        self._refresh()

    def run(self) -> None:
        """Serve the page until the interrupt key or :meth:`stop`."""
        try:
            while not self._stopped:
                self._turn()
        except KeyboardInterrupt:
            self._stopped = True

    def close(self) -> None:
        """Stop physics and the web server; idempotent."""
        self._stopped = True
        self._end_play()
        self._drop_eye()
        self._server.stop()

    def __enter__(self) -> Editor:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # What a person does, in any thread

    def stop(self) -> None:
        """End :meth:`run`."""
        self._put(self._stop)

    def do(self, label: str, edit: Edit) -> None:
        self._put(lambda: self._do(label, edit))

    def select(self, name: str) -> None:
        self._put(lambda: self._select(name))

    def add(self, entry: Entry) -> None:
        self._put(lambda: self._add(entry))

    def add_file(self, name: str) -> None:
        self._put(lambda: self._add_file(name))

    def undo(self) -> None:
        self._put(lambda: self._step_back(self.session.undo(), "undone"))

    def redo(self) -> None:
        self._put(lambda: self._step_back(self.session.redo(), "done again"))

    def duplicate(self) -> None:
        self._put(self._duplicate)

    def delete(self) -> None:
        self._put(self._delete)

    def drop(self) -> None:
        self._put(self._drop)

    def play(self) -> None:
        self._put(self._play)

    def keep(self) -> None:
        self._put(self._keep)

    def try_task(self, agent: str) -> None:
        self._put(lambda: self._try_task(agent))

    def make_task(self) -> None:
        self._put(self._make_task)

    def save(self) -> None:
        self._put(self._save)

    def save_usd(self) -> None:
        self._put(self._save_usd)

    def wake(self) -> None:
        self._put(lambda: None)

    def _put(self, action: Callable[[], None]) -> None:
        self._queue.put(action)

    # The loop

    def _turn(self) -> None:
        drawn = False
        if self.playing is not None:
            self._advance()
        else:
            drawn = self._panel.library.draw_next()
        self._show_pictures()
        # Sleep only where nothing moves and no picture of the catalogue waits to be drawn.
        wait = 0.0 if drawn or self.playing is not None else _IDLE
        while True:
            try:
                action = self._queue.get(timeout=wait) if wait else self._queue.get_nowait()
            except queue.Empty:
                break
            self._try(action)
            # What came meanwhile is done before the page is shown again.
            wait = 0.0
        self._show_status()

    def _try(self, action: Callable[[], None]) -> None:
        """Run an action; what it refuses is shown to the person."""
        try:
            action()
        except OrbitError as error:
            self._say(str(error), "red")

    def _say(self, words: str, color: Any = None) -> None:
        """Show a message in the panel, and errors also as a notification."""
        # The status line has one line; errors of engines may have several.
        words = " ".join(words.split())
        self._note = words
        if color is not None:
            for client in self._server.get_clients().values():
                client.add_notification("ORBIT", words, auto_close_seconds=8.0, color=color)

    def _show_status(self) -> None:
        history, playing = self.session.history, self.playing
        note = self._note or ("" if self.session.document.items else "begin in the tab Add")
        self._panel.show_status(self.session.path.name, history.saved, note, playing.words if playing else "")

    def _refresh(self) -> None:
        """Show the document as it now is."""
        document = self.session.document
        self._scene = self.session.builder.scene(document)
        self._stage.show(self._scene, scene_poses(self._scene), document.task)
        self._show_selection()
        self._show_status()

    def _show_selection(self) -> None:
        document, name = self.session.document, self.selected
        # An undo may have taken away what was selected.
        known = {each.name for each in (*document.items, *document.sensors)} | ({GOAL} if document.task else set())
        if name not in known:
            self.selected = name = ""
        items = {item.name: item for item in document.items}
        if name in items:
            self._stage.show_selected(*self.session.builder.bounds(items[name]))
        else:
            self._stage.show_selected(None)
        self._show_gizmo()
        self._panel.show(document, name)
        # Cameras draw again, each once.
        self._picture_time, self._picture_turn = -math.inf, 0

    # Edits

    def _do(self, label: str, edit: Edit) -> None:
        self._refuse_while_playing()
        now = time.monotonic()
        # A person who types or drags a slider makes one edit, which one undo takes back.
        merge = self._edited[0] == label and now - self._edited[1] < _TYPING
        try:
            if self.session.do(label, edit, merge):
                self._edited = (label, now)
                self._note = label
        finally:
            # Also after a refusal: inputs show again what holds.
            self._refresh()

    def _step_back(self, label: str, what: str) -> None:
        self._refuse_while_playing()
        # The next edit stands by itself, whatever it is called.
        self._edited = ("", -math.inf)
        self._note = f"{what}: {label}" if label else "there is nothing more"
        self._refresh()

    def _refuse_while_playing(self) -> None:
        if self.playing is not None:
            raise ConfigurationError("physics runs: stop it first, then edit")

    def _select(self, name: str) -> None:
        known = {each.name for each in (*self.session.document.items, *self.session.document.sensors)}
        # A rename that was refused selects a name that is not there.
        if name in known or name in ("", GOAL):
            self.selected = name
            self._show_selection()

    def _add(self, entry: Entry) -> None:
        document, builder = self.session.document, self.session.builder
        name = edits.unique_name(document, entry.name)
        if entry.group is Group.SENSOR:
            sensor = sensor_for(entry.name, name, self._selected_entity(), self._view())
            self._do(f"add {name}", lambda document: edits.add_sensor(document, sensor))
        else:
            # Where the person looks, beside what is selected, so that nothing is added out of sight or inside another.
            x, y = self._aimed()
            item = edits.standing_near(document, builder, entry.item(name), x, y, self.selected)
            self._do(f"add {name}", lambda document: edits.add_item(document, item))
        self._select(name)

    def _add_file(self, name: str) -> None:
        from orbit_scenes.document.build import inside

        # Read once, before the edit: a file that is refused leaves no step to undo.
        found = imported(inside(self.session.path.parent, name))

        def edit(document: SceneDocument) -> SceneDocument:
            for item in found.items:
                document = edits.add_item(document, replace(item, name=edits.unique_name(document, item.name)))
            return document if not found.terrain or document.terrain else replace(document, terrain=found.terrain)

        self._do(f"add {name}", edit)

    def _duplicate(self) -> None:
        name = self._needs_selection()
        _, copy = edits.duplicate(self.session.document, name)
        self._do(f"duplicate {name}", lambda document: edits.duplicate(document, name)[0])
        self._select(copy)

    def _delete(self) -> None:
        if (name := self._needs_selection()) == GOAL:
            self._do("remove the task", lambda document: replace(document, task=None))
        else:
            self._do(f"delete {name}", lambda document: edits.remove(document, [name]))

    def _drop(self) -> None:
        names = [self._needs_selection()] if self.selected else list(edits.free_items(self._scene.entities))
        self._say(f"dropping {', '.join(names)} on {self._panel.backend}")
        self._show_status()
        builder, backend = self.session.builder, self._panel.backend
        self._do(f"drop {', '.join(names)}", lambda document: edits.settle(document, builder, names, backend))

    def _needs_selection(self) -> str:
        if not self.selected:
            raise ConfigurationError("nothing is selected: click a thing, or choose it in the panel")
        return self.selected

    def _selected_entity(self) -> Entity | None:
        return next((each for each in self._scene.entities if each.name == self.selected), None)

    # Files

    def _save(self) -> None:
        self.session.save()
        self._note = f"saved {self.session.path.name}"

    def _save_usd(self) -> None:
        path, lost = self.session.save_usd()
        self._say(
            f"wrote {path.name}" + (f"; not held: {'; '.join(lost)}" if lost else ""), "yellow" if lost else "green"
        )

    def _stop(self) -> None:
        self._stopped = True

    # Physics

    def _play(self) -> None:
        if self.playing is not None:
            self._end_play()
            self._note = "stopped: the scene is as it was edited"
            self._refresh()
            return
        self._start_play(lambda: PhysicsPlay(self._scene, self._panel.backend))

    def _try_task(self, agent: str) -> None:
        self._end_play()
        # The task is read from the file, as by 'orbit run'.
        self._save()
        self._start_play(lambda: TaskPlay(self.session.path, self._panel.backend, agent))

    def _start_play(self, start: Callable[[], Playing]) -> None:
        self._say(f"building the scene on {self._panel.backend}")
        self._show_status()
        self.playing = start()
        self._remove_gizmo()
        self._stage.show_selected(None)
        self._note = self.playing.words

    def _keep(self) -> None:
        if self.playing is None:
            return
        # Read before the engine is closed, which frees them.
        states = self.playing.states()
        self._end_play()
        if states:
            self._do("keep where physics left things", lambda document: edits.kept(document, states))
        self._refresh()

    def _advance(self) -> None:
        assert self.playing is not None
        try:
            self.playing.step()
            self._show_moved(self.playing.link_poses.detach().cpu())
        except OrbitError as error:
            self._end_play()
            self._say(str(error), "red")
            self._refresh()
            return
        self._pacer.wait(self.playing.step_dt)

    def _show_moved(self, link_poses: Tensor) -> None:
        with self._server.atomic():
            start = 0
            # A task's scene has the same entities in the same order; only one robot's name differs.
            for entity in self._scene.entities:
                count = len(entity.articulation.links)
                self._stage.move(entity.name, link_poses[0, start : start + count].numpy())
                start += count

    def _end_play(self) -> None:
        if self.playing is not None:
            self.playing.close()
            self.playing = None

    # The task

    def _make_task(self) -> None:
        robots = [each.name for each in self._scene.robots]
        free = edits.free_items(self._scene.entities)
        if not robots:
            raise ConfigurationError("a task needs a robot: add one")
        if self.selected not in free:
            raise ConfigurationError("select an object that is free to move: the task is to bring it to the goal")
        # A quarter of a metre aside: near enough to be reached, and far enough to be seen.
        x, y, z = self.session.document.item(self.selected).position
        task = TaskPlan(robot=robots[0], objects=(self.selected,), goal=(round(x, 3), round(y + 0.25, 3), round(z, 3)))
        self._do("make a task", lambda document: replace(document, task=task))
        self._select(GOAL)

    # The gizmo

    def _gizmo_pose(self) -> Pose | None:
        """Return the pose of what the selection's gizmo moves; None if it moves nothing."""
        document = self.session.document
        if self.selected == GOAL and document.task is not None:
            return Pose(document.task.goal)
        for item in document.items:
            if item.name == self.selected:
                return item.pose
        for sensor in document.sensors:
            if sensor.name == self.selected and isinstance(sensor, CameraSpec):
                return camera_pose(sensor, self._scene, scene_poses(self._scene))
        return None

    def _show_gizmo(self) -> None:
        pose = self._gizmo_pose()
        if pose is None:
            self._remove_gizmo()
            return
        grip = (self.selected, self._gizmo_scale())
        if self._gizmo is None or self._grip != grip:
            self._remove_gizmo()
            self._grip = grip
            self._gizmo = self._server.scene.add_transform_controls(
                "/gizmo", scale=grip[1], depth_test=False, disable_rotations=self.selected == GOAL,
                position=pose.position, wxyz=pose.orientation,
            )  # fmt: skip

            # Asynchronous callbacks keep the order of a drag's events, which threads would not.
            async def update(event: Any) -> None:
                x, y, z = (float(part) for part in event.target.position)
                w, qx, qy, qz = (float(part) for part in event.target.wxyz)
                self._put(lambda: self._drag(event.phase, (x, y, z), (w, qx, qy, qz)))

            self._gizmo.on_update(update)
        else:
            self._gizmo.position, self._gizmo.wxyz = pose.position, pose.orientation

    def _gizmo_scale(self) -> float:
        for item in self.session.document.items:
            if item.name == self.selected:
                low, high = self.session.builder.bounds(item)
                # Larger than the thing, so that its arrows stand out of it, within what fits on the page.
                return round(min(0.8, max(0.25, 0.75 * float((high - low).max()))), 2)
        return 0.25

    def _remove_gizmo(self) -> None:
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None

    def _drag(self, phase: str, position: Vector3, orientation: Quaternion) -> None:
        # Events of a drag may arrive after its thing was deleted or physics began.
        start = self._gizmo_pose()
        if start is None or self._gizmo is None or self.playing is not None:
            return
        snap, name = self._panel.snap, self.selected
        pose = edits.snapped(Pose(position, orientation), start, snap.grid, snap.angle)
        if phase != "end":
            self._preview(name, pose)
            return
        if name == GOAL:
            self._do("move the goal", lambda document: _with_goal(document, pose.position))
        elif isinstance(found := self._camera(name), CameraSpec):
            # In the frame that carries it, which its present pose tells from its pose in the scene.
            own = found.pose @ start.inverse() @ pose
            self._do(f"move {name}", lambda document: edits.place(document, name, own))
        else:
            self._do(f"move {name}", lambda document: edits.place(document, name, pose))

    def _preview(self, name: str, pose: Pose) -> None:
        """Show what is dragged where it would be."""
        if name == GOAL:
            self._stage.move_goal(pose.position)
        entity = next((each for each in self._scene.entities if each.name == name), None)
        if entity is not None:
            self._stage.move(name, entity_poses(replace(entity, pose=pose)).numpy())
            low, high = self.session.builder.bounds(self.session.document.item(name).at(pose))
            self._stage.show_selected(low, high)

    def _camera(self, name: str) -> CameraSpec | None:
        return next((s for s in self._scene.sensors if s.name == name and isinstance(s, CameraSpec)), None)

    # Views

    def _aim(self) -> None:
        """Aim the camera of new pages at the scene."""
        bounds = [self.session.builder.bounds(item) for item in self.session.document.items]
        low, high = map(np.asarray, _START_VIEW)
        if bounds:
            low = np.min([each[0] for each in bounds], axis=0)
            high = np.max([each[1] for each in bounds], axis=0)
        middle, radius = (low + high) / 2.0, max(0.3, float(np.linalg.norm(high - low)) / 2.0)
        eye = middle + VIEW_DIRECTION * radius / math.sin(FIELD_OF_VIEW / 2.0)
        camera = self._server.initial_camera
        camera.fov = FIELD_OF_VIEW
        camera.position, camera.look_at = eye, middle
        camera.near = radius / 100.0

    def _aimed(self) -> tuple[float, float]:
        """Return the place (x, y) for what is added: the middle of what is selected, or of the page."""
        if self.selected in {item.name for item in self.session.document.items}:
            low, high = self.session.builder.bounds(self.session.document.item(self.selected))
            x, y = (low[:2] + high[:2]) / 2.0
            return round(float(x), 2), round(float(y), 2)
        for client in self._server.get_clients().values():
            x, y, _ = client.camera.look_at
            grid = self._panel.snap.grid or 0.01
            return round(round(float(x) / grid) * grid, 4), round(round(float(y) / grid) * grid, 4)
        return 0.0, 0.0

    def _view(self) -> Pose:
        """Return the pose of a scene's camera that sees what the page shows, from nearer and aside.

        Where the page's own eye is, the camera's frustum would hide everything.
        """
        for client in self._server.get_clients().values():
            eye, target = np.asarray(client.camera.position), np.asarray(client.camera.look_at)
            aside = np.cross(target - eye, (0.0, 0.0, 1.0))
            x, y, z = (round(float(part), 3) for part in eye + 0.4 * (target - eye) + 0.2 * aside)
            a, b, c = (round(float(part), 3) for part in target)
            return look_at((x, y, z), (a, b, c))
        return look_at((1.5, 1.0, 1.2), (0.0, 0.0, 0.3))

    # Live pictures

    def _show_pictures(self) -> None:
        """Draw what one of the cameras sees; they take turns, and the selected one is shown large."""
        # Cameras of rays see no colours.
        cameras = [
            sensor
            for sensor in self._scene.sensors
            if isinstance(sensor, CameraSpec) and not isinstance(sensor, RayCameraSpec)
        ]
        chosen = next((camera for camera in cameras if camera.name == self.selected), None)
        if chosen is None:
            self._panel.show_picture(None)
        now = time.perf_counter()
        if not cameras or now < self._picture_time:
            return
        self._picture_turn += 1
        camera = chosen or cameras[self._picture_turn % len(cameras)]
        poses = scene_poses(self._scene) if self.playing is None else self.playing.link_poses.detach().cpu()
        try:
            eye = self._eye_of(self._scene, cameras)
            picture = eye.picture(camera, camera_pose(camera, self._scene, poses), poses)
        except OrbitError as error:
            self._say(str(error), "red")
            self._picture_time = math.inf  # until the scene changes
            return
        self.pictures_drawn += 1
        self._stage.show_seen(camera.name, picture)
        if chosen is not None:
            self._panel.show_picture(picture)
        taken = time.perf_counter() - now
        # While nothing moves, one picture of each is enough.
        still = self.playing is None and self._picture_turn >= len(cameras)
        self._picture_time = math.inf if still else now + max(_PICTURE_PERIOD, taken / _DRAWING)

    def _eye_of(self, scene: Scene, cameras: list[CameraSpec]) -> Eye:
        """Return a renderer of the scene, made again only where more than poses changed."""
        looks = [each.articulation for each in scene.entities if isinstance(each, RobotSpec | ObjectSpec)]
        lenses = [replace(camera, pose=Pose(), entity=None, frame=None) for camera in cameras]
        key = (*map(id, looks), *lenses, scene.lights, scene.sky, scene.terrain)
        if self._eye is None or self._eye[0] != key:
            self._drop_eye()
            self._eye = (key, Eye(scene, cameras, self._renderer))
        return self._eye[1]

    def _drop_eye(self) -> None:
        if self._eye is not None:
            self._eye[1].close()
            self._eye = None


def _with_goal(document: SceneDocument, goal: Vector3) -> SceneDocument:
    task = document.task
    return document if task is None else replace(document, task=replace(task, goal=goal))
