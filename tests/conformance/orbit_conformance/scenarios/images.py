"""Scenarios of images, pixel by pixel against a ray tracer; pixels next to an outline or an edge are left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_conformance.bodies import fixed, scene
from orbit_conformance.raytracing import NOTHING, Hits, pixel_directions, steady, trace
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.rays import octahedron, primitives, ridges
from orbit_core.interfaces import BACKGROUND, TERRAIN, Capability
from orbit_core.scene import (
    AmbientLight,
    Articulation,
    Box,
    CameraSpec,
    Channel,
    DirectionalLight,
    Light,
    Link,
    Mesh,
    MeshCollision,
    ObjectSpec,
    Plane,
    Pose,
    RayCameraSpec,
    Shape,
    Sky,
    Sphere,
    look_at,
)
from orbit_core.scene.pose import Vector3
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors.camera import CameraSensor
from orbit_data.bounding_boxes import CameraBoxes

_COLORS = ((0.9, 0.2, 0.1), (0.1, 0.7, 0.2), (0.2, 0.3, 0.9), (0.8, 0.7, 0.1), (0.6, 0.1, 0.7), (0.3, 0.35, 0.4))
# Distance in metres beyond which nothing is drawn.
_FAR = 6.0
# Error of a depth in metres from which a pixel shows another surface.
_BEHIND = 0.05
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
    # Off all planes of symmetry, so that a mirrored picture differs.
    eye: Vector3 = (2.6, -1.9, 1.9),
    known_as: Sequence[tuple[Geometry, Pose]] | None = None,
    kind: type[CameraSpec] = CameraSpec,
    solid: bool = False,
) -> _View:
    """The picture of solids that stand still on a ground; they are only to be seen, and collide with nothing.

    Where they are meshes of round shapes, those are the truth in ``known_as``: to trace each triangle takes minutes.
    With ``solid`` they collide as well, so that a ``kind`` of camera that casts rays sees them.
    """
    camera = kind(
        name="eye", width=96, height=72, vertical_fov=0.8, channels=channels, far=_FAR,
        pose=look_at(eye, (0.0, 0.0, 0.4)),
    )  # fmt: skip
    objects = [
        _seen(f"thing{n}", geometry, pose, color, solid)
        for n, ((geometry, pose), color) in enumerate(zip(solids, _COLORS, strict=False))
    ]
    terrain = (Shape(ground, color=(*_COLORS[-1], 1.0), name="ground"),)
    # Two environments, which have to look alike.
    world = trial.world(scene(*objects, sensors=(camera,), terrain=terrain), num_envs=2)
    sensor = world.sensors["eye"]
    assert isinstance(sensor, CameraSensor)
    images = {channel: sensor.image(channel).flatten(1, 2).cpu() for channel in channels}
    truth = _truth([*(known_as or solids), (ground, Pose())], camera)
    return _View(images, *truth, camera, sensor.semantic_labels)


def _seen(
    name: str, geometry: Geometry, pose: Pose, color: tuple[float, float, float], solid: bool = False
) -> ObjectSpec:
    shapes = (Shape(geometry, color=(*color, 1.0)),)
    link = Link(name, 1.0, inertia=np.eye(3), visuals=shapes, collisions=shapes if solid else ())
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
    # Pixels of the sky have to be infinite: a far plane's depth would look like a wall.
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


def _dense_ball() -> Mesh:
    """Return a ball of 20,480 triangles, within 0.2 mm of a round one of 0.5 m."""
    from trimesh.creation import icosphere

    surface = icosphere(subdivisions=5, radius=0.5)
    return Mesh(np.asarray(surface.vertices), np.asarray(surface.faces))


def _dense(trial: Trial) -> Mapping[str, float]:
    pose = Pose((0.0, 0.0, 0.6))
    view = _photograph(trial, (Channel.DEPTH,), [(_dense_ball(), pose)], Plane(), known_as=[(Sphere(0.5), pose)])
    hits, found = view.truth, view.images[Channel.DEPTH].double().numpy()[..., 0]
    error = np.abs(found[:, view.met] - hits.distances[view.met])
    sure, ball = view.sure[view.met], (hits.things == 0)[view.met]
    return {"depth": float(error[:, sure & ball].max()), "outline": float((error > _BEHIND)[:, ~sure].mean())}


def _by_rays(trial: Trial) -> Mapping[str, float]:
    """The same picture by rays and by the renderer."""
    channels = (Channel.DEPTH, Channel.NORMALS, Channel.INSTANCE)
    view = _photograph(trial, channels, _things(), Plane(), kind=RayCameraSpec, solid=True)
    drawn = _photograph(trial, (Channel.DEPTH,), _things(), Plane(), solid=True)
    depth, truth = view.of(Channel.DEPTH, view.met)[..., 0], view.truth.distances[view.sure & view.met]
    cosines = (view.of(Channel.NORMALS, view.met) * view.truth.normals[view.sure & view.met]).sum(-1)
    instances = np.array([*range(len(_things())), TERRAIN, BACKGROUND])
    return {
        "depth": float(np.abs(depth - truth).max()),
        "drawn": float(np.abs(depth - drawn.of(Channel.DEPTH, view.met)[..., 0]).max()),
        "normal": float(np.arccos(cosines.clip(-1.0, 1.0)).max()),
        "instance": float((view.of(Channel.INSTANCE)[..., 0] != instances[view.truth.things[view.sure]]).mean()),
        "nothing": float(np.isfinite(view.of(Channel.DEPTH, ~view.met)).mean()),
    }


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
_PRISMS = "an engine without cylinders casts rays against prisms"
_BUFFER = "rasterisers keep the reciprocal of depth, in a buffer of finite resolution"


_Array = npt.NDArray[np.float64]
_Things = Sequence[tuple[Geometry, Pose]]

_LIT_FAR = 8.0
# Distance in metres from a surface at which a ray towards a light starts.
_LIFT = 1e-6
_LIT_COLORS = ((0.9, 0.3, 0.1), (0.2, 0.7, 0.3), (0.3, 0.4, 0.9), (0.8, 0.8, 0.7))
_SKY = Sky(above=(0.2, 0.4, 0.9), below=(0.9, 0.8, 0.6))
_BOXES: _Things = (
    (Box((0.3, 0.2, 0.15)), Pose.from_euler(0.3, 0.0, 0.4, (0.0, -0.7, 0.9))),
    (Box((0.2, 0.25, 0.2)), Pose.from_euler(-0.5, 0.4, 1.0, (0.1, 0.1, 1.0))),
    (Box((0.25, 0.2, 0.1)), Pose.from_euler(0.9, -0.6, 0.2, (-0.2, 0.8, 0.9))),
)
_GROUND: _Things = ((Plane(), Pose()),)
_AROUND = AmbientLight((0.15, 0.2, 0.25))
_WARM = DirectionalLight((-0.4, 0.3, -1.0), (1.0, 0.8, 0.6), 0.5, shadows=False)
_COLD = DirectionalLight((0.2, -1.0, -0.3), (0.2, 0.5, 1.0), 0.4, shadows=False)
_LAMP = DirectionalLight((-0.3, 0.5, -1.0), (1.0, 0.9, 0.8), 0.6)


@dataclass(frozen=True)
class _Picture:
    """Colours (pixels, 3) of 255, found and true, where the truth is the same a pixel further."""

    found: _Array
    true: _Array
    shaded: npt.NDArray[np.bool_]
    """Whether (pixels,) something stands in the way of a light."""
    met: npt.NDArray[np.bool_]
    """Whether (pixels,) the ray meets a surface."""

    def worst(self, where: npt.NDArray[np.bool_]) -> float:
        return float(np.abs(self.found - self.true)[where].max())


def _lit_photograph(trial: Trial, things: _Things, lights: tuple[Light, ...]) -> _Picture:
    camera = CameraSpec(
        name="eye",
        width=64,
        height=48,
        vertical_fov=0.7,
        far=_LIT_FAR,
        pose=look_at((3.4, -0.6, 2.2), (0.0, 0.1, 0.6)),
    )
    objects = [_lit_seen(n, thing, pose) for n, (thing, pose) in enumerate(things) if not isinstance(thing, Plane)]
    terrain = tuple(Shape(thing, pose, color=_color(-1)) for thing, pose in things if isinstance(thing, Plane))
    described = replace(scene(*objects, sensors=(camera,), terrain=terrain), lights=lights, sky=_SKY)
    sensor = trial.world(described, num_envs=1).sensors["eye"]
    assert isinstance(sensor, CameraSensor)
    found = sensor.image(Channel.RGB)[0].flatten(0, 1).cpu().double().numpy()
    views = [_view(things, camera, lights, right, up) for right in (-1.0, 0.0, 1.0) for up in (-1.0, 0.0, 1.0)]
    hits, shaded, true = views.pop(4)
    # A pixel counts only where all rays within it meet the same face in the same light.
    sure = steady(hits, [other for other, _, _ in views], 0.999)
    for _, other, _ in views:
        sure &= (other == shaded).all(-1)
    return _Picture(found[sure], true[sure], np.asarray(shaded[sure].any(-1)), hits.things[sure] != NOTHING)


def _lit_seen(index: int, thing: Geometry, pose: Pose) -> ObjectSpec:
    name = f"thing{index}"
    link = Link(name, 1.0, inertia=np.eye(3), visuals=(Shape(thing, color=_color(index)),))
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), pose=pose, fixed_base=True)


def _color(index: int) -> tuple[float, float, float, float]:
    return (*_LIT_COLORS[index], 1.0)


def _view(
    things: _Things, camera: CameraSpec, lights: Sequence[Light], right: float, up: float
) -> tuple[Hits, npt.NDArray[np.bool_], _Array]:
    """Return each pixel's hit, a mask (pixels, lamps) of directional lights in whose shadow it is, and its colour."""
    directions = pixel_directions(camera, right, up)
    origins = np.broadcast_to(camera.pose.position, directions.shape)
    hits = trace(things, origins, directions)
    # The renderer draws nothing beyond either.
    hits.things[hits.distances > _LIT_FAR] = NOTHING
    met = hits.things != NOTHING
    colors = np.array(
        [_LIT_COLORS[-1] if isinstance(thing, Plane) else _LIT_COLORS[n] for n, (thing, _) in enumerate(things)]
    )
    lamps = [light for light in lights if isinstance(light, DirectionalLight)]
    total = sum((np.array(light.color) for light in lights if isinstance(light, AmbientLight)), np.zeros(3))
    light = np.tile(total, (len(met), 1))
    shaded = np.zeros((len(met), len(lamps)), dtype=np.bool_)
    for number, lamp in enumerate(lamps):
        toward = -np.array(lamp.unit_direction)
        cosine = (hits.normals @ toward).clip(0.0) * met
        # A ray from the surface itself would meet it again by rounding.
        starts = (origins + np.where(met, hits.distances, 0.0)[:, None] * directions) + _LIFT * hits.normals
        blocked = trace(things, starts, np.broadcast_to(toward, starts.shape)).things != NOTHING
        shaded[:, number] = blocked & (cosine > 0.0) & lamp.shadows
        light += np.where(shaded[:, number], 0.0, cosine)[:, None] * np.array(lamp.radiance)
    height = 0.5 * (1.0 + directions[:, 2:] / np.linalg.norm(directions, axis=-1, keepdims=True))
    sky = np.array(_SKY.below) + height * (np.array(_SKY.above) - np.array(_SKY.below))
    return hits, shaded, 255.0 * np.where(met[:, None], (colors[hits.things] * light).clip(0.0, 1.0), sky)


def _lit(trial: Trial) -> Mapping[str, float]:
    around = _lit_photograph(trial, _BOXES, (_AROUND,))
    one, both = (_lit_photograph(trial, _BOXES, lights) for lights in ((_WARM,), (_WARM, _AROUND, _COLD)))
    return {
        "ambient": around.worst(around.met),
        "facing": one.worst(one.met),
        "sum": both.worst(both.met),
        "sky": both.worst(~both.met),
    }


def _shadows(trial: Trial) -> Mapping[str, float]:
    picture = _lit_photograph(trial, [*_BOXES, *_GROUND], (_AROUND, _LAMP))
    ground = picture.met
    wrong = np.abs(picture.found - picture.true).max(-1) > 3.0
    return {
        "dark": float(wrong[picture.shaded].mean()),
        "lit": float(wrong[ground & ~picture.shaded].mean()),
    }


_LAMBERT = "Lambert's law and a ray through each pixel's centre, in double precision"
_SOURCE = "Foley et al., Computer Graphics: Principles and Practice, 2nd ed. (1990), sections 16.1 and 16.4"


_CAMERA = CameraSpec(
    name="eye", width=96, height=72, vertical_fov=0.8, channels=(Channel.INSTANCE,),
    pose=look_at((2.6, -1.9, 1.9), (0.0, 0.0, 0.4)),
)  # fmt: skip
# Number of rays along a pixel's side that find the outlines.
_FINE = 8


def _boxed_things() -> list[tuple[Geometry, Pose]]:
    return [*primitives(), (octahedron(MeshCollision.CONVEX_HULL), Pose.from_euler(0.3, 0.5, 0.1, (0.1, 0.0, 0.6)))]


def _screen() -> tuple[Geometry, Pose]:
    """A plate between the camera and the middle of the scene."""
    place = look_at((1.3, -0.95, 0.9), (0.0, 0.0, 0.4))
    return Box((0.15, 0.25, 0.005)), place


def _boxes(things: list[tuple[Geometry, Pose]], camera: CameraSpec) -> npt.NDArray[np.float64]:
    """Boxes (things, 4) around the pixels whose centre shows each thing, zeros where none does."""
    directions = pixel_directions(camera)
    seen = trace([*things, (Plane(), Pose())], np.broadcast_to(camera.pose.position, directions.shape), directions)
    shown = seen.things.reshape(camera.height, camera.width)
    boxes = np.zeros((len(things), 4))
    for index in range(len(things)):
        rows, columns = np.nonzero(shown == index)
        if len(rows):
            # Edges of pixels, as the boxes' convention has them: the last pixel is inside.
            boxes[index] = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
    return boxes


def _whole(things: list[tuple[Geometry, Pose]]) -> npt.NDArray[np.float64]:
    """Boxes (things, 4) around each thing alone, from rays a fraction of a pixel apart, in the camera's own pixels."""
    fine = CameraSpec(
        name="fine", width=_FINE * _CAMERA.width, height=_FINE * _CAMERA.height, vertical_fov=_CAMERA.vertical_fov,
        pose=_CAMERA.pose,
    )  # fmt: skip
    directions = pixel_directions(fine)
    origins = np.broadcast_to(fine.pose.position, directions.shape)
    boxes = []
    for thing in things:
        shown = np.isfinite(trace([thing], origins, directions).distances).reshape(fine.height, fine.width)
        rows, columns = np.nonzero(shown)
        boxes.append((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))
    return np.array(boxes) / _FINE


def _measure(trial: Trial) -> Mapping[str, float]:
    free, hidden = _boxed_things(), [*_boxed_things(), _screen()]
    errors: dict[str, float] = {}
    truth = {"free": _boxes(free, _CAMERA), "hidden": _boxes(hidden, _CAMERA)}
    whole = torch.as_tensor(_whole(free))
    loose = 0.0
    for case, things in (("free", free), ("hidden", hidden)):
        objects = (fixed(f"thing{n}", geometry, pose) for n, (geometry, pose) in enumerate(things))
        world = trial.world(scene(*objects, sensors=(_CAMERA,)), num_envs=2)
        sensor = world.sensors["eye"]
        assert isinstance(sensor, CameraSensor)
        boxes = CameraBoxes(sensor).in_pictures()
        errors[case] = float((boxes.tight.double().cpu() - torch.as_tensor(truth[case])).abs().max())
        loose = max(loose, float((boxes.loose[:, : len(free)].double().cpu() - whole).abs().max()))
    return {"tight": errors["free"], "hidden": errors["hidden"], "loose": loose}


_BOX_FACETS = "rasterisers draw round shapes as facets, within the true outline"


SCENARIOS = (
    _scenario(
        "depth_images",
        "Is each pixel's depth, and the place that follows from it, right?",
        _depth,
        (Capability.DEPTH,),
        Metric(name="depth", unit="m", tolerance=6e-3, meaning="largest error of a depth", looser_because=_FACETS),
        Metric(name="position", unit="m", tolerance=8e-3, meaning="largest error of a place", looser_because=_FACETS),
        Metric(name="nothing", unit="", tolerance=0.0, meaning="part of the pixels that see something in the void"),
    ),
    _scenario(
        "depth_images_of_terrain",
        "Is the depth of a height field right?",
        _terrain,
        (Capability.DEPTH, Capability.HEIGHT_FIELDS),
        Metric(name="depth", unit="m", tolerance=2e-4, meaning="largest error of a depth", looser_because=_BUFFER),
    ),
    _scenario(
        "depth_images_of_dense_meshes",
        "Does a mesh of many triangles keep its depth and its outline?",
        _dense,
        (Capability.DEPTH,),
        Metric(name="depth", unit="m", tolerance=1e-3, meaning="largest error of a depth", looser_because=_FACETS),
        Metric(
            name="outline",
            unit="",
            tolerance=8e-3,
            meaning="part of the pixels next to an outline that show what is behind it, or the reverse",
            looser_because=_FACETS,
        ),
    ),
    _scenario(
        "ray_camera",
        "Does a camera of rays show what the engine collides with, as the renderer draws it?",
        _by_rays,
        (Capability.RAY_CASTS, Capability.DEPTH),
        Metric(name="depth", unit="m", tolerance=6e-3, meaning="largest error of a depth", looser_because=_PRISMS),
        Metric(
            name="drawn",
            unit="m",
            tolerance=6e-3,
            meaning="largest difference from the rendered depth",
            looser_because=_FACETS,
        ),
        Metric(name="normal", unit="rad", tolerance=0.1, meaning="largest angle to the true", looser_because=_PRISMS),
        Metric(name="instance", unit="", tolerance=0.0, meaning="part of the pixels that name another entity"),
        Metric(name="nothing", unit="", tolerance=0.0, meaning="part of the pixels that see something in the void"),
    ),
    _scenario(
        "normal_images",
        "Does each pixel's normal stand on its surface?",
        _normals,
        (Capability.NORMALS,),
        Metric(name="normal", unit="rad", tolerance=0.05, meaning="largest angle to the true", looser_because=_FACETS),
    ),
    _scenario(
        "segmentation_images",
        "Does each pixel name the thing that it shows?",
        _segmentation,
        (Capability.SEGMENTATION,),
        Metric(name="instance", unit="", tolerance=0.0, meaning="part of the pixels that name another entity"),
        Metric(name="semantic", unit="", tolerance=0.0, meaning="part of the pixels that name another label"),
    ),
    _scenario(
        "albedo_images",
        "Has each pixel its shape's own colour?",
        _albedo,
        (Capability.ALBEDO,),
        Metric(name="albedo", unit="of 255", tolerance=1.5, meaning="largest error of a channel"),
    ),
    Scenario(
        name="lit_images",
        group="Images",
        question="Has each face the colour that the scene's lights give it?",
        truth=f"{_LAMBERT}; pixels beside an outline or edge left out",
        source=_SOURCE,
        run=_lit,
        needs=(Capability.RGB, Capability.LIGHTING),
        judges=(Capability.LIGHTING,),
        time_steps=(),
        metrics=(
            Metric(name="ambient", unit="of 255", tolerance=1.0, meaning="largest error of a channel in ambient light"),
            Metric(name="facing", unit="of 255", tolerance=1.0, meaning="the same in one light, also on faces away"),
            Metric(name="sum", unit="of 255", tolerance=1.0, meaning="the same in two lights and ambient light"),
            Metric(name="sky", unit="of 255", tolerance=1.0, meaning="the same of the sky"),
        ),
    ),
    Scenario(
        name="shadows",
        group="Images",
        question="Do things cast shadows where they should, as dark as the ambient light leaves them?",
        truth=f"{_LAMBERT} and one towards the light; pixels beside an outline, edge or shadow's edge left out",
        source=_SOURCE,
        run=_shadows,
        needs=(Capability.RGB, Capability.LIGHTING, Capability.SHADOWS),
        judges=(Capability.SHADOWS,),
        time_steps=(),
        metrics=(
            Metric(name="dark", unit="", tolerance=0.0, meaning="part of the shadowed pixels more than 3 of 255 off"),
            Metric(name="lit", unit="", tolerance=0.0, meaning="part of the lit pixels more than 3 of 255 off"),
        ),
    ),
    Scenario(
        name="bounding_boxes",
        group="Images",
        question="Do boxes stand tight around what is seen of a thing, and loose around all of it?",
        truth="rays through the pixels' centres, in double precision; eight rays to a pixel's side for whole outlines",
        source="Ericson, Real-Time Collision Detection (2005), section 5.3; Hartley and Zisserman, Multiple View "
        "Geometry, 2nd ed., sections 6.1 and 8.3",
        run=_measure,
        needs=(Capability.SEGMENTATION,),
        judges=(Capability.SEGMENTATION,),
        time_steps=(),
        metrics=(
            Metric(
                name="tight",
                unit="pixels",
                tolerance=1.0,
                meaning="largest error of a side, nothing in the way",
                looser_because=_BOX_FACETS,
            ),
            Metric(
                name="hidden",
                unit="pixels",
                tolerance=1.0,
                meaning="the same, with a plate before some",
                looser_because=_BOX_FACETS,
            ),
            Metric(
                name="loose",
                unit="pixels",
                tolerance=0.13,
                meaning="largest error of a side of the whole thing's box; the truth is known to 1/8 of a pixel",
            ),
        ),
    ),
)
