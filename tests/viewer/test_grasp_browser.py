"""A person grasps in a real browser: chooses by a click, sees candidates and ghost, refuses, accepts, lets go."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import ModuleType

import pytest
import torch
from playwright.sync_api import Page

from orbit_core.backends import backend_names
from orbit_core.envs import make
from orbit_motion.grasping import GraspWorkflow, Stage
from orbit_motion.grasping.tool import GraspedEnvironment, GraspTool
from orbit_viewer.viewer import Viewer


@pytest.fixture
def running() -> Iterator[tuple[Viewer, GraspWorkflow]]:
    environment = make("Lift", num_envs=1, backend=backend_names()[0], seed=3)
    grasped = GraspedEnvironment(environment)
    with Viewer(grasped, grasped, port=8160, tool=lambda s, v: GraspTool(grasped.workflow, s, v)) as viewer:
        thread = threading.Thread(target=viewer.run)
        thread.start()
        yield viewer, grasped.workflow
        viewer.controls.stop()
        thread.join(10.0)
    grasped.workflow.close()
    environment.close()


def test_a_person_chooses_refuses_accepts_and_lets_go(
    page: Page, person: ModuleType, running: tuple[Viewer, GraspWorkflow]
) -> None:
    viewer, work = running
    page.goto(person.address(viewer))
    person.until(lambda: len(viewer._server.get_clients()) == 1, page)
    page.get_by_text("choose an object").wait_for()
    page.wait_for_timeout(2000)
    cube = work._world.objects["cube"].root_pose[0, :3].numpy()
    page.mouse.click(*person.pixel(viewer, cube))
    page.get_by_text("accept, refuse or move").wait_for()
    assert work.motion is not None
    first = work.motion.pose
    page.get_by_role("button", name="Refuse").click()
    person.until(lambda: work.motion is not None and not torch.equal(work.motion.pose, first), page)
    page.get_by_role("button", name="Accept").click()
    person.until(lambda: work.stage is Stage.EXECUTING, page)
    page.get_by_text("is lifted by").wait_for()
    assert work.lifted is not None
    assert work.lifted > 0.1
    page.get_by_role("button", name="Gripper").click()
    person.until(lambda: work.driver.gripper_open, page)
