"""Peg-In-Hole: sections that fill their tiles, a tight hole, what counts as inserted, settings."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_assets import pegs
from orbit_core.dynamics import transforms
from orbit_core.envs import make
from orbit_core.interfaces import AssetError, ConfigurationError, UnknownNameError
from orbit_core.scene import Box, Mesh, Shape
from orbit_tasks import peg_in_hole as task_file
from orbit_tasks.peg_in_hole import PegInHole
from tests.tasks.experts import episode


def area(shape: Shape) -> float:
    """m^2 seen from above."""
    if isinstance(shape.geometry, Box):
        return 4.0 * shape.geometry.half_extents[0] * shape.geometry.half_extents[1]
    assert isinstance(shape.geometry, Mesh)
    corners = np.asarray(shape.geometry.vertices)
    x, y = corners[: len(corners) // 2, 0], corners[: len(corners) // 2, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


@pytest.mark.parametrize("kind", pegs.SECTIONS)
@pytest.mark.parametrize("clearance", [0.002, 0.0005])
def test_a_board_leaves_out_just_the_hole(kind: str, clearance: float) -> None:
    board = pegs.board("board", (kind,), clearance)
    around = sum(area(shape) for shape in board.articulation.root.collisions)
    hole = pegs.TILE**2 - around
    outline = pegs.section(kind).outline
    sides = np.roll(outline, -1, axis=0) - outline
    own = 0.5 * float(np.sum(outline[:, 0] * np.roll(outline[:, 1], -1) - outline[:, 1] * np.roll(outline[:, 0], -1)))
    rim = 0.5 * clearance * float(np.linalg.norm(sides, axis=1).sum())
    assert 0.0 < hole - own - rim < 20.0 * clearance**2


def test_the_expert_puts_a_block_into_a_tight_hole() -> None:
    environment, success = episode("Peg-In-Hole", "mujoco", 2, episode_length=10.0, clearance=0.0005)
    depths = environment.world.objects["block_0"].root_pose[:, 2]
    environment.close()
    assert success.all()
    assert (depths < 0.005).all()


def test_what_the_expert_teaches_by_the_state_alone_puts_a_block_into_its_hole() -> None:
    environment, success = episode("Peg-In-Hole", "mujoco", 2, teaches=True, action="ik_relative", episode_length=6.0)
    environment.close()
    assert success.all()


def test_a_block_on_the_board_is_not_inserted() -> None:
    environment = make("Peg-In-Hole", 2, "mujoco", seed=0)
    task, world = environment.task, environment.world
    assert isinstance(task, PegInHole)
    pose = task_file.seats(environment)[:, 0].clone()
    pose[1, 2] += pegs.BOARD_HEIGHT
    world.objects["block_0"].set_root_pose(pose)
    assert task.success(environment).tolist() == [True, False]
    assert task.metrics(environment)["distance_m"][1] == pytest.approx(pegs.BOARD_HEIGHT, abs=1e-5)
    assert task_file.depth(environment).tolist() == pytest.approx([1.0, 0.0], abs=1e-5)
    environment.close()


def test_a_quarter_turn_of_a_square_block_fits_as_well_and_an_eighth_does_not() -> None:
    environment = make("Peg-In-Hole", 2, "mujoco", seed=0)
    task, world = environment.task, environment.world
    assert isinstance(task, PegInHole)
    pose = task_file.seats(environment)[:, 0].clone()
    turns = torch.tensor([0.5 * torch.pi, 0.24 * torch.pi])
    pose[:, 3:] = transforms.quat_multiply(pose[:, 3:], task_file.common.turned(turns))
    world.objects["block_0"].set_root_pose(pose)
    off = transforms.rotation_angle(task_file.offsets(environment)[:, 0, 3:])
    assert off.tolist() == pytest.approx([0.0, 0.24 * torch.pi], abs=1e-4)
    environment.close()


def test_a_peg_as_wide_as_its_hole_is_refused() -> None:
    with pytest.raises(AssetError, match="40 mm wide and its hole 39 mm, so that it does not go in"):
        make("Peg-In-Hole", 1, "mujoco", clearance=-0.001)
    with pytest.raises(AssetError, match="breaks through its tile"):
        make("Peg-In-Hole", 1, "mujoco", clearance=0.05)
    with pytest.raises(ValueError, match="shape 'rim': contact_distance must be metres above zero, not 0"):
        Shape(Box((0.1, 0.1, 0.1)), name="rim", contact_distance=0.0)


def test_an_unknown_section_is_refused_by_name() -> None:
    with pytest.raises(UnknownNameError, match=r"'sqare'.*square"):
        make("Peg-In-Hole", 1, "mujoco", shapes=("sqare",))


def test_more_blocks_than_fit_before_an_arm_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="6 shapes do not fit before an arm: give 5 at most"):
        make("Peg-In-Hole", 1, "mujoco", shapes=("square",) * 6)
    with pytest.raises(ConfigurationError, match="field 'tolerance' of task PegInHole must be 1e-06 to"):
        make("Peg-In-Hole", 1, "mujoco", tolerance=-1.0)
