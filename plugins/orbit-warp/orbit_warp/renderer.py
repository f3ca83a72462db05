"""Pictures of a scene from poses alone, by MuJoCo-Warp's ray casts, all environments in one launch."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import CaptureFacet, ConfigurationError, Image, Renderer, SceneLayout
from orbit_core.scene import CameraSpec, Channel
from orbit_warp.config import WarpConfig
from orbit_warp.renderer_model import PictureModel
from orbit_warp.renderer_stage import Stage
from orbit_warp.renderer_trace import EVERY_TYPE, trace_kernel
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.start import start

_SEGMENTED = (Channel.INSTANCE, Channel.SEMANTIC)


class _Capture(CaptureFacet):
    takes_masks = frozenset({"render"})


class WarpRenderer(Renderer):
    """Draws a scene with direct light, shadows and a sky, on the device where the poses are.

    Pictures are made of a ray through each pixel's centre; nothing waits for the host. Depth, links, albedo and normals
    take transparent shapes for solid ones, and normals are those of the faces. Markers are seen in colour alone, and
    cast no shadows.
    """

    capture = _Capture()

    def __init__(self, layout: SceneLayout, config: WarpConfig) -> None:
        start()
        self._model = PictureModel(layout)
        self._shadows = config.shadows
        self._stages: dict[torch.device, tuple[Graphs, Stage]] = {}
        self._closed = False

    def render(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        link_poses: Tensor,
        channels: Sequence[Channel],
        marker_poses: Tensor | None = None,
        env_ids: Tensor | None = None,
    ) -> Image:
        if self._closed:
            raise ConfigurationError("the renderer is closed: make another")
        graphs, stage = self._stage(link_poses.device)
        with torch.no_grad(), graphs.stream():
            mask = env_ids if env_ids is not None and env_ids.dtype == torch.bool else None
            stage.choose(env_ids if mask is None else None)
            stage.place(link_poses, marker_poses)
            return self._trace(camera, camera_poses, stage, set(channels), marker_poses is not None, mask)

    def close(self) -> None:
        self._stages.clear()
        self._closed = True

    def _stage(self, device: torch.device) -> tuple[Graphs, Stage]:
        if device not in self._stages:
            graphs = Graphs(device, capture=False)
            with graphs.stream():
                self._stages[device] = graphs, Stage(self._model)
        return self._stages[device]

    def _trace(
        self,
        camera: CameraSpec,
        camera_poses: Tensor,
        stage: Stage,
        wanted: set[Channel],
        markers: bool,
        mask: Tensor | None,
    ) -> Image:
        """Pictures, of the environments of a mask alone; others are black, and nothing is in them."""
        count, device = len(camera_poses), camera_poses.device
        pixels = camera.width * camera.height

        def buffer(channels: tuple[Channel, ...], depth: int, dtype: torch.dtype) -> Tensor:
            asked = not wanted.isdisjoint(channels)
            make = torch.empty if mask is None else torch.zeros
            return make(count if asked else 0, pixels, depth, dtype=dtype, device=device)

        rgb, albedo = buffer((Channel.RGB,), 3, torch.uint8), buffer((Channel.ALBEDO,), 3, torch.uint8)
        depth, normals = buffer((Channel.DEPTH,), 1, torch.float32), buffer((Channel.NORMALS,), 3, torch.float32)
        links = buffer(_SEGMENTED, 1, torch.int32)
        # A GPU gains by a kernel made for the scene; on a CPU, compiling one takes longer than what it saves.
        types = self._model.geom_types if stage.device.is_cuda else EVERY_TYPE
        wp.launch(
            trace_kernel(types, Channel.RGB in wanted, self._shadows),
            dim=(count, pixels),
            inputs=[
                stage.arrays, wp.from_torch(camera_poses.contiguous()), camera.width, camera.height,
                2.0 * math.tan(0.5 * camera.vertical_fov) / camera.height, camera.near, camera.far, markers,
                stage.everyone if mask is None else wp.from_torch(mask),
            ],
            outputs=[wp.from_torch(tensor) for tensor in (rgb, depth, normals, links, albedo)],
            device=stage.device,
        )  # fmt: skip
        shape = (count, camera.height, camera.width, -1)
        pictures = {"rgb": rgb, "depth": depth, "normals": normals, "links": links, "albedo": albedo}
        return Image(**{name: picture.view(shape) for name, picture in pictures.items() if len(picture)})
