"""Installed packages bring sensors: found by their specification, and named where they are broken."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.forked import run_forked

_PACKAGE = """
from dataclasses import dataclass

from orbit_core.scene import CameraSpec, ImuSpec, SensorSpec
from orbit_core.sensors import TimedSensor
from orbit_core.sensors.proprioception import Mount


@dataclass(frozen=True, kw_only=True)
class AltimeterSpec(SensorSpec):
    entity: str
    frame: str


class Altimeter(TimedSensor):
    noisy = ("height",)

    def __init__(self, spec, context):
        super().__init__(spec, context)
        self._mount = Mount(context.engine, context.layout, spec.entity, spec.frame, spec.name)

    @property
    def height(self):
        return self._read("height")

    def _measure(self, env_ids):
        return {"height": self._mount.pose(env_ids)[:, 2]}


@dataclass(frozen=True, kw_only=True)
class FineImuSpec(ImuSpec):
    pass


not_a_sensor = 3
"""
_PROGRAM = """
import theirs
from orbit_assets.objects import box
from orbit_core.scene import Pose, Scene
from orbit_core.world import simulate

crate = box("crate", size=(0.1, 0.1, 0.1), pose=Pose((0.0, 0.0, 0.7)))
spec = theirs.{spec}(name="it", entity="crate", frame="crate")
world = simulate(Scene(objects=(crate,), sensors=(spec,)), 2, "mujoco")
sensor = world.sensors["it"]
print(type(sensor).__name__, getattr(sensor, "height", None))
"""


def run(folder: Path, points: str, spec: str) -> subprocess.CompletedProcess[str]:
    """A program with a sensor of that specification, where a distribution 'theirs' is installed beside ORBIT."""
    (folder / "theirs.py").write_text(_PACKAGE)
    about = folder / "theirs-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[orbit.sensors]\n{points}\n")
    return run_forked(_PROGRAM.format(spec=spec), path=[folder])


def test_an_installed_package_brings_a_sensor(tmp_path: Path) -> None:
    done = run(tmp_path, "AltimeterSpec = theirs:Altimeter", "AltimeterSpec")
    assert done.stdout.split(maxsplit=1) == ["Altimeter", "tensor([0.7000, 0.7000])\n"], done.stderr


def test_a_derived_specification_has_the_sensor_of_the_one_that_it_is_derived_from(tmp_path: Path) -> None:
    done = run(tmp_path, "", "FineImuSpec")
    assert done.stdout.split() == ["ImuSensor", "None"], done.stderr


def test_a_broken_package_does_not_stop_who_asks_for_another_sensor(tmp_path: Path) -> None:
    done = run(tmp_path, "AltimeterSpec = theirs:nothing", "FineImuSpec")
    assert done.stdout.split() == ["ImuSensor", "None"], done.stderr


@pytest.mark.parametrize(
    ("point", "complaint"),
    [
        ("AltimeterSpec = theirs:nothing", "(theirs:nothing, of distribution theirs) cannot be loaded (AttributeError"),
        ("AltimeterSpec = gone:Altimeter", "cannot be loaded (ModuleNotFoundError: No module named 'gone')"),
        ("AltimeterSpec = theirs:not_a_sensor", "names 3, which is no subclass of orbit_core.sensors.TimedSensor"),
        ("AltimetreSpec = theirs:Altimeter", "unknown sensor specification 'AltimeterSpec': did you mean 'Altimetre"),
    ],
)  # fmt: skip
def test_a_sensor_that_cannot_be_had_is_told_with_the_reason(tmp_path: Path, point: str, complaint: str) -> None:
    done = run(tmp_path, point, "AltimeterSpec")
    assert done.returncode == 1
    assert complaint in done.stderr.splitlines()[-1]


def test_a_package_cannot_take_the_place_of_a_sensor_of_the_cores_own(tmp_path: Path) -> None:
    done = run(tmp_path, "ImuSpec = theirs:Altimeter", "FineImuSpec")
    assert done.stdout.split() == ["ImuSensor", "None"], done.stderr
    assert "registered twice" in done.stderr
