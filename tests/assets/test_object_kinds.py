"""Objects by name: what each kind makes, how its parameters are set, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import trimesh

from orbit_assets.object_kinds import BoxConfig, SphereConfig
from orbit_core.envs.configuration import configure
from orbit_core.interfaces import ConfigurationError, OrbitError, UnknownNameError
from orbit_core.objects import ObjectConfig, object_config, object_kinds
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Geometry, Mesh, ObjectSpec, Pose
from orbit_tasks.lift import Lift


@pytest.fixture
def _own_kinds() -> Iterator[None]:
    """What a test registers is forgotten after it."""
    object_kinds.cache_clear()
    yield
    object_kinds.cache_clear()


def lowest(geometry: Geometry) -> float:
    """The least z of a shape in its own frame."""
    match type(geometry).__name__:
        case "Box":
            return -geometry.half_extents[2]  # pyright: ignore[reportAttributeAccessIssue]
        case "Sphere":
            return -geometry.radius  # pyright: ignore[reportAttributeAccessIssue]
        case "Cylinder":
            return -geometry.half_length  # pyright: ignore[reportAttributeAccessIssue]
        case "Capsule":
            return -geometry.half_length - geometry.radius  # pyright: ignore[reportAttributeAccessIssue]
    assert isinstance(geometry, Mesh)
    return float(np.asarray(geometry.vertices)[:, 2].min())


@pytest.mark.parametrize("kind", ["box", "sphere", "cylinder", "capsule", "mesh", "table"])
def test_a_kind_stands_at_its_rest_height(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "wedge.stl"
    wedge = trimesh.creation.cone(radius=0.1, height=0.3)
    wedge.apply_translation((0.0, 0.0, 0.07))
    wedge.export(path)
    config = object_config(kind, **({"file": path, "scale": 0.5} if kind == "mesh" else {}))
    made = config.build("thing", Pose((0.0, 0.0, config.rest_height)))
    validate_entity(made)
    shapes = made.articulation.root.collisions
    assert min(lowest(shape.geometry) + shape.pose.position[2] for shape in shapes) + config.rest_height == (
        pytest.approx(0.0, abs=1e-6)
    )


def test_every_kind_of_the_program_describes_itself() -> None:
    assert {"box", "sphere", "cylinder", "capsule", "mesh", "table", "cabinet", "dishwasher"} <= {*object_kinds().names}
    assert all(text.endswith(".") for text in object_kinds().descriptions.values())


def test_a_mass_wins_over_the_density() -> None:
    light, heavy = object_config("box", density=100.0), object_config("box", density=100.0, mass=2.0)
    assert light.build("a").articulation.mass == pytest.approx(100.0 * 0.05**3)
    assert heavy.build("a").articulation.mass == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("kind", "parameters", "told"),
    [
        ("bocks", {}, "unknown object 'bocks': did you mean 'box'"),
        ("box", {"sise": 1}, "unknown parameter 'sise' in object 'box': did you mean 'size'"),
        ("box", {"size": "big"}, "'size' of object 'box' is 'big'"),
        ("box", {"size": (0.1, 0.0, 0.1)}, "a length of 'thing' is 0.0"),
        ("sphere", {"mass": -1.0}, "a mass of 'thing' is -1.0"),
        ("mesh", {}, "object 'thing' is of kind mesh and has no file"),
    ],
)
def test_a_wrong_kind_or_parameter_is_named(kind: str, parameters: dict[str, Any], told: str) -> None:
    with pytest.raises(OrbitError, match=told):
        object_config(kind, **parameters).build("thing")


def test_a_task_takes_a_kind_by_its_name_and_parameters_by_their_paths() -> None:
    task = configure(Lift, {"cube": "sphere", "cube.radius": 0.03, "cube.material.static_friction": 0.5})
    assert isinstance(task.cube, SphereConfig)
    assert (task.cube.radius, task.cube.material.static_friction) == (0.03, 0.5)
    (made,) = [thing for thing in task.scene().objects if thing.name == "cube"]
    assert made.pose.position[2] == pytest.approx(0.03)
    assert configure(Lift, {"cube": BoxConfig(mass=0.4)}).cube == BoxConfig(mass=0.4)
    with pytest.raises(UnknownNameError, match="'spere' in field 'cube' of task Lift: did you mean 'sphere'"):
        configure(Lift, {"cube": "spere"})


@dataclass(frozen=True, kw_only=True)
class Coin(ObjectConfig):
    """A coin that lies flat."""

    name: ClassVar[str] = "coin"
    radius: float = 0.012

    def build(self, name: str, pose: Pose | None = None) -> ObjectSpec:
        return object_config("cylinder", radius=self.radius, length=0.002).build(name, pose)

    @property
    def rest_height(self) -> float:
        return 0.001


@dataclass(frozen=True, kw_only=True)
class Edged(Coin):
    """A coin whose edge must be given."""

    name: ClassVar[str] = "edged"
    edge: float


@pytest.mark.usefixtures("_own_kinds")
def test_a_program_brings_kinds() -> None:
    object_kinds().add_class(Coin)
    assert configure(Lift, {"cube": "coin"}).cube == Coin()
    with pytest.raises(ConfigurationError, match="object 'coin' is registered twice"):
        object_kinds().add_class(Coin)
    with pytest.raises(ConfigurationError, match="is no dataclass of class ObjectConfig"):
        object_kinds().add_class(dict)  # pyright: ignore[reportArgumentType]


@pytest.mark.usefixtures("_own_kinds")
def test_a_kind_without_defaults_is_named_with_its_module() -> None:
    object_kinds().add_class(Edged)
    with pytest.raises(ConfigurationError, match=rf"object 'edged' \({__name__}\) cannot be made by name.*edge"):
        object_config("edged")


@pytest.mark.usefixtures("_own_kinds")
def test_an_installed_package_brings_kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = f"from {__name__} import Coin\n\nclass Medal(Coin):\n    name = 'medal'\n"
    (tmp_path / "their_objects.py").write_text(code)
    about = tmp_path / "their_objects-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-objects\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[orbit.objects]\nany = their_objects:Medal\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert object_config("medal", radius=0.04).build("prize").articulation.mass > 0
    assert "their-objects" in object_kinds().origin("medal")


@pytest.mark.parametrize("values", [{"cube": "table"}, {"cube": "cabinet"}, {"cube.fixed_base": True}])
def test_lift_refuses_what_does_not_move(values: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=r"field 'cube' of task Lift is a '\w+' whose base is fixed"):
        configure(Lift, values).scene()


def test_an_unknown_kind_is_answered_with_the_kinds() -> None:
    with pytest.raises(UnknownNameError, match=r"did you mean 'sphere'\? known: box, cabinet, capsule"):
        configure(Lift, {"cube": "spere"})
