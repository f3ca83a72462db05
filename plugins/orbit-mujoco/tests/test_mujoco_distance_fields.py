"""Contact by signed distance fields: a nut that screws itself down a bolt, and who refuses such meshes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_core.assets.inertia import mass_properties
from orbit_core.assets.threads import Thread, bolt, nut
from orbit_core.interfaces import Capability, UnsupportedCapabilityError
from orbit_core.interfaces.errors import ArgumentError, AssetError
from orbit_core.scene import Articulation, Link, Mesh, ObjectSpec, PhysicsMaterial, Pose, Scene, Shape
from orbit_core.world import simulate

THREAD = Thread()
SLIPPERY = PhysicsMaterial(0.01, 0.01)


def thing(name: str, mesh: Mesh, height: float = 0.0, *, fixed: bool = False) -> ObjectSpec:
    body = mass_properties(mesh, density=7800.0)
    link = Link(name, body.mass, body.center_of_mass, body.inertia, (Shape(mesh, material=SLIPPERY),))
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), fixed_base=fixed, pose=Pose((0, 0, height)))


def screw() -> Scene:
    parts = (thing("bolt", bolt(0.016), fixed=True), thing("nut", nut(0.006, 0.013), 0.008))
    return Scene(objects=parts, terrain=(), physics_dt=0.001)


def yaw(pose: torch.Tensor) -> float:
    w, x, y, z = (float(part) for part in pose[0, 3:])
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def test_a_nut_moves_down_its_bolt_by_the_lead_in_a_turn() -> None:
    world = simulate(screw(), num_envs=1, backend="mujoco")
    own = world.objects["nut"]
    rate = -12.0
    own.set_root_velocity(torch.tensor([[0.0, 0.0, rate * THREAD.lead / (2.0 * math.pi), 0.0, 0.0, rate]]))
    world.step(100)  # until the nut lies on the flanks
    height, angles = float(own.root_pose[0, 2]), [yaw(own.root_pose)]
    for _ in range(40):
        world.step(10)
        angles.append(yaw(own.root_pose))
    turns = float(np.unwrap(angles)[-1] - angles[0]) / (2.0 * math.pi)
    travel = float(own.root_pose[0, 2]) - height
    across = float(own.root_pose[0, :2].norm())
    world.close()
    print(turns, travel, across)
    assert turns < -0.5
    assert travel / turns == pytest.approx(THREAD.lead, rel=0.05)
    assert across < 2e-4


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
