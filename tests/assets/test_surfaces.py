"""No shape with sizes, points or colours that cannot be reaches an engine, from a file or from Python."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orbit_assets.objects import box
from orbit_core.interfaces import ArgumentError, AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Compliance,
    Cylinder,
    HeightField,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    PhysicsMaterial,
    Pose,
    Scene,
    Shape,
    Sphere,
)
from orbit_core.world import simulate

NAN, INF = float("nan"), float("inf")
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
FLAT = POINTS * (1.0, 1.0, 0.0)


def mesh(vertices: Any = POINTS, faces: Any = FACES, **options: Any) -> Mesh:
    return Mesh(np.asarray(vertices), np.asarray(faces), **options)


def body(shape: Shape, *, drawn_only: bool = False) -> Articulation:
    link = Link("hand", 1.0, inertia=np.eye(3), collisions=() if drawn_only else (shape,), visuals=(shape,))
    return Articulation("arm", (link,))


BAD = [
    (Shape(Box((0.1, 0.0, 0.1))), r"half_extents is 0\.0"),
    (Shape(Box((0.1, INF, 0.1))), "half_extents is inf"),
    (Shape(Sphere(-0.1)), r"radius is -0\.1"),
    (Shape(Sphere(NAN)), "radius is nan"),
    (Shape(Cylinder(0.1, 0.0)), r"half_length is 0\.0"),
    (Shape(Capsule(0.1, -0.1)), r"half_length is -0\.1"),
    (Shape(Box((1, 1, 1)), Pose((0.0, 0.0, NAN))), "position.* is nan"),
    (Shape(Box((1, 1, 1)), Pose((0.0, 0.0, INF))), "position is inf"),
    (Shape(Box((1, 1, 1)), Pose(orientation=(0.0, 0.0, 0.0, 0.0))), "orientation is"),
    (Shape(Box((1, 1, 1)), color=(0.5, NAN, 0.5, 1.0)), "color.* is nan"),
    (Shape(Box((1, 1, 1)), color=(0.5, -0.1, 0.5, 1.0)), r"color is -0\.1"),
    (Shape(Box((1, 1, 1)), material=PhysicsMaterial(static_friction=-1.0)), r"static_friction is -1\.0"),
    (Shape(Box((1, 1, 1)), material=PhysicsMaterial(compliance=Compliance(NAN, 1.0))), "stiffness is nan"),
    (Shape(Box((1, 1, 1)), material=PhysicsMaterial(compliance=Compliance(1.0, -1.0))), r"damping is -1\.0"),
    (Shape(mesh(POINTS * NAN)), "vertices holds NaN"),
    (Shape(mesh(POINTS * (1, 1, INF))), "not finite|NaN"),
    (Shape(mesh(POINTS * 1e9)), "beyond 1e[+]06 m"),
    (Shape(mesh(faces=[[0, 1, 4]])), "triangle of vertex 4, and vertices 0 to 3"),
    (Shape(mesh(faces=[[0, 1, -1]])), "triangle of vertex -1"),
    (Shape(mesh(faces=np.zeros((0, 3), int))), "0 triangles: give it a surface"),
    (Shape(mesh(faces=[[0, 1, 2, 3]])), r"shape \(1, 4\)"),
    (Shape(mesh(FLAT)), "convex hull has no volume"),
    (Shape(mesh(POINTS * (1, 0, 0))), "on one line"),
    (Shape(mesh(POINTS * 0.0)), "on one line"),
    (Shape(HeightField(np.zeros((1, 5)), (1.0, 1.0))), "two rows"),
    (Shape(HeightField(np.full((3, 3), INF), (1.0, 1.0))), "not finite"),
    (Shape(HeightField(np.zeros((3, 3)), (1.0, 0.0))), "size is"),
]  # fmt: skip


@pytest.mark.parametrize(("shape", "message"), BAD)
def test_shapes_that_cannot_be_are_refused_by_name(shape: Shape, message: str) -> None:
    with pytest.raises(AssetError, match=rf"'arm'\.links\['hand'\].*({message})"):
        validate(body(shape))
    with pytest.raises(ArgumentError, match=message):
        simulate(Scene(objects=(replace(box("thing", (1, 1, 1)), articulation=body(shape)),)), 1, "mujoco")


def test_flat_meshes_may_be_drawn_or_collide_as_triangles() -> None:
    validate(body(Shape(mesh(FLAT)), drawn_only=True))
    validate(body(Shape(mesh(FLAT, collision=MeshCollision.TRIANGLES))))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"damping": INF}, "damping is inf"),
        ({"friction": NAN}, "friction is nan"),
        ({"armature": -1.0}, "armature is -1"),
        ({"lower_limit": INF, "upper_limit": INF}, "limits is"),
        ({"axis": (INF, 0.0, 0.0)}, "axis is inf"),
        ({"parent_pose": Pose((INF, 0.0, 0.0))}, "parent_pose.position is inf"),
        ({"effort_limit": -1.0}, "effort_limit is -1"),
    ],
)
def test_joints_numbers_are_finite_and_not_negative(change: dict[str, Any], message: str) -> None:
    links = tuple(Link(name, 1.0, inertia=np.eye(3)) for name in ("base", "hand"))
    joint = replace(Joint("wrist", JointType.REVOLUTE, "base", "hand"), **change)
    with pytest.raises(AssetError, match=rf"'arm'\.joints\['wrist'\].*({message})"):
        validate(Articulation("arm", links, (joint,)))
