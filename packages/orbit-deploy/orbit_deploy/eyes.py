"""Cameras of a simulated robot, drawn by another process, so that the robot's loop never waits for a picture."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import IO, Any

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import Renderer, SimulationError, World
from orbit_core.scene import CameraSpec, Channel, Scene
from orbit_core.sensors.proprioception import Mount, pose_tensor
from orbit_core.world import simulate
from orbit_deploy.pictures import CameraDescription, Picture, PictureKind, kinds_of

# Hz of cameras without a rate, as most are
_RATE = 30.0
_CHANNELS = {PictureKind.RGB: Channel.RGB, PictureKind.DEPTH: Channel.DEPTH}
_LENGTH = struct.Struct("<I")


class SimulatedEyes:
    """Cameras of a simulated robot.

    Args:
        specs: cameras of the scene.
        scene: that is simulated, without them.
        world: of the scene, whose links are drawn.
        backend: that draws.
        settings: of the backend.
        rate: of the robot's loop, Hz.
    """

    def __init__(
        self,
        specs: Sequence[CameraSpec],
        scene: Scene,
        world: World,
        backend: str,
        settings: dict[str, object] | None,
        rate: float,
    ) -> None:
        self._specs, self._world = tuple(specs), world
        self._made = (scene, self._specs, backend, settings)
        self.cameras = [CameraDescription.of(spec, spec.rate or _RATE) for spec in self._specs]
        """Descriptions of the cameras."""
        self._every = [max(1, round(rate / camera.rate)) for camera in self.cameras]
        self._mounts = [_mount(spec, world) for spec in self._specs]
        self._renderer: Renderer | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._waiting: dict[int, int] = {}
        self._cycle = 0

    def look(self, camera: str, kind: PictureKind, stamp: int) -> Picture:
        """Draw one picture of the present state in this process.

        Args:
            camera: name of the camera.
            kind: quantity.
            stamp: ns on the robot's clock.
        """
        if self._renderer is None:
            self._renderer = self._world.create_renderer(self._specs)
        place = next(index for index, spec in enumerate(self._specs) if spec.name == camera)
        spec, links = self._specs[place], self._world.link_poses
        (picture,) = _draw(self._renderer, spec, self._pose(place), links, (kind,))
        return Picture(spec.name, kind, stamp, spec.height, spec.width, picture)

    def start(self, sink: Callable[[Picture], None]) -> None:
        """Start the process, and hand pictures to ``sink`` from a thread.

        Raises:
            SimulationError: the process has not started.
        """
        words = [sys.executable, "-m", "orbit_deploy.eyes"]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        _put(self._process.stdin, pickle.dumps(self._made))
        if _get(self._process.stdout) is None:
            raise SimulationError("the process that draws the robot's cameras has ended: its error is above")
        arguments = (self._process.stdout, sink)
        threading.Thread(target=self._receive, args=arguments, name="robot's eyes", daemon=True).start()

    def offer(self, stamp: int) -> None:
        """Have the pictures that are due drawn; a camera whose last one is not done yet misses one.

        Args:
            stamp: ns on the robot's clock.
        """
        process, cycle = self._process, self._cycle
        self._cycle += 1
        if process is None:
            return
        assert process.stdin is not None
        for place, every in enumerate(self._every):
            if cycle % every or place in self._waiting or process.poll() is not None:
                continue
            self._waiting[place] = stamp
            # A few thousand bytes, which the pipe takes at once as only one picture is under way.
            poses = torch.cat((self._pose(place)[:, None], self._world.link_poses), 1)
            _put(process.stdin, _LENGTH.pack(place) + poses[0].cpu().numpy().astype("<f4").tobytes())

    def close(self) -> None:
        """End the process and free the renderer; idempotent."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _pose(self, place: int) -> Tensor:
        mount = self._mounts[place]
        return mount.pose() if isinstance(mount, Mount) else mount

    def _receive(self, stream: IO[bytes], sink: Callable[[Picture], None]) -> None:
        while (data := _get(stream)) is not None:
            (place,) = _LENGTH.unpack_from(data)
            spec, begin = self._specs[place], _LENGTH.size
            stamp = self._waiting.pop(place)
            for kind in kinds_of(spec):
                end = begin + spec.height * spec.width * kind.channels * kind.dtype.itemsize
                sink(Picture(spec.name, kind, stamp, spec.height, spec.width, data[begin:end]))
                begin = end


def _mount(spec: CameraSpec, world: Any) -> Mount | Tensor:
    """Return where a camera sits: a frame, or its pose (1, 7)."""
    if spec.entity is None or spec.frame is None:
        return pose_tensor(spec.pose, world.device)[None]
    return Mount(world.engine, world.layout, spec.entity, spec.frame, spec.name, spec.pose)


def _draw(
    renderer: Renderer, spec: CameraSpec, pose: Tensor, links: Tensor, kinds: Sequence[PictureKind]
) -> list[bytes]:
    """Return the numbers of a camera's pictures.

    Args:
        renderer: of the scene.
        spec: camera.
        pose: (1, 7) of the camera.
        links: (1, L, 7) of all links.
        kinds: quantities.
    """
    image = renderer.render(spec, pose, links, [_CHANNELS[kind] for kind in kinds])
    pictures: list[Tensor] = [getattr(image, kind.value)[0] for kind in kinds]
    return [
        np.ascontiguousarray(each.cpu().numpy(), kind.dtype).tobytes()
        for each, kind in zip(pictures, kinds, strict=True)
    ]


def _put(stream: IO[bytes], data: bytes) -> None:
    stream.write(_LENGTH.pack(len(data)) + data)
    stream.flush()


def _get(stream: IO[bytes]) -> bytes | None:
    """Read one message; None at the end of the stream."""
    head = stream.read(_LENGTH.size)
    data = stream.read(_LENGTH.unpack(head)[0]) if len(head) == _LENGTH.size else b""
    return data or None


def main() -> None:
    """Draw pictures of poses that come by standard input, and write them to standard output."""
    import os

    # The robot's loop needs the priority that this process has inherited.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    torch.set_num_threads(1)
    reading, writing = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    # Words of libraries must not get into the pictures.
    os.dup2(2, 1)
    made = _get(reading)
    assert made is not None
    scene, specs, backend, settings = pickle.loads(made)  # of the process that has started this one
    world = simulate(scene, 1, backend, settings=settings)
    renderer = world.create_renderer(specs)
    _put(writing, b"ready")
    while (data := _get(reading)) is not None:
        (place,) = _LENGTH.unpack_from(data)
        poses = torch.from_numpy(np.frombuffer(data, "<f4", offset=_LENGTH.size).copy()).view(1, -1, 7)
        pictures = _draw(renderer, specs[place], poses[:, 0], poses[:, 1:], kinds_of(specs[place]))
        _put(writing, _LENGTH.pack(place) + b"".join(pictures))


if __name__ == "__main__":
    main()
