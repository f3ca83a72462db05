"""A scene's data is what its dataclasses say, and its numbers can be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from orbit_assets.objects import box, capsule, cylinder, sphere, table
from orbit_core.interfaces import ArgumentError, AssetError
from orbit_core.preparation.scene_data import check_data
from orbit_core.scene import (
    AmbientLight,
    Box,
    CameraSpec,
    DirectionalLight,
    ImuSpec,
    MarkerSpec,
    Mesh,
    PhysicsMaterial,
    Pose,
    RayCasterSpec,
    Scene,
    Shape,
    Sky,
)

CUBE = box("cube", (0.1, 0.1, 0.1))
NAN, INF = float("nan"), float("inf")


def scene(**changes: Any) -> Scene:
    return replace(Scene(objects=(CUBE,)), **changes)


def placed(*pose: Any) -> Scene:
    return scene(objects=(replace(CUBE, pose=Pose(*pose)),))


def lit(*lights: Any) -> Scene:
    return scene(lights=lights)


def made_of(**coefficients: Any) -> Scene:
    return scene(objects=(box("cube", (0.1, 0.1, 0.1), material=PhysicsMaterial(**coefficients)),))


BAD = [
    (scene(gravity=(0.0, 0.0, NAN)), r"scene\.gravity\[2\] is nan: give a number"),
    (scene(gravity=(0.0, -9.81)), r"scene\.gravity is .*: give 3 of them"),
    (scene(gravity="down"), r"scene\.gravity is 'down': give a tuple"),
    (scene(gravity=(0.0, 0.0, -1e30)), r"scene\.gravity is -1e\+30: give -10000 to 10000 m/s\^2"),
    (scene(physics_dt=-0.1), r"scene\.physics_dt is -0\.1: give 1e-07 to 1 s"),
    (scene(physics_dt=INF), r"scene\.physics_dt is inf"),
    (lit(DirectionalLight((0.0, 0.0, 0.0))), r"scene\.lights\[0\]\.direction is .*: give the direction of travel"),
    (lit(DirectionalLight((0.0, 0.0, NAN))), r"scene\.lights\[0\]\.direction\[2\] is nan: give a number"),
    (lit(DirectionalLight(color=(1.0, -0.1, 0.0))), r"scene\.lights\[0\]\.color is -0\.1: give 0 to 1000"),
    (lit(DirectionalLight(intensity=-1.0)), r"scene\.lights\[0\]\.intensity is -1\.0: give 0 to 1000"),
    (lit(AmbientLight((0.1, INF, 0.1))), r"scene\.lights\[0\]\.color is inf: give 0 to 1000"),
    (lit(AmbientLight(), "sun"), r"scene\.lights\[1\] is 'sun': give AmbientLight or DirectionalLight"),
    (lit(*4 * [DirectionalLight()]), r"scene\.lights has 4 directional lights: give 3 at most"),
    (scene(sky=Sky(above=(0.0, 0.0, 1.1))), r"scene\.sky\.above is 1\.1: give 0 to 1"),
    (scene(objects=CUBE), r"scene\.objects is .*give a tuple"),
    (scene(objects=("cube",)), r"scene\.objects\[0\] is 'cube': give a ObjectSpec"),
    (placed((0.0, NAN, 0.0)), r"scene\.objects\['cube'\]\.pose\.position\[1\] is nan"),
    (placed((0.0, 1e30, 0.0)), r"scene\.objects\['cube'\]\.pose\.position is 1e\+30: give -1e\+06 to 1e\+06 m"),
    (placed((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)), r"pose\.orientation is .*quaternion \(w, x, y, z\) of length 1"),
    (scene(objects=(replace(CUBE, fixed_base=3),)), r"fixed_base is 3: give true or false"),
    (scene(objects=(replace(CUBE, name=3),)), r"\.name is 3: give a str"),
    (scene(objects=(replace(CUBE, home={"a": "b"}),)), r"\.home\['a'\] is 'b': give a number"),
    (scene(objects=(box("cube", (0.1, 0.1, 0.1), mass=10**30),)), r"links\['cube'\]\.mass is 1.*: give 0 to 1e\+09 kg"),
    (made_of(static_friction=-1.0), r"material\.static_friction is -1\.0: give 0 to 1e\+06"),
    (made_of(restitution=1.5), r"material\.restitution is 1\.5: give 0 to 1"),
    (scene(sensors=("eye",)), r"scene\.sensors\[0\] is 'eye': give a SensorSpec"),
    (scene(sensors=(CameraSpec(name="eye", width=0),)), r"sensors\['eye'\]\.width is 0: give 1 to 32768 pixels"),
    (scene(sensors=(CameraSpec(name="eye", vertical_fov=4.0),)), r"vertical_fov is 4\.0: give 0\.001 to"),
    (scene(sensors=(CameraSpec(name="eye", near=2.0, far=1.0),)), r"give 0 < near < far"),
    (scene(sensors=(CameraSpec(name="eye", channels=("rgb",)),)), r"channels\[0\] is 'rgb': give a Channel"),
    (scene(sensors=(ImuSpec(name="imu", entity="cube", frame="cube", rate="fast"),)), r"rate is 'fast': give a number"),
    (scene(sensors=(RayCasterSpec(name="r", entity="cube", frame="cube", directions=(1, 2)),)), r"directions\[0\]"),
    (scene(markers=(MarkerSpec("goal", size=True),)), r"markers\['goal'\]\.size is True: give a number"),
    (scene(terrain=(Shape(Mesh(np.full((3, 3), NAN), np.zeros((1, 3), int))),)), r"vertices holds NaN"),
    (scene(terrain=(Shape(Box((0.1, -0.1, 0.1))),)), r"geometry\.half_extents is -0\.1: give 1e-09 to 1e\+06 m"),
    (scene(terrain=(Shape("ground"),)), r"terrain\[0\]\.geometry is 'ground': give Box or Sphere"),
]  # fmt: skip


@pytest.mark.parametrize(("bad", "message"), BAD)
def test_the_field_that_cannot_be_is_named(bad: Scene, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        check_data(bad, "scene")


def test_lists_arrays_and_whole_numbers_will_do() -> None:
    check_data(scene(gravity=[0, 0, -9], physics_dt=np.float32(0.01), objects=[CUBE]), "scene")
    check_data(placed(np.array([0.0, 1.0, 2.0])), "scene")


@pytest.mark.parametrize("length", [0, -0.1, NAN, INF, "long", None, True, 1j])
def test_solids_have_lengths_and_masses_above_zero(length: Any) -> None:
    for make in (
        lambda: box("solid", (0.1, length, 0.1)),
        lambda: box("solid", length),
        lambda: sphere("solid", length),
        lambda: sphere("solid", 0.1, mass=length if length is not None else 0.0),
        lambda: cylinder("solid", 0.1, length),
        lambda: capsule("solid", 0.1, length),
        lambda: table("solid", (0.1, 0.1, length)),
    ):
        with pytest.raises((AssetError, ArgumentError), match="'solid'"):
            make()


def test_lights_of_one_kind_add_up_and_a_direction_has_any_length() -> None:
    dim, bright = AmbientLight((0.1, 0.0, 0.2)), AmbientLight((0.2, 0.3, 0.0))
    lamp = DirectionalLight((0.0, -3.0, -4.0), (1.0, 0.5, 0.0), 0.5)
    made = lit(dim, lamp, bright)
    assert made.ambient == pytest.approx((0.3, 0.3, 0.2))
    assert made.directional_lights == (lamp,)
    assert lamp.unit_direction == pytest.approx((0.0, -0.6, -0.8))
    assert lamp.radiance == (0.5, 0.25, 0.0)
    assert lit().ambient == (0.0, 0.0, 0.0)
