"""Pictures of a robot's cameras: messages, the newest ones of a link, and the view that a task's camera has of them."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from enum import StrEnum

import msgspec
import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import CameraSpec, Channel

# Seconds that a first picture, or one after a motion, is waited for, and after which a silent camera is lost
_WAITED, _LOST = 5.0, 1.0
# Periods of a slow camera that it may miss
_MISSED = 5.0
# Share by which a field of view may be narrower than the task's, as calibrated cameras differ from their data sheets
_NARROWER = 0.02
_MOST_PIXELS = 1 << 24


class PictureKind(StrEnum):
    """Quantity that a picture holds."""

    RGB = "rgb"
    """uint8, red, green and blue."""
    DEPTH = "depth"
    """float32, metres along the optical axis; infinite where nothing is seen."""

    @property
    def dtype(self) -> np.dtype[np.uint8] | np.dtype[np.float32]:
        """Type of the numbers, little-endian."""
        return np.dtype(np.uint8) if self is PictureKind.RGB else np.dtype("<f4")

    @property
    def channels(self) -> int:
        """Numbers of a pixel."""
        return 3 if self is PictureKind.RGB else 1


class CameraDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Camera of a robot: a pinhole with the distortion of OpenCV's model ``plumb_bob``."""

    name: str
    """Name that tasks know it by."""
    width: int
    """Columns, pixels."""
    height: int
    """Rows, pixels."""
    focal: tuple[float, float]
    """Focal lengths across and down, pixels."""
    center: tuple[float, float]
    """Point of the optical axis from the left and the top edge, pixels."""
    distortion: list[float] = []
    """Coefficients k1, k2, p1, p2, k3; empty for a rectified picture."""
    kinds: list[PictureKind] = msgspec.field(default_factory=lambda: [PictureKind.RGB])
    """Pictures that are taken."""
    rate: float = 0.0
    """Pictures in a second, Hz; 0 if unknown."""

    @staticmethod
    def of(spec: CameraSpec, rate: float) -> CameraDescription:
        """Describe a camera of a scene.

        Args:
            spec: camera.
            rate: pictures in a second.

        Raises:
            ConfigurationError: a robot's camera takes no such pictures.
        """
        focal = 0.5 * spec.height / math.tan(0.5 * spec.vertical_fov)
        return CameraDescription(
            name=spec.name,
            width=spec.width,
            height=spec.height,
            focal=(focal, focal),
            center=(0.5 * spec.width, 0.5 * spec.height),
            kinds=kinds_of(spec),
            rate=rate,
        )

    def check(self) -> None:
        """Check that the numbers are those of a camera.

        Raises:
            ConfigurationError: names the camera.
        """
        numbers = (*self.focal, *self.center, *self.distortion, self.rate)
        if (
            min(self.width, self.height) < 1
            or self.width * self.height > _MOST_PIXELS
            or min(self.focal) <= 0.0
            or not all(map(math.isfinite, numbers))
            or len(self.distortion) > 5
        ):
            raise ConfigurationError(
                f"camera '{self.name}' has {self.width} by {self.height} pixels, focal lengths {self.focal} and "
                f"{len(self.distortion)} coefficients of distortion: those of no calibrated pinhole camera"
            )


class Picture(msgspec.Struct, frozen=True, array_like=True, tag="picture"):
    """One picture."""

    camera: str
    """Name of the camera."""
    kind: PictureKind
    """Quantity of its numbers."""
    stamp: int
    """Time on the robot's clock, ns."""
    height: int
    """Rows."""
    width: int
    """Columns."""
    data: bytes
    """Numbers, little-endian, row by row from the top."""

    def pixels(self) -> np.ndarray:
        """Return the numbers (height, width, channels).

        Raises:
            ConfigurationError: there are more or fewer of them.
        """
        shape = (self.height, self.width, self.kind.channels)
        if min(shape) < 1 or math.prod(shape) * self.kind.dtype.itemsize != len(self.data):
            raise ConfigurationError(
                f"a picture of camera '{self.camera}' has {len(self.data)} bytes, which are not {shape[0]} rows of "
                f"{shape[1]} pixels"
            )
        return np.frombuffer(self.data, self.kind.dtype).reshape(shape)


def kinds_of(spec: CameraSpec) -> list[PictureKind]:
    """Return the pictures that a scene's camera needs; points follow from depth.

    Raises:
        ConfigurationError: a robot's camera takes no such pictures.
    """
    found: list[PictureKind] = []
    for channel in spec.channels:
        if channel is Channel.RGB:
            found.append(PictureKind.RGB)
        elif channel in (Channel.DEPTH, Channel.POSITION):
            found.append(PictureKind.DEPTH)
        else:
            raise ConfigurationError(
                f"camera '{spec.name}' has channel {channel.value}, which no camera of a robot takes: use rgb and depth"
            )
    return list(dict.fromkeys(found))


class PictureBox:
    """Newest picture of each camera and kind, from the thread that receives them to the one that looks."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, PictureKind], tuple[Picture, float]] = {}
        self._changed = threading.Condition()
        self._fault = ""

    def put(self, picture: Picture) -> None:
        """Keep a picture in the place of the one before."""
        with self._changed:
            self._newest[picture.camera, picture.kind] = picture, time.monotonic()
            self._changed.notify_all()

    def fail(self, text: str) -> None:
        """Have whoever looks next know that what came is no picture."""
        with self._changed:
            self._fault = text
            self._changed.notify_all()

    def newest(self, camera: CameraDescription, kind: PictureKind, since: int = 0) -> Picture:
        """Return the newest picture, waiting for one that was taken late enough.

        Args:
            camera: of the robot.
            kind: quantity.
            since: ns on the robot's clock before which pictures show what is no longer so.

        Raises:
            ConfigurationError: the camera is silent, or sends something else.
        """
        key = camera.name, kind
        with self._changed:
            fresh = self._changed.wait_for(
                lambda: bool(self._fault) or (key in self._newest and self._newest[key][0].stamp >= since), _WAITED
            )
            if self._fault:
                raise ConfigurationError(f"camera '{camera.name}': {self._fault}")
            if not fresh:
                raise ConfigurationError(f"camera '{camera.name}' has sent no {kind} picture for {_WAITED:g} s")
            picture, arrived = self._newest[key]
        silent, patience = time.monotonic() - arrived, max(_LOST, _MISSED / camera.rate if camera.rate else 0.0)
        if silent > patience:
            raise ConfigurationError(f"camera '{camera.name}' has sent no {kind} picture for {silent:.2f} s")
        return picture


def check_cameras(specs: Sequence[CameraSpec], cameras: Sequence[CameraDescription], where: str) -> None:
    """Compare a task's cameras with those of a robot.

    Args:
        specs: cameras of the task's scene.
        cameras: of the robot.
        where: address, for messages.

    Raises:
        ConfigurationError: the robot has no such camera, or it does not see all that the task's sees.
    """
    known = {each.name: each for each in cameras}
    for spec in specs:
        camera = known.get(spec.name)
        if camera is None:
            raise ConfigurationError(
                f"the robot at {where} has no camera '{spec.name}': it has {', '.join(known) or 'none'}"
            )
        if missing := [kind for kind in kinds_of(spec) if kind not in camera.kinds]:
            raise ConfigurationError(
                f"camera '{spec.name}' of the robot at {where} takes no {' and no '.join(missing)} pictures, which the "
                "task's has"
            )
        PictureView(spec, camera)


class PictureView:
    """View that a task's camera has, cut out of the pictures of a robot's camera in the same place.

    Distortion is removed, and pixels are averaged where the robot's are finer.

    Args:
        spec: camera of the task.
        camera: of the robot, which sees at least as much.

    Raises:
        ConfigurationError: it sees less.
    """

    def __init__(self, spec: CameraSpec, camera: CameraDescription) -> None:
        camera.check()
        self._spec, self._camera = spec, camera
        focal = 0.5 * spec.height / math.tan(0.5 * spec.vertical_fov)
        # Samples of a pixel each way, so that fine pictures do not alias.
        self._fine = max(1, round(max(camera.focal) / focal))
        fine, coarse = _places(spec, camera, focal, self._fine), _places(spec, camera, focal, 1)
        # Unchanged pictures, as of a simulated camera of the same task, need no interpolation.
        size = torch.tensor((camera.width, camera.height))
        middles = torch.stack(
            torch.meshgrid(torch.arange(camera.width) + 0.5, torch.arange(camera.height) + 0.5, indexing="xy"), -1
        )
        self._same = coarse.shape == middles.shape and bool(torch.allclose(coarse, middles, atol=1e-2))
        seen = (coarse / size - 0.5).abs().max()
        if float(seen) > 0.5 * (1.0 + _NARROWER):
            raise ConfigurationError(
                f"camera '{spec.name}' of the robot sees less than the task's, {2.0 * float(seen):.2f} times as much "
                "would do: use a camera or a crop with a wider field of view"
            )
        self._fine_grid, self._grid = (2.0 * places / size - 1.0 for places in (fine, coarse))

    def see(self, picture: Picture) -> Tensor:
        """Return what the task's camera sees, (1, H, W, channels).

        Raises:
            ConfigurationError: the picture is of another size than the camera's.
        """
        pixels, camera = picture.pixels(), self._camera
        if pixels.shape[:2] != (camera.height, camera.width):
            raise ConfigurationError(
                f"a picture of camera '{camera.name}' has {pixels.shape[1]} by {pixels.shape[0]} pixels, and the "
                f"camera {camera.width} by {camera.height}"
            )
        # A copy: the message's bytes cannot be written.
        image = torch.from_numpy(pixels.copy())[None]
        if picture.kind is PictureKind.DEPTH:
            # Cameras say NaN or zero where they measure nothing.
            image = torch.where(image > 0.0, image, torch.inf)
        if self._same:
            return image
        source = image.permute(0, 3, 1, 2)
        if picture.kind is PictureKind.DEPTH:
            # Depths of two surfaces must not be blended.
            seen = torch.nn.functional.grid_sample(source, self._grid[None], mode="nearest", align_corners=False)
            return seen.permute(0, 2, 3, 1)
        seen = torch.nn.functional.grid_sample(
            source.float(), self._fine_grid[None], padding_mode="border", align_corners=False
        )
        seen = torch.nn.functional.avg_pool2d(seen, self._fine)
        return (seen.permute(0, 2, 3, 1) + 0.5).to(torch.uint8)


def _places(spec: CameraSpec, camera: CameraDescription, focal: float, fine: int) -> Tensor:
    """Return the places (H * fine, W * fine, 2), u and v in pixels, where a robot's camera has a task's pixels."""
    columns = (torch.arange(spec.width * fine) + 0.5) / fine - 0.5 * spec.width
    rows = (torch.arange(spec.height * fine) + 0.5) / fine - 0.5 * spec.height
    x, y = torch.meshgrid(columns / focal, rows / focal, indexing="xy")
    k1, k2, p1, p2, k3 = (*camera.distortion, *[0.0] * (5 - len(camera.distortion)))
    square = x**2 + y**2
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    across = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x**2)
    down = y * radial + p1 * (square + 2.0 * y**2) + 2.0 * p2 * x * y
    return torch.stack((camera.focal[0] * across + camera.center[0], camera.focal[1] * down + camera.center[1]), -1)
