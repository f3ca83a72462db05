"""MJCF files: the engine's own kinematics are the truth."""

from __future__ import annotations

import math
import sys
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbit_assets.mjcf import read_mjcf
from orbit_assets.options import ReadOptions, Unsupported
from orbit_core.interfaces.errors import AssetError
from orbit_core.preparation.validation import validate
from orbit_core.scene import Articulation, Box, JointType, Mesh, Pose, Sphere


def package_folder(name: str) -> Path:
    spec = find_spec(name)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0])


GYMNASIUM = package_folder("gymnasium") / "envs" / "mujoco" / "assets"
GYMNASIUM_MODELS = [
    GYMNASIUM / f"{name}.xml" for name in ("ant", "half_cheetah", "hopper", "humanoid", "pusher_v5", "reacher")
]
DROP = ReadOptions(unsupported=Unsupported.DROP)
HAND = package_folder("gymnasium_robotics") / "envs" / "assets" / "hand" / "reach.xml"


def write(tmp_path: Path, worldbody: str, rest: str = "") -> Path:
    path = tmp_path / "model.xml"
    path.write_text(f'<mujoco><compiler angle="radian"/><worldbody>{worldbody}</worldbody>{rest}</mujoco>')
    return path


def link_poses(articulation: Articulation, positions: dict[str, float]) -> dict[str, np.ndarray]:
    found = {articulation.root.name: Pose()}
    for joint in articulation.joints:
        q = positions.get(joint.name, 0.0)
        x, y, z = (float(value) for value in np.asarray(joint.axis) * q)
        motion = Pose((x, y, z)) if joint.type is JointType.PRISMATIC else Pose.from_axis_angle(joint.axis, q)
        found[joint.child] = found[joint.parent] @ joint.parent_pose @ motion @ joint.child_pose.inverse()
    return {name: pose.matrix() for name, pose in found.items()}


@pytest.mark.filterwarnings("ignore:compiler attribute")
@pytest.mark.parametrize("path", [*GYMNASIUM_MODELS, HAND], ids=lambda path: path.stem)
def test_links_stand_where_the_engine_puts_them(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings where it runs
    articulation = validate(read_mjcf(path, options=DROP))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    generator = np.random.default_rng(0)
    positions: dict[str, float] = {}
    for joint in articulation.movable_joints:
        positions[joint.name] = float(generator.uniform(-1.0, 1.0))
        data.qpos[model.jnt_qposadr[model.joint(joint.name).id]] = positions[joint.name]
    mujoco.mj_kinematics(model, data)
    ours = link_poses(articulation, positions)

    def theirs(body: int) -> np.ndarray:
        matrix = np.eye(4)
        matrix[:3, :3] = data.xmat[body].reshape(3, 3)
        matrix[:3, 3] = data.xpos[body]
        return matrix

    to_root = np.linalg.inv(theirs(model.body(articulation.root.name).id))
    bodies = {model.body(body).name or f"body_{body}": body for body in range(model.nbody)}
    for name in bodies.keys() & set(articulation.link_names):
        np.testing.assert_allclose(ours[name], to_root @ theirs(bodies[name]), atol=1e-6, err_msg=name)
    assert articulation.mass == pytest.approx(model.body_mass.sum(), rel=1e-12)


def test_the_hand_is_complete() -> None:
    with pytest.raises(AssetError, match=r"tendon 'robot0:T_FFJ1c' has a limit: .*Unsupported.DROP"):
        read_mjcf(HAND)
    hand = read_mjcf(HAND, options=DROP)
    assert any(note.startswith("left out: tendon 'robot0:T_FFJ1c' has a limit") for note in hand.notes)
    assert len(hand.joint_names) == 24
    assert hand.mass == pytest.approx(5.011)
    assert hand.self_collisions
    # Its wrist's drive is limited by forcerange, and its fingertips carry touch sites.
    assert hand.movable_joints[0].effort_limit == pytest.approx(4.785)
    assert sum(frame.name.startswith("robot0:S_") for frame in hand.frames) == 5
    assert all(not math.isinf(joint.upper_limit) for joint in hand.movable_joints)


def test_several_joints_of_a_body_become_a_chain(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        '<body name="base"><geom size="0.1"/><body name="tip" pos="0 0 1"><joint name="a" axis="1 0 0" pos="0 0 -.5"/>'
        '<joint name="b" axis="0 1 0"/><joint name="c" type="slide" axis="0 0 1" range="-1 1"/><geom size="0.1"/>'
        '</body></body>',
    )  # fmt: skip
    got = validate(read_mjcf(path))
    assert got.link_names == ("base", "a_link", "b_link", "tip")
    assert [joint.parent for joint in got.joints] == ["base", "a_link", "b_link"]
    assert got.links[1].mass == 0.0
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = (0.3, -0.8, 0.2)
    mujoco.mj_kinematics(model, data)
    ours = link_poses(got, {"a": 0.3, "b": -0.8, "c": 0.2})["tip"]
    np.testing.assert_allclose(ours[:3, 3], data.body("tip").xpos, atol=1e-9)
    np.testing.assert_allclose(ours[:3, :3], data.body("tip").xmat.reshape(3, 3), atol=1e-9)


def test_reference_positions_and_couplings(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        '<body name="base"><geom size="0.1"/>'
        '<body name="one"><joint name="a" axis="0 1 0" ref="0.4"/><geom size="0.1" pos="1 0 0"/></body>'
        '<body name="two"><joint name="b" type="slide" axis="0 0 1" ref="-0.2"/><geom size="0.1"/></body></body>',
        '<equality><joint joint1="b" joint2="a" polycoef="0.1 0.5 0 0 0"/></equality>',
    )  # fmt: skip
    got = read_mjcf(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[:] = (0.9, 0.3)
    mujoco.mj_kinematics(model, data)
    ours = link_poses(got, {"a": 0.9, "b": 0.3})
    for name in ("one", "two"):
        np.testing.assert_allclose(ours[name][:3, 3], data.body(name).xpos, atol=1e-9)
        np.testing.assert_allclose(ours[name][:3, :3], data.body(name).xmat.reshape(3, 3), atol=1e-9)
    mimic = got.joints[1].mimic
    assert mimic is not None
    # The constraint's residual vanishes where the description says that the follower is.
    data.qpos[1] = mimic.multiplier * 0.9 + mimic.offset
    mujoco.mj_forward(model, data)
    assert data.efc_pos[0] == pytest.approx(0.0, abs=1e-9)


def test_roots(tmp_path: Path) -> None:
    geom = '<geom size="0.1"/>'
    floating = f'<geom type="plane" size="1 1 1"/><body name="a"><freejoint/>{geom}</body>'
    assert read_mjcf(write(tmp_path, floating)).link_names == ("a",)
    assert read_mjcf(write(tmp_path, f'<body name="a" pos="1 2 3">{geom}</body>')).link_names == ("a",)
    sliding = f'<geom name="rail" type="capsule" size="0.1 1"/><body name="a"><joint name="j"/>{geom}</body>'
    got = validate(read_mjcf(write(tmp_path, sliding)))
    assert got.link_names == ("world", "a")
    assert got.root.mass == 0.0
    assert [shape.name for shape in got.root.collisions] == ["rail"]


def test_geoms(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        '<body name="a"><geom name="both" type="box" size="1 2 3" condim="4" friction="0.5 0.25 0.125"/>'
        '<geom name="drawn" size="0.1" contype="0" conaffinity="0" rgba="1 0 0 1"/>'
        '<geom name="felt" size="0.1" group="3" condim="1"/>'
        '<geom name="egg" type="ellipsoid" size="1 2 3"/></body>',
    )  # fmt: skip
    root = read_mjcf(path).root
    assert [shape.name for shape in root.collisions] == ["both", "felt", "egg"]
    assert [shape.name for shape in root.visuals] == ["both", "drawn", "egg"]
    both, felt, egg = root.collisions
    assert both.geometry == Box((1.0, 2.0, 3.0))
    assert felt.geometry == Sphere(0.1)
    assert isinstance(egg.geometry, Mesh)
    np.testing.assert_allclose(np.abs(egg.geometry.vertices).max(0), (1.0, 2.0, 3.0), rtol=0.05)
    material = both.material
    assert (material.static_friction, material.torsional_friction, material.rolling_friction) == (0.5, 0.25, 0.0)
    assert felt.material.static_friction == 0.0
    assert root.visuals[1].color == (1.0, 0.0, 0.0, 1.0)


def test_masks_and_exclusions_say_what_collides(tmp_path: Path) -> None:
    def chain(masks: tuple[str, str, str]) -> str:
        a, b, c = (f'<geom size="0.1" {mask}/>' for mask in masks)
        return (
            f'<body name="a">{a}<body name="b"><joint/>{b}<body name="c"><joint/>{c}</body></body>'
            f'<body name="d"><joint/><geom size="0.1"/></body></body>'
        )

    every = ("", "", "")
    rest = '<contact><exclude body1="b" body2="d"/></contact>'
    got = read_mjcf(write(tmp_path, chain(every), rest))
    assert got.self_collisions
    assert {frozenset(pair) for pair in got.collision_exclusions} == {frozenset("bd")}
    apart = read_mjcf(write(tmp_path, chain(("", "", 'contype="2" conaffinity="2"')), rest))
    assert not apart.self_collisions


def test_a_body_on_several_hinges_does_not_collide_with_its_parent(tmp_path: Path) -> None:
    """As in the engine, which differs where the parent is fixed to the world: a note says so."""
    hinges = '<joint axis="1 0 0"/><joint axis="0 1 0"/>'
    below = f'<geom size="0.1"/><body name="b">{hinges}<geom size="0.1"/></body>'
    others = '<body name="c" pos="1 0 0"><joint/><geom size="0.1"/></body>'
    floating = read_mjcf(write(tmp_path, f'<body name="a"><freejoint/>{below}{others}</body>'))
    assert floating.self_collisions
    assert ("a", "b") in floating.joined_links
    assert not any("collide" in note for note in floating.notes)
    fixed = read_mjcf(write(tmp_path, f'<body name="a">{below}</body>'))
    assert not fixed.self_collisions
    assert any("do not collide with those that they carry by joints: a with b" in note for note in fixed.notes)


@pytest.mark.parametrize(
    "ends",
    ['body1="left" body2="right" anchor="0.5 0 0.1"', 'site1="tip" site2="end"'],
)
def test_a_connect_closes_a_loop(tmp_path: Path, ends: str) -> None:
    """Its points meet where the joints' positions close it, given either way."""
    path = write(
        tmp_path,
        '<body name="base"><geom size="0.1"/>'
        '<body name="left"><joint name="a" axis="0 1 0"/><geom size="0.1"/><site name="tip" pos="0.5 0 0.1"/></body>'
        '<body name="right" pos="1 0 0" quat="0 0 0 1"><joint name="b" axis="0 1 0"/><geom size="0.1"/>'
        '<site name="end" pos="0.5 0 0.1"/></body></body>',
        f'<equality><connect name="knee" {ends}/></equality>',
    )
    got = read_mjcf(path)
    (loop,) = got.loops
    assert (loop.first, loop.second) == ("left", "right")
    for angle, apart in ((0.0, 0.0), (0.3, 2 * abs(0.5 - 0.5 * np.cos(0.3) - 0.1 * np.sin(0.3)))):
        poses = link_poses(got, {"a": angle, "b": angle})
        ends_of_loop = ((loop.first, loop.first_point), (loop.second, loop.second_point))
        points = [poses[name] @ (*point, 1.0) for name, point in ends_of_loop]
        assert np.linalg.norm(points[0] - points[1]) == pytest.approx(apart, abs=1e-9)


@pytest.mark.parametrize(
    ("body", "rest", "message"),
    [
        (
            '<body name="b"><joint name="j" type="ball" range="0 1" limited="true"/><geom size="1"/></body>',
            "",
            "ball joint 'j' has a limit of 1 rad .* remove its range",
        ),
        (
            '<body name="b"><freejoint/><geom size="1"/></body><body name="c"><freejoint/><geom size="1"/></body>',
            "",
            "several articulations: name one by ReadOptions.articulation=....*'b', 'c'",
        ),
        ("", "", "holds no body"),
        ("<nonsense/>", "", "does not compile"),
        (
            '<body name="b"><freejoint/><geom size="1"/></body>',
            '<equality><weld name="glue" body1="b"/></equality>',
            "constraint 'glue' holds a body to one that is not of its articulation",
        ),
    ],
)
def test_what_cannot_be_taken_over_is_refused(tmp_path: Path, body: str, rest: str, message: str) -> None:
    with pytest.raises(AssetError, match=message):
        read_mjcf(write(tmp_path, body, rest))


def test_without_mujoco_the_error_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(AssetError, match=r"pip install .*\[mjcf\]"):
        read_mjcf(tmp_path / "model.xml")
