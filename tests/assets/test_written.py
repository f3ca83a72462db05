"""Written files read back: flat plates in any frame, and what differs is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from orbit_assets import load_articulation
from orbit_assets.files import check_written
from orbit_assets.mjcf import write_mjcf
from orbit_assets.options import ReadOptions
from orbit_assets.urdf import write_urdf
from orbit_assets.usd import write_usd
from orbit_core.cli import main
from orbit_core.interfaces.errors import AssetError
from orbit_core.scene import Articulation, Box, Joint, JointType, Link, Pose, Shape
from orbit_core.scene.articulation import DOUBLE, SINGLE, lacking_moment, raised_moments, solid_moments

Write = Callable[[Articulation, Path], tuple[str, ...]]
WRITERS: dict[str, Write] = {"xml": write_mjcf, "urdf": write_urdf, "usda": write_usd}
OPTIONS = ReadOptions()


def plate(number: int, beyond: float = 0.0) -> np.ndarray:
    """The inertia of a flat plate of 1e-9 to 1 kg m^2 in a frame of its own, its moments ``beyond`` what a body has."""
    generator = np.random.default_rng(number)
    first, second = generator.uniform(0.05, 1.0, 2) * 10.0 ** generator.uniform(-9, 0)
    axes = Pose.from_euler(*generator.uniform(-3, 3, 3)).rotation_matrix()
    tensor = axes @ np.diag((first, second, (first + second) * (1.0 + beyond))) @ axes.T
    return (tensor + tensor.T) / 2.0


def plates(beyond: float = 0.0) -> Articulation:
    box = (Shape(Box((0.1, 0.1, 0.1))),)
    links = [Link(f"plate{number}", 1.0, (0.0, 0.0, 0.1), plate(number, beyond), box) for number in range(20)]
    joints = [
        Joint(f"j{number}", JointType.REVOLUTE, "base", link.name, lower_limit=-1.0, upper_limit=1.0)
        for number, link in enumerate(links)
    ]
    return Articulation("plates", (Link("base", 1.0, inertia=np.eye(3)), *links), tuple(joints))


@pytest.mark.parametrize("margin", [DOUBLE, SINGLE])
def test_moments_of_flat_plates_are_rounded_upwards_about_the_axes_that_they_have(margin: float) -> None:
    for number in range(50):
        tensor = plate(number)
        moments, axes = solid_moments(tensor, margin)
        rotation = axes.rotation_matrix()
        np.testing.assert_allclose(
            rotation @ np.diag(moments) @ rotation.T, tensor, atol=(margin + 1e-14) * tensor.trace()
        )
        assert lacking_moment(moments) <= -0.9 * margin * moments.max()


def test_a_diagonal_tensor_needs_no_rotation() -> None:
    moments, axes = solid_moments(np.diag((0.3, 0.1, 0.25)))
    assert moments.tolist() == [0.3, 0.1, 0.25]
    assert axes == Pose()


def test_raised_moments_are_never_negative() -> None:
    assert raised_moments((-1.0, 0.0, 2.0)).tolist() == [1.0, 1.0, 2.0]


@pytest.mark.parametrize("suffix", ["xml", "urdf"])
def test_mujoco_takes_flat_plates_as_they_are_written(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"plates.{suffix}"
    assert not any("moments" in line for line in WRITERS[suffix](plates(), path))
    model = mujoco.MjModel.from_xml_path(str(path))
    for number, link in enumerate(plates().links[1:]):
        moments = np.sort(model.body(f"plate{number}").inertia)
        np.testing.assert_allclose(moments, np.linalg.eigvalsh(link.inertia), rtol=1e-9)


def test_single_precision_keeps_moments_of_flat_plates_sound(tmp_path: Path) -> None:
    from pxr import Usd

    write_usd(plates(), tmp_path / "plates.usda")
    stage = Usd.Stage.Open(str(tmp_path / "plates.usda"))
    found = [prim.GetAttribute("physics:diagonalInertia") for prim in stage.Traverse()]
    moments = [np.sort(np.asarray(each.Get(), dtype=np.float64)) for each in found if each and each.HasAuthoredValue()]
    assert len(moments) == 21
    assert all(small + middle >= large for small, middle, large in moments)


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("beyond", [0.0, 5e-4])
def test_what_is_written_reads_back(tmp_path: Path, suffix: str, beyond: float) -> None:
    path = tmp_path / f"plates.{suffix}"
    lost = WRITERS[suffix](plates(beyond), path)
    assert any("principal moments that no solid has are written larger" in line for line in lost) == bool(beyond)
    assert check_written(plates(beyond), path, OPTIONS) == ()


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ('<mass value="1.0" />', '<mass value="1.5" />', "its mass is 31.5 kg instead of 21"),
        ('name="j3"', 'name="k3"', "joints j3, k3 are not in both"),
        ('xyz="0.0 0.0 0.1"', 'xyz="0.0 0.1 0.1"', "the centre of mass of link 'plate0' is 0.1 m off"),
        ('izz="1.0"', 'izz="1.5"', "link 'base' has principal moments"),
        ("</robot>", "", "was written but cannot be read"),
    ],
)
def test_a_file_that_holds_something_else_is_refused(tmp_path: Path, before: str, after: str, fault: str) -> None:
    path = tmp_path / "plates.urdf"
    write_urdf(plates(), path)
    path.write_text(path.read_text().replace(before, after))
    with pytest.raises(AssetError, match=fault):
        check_written(plates(), path, OPTIONS)


def test_a_conversion_whose_file_does_not_read_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def write(articulation: Articulation, path: Path) -> tuple[str, ...]:
        path.write_text(f"<mujoco model='{articulation.name}'><worldbody><body/></worldbody></mujoco>")
        return ()

    write_urdf(plates(), tmp_path / "plates.urdf")
    monkeypatch.setattr("orbit_assets.mjcf.write_mjcf", write)
    assert main(["convert", str(tmp_path / "plates.urdf"), str(tmp_path / "plates.xml")]) == 2
    assert "plates.xml' was written but" in " ".join(capsys.readouterr().err.split())


def test_without_the_parser_of_mjcf_a_conversion_says_that_it_is_not_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "plates.xml"
    write_mjcf(plates(), path)
    monkeypatch.setattr("orbit_assets.files.find_spec", lambda _: None)
    (line,) = check_written(plates(), path, OPTIONS)
    assert '[mjcf]"' in line


def test_a_link_whose_moments_only_its_body_makes_sound_is_written_and_noted(tmp_path: Path) -> None:
    """As sensors in published robots, whose own entries are rounded beyond physics."""
    rod = Link("sensor", 0.01, inertia=np.diag((0.0, 0.0, 3e-6)))
    joint = Joint("mount", JointType.FIXED, "base", "sensor")
    articulation = Articulation("robot", (Link("base", 1.0, inertia=np.eye(3)), rod), (joint,))
    for suffix, write in WRITERS.items():
        path = tmp_path / f"robot.{suffix}"
        assert any("written larger, of links: 'sensor'" in line for line in write(articulation, path)), suffix
        check_written(articulation, path, OPTIONS)
        assert load_articulation(path).mass == pytest.approx(1.01)
