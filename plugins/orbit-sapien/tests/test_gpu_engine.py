"""The GPU engine's book-keeping, with the CPU's PhysX behind a stand-in for SAPIEN's GPU system.

It shows that links, joints and queries are looked for in the right places of the buffers, and that writes are followed
by the calls that make them count. It shows nothing of PhysX on a GPU.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core.interfaces import ContactQuery, Engine, SceneLayout
from orbit_core.scene import (
    Articulation,
    Box,
    ContactSensorSpec,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    Plane,
    Pose,
    RobotSpec,
    Scene,
    Shape,
)
from orbit_sapien import gpu_engine, physx_gpu
from orbit_sapien.config import SapienConfig
from orbit_sapien.engine import SapienEngine
from orbit_sapien.gpu_engine import SapienGpuEngine
from orbit_sapien.native import NativePose, physx

NUM_ENVS = 3
CPU = torch.device("cpu")


class StandIn(physx.PhysxCpuSystem):
    """Buffers that hold what was fetched, and reach the CPU's bodies when applied."""

    def __init__(self, device: str) -> None:
        super().__init__()

    def gpu_init(self) -> None:
        # Links before free bodies, the last made first: no order that the engine could take for granted.
        self.links = list(self.articulation_link_components)[::-1]
        self.free = list(self.rigid_dynamic_components)[::-1]
        self.articulations = list(dict.fromkeys(link.articulation for link in self.links))
        self.rows = {body: row for row, body in enumerate((*self.links, *self.free))}
        width = 2 + max((each.dof for each in self.articulations), default=0)
        shape = len(self.articulations), width
        self.bodies = torch.zeros(len(self.rows), 13)
        self.q, self.v, self.f, self.tq, self.tv = (torch.zeros(shape) for _ in range(5))
        self.fetch()

    def __getattr__(self, name: str) -> Any:
        buffers = {
            "cuda_rigid_body_data": "bodies", "cuda_articulation_qpos": "q", "cuda_articulation_qvel": "v",
            "cuda_articulation_qf": "f", "cuda_articulation_target_qpos": "tq", "cuda_articulation_target_qvel": "tv",
        }  # fmt: skip
        if name in buffers:
            buffer = getattr(self, buffers[name])
            return SimpleNamespace(torch=lambda: buffer)
        if name.startswith("gpu_fetch"):
            return self.fetch
        if name in ("gpu_set_cuda_stream", "gpu_update_articulation_kinematics"):
            return lambda *_: None
        raise AttributeError(name)

    def fetch(self) -> None:
        for body, row in self.rows.items():
            pose = body.entity.pose
            values = (pose.p, pose.q, body.linear_velocity, body.angular_velocity)
            self.bodies[row] = torch.as_tensor(np.concatenate(values))
        for row, each in enumerate(self.articulations):
            self.q[row, : each.dof], self.v[row, : each.dof] = map(torch.as_tensor, (each.qpos, each.qvel))

    def gpu_apply_rigid_dynamic_data(self) -> None:
        for body in self.free:
            data = self.bodies[self.rows[body]].numpy()
            body.entity.set_pose(NativePose(data[:3], data[3:7]))
            body.set_linear_velocity(data[7:10])
            body.set_angular_velocity(data[10:])

    def each(self, write: Callable[[Any, int], None]) -> None:
        for row, articulation in enumerate(self.articulations):
            write(articulation, row)

    def root(self, articulation: Any) -> Any:
        return self.bodies[self.rows[articulation.links[0]]].numpy()

    def gpu_apply_articulation_root_pose(self) -> None:
        self.each(lambda a, _: a.set_root_pose(NativePose(self.root(a)[:3], self.root(a)[3:7])))

    def gpu_apply_articulation_root_velocity(self) -> None:
        self.each(lambda a, _: a.set_root_linear_velocity(self.root(a)[7:10]))
        self.each(lambda a, _: a.set_root_angular_velocity(self.root(a)[10:]))

    def gpu_apply_articulation_qpos(self) -> None:
        self.each(lambda a, row: a.set_qpos(self.q[row, : a.dof].numpy()))

    def gpu_apply_articulation_qvel(self) -> None:
        self.each(lambda a, row: a.set_qvel(self.v[row, : a.dof].numpy()))

    def gpu_apply_articulation_qf(self) -> None:
        self.each(lambda a, row: a.set_qf(self.f[row, : a.dof].numpy()))

    def gpu_apply_articulation_target_position(self) -> None:
        self.each(
            lambda a, row: [j.set_drive_target(float(t)) for j, t in zip(a.active_joints, self.tq[row], strict=False)]
        )

    def gpu_apply_articulation_target_velocity(self) -> None:
        self.each(
            lambda a, row: [
                j.set_drive_velocity_target(float(t)) for j, t in zip(a.active_joints, self.tv[row], strict=False)
            ]
        )

    def gpu_create_contact_body_impulse_query(self, bodies: list[Any]) -> Any:
        return SimpleNamespace(of=[(body, None) for body in bodies])

    def gpu_create_contact_pair_impulse_query(self, pairs: list[Any]) -> Any:
        return SimpleNamespace(of=pairs)

    def gpu_query_contact_body_impulses(self, query: Any) -> None:
        impulses = torch.zeros(len(query.of), 3)
        for contact in self.get_contacts():
            total = torch.as_tensor(sum(point.impulse for point in contact.points))
            for row, (body, other) in enumerate(query.of):
                for sign, (one, two) in ((1, contact.bodies), (-1, contact.bodies[::-1])):
                    if body == one and other in (None, two):
                        impulses[row] += sign * total
        query.cuda_impulses = SimpleNamespace(torch=lambda: impulses)

    gpu_query_contact_pair_impulses = gpu_query_contact_body_impulses


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Callable[[type[Engine]], Any]:
    """An engine of that class of the same scene."""
    made: list[Any] = []
    monkeypatch.setattr(physx_gpu, "enable", lambda: None)
    monkeypatch.setattr(gpu_engine.physx, "PhysxGpuSystem", StandIn)
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: SimpleNamespace(cuda_stream=0))
    index = property(lambda self: made[-1].rows[self])
    for kind in (physx.PhysxArticulationLinkComponent, physx.PhysxRigidDynamicComponent):
        monkeypatch.setattr(kind, "gpu_pose_index", index)
    monkeypatch.setattr(physx.PhysxArticulation, "gpu_index", property(lambda self: made[-1].articulations.index(self)))
    start = StandIn.gpu_init
    monkeypatch.setattr(StandIn, "gpu_init", lambda self: (start(self), made.append(self)))
    return lambda kind: kind(SceneLayout.of(scene()), NUM_ENVS, CPU, SapienConfig())


def scene() -> Scene:
    """A two-joint arm, a stool that nothing moves, and a cube that falls on the ground."""
    inertia = np.eye(3) * 0.02
    links = [Link(name, 1.0, (0.1, 0.0, 0.0), inertia) for name in ("base", "upper", "lower")]
    joints = [
        Joint(f"j{n}", JointType.REVOLUTE, parent, child, Pose((0.3 * n, 0, 0)), axis=(0, 1, 0), effort_limit=40.0)
        for n, (parent, child) in enumerate((("base", "upper"), ("upper", "lower")))
    ]
    drives = ImplicitPd(joints=(".*",), stiffness=60.0, damping=8.0)
    arm = RobotSpec(
        name="arm", articulation=Articulation("arm", tuple(links), tuple(joints)), pose=Pose((0, 0, 1.0)),
        fixed_base=True, actuators=(drives,), home={"j0": 0.2},
    )  # fmt: skip
    shape = Shape(Box((0.05, 0.05, 0.05)))
    bodies = {
        name: Articulation(name, (Link(name, 0.5, (0.0, 0.0, 0.01), np.eye(3) * 1e-3, (shape,)),))
        for name in ("stool", "cube")
    }
    return Scene(
        robots=(arm,),
        objects=(
            ObjectSpec(name="stool", articulation=bodies["stool"], pose=Pose((1.0, 0, 0.05)), fixed_base=True),
            ObjectSpec(name="cube", articulation=bodies["cube"], pose=Pose((0.5, 0.2, 0.08))),
        ),
        terrain=(Shape(Plane()),),
        sensors=(ContactSensorSpec(name="touch", entity="cube", filters=("terrain", "stool")),),
    )  # fmt: skip


def run(engine: Engine) -> dict[str, Tensor]:
    """What it comes to after targets, a push, a partial reset and a snapshot's return."""
    assert ContactQuery in {type(query) for query in engine.layout.contact_queries}
    engine.position_targets += torch.tensor([[0.3, -0.2], [0.0, 0.4], [-0.3, 0.1]])
    engine.efforts[1, 0] = 3.0
    engine.step(60)
    falling = torch.tensor([[0.4, -0.1, 0.3, 1.0, 0, 0, 0]])
    moving = torch.tensor([[0.2, 0.1, 0.0, 0.0, 0.0, 1.0]])
    engine.write_root_state(2, falling, moving, torch.tensor([2]))
    engine.reset(torch.tensor([0]))
    saved = engine.save_state()
    engine.step(50)
    engine.load_state(saved)
    engine.step(80)
    names = ("joint_positions", "joint_velocities", "joint_efforts", "link_poses", "link_velocities", "contact_forces")
    return {name: getattr(engine, name).clone() for name in names}


def test_the_gpu_engine_reads_and_writes_as_the_cpu_engine_does(make: Callable[[type[Engine]], Any]) -> None:
    expected, found = run(make(SapienEngine)), run(make(SapienGpuEngine))
    assert expected["contact_forces"][:, 0, 2].min() > 4.0, "the cubes rest on the ground"
    for name, values in expected.items():
        torch.testing.assert_close(found[name], values, atol=2e-3, rtol=2e-3, msg=lambda text, n=name: f"{n}: {text}")


def test_the_build_report_says_that_it_is_untested(make: Callable[[type[Engine]], Any]) -> None:
    assert any("no GPU has run" in line.got for line in make(SapienGpuEngine).build_report)
