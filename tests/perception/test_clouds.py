"""Clouds of a fixed number of points: on the surface, in the frame asked for, within the workspace, each pixel once."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_core.agent import AgentGraph, Edge
from orbit_core.dynamics.random import RandomStreams
from orbit_core.dynamics.transforms import pose_inverse, transform_points
from orbit_core.interfaces import ConfigurationError, Port, ShapeError
from orbit_core.scene import CameraSpec, Plane, Pose, Sphere, look_at
from orbit_core.sensors.proprioception import pose_tensor
from orbit_motion.perception import CloudFrame, PointCloudConfig, PointCloudNode, Sampling, TsdfConfig, TsdfNode
from orbit_motion.perception import sample_point_cloud as sample

CPU = torch.device("cpu")
CAMERA = CameraSpec(name="eye", width=40, height=30, vertical_fov=0.8, pose=look_at((1.0, 0.5, 1.2), (0.0, 0.0, 0.0)))
POSE = pose_tensor(CAMERA.pose, CPU)[None]
BODY = pose_tensor(Pose.from_euler(0.1, 0.2, 0.9, (0.4, -0.3, 0.2)), CPU)[None]
GROUND = (Plane(), Pose())
BALL = (Sphere(0.2), Pose((0.0, 0.0, 0.3)))


def streams(num_envs: int, seed: int = 0) -> RandomStreams:
    made = RandomStreams(num_envs, seed, CPU)
    made.reset()
    return made


def pixels(count: int, num_envs: int = 1) -> torch.Tensor:
    """(N, 1, count, 3): the x of each point is its pixel's number."""
    return torch.arange(float(count))[None, None, :, None].expand(num_envs, 1, count, 3).clone()


def cloud_of_ground(picture, frame: CloudFrame, **settings):
    node = PointCloudNode("cloud", CAMERA, PointCloudConfig(points=200, **settings), CPU, frame)
    rgb = torch.full((1, 30, 40, 3), 255, dtype=torch.uint8)
    return node.compute({"depth": picture([GROUND], CAMERA), "rgb": rgb, "pose": POSE, "body": BODY})


def test_points_of_a_plane_lie_on_it_in_every_frame(picture):
    found = cloud_of_ground(picture, CloudFrame.ENVIRONMENT)
    assert found["valid"].all()
    assert found["points"][..., 2].abs().max() < 1e-5
    assert (found["colors"] == 1.0).all()
    for frame, place in ((CloudFrame.CAMERA, POSE), (CloudFrame.BODY, BODY)):
        points = cloud_of_ground(picture, frame)["points"]
        torch.testing.assert_close(transform_points(place[:, None], points), found["points"], atol=1e-5, rtol=0)


def test_points_of_a_ball_lie_on_it(picture):
    node = PointCloudNode("cloud", CAMERA, PointCloudConfig(points=100), CPU)
    rgb = torch.zeros(1, 30, 40, 3, dtype=torch.uint8)
    found = node.compute({"depth": picture([BALL], CAMERA), "rgb": rgb, "pose": POSE})
    distances = (found["points"] - torch.tensor(BALL[1].position)).norm(dim=-1)
    assert (distances[found["valid"]] - 0.2).abs().max() < 1e-5


@pytest.mark.parametrize("frame", CloudFrame)
def test_the_workspace_cuts_in_the_frame_of_the_points(picture, frame):
    centre = {CloudFrame.CAMERA: POSE, CloudFrame.BODY: BODY}.get(frame)
    middle = torch.zeros(1, 3) if centre is None else transform_points(pose_inverse(centre), torch.zeros(1, 3))
    lower, upper = (tuple((middle[0] + side).tolist()) for side in (-0.2, 0.2))
    found = cloud_of_ground(picture, frame, lower=lower, upper=upper)
    inside = found["points"][found["valid"]]
    assert 0 < len(inside) < 200
    assert (inside >= torch.tensor(lower)).all()
    assert (inside <= torch.tensor(upper)).all()
    assert (found["points"][~found["valid"]] == 0).all()
    assert (found["colors"][~found["valid"]] == 0).all()


def test_strided_sampling_spreads_over_all_pixels_that_are_there():
    points = pixels(10)
    points[..., 3, 2], points[..., 7, 0] = math.inf, math.nan
    cloud = sample(points, PointCloudConfig(points=4))
    assert cloud.points[0, :, 0].tolist() == [0, 2, 5, 8]  # ranks 0, 2, 4, 6 of 0 1 2 4 5 6 8 9
    assert cloud.valid.all()
    assert cloud.colors is None


@pytest.mark.parametrize("sampling", Sampling)
def test_fewer_points_than_asked_for_come_first_and_once(sampling):
    points = pixels(6, num_envs=2)
    points[1] = math.inf
    cloud = sample(points, PointCloudConfig(points=8, sampling=sampling), random=streams(2))
    assert cloud.valid.tolist() == [[True] * 6 + [False] * 2, [False] * 8]
    assert sorted(cloud.points[0, :6, 0].tolist()) == [0, 1, 2, 3, 4, 5]
    assert (cloud.points[1] == 0).all()


def test_random_sampling_takes_each_point_as_often_as_another_and_none_twice():
    config = PointCloudConfig(points=5, sampling=Sampling.RANDOM)
    cloud = sample(pixels(20, num_envs=4000), config, random=streams(4000))
    chosen = cloud.points[..., 0].to(torch.int64)
    assert (chosen.sort(-1).values.diff(dim=-1) > 0).all()
    counts = chosen.flatten().bincount(minlength=20)
    assert (counts - 1000).abs().max() < 4.5 * math.sqrt(4000 * 0.25 * 0.75)


def test_random_sampling_is_of_each_environments_own_stream():
    config = PointCloudConfig(points=5, sampling=Sampling.RANDOM)
    few, many = (sample(pixels(50, num_envs=n), config, random=streams(n)).points for n in (2, 5))
    assert torch.equal(few, many[:2])
    assert not torch.equal(many[0], many[1])


def test_colours_go_with_their_points():
    rgb = torch.arange(30, dtype=torch.uint8).view(1, 1, 10, 3)
    cloud = sample(pixels(10), PointCloudConfig(points=3), rgb=rgb)
    torch.testing.assert_close(cloud.colors[0, :, 0], cloud.points[0, :, 0] * 3 / 255)


def test_nodes_stand_in_an_agent_and_forget_with_their_environment(picture):
    cloud = PointCloudNode("cloud", CAMERA, PointCloudConfig(points=50), CPU)
    grid = TsdfConfig(lower=(-0.4, -0.4, -0.1), voxel_size=0.05, shape=(16, 16, 16))
    field = TsdfNode("field", CAMERA, grid, 2, CPU, rate=10.0)
    edges = [Edge(port.name, f"cloud.{port.name}") for port in cloud.inputs]
    edges += [Edge("depth", "field.depth"), Edge("pose", "field.pose")]
    edges += [Edge("cloud.valid", "valid"), Edge("field.weights", "weights")]
    agent = AgentGraph(
        [cloud, field],
        edges,
        rate=20.0,
        inputs=cloud.inputs,
        outputs=[Port("valid", (50,)), Port("weights", grid.shape)],
    )
    rgb = torch.zeros(2, 30, 40, 3, dtype=torch.uint8)
    inputs = {"depth": picture([GROUND], CAMERA).repeat(2, 1, 1, 1), "rgb": rgb, "pose": POSE.repeat(2, 1)}
    for _ in range(4):
        found = agent.step(inputs)
    seen = found["weights"].amax((1, 2, 3))
    assert found["valid"].all()
    assert seen[0] == seen[1] > 0.0  # of two pictures, at half the agent's rate
    agent.step(inputs)
    agent.reset(torch.tensor([1]))
    renewed = agent.step(inputs)["weights"].amax((1, 2, 3))
    assert renewed[1].item() == pytest.approx(seen[1].item() / 2, rel=1e-5)
    assert renewed[0].item() == pytest.approx(seen[0].item() * 1.5, rel=1e-5)


def test_clouds_that_cannot_be_are_refused():
    with pytest.raises(ConfigurationError, match="at least one"):
        PointCloudConfig(points=0)
    with pytest.raises(ConfigurationError, match="both its lower and its upper corner"):
        PointCloudConfig(points=1, lower=(0.0, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match="is empty"):
        PointCloudConfig(points=1, lower=(0.0, 0.0, 0.0), upper=(1.0, 0.0, 1.0))
    with pytest.raises(ConfigurationError, match="random streams"):
        sample(pixels(4), PointCloudConfig(points=1, sampling=Sampling.RANDOM))
    with pytest.raises(ShapeError, match=r"\(N, H, W, 3\), not \(4, 3\)"):
        sample(torch.zeros(4, 3), PointCloudConfig(points=1))
    with pytest.raises(ShapeError, match="colours of pixels"):
        sample(pixels(4), PointCloudConfig(points=1), rgb=torch.zeros(1, 1, 3, 3, dtype=torch.uint8))
