"""Images of every backend that draws, against closed forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from orbit_core import backends
from orbit_core.dynamics.transforms import pose_inverse, transform_points
from orbit_core.interfaces import BACKGROUND, TERRAIN, Backend, Capability, Image, Renderer, SceneLayout
from orbit_core.scene import (
    AmbientLight,
    Articulation,
    Box,
    CameraSpec,
    Capsule,
    Channel,
    Cylinder,
    DirectionalLight,
    HeightField,
    Link,
    MarkerShape,
    MarkerSpec,
    Mesh,
    ObjectSpec,
    Plane,
    Pose,
    Scene,
    Shape,
    Sphere,
    look_at,
)
from orbit_core.sensors import intrinsic_matrix, point_cloud, project
from orbit_core.world import simulate

GROUND = Shape(Plane(), color=(0.2, 0.3, 0.4, 1.0))
TETRAHEDRON = Mesh(
    np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.4, 0], [0, 0, 0.4]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
Draw = Callable[..., Image]


def entity(name: str, visuals: tuple[Shape, ...] = (), collisions: tuple[Shape, ...] = ()) -> ObjectSpec:
    link = Link(name, 1.0, inertia=np.eye(3) * 0.01, visuals=visuals, collisions=collisions)
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)))


def eye(position: tuple[float, float, float], target: tuple[float, float, float], **settings) -> CameraSpec:
    values = {"name": "eye", "width": 64, "height": 48, "vertical_fov": 0.8, "pose": look_at(position, target)}
    return CameraSpec(**values | settings)


def poses(*places: Pose) -> Tensor:
    return torch.tensor([(*place.position, *place.orientation) for place in places])


@pytest.fixture
def draw(backend: Backend, device: torch.device) -> Iterator[Draw]:
    """``draw(objects, terrain, camera, channels, link_poses)``: pictures of environments with those poses (n, L, 7)."""
    made: list[Renderer] = []

    def picture(
        objects: tuple[ObjectSpec, ...],
        terrain: tuple[Shape, ...],
        camera: CameraSpec,
        channels: tuple[Channel, ...],
        link_poses: Tensor,
    ) -> Image:
        for channel in channels:
            need = Capability.SEGMENTATION if channel is Channel.INSTANCE else Capability[channel.name]
            if not backend.capabilities().has(need):
                pytest.skip(f"{backend.name}: {backend.capabilities()[need].reason}")
        layout = SceneLayout.of(Scene(objects=objects, terrain=terrain, sensors=(camera,)))
        made.append(backend.create_renderer(layout, (camera,), backends.backend_config(backend)))
        camera_poses = poses(camera.pose).expand(len(link_poses), -1)
        image = made[-1].render(camera, camera_poses.to(device), link_poses.to(device), channels)
        return Image(**{name: None if values is None else values.cpu() for name, values in vars(image).items()})

    yield picture
    for renderer in made:
        renderer.close()


def pixel_rays(camera: CameraSpec) -> Tensor:
    """(H, W, 3) from the camera to points at depth 1, in the environment's axes."""
    depth = torch.ones(1, camera.height, camera.width, 1)
    ends = point_cloud(depth, intrinsic_matrix(camera), poses(camera.pose))[0]
    return ends - torch.tensor(camera.pose.position)


NO_LINKS = torch.zeros(1, 0, 7)


def test_depth_of_a_plane_seen_aslant(draw):
    camera = eye((0, 0, 2.0), (1.5, 0.3, 0.0))
    image = draw((), (GROUND,), camera, (Channel.DEPTH, Channel.INSTANCE), NO_LINKS)
    assert image.depth.shape == (1, 48, 64, 1)
    assert image.depth.dtype == torch.float32
    expected = -2.0 / pixel_rays(camera)[..., 2]
    torch.testing.assert_close(image.depth[0, ..., 0], expected, rtol=2e-4, atol=1e-4)
    assert (image.links == TERRAIN).all()


def test_depth_is_infinite_above_the_horizon_and_beyond_the_far_plane(draw):
    camera = eye((0, 0, 1.0), (1.0, 0, 1.0), far=20.0)
    image = draw((), (GROUND,), camera, (Channel.DEPTH, Channel.INSTANCE), NO_LINKS)
    expected = -1.0 / pixel_rays(camera)[..., 2]
    seen = (expected > 0) & (expected < 20.0)
    assert torch.equal(image.depth[0, ..., 0].isfinite(), seen)
    assert torch.equal(image.links[0, ..., 0] == BACKGROUND, ~seen)
    torch.testing.assert_close(image.depth[0, ..., 0][seen], expected[seen], rtol=2e-4, atol=1e-4)


def test_a_sphere_has_its_depth_outline_and_normals(draw):
    camera = eye((2.0, 0, 0), (0, 0, 0), vertical_fov=0.6)
    image = draw(
        (entity("ball", (Shape(Sphere(0.3)),)),), (), camera,
        (Channel.DEPTH, Channel.INSTANCE, Channel.NORMALS), poses(Pose())[None],
    )  # fmt: skip
    rays = pixel_rays(camera)
    position = torch.tensor(camera.pose.position)
    a, b = (rays * rays).sum(-1), (rays * position).sum(-1)
    root = b * b - a * ((position * position).sum() - 0.09)
    hit = root > 0
    # The outline may differ by the pixels that straddle it, and by the facets of a rasterised ball.
    assert ((image.links[0, ..., 0] == 0) != hit).float().mean() < 0.02
    inside = root > 0.01
    expected = (-b - root.clamp_min(0).sqrt()) / a
    torch.testing.assert_close(image.depth[0, ..., 0][inside], expected[inside], atol=4e-3, rtol=0)
    normals = (position + expected[..., None] * rays) / 0.3
    cosine = (image.normals[0] * normals).sum(-1)
    assert cosine[inside].min() > 0.99
    assert (image.normals[0][image.links[0, ..., 0] == BACKGROUND] == 0).all()


def test_the_faces_of_a_box_have_their_normals_in_world_axes(draw):
    turned = Pose.from_euler(0.0, 0.0, 0.5, (0, 0, 0.2))
    camera = eye((1.5, 0.4, 1.2), (0, 0, 0.2), vertical_fov=0.5)
    image = draw(
        (entity("box", (Shape(Box((0.3, 0.2, 0.2))),)),), (GROUND,), camera,
        (Channel.NORMALS, Channel.INSTANCE), poses(turned)[None],
    )  # fmt: skip
    rotation = torch.tensor(turned.rotation_matrix(), dtype=torch.float32)
    directions = torch.cat((rotation.T, -rotation.T))
    found = image.normals[0][image.links[0, ..., 0] == 0]
    cosine = found @ directions.T
    assert (cosine.max(-1).values > 0.99).float().mean() > 0.97
    assert len(cosine.argmax(-1).unique()) == 3
    ground = image.normals[0][image.links[0, ..., 0] == TERRAIN]
    assert (ground[:, 2] > 0.99).float().mean() > 0.97


def test_each_environment_is_drawn_from_its_own_poses(draw):
    camera = eye((0, 0, 3.0), (0, 0, 0.0))
    links = torch.stack([poses(Pose((0, 0, height))) for height in (0.1, 0.5, 1.0)])
    image = draw((entity("box", (Shape(Box((0.5, 0.5, 0.1))),)),), (GROUND,), camera, (Channel.DEPTH,), links)
    torch.testing.assert_close(image.depth[:, 24, 32, 0], torch.tensor([2.8, 2.4, 1.9]), atol=1e-3, rtol=0)
    torch.testing.assert_close(image.depth[:, 0, 0, 0], torch.tensor([3.0, 3.0, 3.0]), atol=1e-3, rtol=0)


@pytest.mark.parametrize(
    ("geometry", "height"),
    [
        (Box((0.2, 0.1, 0.3)), 0.3),
        (Sphere(0.25), 0.25),
        (Capsule(0.1, 0.2), 0.3),
        (Cylinder(0.1, 0.2), 0.2),
        (TETRAHEDRON, None),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, float | None) else "",
)
def test_every_shape_stands_where_and_as_high_as_it_should(draw, geometry, height):
    aside = 1e-3  # no pixel's centre lies on an edge, where which side is drawn is the renderer's choice
    camera = eye((aside, aside, 2.0), (aside, aside, 0), width=65, height=65)
    shape = Shape(geometry, Pose((0.0, 0.0, 0.1)))
    image = draw(
        (entity("thing", (shape,)),), (), camera, (Channel.DEPTH, Channel.INSTANCE), poses(Pose((0, 0, 0.2)))[None]
    )
    if height is None:  # the tetrahedron's apex stands at the middle, so the image's centre sees just beside it
        height = 0.4
    assert image.depth[0, 32, 32].item() == pytest.approx(2.0 - 0.3 - height, abs=0.012)
    assert (image.links >= 0).any()


def test_a_sphere_is_seen_where_its_centre_projects(draw):
    camera = eye((2.0, -1.0, 1.5), (0, 0, 0.3), width=96, height=64)
    centers = [(0.3, 0.2, 0.4), (-0.4, 0.1, 0.2), (0.0, -0.3, 0.8)]
    links = torch.stack([poses(Pose(center)) for center in centers])
    image = draw((entity("ball", (Shape(Sphere(0.05)),)),), (GROUND,), camera, (Channel.INSTANCE,), links)
    for index, center in enumerate(centers):
        rows, columns = (image.links[index, ..., 0] == 0).nonzero(as_tuple=True)
        local = transform_points(pose_inverse(poses(camera.pose)), torch.tensor([center]))
        expected = project(local, intrinsic_matrix(camera))[0]
        seen = torch.stack((columns.float().mean() + 0.5, rows.float().mean() + 0.5))
        torch.testing.assert_close(seen, expected, atol=0.6, rtol=0)


def test_colours_are_those_of_the_visual_shapes(draw):
    red, blue = (0.9, 0.1, 0.1, 1.0), (0.1, 0.1, 0.9, 1.0)
    things = (
        entity("dressed", (Shape(Sphere(0.3), color=red),), (Shape(Sphere(0.4), color=blue),)),
        entity("bare", (), (Shape(Sphere(0.3), color=blue),)),
    )
    camera = eye((3.0, 0, 0), (0, 0, 0))
    links = poses(Pose((0, -0.5, 0)), Pose((0, 0.5, 0)))[None]
    image = draw(things, (), camera, (Channel.RGB, Channel.INSTANCE), links)
    assert image.rgb.dtype == torch.uint8
    for index, channel in ((0, 0), (1, 2)):
        color = image.rgb[0][image.links[0, ..., 0] == index].float().mean(0)
        assert color.argmax() == channel
        assert color[channel] > 2 * color[1]


def test_a_nearer_thing_hides_a_farther_one(draw):
    things = (entity("far", (Shape(Box((0.01, 0.5, 0.5))),)), entity("near", (Shape(Box((0.01, 0.2, 0.2))),)))
    camera = eye((2.0, 0, 0), (0, 0, 0))
    image = draw(things, (), camera, (Channel.INSTANCE, Channel.DEPTH), poses(Pose(), Pose((1.0, 0, 0)))[None])
    assert image.links[0, 24, 32].item() == 1
    assert image.depth[0, 24, 32].item() == pytest.approx(0.99, abs=1e-3)
    assert set(image.links.unique().tolist()) == {BACKGROUND, 0, 1}


def test_a_height_field_rises_along_x_and_y_as_given(draw):
    rows, columns = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 41), indexing="ij")
    slope = Shape(HeightField(0.5 * columns + 0.2 * rows + 0.1, (4.0, 2.0)))
    camera = eye((0.6, 0.3, 3.0), (0.6, 0.3, 0.0), vertical_fov=0.3)
    image = draw((), (slope,), camera, (Channel.DEPTH,), NO_LINKS)
    points = point_cloud(image.depth, intrinsic_matrix(camera), poses(camera.pose))[0]
    x, y, z = points.unbind(-1)
    torch.testing.assert_close(z, 0.5 * (x + 2.0) / 4.0 + 0.2 * (y + 1.0) / 2.0 + 0.1, atol=2e-3, rtol=0)


def test_only_channels_asked_for_come_back(draw):
    camera = eye((0, 0, 2.0), (0, 0, 0))
    image = draw((), (GROUND,), camera, (Channel.RGB,), NO_LINKS)
    assert image.rgb is not None
    assert image.depth is None
    assert image.normals is None
    assert image.links is None


def test_an_arrow_marker_is_as_long_as_it_says(backend, device):
    if not backend.capabilities().has(Capability.RGB):
        pytest.skip(f"{backend.name}: {backend.capabilities()[Capability.RGB].reason}")
    camera = eye((2.0, 0, 0.5), (0, 0, 0.5))
    arrow = MarkerSpec("arrow", MarkerShape.ARROW, 0.6, (1.0, 0.0, 0.0, 1.0))
    layout = SceneLayout.of(Scene(terrain=(), sensors=(camera,), markers=(arrow,)))
    renderer = backend.create_renderer(layout, (camera,), backends.backend_config(backend))
    along_y = poses(Pose.from_euler(0.0, 0.0, np.pi / 2, (0.0, -0.1, 0.5)))
    images = [
        renderer.render(camera, poses(camera.pose).to(device), NO_LINKS.to(device), (Channel.RGB,), markers).rgb[0]
        for markers in (along_y[None].to(device), None)
    ]
    columns = ((images[0].cpu().float() - images[1].cpu().float()).abs().sum(-1) > 60).any(0).nonzero().ravel()
    ends = torch.tensor([[0.0, -0.1, 0.5], [0.0, 0.5, 0.5]])
    expected = project(transform_points(pose_inverse(poses(camera.pose)), ends), intrinsic_matrix(camera))[:, 0]
    seen = torch.tensor([columns.min(), columns.max() + 1.0])
    torch.testing.assert_close(seen, expected.sort().values, atol=3.0, rtol=0)  # the tip is thinner than a pixel
    renderer.close()


def test_positions_lie_on_the_surfaces_that_are_seen(backend, device):
    """Through the camera sensor, which has them from depth: a ball turned with its link, on a level ground."""
    need = Capability.DEPTH
    if not backend.capabilities().has(need):
        pytest.skip(f"{backend.name}: {backend.capabilities()[need].reason}")
    camera = eye((1.5, -0.8, 0.9), (0.2, 0.1, 0.0), channels=(Channel.POSITION, Channel.INSTANCE), far=3.0)
    center, radius = torch.tensor((0.2, 0.1, 0.2)), 0.2
    ball = replace(entity("ball", (Shape(Sphere(radius)),)), pose=Pose(tuple(center.tolist())), fixed_base=True)
    world = simulate(Scene(objects=(ball,), terrain=(GROUND,), sensors=(camera,)), 2, backend.name, device=device)
    sensor = world.sensors["eye"]
    points, seen = sensor.image(Channel.POSITION).cpu(), sensor.image(Channel.INSTANCE)[..., 0].cpu()
    assert points.shape == (2, 48, 64, 3)
    assert points.dtype == torch.float32
    distance = (points[seen == 0] - center).norm(dim=-1)
    assert len(distance) > 100
    torch.testing.assert_close(distance, torch.full_like(distance, radius), atol=6e-3, rtol=0)
    ground = points[seen == -2]
    torch.testing.assert_close(ground[:, 2], torch.zeros(len(ground)), atol=1e-3, rtol=0)
    missed = seen == -1
    assert missed.any()
    assert points[missed].isinf().all()
    # And each lies on its own pixel's ray.
    rays = pixel_rays(camera)[~missed[0]]
    ends = points[0][~missed[0]] - torch.tensor(camera.pose.position)
    assert torch.cosine_similarity(rays, ends, dim=-1).min() > 0.99999
    world.close()


def test_albedo_is_the_shapes_own_colour_in_light_and_shade(draw):
    """A ball under a lid that shades it; both of a link with two colours."""
    lid, ball, ground = (0.8, 0.5, 0.1, 1.0), (0.1, 0.6, 0.9, 1.0), GROUND.color
    shapes = (Shape(Box((0.6, 0.6, 0.02)), Pose((0, 0, 0.5)), color=lid), Shape(Sphere(0.2), color=ball))
    camera = eye((2.0, 0.3, 0.9), (0, 0, 0.3), far=3.0)
    image = draw(
        (entity("shaded", shapes),), (GROUND,), camera,
        (Channel.ALBEDO, Channel.RGB, Channel.INSTANCE), poses(Pose((0, 0, 0.2)))[None],
    )  # fmt: skip
    assert image.albedo.shape == (1, 48, 64, 3)
    assert image.albedo.dtype == torch.uint8
    links = image.links[0, ..., 0]
    colors = torch.tensor([lid, ball, ground])[:, :3] * 255.0
    nearest = torch.cdist(image.albedo[0].float(), colors).min(-1)
    seen = links != BACKGROUND
    assert nearest.values[seen].max() < 1.8  # one step of each channel
    assert set(nearest.indices[links == 0].tolist()) == {0, 1}
    assert set(nearest.indices[links == TERRAIN].tolist()) == {2}
    assert (image.albedo[0][~seen] == 0).all()
    assert (image.rgb[0][links == 0].float().std(0) > 5.0).any(), "the light on the same pixels does vary"


def test_lights_add_up_and_only_darken_where_there_is_a_shadow(backend, device):
    """A level lid above the ground: its top, and the ground in its shade and beside it, from straight above."""
    for need in (Capability.LIGHTING, Capability.SHADOWS):
        if not backend.capabilities().has(need):
            pytest.skip(f"{backend.name}: {backend.capabilities()[need].reason}")
    camera = eye((0, 0, 4.0), (0, 1e-4, 0), width=48, height=48, vertical_fov=0.8)
    lid = entity("lid", (Shape(Box((0.3, 0.3, 0.05)), color=(0.5, 0.4, 0.2, 1.0)),))
    sun, lamp = DirectionalLight((0.0, 1.0, -1.0), (1.0, 0.5, 0.5), 0.5), DirectionalLight((0, 0, -1), intensity=0.2)
    lights = (AmbientLight((0.1, 0.2, 0.3)), sun, replace(lamp, shadows=False))
    layout = SceneLayout.of(Scene(objects=(lid,), terrain=(GROUND,), sensors=(camera,), lights=lights))
    renderer = backend.create_renderer(layout, (camera,), backends.backend_config(backend))
    links = poses(Pose((0, 0, 0.65)))[None].to(device)
    rgb = renderer.render(camera, poses(camera.pose).to(device), links, (Channel.RGB,)).rgb[0].cpu().float()
    renderer.close()
    pixel = 2 * np.tan(0.4) * 4.0 / 48  # metres on the ground
    around, straight = torch.tensor((0.1, 0.2, 0.3)), 0.2 * torch.tensor(lamp.color)
    slanted = 0.5 * np.sqrt(0.5) * torch.tensor(sun.color)
    ground = 255 * torch.tensor(GROUND.color[:3])
    top = 255 * torch.tensor((0.5, 0.4, 0.2))
    torch.testing.assert_close(rgb[24, 24], top * (around + straight + slanted), atol=2.0, rtol=0)
    torch.testing.assert_close(rgb[44, 24], ground * (around + straight + slanted), atol=2.0, rtol=0)
    # The upper edge of the lid's farther side, 0.7 m above the ground, has its shadow at y = 0.3 + 0.7.
    edge = int(24 - 1.0 / pixel)  # the row that it falls in; y is largest in the uppermost
    torch.testing.assert_close(rgb[edge + 1, 24], ground * (around + straight), atol=2.0, rtol=0)
    torch.testing.assert_close(rgb[edge - 1, 24], ground * (around + straight + slanted), atol=2.0, rtol=0)
