"""Grasping by a person in the browser: candidates, the planned motion as a ghost, gizmos and buttons."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.envs.environment import Environment
from orbit_core.interfaces import ConfigurationError
from orbit_motion.grasping import GraspMotion, GraspWorkflow, Stage
from orbit_viewer.scene_view import Ghost, SceneView

if TYPE_CHECKING:
    from viser import ViserServer

_NOTHING = "(none)"
# Seconds that the ghost stays at the end of its motion.
_PAUSE = 0.5


class GraspedEnvironment:
    """A task's world in which a person works: no episode ends, and the workflow drives the robot.

    Args:
        environment: of the task, with one environment.

    Raises:
        ConfigurationError: no robot of the task can grasp, or nothing can be grasped.
    """

    def __init__(self, environment: Environment) -> None:
        self.num_envs, self.step_dt, self.world = 1, environment.step_dt, environment.world
        """Number of environments (one), seconds of a step and world, as the viewer reads them of any environment."""
        self._environment = environment
        if not environment.world.robots:
            raise ConfigurationError("the task has no robot that could grasp")
        robot = next(iter(environment.world.robots.values()))
        self.workflow = GraspWorkflow(environment.world, robot, environment.step_dt)
        """State of the person's work."""
        self._zero, self._never = torch.zeros(1), torch.zeros(1, dtype=torch.bool)

    def reset(self) -> None:
        """Reset the world and the workflow."""
        self._environment.reset()
        self.workflow.restart()

    def act(self) -> Tensor:
        """Apply the workflow's commands, and return an empty action (1, 0)."""
        self.workflow.drive()
        return torch.zeros(1, 0)

    def step(self, action: Tensor) -> tuple[Any, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Advance the world by one control step."""
        self.world.step(self._environment.task.decimation)
        return {}, self._zero, self._never, self._never, {}


class GraspTool:
    """Page elements for grasping, updated in the simulation's thread.

    Args:
        workflow: that is controlled.
        server: of viser.
        scene: whose objects may be clicked.
    """

    def __init__(self, workflow: GraspWorkflow, server: ViserServer, scene: SceneView) -> None:
        self._work, self._server = workflow, server
        robot = workflow.driver.robot
        self._ghost = Ghost(server, robot.spec)
        self._gizmo = server.scene.add_transform_controls("/grasp/gizmo", scale=0.15, visible=False)
        self._gizmo.on_update(lambda event: self._dragged(event.phase))
        self._candidates: Any = None
        self._seen = -1
        self._began = time.perf_counter()
        self._add_panel()
        scene.let_click(workflow.things, self._clicked)

    def update(self) -> None:
        """Handle the person's requests, show their results, and move the ghost."""
        self._work.update()
        if self._work.version != self._seen:
            self._seen = self._work.version
            self._began = time.perf_counter()
            self._show()
        if (motion := self._work.motion) is not None and self._work.stage is Stage.OFFERED:
            self._ghost.place(self._work.driver.robot.root_pose[0], self._posture(motion))

    # What the person does

    def _add_panel(self) -> None:
        gui, work = self._server.gui, self._work
        with gui.add_folder("Grasp", order=-1.0):
            self._told = gui.add_markdown("")
            self._choice = gui.add_dropdown("Object", (_NOTHING, *work.things))
            self._accept = gui.add_button("Accept", color="green", hint="Do the motion that the ghost shows")
            self._refuse = gui.add_button("Refuse", color="gray", hint="Show the next grasp")
            self._take = gui.add_button("Take the arm", color="gray", hint="Move the hand by the gizmo")
            self._grip = gui.add_button("Gripper", hint="Open or close it")
        self._choice.on_update(lambda event: self._chosen(event.client))
        self._accept.on_click(lambda _: work.accept())
        self._refuse.on_click(lambda _: work.refuse())
        self._take.on_click(lambda _: work.take())
        self._grip.on_click(lambda _: work.set_gripper(not work.driver.gripper_open))

    def _chosen(self, client: object) -> None:
        # The library calls back for values that a program sets, too; those have no client.
        if client is not None and self._choice.value != _NOTHING:
            self._work.select(self._choice.value)

    def _clicked(self, thing: str) -> None:
        self._work.select(thing)

    def _dragged(self, phase: str) -> None:
        # While dragging, only steering follows at once: a new plan takes longer than a frame.
        if phase == "end" or (phase == "update" and self._work.stage is Stage.STEERING):
            pose = torch.tensor((*self._gizmo.position, *self._gizmo.wxyz), dtype=torch.float32)
            self._work.move(pose)

    # What the person sees

    def _show(self) -> None:
        work = self._work
        score = f", score {work.motion.score:.2f}" if work.motion and work.motion.score is not None else ""
        self._told.content = f"**{work.stage.value}**{score}" + (f"\n\n{work.message}" if work.message else "")
        self._choice.value = work.thing or _NOTHING
        self._accept.disabled = work.stage is not Stage.OFFERED or work.motion is None
        self._refuse.disabled = work.stage is not Stage.OFFERED
        self._grip.disabled = work.stage is not Stage.STEERING
        if work.motion is None or work.stage is not Stage.OFFERED:
            self._ghost.hide()
        self._show_gizmo()
        self._show_candidates()

    def _show_gizmo(self) -> None:
        work = self._work
        self._gizmo.visible = work.stage in (Stage.OFFERED, Stage.STEERING)
        if work.stage is Stage.STEERING or work.motion is not None:
            pose = work.motion.pose if work.motion is not None else work.hand_pose()
            self._gizmo.position, self._gizmo.wxyz = pose[:3].cpu().numpy(), pose[3:].cpu().numpy()

    def _show_candidates(self) -> None:
        if self._candidates is not None:
            self._candidates.remove()
            self._candidates = None
        search = self._work.search
        if search is None or self._work.stage not in (Stage.OFFERED, Stage.PLANNING):
            return
        vertices, faces = _fork(search.opening)
        poses = search.poses.cpu().numpy()
        self._candidates = self._server.scene.add_batched_meshes_simple(
            "/grasp/candidates",
            vertices,
            faces,
            poses[:, 3:],
            poses[:, :3],
            batched_colors=_colors(search.candidates.scores.cpu().numpy()),
            opacity=0.6,
            side="double",
            lod="off",
            cast_shadow=False,
        )

    def _posture(self, motion: GraspMotion) -> Tensor:
        """Return the ghost's joint positions (J,) at this time."""
        driver = self._work.driver
        parts = [part.positions for part in (motion.reach, motion.approach, motion.lift)]
        path = np.concatenate(parts)
        step = int((time.perf_counter() - self._began) / motion.reach.dt) % (len(path) + int(_PAUSE / motion.reach.dt))
        positions = driver.robot.joint_positions[0].clone()
        positions[driver.joints] = torch.as_tensor(path[min(step, len(path) - 1)]).to(positions)
        return positions


def _fork(opening: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """Return two fingers, the bar between them and a stem, in the hand's frame: z along the approach."""
    import trimesh

    half, thin, deep = 0.5 * opening, 0.004, 0.04
    bars = (
        ((thin, thin, deep), (0.0, half, -0.5 * deep)),
        ((thin, thin, deep), (0.0, -half, -0.5 * deep)),
        ((thin, opening + thin, thin), (0.0, 0.0, -deep)),
        ((thin, thin, deep), (0.0, 0.0, -1.5 * deep)),
    )
    boxes = [trimesh.creation.box(size, trimesh.transformations.translation_matrix(middle)) for size, middle in bars]
    joined: Any = trimesh.util.concatenate(boxes)
    return np.asarray(joined.vertices, dtype=np.float32), np.asarray(joined.faces, dtype=np.uint32)


def _colors(scores: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Return colours (K, 3) from red for the worst to green for the best."""
    share = (scores - scores.min()) / max(float(np.ptp(scores)), 1e-6)
    return np.stack((255 * (1 - share), 200 * share, np.full_like(share, 40)), axis=1).astype(np.uint8)
