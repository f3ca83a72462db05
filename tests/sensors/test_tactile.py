"""Tactile pads against closed forms: Hertz's ball, a line contact, an edge, shear with partial slip."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_assets.objects import box, cylinder, sphere
from orbit_core.backends import backend_names
from orbit_core.dynamics.transforms import quat_rotate
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.scene import ContactSensorSpec, ObjectSpec, PhysicsMaterial, Pose, Scene, TactileSpec
from orbit_core.sensors import TactileSensor
from orbit_core.sensors.half_space import HalfSpace, compliance_matrix
from orbit_core.world import simulate

CPU = torch.device("cpu")
YOUNG, POISSON = 2.0e5, 0.48
MODULUS = YOUNG / (1.0 - POISSON**2)
# Engines that report contact forces and cast rays.
ENGINES = [name for name in ("mujoco", "bullet", "sapien", "warp") if name in backend_names()]
# PhysX reports the normal part of contact forces only.
WITH_FRICTION = [name for name in ENGINES if name != "sapien"]
PAD = TactileSpec(name="pad", entity="finger", frame="finger", pose=Pose((0.0, 0.0, 0.02)))


def middles(count: int, extent: float) -> torch.Tensor:
    """Middles (count,) of cells over an extent, m."""
    return ((torch.arange(count) + 0.5) / count - 0.5) * extent


def ball_gaps(count: int, extent: float, radius: float) -> torch.Tensor:
    """Gaps (1, T) below a ball that touches the middle, m."""
    x = middles(count, extent)
    squared = x[None, :] ** 2 + x[:, None] ** 2
    return (radius - (radius**2 - squared).clamp_min(0.0).sqrt()).flatten()[None]


@pytest.mark.parametrize(("force", "radius"), [(1.0, 0.01), (3.0, 0.01), (2.0, 0.02)])
def test_the_pressure_under_a_ball_is_that_of_hertz(force: float, radius: float):
    count, extent = 24, 0.02
    half_space = HalfSpace(count, count, (extent, extent), MODULUS, CPU)
    loads = half_space.loads(ball_gaps(count, extent, radius), torch.tensor([force]))
    cell = (extent / count) ** 2
    # Johnson 1985, section 4.2.
    contact = (3.0 * force * radius / (4.0 * MODULUS)) ** (1.0 / 3.0)
    peak = 3.0 * force / (2.0 * math.pi * contact**2)
    assert float(loads.sum()) == pytest.approx(force, rel=1e-4)
    assert float(loads.max()) / cell == pytest.approx(peak, rel=0.03)
    area = float((loads > 0.02 * loads.max()).sum()) * cell
    assert math.sqrt(area / math.pi) == pytest.approx(contact, rel=0.06)
    depth = half_space.displacements(loads).max()
    assert float(depth) == pytest.approx(contact**2 / radius, rel=0.03)


def test_the_pressure_under_a_roller_is_that_of_a_line_contact():
    count, size, force, radius = 24, (0.02, 0.04), 6.0, 0.01
    half_space = HalfSpace(count, count, size, MODULUS, CPU)
    x = middles(count, size[0])
    gaps = (radius - (radius**2 - x**2).sqrt()).expand(count, count).flatten()[None]
    loads = half_space.loads(gaps, torch.tensor([force])).view(count, count)
    # In the middle of its length, away from its ends, where the load per length is what the row bears.
    row = loads[count // 2]
    per_length = float(row.sum()) / (size[1] / count)
    half_width = math.sqrt(4.0 * per_length * radius / (math.pi * MODULUS))
    peak = 2.0 * per_length / (math.pi * half_width)
    assert float(row.max()) / (size[0] * size[1] / count**2) == pytest.approx(peak, rel=0.05)


def test_the_compliance_of_one_cell_is_loves_and_far_away_that_of_a_point():
    matrix = compliance_matrix(8, 8, (0.008, 0.008), MODULUS)
    # A uniformly loaded square of side a sinks in its middle by 4 a p ln(1 + sqrt 2) / (pi E*), with p = F / a^2.
    assert float(matrix[0, 0]) == pytest.approx(4.0 * math.log(1.0 + math.sqrt(2.0)) / (math.pi * MODULUS * 1e-3))
    assert float(matrix[0, 7]) == pytest.approx(1.0 / (math.pi * MODULUS * 7e-3), rel=0.01)
    assert torch.allclose(matrix, matrix.T)


def test_cells_without_a_surface_bear_nothing_and_no_force_is_no_load():
    half_space = HalfSpace(8, 8, (0.02, 0.02), MODULUS, CPU)
    gaps = torch.zeros(3, 64)
    gaps[0, :32] = torch.inf
    gaps[2] = torch.inf
    loads = half_space.loads(gaps, torch.tensor([2.0, -1.0, 2.0]))
    assert float(loads[0].sum()) == pytest.approx(2.0, rel=1e-4)
    assert not loads[0, :32].any()
    assert not loads[1:].any()


def pressed(thing: ObjectSpec, engine: str, pad: TactileSpec = PAD, num_envs: int = 2) -> World:
    """Return a world in which a thing rests on a finger whose pad faces up."""
    rough = PhysicsMaterial(1.0, 1.0)
    finger = box("finger", (0.04, 0.04, 0.04), pose=Pose((0.0, 0.0, 0.02)), fixed_base=True, material=rough)
    net = ContactSensorSpec(name="net", entity="finger")
    world = simulate(Scene(objects=(finger, thing), sensors=(pad, net), physics_dt=0.002), num_envs, engine)
    world.step(250)
    return world


def pad_of(world: World) -> TactileSensor:
    """Return the world's tactile sensor."""
    sensor = world.sensors["pad"]
    assert isinstance(sensor, TactileSensor)
    return sensor


@pytest.mark.parametrize("engine", ENGINES)
def test_taxels_under_a_ball_add_up_to_the_contact_force_and_are_hertzian(engine: str):
    mass = 0.2
    world = pressed(sphere("ball", 0.015, mass=mass, pose=Pose((0.0, 0.0, 0.055))), engine)
    sensor = pad_of(world)
    net = world.sensors["net"].forces[:, 0]  # pyright: ignore[reportAttributeAccessIssue]
    total = sensor.normal_forces.sum((1, 2))
    assert torch.allclose(total, -net[:, 2], rtol=0.02)
    assert float(total[0]) == pytest.approx(mass * 9.81, rel=0.02)
    contact = (3.0 * float(total[0]) * 0.015 / (4.0 * MODULUS)) ** (1.0 / 3.0)
    peak = 3.0 * float(total[0]) / (2.0 * math.pi * contact**2)
    assert float(sensor.normal_forces[0].max()) / (0.02 / 16) ** 2 == pytest.approx(peak, rel=0.06)
    world.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_an_edge_loads_one_line_of_taxels(engine: str):
    # A block that overhangs: its edge is over the pad, 4 mm from the middle, parallel to y.
    block = box("block", (0.05, 0.03, 0.02), mass=0.3, pose=Pose((0.029, 0.0, 0.05)))
    pad = TactileSpec(name="pad", entity="finger", frame="finger", pose=PAD.pose, links=("finger",))
    rest = box("rest", (0.02, 0.04, 0.04), pose=Pose((0.045, 0.0, 0.02)), fixed_base=True)
    finger = box("finger", (0.04, 0.04, 0.04), pose=Pose((0.0, 0.0, 0.02)), fixed_base=True)
    world = simulate(Scene(objects=(finger, block, rest), sensors=(pad,), physics_dt=0.002), 1, engine)
    world.step(250)
    forces = pad_of(world).normal_forces[0]
    columns = forces.sum(0)
    loaded = torch.nonzero(columns > 1e-6).flatten()
    # Taxels right of x = 4 mm only: 1.25 mm wide, the first middle beyond it is at 4.375 mm.
    assert float(middles(16, 0.02)[loaded[0]]) == pytest.approx(0.004, abs=0.0013)
    # As under any flat punch the pressure rises towards the edge.
    assert float(columns[loaded[0] : loaded[0] + 2].max()) > 1.3 * float(columns[13])
    world.close()


@pytest.mark.parametrize("engine", WITH_FRICTION)
def test_shear_adds_up_to_the_push_and_slip_grows_with_it(engine: str):
    world = pressed(sphere("ball", 0.015, mass=0.3, pose=Pose((0.0, 0.0, 0.055))), engine)
    sensor, weight = pad_of(world), 0.3 * 9.81
    ball, slips = world.objects["ball"], []
    for push in (0.2, 0.5):
        wrench = torch.zeros(2, 1, 6)
        wrench[..., 0] = push * weight
        # The push acts at the point of contact, so that the ball does not roll: a torque about y balances it.
        wrench[..., 4] = -0.015 * push * weight
        ball.set_wrenches(wrench)
        world.step(10)
        shear, normal = sensor.shear_forces.sum((1, 2)), sensor.normal_forces
        net = world.sensors["net"].forces[:, 0]  # pyright: ignore[reportAttributeAccessIssue]
        assert torch.allclose(shear, net[:, :2], atol=0.02 * weight)
        assert (sensor.shear_forces.norm(dim=-1) <= 0.801 * normal + 1e-6).all()
        slips.append(float(sensor.slip[0]))
    assert 0.0 < slips[0] < slips[1] < 1.0
    world.close()


def test_the_slipping_ring_under_a_ball_is_that_of_mindlin():
    half_space = HalfSpace(32, 32, (0.016, 0.016), MODULUS, CPU)
    gaps = ball_gaps(32, 0.016, 0.01)
    whole, held = half_space.loads(torch.cat((gaps, gaps)), torch.tensor([2.0, 2.0 * (1.0 - 0.6)]))
    # Johnson 1985, section 7.2: the radius that sticks is (1 - Q / (mu P))^(1/3) of the contact's.
    ratio = math.sqrt(float((held > 1e-4).sum()) / float((whole > 1e-4).sum()))
    assert ratio == pytest.approx(0.4 ** (1.0 / 3.0), rel=0.05)


def test_a_pad_that_nothing_touches_is_zero_and_its_gel_is_grey():
    world = pressed(sphere("ball", 0.015, mass=0.2, pose=Pose((0.5, 0.0, 0.015))), "mujoco")
    sensor = pad_of(world)
    assert not sensor.normal_forces.any()
    assert not sensor.shear_forces.any()
    assert not sensor.slip.any()
    picture = sensor.picture(40, 40)
    assert picture.shape == (2, 40, 40, 3)
    assert torch.equal(picture, torch.full_like(picture, 128))
    world.close()


def test_the_picture_of_a_gel_shows_the_ball_lit_from_three_sides():
    world = pressed(sphere("ball", 0.015, mass=0.5, pose=Pose((0.0, 0.0, 0.055))), "mujoco")
    picture = pad_of(world).picture(64, 64)[0].int()
    red = picture[..., 0]
    # Seen from behind, the ball is a bump; red light comes from +x, so that its right side is bright.
    assert red[32, 12:28].float().mean() < 110.0
    assert red[32, 36:52].float().mean() > 150.0
    assert torch.equal(red, red.flip(0)) or (red - red.flip(0)).abs().float().mean() < 3.0
    world.close()


def test_a_cylinder_that_lies_on_the_pad_loads_a_line():
    turned = Pose.from_euler(math.pi / 2, 0.0, 0.0, (0.0, 0.0, 0.051))
    world = pressed(cylinder("roller", 0.01, 0.03, mass=0.2, pose=turned), "mujoco")
    forces = pad_of(world).normal_forces[0]
    assert float(forces.sum()) == pytest.approx(0.2 * 9.81, rel=0.02)
    assert int(forces.sum(0).argmax()) in (7, 8)
    assert float(forces.sum(1).min()) > 0.0
    world.close()


def test_a_pad_in_a_frame_of_another_orientation_feels_the_same():
    side = Pose.from_euler(0.0, math.pi / 2, 0.0, (0.02, 0.0, 0.0))
    pad = TactileSpec(name="pad", entity="finger", frame="finger", pose=side)
    out = quat_rotate(torch.tensor(side.orientation), torch.tensor((0.0, 0.0, 1.0)))
    assert out.tolist() == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    world = pressed(sphere("ball", 0.015, mass=0.2, pose=Pose((0.0, 0.0, 0.055))), "mujoco", pad)
    # The ball lies on top of the finger, where this pad is not.
    assert not pad_of(world).normal_forces.any()
    world.close()


def test_constants_that_cannot_be_and_a_pad_on_an_unmeasured_link_are_refused():
    with pytest.raises(ValueError, match="poisson from 0 to"):
        TactileSpec(name="pad", entity="finger", frame="finger", poisson=0.7)
    with pytest.raises(ValueError, match="2 to 64 taxels"):
        TactileSpec(name="pad", entity="finger", frame="finger", taxels=(1, 16))
    from orbit_assets.objects import cabinet

    pad = TactileSpec(name="pad", entity="cabinet", frame="drawer", links=("door",))
    with pytest.raises(ConfigurationError, match="is on link 'drawer'"):
        simulate(Scene(objects=(cabinet(),), sensors=(pad,)), 1, "mujoco")
