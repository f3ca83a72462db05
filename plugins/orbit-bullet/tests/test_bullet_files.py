"""Bullet's reading of what is written for it: nothing is cut or rounded, and what it refuses is told by its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orbit_assets import sources
from orbit_assets.catalogue import robot
from orbit_assets.files import load_articulation
from orbit_bullet import stage, urdf
from orbit_bullet.actuation import Actuation
from orbit_bullet.buffers import private_buffers, shapes_of
from orbit_bullet.library import Client
from orbit_bullet.readback import read_model
from orbit_bullet.stage import Stage, write_scene
from orbit_core.interfaces import AssetError, BuildError, BuiltModel, ConfigurationError, SceneLayout
from orbit_core.plugin_kit.meshes import height_field_mesh
from orbit_core.scene import (
    Articulation,
    Entity,
    HeightField,
    ImplicitPd,
    Joint,
    JointType,
    Link,
    Mesh,
    MeshCollision,
    RobotSpec,
    Scene,
    Shape,
)
from orbit_core.world import simulate


def robot_layout(spec: RobotSpec) -> SceneLayout:
    return SceneLayout.of(Scene(robots=(spec,), terrain=()))


def stage_of(layout: SceneLayout, folder: Path, client: Client) -> Stage:
    return Stage(client, layout, write_scene(layout, folder), 1)


def read_back(stage: Stage) -> BuiltModel:
    return read_model(stage, Actuation(stage, private_buffers(shapes_of(stage.layout, 1))))


@pytest.mark.parametrize(
    "file",
    [
        "go2_description/urdf/go2.urdf",
        "talos_data/robots/talos_reduced.urdf",
        "solo_description/robots/solo12.urdf",
        "kinova_description/robots/kinova.urdf",
        "tiago_description/robots/tiago.urdf",
        "baxter_description/urdf/baxter.urdf",
    ],
)
def test_robots_stand_as_described(file: str) -> None:
    """Poses, masses, centres of mass, inertias and limits: a world of another is refused when it is made."""
    articulation = load_articulation(sources.model_folder("example-robot-data") / "robots" / file)
    spec = RobotSpec(name="robot", articulation=articulation, fixed_base=True)
    simulate(Scene(robots=(spec,), terrain=()), num_envs=1, backend="bullet").close()


@pytest.mark.parametrize(
    ("was", "becomes", "message"),
    [
        ('mass value="1.0"', 'mass value="1.1"', "mass of link 'rod' of 'robot' is 1.1 kg instead of 1"),
        ('izz="0.02"', 'izz="0.021"', "inertia of link 'rod'"),
        ('upper="2.0"', 'upper="2.5"', "upper limit of joint 'swing' of 'robot' is 2.5 instead of 2"),
        ('origin xyz="0.3 0.0 0.0"', 'origin xyz="0.31 0.0 0.0"', "centre of mass of link 'rod'"),
        ('axis xyz="0.0 0.0 1.0"', 'axis xyz="0.0 1.0 0.0"', "link 'rod' of 'robot' in environment 0 stands"),
    ],
)
def test_a_number_that_bullet_reads_otherwise_is_found(
    was: str, becomes: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that says something else than the description, as one that is cut does."""
    written = urdf.write_entity

    def write(entity: Entity, path: Path, meshes: urdf.MeshFiles) -> None:
        written(entity, path, meshes)
        text = path.read_text()
        assert was in text
        path.write_text(text.replace(was, becomes))

    monkeypatch.setattr(stage, "write_entity", write)
    rod = Link("rod", 1.0, (0.3, 0.0, 0.0), np.diag([0.01, 0.02, 0.02]))
    swing = Joint("swing", JointType.REVOLUTE, "base", "rod", lower_limit=-1.0, upper_limit=2.0, axis=(0.0, 0.0, 1.0))
    spec = RobotSpec(name="robot", articulation=Articulation("robot", (Link("base"), rod), (swing,)), fixed_base=True)
    with pytest.raises(BuildError, match=message):
        simulate(Scene(robots=(spec,), terrain=()), num_envs=1, backend="bullet")


def test_armatures_are_read_back_from_the_wheels(tmp_path: Path) -> None:
    """Beside drives with and without effort limits, and beside damping."""
    drives = (
        ImplicitPd(joints=("panda_joint[1-4]",), stiffness=400.0, damping=40.0, armature=0.3),
        ImplicitPd(joints=("panda_joint[5-7]",), stiffness=1e5, damping=10.0, armature=0.01, effort_limit=None),
    )
    layout = robot_layout(robot("franka_panda", actuators=drives))
    client = Client()
    armatures = read_back(stage_of(layout, tmp_path, client)).armatures
    assert armatures is not None
    np.testing.assert_allclose(armatures, layout.joint_parameters.armature, rtol=1e-6, atol=1e-9)
    assert armatures[:7] == pytest.approx([0.3] * 4 + [0.01] * 3)
    client.close()


def test_the_length_of_the_folders_name_changes_nothing(tmp_path: Path) -> None:
    """The paths of meshes move all that follows them along Bullet's buffer: 40 of its positions."""
    layout = robot_layout(robot("ur10_robotiq_2f85"))
    client = Client()
    found = []
    for length in range(1, 41):
        folder = tmp_path / ("f" * length)
        folder.mkdir()
        model = read_back(stage_of(layout, folder, client))
        found.append((model.lower_limits, model.upper_limits, model.masses, model.centers_of_mass, model.inertias))
        client.resetSimulation()
    client.close()
    for other in found[1:]:
        for first, second in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(first, second)


def test_a_long_name_and_odd_characters_are_read(tmp_path: Path) -> None:
    """Names of entities and of folders, with what XML escapes."""
    spec = robot("ur10_robotiq_2f85", name="<&>" * 4000)
    folder = tmp_path / "a & b" / ("é" * 100)
    folder.mkdir(parents=True)
    client = Client()
    masses = read_back(stage_of(robot_layout(spec), folder, client)).masses
    np.testing.assert_allclose(masses[1:], [link.mass for link in spec.articulation.links[1:]])
    client.close()


def test_a_folder_of_too_long_a_name_is_refused(tmp_path: Path) -> None:
    layout = robot_layout(robot("cartpole"))
    with pytest.raises(ConfigurationError, match="TMPDIR"):
        write_scene(layout, tmp_path / ("f" * 1000))


def test_a_model_that_bullet_refuses_is_told_by_its_name(tmp_path: Path) -> None:
    layout = robot_layout(
        RobotSpec(name="broken", articulation=Articulation("broken", (Link("base"),)), fixed_base=True)
    )
    files = write_scene(layout, tmp_path)
    files.entities[0].write_text("<robot")
    client = Client()
    with pytest.raises(AssetError, match="'broken'"):
        Stage(client, layout, files, 1)
    client.close()


def test_flat_ground_is_written_as_few_triangles_as_it_needs(tmp_path: Path) -> None:
    ramp = np.zeros((11, 11))
    ramp[:, 5:] = np.linspace(0.0, 0.2, 6)
    rough = np.random.default_rng(0).uniform(0.0, 0.1, (11, 11))
    fields = [HeightField(heights, (1.0, 1.0)) for heights in (np.zeros((11, 11)), ramp, rough)]
    mesh = Mesh(*height_field_mesh(fields[1]), collision=MeshCollision.TRIANGLES)
    layout = SceneLayout.of(Scene(terrain=(*map(Shape, fields), Shape(mesh))))
    paths = write_scene(layout, tmp_path).terrain
    counts = [path and path.read_text().count("f ") for path in paths]
    assert counts == [2, 4, None, 4]
