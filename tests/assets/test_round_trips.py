"""Random articulations survive every file format, and an engine builds what the description says."""

from __future__ import annotations

import math
from dataclasses import astuple, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from orbit_assets.compose import sort_links
from orbit_assets.files import load_articulation
from orbit_assets.mjcf import read_mjcf, write_mjcf
from orbit_assets.urdf import read_urdf, write_urdf
from orbit_assets.usd import read_usd, write_usd
from orbit_core.interfaces import SceneLayout
from orbit_core.preparation.validation import validate
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    Cylinder,
    Frame,
    Geometry,
    Joint,
    JointType,
    Link,
    Mimic,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    Scene,
    Shape,
    Sphere,
)
from orbit_core.scene.pose import FloatArray, Vector3

TOLERANCE = 1e-5


# Random descriptions -------------------------------------------------------------------------------------------------


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False).map(lambda value: round(value, 4))


def vectors(size: float) -> st.SearchStrategy[Vector3]:
    return st.tuples(numbers(-size, size), numbers(-size, size), numbers(-size, size))


def poses(size: float = 0.5) -> st.SearchStrategy[Pose]:
    angle = numbers(-3.0, 3.0)
    return st.builds(lambda p, r, q, y: Pose.from_euler(r, q, y, p), vectors(size), angle, angle, angle)


SIZES = numbers(0.02, 0.3)
GEOMETRIES = st.one_of(
    st.builds(Box, st.tuples(SIZES, SIZES, SIZES)),
    st.builds(Sphere, SIZES),
    st.builds(Capsule, SIZES, SIZES),
    st.builds(Cylinder, SIZES, SIZES),
)


@st.composite
def inertias(draw: st.DrawFn) -> FloatArray:
    """Principal moments of a random box, about random axes."""
    a, b, c = (draw(SIZES) ** 2 for _ in range(3))
    axes = draw(poses()).rotation_matrix()
    return draw(numbers(0.1, 3.0)) * axes @ np.diag((b + c, a + c, a + b)) @ axes.T


@st.composite
def links(draw: st.DrawFn, name: str) -> Link:
    friction = draw(numbers(0.0, 1.5))
    material = PhysicsMaterial(friction, friction)
    shapes = tuple(
        Shape(draw(GEOMETRIES), draw(poses()), material, (0.2, 0.4, 0.6, 1.0), f"{name}_shape_{index}")
        for index in range(draw(st.integers(0, 2)))
    )
    return Link(name, draw(numbers(0.1, 5.0)), draw(vectors(0.2)), draw(inertias()), shapes, shapes)


@st.composite
def joints(draw: st.DrawFn, index: int, parent: str, child: str, child_frames: bool) -> Joint:
    name = f"joint_{index}"
    kind = draw(st.sampled_from(JointType))
    child_pose = draw(poses()) if child_frames else Pose()
    joint = Joint(name, kind, parent, child, draw(poses()), child_pose)
    if kind is JointType.FIXED:
        return joint
    direction = np.asarray(draw(vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.1)))
    axis = draw(st.sampled_from([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), tuple(direction / np.linalg.norm(direction))]))
    lower = draw(numbers(-1.5, 0.0))
    unlimited = kind is JointType.CONTINUOUS
    return replace(
        joint,
        axis=axis,
        lower_limit=-math.inf if unlimited else lower,
        upper_limit=math.inf if unlimited else lower + draw(numbers(0.1, 3.0)),
        effort_limit=draw(numbers(1.0, 100.0)),
        velocity_limit=draw(numbers(0.5, 10.0)),
        damping=draw(numbers(0.0, 2.0)),
        friction=draw(numbers(0.0, 2.0)),
        armature=draw(numbers(0.0, 0.5)),
    )


@st.composite
def articulations(draw: st.DrawFn, child_frames: bool = True) -> Articulation:
    """2 to 6 links in any tree; one joint may follow another of its kind."""
    names = [f"link_{index}" for index in range(draw(st.integers(2, 6)))]
    tree: list[Joint] = []
    for index, name in enumerate(names[1:], start=1):
        parent = names[draw(st.integers(0, index - 1))]
        joint = draw(joints(index, parent, name, child_frames))
        leaders = [other.name for other in tree if other.type is joint.type and other.movable and not other.mimic]
        if leaders and draw(st.booleans()):
            mimic = Mimic(draw(st.sampled_from(leaders)), draw(numbers(-2.0, 2.0)), draw(numbers(-0.5, 0.5)))
            joint = replace(joint, mimic=mimic)
        tree.append(joint)
    frames = (Frame("tool", names[-1], draw(poses())),)
    return Articulation("thing", tuple(draw(links(name)) for name in names), tuple(tree), frames)


# What must agree -----------------------------------------------------------------------------------------------------


def link_poses(articulation: Articulation, positions: dict[str, float]) -> dict[str, FloatArray]:
    """Forward kinematics: the pose (4, 4) of each link, and of each frame, in the root's frame."""
    found = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        q, axis = positions.get(joint.name, 0.0), np.asarray(joint.axis)
        if joint.type is JointType.PRISMATIC:
            x, y, z = (float(value) for value in q * axis)
            motion = Pose((x, y, z))
        else:
            motion = Pose.from_axis_angle(joint.axis, q) if joint.movable else Pose()
        found[joint.child] = found[joint.parent] @ joint.parent_pose @ motion @ joint.child_pose.inverse()
    found |= {frame.name: found[frame.link] @ frame.pose for frame in articulation.frames}
    return {name: pose.matrix() for name, pose in found.items()}


def assert_same_shapes(got: tuple[Shape, ...], asked: tuple[Shape, ...]) -> None:
    assert [type(shape.geometry) for shape in got] == [type(shape.geometry) for shape in asked]
    for one, other in zip(got, asked, strict=True):
        np.testing.assert_allclose(np.hstack(astuple(one.geometry)), np.hstack(astuple(other.geometry)), atol=TOLERANCE)
        np.testing.assert_allclose(one.pose.matrix(), other.pose.matrix(), atol=TOLERANCE)


def assert_same(got: Articulation, asked: Articulation, lost: tuple[str, ...] = ()) -> None:
    """The same machine, up to the choice of joint frames; ``lost`` names fields of joints that the format lacks."""
    assert got.link_names == asked.link_names
    for one, other in zip(got.links, asked.links, strict=True):
        assert one.mass == pytest.approx(other.mass, rel=TOLERANCE)
        np.testing.assert_allclose(one.center_of_mass, other.center_of_mass, atol=TOLERANCE)
        np.testing.assert_allclose(one.inertia, other.inertia, atol=TOLERANCE)
        assert_same_shapes(one.collisions, other.collisions)
        assert_same_shapes(one.visuals, other.visuals)
    assert got.joint_names == asked.joint_names
    for one, other in zip(got.movable_joints, asked.movable_joints, strict=True):
        assert (one.type, one.parent, one.child) == (other.type, other.parent, other.child)
        for name in {"lower_limit", "upper_limit", "effort_limit", "velocity_limit", "damping", "friction", "armature"}:
            if name not in lost:
                assert getattr(one, name) == pytest.approx(getattr(other, name), rel=TOLERANCE, abs=TOLERANCE), name
        assert (one.mimic is None) == (other.mimic is None)
        if one.mimic and other.mimic:
            assert one.mimic.joint == other.mimic.joint
            assert one.mimic.multiplier == pytest.approx(other.mimic.multiplier, abs=TOLERANCE)
            assert one.mimic.offset == pytest.approx(other.mimic.offset, abs=TOLERANCE)
    generator = np.random.default_rng(0)
    for _ in range(3):
        positions = {name: float(generator.uniform(-2.0, 2.0)) for name in asked.joint_names}
        moved = link_poses(got, positions)
        for name, matrix in link_poses(asked, positions).items():
            np.testing.assert_allclose(moved[name], matrix, atol=3 * TOLERANCE, err_msg=name)


# Text of other formats -----------------------------------------------------------------------------------------------


def text(*values: float) -> str:
    return quoteattr(" ".join(repr(float(value)) for value in values))


def urdf_origin(pose: Pose) -> str:
    m = pose.rotation_matrix()
    pitch = math.asin(max(-1.0, min(1.0, -m[2, 0])))
    roll, yaw = math.atan2(m[2, 1], m[2, 2]), math.atan2(m[1, 0], m[0, 0])
    return f"<origin xyz={text(*pose.position)} rpy={text(roll, pitch, yaw)}/>"


def urdf_geometry(geometry: Geometry) -> str:
    match geometry:
        case Box(half_extents=half):
            inner = f"<box size={text(*(2 * value for value in half))}/>"
        case Sphere(radius=radius):
            inner = f"<sphere radius={text(radius)}/>"
        case Capsule(radius=radius, half_length=half) | Cylinder(radius=radius, half_length=half):
            kind = type(geometry).__name__.lower()
            inner = f"<{kind} radius={text(radius)} length={text(2 * half)}/>"
        case _:
            raise AssertionError(geometry)
    return f"<geometry>{inner}</geometry>"


def urdf_link(link: Link) -> str:
    i = link.inertia
    moments = {"ixx": i[0, 0], "iyy": i[1, 1], "izz": i[2, 2], "ixy": i[0, 1], "ixz": i[0, 2], "iyz": i[1, 2]}
    inertia = " ".join(f"{name}={text(value)}" for name, value in moments.items())
    shapes = [
        f"<{role}>{urdf_origin(shape.pose)}{urdf_geometry(shape.geometry)}</{role}>"
        for role, group in (("collision", link.collisions), ("visual", link.visuals))
        for shape in group
    ]
    return (
        f'<link name="{link.name}"><inertial>{urdf_origin(Pose(link.center_of_mass))}<mass value={text(link.mass)}/>'
        f"<inertia {inertia}/></inertial>{''.join(shapes)}</link>"
    )


def urdf_joint(joint: Joint) -> str:
    inner = [
        urdf_origin(joint.parent_pose),
        f'<parent link="{joint.parent}"/><child link="{joint.child}"/><axis xyz={text(*joint.axis)}/>',
    ]
    if joint.movable:
        effort = f"effort={text(joint.effort_limit)} velocity={text(joint.velocity_limit)}"
        bounds = f"lower={text(joint.lower_limit)} upper={text(joint.upper_limit)} "
        inner.append(f"<limit {bounds if joint.type is not JointType.CONTINUOUS else ''}{effort}/>")
        inner.append(f"<dynamics damping={text(joint.damping)} friction={text(joint.friction)}/>")
    if (mimic := joint.mimic) is not None:
        coefficients = f"multiplier={text(mimic.multiplier)} offset={text(mimic.offset)}"
        inner.append(f'<mimic joint="{mimic.joint}" {coefficients}/>')
    return f'<joint name="{joint.name}" type="{joint.type.value}">{"".join(inner)}</joint>'


def urdf_text(articulation: Articulation) -> str:
    parts = [*map(urdf_link, articulation.links), *map(urdf_joint, articulation.joints)]
    return f'<robot name="{articulation.name}">{"".join(parts)}</robot>'


def mjcf_pose(pose: Pose) -> str:
    return f"pos={text(*pose.position)} quat={text(*pose.orientation)}"


def mjcf_geom(shape: Shape) -> str:
    geometry = shape.geometry
    size, friction = text(*np.hstack(astuple(geometry))), text(shape.material.static_friction, 0.005, 0.0001)
    return (
        f'<geom name="{shape.name}" type="{type(geometry).__name__.lower()}" size={size} '
        f"friction={friction} {mjcf_pose(shape.pose)}/>"
    )


def mjcf_joint(joint: Joint) -> str:
    limited = joint.type is not JointType.CONTINUOUS
    bounds = f"range={text(joint.lower_limit, joint.upper_limit)}" if limited else ""
    effort = f"actuatorfrcrange={text(-joint.effort_limit, joint.effort_limit)}"
    axis = joint.child_pose.rotation_matrix() @ np.asarray(joint.axis)
    return (
        f'<joint name="{joint.name}" type="{"slide" if joint.type is JointType.PRISMATIC else "hinge"}" '
        f'limited="{str(limited).lower()}" {bounds} {effort} pos={text(*joint.child_pose.position)} '
        f"axis={text(*axis)} damping={text(joint.damping)} frictionloss={text(joint.friction)} "
        f"armature={text(joint.armature)}/>"
    )


def mjcf_body(articulation: Articulation, link: Link, joint: Joint | None) -> str:
    i = link.inertia
    inertia = text(i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2])
    children = {other.child: other for other in articulation.joints if other.parent == link.name}
    pose = joint.parent_pose @ joint.child_pose.inverse() if joint else Pose()
    return "".join(
        [
            f'<body name="{link.name}" {mjcf_pose(pose)}>',
            mjcf_joint(joint) if joint and joint.movable else "",
            f"<inertial pos={text(*link.center_of_mass)} mass={text(link.mass)} fullinertia={inertia}/>",
            *map(mjcf_geom, link.collisions),
            *(
                f'<site name="{frame.name}" {mjcf_pose(frame.pose)}/>'
                for frame in articulation.frames
                if frame.link == link.name
            ),
            *(
                mjcf_body(articulation, other, children[other.name])
                for other in articulation.links
                if other.name in children
            ),
            "</body>",
        ]
    )


def mjcf_text(articulation: Articulation) -> str:
    couplings = "".join(
        f'<joint joint1="{joint.name}" joint2="{joint.mimic.joint}" '
        f"polycoef={text(joint.mimic.offset, joint.mimic.multiplier, 0, 0, 0)}/>"
        for joint in articulation.joints
        if joint.mimic
    )
    return (
        f'<mujoco model="{articulation.name}"><compiler angle="radian"/><worldbody>'
        f"{mjcf_body(articulation, articulation.root, None)}</worldbody><equality>{couplings}</equality></mujoco>"
    )


# Tests ---------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("round_trips")


@settings(max_examples=40, deadline=None)
@given(articulations(), st.booleans(), st.sampled_from(["usda", "usdc"]))
def test_usd(folder: Path, asked: Articulation, self_collisions: bool, suffix: str) -> None:
    asked = replace(
        asked, self_collisions=self_collisions, collision_exclusions=((asked.links[0].name, asked.links[-1].name),)
    )
    write_usd(asked, folder / f"thing.{suffix}")
    got = read_usd(folder / f"thing.{suffix}")
    assert_same(validate(got), asked)
    assert got.name == asked.name
    assert got.self_collisions == self_collisions
    assert got.collision_exclusions == asked.collision_exclusions
    assert [joint.name for joint in got.joints] == [joint.name for joint in asked.joints]
    for one, other in zip(got.links, asked.links, strict=True):
        for got_shape, asked_shape in zip(one.collisions, other.collisions, strict=True):
            friction = asked_shape.material.static_friction
            assert got_shape.material == replace(
                asked_shape.material,
                static_friction=pytest.approx(friction),
                dynamic_friction=pytest.approx(friction),
                torsional_friction=pytest.approx(0.005),
                rolling_friction=pytest.approx(0.0001),
            )
            assert got_shape.color == pytest.approx(asked_shape.color)
            assert got_shape.name == asked_shape.name


@settings(max_examples=40, deadline=None)
@given(articulations(child_frames=False))
def test_urdf(folder: Path, asked: Articulation) -> None:
    path = folder / "thing.urdf"
    path.write_text(urdf_text(asked))
    tool = asked.frames[0]
    got = replace(read_urdf(path), frames=(tool,))  # the format has no frames
    assert_same(validate(got), sort_links(asked), lost=("armature",))


@settings(max_examples=40, deadline=None)
@given(articulations())
def test_mjcf(folder: Path, asked: Articulation) -> None:
    path = folder / "thing.xml"
    path.write_text(mjcf_text(asked))
    assert_same(validate(read_mjcf(path)), sort_links(asked), lost=("velocity_limit",))


@settings(max_examples=10, deadline=None)
@given(articulations(), poses(), st.booleans())
def test_mujoco_builds_what_is_described(asked: Articulation, pose: Pose, fixed_base: bool) -> None:
    backend = pytest.importorskip("orbit_mujoco", reason="the backend orbit-mujoco is not installed")
    asked = without_limits_that_mimics_break(asked)
    home = {
        joint.name: 0.5 * (joint.lower_limit + joint.upper_limit)
        for joint in asked.movable_joints
        if joint.type is not JointType.CONTINUOUS and not joint.mimic
    }
    spec = ObjectSpec(name="thing", articulation=asked, pose=pose, fixed_base=fixed_base, home=home)
    layout = SceneLayout.of(Scene(objects=(spec,), terrain=()))
    config = backend.MujocoBackend.config_type()
    engine = backend.MujocoBackend().create_engine(layout, 2, torch.device("cpu"), config)
    engine.reset()
    positions = dict(zip(asked.joint_names, layout.joint_parameters.home, strict=True))
    expected = link_poses(asked, positions)
    for index, name in enumerate(asked.link_names):
        x, y, z, *quaternion = engine.link_poses[1, index].tolist()
        got = Pose((x, y, z), (quaternion[0], quaternion[1], quaternion[2], quaternion[3])).matrix()
        np.testing.assert_allclose(got, pose.matrix() @ expected[name], atol=3 * TOLERANCE, err_msg=name)
    model = engine.native[0]
    heavy = model.body_mass[model.body_mass > 0]
    np.testing.assert_allclose(np.sort(heavy), np.sort([link.mass for link in asked.links]), rtol=TOLERANCE)
    engine.close()


def without_limits_that_mimics_break(articulation: Articulation) -> Articulation:
    """A follower's own limits need not hold where its leader is; the home pose of a scene must lie within them."""
    free = {"lower_limit": -10.0, "upper_limit": 10.0}
    joints_ = tuple(
        replace(joint, **free) if joint.mimic and joint.type is not JointType.CONTINUOUS else joint
        for joint in articulation.joints
    )
    return replace(articulation, joints=joints_)


@pytest.mark.parametrize("number", [np.float32, np.float64, np.int64])
@pytest.mark.parametrize("suffix", ["usda", "urdf", "xml"])
def test_scene_data_may_hold_numpys_numbers(tmp_path: Path, suffix: str, number: type[np.number]) -> None:
    one, zero = number(1), number(0)
    pose = Pose((one, zero, one), (one, zero, zero, zero))  # pyright: ignore[reportArgumentType]
    shape = Shape(Capsule(one, one), pose, color=(one, zero, zero, one))  # pyright: ignore[reportArgumentType]
    box = Shape(Box((one, one, one)), pose)  # pyright: ignore[reportArgumentType]
    base = Link("base", one, (zero, zero, zero), np.eye(3), (box,), (shape,))  # pyright: ignore[reportArgumentType]
    limits = (-one, one, one, one, one)
    joint = Joint("j", JointType.REVOLUTE, "base", "arm", pose, pose, (zero, zero, one), *limits)  # pyright: ignore[reportArgumentType]
    written = Articulation("r", (base, replace(base, name="arm")), (joint,), (Frame("f", "base", pose),))
    path = tmp_path / f"r.{suffix}"
    WRITERS[suffix](written, path)
    assert "np." not in path.read_text()
    read = load_articulation(path, merge=False)
    assert read.joints[0].parent_pose == pose
    assert read.joints[0].upper_limit == pytest.approx(1.0)


def test_a_pose_of_arrays_is_a_pose_of_numbers() -> None:
    pose = Pose(np.array([1, 2, 3]), np.array([1, 0, 0, 0], np.float32))  # pyright: ignore[reportArgumentType]
    assert pose == Pose((1.0, 2.0, 3.0))
    assert hash(pose) == hash(Pose((1.0, 2.0, 3.0)))
    assert {type(value) for value in (*pose.position, *pose.orientation)} == {float}


WRITERS = {"usda": write_usd, "urdf": write_urdf, "xml": write_mjcf}
