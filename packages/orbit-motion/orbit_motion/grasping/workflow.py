"""Grasping by a person and an arm: choose a thing, search, offer, execute, then follow the person's hand.

Requests may come from any thread. :meth:`GraspWorkflow.update` handles them in the thread that steps the world; plans
are computed in a third one, from a copy of the world, so that world and view continue meanwhile.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from enum import Enum
from functools import partial
from typing import Any

import torch
from torch import Tensor

from orbit_core.actions.base import Actuate, JointTarget
from orbit_core.actions.differential_ik import DifferentialIkConfig
from orbit_core.actions.grippers import BinaryGripperConfig
from orbit_core.interfaces import (
    ArgumentError,
    ConfigurationError,
    OrbitError,
    PlanningError,
    Robot,
    UnknownNameError,
    World,
)
from orbit_core.interfaces.layout import actuator_of_joint
from orbit_motion.grasping.planner import GraspMotion, GraspSearch
from orbit_motion.planning import JointTrajectory, StillWorld, TrajectoryFollower


class ArmDriver:
    """Controller of a robot's first arm and gripper, once per control step; without orders the arm holds still.

    Args:
        world: of one environment.
        robot: that moves.
        step_dt: s from one command to the next.

    Raises:
        ConfigurationError: there are several environments; or the robot has no arm with a gripper; or joints of its arm
            are not driven by positions.
    """

    def __init__(self, world: World, robot: Robot, step_dt: float) -> None:
        if world.num_envs != 1:
            raise ConfigurationError(f"a person drives one environment, not {world.num_envs}: use num_envs=1")
        self.robot = robot
        self._hand = DifferentialIkConfig(robot=robot.name).build("hand", robot)
        self._gripper = BinaryGripperConfig(robot=robot.name).build("gripper", robot)
        self.joints = self._hand.joints
        """Indices of the arm's joints."""
        actuators = actuator_of_joint(robot.spec)
        for joint in self.joints:
            if not actuators[joint].stiffness > 0.0:
                raise ConfigurationError(
                    f"joint '{robot.joint_names[joint]}' of '{robot.name}' is not driven by positions: choose the "
                    "action space joint_position"
                )
        self._follower = TrajectoryFollower("follow", robot, self.joints, 1.0 / step_dt)
        self._actuate = Actuate(robot, self._hand), Actuate(robot, self._gripper)
        self.gripper_open = True
        """Commanded state of the gripper."""
        self._goal: Tensor | None = None

    def follow(self, trajectory: JointTrajectory) -> None:
        """Begin a path; the arm holds its end."""
        self._goal = None
        self._follower.load({0: trajectory})

    @property
    def arrived(self) -> bool:
        """True if the path's end was commanded."""
        return bool(self._follower.finished[0])

    def hold(self) -> None:
        """Hold the arm where it is."""
        self._goal = None
        self._follower.reset()

    def steer(self, pose: Tensor) -> None:
        """Move the hand towards a pose (7,) in the environment, by differential inverse kinematics."""
        self._goal = pose[None].to(self.robot.joint_positions)

    def advance(self) -> None:
        """Set the targets of the next control step."""
        if self._goal is None:
            targets = self._follower.compute({})
            self.robot.set_position_targets(targets[JointTarget.POSITION], self.joints)
            self.robot.set_velocity_targets(targets[JointTarget.VELOCITY], self.joints)
        else:
            command = self._hand.encode(self._goal, torch.tensor([self.gripper_open]))
            # Inverse kinematics commands positions only; an old velocity target would push the arm on.
            self._actuate[0].compute(self._hand.compute({"command": command}))
            self.robot.set_velocity_targets(torch.zeros_like(self._hand.positions), self.joints)
        opening = torch.full((1, 1), 1.0 if self.gripper_open else -1.0, device=self.robot.joint_positions.device)
        self._actuate[1].compute(self._gripper.compute({"command": opening}))


# Metres by which a thing may have moved since its grasps were planned.
_MOVED = 0.005
# Height (m) above which a thing counts as lifted.
_LIFTED = 0.05


class Stage(Enum):
    """Stage of the workflow."""

    CHOOSING = "choose an object"
    PLANNING = "looking for grasps"
    OFFERED = "accept, refuse or move the grasp"
    EXECUTING = "grasping"
    """The arm moves through an accepted grasp."""
    STEERING = "the arm is yours"


class GraspWorkflow:
    """State of the workflow; one robot, one environment.

    Args:
        world: of one environment.
        robot: that grasps; its first end effector has a parallel gripper.
        step_dt: s of a control step.

    Raises:
        ConfigurationError: the robot cannot grasp, or the scene has nothing that it could.
    """

    def __init__(self, world: World, robot: Robot, step_dt: float) -> None:
        self._world, self._dt = world, step_dt
        self.driver = ArmDriver(world, robot, step_dt)
        """Controller that each step of the workflow commands."""
        self.things = tuple(name for name, thing in world.objects.items() if not thing.spec.fixed_base)
        """Names of the objects that may be chosen."""
        if not self.things:
            raise ConfigurationError("the scene has no object that is free to move: there is nothing to grasp")
        self._frame = robot.spec.end_effector.frame
        self._wishes: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._thread = ThreadPoolExecutor(1, "grasp-plans")
        self._job: tuple[Future[Any], Callable[[Any], None]] | None = None
        self._motions: Iterator[GraspMotion] | None = None
        self._phases: Iterator[None] | None = None
        self.version = 0
        """Counter that grows with every change of the fields below."""
        self._begin()

    # Requests, from any thread

    def select(self, thing: str) -> None:
        """Search grasps of an object.

        Raises:
            UnknownNameError: it is none that may be chosen.
        """
        if thing not in self.things:
            raise UnknownNameError("object", thing, self.things, "what can be grasped")
        self._wishes.put(partial(self._select, thing))

    def refuse(self) -> None:
        """Request the next grasp."""
        self._wishes.put(self._refuse)

    def accept(self) -> None:
        """Execute the offered grasp."""
        self._wishes.put(self._accept)

    def move(self, pose: Tensor) -> None:
        """Request a grasp with the hand at a pose (7,) while OFFERED; move the hand there while STEERING.

        Raises:
            ArgumentError: the values are not a pose.
        """
        if pose.shape != (7,) or not bool(pose.isfinite().all()):
            raise ArgumentError(f"a pose is 7 finite numbers, position and quaternion, not {pose.tolist()}")
        self._wishes.put(partial(self._move, pose.to(self._world.device, torch.float32)))

    def take(self) -> None:
        """Stop the arm at once, and let the person steer it."""
        self._wishes.put(self._take)

    def set_gripper(self, opened: bool) -> None:
        """Open or close the gripper while STEERING."""
        self._wishes.put(partial(self._set_gripper, opened))

    # In the world's thread

    def restart(self) -> None:
        """Begin again after the world was reset."""
        self._begin()

    def update(self) -> None:
        """Handle requests, and plans that are ready."""
        while not self._wishes.empty():
            self._wishes.get()()
        # The job is cleared first: its handler may start the next one.
        if self._job and self._job[0].done():
            (future, then), self._job = self._job, None
            try:
                then(future.result())
            except OrbitError as error:
                self.motion = None
                self._tell(Stage.OFFERED if self.search else Stage.CHOOSING, str(error))

    def drive(self) -> None:
        """Set the robot's targets of the next control step."""
        # ``next`` with a default: exhaustion of the generator ends the execution.
        if self._phases is not None and next(self._phases, self) is self:
            self._phases = None
        self.driver.advance()

    def close(self) -> None:
        """Stop the planning thread, once its plan is done."""
        self._thread.shutdown(wait=True, cancel_futures=True)

    def hand_pose(self) -> Tensor:
        """Return the pose (7,) of the end effector."""
        return self.driver.robot.frame_pose(self._frame)[0].clone()

    # Handling of requests

    def _begin(self) -> None:
        self._job = self._phases = self._motions = None
        self.thing: str | None = None
        self.search: GraspSearch | None = None
        self.motion: GraspMotion | None = None
        """The offered motion."""
        self.lifted: float | None = None
        """Height (m) by which the last grasp lifted its thing."""
        self.driver.gripper_open = True
        self.driver.hold()
        self._tell(Stage.CHOOSING)

    def _tell(self, stage: Stage, message: str = "") -> None:
        self.stage, self.message = stage, message
        self.version += 1

    def _select(self, thing: str) -> None:
        if self.stage is Stage.EXECUTING:
            return
        if not self.driver.gripper_open:
            self._tell(self.stage, "open the gripper before you choose an object")
            return
        self.thing, self.search, self.motion = thing, None, None
        self.driver.hold()
        still = StillWorld.of(self._world, self.driver.robot)
        self._plan(partial(GraspSearch, still, self.driver.joints, thing, self._dt), self._found)

    def _found(self, search: GraspSearch) -> None:
        self.search, self._motions = search, search.motions()
        self._plan(partial(next, self._motions, None), self._offer)

    def _refuse(self) -> None:
        if self.stage is Stage.OFFERED and self._motions is not None:
            self._plan(partial(next, self._motions, None), self._offer)

    def _offer(self, motion: GraspMotion | None) -> None:
        if motion is None:
            raise PlanningError(
                f"no other grasp of '{self.thing}' has a plan: choose the object again, or move the hand"
            )
        self.motion = motion
        self._tell(Stage.OFFERED)

    def _move(self, pose: Tensor) -> None:
        if self.stage is Stage.STEERING:
            self.driver.steer(pose)
        elif self.stage is Stage.OFFERED and self.search is not None:
            self._plan(partial(self.search.motion_to, pose), self._offer)

    def _plan(self, job: Callable[[], Any], then: Callable[[Any], None]) -> None:
        self._job = (self._thread.submit(job), then)
        self._tell(Stage.PLANNING)

    def _accept(self) -> None:
        if self.stage is not Stage.OFFERED or self.motion is None or self.thing is None or self.search is None:
            return
        here = self._world.objects[self.thing].root_pose[0, :3]
        if float((here - self.search.place).norm()) > _MOVED:
            self._tell(Stage.OFFERED, f"'{self.thing}' has moved since: choose it again")
            return
        self._phases = self._execution(self.motion, self.thing)
        self._tell(Stage.EXECUTING)

    def _take(self) -> None:
        self._job = self._phases = None
        self.motion = self.search = None
        self.driver.hold()
        self._tell(Stage.STEERING)

    def _set_gripper(self, opened: bool) -> None:
        if self.stage is Stage.STEERING:
            self.driver.gripper_open = opened
            self._tell(Stage.STEERING)

    def _execution(self, motion: GraspMotion, thing: str) -> Iterator[None]:
        """Execute a motion as a generator, one iteration per control step."""
        before = float(self._world.objects[thing].root_pose[0, 2])
        for part in (motion.reach, motion.approach):
            self.driver.follow(part)
            yield from self._until_there()
        self.driver.gripper_open = False
        # Seconds in which the slowest gripper of the catalogue closes.
        yield from self._wait(0.8)
        self.driver.follow(motion.lift)
        yield from self._until_there()
        self.lifted = float(self._world.objects[thing].root_pose[0, 2]) - before
        self.motion = self.search = None
        outcome = "is lifted" if self.lifted > _LIFTED else "is not lifted: it stands"
        self._tell(Stage.STEERING, f"'{thing}' {outcome} by {self.lifted:.3f} m")

    def _until_there(self) -> Iterator[None]:
        yield
        while not self.driver.arrived:
            yield
        # Let the arm settle before the next part.
        yield from self._wait(0.3)

    def _wait(self, seconds: float) -> Iterator[None]:
        for _ in range(round(seconds / self._dt)):
            yield
