"""What is MuJoCo's own: settings, the model that is built, threads, and what it does not leave behind."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from orbit_core.interfaces import AssetError, ConfigurationError, Engine, SceneLayout, SimulationError
from orbit_core.scene import (
    Articulation,
    Box,
    Capsule,
    ContactSensorSpec,
    Cylinder,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    Mesh,
    Mimic,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    RobotSpec,
    Scene,
    Shape,
    Sphere,
    single_link,
)
from orbit_mjmodel.materials import contact_parameters
from orbit_mujoco import MujocoBackend, MujocoConfig


def make(scene: Scene, num_envs: int = 1, **settings: object) -> Engine:
    config = MujocoConfig(**settings)  # type: ignore[arg-type]
    return MujocoBackend().create_engine(SceneLayout.of(scene), num_envs, torch.device("cpu"), config)


def model_of(engine: Engine) -> mujoco.MjModel:
    return engine.native[0]


def bar(name: str, mass: float = 1.0) -> Link:
    return Link(name, mass, (0.1, 0.0, 0.0), np.diag([0.01, 0.02, 0.02]), (Shape(Box((0.1, 0.02, 0.02))),))


def robot(**joint: object) -> RobotSpec:
    """Two overlapping bars on a fixed base."""
    joints = (
        Joint("a", JointType.REVOLUTE, "base", "upper", lower_limit=-1.0, upper_limit=2.0, **joint),  # type: ignore[arg-type]
        Joint("b", JointType.CONTINUOUS, "upper", "lower", Pose((0.1, 0.0, 0.0))),
    )
    articulation = Articulation("robot", (bar("base"), bar("upper"), bar("lower")), joints)
    drives = (ImplicitPd(joints=("a",), stiffness=100.0, damping=10.0, effort_limit=5.0),)
    return RobotSpec(name="robot", articulation=articulation, fixed_base=True, pose=Pose((0, 0, 1.0)), actuators=drives)


def cube(name: str = "cube", height: float = 0.05) -> ObjectSpec:
    articulation = single_link(name, Shape(Box((0.05, 0.05, 0.05))), 1.0, np.eye(3) * 0.01)
    return ObjectSpec(name=name, articulation=articulation, pose=Pose((0.5, 0.0, height)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"integrator": "verlet"}, "integrator 'verlet' is not one of implicitfast"),
        ({"cone": "round"}, "cone 'round'"),
        ({"threads": -1}, "threads must be 0"),
        ({"iterations": 0}, "iterations must be positive"),
        ({"contact_solref": (0.02,)}, "contact_solref takes 2 numbers, not 1"),
        ({"limit_solref": (0.02,)}, "limit_solref takes 2 numbers, not 1"),
    ],
)
def test_settings_are_checked(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        MujocoConfig(**settings)  # type: ignore[arg-type]


def test_settings_reach_the_model() -> None:
    engine = make(
        Scene(robots=(robot(),), physics_dt=0.002), cone="pyramidal", solver="cg", iterations=7, ls_iterations=8,
        integrator="euler", impratio=3.0, contact_solref=(0.01, 0.9), limit_solref=(0.01, 2.0),
    )  # fmt: skip
    option = model_of(engine).opt
    assert (option.timestep, option.iterations, option.ls_iterations, option.impratio) == (0.002, 7, 8, 3.0)
    assert option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert option.solver == mujoco.mjtSolver.mjSOL_CG
    assert option.integrator == mujoco.mjtIntegrator.mjINT_EULER
    np.testing.assert_allclose(model_of(engine).jnt_solref, np.tile((0.01, 2.0), (model_of(engine).njnt, 1)))
    np.testing.assert_allclose(model_of(engine).geom_solref, np.tile((0.01, 0.9), (model_of(engine).ngeom, 1)))
    assert [line.subject for line in engine.build_report] == ["contacts"]


def test_friction_is_firm_where_the_scene_asks_for_it_and_settings_do_not_say() -> None:
    firm = Scene(robots=(robot(),), firm_friction=True)
    engines = make(Scene(robots=(robot(),))), make(firm), make(firm, impratio=2.0)
    assert [model_of(engine).opt.impratio for engine in engines] == [1.0, 10.0, 2.0]


def test_only_the_cpu() -> None:
    with pytest.raises(ConfigurationError, match="'cpu' only"):
        MujocoBackend().create_engine(SceneLayout.of(Scene()), 1, torch.device("cuda"), MujocoConfig())


def test_masses_limits_and_drives_are_the_descriptions() -> None:
    model = model_of(make(Scene(robots=(robot(damping=0.3, armature=0.02, friction=0.1),), objects=(cube(),))))
    np.testing.assert_allclose(model.body_mass[1:], [1, 1, 1, 1])
    np.testing.assert_allclose(model.body_ipos[2], [0.1, 0, 0])
    np.testing.assert_allclose(np.sort(model.body_inertia[2]), [0.01, 0.02, 0.02])
    np.testing.assert_allclose(model.jnt_range[0], [-1, 2])
    assert model.jnt_limited.tolist() == [1, 0, 0]
    assert (model.dof_damping[0], model.dof_armature[0], model.dof_frictionloss[0]) == (0.3, 0.02, 0.1)
    np.testing.assert_allclose(model.actuator_biasprm[0, :3], [0, -100, -10])
    np.testing.assert_allclose(model.actuator_forcerange[0], [-5, 5])
    assert model.actuator_forcelimited.tolist() == [1, 0]


def test_a_link_does_not_push_its_fixed_parent() -> None:
    """MuJoCo itself lets the first link of a fixed base touch that base."""
    sensor = ContactSensorSpec(name="contact", entity="robot")
    engine = make(Scene(robots=(robot(),), sensors=(sensor,), gravity=(0.0, 0.0, 0.0)))
    engine.step(10)
    assert engine.contact_forces.abs().max() == 0


def test_a_scene_without_entities_steps() -> None:
    engine = make(Scene(), num_envs=2)
    engine.step(3)
    engine.reset()
    assert engine.link_poses.shape == (2, 0, 7)
    assert engine.joint_positions.shape == (2, 0)


def test_results_do_not_depend_on_threads() -> None:
    engines = [make(Scene(robots=(robot(),), objects=(cube(),)), num_envs=8, threads=threads) for threads in (1, 3)]
    for engine in engines:
        engine.position_targets[:, 0] = torch.linspace(-1, 1, 8)
        engine.step(100)
    assert torch.equal(engines[0].link_poses, engines[1].link_poses)
    assert torch.equal(engines[0].link_velocities, engines[1].link_velocities)


def test_a_mimic_joint_has_no_drive_and_that_is_reported() -> None:
    links = (bar("base"), bar("one"), bar("two"))
    joints = (
        Joint("leader", JointType.CONTINUOUS, "base", "one"),
        Joint("follower", JointType.CONTINUOUS, "base", "two", mimic=Mimic("leader")),
    )
    drives = (ImplicitPd(joints=(".*",), stiffness=10.0),)
    pair = RobotSpec(name="pair", articulation=Articulation("pair", links, joints), fixed_base=True, actuators=drives)
    engine = make(Scene(robots=(pair,)))
    assert [line.subject for line in engine.build_report] == ["joint 'follower' of 'pair'"]
    engine.efforts[:, 1] = 5.0
    engine.step(10)
    assert engine.joint_efforts[0, 1] == 0
    assert engine.joint_positions.abs().max() < 1e-6


def test_impossible_inertia_is_repaired_and_reported() -> None:
    odd = ObjectSpec(name="odd", articulation=single_link("odd", Shape(Sphere(0.1)), 1.0, np.diag([1.0, 0.1, 0.1])))
    report = make(Scene(objects=(odd,))).build_report
    assert [line.subject for line in report] == ["link 'odd' of 'odd'"]
    assert "principal moments" in report[0].asked


def test_a_refused_description_is_an_asset_error() -> None:
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    thing = ObjectSpec(name="flat", articulation=single_link("flat", Shape(flat), 1.0, np.eye(3)))
    with pytest.raises(AssetError, match="MuJoCo refuses the scene"):
        make(Scene(objects=(thing,)))


def test_a_mesh_shared_by_shapes_is_stored_once() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    shapes = [Shape(Mesh(corners.copy(), np.array([[0, 1, 2]]))) for _ in range(2)]
    things = tuple(
        ObjectSpec(name=f"o{i}", articulation=single_link(f"o{i}", shape, 1.0, np.eye(3)))
        for i, shape in enumerate(shapes)
    )
    model = model_of(make(Scene(objects=things)))
    assert model.nmesh == 1
    assert model.ngeom == 3


@pytest.mark.parametrize(
    ("shape", "rolls", "condim"),
    [
        (Box((1, 1, 1)), True, 4),
        (Sphere(1), True, 6),
        (Sphere(1), False, 4),
        (Capsule(1, 1), True, 6),
        (Cylinder(1, 1), False, 4),
    ],
)
def test_contacts_have_no_more_directions_than_matter(shape: Box | Sphere, rolls: bool, condim: int) -> None:
    config = MujocoConfig()
    assert contact_parameters(Shape(shape), 1.0, rolls, 0.005, config).condim == condim
    frictionless = Shape(shape, material=PhysicsMaterial(torsional_friction=0.0, rolling_friction=0.0))
    assert contact_parameters(frictionless, 1.0, rolls, 0.005, config).condim == 3
    sticky = Shape(shape, material=PhysicsMaterial(rolling_friction=0.01))
    assert contact_parameters(sticky, 1.0, rolls, 0.005, config).condim == 6


@pytest.mark.parametrize(("speed", "whose"), [(2e4, ""), (1e12, " in 'cube'")])
def test_divergence_is_an_error_and_leaves_no_log(
    speed: float, whose: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the bound that all engines have, and where MuJoCo itself gives up."""
    monkeypatch.chdir(tmp_path)
    engine = make(Scene(objects=(cube(),)), num_envs=3)
    velocity = torch.zeros(1, 6)
    velocity[0, 2] = speed
    engine.write_root_state(0, None, velocity, torch.tensor([1]))
    with pytest.raises(SimulationError, match=f"environments 1 diverged{whose}:"):
        engine.step(2)
    assert not list(tmp_path.iterdir())
    engine.reset(torch.tensor([1]))
    engine.step(2)
    assert engine.link_poses.isfinite().all()


def test_closing_twice_is_no_error() -> None:
    engine = make(Scene(objects=(cube(),)))
    engine.close()
    engine.close()


def slider(**joint: object) -> Scene:
    """A carriage of 1 kg along x."""
    joints = (Joint("slide", JointType.PRISMATIC, "base", "carriage", axis=(1.0, 0.0, 0.0), **joint),)  # type: ignore[arg-type]
    articulation = Articulation("slider", (Link("base"), Link("carriage", 1.0, inertia=0.1 * np.eye(3))), joints)
    return Scene(robots=(RobotSpec(name="slider", articulation=articulation, fixed_base=True),), terrain=())


def test_limits_at_one_position_hold_the_joint_there_and_are_reported() -> None:
    engine = make(slider(lower_limit=0.3, upper_limit=0.3))
    (line,) = engine.build_report
    assert (line.subject, line.asked) == ("joint 'slide' of 'slider'", "both limits at 0.3")
    engine.efforts[:] = 10.0
    engine.step(50)
    assert engine.joint_positions.item() == pytest.approx(0.3, abs=1e-3)


def test_a_spring_too_stiff_for_the_step_is_damped_and_that_is_reported() -> None:
    soft = make(slider(stiffness=3e4, rest_position=0.1))
    assert soft.build_report == ()
    assert (model_of(soft).jnt_stiffness[0], model_of(soft).qpos_spring[0]) == (3e4, 0.1)
    stiff = make(slider(stiffness=1e6))
    (line,) = stiff.build_report
    assert "a spring of stiffness 1e+06" in line.asked
    stiff.write_joint_state(torch.tensor([0]), torch.tensor([[0.1]]), None, torch.tensor([0]))
    stiff.step(200)
    assert abs(stiff.joint_positions.item()) < 1e-6
