"""MuJoCo's own cloth and rope: what is particular to them; tests of the matter solver and scenarios hold the rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.deformables import line, sheet
from orbit_assets.objects import box
from orbit_conformance.bodies import on_slope, slope
from orbit_core.interfaces import ConfigurationError, UnsupportedCapabilityError, World
from orbit_core.scene import (
    Articulation,
    Attachment,
    Cloth,
    Cylinder,
    Link,
    ObjectSpec,
    PhysicsMaterial,
    Pose,
    RayCasterSpec,
    Rope,
    Scene,
    Shape,
)
from orbit_core.world import simulate

COUNT = 13
ROPE = Rope("rope", line(0.24, COUNT), 0.1, Pose((0.0, 0.0, 1.0)), bending_stiffness=1e-3, damping=2.0)
CLOTH = Cloth("cloth", sheet((0.06, 0.06), (4, 4)), 0.2, Pose((0.0, 0.3, 1.0)))


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = simulate(Scene(deformables=(ROPE, CLOTH), terrain=()), 2, "mujoco", matter="native")
    yield made
    made.close()


@pytest.fixture
def fresh(world: World) -> World:
    for body in world.deformables.values():
        body.release()
    world.reset()
    return world


def test_a_rope_is_where_it_is_put_and_moves_as_it_is_told(fresh: World) -> None:
    """A helix that turns about an axis of its own and flies along: a rigid motion, which leaves lengths alone."""
    rope = fresh.deformables["rope"]
    turn = torch.linspace(0.0, 5.0, COUNT)
    helix = torch.stack((turn.cos(), turn.sin(), 0.4 * turn), dim=1)
    helix *= 0.02 / (helix[1] - helix[0]).norm()
    spin, speed = torch.tensor([0.3, -1.0, 2.0]), torch.tensor([0.5, 0.1, -0.2])
    moving = torch.linalg.cross(spin.expand_as(helix), helix) + speed
    rope.set_state(helix[None], moving[None], torch.tensor([1]))
    torch.testing.assert_close(rope.positions[1], helix, rtol=0, atol=1e-6)
    torch.testing.assert_close(rope.velocities[1], moving, rtol=0, atol=1e-5)
    assert rope.velocities[0].abs().max() == 0.0


def test_a_rope_may_turn_back_on_itself(fresh: World) -> None:
    points = fresh.deformables["rope"].positions[:1].clone()
    points[0, :, 0] *= -1.0  # the first piece points along minus x, where shortest turns are not unique
    fresh.deformables["rope"].set_state(points, env_ids=torch.tensor([0]))
    torch.testing.assert_close(fresh.deformables["rope"].positions[:1], points, rtol=0, atol=1e-6)


def test_what_is_held_outlasts_resets_in_its_environment_alone(fresh: World) -> None:
    for body in fresh.deformables.values():
        body.anchor([0, 1], env_ids=torch.tensor([1]))
    fresh.reset()
    starts = {name: body.positions[:, 0].clone() for name, body in fresh.deformables.items()}
    fresh.step(60)
    for name, body in fresh.deformables.items():
        assert (body.positions[0, 0, 2] - starts[name][0, 2]).item() < -0.3
        torch.testing.assert_close(body.positions[1, 0], starts[name][1], rtol=0, atol=1e-3)


def test_parameters_of_rope_differ_between_environments_and_stretch_is_none(fresh: World) -> None:
    rope = fresh.deformables["rope"]
    rope.anchor([0, 1])
    rope.set_parameter("bending", torch.tensor([1.0, 30.0]))
    fresh.step(250)
    drop = 1.0 - rope.positions[:, -1, 2]
    assert drop[0] > 4.0 * drop[1] > 0.0
    with pytest.raises(UnsupportedCapabilityError, match="'rope' has no axial stiffness"):
        rope.set_parameter("stiffness", torch.ones(2))
    rope.set_parameter("bending", torch.ones(2))


def test_contacts_of_cloth_stay_firm_where_densities_differ(fresh: World) -> None:
    """MuJoCo computes them anew from masses, in the environments that have new ones."""
    batch = fresh.engine.native[1]

    def softness() -> torch.Tensor:
        """(N,) 1/kg of the cloth's first particle: what MuJoCo makes of it for contacts."""
        return torch.from_numpy(batch.expand("body_invweight0")[:, batch.model.body("matter1_0").id, 0].copy())

    particle = batch.model.body("matter1_0").mass.item()
    torch.testing.assert_close(softness(), torch.full((2,), 0.25 / particle, dtype=torch.float64))
    fresh.deformables["cloth"].set_parameter("density", torch.tensor([1.0, 2.0]))
    fresh.step(1)
    torch.testing.assert_close(softness(), torch.tensor([0.25, 0.125], dtype=torch.float64) / particle)
    fresh.deformables["cloth"].set_parameter("density", torch.ones(2))
    fresh.step(1)


def test_the_report_says_what_differs() -> None:
    block = box("block", size=(0.05, 0.05, 0.05), mass=0.5, pose=Pose((-0.12, 0.0, 1.0)), fixed_base=True)
    held = replace(ROPE, attachments=(Attachment((0,), "block", "block"),))
    own = simulate(Scene(objects=(block,), deformables=(held,)), 1, "mujoco", matter="native")
    report = {line.asked: line.got for line in own.build_report}
    assert report["implicitfast"] == "discrete"
    assert report["axial stiffness 2000 N"] == "no stretch"
    assert report["contact with link 'block', which holds it"] == "none"
    own.close()


def test_ropes_that_friction_holds_on_a_slope_neither_creep_nor_roll() -> None:
    """At 95 % of what it holds; along the slope pieces rattled, and across it they rolled until the solver gave up."""
    angle, radius = math.atan(0.38), 0.002
    ropes = [
        Rope(
            name, line(0.2, 21), 0.05, on_slope(angle, radius) @ Pose.from_euler(0.0, 0.0, yaw, (0.0, aside, 0.0)),
            radius=radius, friction=0.4, damping=0.0, bending_stiffness=1e-5,
        )
        for name, yaw, aside in (("along", 0.0, 0.0), ("across", 0.5 * math.pi, 0.3))
    ]  # fmt: skip
    ground = slope(angle, PhysicsMaterial(0.4, 0.4))
    own = simulate(Scene(deformables=tuple(ropes), terrain=(ground,)), 1, "mujoco", matter="native")
    own.step(40)
    before = {name: body.positions.mean(1) for name, body in own.deformables.items()}
    own.step(60)
    for name, body in own.deformables.items():
        assert (body.positions.mean(1) - before[name]).norm().item() < 2e-4, name
    own.close()


def test_a_light_rope_bears_loads_of_a_thousand_times_its_pieces() -> None:
    """50 g at either end of a rope of 5 g/m over a bar; waves across it grew with each step, and it fell through."""
    material, bar, radius = PhysicsMaterial(0.2, 0.2), 0.02, 0.002
    shape = Shape(Cylinder(bar, 0.1), Pose.from_euler(0.5 * math.pi, 0.0, 0.0, (0.0, 0.0, 1.0)), material)
    link = Link("bar", 1.0, (0.0, 0.0, 0.0), 0.01 * np.eye(3), (shape,), (shape,))
    fixed = ObjectSpec(name="bar", articulation=Articulation("bar", (link,)), fixed_base=True)
    around, down = (bar + radius) * np.linspace(-0.5, 0.5, 8)[:, None] * math.pi, 0.01 * np.arange(1, 9)[:, None]
    turn = around / (bar + radius)
    arc = (bar + radius) * np.hstack((np.sin(turn), 0.0 * turn, np.cos(turn)))
    right = np.hstack((np.full_like(down, bar + radius), 0.0 * down, -down))
    left = right[::-1] * (-1.0, 1.0, 1.0)
    points = np.vstack((left, arc, right)) + np.array((0.0, 0.0, 1.0))
    loads = [
        box(name, size=(0.02, 0.02, 0.02), mass=0.05, pose=Pose(tuple(points[end] - (0.0, 0.0, 0.01))))
        for name, end in (("left", 0), ("right", -1))
    ]
    ends = (Attachment((0,), "left", "left"), Attachment((len(points) - 1,), "right", "right"))
    rope = Rope("rope", points, 0.005, radius=radius, friction=0.2, bending_stiffness=1e-7, attachments=ends)
    own = simulate(Scene(objects=(fixed, *loads), deformables=(rope,), terrain=()), 1, "mujoco", matter="native")
    own.step(80)
    assert own.deformables["rope"].positions[0, :, 2].max().item() == pytest.approx(1.0 + bar + radius, abs=1e-3)
    own.close()


def test_rays_do_not_meet_matter() -> None:
    eye = box("eye", size=(0.02, 0.02, 0.02), mass=0.1, pose=Pose((0.0, 0.0, 1.2)), fixed_base=True)
    under = Pose((0.0, 0.0, -0.05))
    down = RayCasterSpec(name="down", entity="eye", frame="eye", directions=((0.0, 0.0, -1.0),), pose=under)
    own = simulate(Scene(objects=(eye,), deformables=(ROPE,), sensors=(down,)), 1, "mujoco", matter="native")
    assert own.sensors["down"].distances[0, 0].item() == pytest.approx(1.15, abs=1e-3)
    own.close()


def test_what_mujoco_would_not_solve_is_refused_by_name() -> None:
    """Cloth so stiff to bend would fall several times too slowly; matrices of so long a chain would fill memory."""
    long = replace(ROPE, points=line(10.0, 1002))
    with pytest.raises(ConfigurationError, match="has 1001 pieces, and MuJoCo's own chains 1000 at most"):
        simulate(Scene(deformables=(long,)), 1, "mujoco", matter="native")
    with pytest.raises(ConfigurationError, match=r"'cloth' is too stiff to bend.*use at most \d"):
        simulate(Scene(deformables=(replace(CLOTH, bending_stiffness=1e3),)), 1, "mujoco", matter="native")


def test_cloth_does_not_meet_the_link_that_holds_it_but_everything_else() -> None:
    """Its edge lies in the block that holds it: its weight is all that this feels, until it comes down on the other."""
    holder = box("holder", size=(0.1, 0.02, 0.02), mass=1.0, pose=Pose((0.0, 0.27, 1.0)), fixed_base=True)
    under = box("under", size=(0.2, 0.2, 0.02), mass=1.0, pose=Pose((0.0, 0.3, 0.9)), fixed_base=True)
    held = replace(CLOTH, damping=3.0, attachments=(Attachment((0, 1, 2, 3), "holder", "holder"),))
    scene = Scene(objects=(holder, under), deformables=(held,))
    own = simulate(scene, 1, "mujoco", matter="native")
    body = own.deformables["cloth"]
    own.step(300)
    assert body.contact_force("holder", "holder")[0, 2].item() == pytest.approx(-held.mass * 9.81, rel=0.02)
    body.release()
    own.step(200)
    assert body.positions[0, :, 2].min().item() == pytest.approx(0.912, abs=1e-3)
    own.close()


def test_two_cloths_that_may_touch_are_refused_with_the_solver_that_has_them() -> None:
    other = replace(CLOTH, name="other", pose=Pose((0.0, 0.3, 1.01)))
    scene = Scene(deformables=(CLOTH, other), terrain=())
    with pytest.raises(UnsupportedCapabilityError, match=r"cloths 'cloth' and 'other'.*matter='orbit-matter'"):
        simulate(scene, 1, "mujoco", matter="native")


def test_cloths_that_land_on_each_other_stay_in_their_order_with_the_solver_that_has_them() -> None:
    """The heavier one on top, both at rest on a block: what MuJoCo's own cloths flung up by 0.3 m."""
    lower = Cloth("lower", sheet((0.1, 0.1), (7, 7)), 0.2, Pose((0.0, 0.0, 0.12)), thickness=0.004)
    upper = replace(lower, name="upper", area_density=0.4, pose=Pose((0.0, 0.0, 0.13)))
    table = box("table", (0.2, 0.2, 0.1), pose=Pose((0.0, 0.0, 0.05)), fixed_base=True)
    own = simulate(Scene(objects=(table,), deformables=(lower, upper), terrain=()), 1, "mujoco", matter="orbit-matter")
    highest = 0.0
    for _ in range(12):
        own.step(10)
        highest = max(highest, own.deformables["upper"].positions[0, :, 2].max().item())
    heights = [own.deformables[name].positions[0, :, 2].mean().item() for name in ("lower", "upper")]
    own.close()
    assert highest < 0.131
    assert 0.1 < heights[0] < heights[1] < 0.125
