"""Boxes around entities: where closed forms of the pinhole camera put them, hidden or not, in view or not."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from orbit_core.interfaces import ConfigurationError, UnknownNameError, World
from orbit_core.scene import (
    Articulation,
    Box,
    CameraSpec,
    Capsule,
    Channel,
    Cylinder,
    Joint,
    JointType,
    Link,
    Mesh,
    ObjectSpec,
    Plane,
    Pose,
    Scene,
    Shape,
    Sphere,
    look_at,
    single_link,
)
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors import CameraSensor
from orbit_core.world import simulate
from orbit_data.bounding_boxes import CameraBoxes

SIZE, FOV = 128, 0.8
FOCAL = 0.5 * SIZE / math.tan(0.5 * FOV)
# Looks along +x from the origin: pixels' columns run along -y, rows along -z.
AHEAD = look_at((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
NAMES = ("ball", "crate")


def camera(**settings: object) -> CameraSpec:
    values = {"width": SIZE, "height": SIZE, "vertical_fov": FOV, "pose": AHEAD, "channels": (Channel.INSTANCE,)}
    return CameraSpec(name="camera", **values | settings)


def thing(name: str, geometry: Geometry, pose: Pose, label: str = "") -> ObjectSpec:
    articulation = single_link(name, Shape(geometry), 1.0, np.eye(3) * 0.01)
    return ObjectSpec(name=name, articulation=articulation, pose=pose, fixed_base=True, semantic_label=label)


def sphere_box(radius: float, x: float, y: float, z: float) -> list[float]:
    """The tangents from the camera's centre: at the centre's angle plus and minus asin(radius / distance)."""
    sides = []
    for across in (-y, -z):
        angle, half = math.atan2(across, x), math.asin(radius / math.hypot(across, x))
        sides.append([SIZE / 2 + FOCAL * math.tan(angle + sign * half) for sign in (-1, 1)])
    (left, right), (top, bottom) = sides
    return [left, top, right, bottom]


def points_box(points: np.ndarray) -> list[float]:
    u, v = SIZE / 2 - FOCAL * points[:, 1] / points[:, 0], SIZE / 2 - FOCAL * points[:, 2] / points[:, 0]
    return [u.min(), v.min(), u.max(), v.max()]


def corners(half: tuple[float, float, float], pose: Pose) -> np.ndarray:
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return pose.transform(signs * half)


BALL = thing("ball", Sphere(0.2), Pose((2.0, 0.3, 0.1)), "toy")
CRATE_POSE = Pose.from_euler(0.3, 0.2, 0.5, (2.5, -0.4, -0.2))
CRATE = thing("crate", Box((0.2, 0.3, 0.15)), CRATE_POSE)
SCREEN = thing("screen", Box((0.01, 0.4, 0.4)), Pose((1.0, 0.5, 0.0)))  # hides what lies left of y = 0.1 x


@pytest.fixture
def look() -> Iterator:
    """``look(scene, backend, num_envs)``: the camera of a world; closed after the test."""
    made: list[World] = []

    def make(*things: ObjectSpec, backend: str = "mujoco", num_envs: int = 2, **settings: object) -> CameraSensor:
        scene = Scene(objects=things, sensors=(camera(**settings),), terrain=())
        made.append(simulate(scene, num_envs, backend))
        sensor = made[-1].sensors["camera"]
        assert isinstance(sensor, CameraSensor)
        return sensor

    yield make
    for world in made:
        world.close()


@pytest.mark.parametrize("backend", ["mujoco", "bullet"])
def test_boxes_of_a_ball_and_a_crate_are_those_of_the_pinhole_camera(look, backend):
    boxes = CameraBoxes(look(BALL, CRATE, backend=backend)).in_pictures()
    truth = torch.tensor([sphere_box(0.2, *BALL.pose.position), points_box(corners((0.2, 0.3, 0.15), CRATE_POSE))])
    assert boxes.names == NAMES
    assert boxes.semantic_labels == ("toy", "crate")
    torch.testing.assert_close(boxes.loose, truth.expand(2, -1, -1).float(), atol=2e-3, rtol=0)
    # A pixel shows what lies at its centre, so a tight box ends within half a pixel of the outline; balls are facets.
    assert (boxes.tight - truth).abs().max() <= (0.51 if backend == "mujoco" else 1.0)
    assert boxes.visible.all()
    assert boxes.in_view.all()
    assert (boxes.visible_share > 0.9).all()
    ellipse = math.pi / 4 * (truth[0, 2] - truth[0, 0]) * (truth[0, 3] - truth[0, 1])
    assert boxes.pixels[0, 0].item() == pytest.approx(ellipse.item(), rel=0.03)


@pytest.mark.parametrize("backend", ["mujoco", "bullet"])
def test_what_hides_an_entity_changes_the_tight_box_alone(look, backend):
    free = CameraBoxes(look(BALL, CRATE, backend=backend)).in_pictures(NAMES)
    hidden = CameraBoxes(look(BALL, CRATE, SCREEN, backend=backend)).in_pictures(NAMES)
    torch.testing.assert_close(hidden.loose, free.loose)
    torch.testing.assert_close(hidden.tight[:, 1], free.tight[:, 1])
    edge = SIZE / 2 - FOCAL * 0.1 / 0.99  # of the screen's near face
    assert (hidden.tight[:, 0, 0] - edge).abs().max() <= 1.0
    torch.testing.assert_close(hidden.tight[:, 0, 2], free.tight[:, 0, 2])
    assert (hidden.visible_share[:, 0] < 0.7 * free.visible_share[:, 0]).all()
    assert hidden.in_view.all()


def test_what_is_wholly_hidden_is_in_view_and_not_visible(look):
    wall = thing("wall", Box((0.01, 1.0, 1.0)), Pose((1.0, 0.0, 0.0)))
    boxes = CameraBoxes(look(BALL, wall)).in_pictures(("ball",))
    assert boxes.in_view.all()
    assert not boxes.visible.any()
    assert (boxes.tight == 0).all()
    assert (boxes.visible_share == 0).all()


@pytest.mark.parametrize("position", [(-2.0, 0.0, 0.0), (2.0, 3.0, 0.0), (2.0, 0.0, -3.0)])
def test_what_is_out_of_view_has_no_box(look, position):
    boxes = CameraBoxes(look(thing("ball", Sphere(0.2), Pose(position)))).in_pictures()
    assert not boxes.in_view.any()
    assert not boxes.visible.any()
    assert (boxes.tight == 0).all()
    assert (boxes.loose == 0).all()


def test_a_box_is_cut_off_at_the_images_edge_and_its_share_is_not(look):
    boxes = CameraBoxes(look(thing("ball", Sphere(0.2), Pose((1.0, math.tan(FOV / 2), 0.0))))).in_pictures()
    left, _, right, _ = sphere_box(0.2, 1.0, math.tan(FOV / 2), 0.0)
    assert boxes.loose[0, 0, 0] == boxes.tight[0, 0, 0] == 0.0
    assert boxes.loose[0, 0, 2].item() == pytest.approx(right, abs=1e-3)
    assert boxes.visible_share[0, 0].item() == pytest.approx(right / (right - left), abs=0.03)


def test_a_thing_that_reaches_through_the_near_plane_fills_the_image_where_it_passes_the_camera(look):
    beam = thing("beam", Box((2.0, 0.05, 0.05)), Pose((0.0, 0.0, -0.1)))
    boxes = CameraBoxes(look(beam)).in_pictures()
    left, top, right, bottom = boxes.loose[0, 0].tolist()
    assert (left, right, bottom) == (0.0, SIZE, SIZE)
    assert top == pytest.approx(SIZE / 2 + FOCAL * 0.05 / 2.0, abs=1e-3)


def _octahedron() -> Mesh:
    ends = [(0.3, 0, 0), (-0.3, 0, 0), (0, 0.2, 0), (0, -0.2, 0), (0, 0, 0.4), (0, 0, -0.1)]
    faces = [(a, b, c) if (a + b + c) % 2 else (b, a, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)]
    return Mesh(np.array(ends), np.array(faces))


ROUND = Pose.from_euler(0.7, -0.4, 0.3, (2.0, 0.2, -0.1))


@pytest.mark.parametrize("geometry", [Capsule(0.1, 0.3), Cylinder(0.2, 0.3), Box((0.1, 0.2, 0.3)), _octahedron()])
def test_loose_boxes_bound_the_points_of_the_surface(look, geometry):
    truth = points_box(ROUND.transform(_surface(geometry)))
    assert_allclose(CameraBoxes(look(thing("it", geometry, ROUND))).in_pictures().loose[0, 0], truth, atol=5e-3)


def _surface(geometry: Geometry) -> np.ndarray:
    """Points all over what bounds the geometry."""
    turn, tilt = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 2 * np.pi, 2001), np.linspace(0, np.pi, 501)))
    match geometry:
        case Capsule(radius, half_length):
            ball = np.stack((np.cos(turn) * np.sin(tilt), np.sin(turn) * np.sin(tilt), np.cos(tilt)), -1) * radius
            end = np.array((0.0, 0.0, half_length))
            return np.concatenate((ball + end, ball - end))
        case Cylinder(radius, half_length):
            return np.stack((np.cos(turn) * radius, np.sin(turn) * radius, half_length * np.sign(tilt - 1.0)), -1)
        case Box(half_extents):
            return corners(half_extents, Pose())
        case Mesh():
            return geometry.vertices
    raise AssertionError(geometry)


def test_a_detailed_mesh_has_the_box_of_all_its_vertices(look):
    random = np.random.default_rng(0)
    vertices = random.normal(size=(500, 3)) * (0.1, 0.2, 0.05)
    faces = np.arange(498)[:, None] + np.arange(3)
    boxes = CameraBoxes(look(thing("it", Mesh(vertices, faces), ROUND))).in_pictures()
    assert_allclose(boxes.loose[0, 0], points_box(ROUND.transform(vertices)), atol=2e-3)


def _lamp() -> ObjectSpec:
    """A foot, and an arm that a joint turns about z, its ball 0.5 m out."""
    links = (
        Link("foot", 1.0, inertia=np.eye(3), visuals=(Shape(Box((0.1, 0.1, 0.05))),)),
        Link("arm", 1.0, inertia=np.eye(3), visuals=(Shape(Sphere(0.1), pose=Pose((0.5, 0.0, 0.2))),)),
    )
    joints = (Joint("turn", JointType.CONTINUOUS, "foot", "arm"),)
    articulation = Articulation("lamp", links, joints)
    pose = Pose.from_euler(0.0, 0.0, math.pi / 2, (2.0, 0.0, 0.0))
    return ObjectSpec(name="lamp", articulation=articulation, pose=pose, fixed_base=True, home={"turn": math.pi / 2})


def test_boxes_in_space_have_the_roots_orientation_and_follow_the_joints(look):
    sensor = look(_lamp(), BALL)
    boxes = CameraBoxes(sensor).in_space()
    assert boxes.names == ("lamp", "ball")
    # In the foot's frame the arm's ball stands at (0, 0.5, 0.2): the box spans x +-0.1, y -0.1..0.6, z -0.05..0.3.
    assert_allclose(boxes.half_extents[0, 0], (0.1, 0.35, 0.175), atol=1e-6)
    assert_allclose(boxes.poses[0, 0, :3], (2.0 - 0.25, 0.0, 0.125), atol=1e-6)
    assert_allclose(boxes.poses[0, 0, 3:], (math.sqrt(0.5), 0, 0, math.sqrt(0.5)), atol=1e-6)
    assert_allclose(boxes.corners[0, 0].amin(0), (1.4, -0.1, -0.05), atol=1e-6)
    assert_allclose(boxes.corners[0, 0].amax(0), (2.1, 0.1, 0.3), atol=1e-6)


def test_links_have_boxes_of_their_own_and_the_camera_sees_them_ahead(look):
    boxes = CameraBoxes(look(_lamp(), BALL)).in_space(("lamp",), of_links=True, in_camera_frame=True)
    assert boxes.names == ("lamp/foot", "lamp/arm")
    assert_allclose(boxes.half_extents[0], [(0.1, 0.1, 0.05), (0.1, 0.1, 0.1)], atol=1e-6)
    assert_allclose(boxes.poses[0, :, :3], [(0.0, 0.0, -2.0), (0.0, 0.2, -1.5)], atol=1e-6)


def test_each_environment_has_the_box_of_its_variant(look):
    kinds = tuple(single_link("it", Shape(Sphere(radius)), 1.0, np.eye(3) * 0.01) for radius in (0.1, 0.2))
    varied = ObjectSpec(
        name="it", articulation=kinds[0], variants=kinds[1:], pose=Pose((2.0, 0.0, 0.0)), fixed_base=True
    )
    sensor = look(varied, num_envs=3)
    truth = torch.tensor([sphere_box(radius, 2.0, 0.0, 0.0) for radius in (0.1, 0.2, 0.1)])
    torch.testing.assert_close(CameraBoxes(sensor).in_pictures().loose[:, 0], truth, atol=1e-3, rtol=0)
    assert_allclose(CameraBoxes(sensor).in_space().half_extents[:, 0, 0], (0.1, 0.2, 0.1), atol=1e-6)


def test_boxes_are_of_the_time_of_the_picture(look):
    free = single_link("ball", Shape(Sphere(0.2)), 1.0, np.eye(3) * 0.01)
    sensor = look(ObjectSpec(name="ball", articulation=free, pose=Pose((2.0, 0.0, 0.0))), rate=20.0)
    before = CameraBoxes(sensor).in_pictures()
    sensor.engine.write_root_state(0, torch.tensor([[2.0, 0.5, 0, 1, 0, 0, 0]] * 2), None)
    held = CameraBoxes(sensor).in_pictures()
    torch.testing.assert_close(held.loose, before.loose)
    assert_allclose(CameraBoxes(sensor).in_space().poses[:, 0, 1], 0.0, atol=1e-6)


def test_what_cannot_be_asked_for_is_told(look):
    with pytest.raises(ConfigurationError, match="no instance channel: add it"):
        CameraBoxes(look(BALL, channels=(Channel.DEPTH,))).in_pictures()
    with pytest.raises(UnknownNameError, match="unknown entity 'bal' in the picture: did you mean 'ball'"):
        CameraBoxes(look(BALL)).in_pictures(("bal",))


def test_an_entity_without_bounds_has_no_box(look):
    floor = thing("floor", Plane(), Pose((0.0, 0.0, -1.0)))
    assert CameraBoxes(look(BALL, floor)).in_pictures().names == ("ball",)
