"""What the kit gives plugins so that each need not write it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from orbit_core import backends
from orbit_core.conformance.bodies import pendulum, scene
from orbit_core.interfaces import TERRAIN, ContactQuery, SceneLayout
from orbit_core.plugin_kit import contact_signs, velocity_at
from orbit_core.plugin_kit.markers import AXIS_COLORS, marker_shapes
from orbit_core.plugin_kit.rotations import compose, multiply, rotate, rotate_inverse
from orbit_core.scene import MarkerShape, MarkerSpec


def test_velocities_at_another_point_are_those_of_a_turning_body() -> None:
    """A point 0.5 m along x of a body that turns at 2 rad/s about z moves at 1 m/s along y more, and back again."""
    velocity = torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0, 2.0]])
    arm = torch.tensor([[0.5, 0.0, 0.0]])
    moved = velocity_at(velocity, arm)
    assert moved.tolist() == [[1.0, 1.0, 0.0, 0.0, 0.0, 2.0]]
    assert torch.equal(velocity_at(moved, -arm), velocity)


def test_contact_signs_count_both_sides_of_a_pair() -> None:
    queries = (ContactQuery(0), ContactQuery(0, frozenset({TERRAIN})), ContactQuery(1, frozenset({0})))
    signs = contact_signs(queries, [(0, TERRAIN), (0, 1), (1, 2)])
    assert signs.tolist() == [[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]


def test_saved_commands_are_copies_and_come_back_in_place() -> None:
    plugin = backends.backend("mujoco")
    engine = plugin.create_engine(SceneLayout.of(scene(pendulum())), 2, torch.device("cpu"), plugin.config_type())
    buffer = engine.efforts
    engine.efforts.fill_(2.0)
    saved = engine.saved_commands()
    engine.efforts.zero_()
    engine.load_commands(saved)
    assert engine.efforts is buffer
    assert buffer.tolist() == [[2.0, 2.0], [2.0, 2.0]]
    engine.close()


def test_rotations_turn_there_and_back_for_any_number_of_leading_dimensions() -> None:
    """A quarter turn about z takes x to y; then one about x takes y to z."""
    half = np.sqrt(0.5)
    about_z, about_x = np.array([half, 0.0, 0.0, half]), np.array([half, half, 0.0, 0.0])
    x = np.broadcast_to([1.0, 0.0, 0.0], (2, 3, 3))
    turned = rotate(about_z, x)
    assert turned == pytest.approx(np.broadcast_to([0.0, 1.0, 0.0], (2, 3, 3)))
    assert rotate_inverse(about_z, turned) == pytest.approx(x)
    assert rotate(multiply(about_x, about_z), x) == pytest.approx(np.broadcast_to([0.0, 0.0, 1.0], (2, 3, 3)))
    position, orientation = compose(np.array([0.0, 0.0, 2.0]), about_z, np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    assert position == pytest.approx([0.0, 1.0, 2.0])
    assert orientation == pytest.approx(about_z)


def test_a_frame_has_an_arrow_of_its_colour_along_each_axis() -> None:
    shapes = marker_shapes(MarkerSpec("frame", MarkerShape.FRAME, size=0.4, color=(0.0, 0.0, 0.0, 0.5)))
    shafts = shapes[::2]
    for axis, (shaft, color) in enumerate(zip(shafts, AXIS_COLORS, strict=True)):
        assert shaft.color == pytest.approx((*color, 0.5))
        middle = np.zeros(3)
        middle[axis] = 0.15
        assert np.array(shaft.pose.position) == pytest.approx(middle)
