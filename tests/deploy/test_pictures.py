"""Pictures of a robot's cameras: the view that a task's camera has of them, and their way from a simulated robot."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import torch

from orbit_core.backends import default_backend
from orbit_core.interfaces import ConfigurationError, World
from orbit_core.scene import CameraSpec, Channel, Pose, Scene, look_at
from orbit_core.sensors.camera import CameraSensor
from orbit_core.world import simulate
from orbit_deploy import pictures as pictures_module
from orbit_deploy.computer import ComputerSettings, RobotComputer
from orbit_deploy.engine import robot_world
from orbit_deploy.follower import FollowerSettings
from orbit_deploy.link import RobotLink, RobotLinkError, connect
from orbit_deploy.local import LocalLink
from orbit_deploy.pictures import CameraDescription, Picture, PictureBox, PictureKind, PictureView, check_cameras
from orbit_deploy.simulated import SimulatedHardware
from orbit_zmq.server import ZmqServer
from tests.deploy.rig import PERIOD, eventually, scene

EYE = CameraSpec(
    name="eye",
    width=32,
    height=24,
    vertical_fov=0.8,
    channels=(Channel.RGB, Channel.DEPTH),
    pose=look_at(eye=(3.0, 0.0, 0.6), target=(0.0, 0.0, 0.3)),
)
TASK = CameraSpec(name="front", width=16, height=16, vertical_fov=0.6, channels=(Channel.RGB, Channel.DEPTH))
WIDE = CameraDescription("front", 640, 480, (500.0, 520.0), (330.0, 235.0), kinds=[*PictureKind])
DISTORTED = msgspec.structs.replace(WIDE, distortion=[-0.2, 0.05, 0.002, -0.001, 0.01])


def seen_scene() -> Scene:
    return replace(scene(), sensors=(EYE,))


def projected(camera: CameraDescription) -> np.ndarray:
    """Return (16, 16, 2) where OpenCV projects the rays of the task's pixels to, u and v."""
    cv2 = pytest.importorskip("cv2")
    focal = 8.0 / np.tan(0.3)
    x, y = np.meshgrid((np.arange(16) - 7.5) / focal, (np.arange(16) - 7.5) / focal)
    points = np.stack((x, y, np.ones_like(x)), -1).reshape(-1, 3)
    (fx, fy), (cx, cy) = camera.focal, camera.center
    k = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    found, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), k, np.array(camera.distortion or [0.0] * 5))
    return found.reshape(16, 16, 2)


@pytest.mark.parametrize("camera", [WIDE, DISTORTED], ids=["rectified", "distorted"])
def test_a_tasks_camera_sees_along_its_own_rays_in_a_robots_picture(camera: CameraDescription) -> None:
    # Colours that say where in the picture they are.
    u, v = np.meshgrid(np.arange(640) + 0.5, np.arange(480) + 0.5)
    colors = np.stack((0.39 * u, 0.5 * v, 0.0 * u), -1).round().astype(np.uint8)
    view = PictureView(TASK, camera).see(Picture("front", PictureKind.RGB, 0, 480, 640, colors.tobytes()))[0]
    expected = projected(camera) * np.array((0.39, 0.5))
    assert view.shape == (16, 16, 3)
    assert np.abs(view[..., :2].double().numpy() - expected).max() < 1.0


def test_depths_are_never_blended_and_nothing_is_infinitely_far() -> None:
    depth = np.full((480, 640), 1.0, "<f4")
    depth[:, 320:], depth[:200] = 3.0, np.nan
    depth[300:] = 0.0
    view = PictureView(TASK, WIDE).see(Picture("front", PictureKind.DEPTH, 0, 480, 640, depth.tobytes()))
    assert set(view.flatten().tolist()) == {1.0, 3.0, float("inf")}


def test_pictures_of_the_tasks_own_camera_stay_as_they_are() -> None:
    numbers = np.random.default_rng(0).integers(0, 256, (24, 32, 3), np.uint8)
    view = PictureView(EYE, CameraDescription.of(EYE, 30.0))
    assert np.array_equal(view.see(Picture("eye", PictureKind.RGB, 0, 24, 32, numbers.tobytes()))[0].numpy(), numbers)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name": "rear"}, r"has no camera 'front': it has rear"),
        ({"kinds": [PictureKind.RGB]}, r"takes no depth pictures"),
        ({"focal": (3000.0, 3000.0)}, r"sees less than the task's"),
        ({"focal": (0.0, 500.0)}, r"no calibrated pinhole camera"),
        ({"center": (float("nan"), 0.0)}, r"no calibrated pinhole camera"),
        ({"width": 10**6, "height": 10**6}, r"no calibrated pinhole camera"),
    ],
)
def test_another_camera_than_the_tasks_is_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        check_cameras([TASK], [msgspec.structs.replace(WIDE, **changes)], "here")


def test_pictures_of_other_sizes_or_without_all_their_bytes_are_refused() -> None:
    view = PictureView(TASK, WIDE)
    with pytest.raises(ConfigurationError, match="has 2 by 2 pixels, and the camera 640 by 480"):
        view.see(Picture("front", PictureKind.RGB, 0, 2, 2, bytes(12)))
    for height, data in ((480, bytes(7)), (-480, bytes(7)), (0, b"")):
        with pytest.raises(ConfigurationError, match=rf"has {len(data)} bytes"):
            view.see(Picture("front", PictureKind.RGB, 0, height, 640, data))


def test_a_look_waits_for_a_picture_of_what_is_so_now(monkeypatch: pytest.MonkeyPatch) -> None:
    box = PictureBox()
    old, new = (Picture("front", PictureKind.RGB, stamp, 1, 1, bytes(3)) for stamp in (5, 20))
    box.put(old)
    assert box.newest(WIDE, PictureKind.RGB) is old
    threading.Timer(0.05, lambda: box.put(new)).start()
    assert box.newest(WIDE, PictureKind.RGB, since=10) is new
    monkeypatch.setattr(pictures_module, "_WAITED", 0.05)
    with pytest.raises(ConfigurationError, match=r"no depth picture for 0.05 s"):
        box.newest(WIDE, PictureKind.DEPTH)
    monkeypatch.setattr(pictures_module, "_LOST", 0.0)
    with pytest.raises(ConfigurationError, match="has sent no rgb picture for"):
        box.newest(WIDE, PictureKind.RGB)


def images(sensor: object) -> dict[Channel, torch.Tensor]:
    assert isinstance(sensor, CameraSensor)
    return {channel: picture.clone() for channel, picture in sensor.images.items()}


def test_a_robots_world_sees_in_lockstep_what_a_simulated_one_sees() -> None:
    simulated = simulate(seen_scene(), 1, default_backend())
    expected = images(simulated.sensors["eye"])
    simulated.close()
    link = LocalLink(SimulatedHardware(seen_scene(), default_backend()), PERIOD)
    world = robot_world(link, PERIOD)(seen_scene(), 1, torch.device("cpu"), 0)
    seen = images(world.sensors["eye"])
    world.close()
    assert (seen[Channel.RGB].int() - expected[Channel.RGB].int()).abs().max() <= 2
    torch.testing.assert_close(seen[Channel.DEPTH], expected[Channel.DEPTH], rtol=0.0, atol=1e-3)
    assert seen[Channel.DEPTH].isfinite().any()


def look_on(world: World) -> None:
    """Step and look for ten seconds."""
    for _ in range(500):
        world.step(4)
        images(world.sensors["eye"])


@contextmanager
def served() -> Iterator[tuple[RobotComputer, SimulatedHardware, RobotLink]]:
    """A robot with a camera behind ZeroMQ, and a session with it."""
    hardware = SimulatedHardware(seen_scene(), default_backend(), 250.0)
    computer = RobotComputer(hardware, FollowerSettings(watchdog=0.5), ComputerSettings(state_rate=125.0))
    computer.watch()
    server = ZmqServer(computer, "zmq://127.0.0.1:0")
    thread = threading.Thread(target=computer.run, daemon=True)
    thread.start()
    link = connect(server.address, PERIOD)
    try:
        yield computer, hardware, link
    finally:
        link.close()
        computer.end()
        thread.join(5.0)
        server.close()
        hardware.close()


def test_pictures_of_a_simulated_robot_come_over_zeromq_and_show_where_things_were_put(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pictures_module, "_WAITED", 20.0)
    monkeypatch.setattr(pictures_module, "_LOST", 10.0)
    with served() as (computer, hardware, link):
        assert [camera.name for camera in link.description.cameras] == ["eye"]
        world = robot_world(link, PERIOD)(seen_scene(), 1, torch.device("cpu"), 0)
        before = images(world.sensors["eye"])
        world.objects["cube"].set_root_pose(torch.tensor([[1.5, 0.3, 0.05, 1.0, 0.0, 0.0, 0.0]]))
        world.step(4)
        after = images(world.sensors["eye"])
        # The pictures differ where the cube was and where it is.
        changed = (after[Channel.DEPTH] - before[Channel.DEPTH]).abs()[0, :, :, 0] > 0.1
        assert 2 < int(changed.sum()) < 200
        # A camera that goes dark ends the motion with one error.
        assert hardware._eyes._process is not None
        hardware._eyes._process.kill()
        monkeypatch.setattr(pictures_module, "_LOST", 0.3)
        with pytest.raises(RobotLinkError, match=r"camera 'eye' has sent no \w+ picture for .* is stopped"):
            look_on(world)
        assert eventually(lambda: computer.follower.limiter.at_rest)


def test_a_pictures_bytes_are_read_or_refused() -> None:
    from orbit_zmq.wire import Codec

    codec, picture = Codec(), Picture("eye", PictureKind.DEPTH, 7, 1, 2, bytes(8))
    assert codec.picture(codec.encode(picture)) == picture
    for data in (b"", b"\xff" * 9, codec.encode(picture)[:-3], codec.encode(["picture", "eye", "x-ray", 0, 1, 1, b""])):
        with pytest.raises(ConfigurationError, match="was not understood"):
            codec.picture(data)


def test_a_camera_with_other_channels_is_refused_on_a_robot() -> None:
    spec = CameraSpec(name="labels", channels=(Channel.SEMANTIC,), pose=Pose((0.0, 0.0, 1.0)))
    with pytest.raises(ConfigurationError, match="channel semantic, which no camera of a robot takes"):
        CameraDescription.of(spec, 30.0)
