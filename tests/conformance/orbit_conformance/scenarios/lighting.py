"""Colours of flat faces in known light, pixel by pixel; pixels next to an outline or a shadow's edge are left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from orbit_conformance.bodies import scene
from orbit_conformance.raytracing import NOTHING, Hits, pixel_directions, steady, trace
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_core.interfaces import Capability
from orbit_core.scene import (
    AmbientLight,
    Articulation,
    Box,
    CameraSpec,
    Channel,
    DirectionalLight,
    Light,
    Link,
    ObjectSpec,
    Plane,
    Pose,
    Shape,
    Sky,
    look_at,
)
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors.camera import CameraSensor

_Array = npt.NDArray[np.float64]
_Things = Sequence[tuple[Geometry, Pose]]

_FAR = 8.0
# Distance in metres from a surface at which a ray towards a light starts.
_LIFT = 1e-6
_COLORS = ((0.9, 0.3, 0.1), (0.2, 0.7, 0.3), (0.3, 0.4, 0.9), (0.8, 0.8, 0.7))
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


def _photograph(trial: Trial, things: _Things, lights: tuple[Light, ...]) -> _Picture:
    camera = CameraSpec(
        name="eye", width=64, height=48, vertical_fov=0.7, far=_FAR, pose=look_at((3.4, -0.6, 2.2), (0.0, 0.1, 0.6))
    )
    objects = [_seen(n, thing, pose) for n, (thing, pose) in enumerate(things) if not isinstance(thing, Plane)]
    terrain = tuple(Shape(thing, pose, color=_color(-1)) for thing, pose in things if isinstance(thing, Plane))
    described = replace(scene(*objects, sensors=(camera,), terrain=terrain), lights=lights, sky=_SKY)
    sensor = trial.world(described, num_envs=1).sensors["eye"]
    assert isinstance(sensor, CameraSensor)
    found = sensor.image(Channel.RGB)[0].flatten(0, 1).cpu().double().numpy()
    views = [_view(things, camera, lights, right, up) for right in (-1.0, 0.0, 1.0) for up in (-1.0, 0.0, 1.0)]
    hits, shaded, true = views.pop(4)
    sure = steady(hits, [other for other, _, _ in views], 0.999)
    for _, other, _ in views:
        sure &= (other == shaded).all(-1)
    return _Picture(found[sure], true[sure], np.asarray(shaded[sure].any(-1)), hits.things[sure] != NOTHING)


def _seen(index: int, thing: Geometry, pose: Pose) -> ObjectSpec:
    name = f"thing{index}"
    link = Link(name, 1.0, inertia=np.eye(3), visuals=(Shape(thing, color=_color(index)),))
    return ObjectSpec(name=name, articulation=Articulation(name, (link,)), pose=pose, fixed_base=True)


def _color(index: int) -> tuple[float, float, float, float]:
    return (*_COLORS[index], 1.0)


def _view(
    things: _Things, camera: CameraSpec, lights: Sequence[Light], right: float, up: float
) -> tuple[Hits, npt.NDArray[np.bool_], _Array]:
    """Return each pixel's hit, a mask (pixels, lamps) of directional lights in whose shadow it is, and its colour."""
    directions = pixel_directions(camera, right, up)
    origins = np.broadcast_to(camera.pose.position, directions.shape)
    hits = trace(things, origins, directions)
    hits.things[hits.distances > _FAR] = NOTHING
    met = hits.things != NOTHING
    colors = np.array([_COLORS[-1] if isinstance(thing, Plane) else _COLORS[n] for n, (thing, _) in enumerate(things)])
    lamps = [light for light in lights if isinstance(light, DirectionalLight)]
    total = sum((np.array(light.color) for light in lights if isinstance(light, AmbientLight)), np.zeros(3))
    light = np.tile(total, (len(met), 1))
    shaded = np.zeros((len(met), len(lamps)), dtype=np.bool_)
    for number, lamp in enumerate(lamps):
        toward = -np.array(lamp.unit_direction)
        cosine = (hits.normals @ toward).clip(0.0) * met
        starts = (origins + np.where(met, hits.distances, 0.0)[:, None] * directions) + _LIFT * hits.normals
        blocked = trace(things, starts, np.broadcast_to(toward, starts.shape)).things != NOTHING
        shaded[:, number] = blocked & (cosine > 0.0) & lamp.shadows
        light += np.where(shaded[:, number], 0.0, cosine)[:, None] * np.array(lamp.radiance)
    height = 0.5 * (1.0 + directions[:, 2:] / np.linalg.norm(directions, axis=-1, keepdims=True))
    sky = np.array(_SKY.below) + height * (np.array(_SKY.above) - np.array(_SKY.below))
    return hits, shaded, 255.0 * np.where(met[:, None], (colors[hits.things] * light).clip(0.0, 1.0), sky)


def _lit(trial: Trial) -> Mapping[str, float]:
    around = _photograph(trial, _BOXES, (_AROUND,))
    one, both = (_photograph(trial, _BOXES, lights) for lights in ((_WARM,), (_WARM, _AROUND, _COLD)))
    return {
        "ambient": around.worst(around.met),
        "facing": one.worst(one.met),
        "sum": both.worst(both.met),
        "sky": both.worst(~both.met),
    }


def _shadows(trial: Trial) -> Mapping[str, float]:
    picture = _photograph(trial, [*_BOXES, *_GROUND], (_AROUND, _LAMP))
    ground = picture.met
    wrong = np.abs(picture.found - picture.true).max(-1) > 3.0
    return {
        "dark": float(wrong[picture.shaded].mean()),
        "lit": float(wrong[ground & ~picture.shaded].mean()),
    }


_LAMBERT = "Lambert's law and a ray through each pixel's centre, in double precision"
_SOURCE = "Foley et al., Computer Graphics: Principles and Practice, 2nd ed. (1990), sections 16.1 and 16.4"

SCENARIOS = (
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
)
