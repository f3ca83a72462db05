"""Descriptions that cannot be simulated are refused, naming the culprit; sound ones pass unchanged."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orbit_assets.compose import sort_links
from orbit_core.interfaces.errors import AssetError, UnknownNameError
from orbit_core.preparation.validation import validate, validate_entity
from orbit_core.scene import (
    Articulation,
    Box,
    DriveGains,
    EndEffector,
    Frame,
    Joint,
    JointType,
    Link,
    LoopJoint,
    LoopType,
    Mimic,
    ObjectSpec,
    PlanarBase,
    Pose,
    RobotSpec,
    Shape,
)

INERTIA = np.diag([0.01, 0.02, 0.02])


def link(name: str, **changes: Any) -> Link:
    return replace(Link(name, 1.0, inertia=INERTIA), **changes)


def joint(name: str, parent: str, child: str, **changes: Any) -> Joint:
    return replace(Joint(name, JointType.REVOLUTE, parent, child), **changes)


def chain(**changes: Any) -> Articulation:
    links = (link("base"), link("upper"), link("lower"))
    joints = (joint("shoulder", "base", "upper"), joint("elbow", "upper", "lower"))
    return replace(Articulation("arm", links, joints), **changes)


def with_joint(**changes: Any) -> Articulation:
    shoulder, elbow = chain().joints
    return chain(joints=(shoulder, replace(elbow, **changes)))


def with_link(**changes: Any) -> Articulation:
    base, upper, lower = chain().links
    return chain(links=(base, upper, replace(lower, **changes)))


def with_middle(**changes: Any) -> Articulation:
    """The link between the joints has no mass."""
    base, _, lower = chain().links
    return chain(links=(base, replace(Link("upper"), **changes), lower))


def test_a_home_just_beyond_its_limit_is_at_the_limit_with_a_note() -> None:
    limited = with_joint(lower_limit=-1.0, upper_limit=2.0)
    near = validate(replace(limited, home=(("elbow", -1.000013), ("shoulder", 0.0))))
    assert near.home == (("elbow", -1.0), ("shoulder", 0.0))
    assert near.notes == ("home positions just beyond their limits are at the limits: 'elbow' -1.000013 -> -1",)
    assert validate(near) is near
    assert validate(replace(limited, home=(("elbow", -1.1),))).home == (("elbow", -1.1),), "for scenes to refuse"


def test_a_link_without_mass_may_stand_between_joints_about_different_axes() -> None:
    shoulder, elbow = with_middle().joints
    articulation = replace(with_middle(), joints=(shoulder, replace(elbow, axis=(1.0, 0.0, 0.0))))
    assert validate(articulation) is articulation


def test_a_weld_that_is_turned_at_home_is_refused() -> None:
    quarter = Pose.from_axis_angle((0.0, 0.0, 1.0), 0.5)
    weld = LoopJoint("weld", "base", "lower", type=LoopType.WELD, orientation=quarter.orientation)
    arm = chain(loops=(weld,))
    with pytest.raises(AssetError, match=r"weld 'weld' is turned by 0\.5 rad"):
        validate_entity(ObjectSpec(name="arm", articulation=arm, fixed_base=True))
    validate_entity(ObjectSpec(name="arm", articulation=arm, fixed_base=True, home={"elbow": 0.5}))


def test_sound_articulation_is_returned_as_it_is() -> None:
    articulation = chain()
    assert validate(articulation) is articulation


def test_axes_get_unit_length() -> None:
    assert validate(with_joint(axis=(0.0, 3.0, 4.0))).joints[1].axis == pytest.approx((0.0, 0.6, 0.8))


@pytest.mark.parametrize(
    ("articulation", "message"),
    [
        (chain(links=()), "no link"),
        (chain(links=(link("base"), link("base"), link("lower"))), "'base'"),
        (chain(joints=(joint("j", "base", "upper"), joint("j", "upper", "lower"))), "two joints share the name 'j'"),
        (chain(frames=(Frame("upper", "base"),)), "share the name 'upper'"),
        (chain(frames=(Frame("tip", "nowhere"),)), "unknown link 'nowhere'"),
        (chain(collision_exclusions=(("base", "nowhere"),)), "unknown link 'nowhere'"),
        (with_joint(parent="nowhere"), "unknown parent link 'nowhere'"),
        (with_joint(child="nowhere"), "unknown child link 'nowhere'"),
        (chain(joints=chain().joints[:1]), "several roots, 'base', 'lower'"),
        (chain(joints=(joint("a", "lower", "upper"), joint("b", "upper", "lower"))), "cycle"),
        (chain(joints=(*chain().joints, joint("again", "base", "lower"))), "link 'lower' has two parents"),
        (chain(joints=chain().joints[::-1]), "sort_links"),
        (with_joint(axis=(0.0, 0.0, 0.0)), "axis of zero length"),
        (with_joint(axis=(0.0, math.nan, 0.0)), "axis.* is nan"),
        (with_joint(lower_limit=1.0, upper_limit=-1.0), "lower limit 1.0 above upper limit -1.0"),
        (with_joint(lower_limit=math.nan), "limit"),
        (with_joint(type=JointType.CONTINUOUS, upper_limit=2.0), "continuous and has limits, -inf to 2.0"),
        (with_joint(damping=-1.0), "damping is -1.0"),
        (with_joint(effort_limit=math.nan), "effort_limit is nan"),
        (with_joint(stiffness=-1.0), r"stiffness is -1\.0"),
        (with_joint(stiffness=math.inf), "stiffness is inf"),
        (with_joint(rest_position=math.nan), "rest_position is nan"),
        (with_joint(mimic=Mimic("shoulder", higher_powers=(1.0, 1.0, 1.0, 1.0))), "with 4 higher powers"),
        (with_joint(mimic=Mimic("shoulder", higher_powers=(math.nan,))), "higher_powers.* is nan"),
        (chain(drives=(DriveGains("knee"),)), "a drive is on 'knee'"),
        (chain(drives=(DriveGains("elbow", stiffness=-1.0),)), "stiffness -1.0"),
        (chain(drives=(DriveGains("elbow"), DriveGains("elbow"))), "two drives share the name 'elbow'"),
        (chain(home=(("knee", 0.0),)), "a home position is of 'knee'"),
        (chain(home=(("elbow", math.nan),)), "home.* is nan"),
        (chain(loops=(LoopJoint("l", "base", "lower", orientation=(2.0, 0.0, 0.0, 0.0)),)), "no unit quaternion"),
        (with_middle(inertia=INERTIA), "'upper' has an inertia but no mass"),
        (with_middle(collisions=(Shape(Box((0.1, 0.1, 0.1))),)), "'upper' collides but has no mass"),
        (with_middle(), "'shoulder', 'elbow' move link 'lower' in the same way"),
        (with_joint(mimic=Mimic("nowhere")), "does not exist"),
        (with_joint(mimic=Mimic("elbow")), "itself"),
        (with_link(mass=-1.0), "mass is -1.0"),
        (with_link(mass=math.nan), "mass is nan"),
        (with_link(mass=0.0), "'lower' moves but has no mass"),
        (with_link(inertia=np.diag([0.01, 0.02, -0.01])), "not all positive"),
        (with_link(inertia=np.diag([0.01, 0.02, 0.04])), "exceeds the sum"),
        (with_link(inertia=np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])), "not symmetric"),
        (with_link(inertia=np.full((3, 3), math.nan)), "inertia holds NaN"),
    ],
)
def test_faults_are_named(articulation: Articulation, message: str) -> None:
    with pytest.raises(AssetError, match=message) as caught:
        validate(articulation)
    assert str(caught.value).startswith("'arm'")


def test_mimic_of_fixed_or_mimicking_joint_is_refused() -> None:
    shoulder, elbow = chain().joints
    follower = replace(elbow, mimic=Mimic("shoulder"))
    validate(chain(joints=(shoulder, follower)))
    with pytest.raises(AssetError, match="which is fixed"):
        validate(chain(joints=(replace(shoulder, type=JointType.FIXED), follower)))
    three = chain(
        links=(*chain().links, link("hand")),
        joints=(shoulder, follower, joint("wrist", "lower", "hand", mimic=Mimic("elbow"))),
    )
    with pytest.raises(AssetError, match="itself mimics 'shoulder'"):
        validate(three)


def test_inertia_is_judged_per_rigid_body() -> None:
    odd_sensor = with_link(mass=0.01, inertia=np.diag([1e-6, 1e-6, 4e-6]))
    with pytest.raises(AssetError, match="'lower'"):
        validate(odd_sensor)
    shoulder, elbow = odd_sensor.joints
    validate(replace(odd_sensor, joints=(shoulder, replace(elbow, type=JointType.FIXED))))


def test_a_fixed_link_may_not_take_mass_away() -> None:
    shoulder, elbow = chain().joints
    fixed = replace(elbow, type=JointType.FIXED)
    with pytest.raises(AssetError, match=r"links\['lower'\]\.mass is -0"):
        validate(replace(with_link(mass=-0.5), joints=(shoulder, fixed)))


def test_sort_links_is_depth_first_and_keeps_the_given_order_of_children() -> None:
    names = ("right", "base", "tip", "left")
    joints = (joint("c", "left", "tip"), joint("a", "base", "right"), joint("b", "base", "left"))
    ordered = sort_links(Articulation("tree", tuple(link(name) for name in names), joints))
    assert ordered.link_names == ("base", "right", "left", "tip")
    assert [joint.child for joint in ordered.joints] == ["right", "left", "tip"]
    validate(ordered)


def test_a_free_root_needs_mass() -> None:
    base, *others = chain().links
    articulation = chain(links=(replace(base, mass=0.0), *others))
    validate_entity(ObjectSpec(name="thing", articulation=articulation, fixed_base=True))
    with pytest.raises(AssetError, match="fixed_base=True"):
        validate_entity(ObjectSpec(name="thing", articulation=articulation))


def triangle(**changes: Any) -> Articulation:
    """Two bars of 1 m that hang on the base 1 m apart and meet at their ends when they lean by 60 degrees."""
    joints = (
        joint("left", "base", "upper", lower_limit=-2.0, upper_limit=2.0),
        joint("right", "base", "lower", lower_limit=-2.0, upper_limit=2.5, parent_pose=Pose((1.0, 0.0, 0.0))),
    )
    loop = LoopJoint("apex", "upper", "lower", (1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    return chain(joints=joints, loops=(replace(loop, **changes),))


def test_a_loop_is_closed_at_home() -> None:
    closed = {"left": math.pi / 3, "right": 2 * math.pi / 3}
    validate_entity(ObjectSpec(name="triangle", articulation=triangle(), home=closed))
    with pytest.raises(AssetError, match=r"loop 'apex' is 1 m open"):
        validate_entity(ObjectSpec(name="triangle", articulation=triangle()))


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"second": "nothing"}, "unknown link 'nothing'"),
        ({"second": "upper"}, "to itself"),
        ({"first_point": (math.nan, 0.0, 0.0)}, "first_point.* is nan"),
        ({"name": "left"}, "share the name 'left'"),
    ],
)
def test_impossible_loops(change: dict[str, Any], fault: str) -> None:
    with pytest.raises(AssetError, match=fault):
        validate(triangle(**change))


@pytest.mark.parametrize(
    ("parts", "fault"),
    [
        ({"end_effectors": (EndEffector("uper", ()),)}, r"effector frame 'uper' in robot 'arm': did you mean 'upper'"),
        ({"end_effectors": (EndEffector("upper", (), finger_tips=("tip",)),)}, r"unknown finger tip frame 'tip'"),
        ({"end_effectors": (EndEffector("upper", ("sholder",)),)}, r"unknown joint 'sholder' in arm of robot 'arm'"),
        ({"feet": ("foot",)}, r"unknown foot frame 'foot' in robot 'arm'"),
        ({"wheels": ("left_wheel",)}, r"unknown wheel frame 'left_wheel' in robot 'arm'"),
        ({"planar_base": PlanarBase("shoulder", "y", "yaw")}, r"unknown joint 'y' in planar base of robot 'arm'"),
    ],
)
def test_a_robots_end_effectors_feet_and_wheels_are_places_of_its_own(parts: dict[str, Any], fault: str) -> None:
    validate_entity(RobotSpec(name="arm", articulation=chain(), fixed_base=True))
    with pytest.raises(UnknownNameError, match=fault):
        validate_entity(RobotSpec(name="arm", articulation=chain(), fixed_base=True, **parts))
