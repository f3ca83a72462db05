"""``orbit scene``: scenes made, checked and listed from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from orbit_assets.scene_files import load_scene
from orbit_assets.usd.scene_writer import write_usd_scene
from orbit_core.interfaces.errors import AssetError, ConfigurationError, PremiseError, UnknownNameError
from orbit_core.scene import Pose, Scene
from orbit_scenes.cli.scene import main
from orbit_scenes.things import thing


def test_make_writes_a_scene_that_reads_and_check_accepts_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "study.usda"
    main(["make", "study", "--seed", "3", "--things", "4", "--output", str(path)])
    assert "4 of them free" in capsys.readouterr().out
    assert sum(each.is_free_body for each in load_scene(path).objects) == 4
    main(["check", str(path), "--backend", "mujoco", "--seconds", "0.2"])
    assert "objects stay" in capsys.readouterr().out
    with pytest.raises(ConfigurationError, match="--overwrite"):
        main(["make", "study", "--output", str(path)])


def test_check_names_what_overlaps_in_a_file(tmp_path: Path):
    mug = thing("mug")
    twins = tuple(mug.build(name, Pose((0.0, 0.0, 0.05))) for name in ("first", "second"))
    write_usd_scene(Scene(objects=twins), tmp_path / "twins.usda")
    with pytest.raises(PremiseError, match="'first' and 'second' overlap"):
        main(["check", str(tmp_path / "twins.usda")])


def test_a_scanned_mesh_becomes_a_scene_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    room = trimesh.creation.box(extents=(4.0, 3.0, 2.4)).subdivide()
    path = tmp_path / "room.ply"
    trimesh.Trimesh(room.vertices, room.faces[:, ::-1], process=False).export(path)
    with pytest.raises(AssetError, match="does not state its unit"):
        main(["scan", str(path)])
    main(["scan", str(path), "--unit", "1.0", "--up", "z", "--voxel", "0.2"])
    assert "4.00 x 3.00 x 2.40 m, 48 triangles" in capsys.readouterr().out
    (scan,) = load_scene(tmp_path / "room.usdc").objects
    assert scan.fixed_base
    assert len(scan.articulation.root.collisions) > 4


def test_lists_name_things_and_furniture(capsys: pytest.CaptureFixture[str]):
    main(["things"])
    main(["furniture"])
    listed = capsys.readouterr().out
    assert "cracker_box" in listed
    assert "drawer_0_joint" in listed


def test_wrong_words_are_named():
    with pytest.raises(UnknownNameError, match="did you mean 'make'"):
        main(["mak"])
    with pytest.raises(UnknownNameError, match="did you mean 'kitchen'"):
        main(["make", "kitchn"])
    with pytest.raises(ConfigurationError, match="name a --backend"):
        main(["make", "bin"])
