"""Lead a hand through waypoints on both sides of a post, along paths that are planned around it, through a bridge.

Start a simulated robot with the post next to it, and the program that drives it, in one go or apart::

    python packages/orbit-deploy/examples/waypoints.py
    python packages/orbit-deploy/examples/waypoints.py --robot franka_panda_allegro
    python packages/orbit-deploy/examples/waypoints.py --serve --port 5555
    python packages/orbit-deploy/examples/waypoints.py --bridge zmq://127.0.0.1:5555

The hand closes on the right of the post, goes around, and opens on the left. The post of the simulated robot is a thing
that falls over when it is touched; its pose is tracked, and the plan avoids it where it is.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from orbit_assets.catalogue import robot as catalogue_robot
from orbit_assets.objects import cylinder
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import JointTarget, PlanningError, World
from orbit_core.interfaces.layout import gripper_positions
from orbit_core.mdp import common
from orbit_core.scene import Pose, Scene
from orbit_deploy import RobotLink, connect, robot_world
from orbit_deploy.engine import RobotEngine
from orbit_deploy.realtime import prioritize
from orbit_motion.full_ik import FullIk
from orbit_motion.planning import JointPlanner, PlannerConfig, TrajectoryFollower, time_optimal

RATE = 50.0
DECIMATION = 4
POST_RADIUS, POST_LENGTH = 0.05, 0.7
# m that stays free of the post on the planned path
MARGIN = 0.01
# Share of the joints' limits that a motion uses, so that the robot's own limits hold nothing back
SHARE = 0.4
# Positions of the hand, which points down, and whether the hand is open when it leaves them
RIGHT, LEFT = (0.55, -0.3, 0.35), (0.55, 0.3, 0.35)
WAYPOINTS = ((RIGHT, False), (LEFT, True), (RIGHT, True))
HAND_SECONDS = 0.8


def scene(robot: str, falls: bool) -> Scene:
    """Return a robot and a post on the floor in front of it.

    Args:
        robot: name in the catalogue.
        falls: let the post fall, as the simulated one does.
    """
    spec = replace(catalogue_robot(robot), name="robot")
    pose = Pose((0.6, 0.0, 0.5 * POST_LENGTH))
    post = cylinder("post", POST_RADIUS, POST_LENGTH, mass=1.0, pose=pose, fixed_base=not falls)
    return Scene(robots=(spec,), objects=(post,), terrain=(common.floor(),), physics_dt=1.0 / (RATE * DECIMATION))


def serve(robot: str, backend: str, address: str) -> None:
    """Serve the simulated robot until it is interrupted."""
    # Before there are threads, which inherit the priority
    prioritize()
    from orbit_deploy.computer import RobotComputer
    from orbit_deploy.link import bridge
    from orbit_deploy.simulated import SimulatedHardware

    torch.set_num_threads(1)
    hardware = SimulatedHardware(scene(robot, falls=True), backend)
    computer = RobotComputer(hardware)
    server = bridge(address.partition(":")[0]).serve(computer, address)
    print(f"serving {robot} at {server.address}", flush=True)
    try:
        computer.run()
    except KeyboardInterrupt:
        computer.end()
        computer.run()
    finally:
        server.close()
        hardware.close()


@contextmanager
def served(robot: str, backend: str) -> Iterator[str]:
    """Address of a simulated robot in a process of its own."""
    words = [sys.executable, __file__, "--serve", "--robot", robot, "--backend", backend, "--port", "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().rpartition(" at ")[2].strip()
        finally:
            process.terminate()


@dataclass
class Report:
    """Result of a run."""

    clearance: float = np.inf
    """Least distance of the robot from the post, by its measured joints, m."""
    direct: float = np.inf
    """The same on the straight line between the joint positions of the waypoints, m; negative where it would touch."""
    missed: float = 0.0
    """Largest distance of the hand from a waypoint, m."""
    moved: float = 0.0
    """Distance by which the post was moved, m."""

    def __str__(self) -> str:
        return (
            f"{1e3 * self.clearance:.1f} mm free at the nearest ({1e3 * self.direct:.1f} mm on the direct way), "
            f"waypoints missed by {1e3 * self.missed:.1f} mm at most, post moved by {1e3 * self.moved:.1f} mm"
        )


class Tour:
    """A robot's way through waypoints.

    Args:
        world: over a robot's link, or simulated, with the robot and the post.
    """

    def __init__(self, world: World) -> None:
        self._world, self._robot = world, world.robots["robot"]
        spec = self._robot.spec
        self._effector = spec.end_effectors[0]
        self._joints = self._robot.find_joints(*self._effector.arm_joints)
        self._planner = JointPlanner(world, self._robot, self._joints, PlannerConfig(margin=MARGIN))
        post_only = PlannerConfig(obstacles=("post",), self_collisions=False)
        self._post_distance = JointPlanner(world, self._robot, self._joints, post_only).clearances
        tree, limits = KinematicTree(spec.articulation), self._robot.position_limits
        self._ik = FullIk(tree, self._effector.frame, self._joints, limits, self._robot.home_positions)
        self._follower = TrajectoryFollower("follower", self._robot, self._joints, RATE)
        self._post = world.objects["post"].root_pose[0, :3].clone()
        self.report = Report()
        """Result up to now."""

    def run(self) -> Report:
        """Visit all waypoints in order."""
        opened = True
        for position, stays_open in WAYPOINTS:
            self._move_to(common.pointing_down(torch.tensor(position)[None])[0])
            if stays_open != opened:
                self._move_fingers(stays_open)
                opened = stays_open
        return self.report

    def _move_to(self, pose: Tensor) -> None:
        robot, joints, report = self._robot, self._joints, self.report
        solution = self._ik.solve(pose[None], robot.joint_positions)
        if not bool(solution.converged[0]):
            raise PlanningError(f"the hand cannot be brought to {pose[:3].tolist()}")
        here, goal = robot.joint_positions[0, joints], solution.positions[0]
        if float((goal - here).abs().max()) > 0.05:
            line = here + torch.linspace(0.0, 1.0, 100)[:, None] * (goal - here)
            report.direct = min(report.direct, float(self._post_distance(line).min()))
            path = self._planner.plan(goal)
            limits = self._limits()
            self._follower.reset()
            self._follower.load({0: time_optimal(path, *limits, dt=1.0 / RATE)})
            while not bool(self._follower.finished[0]):
                self._step()
        # The robot is a little later than its commands.
        for _ in range(round(0.5 * RATE)):
            self._step()
        away = robot.frame_pose(self._effector.frame)[0, :3] - pose[:3]
        report.missed = max(report.missed, float(away.norm()))

    def _move_fingers(self, opened: bool) -> None:
        gripper, spec = self._effector.gripper, self._robot.spec
        assert gripper is not None, f"{spec.articulation.name} has no hand"
        posture = gripper_positions(spec, gripper, gripper.open_position if opened else gripper.closed_position)
        joints = list(posture)
        begin = self._robot.joint_positions[0, joints].clone()
        end = torch.tensor([posture[joint] for joint in joints])
        steps = round(HAND_SECONDS * RATE)
        for step in range(1, steps + 1):
            # A smooth way, as a jump of the target would be held back by the limits
            share = 0.5 - 0.5 * float(np.cos(np.pi * step / steps))
            self._robot.set_position_targets((begin + share * (end - begin))[None], joints)
            self._step()

    def _step(self) -> None:
        robot, joints = self._robot, self._joints
        targets = self._follower.compute({})
        robot.set_position_targets(targets[JointTarget.POSITION], joints)
        robot.set_velocity_targets(targets[JointTarget.VELOCITY], joints)
        self._world.step(DECIMATION)
        report, post = self.report, self._world.objects["post"].root_pose[0, :3]
        report.clearance = min(report.clearance, float(self._post_distance(robot.joint_positions[:, joints])))
        report.moved = max(report.moved, float((post - self._post).norm()))

    def _limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Velocities and accelerations of the planned motions, (k,) each."""
        from orbit_deploy.description import RobotDescription

        described = RobotDescription.of(self._robot.spec)
        speeds, rates = (np.array(values)[self._joints] for values in (described.velocity, described.acceleration))
        return SHARE * speeds, SHARE * rates


def drive(robot: str, link: RobotLink) -> Report:
    """Drive the robot at the end of a link, which this closes."""
    world = robot_world(link, 1.0 / RATE)(scene(robot, falls=False), 1, torch.device("cpu"), 0)
    try:
        if link.description.arranges:
            world.reset()
        report = Tour(world).run()
        state, engine = link.state(), world.engine
        assert isinstance(engine, RobotEngine)
        print(report)
        print(
            f"{engine.times.overruns} of {engine.times.steps} steps late, {state.stops} stops, {state.clamped} "
            f"commands clamped, {state.limited} cycles held back; commands acknowledged after {link.round_trips}"
        )
        link.stop()
        link.finish_motion(2.0)
        return report
    finally:
        world.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="franka_panda", help="arm with a hand, of the catalogue")
    parser.add_argument("--bridge", help="address of a robot that is there; a simulated one is started if left out")
    parser.add_argument("--serve", action="store_true", help="only serve the simulated robot")
    parser.add_argument("--backend", default="mujoco", help="engine of the simulated robot")
    parser.add_argument("--port", type=int, default=5555, help="of --serve")
    arguments = parser.parse_args()
    if arguments.serve:
        serve(arguments.robot, arguments.backend, f"zmq://127.0.0.1:{arguments.port}")
        return
    prioritize()
    torch.set_num_threads(1)
    if arguments.bridge is not None:
        drive(arguments.robot, connect(arguments.bridge, 1.0 / RATE))
        return
    with served(arguments.robot, arguments.backend) as address:
        drive(arguments.robot, connect(address, 1.0 / RATE))


if __name__ == "__main__":
    main()
