"""Cameras as sensors: where they sit, what their numbers mean, and when they draw."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import (
    Box,
    CameraSpec,
    Channel,
    Noise,
    ObjectSpec,
    Plane,
    Pose,
    Scene,
    Shape,
    Sphere,
    look_at,
    single_link,
)

DOWN = look_at((0.0, 0.0, 2.0), (0.0, 0.0, 0.0))


def camera(**settings) -> CameraSpec:
    values = {"name": "camera", "width": 32, "height": 24, "pose": DOWN, "channels": (Channel.DEPTH,)}
    return CameraSpec(**values | settings)


def view(*cameras: CameraSpec) -> Scene:
    box = single_link("crate", Shape(Box((0.2, 0.2, 0.2))), 1.0, np.eye(3) * 0.01)
    ball = single_link("ball", Shape(Sphere(0.1)), 1.0, np.eye(3) * 0.01)
    return Scene(
        objects=(
            ObjectSpec(name="ball", articulation=ball, pose=Pose((0.5, 0, 0.1)), semantic_label="toy"),
            ObjectSpec(name="crate", articulation=box, pose=Pose((0, 0, 0.2))),
        ),
        terrain=(Shape(Plane()),),
        sensors=cameras,
    )


def test_a_fixed_camera_looks_down_on_the_crate(make_rig):
    rig = make_rig(view(camera()))
    sensor = rig.sensors["camera"]
    assert sensor.image(Channel.DEPTH).shape == (2, 24, 32, 1)
    assert sensor.image(Channel.DEPTH)[0, 12, 16].item() == pytest.approx(1.6, abs=1e-3)
    assert sensor.image(Channel.DEPTH)[0, 0, 0].item() == pytest.approx(2.0, abs=1e-3)
    points = sensor.point_cloud()
    torch.testing.assert_close(points[0, 12, 16, 2], torch.tensor(0.4), atol=1e-3, rtol=0)
    assert points[0, ..., 2].min().abs() < 1e-3


def test_segmentation_names_entities_and_labels(make_rig):
    rig = make_rig(view(camera(channels=(Channel.INSTANCE, Channel.SEMANTIC))))
    sensor = rig.sensors["camera"]
    instance, semantic = sensor.images[Channel.INSTANCE], sensor.images[Channel.SEMANTIC]
    assert instance.dtype == semantic.dtype == torch.int32
    assert set(instance.unique().tolist()) == {-2, 0, 1}
    assert sensor.semantic_labels == ("crate", "terrain", "toy")
    for index, label in ((-2, "terrain"), (0, "toy"), (1, "crate")):
        assert (semantic[instance == index] == sensor.semantic_labels.index(label)).all()


def test_nothing_at_all_is_the_background(make_rig):
    up = Pose.from_euler(np.pi, 0.0, 0.0, (0.0, 0.0, 1.0))
    channels = (Channel.INSTANCE, Channel.SEMANTIC, Channel.DEPTH)
    sensor = make_rig(view(camera(pose=up, channels=channels))).sensors["camera"]
    assert (sensor.image(Channel.INSTANCE) == -1).all()
    assert (sensor.image(Channel.SEMANTIC) == -1).all()
    assert sensor.image(Channel.DEPTH).isinf().all()
    assert sensor.point_cloud().isinf().all()


def test_a_carried_camera_moves_with_its_frame(make_rig):
    rig = make_rig(view(camera(entity="crate", frame="crate", pose=Pose((0, 0, -0.3)))))
    rig.engine.write_root_state(1, torch.tensor([[0, 0, 2.0, 1, 0, 0, 0], [0, 0, 3.0, 1, 0, 0, 0]]), None)
    sensor = rig.sensors["camera"]
    torch.testing.assert_close(sensor.pose[:, 2], torch.tensor([1.7, 2.7]))
    torch.testing.assert_close(sensor.image(Channel.DEPTH)[:, 0, 0, 0], torch.tensor([1.7, 2.7]), atol=1e-3, rtol=0)


def test_an_unread_camera_makes_no_renderer(make_rig):
    rig = make_rig(view(camera()))
    rig.step(5)
    assert not rig.renderers
    _ = rig.sensors["camera"].images
    assert len(rig.renderers) == 1


def test_a_reset_draws_the_reset_environment_alone(make_rig, monkeypatch):
    rig = make_rig(view(camera(rate=50.0)), num_envs=3)
    sensor = rig.sensors["camera"]
    before = sensor.image(Channel.DEPTH)
    drawn = []
    render = rig.renderers[0].render
    monkeypatch.setattr(rig.renderers[0], "render", lambda *a, **k: drawn.append(len(a[1])) or render(*a, **k))
    rig.reset(torch.tensor([1]))
    torch.testing.assert_close(sensor.image(Channel.DEPTH), before)
    assert drawn == [1]


def test_depth_noise_is_in_metres(make_rig):
    sensor = make_rig(view(camera(noise=Noise(std=0.02)))).sensors["camera"]
    assert sensor.image(Channel.DEPTH)[:, :2].std().item() == pytest.approx(0.02, rel=0.3)


def test_positions_follow_from_the_depth_that_is_held(make_rig):
    channels, noise = (Channel.POSITION, Channel.DEPTH), Noise(std=0.02)
    sensor = make_rig(view(camera(channels=channels, noise=noise))).sensors["camera"]
    positions, depth = sensor.image(Channel.POSITION), sensor.image(Channel.DEPTH)
    torch.testing.assert_close(positions[..., 2], 2.0 - depth[..., 0])
    torch.testing.assert_close(sensor.images[Channel.POSITION], sensor.point_cloud())


def test_cameras_that_cannot_be_are_refused(make_rig):
    with pytest.raises(ConfigurationError, match="both an entity and a frame"):
        make_rig(view(camera(entity="crate")))
    with pytest.raises(ConfigurationError, match="no depth channel"):
        make_rig(view(camera(channels=(Channel.RGB,), noise=Noise(std=1.0))))
    with pytest.raises(ConfigurationError, match="no rgb channel: add it"):
        make_rig(view(camera())).sensors["camera"].image(Channel.RGB)
    with pytest.raises(ConfigurationError, match="no position channel: add it"):
        make_rig(view(camera(channels=(Channel.RGB,)))).sensors["camera"].point_cloud()
