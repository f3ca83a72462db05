"""What is in ORBIT's catalogue survives a walk through the formats, each written from what was read of the one before.

A format may place a link's frame elsewhere, as URDF does; so what is compared is what moves: masses, mass matrices, and
where centres of mass, colliding shapes and frames are, seen from the root, in random postures.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh.creation

from orbit_assets import load_articulation
from orbit_assets.audit.checks import FloatArray, Posture, mass_matrix, posture, shape_points
from orbit_assets.catalogue import robot
from orbit_assets.mjcf import write_mjcf
from orbit_assets.mjcf.writer import renamed_world
from orbit_assets.urdf import write_urdf
from orbit_assets.usd import write_usd
from orbit_core.objects import object_config, object_kinds
from orbit_core.preparation.merge import merge_fixed_links
from orbit_core.scene import Articulation, Joint

TOLERANCE = 1e-6
CHAIN = (("usda", write_usd), ("urdf", write_urdf), ("xml", write_mjcf))
OF_JOINTS = ("lower_limit", "upper_limit", "effort_limit", "velocity_limit", "damping", "friction")
NOT_IN_URDF = ("armature", "stiffness")


def places(articulation: Articulation, at: Posture) -> dict[str, FloatArray]:
    """Points (P, 3) from the root by name: centres of mass and bounds of colliding shapes; frames' origins."""
    found: dict[str, FloatArray] = {}
    for link in articulation.links:
        pose = at.links[link.name]
        # What has no mass has no centre of it.
        clouds = [np.asarray([link.center_of_mass])[: link.mass > 0], *map(shape_points, link.collisions)]
        moved = [cloud @ pose[:3, :3].T + pose[:3, 3] for cloud in clouds if len(cloud)]
        bounds = [np.stack([cloud.min(0), cloud.max(0)]) for cloud in moved]
        found[link.name] = np.concatenate([np.zeros((0, 3)), *bounds])
    return found | {name: pose[:3, 3] for name, pose in at.frames.items()}


def assert_same_machine(got: Articulation, asked: Articulation, lost: tuple[str, ...]) -> None:
    """All that both formats can say agrees."""
    assert got.link_names == asked.link_names
    assert got.joint_names == asked.joint_names
    for one, other in zip(got.links, asked.links, strict=True):
        assert one.mass == pytest.approx(other.mass, rel=TOLERANCE), one.name
    for one, other in zip(got.movable_joints, asked.movable_joints, strict=True):
        assert (one.type, one.parent, one.child) == (other.type, other.parent, other.child)
        for field in {*OF_JOINTS, *NOT_IN_URDF} - {*lost}:
            assert getattr(one, field) == pytest.approx(getattr(other, field), rel=TOLERANCE, abs=TOLERANCE), field
        assert (one.mimic is None) == (other.mimic is None)
        if one.mimic and other.mimic:
            assert one.mimic.joint == other.mimic.joint
            assert one.mimic.coefficients == pytest.approx(other.mimic.coefficients, abs=TOLERANCE)
    generator = np.random.default_rng(0)
    for _ in range(2):
        positions = {joint.name: random_position(joint, generator) for joint in asked.movable_joints}
        one, other = posture(got, positions), posture(asked, positions)
        assert places(got, one).keys() >= places(asked, other).keys()
        for name, points in places(asked, other).items():
            np.testing.assert_allclose(places(got, one)[name], points, atol=TOLERANCE, err_msg=name)
        matrix = mass_matrix(asked, other)
        np.testing.assert_allclose(
            mass_matrix(got, one), matrix, atol=TOLERANCE * max(1.0, float(matrix.max(initial=0)))
        )


def random_position(joint: Joint, generator: np.random.Generator) -> float:
    lower, upper = np.clip((joint.lower_limit, joint.upper_limit), -math.pi, math.pi)
    return float(generator.uniform(lower, upper))


def without_armature(articulation: Articulation) -> Articulation:
    return replace(articulation, joints=tuple(replace(joint, armature=0.0) for joint in articulation.joints))


def walk(asked: Articulation, folder: Path) -> None:
    """Through all formats of the chain, comparing with the beginning after each."""
    current = asked
    lost: tuple[str, ...] = ()
    for suffix, write in CHAIN:
        path = folder / f"thing.{suffix}"
        said = write(current, path)
        if suffix == "urdf":
            lost = (*lost, *NOT_IN_URDF)
            assert any("armature" in sentence for sentence in said or ()) == any(j.armature for j in asked.joints)
        elif suffix == "xml":
            lost = (*lost, "velocity_limit")
            asked, renamed = renamed_world(asked, fixed_base=True)
            assert {*renamed} <= {*said}
        current = merge_fixed_links(load_articulation(path, merge=False))
        assert_same_machine(
            without_armature(current) if lost else current, without_armature(asked) if lost else asked, lost
        )


ROBOTS = (
    "allegro_right", "ant", "anymal_c_kinova_gen3", "base_omni", "cartpole", "franka_panda", "humanoid", "jaco2",
    "shadow_hand", "tiago", "wsg50",
)  # fmt: skip
"""Of each source and kind one: all forty take minutes."""


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_survives_every_format(name: str, tmp_path: Path) -> None:
    walk(robot(name).articulation, tmp_path)


@pytest.mark.parametrize("kind", object_kinds().names)
def test_an_object_survives_every_format(kind: str, tmp_path: Path) -> None:
    parameters = {}
    if kind == "mesh":
        parameters["file"] = tmp_path / "ring.stl"
        trimesh.creation.torus(0.1, 0.03).export(parameters["file"])
    walk(object_config(kind, **parameters).build("thing").articulation, tmp_path)
