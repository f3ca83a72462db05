"""The renderer's tiers, and that it draws what others simulate."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
import torch

from orbit_core import backends
from orbit_core.interfaces import (
    Capability,
    ConfigurationError,
    SceneLayout,
    UnknownNameError,
    UnsupportedCapabilityError,
)
from orbit_core.plugin_kit.surfaces import shaded
from orbit_core.scene import (
    AmbientLight,
    Articulation,
    CameraSpec,
    Channel,
    Link,
    MarkerShape,
    MarkerSpec,
    ObjectSpec,
    Scene,
    Shape,
    Sky,
    Sphere,
    look_at,
)
from orbit_core.world import simulate
from orbit_sapien.native import sapien

CAMERA = CameraSpec(name="eye", width=48, height=36, vertical_fov=0.6, pose=look_at((1.5, 0.0, 1.0), (0.0, 0.0, 0.2)))
EYE = torch.tensor([[*CAMERA.pose.position, *CAMERA.pose.orientation]])


def scene() -> Scene:
    link = Link("ball", 1.0, inertia=np.eye(3) * 0.01, collisions=(Shape(Sphere(0.2), color=(0.9, 0.1, 0.1, 1.0)),))
    ball = ObjectSpec(name="ball", articulation=Articulation("ball", (link,)))
    return Scene(objects=(ball,), markers=(MarkerSpec("goal", MarkerShape.BOX, 0.2, (0.1, 0.2, 0.9, 1.0)),))


@pytest.mark.parametrize("tier", ["fast", "pbr", "rt"])
def test_every_tier_draws_the_ball_red_on_the_ground(tier: str) -> None:
    plugin = backends.renderer(f"sapien-{tier}")
    renderer = plugin.create_renderer(SceneLayout.of(scene()), (CAMERA,), backends.backend_config(plugin))
    ball = torch.tensor([[[0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]]])
    image = renderer.render(CAMERA, EYE, ball, (Channel.RGB, Channel.INSTANCE))
    renderer.close()
    assert image.rgb is not None
    assert image.links is not None
    red, green, blue = image.rgb[image.links[..., 0] == 0].float().mean(0)
    assert red > 2 * max(green, blue)
    assert image.rgb[image.links[..., 0] != 0].float().std() > 0


def test_markers_are_in_colour_alone_and_only_when_asked() -> None:
    plugin = backends.renderer("sapien-fast")
    renderer = plugin.create_renderer(SceneLayout.of(scene()), (CAMERA,), backends.backend_config(plugin))
    ball = torch.tensor([[[0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]]])
    goal = torch.tensor([[[0.6, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]]])
    channels = (Channel.RGB, Channel.DEPTH)
    plain, marked, again = (renderer.render(CAMERA, EYE, ball, channels, poses) for poses in (None, goal, None))
    renderer.close()
    assert not torch.equal(plain.rgb, marked.rgb)
    assert torch.equal(plain.rgb, again.rgb)
    assert torch.equal(plain.depth, marked.depth)


def test_a_world_of_another_backend_is_drawn() -> None:
    if "mujoco" not in backends.backend_names():
        pytest.skip("no other backend is installed")
    world = simulate(scene(), 2, "mujoco", renderer="sapien-fast")
    world.step(10)
    renderer = world.create_renderer((CAMERA,))
    image = renderer.render(CAMERA, EYE.expand(2, 7), world.link_poses, (Channel.INSTANCE,))
    renderer.close()
    assert (image.links == 0).any()


def test_a_tier_simulates_nothing() -> None:
    plugin = backends.renderer("sapien-rt")
    assert not plugin.capabilities().has(Capability.ARTICULATIONS)
    with pytest.raises(UnsupportedCapabilityError, match="sapien"):
        plugin.create_engine(SceneLayout.of(scene()), 1, torch.device("cpu"), backends.backend_config(plugin))
    with pytest.raises(ConfigurationError, match="renderer"):
        backends.backend("sapien-rt")


def test_without_a_vulkan_driver_the_error_names_the_remedy() -> None:
    code = (
        "from orbit_core import backends; from orbit_core.interfaces import SceneLayout, ConfigurationError;"
        "from orbit_core.scene import Scene\n"
        "plugin = backends.renderer('sapien-fast')\n"
        "try: plugin.create_renderer(SceneLayout.of(Scene()), (), backends.backend_config(plugin))\n"
        "except ConfigurationError as error: print(error)"
    )
    environment = {"VK_ICD_FILENAMES": "/nonexistent.json", "VK_DRIVER_FILES": "/nonexistent.json", "PATH": ""}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=False)
    assert "mesa-vulkan-drivers" in result.stdout, result.stderr


def test_normals_are_shared_over_gentle_bends_alone() -> None:
    gentle = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, -0.1], [0, 1, 0]]], dtype=float)
    sharp = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 0, -1], [1, 0, 0]]], dtype=float)
    points, normals, faces = shaded(gentle)
    assert faces[0, 1] == faces[1, 0]
    np.testing.assert_allclose(points[faces], gentle)
    points, normals, faces = shaded(sharp)
    np.testing.assert_allclose(normals[faces[0]], [[0, 0, 1]] * 3)
    np.testing.assert_allclose(points[faces], sharp)


def test_a_renderers_settings_reach_it_and_no_others_do() -> None:
    """Through a world: fewer samples are noisier; what belongs to another tier or to physics is refused at once."""

    def noise(samples: int) -> float:
        settings = {"samples_per_pixel": samples}
        world = simulate(scene(), 1, "sapien", renderer="sapien-rt", renderer_settings=settings)
        image = world.renderer.render(CAMERA, EYE, world.link_poses, (Channel.RGB,))
        world.close()
        ground = image.rgb[0, -8:].float()
        return float((ground - ground.mean((0, 1))).abs().mean())

    assert noise(1) > 1.5 * noise(16)
    foreign = (("sapien-fast", "samples_per_pixel"), ("sapien-rt", "shadow_size"), ("sapien-rt", "workers"))
    for renderer, wrong in foreign:
        with pytest.raises(UnknownNameError, match=f"unknown setting '{wrong}' in backend '{renderer}'"):
            simulate(scene(), 1, "sapien", renderer=renderer, renderer_settings={wrong: 1})
    with pytest.raises(ConfigurationError, match="denoiser 'magic'"):
        simulate(scene(), 1, "sapien", renderer_settings={"denoiser": "magic"})


def test_a_denoiser_that_this_machine_lacks_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    if sapien.render.RenderSystem().device.is_cuda():
        pytest.skip("this machine draws on an NVIDIA GPU")
    # None in its place lets an import fail, as without the package.
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    for name, remedy in (("optix", "use 'oidn' or 'none'"), ("oidn", r"pip install 'orbit-sapien\[denoiser\]'")):
        world = simulate(scene(), 1, "sapien", renderer="sapien-rt", renderer_settings={"denoiser": name})
        with pytest.raises(ConfigurationError, match=f"denoiser '{name}' needs an NVIDIA GPU.*{remedy}"):
            world.create_renderer((CAMERA,))
        world.close()


def test_without_a_gpu_the_host_denoises_colours_by_albedo_and_normals(monkeypatch: pytest.MonkeyPatch) -> None:
    if sapien.render.RenderSystem().device.is_cuda():
        pytest.skip("this machine draws on an NVIDIA GPU")
    given: dict[str, np.ndarray] = {}

    def denoise(color: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
        given.update(color=color, albedo=albedo, normal=normal)
        return np.full_like(color, 0.5)

    library = ModuleType("pyoidn")
    library.denoise = denoise  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, "pyoidn", library)
    settings = {"denoiser": "oidn", "samples_per_pixel": 1}
    world = simulate(scene(), 1, "sapien", renderer="sapien-rt", renderer_settings=settings)
    image = world.renderer.render(CAMERA, EYE, world.link_poses, (Channel.RGB,))
    world.close()
    assert image.rgb is not None
    assert (image.rgb == 128).all()
    for picture in given.values():
        assert picture.dtype == np.float32
        assert picture.flags.c_contiguous
        assert picture.shape == (36, 48, 3)
    # The ball is red in albedo, without light and noise.
    red, green, blue = given["albedo"][18, 24]
    assert red > 5 * max(green, blue)
    np.testing.assert_allclose(np.linalg.norm(given["normal"][18, 24]), 1.0, atol=1e-3)


def test_the_path_tracers_sky_is_the_scenes_and_lights_what_faces_up_more_than_what_faces_down() -> None:
    """Without a directional light a ball is lit by the sky: more above than below."""
    dome = replace(
        scene(), lights=(AmbientLight((0.5, 0.5, 0.5)),), sky=Sky((0.1, 0.2, 0.9), (0.1, 0.2, 0.9)), terrain=()
    )
    world = simulate(dome, 1, "sapien", renderer="sapien-rt", renderer_settings={"samples_per_pixel": 8})
    ball = torch.tensor([[[0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]]])
    image = world.renderer.render(CAMERA, EYE, ball, (Channel.RGB, Channel.INSTANCE))
    world.close()
    assert image.rgb is not None
    assert image.links is not None
    shown = image.links[0, ..., 0] == 0
    rows = shown.any(1).nonzero().flatten()
    bright = [float(image.rgb[0, row][shown[row]].float().mean()) for row in (rows[2], rows[-3])]
    assert bright[0] > 1.3 * bright[1]
    red, _, blue = image.rgb[0, 0, 0].float()
    assert blue > 2 * red
