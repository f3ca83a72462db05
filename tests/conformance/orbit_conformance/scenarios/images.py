"""Images of known shapes, pixel by pixel against a ray tracer; pixels next to an outline or an edge are left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from torch import Tensor

from orbit_conformance.bodies import scene
from orbit_conformance.raytracing import NOTHING, Hits, pixel_directions, steady, trace
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.rays import octahedron, primitives, ridges
from orbit_core.interfaces import BACKGROUND, TERRAIN, Capability
from orbit_core.scene import (
    Articulation,
    CameraSpec,
    Channel,
    Link,
    MeshCollision,
    ObjectSpec,
    Plane,
    Pose,
    Shape,
    look_at,
)
from orbit_core.scene.pose import Vector3
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors.camera import CameraSensor

_COLORS = ((0.9, 0.2, 0.1), (0.1, 0.7, 0.2), (0.2, 0.3, 0.9), (0.8, 0.7, 0.1), (0.6, 0.1, 0.7), (0.3, 0.35, 0.4))
# Distance in metres beyond which nothing is drawn.
_FAR = 6.0
# Cosine of the angle by which the surface may turn from a pixel to the next.
_ALIKE = 0.9


@dataclass(frozen=True)
class _View:
    """Images (2, pixels, channels) and what is to be seen in them."""

    images: Mapping[Channel, Tensor]
    truth: Hits
    sure: npt.NDArray[np.bool_]
    """Whether (pixels,) the truth is certain: the pixel is not beside an outline or an edge."""
    camera: CameraSpec
    labels: tuple[str, ...]

    def of(self, channel: Channel, where: npt.NDArray[np.bool_] | None = None) -> npt.NDArray[np.float64]:
        """The pixels of one kind (2, pixels, channels)."""
        rows = self.sure if where is None else self.sure & where
        return self.images[channel].double().numpy()[:, rows]

    @property
    def met(self) -> npt.NDArray[np.bool_]:
        return self.truth.things != NOTHING


def _things() -> list[tuple[Geometry, Pose]]:
    return [*primitives(), (octahedron(MeshCollision.CONVEX_HULL), Pose.from_euler(0.3, 0.5, 0.1, (0.1, 0.0, 0.6)))]


def _photograph(
    trial: Trial,
    channels: tuple[Channel, ...],
    solids: Sequence[tuple[Geometry, Pose]],
    ground: Geometry,
    eye: Vector3 = (2.6, -1.9, 1.9),
) -> _View:
    """The picture of solids that stand still on a ground; they are only to be seen, and collide with nothing."""
    camera = CameraSpec(
        name="eye", width=96, height=72, vertical_fov=0.8, channels=channels, far=_FAR,
        pose=look_at(eye, (0.0, 0.0, 0.4)),
    )  # fmt: skip
    objects = [
        _seen(f"thing{n}", geometry, pose, color)
        for n, ((geometry, pose), color) in enumerate(zip(solids, _COLORS, strict=False))
    ]
    terrain = (Shape(ground, color=(*_COLORS[-1], 1.0), name="ground"),)
    world = trial.world(scene(*objects, sensors=(camera,), terrain=terrain), num_envs=2)
    sensor = world.sensors["eye"]
    assert isinstance(sensor, CameraSensor)
    images = {channel: sensor.image(channel).flatten(1, 2).cpu() for channel in channels}
    return _View(images, *_truth([*solids, (ground, Pose())], camera), camera, sensor.semantic_labels)


def _seen(name: str, geometry: Geometry, pose: Pose, color: tuple[float, float, float]) -> ObjectSpec:
    link = Link(name, 1.0, inertia=np.eye(3), visuals=(Shape(geometry, color=(*color, 1.0)),))
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), pose=pose, fixed_base=True)


def _truth(things: Sequence[tuple[Geometry, Pose]], camera: CameraSpec) -> tuple[Hits, npt.NDArray[np.bool_]]:
    def seen(right: float, up: float) -> Hits:
        directions = pixel_directions(camera, right, up)
        hits = trace(things, np.broadcast_to(camera.pose.position, directions.shape), directions)
        beyond = hits.distances > _FAR
        hits.things[beyond], hits.distances[beyond], hits.normals[beyond] = NOTHING, np.inf, 0.0
        return hits

    beside = [seen(right, up) for right in (-1.0, 0.0, 1.0) for up in (-1.0, 0.0, 1.0) if right or up]
    hits = seen(0.0, 0.0)
    return hits, steady(hits, beside, _ALIKE)


def _depth(trial: Trial) -> Mapping[str, float]:
    view = _photograph(trial, (Channel.DEPTH, Channel.POSITION), _things(), Plane())
    truth = view.truth.distances[view.sure & view.met]
    points = view.camera.pose.position + truth[:, None] * pixel_directions(view.camera)[view.sure & view.met]
    nothing = view.of(Channel.DEPTH, ~view.met)
    return {
        "depth": float(np.abs(view.of(Channel.DEPTH, view.met)[..., 0] - truth).max()),
        "position": float(np.linalg.norm(view.of(Channel.POSITION, view.met) - points, axis=-1).max()),
        "nothing": float(np.isfinite(nothing).mean()),
    }


def _terrain(trial: Trial) -> Mapping[str, float]:
    view = _photograph(trial, (Channel.DEPTH,), [], ridges(), eye=(1.2, -0.8, 2.4))
    found, truth = view.of(Channel.DEPTH, view.met)[..., 0], view.truth.distances[view.sure & view.met]
    return {"depth": float(np.abs(found - truth).max())}


def _normals(trial: Trial) -> Mapping[str, float]:
    view = _photograph(trial, (Channel.NORMALS,), _things(), Plane())
    cosines = (view.of(Channel.NORMALS, view.met) * view.truth.normals[view.sure & view.met]).sum(-1)
    return {"normal": float(np.arccos(cosines.clip(-1.0, 1.0)).max())}


def _segmentation(trial: Trial) -> Mapping[str, float]:
    things = _things()
    view = _photograph(trial, (Channel.INSTANCE, Channel.SEMANTIC), things, Plane())
    names = [*(f"thing{n}" for n in range(len(things))), "terrain"]
    instances = np.array([*range(len(things)), TERRAIN, BACKGROUND])
    labels = np.array([*(view.labels.index(name) for name in names), BACKGROUND])
    seen = view.truth.things[view.sure]  # NOTHING is the last
    return {
        "instance": float((view.of(Channel.INSTANCE)[..., 0] != instances[seen]).mean()),
        "semantic": float((view.of(Channel.SEMANTIC)[..., 0] != labels[seen]).mean()),
    }


def _albedo(trial: Trial) -> Mapping[str, float]:
    view = _photograph(trial, (Channel.ALBEDO,), _things(), Plane())
    colors = 255.0 * np.array([*_COLORS, (0.0, 0.0, 0.0)])
    return {"albedo": float(np.abs(view.of(Channel.ALBEDO) - colors[view.truth.things[view.sure]]).max())}


def _scenario(
    name: str,
    question: str,
    run: Callable[[Trial], Mapping[str, float]],
    needs: tuple[Capability, ...],
    *metrics: Metric,
) -> Scenario:
    return Scenario(
        name=name,
        group="Images",
        question=question,
        truth="a ray through each pixel's centre, in double precision; pixels beside an outline or edge left out",
        source="Ericson, Real-Time Collision Detection (2005), section 5.3; Hartley and Zisserman, Multiple View "
        "Geometry, 2nd ed., section 6.1",
        run=run,
        needs=needs,
        judges=needs,
        time_steps=(),
        metrics=metrics,
    )


_FACETS = "rasterisers draw round shapes as facets"
_BUFFER = "rasterisers keep the reciprocal of depth, in a buffer of finite resolution"

SCENARIOS = (
    _scenario(
        "depth_images", "Is each pixel's depth, and the place that follows from it, right?", _depth,
        (Capability.DEPTH,),
        Metric(name="depth", unit="m", tolerance=6e-3, meaning="largest error of a depth", looser_because=_FACETS),
        Metric(name="position", unit="m", tolerance=8e-3, meaning="largest error of a place", looser_because=_FACETS),
        Metric(name="nothing", unit="", tolerance=0.0, meaning="part of the pixels that see something in the void"),
    ),
    _scenario(
        "depth_images_of_terrain", "Is the depth of a height field right?", _terrain,
        (Capability.DEPTH, Capability.HEIGHT_FIELDS),
        Metric(name="depth", unit="m", tolerance=2e-4, meaning="largest error of a depth", looser_because=_BUFFER),
    ),
    _scenario(
        "normal_images", "Does each pixel's normal stand on its surface?", _normals, (Capability.NORMALS,),
        Metric(name="normal", unit="rad", tolerance=0.05, meaning="largest angle to the true", looser_because=_FACETS),
    ),
    _scenario(
        "segmentation_images", "Does each pixel name the thing that it shows?", _segmentation,
        (Capability.SEGMENTATION,),
        Metric(name="instance", unit="", tolerance=0.0, meaning="part of the pixels that name another entity"),
        Metric(name="semantic", unit="", tolerance=0.0, meaning="part of the pixels that name another label"),
    ),
    _scenario(
        "albedo_images", "Has each pixel its shape's own colour?", _albedo, (Capability.ALBEDO,),
        Metric(name="albedo", unit="of 255", tolerance=1.5, meaning="largest error of a channel"),
    ),
)  # fmt: skip
