"""What is the Warp renderer's own: markers, transparency, shadows, numbers of environments, and MuJoCo's view of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from mujoco_warp._src.types import GeomType

from orbit_core import backends
from orbit_core.envs import make
from orbit_core.interfaces import BACKGROUND, ConfigurationError, Image, SceneLayout
from orbit_core.scene import (
    Box,
    CameraSpec,
    Channel,
    MarkerShape,
    MarkerSpec,
    Mesh,
    ObjectSpec,
    Plane,
    Scene,
    Shape,
    look_at,
    single_link,
)
from orbit_warp import WarpConfig
from orbit_warp.renderer import WarpRenderer
from orbit_warp.renderer_trace import trace_kernel

CAMERA = CameraSpec(name="camera", width=64, height=48, pose=look_at((0.8, 0, 0.8), (0, 0, 0)))
HERE = (0.0, 0, 0.1, 1, 0, 0, 0)
GEOMETRY = (Channel.DEPTH, Channel.INSTANCE, Channel.NORMALS, Channel.ALBEDO)


def renderer(
    *markers: MarkerSpec, color: tuple[float, float, float, float] = (0.8, 0.2, 0.2, 1.0), shadows: bool = True
) -> WarpRenderer:
    box = single_link("box", Shape(Box((0.1, 0.1, 0.1)), color=color), 1.0, np.eye(3) * 0.01)
    scene = Scene(objects=(ObjectSpec(name="box", articulation=box),), terrain=(Shape(Plane()),), markers=markers)
    return WarpRenderer(SceneLayout.of(scene), WarpConfig(shadows=shadows))


def draw(
    source: WarpRenderer, *channels: Channel, links: tuple = (HERE,), markers: torch.Tensor | None = None
) -> Image:
    poses = torch.tensor(links, dtype=torch.float32)[:, None]
    camera = torch.tensor([(*CAMERA.pose.position, *CAMERA.pose.orientation)]).expand(len(links), -1)
    return source.render(CAMERA, camera, poses, channels, markers)


def rgb(source: WarpRenderer, markers: torch.Tensor | None = None) -> torch.Tensor:
    image = draw(source, Channel.RGB, markers=markers)
    assert image.rgb is not None
    return image.rgb[0].float()


def test_shadows_only_darken_and_can_be_left_out():
    lit, shaded = rgb(renderer(shadows=False)), rgb(renderer())
    assert (shaded <= lit).all()
    assert 0.005 < ((lit - shaded) > 20).any(-1).float().mean() < 0.5


@pytest.mark.parametrize("shape", MarkerShape)
def test_markers_are_drawn_in_colour_alone(shape):
    source = renderer(MarkerSpec("goal", shape, 0.3, (0.1, 0.9, 0.1, 1.0)))
    marker = torch.tensor([[[0.2, 0.2, 0.2, 1.0, 0, 0, 0]]])
    changed = (rgb(source, marker) - rgb(source)).abs() > 30
    assert changed.any(-1).sum() > 10
    plain, marked = draw(source, *GEOMETRY), draw(source, *GEOMETRY, Channel.RGB, markers=marker)
    for name in ("depth", "links", "normals", "albedo"):
        assert torch.equal(getattr(plain, name), getattr(marked, name)), name


def test_a_marker_that_is_not_drawn_is_not_seen_through_glass_either():
    """The marker lies behind the box, where the picture before left it."""
    glass = renderer(MarkerSpec("goal", MarkerShape.BOX, 0.3, (0.1, 0.9, 0.1, 1.0)), color=(0.8, 0.2, 0.2, 0.5))
    before = rgb(glass)
    marked = rgb(glass, torch.tensor([[[-0.3, 0.0, 0.2, 1.0, 0, 0, 0]]]))
    assert ((marked - before).abs() > 30).any(-1).sum() > 10
    assert torch.equal(rgb(glass), before)


def test_a_transparent_shape_shows_what_is_behind_it_and_is_solid_to_depth():
    glass, solid = renderer(color=(0.8, 0.2, 0.2, 0.5), shadows=False), renderer(shadows=False)
    nothing = renderer(color=(0.8, 0.2, 0.2, 0.001), shadows=False)
    half = 0.5 * (rgb(solid) + rgb(nothing))
    torch.testing.assert_close(rgb(glass), half, atol=2.0, rtol=0)
    for name in ("depth", "links"):
        assert torch.equal(getattr(draw(glass, *GEOMETRY), name), getattr(draw(solid, *GEOMETRY), name))


def test_each_environment_is_drawn_alike_whatever_their_number():
    places = tuple((0.05 * i, 0.02 * i, 0.1, 1.0, 0, 0, 0) for i in range(5))
    source = renderer()
    all_channels = (*GEOMETRY, Channel.RGB)
    alone = [draw(renderer(), *all_channels, links=(place,)) for place in places]
    for chosen in ((0, 1), (0, 1, 2, 3, 4), (3,), (4, 2)):  # more than before, and fewer
        together = draw(source, *all_channels, links=tuple(places[i] for i in chosen))
        for row, i in enumerate(chosen):
            assert torch.equal(together.rgb[row], alone[i].rgb[0])
            assert torch.equal(together.depth[row], alone[i].depth[0])
            assert torch.equal(together.links[row], alone[i].links[0])


def test_open_meshes_are_seen_from_the_front_alone():
    sheet = Mesh(
        np.array([[-0.3, -0.3, 0], [0.3, -0.3, 0], [0.3, 0.3, 0], [-0.3, 0.3, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    body = single_link("sheet", Shape(sheet), 1.0, np.eye(3) * 0.01)
    source = WarpRenderer(
        SceneLayout.of(Scene(objects=(ObjectSpec(name="s", articulation=body),), terrain=())), WarpConfig()
    )
    front, back = (draw(source, Channel.INSTANCE, links=(pose,)).links for pose in (HERE, (0.0, 0, 0.1, 0, 1, 0, 0)))
    assert (front == 0).float().mean() > 0.1
    assert (back == BACKGROUND).all()


def test_a_task_looks_as_with_mujoco():
    """The same shapes at the same places in much the same light, of a scene with meshes."""
    environment = make("Lift", 1, "mujoco", seed=3)
    camera = CameraSpec(name="view", width=96, height=72, pose=look_at((1.3, -0.9, 0.9), (0.35, 0.0, 0.2)))
    pose = torch.tensor([(*camera.pose.position, *camera.pose.orientation)])
    images = []
    # Every triangle: a mesh as fine as the picture needs may be off by a pixel where it bends away.
    for name, settings in (("mujoco", {"simplify_meshes": False}), ("warp", {})):
        backend = backends.backend(name)
        config = backends.backend_config(backend, settings)
        source = backend.create_renderer(environment.world.layout, (camera,), config)
        images.append(source.render(camera, pose, environment.world.engine.link_poses, (Channel.RGB, *GEOMETRY)))
        source.close()
    theirs, mine = images
    same = theirs.links == mine.links
    assert same.float().mean() > 0.999
    torch.testing.assert_close(mine.depth[same], theirs.depth[same], atol=2e-3, rtol=1e-3)
    assert (mine.rgb.float() - theirs.rgb.float()).abs().mean() < 10
    assert (
        (mine.normals * theirs.normals).sum(-1)[same[..., 0] & (theirs.links[..., 0] != BACKGROUND)] > 0.99
    ).float().mean() > 0.99
    environment.close()


def test_a_scene_of_nothing_is_all_sky():
    source = WarpRenderer(SceneLayout.of(Scene(terrain=())), WarpConfig())
    pose = torch.tensor([(*CAMERA.pose.position, *CAMERA.pose.orientation)])
    image = source.render(CAMERA, pose, torch.zeros(1, 0, 7), (Channel.RGB, *GEOMETRY))
    assert image.depth.isinf().all()
    assert (image.links == BACKGROUND).all()
    assert (image.rgb > 100).all()


def test_a_closed_renderer_says_so():
    source = renderer()
    source.close()
    source.close()
    with pytest.raises(ConfigurationError, match="closed"):
        rgb(source)


def test_the_kernel_for_opaque_scenes_draws_as_the_general_one(monkeypatch):
    """On a GPU scenes without glass and markers have a smaller kernel; a CPU takes the general one for all."""
    general = draw(renderer(), Channel.RGB, *GEOMETRY)
    monkeypatch.setattr(
        "orbit_warp.renderer.trace_kernel",
        lambda options: trace_kernel(
            replace(options, geom_types=(GeomType.PLANE, GeomType.BOX), transparent=False, markers=False)
        ),
    )
    fitted = draw(renderer(), Channel.RGB, *GEOMETRY)
    for name in ("rgb", "depth", "links", "normals", "albedo"):
        assert torch.equal(getattr(general, name), getattr(fitted, name)), name


def test_pictures_whose_width_holds_no_whole_tiles_agree_with_those_that_do():
    """Pixels are drawn in tiles of 8 x 4 where these fit, else row by row."""
    source, poses = renderer(), torch.tensor([HERE])[:, None]
    eye = torch.tensor([(*CAMERA.pose.position, *CAMERA.pose.orientation)])
    tiled = source.render(CAMERA, eye, poses, (Channel.DEPTH,)).depth
    # Ten columns less, five on each side: the others' rays stay the same.
    narrow = source.render(replace(CAMERA, width=54), eye, poses, (Channel.DEPTH,)).depth
    torch.testing.assert_close(narrow, tiled[:, :, 5:-5], atol=0.0, rtol=0.0)


def test_only_shapes_and_drawn_markers_that_can_be_seen_through_make_a_scene_transparent():
    ghost = MarkerSpec("goal", MarkerShape.BOX, 0.3, (0.1, 0.9, 0.1, 0.5))
    opaque, glass = renderer(ghost)._model, renderer(color=(0.8, 0.2, 0.2, 0.5))._model
    assert (opaque.transparent(markers=False), opaque.transparent(markers=True)) == (False, True)
    assert glass.transparent(markers=False)
