"""Random trees of links, and the same tree in MuJoCo as the reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
import torch

from orbit_core.scene import Articulation, Joint, JointType, Link, Pose


@dataclass
class Reference:
    """An articulation in MuJoCo, with one state of it in ORBIT's order and axes."""

    articulation: Articulation
    model: mujoco.MjModel
    data: mujoco.MjData
    floating: bool

    def set_random_state(self, rng: np.random.Generator) -> None:
        self.data.qpos[:] = rng.uniform(-1.0, 1.0, self.model.nq)
        self.data.qvel[:] = rng.uniform(-2.0, 2.0, self.model.nv)
        if self.floating:
            self.data.qpos[3:7] = _random_quaternion(rng)
        mujoco.mj_forward(self.model, self.data)

    @property
    def bodies(self) -> list[int]:
        """MuJoCo's body of each link; it numbers bodies depth first."""
        return [self.model.body(name).id for name in self.articulation.link_names]

    @property
    def dofs(self) -> list[int]:
        """MuJoCo's degree of freedom of each of ORBIT's, the floating base's first."""
        joints = [int(self.model.joint(name).dofadr[0]) for name in self.articulation.joint_names]
        return [*range(6 if self.floating else 0), *joints]

    @property
    def root_pose(self) -> torch.Tensor:
        return self.link_poses[:, 0]

    @property
    def link_poses(self) -> torch.Tensor:
        poses = np.concatenate((self.data.xpos[self.bodies], self.data.xquat[self.bodies]), -1)
        return torch.tensor(poses, dtype=torch.float32)[None]

    @property
    def link_velocities(self) -> torch.Tensor:
        velocities = []
        for body in self.bodies:
            angular_linear = np.zeros(6)
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, body, angular_linear, 0)
            velocities.append(np.concatenate((angular_linear[3:], angular_linear[:3])))
        return torch.tensor(np.stack(velocities), dtype=torch.float32)[None]

    @property
    def joint_positions(self) -> torch.Tensor:
        addresses = [int(self.model.joint(name).qposadr[0]) for name in self.articulation.joint_names]
        return torch.tensor(self.data.qpos[addresses], dtype=torch.float32)[None]

    @property
    def joint_velocities(self) -> torch.Tensor:
        return torch.tensor(self.data.qvel[self.dofs[6 if self.floating else 0 :]], dtype=torch.float32)[None]

    @property
    def from_native(self) -> np.ndarray:
        """(D, nv): ORBIT's generalized velocity from MuJoCo's, whose free joint turns about the body's axes."""
        matrix = np.eye(self.model.nv)
        if self.floating:
            matrix[3:6, 3:6] = self.data.xmat[self.bodies[0]].reshape(3, 3)
        return matrix[self.dofs]

    def mass_matrix(self) -> np.ndarray:
        native = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, native)
        return self.from_native @ native @ self.from_native.T

    def bias_forces(self) -> np.ndarray:
        return self.from_native @ self.data.qfrc_bias

    def jacobian(self, link: int) -> np.ndarray:
        linear, angular = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jacBody(self.model, self.data, linear, angular, self.bodies[link])
        return np.concatenate((linear, angular)) @ self.from_native.T


def _build(articulation: Articulation, floating: bool) -> Reference:
    spec = mujoco.MjSpec()
    spec.compiler.boundmass = 0.0
    spec.compiler.balanceinertia = False
    bodies: dict[str, mujoco.MjsBody] = {}
    joint_of = {joint.child: joint for joint in articulation.joints}
    for link in articulation.links:
        joint = joint_of.get(link.name)
        parent = spec.worldbody if joint is None else bodies[joint.parent]
        pose = Pose() if joint is None else joint.parent_pose @ joint.child_pose.inverse()
        body = parent.add_body(name=link.name, pos=pose.position, quat=pose.orientation)
        body.mass, body.ipos, body.explicitinertial = link.mass, link.center_of_mass, True
        i = link.inertia
        body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
        bodies[link.name] = body
        if joint is None:
            if floating:
                body.add_freejoint()
        elif joint.movable:
            slide = joint.type is JointType.PRISMATIC
            body.add_joint(
                name=joint.name,
                type=mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE,
                pos=joint.child_pose.position,
                axis=joint.child_pose.rotation_matrix() @ np.asarray(joint.axis),
                armature=joint.armature,
            )
    model = spec.compile()
    return Reference(articulation, model, mujoco.MjData(model), floating)


def _random_tree(seed: int) -> Articulation:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    links = tuple(_random_link(f"link{i}", rng) for i in range(count))
    joints = tuple(_random_joint(i, int(rng.integers(0, i)), rng) for i in range(1, count))
    return Articulation(f"tree{seed}", links, joints)


def _random_link(name: str, rng: np.random.Generator) -> Link:
    mass = float(rng.uniform(0.2, 3.0))
    points = rng.normal(size=(6, 3)) * 0.2
    covariance = points.T @ points / 6
    inertia = mass * (np.trace(covariance) * np.eye(3) - covariance)
    return Link(name, mass, tuple(rng.uniform(-0.3, 0.3, 3)), inertia)


def _random_joint(child: int, parent: int, rng: np.random.Generator) -> Joint:
    kind = rng.choice(np.array([JointType.REVOLUTE, JointType.CONTINUOUS, JointType.PRISMATIC, JointType.FIXED]))
    axis = rng.normal(size=3)
    x, y, z = (float(value) for value in axis / np.linalg.norm(axis))
    poses = [Pose(tuple(rng.uniform(-0.4, 0.4, 3)), _random_quaternion(rng)) for _ in range(2)]
    return Joint(
        f"joint{child}", kind, f"link{parent}", f"link{child}", *poses, (x, y, z), armature=float(rng.uniform(0.0, 0.1))
    )


def _random_quaternion(rng: np.random.Generator) -> tuple[float, float, float, float]:
    q = rng.normal(size=4)
    w, x, y, z = (float(value) for value in q / np.linalg.norm(q))
    return (w, x, y, z)


@pytest.fixture(scope="session")
def build_reference() -> Callable[[Articulation, bool], Reference]:
    """(articulation, floating base) -> the same in MuJoCo."""
    return _build


@pytest.fixture(scope="session")
def random_tree() -> Callable[[int], Articulation]:
    """seed -> a tree of one to seven links with joints of every type."""
    return _random_tree
