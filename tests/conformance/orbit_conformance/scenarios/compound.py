"""Joints of several degrees of freedom, as chains of simple ones with links between that have no mass."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch

from orbit_assets.joint_models import BALL, FLOATING, PLANAR, Freedom, compound
from orbit_conformance.bodies import G, scene
from orbit_conformance.scenario import FIRST_ORDER, SINGLE, Metric, Scenario, Trial
from orbit_core.dynamics.rigid_body import RigidBodyModel
from orbit_core.dynamics.transforms import quat_distance
from orbit_core.interfaces import Capability
from orbit_core.scene import Articulation, IdealPd, Joint, JointType, Link, Pose, RobotSpec

_LEVER, _MASS, _INERTIA, _TILT = 0.5, 2.0, 0.05, 0.5
_LIGHT = 0.1
"""Size of a body of 2 g, whose smallest moment of inertia is 5e-7 kg m^2."""
_POSTURE = (0.4, -0.5, 0.3, 0.6, -0.4, 0.7)


def _hung(
    name: str, freedoms: tuple[Freedom, ...], moments: tuple[float, float, float], size: float = 1.0
) -> RobotSpec:
    """A body of 2 kg, its centre half a metre below a compound joint; its lengths times ``size``, of one density."""
    joint = Joint(name, JointType.CONTINUOUS, "base", "bob")
    links, joints = compound(joint, freedoms)
    bob = Link("bob", _MASS * size**3, (0.0, 0.0, -_LEVER * size), np.diag(moments) * size**5)
    return RobotSpec(
        name=name,
        articulation=Articulation(name, (Link("base"), *links, bob), joints),
        fixed_base=True,
        pose=Pose((0.0, 0.0, 2.0)),
        actuators=(IdealPd(joints=(".*",)),),
    )


def _compound(trial: Trial) -> Mapping[str, float]:
    off, tilt = _conical_motion(trial)
    return {
        "accelerations": _accelerations(trial, 1.0),
        "light": _accelerations(trial, _LIGHT),
        "precession": off,
        "tilt": tilt,
    }


def _conical_motion(trial: Trial) -> tuple[float, float]:
    """A body on a ball joint, tilted, that turns about the vertical as one with it: ``omega^2 = g / (l cos(tilt))``.

    The torque of its weight turns its angular momentum: ``m g l sin = omega^2 sin cos (A - C)``, where the moments of
    inertia about the joint across and along its axis, A and C, differ by ``m l^2``. Returns the largest error of its
    angle and of its tilt in two turns.
    """
    omega = math.sqrt(G / (_LEVER * math.cos(_TILT)))
    world = trial.world(scene(_hung("ball", BALL, (_INERTIA, _INERTIA, _INERTIA)), terrain=()))
    robot = world.robots["ball"]
    # ``R = R_x(a) R_y(b) R_z(c)`` turns at omega about the vertical, where b = 0, by these rates.
    rates = [0.0, omega * math.sin(_TILT), omega * math.cos(_TILT)]
    start = torch.tensor([[_TILT, 0.0, 0.0]], device=world.device)
    robot.set_joint_state(start, torch.tensor([rates], device=world.device))
    off = tilted = 0.0
    curve = []
    for time in trial.advance(world, 4 * math.pi / omega):
        turned = robot.link_poses[0, -1, 3:].double().cpu()
        truth = Pose.from_axis_angle((0.0, 0.0, 1.0), omega * time) @ Pose.from_axis_angle((1.0, 0.0, 0.0), _TILT)
        off = max(off, float(quat_distance(turned, torch.tensor(truth.orientation, dtype=torch.float64))))
        _, x, y, _ = turned.tolist()
        upright = 1 - 2 * (x * x + y * y)
        tilted = max(tilted, abs(math.acos(upright) - _TILT))
        curve.append((time, math.acos(upright), _TILT))
    trial.trace("tilt of a body that precesses", "rad", *zip(*curve, strict=True))
    return off, tilted


def _accelerations(trial: Trial, size: float) -> float:
    """Largest error of accelerations from rest under efforts, against the mass matrix in double precision.

    Efforts are forces in proportion to the weight, and torques to the weight times the lever.
    """
    worst = 0.0
    for name, freedoms in (("ball", BALL), ("planar", PLANAR), ("floating", FLOATING), ("universal", BALL[1:])):
        robot = _hung(name, freedoms, (0.05, 0.08, 0.1), size)
        count = len(freedoms)
        posture = torch.tensor([_POSTURE[:count]], dtype=torch.float64)
        efforts = torch.tensor([[1.0, -2.0, 0.5, 0.8, -0.6, 0.4][:count]], dtype=torch.float64)
        prismatic = [freedom.type is JointType.PRISMATIC for freedom in freedoms]
        efforts *= torch.where(torch.tensor(prismatic), size**3, size**4)
        world = trial.world(scene(robot, terrain=()))
        thing = world.robots[name]
        thing.set_joint_state(posture.float().to(world.device), torch.zeros(1, count, device=world.device))
        thing.set_effort_targets(efforts.float().to(world.device))
        model = RigidBodyModel(robot.articulation, True, dtype=torch.float64)
        root = torch.tensor([[0.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
        poses = model.kinematics.forward(root, posture)
        push = (efforts - model.gravity_forces(poses))[..., None]
        truth = torch.linalg.solve(model.mass_matrix(poses), push)[0, :, 0]
        trial.step(world)
        measured = thing.joint_velocities[0].double().cpu() / trial.time_step
        worst = max(worst, float((measured - truth).norm() / truth.norm()))
    return worst


SCENARIOS = (
    Scenario(
        name="compound_joints",
        group="Joints",
        question="Do ball, planar and floating joints, made of simple ones with links without mass, move as one joint?",
        truth="omega^2 = g / (l cos(tilt)) of steady precession; M(q) a = tau - g(q)",
        source="Goldstein, Classical Mechanics, 3rd ed., section 5.7; Featherstone, Rigid Body Dynamics Algorithms, 6",
        judges=(Capability.MASSLESS_LINKS,),
        needs=(Capability.MASSLESS_LINKS,),
        run=_compound,
        metrics=(
            Metric(
                name="accelerations",
                unit="",
                tolerance=5e-4,
                meaning="largest error from rest under efforts, relative to the norm of all joints'",
                looser_because="engines of higher order take in how forces change within the step",
            ),
            Metric(
                name="light",
                unit="",
                tolerance=2e-5,
                meaning="the same error of a body of 2 g, a tenth as long, of the same density",
                looser_because=SINGLE,
            ),
            Metric(
                name="precession",
                unit="rad",
                tolerance=0.05,
                meaning="largest error of the orientation in two turns",
                looser_because=FIRST_ORDER,
            ),
            Metric(
                name="tilt",
                unit="rad",
                tolerance=0.02,
                meaning="largest error of the tilt in two turns",
                looser_because=FIRST_ORDER,
            ),
        ),
    ),
)
