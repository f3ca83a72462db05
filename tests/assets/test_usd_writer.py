"""What a description says beyond bodies and joints comes back from USD."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from orbit_assets.usd import read_usd, write_usd
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    DriveGains,
    Joint,
    JointType,
    Link,
    LoopJoint,
    LoopType,
    Mimic,
    Pose,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import canonical


def solid(name: str, *shapes: Shape) -> Link:
    return Link(name, 1.0, inertia=np.eye(3), collisions=shapes, visuals=shapes)


SLANT = canonical((0.5, 0.1, -0.7, 0.3))
MACHINE = Articulation(
    "machine",
    (solid("a"), solid("b"), solid("c"), solid("d")),
    (
        Joint(
            "turn", JointType.REVOLUTE, "a", "b", Pose((0.0, 0.0, 0.5)), axis=(0.0, 0.6, 0.8), lower_limit=-1.0,
            upper_limit=2.0, effort_limit=20.0, stiffness=7.0, rest_position=0.25,
        ),
        Joint(
            "slide", JointType.PRISMATIC, "b", "c", axis=(1.0, 0.0, 0.0), lower_limit=0.0, upper_limit=1.0,
            stiffness=300.0, rest_position=-0.1,
        ),
        Joint(
            "follow", JointType.PRISMATIC, "c", "d", axis=(0.0, 1.0, 0.0), lower_limit=-9.0, upper_limit=9.0,
            mimic=Mimic("turn", 0.5, 0.1, (0.25, -0.125)),
        ),
    ),
    loops=(
        LoopJoint("pin", "a", "d", (0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
        LoopJoint("glue", "b", "d", (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), LoopType.WELD, SLANT),
    ),
    drives=(DriveGains("turn", 100.0, 5.0, 20.0), DriveGains("slide", 1000.0, 50.0)),
    home=(("turn", 0.75), ("slide", 0.5)),
)  # fmt: skip


def test_springs_drives_loops_and_home_survive(tmp_path: Path) -> None:
    assert write_usd(MACHINE, tmp_path / "machine.usdc") == ()
    got = validate(read_usd(tmp_path / "machine.usdc"))
    assert got.notes == ()
    for one, asked in zip(got.joints, MACHINE.joints, strict=True):
        assert (one.stiffness, one.rest_position) == (
            pytest.approx(asked.stiffness),
            pytest.approx(asked.rest_position),
        )
    mimic = got.joints[2].mimic
    assert mimic is not None
    assert mimic.coefficients == pytest.approx((0.1, 0.5, 0.25, -0.125), rel=1e-6)
    for drive, wanted in zip(got.drives, MACHINE.drives, strict=True):
        assert (drive.joint, drive.effort_limit) == (wanted.joint, wanted.effort_limit)
        assert (drive.stiffness, drive.damping) == (pytest.approx(wanted.stiffness), pytest.approx(wanted.damping))
    assert dict(got.home) == {"turn": pytest.approx(0.75, abs=1e-6), "slide": pytest.approx(0.5, abs=1e-6)}
    for loop, wanted in zip(got.loops, MACHINE.loops, strict=True):
        assert (loop.name, loop.first, loop.second, loop.type) == (
            wanted.name,
            wanted.first,
            wanted.second,
            wanted.type,
        )
        np.testing.assert_allclose(
            (loop.first_point, loop.second_point), (wanted.first_point, wanted.second_point), atol=1e-6
        )
        np.testing.assert_allclose(loop.orientation, wanted.orientation, atol=1e-6)


def test_shapes_keep_their_order_and_their_want_of_a_name(tmp_path: Path) -> None:
    ball, box, egg = (
        Shape(Sphere(0.1)),
        Shape(Box((0.1, 0.2, 0.3)), name="box"),
        Shape(Sphere(0.2), color=(1, 0, 0, 1)),
    )
    for collisions, visuals in (
        ((ball, box), (egg, ball)),
        ((ball, box), (box, egg, ball)),
        ((ball, ball), (egg, ball)),
    ):
        link = Link("a", 1.0, inertia=np.eye(3), collisions=collisions, visuals=visuals)
        write_usd(Articulation("a", (link,)), tmp_path / "a.usda")
        got = read_usd(tmp_path / "a.usda").root
        for shapes, asked in ((got.collisions, collisions), (got.visuals, visuals)):
            assert [type(shape.geometry) for shape in shapes] == [type(shape.geometry) for shape in asked]
            assert [shape.name for shape in shapes] == [shape.name for shape in asked]


def test_what_usd_cannot_hold_is_told(tmp_path: Path) -> None:
    joint = Joint("j", JointType.REVOLUTE, "a", "b", lower_limit=0.0, upper_limit=1.0, effort_limit=5.0)
    drives = (DriveGains("j", 1.0, 1.0, 9.0),)
    hinge = Articulation("hinge", (solid("a"), solid("b")), (joint,), drives=drives)
    (told,) = write_usd(hinge, tmp_path / "hinge.usda")
    assert "one effort limit" in told
    assert "'j'" in told
    assert math.isclose(read_usd(tmp_path / "hinge.usda").drives[0].effort_limit, 5.0)
