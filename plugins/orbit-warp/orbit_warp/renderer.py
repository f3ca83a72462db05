"""Pictures of a scene from poses alone, by MuJoCo-Warp's ray casts, all environments in one launch."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

from __future__ import annotations

import math
from dataclasses import replace

import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import CaptureFacet, Image, SceneLayout
from orbit_core.plugin_kit.rendering import PIXELS, Kind, KitRenderer, Request
from orbit_warp.config import WarpConfig
from orbit_warp.renderer_model import PictureModel
from orbit_warp.renderer_stage import Stage
from orbit_warp.renderer_trace import BLOCK_THREADS, TraceOptions, trace_kernel
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.start import start


class _Capture(CaptureFacet):
    takes_masks = frozenset({"render"})


class WarpRenderer(KitRenderer):
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

    def draw(self, request: Request) -> Image:
        graphs, stage = self._stage(request.link_poses.device)
        with torch.no_grad(), graphs.stream():
            ids = request.env_ids
            mask = ids if ids is not None and ids.dtype == torch.bool else None
            rows = ids if mask is None else None
            stage.choose(rows, request.marker_poses is not None, self.link_colors)
            stage.light(rows, self.lights)
            stage.place(request.link_poses, request.marker_poses)
            return self._trace(request, stage, mask)

    def free(self) -> None:
        self._stages.clear()

    def _stage(self, device: torch.device) -> tuple[Graphs, Stage]:
        if device not in self._stages:
            graphs = Graphs(device, capture=False)
            with graphs.stream():
                self._stages[device] = graphs, Stage(self._model)
        return self._stages[device]

    def _trace(self, request: Request, stage: Stage, mask: Tensor | None) -> Image:
        """Pictures, of the environments of a mask alone; others are black, and nothing is in them."""
        camera, wanted, poses = request.camera, request.wanted, request.camera_poses
        count, pixels = len(poses), camera.width * camera.height
        make = torch.empty if mask is None else torch.zeros
        pictures: dict[Kind, Tensor] = {
            kind: make(count if kind in wanted else 0, pixels, depth, dtype=dtype, device=poses.device)
            for kind, (depth, dtype) in PIXELS.items()
        }
        options = TraceOptions(color="rgb" in wanted, shadows=self._shadows, textured=self._model.textured)
        # A GPU gains by a kernel made for the scene; on a CPU, compiling one takes longer than what it saves.
        if stage.device.is_cuda:
            marked = options.color and request.marker_poses is not None
            options = replace(
                options, geom_types=self._model.geom_types, markers=marked,
                transparent=self._model.transparent(marked), fast_math=True,
            )  # fmt: skip
        wp.launch(
            trace_kernel(options),
            dim=(count, pixels),
            inputs=[
                stage.arrays, wp.from_torch(poses.contiguous()), camera.width, camera.height,
                2.0 * math.tan(0.5 * camera.vertical_fov) / camera.height, camera.near, camera.far,
                request.marker_poses is not None, stage.everyone if mask is None else wp.from_torch(mask),
            ],
            outputs=[wp.from_torch(picture) for picture in pictures.values()],
            device=stage.device, block_dim=BLOCK_THREADS,
        )  # fmt: skip
        shape = (count, camera.height, camera.width, -1)
        return Image(**{kind: picture.view(shape) for kind, picture in pictures.items() if kind in wanted})
