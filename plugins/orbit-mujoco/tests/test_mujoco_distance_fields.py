"""Contact by signed distance fields: the lead of a screw, a ball on a ring, and who refuses such meshes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from orbit_assets.mass_properties import mass_properties
from orbit_assets.threads import Thread, bolt, nut
from orbit_core.backends import backend_names
from orbit_core.dynamics.transforms import yaw_angle
from orbit_core.interfaces import Capability, UnsupportedCapabilityError
from orbit_core.interfaces.errors import ArgumentError, AssetError
from orbit_core.scene import (
    Articulation,
    Link,
    Mesh,
    MeshCollision,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Scene,
    Shape,
    Sphere,
)
from orbit_core.world import simulate

BACKENDS = [name for name in ("mujoco", "warp") if name in backend_names()]
THREAD = Thread(lead=0.004)
CLEARANCE = 3e-4
SLIPPERY = PhysicsMaterial(0.01, 0.01)


def thing(name: str, mesh: Mesh, height: float = 0.0, *, fixed: bool = False) -> ObjectSpec:
    body = mass_properties(mesh, density=7800.0)
    link = Link(name, body.mass, body.center_of_mass, body.inertia, (Shape(mesh, material=SLIPPERY),))
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), fixed_base=fixed, pose=Pose((0, 0, height)))


def screw() -> Scene:
    parts = (
        thing("bolt", bolt(0.032, THREAD), fixed=True),
        thing("nut", nut(0.012, 0.013, THREAD, clearance=CLEARANCE), 0.016),
    )
    return Scene(objects=parts, terrain=(), physics_dt=0.001)


def test_a_nut_driven_by_a_torque_moves_down_its_bolt_by_the_lead_in_a_turn() -> None:
    world = simulate(screw(), num_envs=1, backend="mujoco")
    own = world.objects["nut"]
    heights, angles = [], []
    for _ in range(80):
        torque = min(max(-0.002 * (float(own.root_velocity[0, 5]) + 8.0), -0.02), 0.02)
        own.set_wrenches(torch.tensor([[[0.0, 0.0, 0.0, 0.0, 0.0, torque]]]))
        world.step(10)
        heights.append(float(own.root_pose[0, 2]))
        angles.append(float(yaw_angle(own.root_pose[0, 3:])))
    across = float(own.root_pose[0, :2].norm())
    world.close()
    settled = 20  # by then the nut lies on the flanks
    turns = float(np.ptp(np.unwrap(angles)[settled:])) / (2.0 * math.pi)
    assert turns > 0.8
    assert (heights[settled] - heights[-1]) / turns == pytest.approx(THREAD.lead, rel=0.03)
    assert across < CLEARANCE


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_ball_rests_on_the_rim_of_a_ring(backend: str) -> None:
    surface = trimesh.creation.annulus(0.05, 0.08, 0.04, sections=48)
    ring = thing("ring", Mesh(surface.vertices, surface.faces, MeshCollision.SIGNED_DISTANCE), fixed=True)
    radius = 0.055
    link = Link("ball", 0.3, (0.0, 0.0, 0.0), np.eye(3) * 0.4 * 0.3 * radius**2, (Shape(Sphere(radius)),))
    ball = ObjectSpec(name="ball", articulation=Articulation("ball", (link,)), pose=Pose((0.0, 0.0, 0.045)))
    world = simulate(Scene(objects=(ring, ball), terrain=()), num_envs=1, backend=backend)
    world.step(120)
    place = world.objects["ball"].root_pose[0, :3].tolist()
    world.close()
    assert place == pytest.approx((0.0, 0.0, 0.02 + math.sqrt(radius**2 - 0.05**2)), abs=1.5e-3)


def test_engines_without_fields_refuse_such_meshes() -> None:
    with pytest.raises(UnsupportedCapabilityError, match=rf"{Capability.SIGNED_DISTANCE_FIELDS.value}.*mujoco"):
        simulate(screw(), num_envs=1, backend="sapien")


def test_surfaces_that_are_open_and_threads_that_cannot_be_are_refused() -> None:
    whole = bolt(0.016)
    holed = replace(whole, faces=whole.faces[1:])
    with pytest.raises((ArgumentError, AssetError), match="not closed"):
        simulate(Scene(objects=(thing("bolt", holed),)), num_envs=1, backend="mujoco")
    with pytest.raises(AssetError, match="give one above zero"):
        nut(0.006, 0.013, clearance=0.0)
    with pytest.raises(AssetError, match="a length of two leads"):
        bolt(0.001)
