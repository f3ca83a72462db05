"""Bullet's reading of what is written for it: nothing is cut or rounded, and what it refuses is told by its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from orbit_bullet import BulletBackend, BulletConfig
from orbit_bullet.engine import BulletEngine
from orbit_bullet.library import Client
from orbit_bullet.pool import LocalPool
from orbit_bullet.stage import Stage, write_scene
from orbit_core.assets import sources
from orbit_core.assets.catalogue import robot
from orbit_core.assets.files import load_articulation
from orbit_core.dynamics.kinematics import KinematicTree
from orbit_core.interfaces import AssetError, ConfigurationError, SceneLayout
from orbit_core.scene import Articulation, Link, RobotSpec, Scene


def robot_layout(spec: RobotSpec) -> SceneLayout:
    return SceneLayout.of(Scene(robots=(spec,), terrain=()))


def example_layout(file: str) -> SceneLayout:
    """A robot of the package example-robot-data."""
    articulation = load_articulation(sources.model_folder("example-robot-data") / "robots" / file)
    return robot_layout(RobotSpec(name="robot", articulation=articulation, fixed_base=True))


def stage_of(layout: SceneLayout, folder: Path, client: Client) -> Stage:
    return Stage(client, layout, write_scene(layout, folder), 1, BulletConfig())


def read_limits(stage: Stage) -> npt.NDArray[np.float64]:
    """Lower and upper limits (J, 2) as Bullet has them."""
    found = [stage.client.getJointInfo(stage.bodies[0][0], joint)[8:10] for joint in stage.joints[0]]
    return np.array(found).reshape(-1, 2)


def read_masses(stage: Stage) -> npt.NDArray[np.float64]:
    """Masses (L,) as Bullet has them; a base that is held has none."""
    return np.array([stage.client.getDynamicsInfo(stage.bodies[0][0], link)[0] for link in stage.links[0]])


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
    """Link poses within 1e-6 m of forward kinematics; masses and limits to single precision."""
    layout = example_layout(file)
    engine = BulletBackend().create_engine(layout, 1, torch.device("cpu"), BulletConfig(workers=1))
    assert isinstance(engine, BulletEngine)
    assert isinstance(engine.native, LocalPool)
    articulation = layout.entities[0].spec.articulation
    expected = KinematicTree(articulation).forward(engine.link_poses[:, 0], engine.joint_positions)
    torch.testing.assert_close(engine.link_poses, expected, rtol=0, atol=1e-6)
    stage = engine.native.shard.simulations[0].stage
    np.testing.assert_allclose(read_masses(stage)[1:], [link.mass for link in articulation.links[1:]], rtol=1e-6)
    limits = np.array([(joint.lower_limit, joint.upper_limit) for joint in articulation.movable_joints])
    limited = np.isfinite(limits).all(axis=1)
    np.testing.assert_allclose(read_limits(stage)[limited], limits[limited], rtol=1e-6)
    engine.close()


def test_the_length_of_the_folders_name_changes_nothing(tmp_path: Path) -> None:
    """The paths of meshes move all that follows them along Bullet's buffer: 40 of its positions."""
    layout = robot_layout(robot("ur10_robotiq_2f85"))
    client = Client()
    found = []
    for length in range(1, 41):
        folder = tmp_path / ("f" * length)
        folder.mkdir()
        stage = stage_of(layout, folder, client)
        found.append((read_limits(stage), read_masses(stage), stage.offsets))
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
    stage = stage_of(robot_layout(spec), folder, client)
    assert np.count_nonzero(read_masses(stage)) == len(spec.articulation.links) - 1
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
        Stage(client, layout, files, 1, BulletConfig())
    client.close()
