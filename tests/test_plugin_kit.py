"""What the kit gives plugins so that each need not write it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_assets.deformables import ball, cuboid, ring
from orbit_assets.joint_models import BALL, compound
from orbit_conformance.bodies import pendulum, scene, slider
from orbit_core import backends
from orbit_core.interfaces import TERRAIN, ConfigurationError, ContactQuery, SceneLayout
from orbit_core.plugin_kit.bodies import (
    STAND_IN,
    least_inertias,
    on_leaders,
    soft_springs,
    stand_in_approximations,
    with_stand_in,
)
from orbit_core.plugin_kit.closed_surfaces import inside_lattice, is_convex
from orbit_core.plugin_kit.engines import contact_signs, velocity_at
from orbit_core.plugin_kit.meshes import AXIS_COLORS, height_field_mesh, marker_shapes
from orbit_core.plugin_kit.rendering import DeformableSurface, HostRenderer, HostRequest, Pictures
from orbit_core.plugin_kit.rotations import compose, multiply, rotate, rotate_inverse
from orbit_core.plugin_kit.rows import block, host_rows, rows_of
from orbit_core.scene import (
    Articulation,
    CameraSpec,
    Channel,
    Fluid,
    HeightField,
    Joint,
    JointType,
    Link,
    MarkerShape,
    MarkerSpec,
    Mimic,
    RobotSpec,
    Rope,
    SoftBody,
)


def test_a_leader_bears_what_its_followers_have_by_the_ratio_squared() -> None:
    """Of a second robot too, whose joints come after those of the first."""
    links = tuple(Link(name, 1.0) for name in ("base", "a", "b", "c"))
    joints = (
        Joint("follower", JointType.CONTINUOUS, "base", "a", mimic=Mimic("leader", -3.0)),
        Joint("leader", JointType.CONTINUOUS, "base", "b"),
        Joint("alone", JointType.CONTINUOUS, "base", "c"),
    )
    hands = (RobotSpec(name=name, articulation=Articulation(name, links, joints)) for name in ("left", "right"))
    values = np.array([0.1, 1.0, 10.0, 0.2, 2.0, 20.0])
    borne = on_leaders(SceneLayout.of(scene(*hands)), values)
    assert borne == pytest.approx([0.0, 1.9, 10.0, 0.0, 3.8, 20.0])
    assert values[0] == 0.1


def test_velocities_at_another_point_are_those_of_a_turning_body() -> None:
    """A point 0.5 m along x of a body that turns at 2 rad/s about z moves at 1 m/s along y more, and back again."""
    velocity = torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0, 2.0]])
    arm = torch.tensor([[0.5, 0.0, 0.0]])
    moved = velocity_at(velocity, arm)
    assert moved.tolist() == [[1.0, 1.0, 0.0, 0.0, 0.0, 2.0]]
    assert torch.equal(velocity_at(moved, -arm), velocity)


def test_contact_signs_count_both_sides_of_a_pair() -> None:
    queries = (ContactQuery(0), ContactQuery(0, frozenset({TERRAIN})), ContactQuery(1, frozenset({0})))
    signs = contact_signs(queries, [(0, TERRAIN), (0, 1), (1, 2)])
    assert signs.tolist() == [[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]


def gimbal() -> Articulation:
    """A link of 2 kg on a hinge about x, on a link without mass, on a hinge about z."""
    bob = Link("bob", 2.0, inertia=np.diag([0.1, 0.2, 0.25]))
    joint = Joint("pivot", JointType.CONTINUOUS, "base", "bob", armature=0.5)
    links, joints = compound(joint, (BALL[2], BALL[0]))
    return Articulation("gimbal", (Link("base"), *links, bob), joints)


def test_the_least_inertia_of_a_joint_that_moves_a_link_without_mass_is_of_what_that_carries() -> None:
    layout = SceneLayout.of(scene(RobotSpec(name="gimbal", articulation=gimbal(), fixed_base=True)))
    np.testing.assert_allclose(least_inertias(layout), [0.5 + 0.1, 0.5 + 0.1])


@pytest.mark.parametrize(("stiffness", "soft"), [(0.0, True), (3.9e4, True), (4.1e4, False)])
def test_springs_are_soft_below_one_radian_of_natural_frequency_per_step(stiffness: float, soft: bool) -> None:
    layout = SceneLayout.of(scene(slider(mass=1.0, stiffness=stiffness)))
    assert soft_springs(layout, 0.005).tolist() == [soft]


def test_a_stand_in_is_a_share_of_what_a_link_without_mass_carries_and_is_reported() -> None:
    articulation = gimbal()
    base, ring, bob = articulation.links
    stand_in = with_stand_in(articulation, ring)
    assert stand_in.mass == pytest.approx(2.0 * STAND_IN)
    np.testing.assert_allclose(stand_in.inertia, 0.1 * STAND_IN * np.eye(3))
    assert with_stand_in(articulation, base) is base
    assert with_stand_in(articulation, bob) is bob
    layout = SceneLayout.of(scene(RobotSpec(name="gimbal", articulation=articulation, fixed_base=True)))
    (line,) = stand_in_approximations(layout.entities[0], "an engine")
    assert (line.subject, line.asked) == (f"link '{ring.name}' of 'gimbal'", "no mass")


def test_saved_commands_are_copies_and_come_back_in_place() -> None:
    plugin = backends.backend("mujoco")
    engine = plugin.create_engine(SceneLayout.of(scene(pendulum())), 2, torch.device("cpu"), plugin.config_type())
    buffer = engine.efforts
    engine.efforts.fill_(2.0)
    saved = engine.saved_commands()
    engine.efforts.zero_()
    engine.load_commands(saved)
    assert engine.efforts is buffer
    assert buffer.tolist() == [[2.0, 2.0], [2.0, 2.0]]
    engine.close()


def test_rotations_turn_there_and_back_for_any_number_of_leading_dimensions() -> None:
    """A quarter turn about z takes x to y; then one about x takes y to z."""
    half = np.sqrt(0.5)
    about_z, about_x = np.array([half, 0.0, 0.0, half]), np.array([half, half, 0.0, 0.0])
    x = np.broadcast_to([1.0, 0.0, 0.0], (2, 3, 3))
    turned = rotate(about_z, x)
    assert turned == pytest.approx(np.broadcast_to([0.0, 1.0, 0.0], (2, 3, 3)))
    assert rotate_inverse(about_z, turned) == pytest.approx(x)
    assert rotate(multiply(about_x, about_z), x) == pytest.approx(np.broadcast_to([0.0, 0.0, 1.0], (2, 3, 3)))
    position, orientation = compose(np.array([0.0, 0.0, 2.0]), about_z, np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    assert position == pytest.approx([0.0, 1.0, 2.0])
    assert orientation == pytest.approx(about_z)


def test_a_frame_has_an_arrow_of_its_colour_along_each_axis() -> None:
    shapes = marker_shapes(MarkerSpec("frame", MarkerShape.FRAME, size=0.4, color=(0.0, 0.0, 0.0, 0.5)))
    shafts = shapes[::2]
    for axis, (shaft, color) in enumerate(zip(shafts, AXIS_COLORS, strict=True)):
        assert shaft.color == pytest.approx((*color, 0.5))
        middle = np.zeros(3)
        middle[axis] = 0.15
        assert np.array(shaft.pose.position) == pytest.approx(middle)


class _Painter(HostRenderer):
    """Paints each environment's number and the height of its first link, whatever is asked for."""

    freed = 0

    def draw_pictures(self, request: HostRequest) -> Pictures:
        rgb, depth, links = request.canvas("rgb"), request.canvas("depth"), request.canvas("links")
        rgb[...] = request.environments[:, None, None, None]
        depth[...] = request.links[:, 0, 2, None, None, None]
        links[...] = 0 if request.markers is None else len(request.markers[0])
        return Pictures(rgb, depth, links=links)

    def free(self) -> None:
        self.freed += 1


CAMERA = CameraSpec(name="eye", width=6, height=4)
EYES = torch.tensor([[0.0, 0, 1, 1, 0, 0, 0]]).expand(2, 7)
LINKS = torch.tensor([[[0.0, 0, 0.25, 1, 0, 0, 0]], [[0.0, 0, 0.5, 1, 0, 0, 0]]])


def test_a_renderer_on_the_host_gives_the_wanted_fields_alone_as_tensors() -> None:
    painter = _Painter()
    image = painter.render(CAMERA, EYES, LINKS, (Channel.RGB, Channel.DEPTH), env_ids=torch.tensor([3, 1]))
    assert image.rgb is not None
    assert image.depth is not None
    assert (image.rgb.shape, image.rgb.dtype) == ((2, 4, 6, 3), torch.uint8)
    assert (image.depth.shape, image.depth.dtype) == ((2, 4, 6, 1), torch.float32)
    assert image.rgb[:, 0, 0, 0].tolist() == [3, 1]
    assert image.depth[:, 0, 0, 0].tolist() == [0.25, 0.5]
    assert image.links is image.normals is image.albedo is None


@pytest.mark.parametrize("channel", [Channel.INSTANCE, Channel.SEMANTIC])
def test_both_kinds_of_segmentation_are_served_by_links(channel: Channel) -> None:
    image = _Painter().render(CAMERA, EYES, LINKS, (channel,), marker_poses=torch.zeros(2, 5, 7))
    assert image.links is not None
    assert image.links.unique().tolist() == [5]
    assert image.rgb is image.depth is None


def test_a_renderer_is_freed_once_and_refuses_pictures_afterwards() -> None:
    painter = _Painter()
    painter.close()
    painter.close()
    assert painter.freed == 1
    with pytest.raises(ConfigurationError, match="the renderer is closed: make another"):
        painter.render(CAMERA, EYES, LINKS, (Channel.RGB,))


def test_rows_and_columns_pick_the_same_block_on_the_host_and_on_the_device() -> None:
    table = torch.arange(12.0).reshape(3, 4)
    columns, some = torch.tensor([3, 1]), torch.tensor([2, 0])
    for env_ids in (None, some):
        chosen = table[block(rows_of(env_ids), columns)]
        assert chosen.tolist() == table[[0, 1, 2] if env_ids is None else [2, 0]][:, [3, 1]].tolist()
        assert table.numpy()[block(host_rows(env_ids), columns.numpy())].tolist() == chosen.tolist()


def test_the_triangles_of_a_height_field_face_up_and_cover_it() -> None:
    vertices, faces = height_field_mesh(HeightField(np.random.default_rng(0).random((4, 6)), (3.0, 2.0)))
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert len(faces) == 2 * 3 * 5
    assert (normals[:, 2] > 0).all()
    assert 0.5 * normals[:, 2].sum() == pytest.approx(3.0 * 2.0)


def test_a_rope_is_drawn_as_a_tube_around_its_particles() -> None:
    points = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0.05]])
    surface = DeformableSurface(Rope("rope", points, 0.1, radius=0.01))
    vertices = surface.vertices(torch.as_tensor(points, dtype=torch.float32)[None])[0].numpy()
    assert surface.faces.max() == len(vertices) - 1
    nearest = np.linalg.norm(vertices[:, None] - points, axis=-1).min(axis=1)
    assert nearest == pytest.approx(0.01, rel=1e-4)


def test_a_fluid_is_its_particles_which_a_painter_draws_a_surface_around() -> None:
    fluid = Fluid("water", (0.01, 0.01, 0.02), spacing=0.01)
    surface = DeformableSurface(fluid)
    particles = torch.as_tensor(fluid.rest_positions, dtype=torch.float32)[None]
    assert torch.equal(surface.vertices(particles), particles)
    assert surface.faces.shape == (0, 3)


def test_a_soft_body_has_its_edges_sharp_and_its_curves_smooth() -> None:
    block = SoftBody("block", cuboid((0.1, 0.1, 0.1), (2, 2, 2)), 500.0)
    surface = DeformableSurface(block)
    points = torch.from_numpy(np.asarray(block.rest_positions)).float()[None]
    corners = surface.vertices(points)[0][torch.from_numpy(surface.faces)]
    assert torch.allclose(corners, points[0][torch.from_numpy(np.asarray(block.mesh.faces))])
    # Each of six sides has 3 x 3 vertices of its own.
    assert len(surface.vertices(points)[0]) == 54
    round_one = SoftBody("ball", ball(0.05, 2), 500.0)
    assert len(DeformableSurface(round_one).vertices(torch.zeros(1, len(round_one.rest_positions), 3))[0]) == len(
        round_one.rest_positions
    )


def test_a_surface_that_bulges_everywhere_touches_itself_nowhere() -> None:
    block, hollow = cuboid((0.05, 0.05, 0.05), (2, 2, 2)), ring(0.03, 0.01)
    assert is_convex(block.vertices, block.faces)
    assert not is_convex(hollow.vertices, hollow.faces)


def test_points_of_a_lattice_are_inside_of_a_ring_but_not_of_its_hole() -> None:
    mesh = ring(0.03, 0.01)
    line, middle = np.array((-0.03, 0.0, 0.03)), np.array((0.0, 0.02))
    found = inside_lattice((line, line, middle), np.asarray(mesh.vertices), np.asarray(mesh.faces))
    assert found[:, :, 0].tolist() == [[False, True, False], [True, False, True], [False, True, False]]
    assert not found[:, :, 1].any(), "above it"
