"""What is Bullet's own: messages, quiet, materials, wheels, and its two renderers."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import numpy as np
import pytest
import torch

from orbit_bullet import BulletBackend, BulletConfig, library
from orbit_bullet.engine import BulletEngine
from orbit_bullet.materials import PairProducts, nominal, rolling_friction
from orbit_bullet.renderer import BulletRenderer
from orbit_core.dynamics.transforms import quat_conjugate, quat_rotate
from orbit_core.interfaces import BackendNotInstalledError, ConfigurationError, SceneLayout
from orbit_core.scene import (
    Articulation,
    Box,
    CameraSpec,
    Channel,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    ObjectSpec,
    PhysicsMaterial,
    Plane,
    Pose,
    RobotSpec,
    Scene,
    Shape,
    Sphere,
    look_at,
    single_link,
)


def cube(name: str, friction: float) -> ObjectSpec:
    shape = Shape(Box((0.05, 0.05, 0.05)), material=PhysicsMaterial(friction, friction))
    return ObjectSpec(name=name, articulation=single_link(name, shape, 1.0, np.eye(3) * 1e-3))


def ground(friction: float) -> Shape:
    return Shape(Plane(), material=PhysicsMaterial(friction, friction), name="ground")


@pytest.mark.parametrize(
    ("version", "remedy"), [((3, 11), "pip install pybullet$"), ((3, 13), r"up to Python 3\.11 .* pybullet-arm64")]
)
def test_a_missing_library_names_the_remedy(
    monkeypatch: pytest.MonkeyPatch, version: tuple[int, int], remedy: str
) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.setattr(library.sys, "version_info", (*version, 0, "final", 0))
    library.bullet.cache_clear()
    with pytest.raises(BackendNotInstalledError, match=remedy):
        library.bullet()
    library.bullet.cache_clear()


def test_nothing_is_printed() -> None:
    code = (
        "import torch, orbit_bullet as b; from orbit_core.interfaces import SceneLayout; "
        "from orbit_core.scene import Scene; "
        "layout, config = SceneLayout.of(Scene()), b.BulletConfig(workers=2); "
        "e = b.BulletBackend().create_engine(layout, 4, torch.device('cpu'), config); "
        "e.step(3); e.close()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout + done.stderr == ""


def test_settings_are_checked() -> None:
    for wrong in ({"workers": -1}, {"envs_per_client": 99}, {"solver_iterations": 0}, {"renderer": "vulkan"}):
        with pytest.raises(ConfigurationError, match=next(iter(wrong))):
            BulletConfig(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("values", [(0.5, 0.5), (0.0, 0.7), (0.9, 0.2), (0.0, 0.0)])
def test_one_pair_takes_the_larger_value_exactly(values: tuple[float, float]) -> None:
    layout = SceneLayout.of(Scene(objects=(cube("cube", values[0]),), terrain=(ground(values[1]),)))
    products = PairProducts(layout)
    factors = products.factors(nominal(layout, "dynamic_friction"))
    assert factors.prod() == pytest.approx(max(values), rel=1e-3, abs=1e-9)
    assert products.report("friction", nominal(layout, "dynamic_friction")) == []


def test_products_that_cannot_be_right_are_reported() -> None:
    """Two cubes of friction 0.2 on ground of 0.8: no factors give 0.2 between them, and 0.8 below, and no others."""
    cubes = (cube("one", 0.2), cube("two", 0.2))
    layout = SceneLayout.of(Scene(objects=cubes, terrain=(ground(0.8),)))
    assert PairProducts(layout).report("friction", nominal(layout, "dynamic_friction")) == []
    wild = (cube("one", 0.2), cube("two", 0.2), cube("three", 0.8), cube("four", 0.8))
    layout = SceneLayout.of(Scene(objects=wild, terrain=(ground(0.2),)))
    (line,) = PairProducts(layout).report("friction", nominal(layout, "dynamic_friction"))
    assert "pairs that may touch" in line.subject
    assert "multiplies" in line.why


@pytest.mark.parametrize("values", [(0.005, 0.005), (0.0, 0.02), (0.01, 0.0)])
@pytest.mark.parametrize("friction", [(0.5, 0.5), (0.3, 1.2)])
def test_one_pair_takes_the_larger_length_exactly(values: tuple[float, float], friction: tuple[float, float]) -> None:
    """Bullet's rule: each length times the other's sliding friction, added up."""
    layout = SceneLayout.of(Scene(objects=(cube("cube", friction[0]),), terrain=(ground(friction[1]),)))
    products = PairProducts(layout)
    factors = products.factors(nominal(layout, "dynamic_friction"))
    lengths = products.lengths(np.array(values), factors)
    assert lengths @ factors[::-1] == pytest.approx(max(values), rel=1e-3)
    assert products.report_lengths("torsional friction", np.array(values), factors) == []


def test_lengths_that_cannot_be_right_are_reported() -> None:
    """Of four cubes in a ring of pairs, one that grips more than the others, on ground that grips less."""
    layout = SceneLayout.of(Scene(objects=tuple(cube(name, 0.5) for name in "abcd"), terrain=(ground(0.5),)))
    products = PairProducts(layout)
    factors = products.factors(nominal(layout, "dynamic_friction"))
    values = np.array([0.05, 0.05, 0.0, 0.0, 0.0])
    (line,) = products.report_lengths("torsional friction", values, factors)
    assert line.subject.startswith("torsional friction of")
    assert "adds up the two lengths" in line.why


def test_flat_things_ask_for_rolling_friction_beyond_the_usual_alone() -> None:
    def with_rolling(name: str, geometry: Box | Sphere, rolling: float) -> ObjectSpec:
        shape = Shape(geometry, material=PhysicsMaterial(rolling_friction=rolling))
        return ObjectSpec(name=name, articulation=single_link(name, shape, 1.0, np.eye(3) * 1e-3))

    box, usual = Box((0.05, 0.05, 0.05)), PhysicsMaterial.rolling_friction
    things = (
        with_rolling("box", box, usual),
        with_rolling("sticky", box, 0.01),
        with_rolling("ball", Sphere(0.1), usual),
    )
    layout = SceneLayout.of(Scene(objects=things))
    assert rolling_friction(layout).tolist() == [0.0, 0.01, usual, 0.0]


def test_friction_that_is_written_keeps_torsional_friction() -> None:
    """A ball that spins on the spot loses ``5 c g t / (2 r^2)``, c = 0.005 m, whatever its sliding friction; 1 %."""
    ball = Shape(Sphere(0.05), material=PhysicsMaterial(0.5, 0.5, 0.005, 0.0))
    inertia = np.eye(3) * 0.4 * 0.05**2
    spec = ObjectSpec(name="ball", articulation=single_link("ball", ball, 1.0, inertia), pose=Pose((0.0, 0.0, 0.05)))
    smooth = Shape(Plane(), material=PhysicsMaterial(0.0, 0.0, 0.0, 0.0), name="ground")
    layout = SceneLayout.of(Scene(objects=(spec,), terrain=(smooth,), physics_dt=0.005))
    engine = BulletEngine(layout, 2, torch.device("cpu"), BulletConfig(workers=1))
    engine.set_friction(torch.tensor([0]), torch.tensor([[0.9]]), torch.tensor([1]))
    engine.step(20)
    engine.write_root_state(0, None, torch.tensor([[0.0, 0.0, 0.0, 0.0, 0.0, 40.0]]).repeat(2, 1))
    engine.step(80)
    lost = 40.0 - engine.link_velocities[:, 0, 5]
    torch.testing.assert_close(lost, torch.full((2,), 0.005 * 9.81 * 0.4 / (0.4 * 0.05**2)), rtol=0.01, atol=0)
    engine.close()


def test_a_fast_body_keeps_its_angular_momentum_and_energy() -> None:
    """About its middle axis, which is unstable, at 60 rad/s for a second: to 1e-5, and to 0.3 % of energy.

    In the second environment as heavy again.
    """
    moments = np.array([0.01, 0.02, 0.03])
    articulation = single_link("brick", Shape(Box((0.1, 0.1, 0.1))), 1.0, np.diag(moments))
    layout = SceneLayout.of(Scene(objects=(ObjectSpec(name="brick", articulation=articulation),), terrain=()))
    engine = BulletEngine(layout, 2, torch.device("cpu"), BulletConfig(workers=1))
    engine.set_masses(torch.tensor([0]), torch.tensor([[2.0]]), torch.tensor([1]))
    engine.write_root_state(0, None, torch.tensor([[0.0, 0.0, 0.0, 0.1, 60.0, 0.1]]).repeat(2, 1))
    for _ in range(10):
        engine.step(20)
        orientation, spin = engine.link_poses[:, 0, 3:].double(), engine.link_velocities[:, 0, 3:].double()
        inward = quat_rotate(quat_conjugate(orientation), spin)
        momentum = quat_rotate(orientation, torch.as_tensor(moments) * inward)
        expected = torch.tensor([[0.001, 1.2, 0.003]], dtype=torch.float64).expand(2, 3)
        torch.testing.assert_close(momentum, expected, rtol=0, atol=1e-5)
        energy = 0.5 * (torch.as_tensor(moments) * inward**2).sum(-1)
        torch.testing.assert_close(energy, torch.full_like(energy, 36.0), rtol=3e-3, atol=0)
    assert (inward[:, 1] < 59.9).all()  # the axis has left its place
    engine.close()


def test_a_drive_within_its_limit_is_integrated_implicitly() -> None:
    """``v' = (I v + h (k (t - q) + d tv)) / (I + a + h d + h^2 k)``: armature, damping and drive in one step; 1e-5."""
    links = (Link("base"), Link("rotor", 1.0, inertia=np.eye(3) * 0.01))
    joint = Joint("spin", JointType.CONTINUOUS, "base", "rotor", damping=0.3, armature=0.02)
    for limit in (None, 1e4):
        drive = ImplicitPd(joints=(".*",), stiffness=400.0, damping=40.0, effort_limit=limit)
        robot = RobotSpec(
            name="rotor", articulation=Articulation("rotor", links, (joint,)), fixed_base=True, actuators=(drive,)
        )
        layout = SceneLayout.of(Scene(robots=(robot,), physics_dt=0.005))
        engine = BulletEngine(layout, 1, torch.device("cpu"), BulletConfig(workers=1))
        engine.position_targets.fill_(0.5)
        engine.velocity_targets.fill_(0.1)
        engine.step(1)
        h, inertia = 0.005, 0.01 + 0.02
        expected = h * (400.0 * 0.5 + 40.0 * 0.1) / (inertia + h * (40.0 + 0.3) + h * h * 400.0)
        assert engine.joint_velocities[0, 0] == pytest.approx(expected, rel=1e-5)
        effort = 400.0 * (0.5 - h * expected) + 40.0 * (0.1 - expected)
        assert engine.joint_efforts[0, 0] == pytest.approx(effort, rel=1e-4)
        engine.close()


def test_opengl_draws_the_same_as_the_software_renderer() -> None:
    """Links agree but at edges, depth to its 16 bits; a second OpenGL renderer in the process is refused."""
    if importlib.util.find_spec("eglRenderer") is None:
        pytest.skip("this build of Bullet has no OpenGL renderer")
    channels = (Channel.RGB, Channel.DEPTH, Channel.INSTANCE)
    camera = CameraSpec(
        name="eye", width=160, height=120, channels=channels, pose=look_at((0.6, 0.4, 0.5), (0, 0, 0)), near=0.1
    )
    layout = SceneLayout.of(Scene(objects=(cube("cube", 1.0),), sensors=(camera,)))
    poses = torch.tensor([[[0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]]])
    eye = torch.tensor([[*camera.pose.position, *camera.pose.orientation]])
    images = []
    renderers = []
    for kind in ("tiny", "egl"):
        try:
            renderers.append(BulletBackend().create_renderer(layout, (camera,), BulletConfig(renderer=kind)))
        except ConfigurationError as error:
            pytest.skip(str(error))
        images.append(renderers[-1].render(camera, eye, poses, channels))
    with pytest.raises(ConfigurationError, match="another renderer of this process"):
        BulletRenderer(layout, (camera,), BulletConfig(renderer="egl"))
    tiny, opengl = images
    same = tiny.links == opengl.links
    assert same.float().mean() > 0.99
    both = same & (tiny.links == 0)
    assert both.sum() > 100
    torch.testing.assert_close(tiny.depth[both], opengl.depth[both], rtol=0.01, atol=0)
    for renderer in renderers:
        renderer.close()
