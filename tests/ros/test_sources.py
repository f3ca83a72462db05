"""Measurements of a robot of ROS other than its joints: programs of the real ROS publish them, our World reads them."""

from __future__ import annotations

import re
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

pytest.importorskip("cyclonedds", reason="ROS over DDS needs cyclonedds: pip install orbit-ros")

from orbit_assets.catalogue import robot
from orbit_assets.objects import box
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import CameraSpec, Channel, ImuSpec, Pose, Scene
from orbit_core.sensors.camera import CameraSensor
from orbit_deploy import pictures as pictures_module
from orbit_deploy.engine import RobotWorld, robot_world
from orbit_deploy.link import RobotLinkError, connect
from orbit_deploy.measured import MeasuredImu
from orbit_deploy.pictures import CameraDescription, Picture, PictureKind
from orbit_ros import hardware as hardware_module
from orbit_ros.dds import Ros2Node
from orbit_ros.messages import (
    CameraInfo,
    CompressedImage,
    Header,
    Image,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
    quaternion_of,
)
from orbit_ros.rosbridge import from_json, to_json
from orbit_ros.sources import FrameTree, RosCamera, camera_messages
from tests.deploy.rig import eventually
from tests.ros import robot_program
from tests.ros.rig import free_domain, ros1_master, skip_without_ros1
from tests.ros.rosbridge_server import ROS2_PYTHON, missing, rosbridge

PROGRAM = Path(robot_program.__file__)
DEBIAN_PYTHON = Path("/usr/bin/python3")
FRONT = CameraSpec(
    name="front",
    width=32,
    height=24,
    vertical_fov=1.0,
    channels=(Channel.RGB, Channel.DEPTH),
    pose=Pose((1.0, 0.0, 0.5)),
)
SOURCES = (
    "robot=franka_panda&images=front:camera/color/image_raw&depths=front:camera/depth/image_raw"
    "&imus=hand_imu:imu/data&objects=cube:tag/odom"
)


def ros2_environment(domain: int, folder: Path) -> dict[str, str]:
    return {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PATH": "/usr/bin:/bin",
            "HOME": str(folder)}  # fmt: skip


@contextmanager
def program(python: str | Path, words: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [str(python), str(PROGRAM), *words], env=environment, stdout=subprocess.PIPE, text=True
    ) as run:
        try:
            yield run
        finally:
            run.kill()


@pytest.fixture(scope="module", params=["ros2", "ros1", "rosbridge"])
def address(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a robot that a program of the real ROS publishes, over each way into ROS."""
    folder = tmp_path_factory.mktemp("ros")
    with ExitStack() as stack:
        if request.param == "ros1":
            skip_without_ros1()
            port = stack.enter_context(ros1_master())
            uri = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "HOME": str(folder)}
            stack.enter_context(program(DEBIAN_PYTHON, ["ros1"], uri | {"PATH": "/usr/bin:/bin"}))
            yield f"ros1://127.0.0.1:{port}?"
            return
        if not ROS2_PYTHON:
            pytest.skip("capability 'ROS 2' (rclpy) is not named by ORBIT_ROS2_PYTHON")
        domain = free_domain()
        stack.enter_context(program(ROS2_PYTHON, ["ros2"], ros2_environment(domain, folder)))
        if request.param == "ros2":
            yield f"ros2://127.0.0.1:{domain}?"
            return
        if missing():
            pytest.skip(missing())
        yield f"rosbridge://127.0.0.1:{stack.enter_context(rosbridge(domain, folder))}?ros=2&"


@pytest.fixture(autouse=True)
def long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait longer than a robot may, on a machine with other work."""
    monkeypatch.setattr(hardware_module, "_FOUND", 20.0)
    monkeypatch.setattr(pictures_module, "_LOST", 10.0)


def scene() -> Scene:
    unit = ImuSpec(name="hand_imu", entity="robot", frame="panda_hand")
    cube = box("cube", size=(0.05, 0.05, 0.05), mass=0.1)
    panda = replace(robot("franka_panda"), name="robot")
    return Scene(robots=(panda,), objects=(cube,), sensors=(FRONT, unit), physics_dt=0.02)


def world_of(address: str) -> RobotWorld:
    world = robot_world(connect(address, 0.02), 0.02)(scene(), 1, torch.device("cpu"), 0)
    assert isinstance(world, RobotWorld)
    return world


def test_a_policys_world_has_the_pictures_inertial_unit_and_objects_of_a_real_robot_of_ros(address: str) -> None:
    world = world_of(address + SOURCES)
    try:
        camera, unit = world.sensors["front"], world.sensors["hand_imu"]
        assert isinstance(camera, CameraSensor)
        assert isinstance(unit, MeasuredImu)
        color = camera.image(Channel.RGB)
        assert color.shape == (1, 24, 32, 3)
        assert color[0, 12, 4].tolist() == [*robot_program.RED]
        assert color[0, 12, 28].tolist() == [*robot_program.BLUE]
        torch.testing.assert_close(camera.image(Channel.DEPTH), torch.full((1, 24, 32, 1), 1.5))
        np.testing.assert_allclose(unit.angular_velocity[0].tolist(), robot_program.GYRO, rtol=1e-6)
        np.testing.assert_allclose(unit.linear_acceleration[0].tolist(), robot_program.FORCE, rtol=1e-6)
        assert world.objects["cube"].root_pose[0, :3].tolist() == pytest.approx([0.4, 0.0, 0.0])
        np.testing.assert_allclose(world.robots["robot"].joint_positions[0].tolist(), robot_program.PANDA, atol=1e-6)
    finally:
        world.close()


def test_compressed_pictures_are_the_same_pictures(address: str) -> None:
    pytest.importorskip("PIL")
    words = "robot=franka_panda&images=front:camera/color/image_raw/compressed"
    link = connect(address + words, 0.02)
    try:
        (camera,) = link.description.cameras
        pixels = link.picture(camera, PictureKind.RGB).pixels()
        assert pixels.shape == (robot_program.HEIGHT, robot_program.WIDTH, 3)
        assert pixels[5, 5].tolist() == [*robot_program.RED]
    finally:
        link.close()


def test_time_is_that_of_a_simulated_robots_clock(address: str) -> None:
    if address.startswith("rosbridge"):
        pytest.skip("one way into ROS 2 suffices")
    link = connect(address + "robot=franka_panda&time=clock", 0.02)
    try:
        began, clock = time.monotonic(), link.now()
        link.wait(clock + 1.0)
        assert link.now() - clock >= 1.0
        # The robot's second is half of ours, and a busy machine hears of it late.
        assert time.monotonic() - began < 0.9 + link.now() - clock - 1.0
        assert link.state().stamp * 1e-9 == pytest.approx(link.now(), abs=1000.0)  # our own clock counts from 1970
    finally:
        link.close()


def test_objects_are_where_frames_of_tf_are(address: str) -> None:
    if not address.startswith("ros1"):
        pytest.skip("the wheels of ROS 2 have no messages of tf2")
    link = connect(address + "robot=franka_panda&frames=cube:tag_3&world=map", 0.02)
    try:
        assert link.description.objects == ["cube"]
        assert link.state().objects[0][:7] == pytest.approx([1.25, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    finally:
        link.close()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("images=front:nowhere/image", "nobody publishes the calibration of 'front': 'nowhere/camera_info'"),
        ("imus=hand_imu:nowhere", "no inertial unit publishes on 'nowhere'"),
        ("frames=cube:tag_9&world=map", "nobody publishes frame 'tag_9' of 'cube' in 'map'"),
        ("objects=cube:nowhere", "nobody publishes where 'cube' is: 'nowhere'"),
    ],
)
def test_a_source_that_nobody_publishes_is_one_clear_error(
    address: str, words: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not address.startswith("ros2"):
        pytest.skip("one way into ROS suffices")
    # Long enough for the joints to be found.
    monkeypatch.setattr(hardware_module, "_FOUND", 3.0)
    with pytest.raises(RobotLinkError, match=message):
        connect(f"{address}robot=franka_panda&{words}", 0.02)


def test_options_that_cannot_be_are_refused() -> None:
    for words, message in (
        ("odometry=perhaps", "odometry is yes or no"),
        ("time=later", "time wall or clock"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            connect(f"ros2://127.0.0.1:{free_domain()}?robot=franka_panda&{words}", 0.02)
    with pytest.raises(ConfigurationError, match=r"name one, as \?imus=imu"):
        connect(f"ros2://127.0.0.1:{free_domain()}?robot=unitree_go2&odometry=no", 0.02)


@pytest.mark.parametrize("version", ["ros2", "ros1"])
def test_programs_of_the_real_ros_see_the_pictures_of_a_simulated_robot(version: str, tmp_path: Path) -> None:
    if version == "ros2" and not ROS2_PYTHON:
        pytest.skip("capability 'ROS 2' (rclpy) is not named by ORBIT_ROS2_PYTHON")
    if version == "ros1":
        skip_without_ros1()
    from orbit_core.backends import default_backend
    from orbit_deploy.computer import ComputerSettings, RobotComputer
    from orbit_deploy.follower import FollowerSettings
    from orbit_deploy.link import bridge
    from orbit_deploy.simulated import SimulatedHardware
    from tests.deploy.test_pictures import seen_scene

    with ExitStack() as stack:
        number = stack.enter_context(ros1_master()) if version == "ros1" else free_domain()
        hardware = SimulatedHardware(seen_scene(), default_backend(), 100.0)
        stack.callback(hardware.close)
        computer = RobotComputer(hardware, FollowerSettings(watchdog=0.5), ComputerSettings(state_rate=50.0))
        computer.watch()
        server = bridge(version).serve(computer, f"{version}://127.0.0.1:{number}")
        stack.callback(server.close)
        thread = threading.Thread(target=computer.run, daemon=True)
        thread.start()
        stack.callback(lambda: (computer.end(), thread.join(5.0)))
        if version == "ros1":
            uri = {"ROS_MASTER_URI": f"http://127.0.0.1:{number}", "ROS_IP": "127.0.0.1", "PATH": "/usr/bin:/bin"}
            python, environment = DEBIAN_PYTHON, uri | {"HOME": str(tmp_path)}
        else:
            python, environment = Path(ROS2_PYTHON), ros2_environment(number, tmp_path)
        heard = subprocess.run(
            [str(python), str(PROGRAM), version, "listen"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=60.0,
        )
        focal = CameraDescription.of(seen_scene().sensors[0], 1.0).focal[0]  # type: ignore[arg-type]
        expected = f"color: 32x24 rgb8 {32 * 24 * 3}; depth: 32x24 32FC1 {32 * 24 * 4}; info: 32 {focal:.3f}"
        assert expected in heard.stdout, heard.stderr[-2000:]


# Without another program ---------------------------------------------------------------------------------------------

CAMERA = CameraDescription("front", 4, 2, (3.0, 3.0), (2.0, 1.0), [0.1, 0.0, 0.0, 0.0, 0.0], [*PictureKind])


class Heard:
    """Node whose messages a test makes."""

    def __init__(self) -> None:
        self.callbacks: dict[str, object] = {}

    def subscribe(self, topic: str, kind: type, callback: object, latched: bool = False, large: bool = False) -> None:
        self.callbacks[topic] = callback

    def say(self, topic: str, message: object) -> None:
        self.callbacks[topic](message, "")  # type: ignore[operator]


def rows(*pixels: tuple[int, ...]) -> bytes:
    return bytes(number for pixel in pixels for number in pixel)


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [("rgb8", (1, 2, 3)), ("bgr8", (3, 2, 1)), ("rgba8", (1, 2, 3, 9)), ("bgra8", (3, 2, 1, 9)), ("8UC3", (3, 2, 1))],
)
def test_colours_of_each_encoding_are_red_green_and_blue_and_rows_may_be_padded(
    encoding: str, pixel: tuple[int, ...]
) -> None:
    node, found = Heard(), []
    camera = RosCamera(node, "front", "c/image", "", CAMERA)  # type: ignore[arg-type]
    camera.watch(found.append, lambda: 5)
    row = rows(*[pixel] * 4) + b"pad"
    node.say("c/image", Image(Header(), 2, 4, encoding, 0, len(row), row * 2))
    assert camera.fault == ""
    assert found == [Picture("front", PictureKind.RGB, 5, 2, 4, bytes((1, 2, 3)) * 8)]


def test_depth_in_millimetres_and_metres_of_either_byte_order_is_in_metres() -> None:
    for encoding, big, data in (
        ("16UC1", 1, b"\x05\xdc"),
        ("16UC1", 0, b"\xdc\x05"),
        ("32FC1", 0, np.float32(1.5).tobytes()),
    ):
        node, found = Heard(), []
        RosCamera(node, "front", "", "d/image", CAMERA).watch(found.append, lambda: 0)  # type: ignore[arg-type]
        node.say("d/image", Image(Header(), 1, 2, encoding, big, 2 * len(data), data * 2))
        np.testing.assert_allclose(found[0].pixels()[..., 0], 1.5, rtol=1e-6)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (Image(Header(), 2, 4, "bayer_rggb8", 0, 4, bytes(8)), "have encoding rgb8, .* not 'bayer_rggb8'"),
        (Image(Header(), 2, 4, "rgb8", 0, 12, bytes(23)), "rows of 12 bytes has 23 bytes"),
        (Image(Header(), 2, 4, "rgb8", 0, 0, b""), "rows of 0 bytes has 0 bytes"),
        (CompressedImage(Header(), "jpeg", b"\xff\xd8 no picture"), "compressed picture cannot be read"),
    ],
)
def test_pictures_that_cannot_be_used_are_one_clear_fault(message: object, words: str) -> None:
    node, topic = Heard(), "c/image" + "/compressed" * isinstance(message, CompressedImage)
    camera = RosCamera(node, "front", topic, "", CAMERA)  # type: ignore[arg-type]
    camera.watch(lambda picture: None, lambda: 0)
    node.say(topic, message)
    assert re.search(words, camera.fault)


def test_a_calibration_that_is_none_or_of_another_model_is_a_fault() -> None:
    for info, words in (
        (CameraInfo(height=2, width=4, distortion_model="equidistant"), "take rectified pictures"),
        (CameraInfo(height=2, width=4), "no calibrated pinhole camera"),
    ):
        node = Heard()
        camera = RosCamera(node, "front", "c/image_raw", "")  # type: ignore[arg-type]
        node.say("c/camera_info", info)
        assert words in camera.fault
        assert camera.description is None


@pytest.mark.parametrize("ros1", [False, True])
def test_pictures_and_calibrations_return_from_json_as_they_were(ros1: bool) -> None:
    picture = Picture("front", PictureKind.RGB, 0, 2, 4, bytes(range(24)))
    for message in (
        *camera_messages(CAMERA, picture, Header(Time(3, 4), "front")),
        CompressedImage(Header(), "png", b"abc"),
    ):
        written = to_json(message, ros1)
        assert from_json(written, type(message)) == message
        assert ("K" in written) == (ros1 and isinstance(message, CameraInfo))


def test_a_calibration_and_a_compressed_picture_keep_their_bytes_over_dds() -> None:
    domain = free_domain()
    ours, theirs, found = Ros2Node(domain), Ros2Node(domain), {}
    info = CameraInfo(Header(Time(1, 2), "front"), 2, 4, "plumb_bob", [0.1] * 5, [float(i) for i in range(9)])  # type: ignore[arg-type]
    picture = CompressedImage(Header(Time(1, 2), "front"), "jpeg; rgb8", bytes(range(251)))
    for name, message in (("info", info), ("picture", picture)):
        theirs.subscribe(
            name, type(message), lambda heard, _, name=name: found.update({name: heard}), large=name == "picture"
        )
    publish = [(ours.advertise(name, type(each)), each) for name, each in (("info", info), ("picture", picture))]

    def heard() -> bool:
        for send, each in publish:
            send(each)
        return len(found) == 2

    assert eventually(heard, 10.0)
    assert found["info"].k == info.k
    assert (found["info"].header, list(found["info"].d), found["info"].roi) == (info.header, [0.1] * 5, info.roi)
    assert found["picture"] == picture
    ours.close()
    theirs.close()


def frame(parent: str, child: str, seconds: int, x: float, yaw: float = 0.0) -> TransformStamped:
    half = 0.5 * yaw
    turn = quaternion_of((np.cos(half), 0.0, 0.0, np.sin(half)))
    return TransformStamped(Header(Time(seconds, 0), parent), child, Transform(Vector3(x, 0.0, 0.0), turn))


def test_frames_are_chained_to_the_world_with_velocities_and_circles_are_none() -> None:
    node = Heard()
    tree = FrameTree(node, "map")  # type: ignore[arg-type]
    assert tree.body("tag") is None
    node.say("tf_static", TFMessage([frame("map", "table", 0, 1.0, np.pi / 2)]))
    node.say("tf", TFMessage([frame("table", "/tag", 1, 0.5)]))
    half = 0.5**0.5
    np.testing.assert_allclose(tree.body("tag") or [], [1.0, 0.5, 0.0, half, 0.0, 0.0, half, *[0.0] * 6], atol=1e-12)
    node.say("tf", TFMessage([frame("table", "tag", 2, 0.75, 0.01)]))
    body = tree.body("tag")
    assert body is not None
    np.testing.assert_allclose(body[7:], [0.0, 0.25, 0.0, 0.0, 0.0, 0.01], atol=1e-5)
    node.say("tf", TFMessage([frame("a", "b", 2, 0.0), frame("b", "a", 2, 0.0)]))
    assert tree.body("a") is None


def test_bytes_that_are_no_message_do_not_end_the_hearing_of_the_next_ones() -> None:
    domain = free_domain()
    ours, theirs, found = Ros2Node(domain), Ros2Node(domain), []
    theirs.subscribe("picture", Image, lambda message, _: found.append(message.width), large=True)
    publish = ours.advertise("picture", Image)
    good = Image(Header(), 1, 2, "rgb8", 0, 6, bytes(6))
    broken = Image(Header(frame_id="!"), 1, 1, "rgb8", 0, 3, bytes(3))
    # DDS rejects bytes that do not fit the type, and does not look into texts.
    written = broken.serialize().replace(b"!", b"\xff")
    broken.serialize = lambda *_, **__: written  # type: ignore[method-assign]
    assert eventually(lambda: publish(good) is None and bool(found), 10.0)
    publish(broken)
    found.clear()
    assert eventually(lambda: publish(good) is None and bool(found), 10.0)
    ours.close()
    theirs.close()


def test_a_walking_robot_without_odometry_is_turned_as_its_inertial_unit_measures() -> None:
    from orbit_ros.messages import Imu, JointState

    domain, ended = free_domain(), threading.Event()
    node, names = Ros2Node(domain), [joint.name for joint in robot("unitree_go2").articulation.movable_joints]
    joints, unit = node.advertise("joint_states", JointState), node.advertise("imu/data", Imu)
    half = 0.5**0.5
    turned = Imu(orientation=quaternion_of((half, 0.0, 0.0, half)), angular_velocity=Vector3(0.5, 0.0, 0.0))

    def speak() -> None:
        while not ended.wait(0.01):
            joints(JointState(name=names, position=[0.0] * 12))
            unit(turned)

    threading.Thread(target=speak, daemon=True).start()
    link = connect(f"ros2://127.0.0.1:{domain}?robot=unitree_go2&odometry=no&imus=imu&command=positions", 0.02)
    try:
        (base,) = link.state().objects
        np.testing.assert_allclose(base, [0, 0, 0, half, 0, 0, half, 0, 0, 0, 0, 0.5, 0], atol=1e-12)
    finally:
        link.close()
        ended.set()
        node.close()
