"""Scenarios that bodies move as described: masses, inertias, axes, limits, armatures and sizes, by their effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from orbit_assets.objects import box, capsule, cylinder, mesh_object, sphere
from orbit_conformance.bodies import SMOOTH_GROUND, WEIGHTLESS, body, prism, scene, smooth_material
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.interfaces import Capability
from orbit_core.scene import Articulation, IdealPd, Joint, JointType, Link, ObjectSpec, Pose, RobotSpec

# Inertias and frames -------------------------------------------------------------------------------------------------

# Armature in kg m^2 that an actuator group gives a joint in the place of its own.
_MOTOR_ARMATURE = 0.05


def _skew_link(name: str, mass: float, number: int) -> Link:
    """A link whose centre of mass and principal axes lie askew, differently for each number."""
    axes = Pose.from_euler(0.3 + number, -0.5, 0.7 * number).rotation_matrix()
    inertia = axes @ np.diag([0.01, 0.015, 0.02]) @ axes.T * (1 + number)
    return Link(name, mass, (0.04, -0.03 * number, 0.05), inertia)


def _every_joint() -> RobotSpec:
    """A chain of a revolute, a prismatic, a continuous and a revolute joint, each with frames and an axis askew."""
    links = (body("base"), *(_skew_link(f"link{number}", 1.5 - 0.3 * number, number) for number in range(4)))
    types = (JointType.REVOLUTE, JointType.PRISMATIC, JointType.CONTINUOUS, JointType.REVOLUTE)
    joints = tuple(
        Joint(
            name,
            type_,
            links[number].name,
            links[number + 1].name,
            Pose.from_euler(0.2, 0.4 * number, -0.3, (0.15, 0.02 * number, 0.1)),
            # Frames on both sides of each joint, as URDF, MJCF and USD place them differently.
            Pose.from_euler(-0.1 * number, 0.3, 0.5, (0.01, -0.02, 0.03)),
            axis=(0.6, 0.0, 0.8) if number % 2 else (0.0, 0.8, -0.6),
            lower_limit=-math.inf if type_ is JointType.CONTINUOUS else -2.0,
            upper_limit=math.inf if type_ is JointType.CONTINUOUS else 2.0,
            armature=0.01 * number,
        )
        for number, (name, type_) in enumerate(zip(("turn", "slide", "spin", "tilt"), types, strict=True))
    )
    motors = (IdealPd(joints=("turn",), armature=_MOTOR_ARMATURE), IdealPd(joints=("slide", "spin", "tilt")))
    articulation = Articulation("every_joint", links, joints)
    return RobotSpec(name="every_joint", articulation=articulation, fixed_base=True, actuators=motors)


_POSTURES = ((0.0, 0.0, 0.0, 0.0), (0.7, -0.3, 1.9, -1.1), (-1.3, 0.5, -2.6, 0.8))
_EFFORTS = ((3.0, 20.0, 0.5, 0.4), (-2.0, 5.0, 1.0, -0.6), (1.0, -15.0, -0.8, 0.9))


def _equation_of_motion(trial: Trial) -> float:
    """Largest error of an acceleration from rest, relative to all four's, in three postures under other efforts."""
    robot = _every_joint()
    world = trial.world(scene(robot, terrain=()), len(_POSTURES))
    thing = world.robots["every_joint"]
    still = torch.zeros(len(_POSTURES), 4, device=world.device)
    thing.set_joint_state(torch.tensor(_POSTURES, device=world.device), still)
    thing.set_effort_targets(torch.tensor(_EFFORTS, device=world.device))
    # An actuator group's armature replaces the joint's own.
    armature = [_MOTOR_ARMATURE, *(joint.armature for joint in robot.articulation.joints[1:])]
    model = RigidBodyModel(robot.articulation, True, armature=armature)
    poses = thing.link_poses.cpu()
    # From rest there are no velocity-dependent forces.
    forces = torch.tensor(_EFFORTS) - model.gravity_forces(poses)
    truth = torch.linalg.solve(model.mass_matrix(poses), forces[..., None])[..., 0]
    trial.step(world)
    # One step from rest: velocity over time is the acceleration, to first order.
    measured = thing.joint_velocities.cpu() / trial.time_step
    return float(((measured - truth).norm(dim=-1) / truth.norm(dim=-1)).max())


# Limits --------------------------------------------------------------------------------------------------------------

# Inertia, damping and effort of each joint in SI units; the speed ends at two units a second.
_INERTIA, _DRAG, _PUSH = 0.5, 0.5, 1.0
_LIMITS = {"both": (-0.5, 0.8), "above": (-math.inf, 0.6), "below": (-0.7, math.inf)}


def _limited(name: str, joint: Joint) -> RobotSpec:
    """The joint between a fixed base and a carried body, with a motor."""
    links = (body("base"), body("carried", mass=_INERTIA, inertia=_INERTIA))
    return RobotSpec(
        name=name,
        articulation=Articulation(name, links, (joint,)),
        fixed_base=True,
        actuators=(IdealPd(joints=(".*",)),),
    )


def _limits(trial: Trial) -> tuple[float, float]:
    """Every joint is pushed up in one environment and down in the other, for 2 s.

    Returns the largest distance from the limit that should hold, and from where a joint that none holds should be.
    """
    robots = {
        f"{name}_{type_.value}": _limited(
            f"{name}_{type_.value}",
            Joint("joint", type_, "base", "carried", lower_limit=lower, upper_limit=upper, damping=_DRAG),
        )
        for name, (lower, upper) in _LIMITS.items()
        for type_ in (JointType.REVOLUTE, JointType.PRISMATIC)
    }
    world = trial.world(scene(*robots.values(), gravity=WEIGHTLESS, terrain=()), 2)
    for robot in world.robots.values():
        robot.set_effort_targets(torch.tensor([[_PUSH], [-_PUSH]], device=world.device))
    time = 2.0
    trial.step(world, trial.steps(time))
    rate = _DRAG / _INERTIA
    # Way of a pushed joint with viscous drag, from rest.
    free = _PUSH / _DRAG * (time - (1 - math.exp(-rate * time)) / rate)
    held = loose = 0.0
    for name, robot in robots.items():
        joint = robot.articulation.joints[0]
        for row, (limit, sign) in enumerate(((joint.upper_limit, 1.0), (joint.lower_limit, -1.0))):
            position = float(world.robots[name].joint_positions[row, 0])
            # A joint limited on one side only has to go on freely on the other.
            if math.isfinite(limit):
                held = max(held, abs(position - limit))
            else:
                loose = max(loose, abs(position - sign * free) / free)
    return held, loose


# Sizes ---------------------------------------------------------------------------------------------------------------


def _solids() -> dict[str, tuple[ObjectSpec, float]]:
    """Solids that stand or lie, with the height of their middle above what they stand on."""
    material = smooth_material(0.5)
    turns = {"z": Pose(), "x": Pose.from_euler(0.0, math.pi / 2, 0.0), "y": Pose.from_euler(math.pi / 2, 0.0, 0.0)}
    found: dict[str, tuple[ObjectSpec, float]] = {}

    def add(name: str, solid: ObjectSpec, turn: str, height: float) -> None:
        place = Pose((0.4 * len(found), 0.0, height)) @ turns[turn]
        found[name] = (replace(solid, name=name, pose=place), height)

    sizes = {"x": 0.12, "y": 0.08, "z": 0.2}
    for axis in sizes:
        add(f"box_{axis}", box("box", (0.12, 0.08, 0.2), mass=1.0, material=material), axis, sizes[axis] / 2)
    add("ball", sphere("ball", 0.06, mass=1.0, material=material), "z", 0.06)
    round_, long = 0.05, 0.16
    hull = mesh_object("hull", prism(6, round_, long), mass=1.0, material=material)
    pole = capsule("capsule", round_, long, mass=1.0, material=material)
    drum = cylinder("cylinder", round_, long, mass=1.0, material=material)
    for name, solid, standing, lying in (
        ("cylinder", drum, long / 2, round_),
        ("capsule", pole, long / 2 + round_, round_),
        # A prism lies on a side face, at the distance of the hexagon's sides.
        ("hull", hull, long / 2, round_ * math.sqrt(3) / 2),
    ):
        # Each solid along each of its axes: swapped or halved sizes change the height of one of them.
        add(f"{name}_standing", solid, "z", standing)
        add(f"{name}_lying", solid, "y", lying)
    return found


def _sizes(trial: Trial) -> float:
    """Largest change of a height within 0.1 s of solids that are put down where their sizes have them touch."""
    solids = _solids()
    world = trial.world(scene(*(solid for solid, _ in solids.values()), terrain=SMOOTH_GROUND))
    trial.step(world, trial.steps(0.1))
    # A wrong size makes a solid fall or be pushed out at once.
    return max(abs(float(world.objects[name].root_pose[0, 2]) - height) for name, (_, height) in solids.items())


def _as_described(trial: Trial) -> Mapping[str, float]:
    held, loose = _limits(trial)
    return {
        "acceleration": _equation_of_motion(trial),
        "limit": held,
        "beyond": loose,
        "height": _sizes(trial),
    }


SCENARIOS = (
    Scenario(
        name="as_described",
        group="Joints",
        question="Is what moves what was described: inertias, axes, armatures, limits on one side or both, and sizes?",
        truth="M(q) a = tau - g(q) of the description; limits hold and nothing else does; things rest at their sizes",
        source="Featherstone, Rigid Body Dynamics Algorithms, section 6.2 (composite rigid bodies)",
        run=_as_described,
        needs=(Capability.ARMATURE, Capability.JOINT_DAMPING),
        metrics=(
            Metric(
                name="acceleration",
                unit="",
                tolerance=1e-5,
                meaning="largest relative error of speeds gained in a step from rest, four joints in three postures",
                looser_because=SINGLE,
            ),
            Metric(
                name="limit",
                unit="",
                tolerance=1e-3,
                meaning="largest distance from the limit that a joint is pushed to, in rad or m",
                looser_because="a limit may give way by a milliradian under a push",
            ),
            Metric(
                name="beyond",
                unit="",
                tolerance=2e-3,
                looser_because=FIRST_ORDER,
                meaning="relative error of the way of a joint that is pushed to where it has no limit",
            ),
            Metric(
                name="height",
                unit="m",
                tolerance=5e-4,
                looser_because="contacts may give way by half a millimetre: a size that is misread is off by more",
                meaning="largest change of height of a box, a ball, a cylinder, a capsule or a hull put on the ground",
            ),
        ),
    ),
)
