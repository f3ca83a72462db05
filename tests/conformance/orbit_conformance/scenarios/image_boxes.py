"""Bounding boxes in pictures of known shapes, side by side and one before the other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import torch

from orbit_conformance.bodies import fixed, scene
from orbit_conformance.raytracing import pixel_directions, trace
from orbit_conformance.scenario import Metric, Scenario, Trial
from orbit_conformance.scenarios.rays import octahedron, primitives
from orbit_core.interfaces import Capability
from orbit_core.scene import Box, CameraSpec, Channel, MeshCollision, Plane, Pose, look_at
from orbit_core.scene.shapes import Geometry
from orbit_core.sensors.camera import CameraSensor
from orbit_data.bounding_boxes import CameraBoxes

_CAMERA = CameraSpec(
    name="eye", width=96, height=72, vertical_fov=0.8, channels=(Channel.INSTANCE,),
    pose=look_at((2.6, -1.9, 1.9), (0.0, 0.0, 0.4)),
)  # fmt: skip
_FINE = 8
"""Number of rays along a pixel's side that find the outlines."""


def _things() -> list[tuple[Geometry, Pose]]:
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
    free, hidden = _things(), [*_things(), _screen()]
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


_FACETS = "rasterisers draw round shapes as facets, within the true outline"

SCENARIOS = (
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
                name="tight", unit="pixels", tolerance=1.0, meaning="largest error of a side, nothing in the way",
                looser_because=_FACETS,
            ),
            Metric(
                name="hidden", unit="pixels", tolerance=1.0, meaning="the same, with a plate before some",
                looser_because=_FACETS,
            ),
            Metric(
                name="loose", unit="pixels", tolerance=0.13,
                meaning="largest error of a side of the whole thing's box; the truth is known to 1/8 of a pixel",
            ),
        ),
    ),
)  # fmt: skip
