"""The library of household things: sizes, masses, hulls, labels and grasps."""

from __future__ import annotations

import pytest
import trimesh

from orbit_assets.decomposition import Convex, convex_shape, distance
from orbit_core.interfaces.errors import ConfigurationError, UnknownNameError
from orbit_core.objects import object_config
from orbit_core.plugin_kit.meshes import triangles
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Box, Mesh, Pose, Shape
from orbit_scenes.grasps import Jaw, grasps
from orbit_scenes.things import ThingConfig, ThingData, make_thing, thing, thing_names, thing_table

# Every thing is built once, and shared.
NAMES = thing_names()


def test_there_are_at_least_sixty_things_each_with_a_source_of_its_size():
    assert len(NAMES) >= 60
    assert {entry.source for entry in thing_table().values()} == {"ycb", "rules", "estimate"}


@pytest.mark.parametrize("name", NAMES)
def test_a_thing_is_a_valid_body_of_convex_pieces_with_its_mass_and_a_label(name: str):
    made, entry = thing(name), thing_table()[name]
    validate_entity(made.build(name))
    assert made.link.mass == pytest.approx(entry.mass)
    assert made.link.semantic_label
    assert all(shape.material.static_friction == entry.friction for shape in made.link.collisions)
    for shape in made.link.collisions:
        if isinstance(shape.geometry, Mesh):
            solid = trimesh.Trimesh(shape.geometry.vertices, shape.geometry.faces, process=False)
            assert solid.is_watertight
            assert solid.volume == pytest.approx(solid.convex_hull.volume, rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_thing_rests_on_its_underside_at_its_rest_height(name: str):
    made = thing(name)
    heights = [shape.pose.transform(triangles(shape.geometry).vertices)[:, 2].min() for shape in made.link.collisions]
    assert min(heights) == pytest.approx(-made.rest_height, abs=1e-4)


def test_sizes_are_those_of_the_table_of_ycb():
    # Calli et al. 2015, table 1: cracker box 60 x 160 x 230 mm, mug 80 x 82 mm, bowl 159 x 53 mm, plate 258 x 24 mm.
    assert thing("cracker_box").size == pytest.approx((0.06, 0.16, 0.23))
    assert thing("bowl").size == pytest.approx((0.159, 0.159, 0.053), abs=1e-4)
    assert thing("plate").size == pytest.approx((0.258, 0.258, 0.024), abs=1e-4)
    assert thing("mug").size[1:] == pytest.approx((0.081, 0.081), abs=1e-3)


def _pieces(name: str) -> list[Convex]:
    found = [convex_shape(shape, Pose()) for shape in thing(name).link.collisions]
    return [each for each in found if each is not None]


def _block(half: tuple[float, float, float], pose: Pose) -> Convex:
    made = convex_shape(Shape(Box(half)), pose)
    assert made is not None
    return made


def test_a_mug_is_hollow_and_its_wall_collides():
    cavity = thing("mug").cavity
    assert cavity is not None
    middle = Pose((*cavity.axis, 0.0))
    # A block of 40 mm fits into it; one of 80 mm does not.
    assert min(distance(_block((0.02, 0.02, 0.02), middle), piece) for piece in _pieces("mug")) > 0.003
    assert min(distance(_block((0.04, 0.04, 0.02), middle), piece) for piece in _pieces("mug")) == 0.0


def test_slanted_walls_lift_what_is_wider_than_the_floor_of_a_bowl():
    cavity = thing("bowl").cavity
    assert cavity is not None
    assert cavity.lift(0.01) == 0.0
    assert 0.0 < (cavity.lift(0.045) or 0.0) < 0.02
    assert cavity.lift(0.09) is None


@pytest.mark.parametrize("name", ["mug", "bowl", "plate", "hammer", "soup_can", "cracker_box", "fork"])
def test_pads_at_a_grasp_are_free_when_open_and_touch_on_both_sides_when_closed(name: str):
    found, jaw, pieces = grasps(thing(name)), Jaw(), _pieces(name)
    assert found
    x, y, z = (length / 2 for length in jaw.pad)
    for grasp in found[:4]:
        assert 0.0 < grasp.width <= jaw.opening
        for side in (1.0, -1.0):
            gaps = []
            for off in (jaw.clearance, -0.002):
                pad = _block((x, y, z), grasp.pose @ Pose((0.0, side * (grasp.width / 2 + off + y), 0.008 - z)))
                gaps.append(min(distance(pad, piece) for piece in pieces))
            assert gaps[0] > 0.0
            assert gaps[1] == 0.0


def test_a_thing_wider_than_the_jaw_has_no_grasp_and_a_wider_jaw_finds_one():
    assert not grasps(thing("wood_block"))
    assert grasps(thing("wood_block"), Jaw(opening=0.1))


def test_an_unknown_thing_is_named_with_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'mug'"):
        thing("mugg")


def test_an_entry_of_no_form_or_two_is_refused():
    with pytest.raises(ConfigurationError, match="no form"):
        ThingData(mass=1.0, source="estimate", color=(1.0, 1.0, 1.0))
    with pytest.raises(ConfigurationError, match="block and can"):
        ThingData(mass=1.0, source="estimate", color=(1.0, 1.0, 1.0), block=(1.0, 1.0, 1.0), can=(1.0, 1.0))
    data = ThingData(mass=1.0, source="estimate", color=(1.0, 1.0, 1.0), block=(0.1, 0.1))
    with pytest.raises(ConfigurationError, match="three finite numbers"):
        make_thing("odd", data)


def test_a_task_takes_a_thing_by_name_with_another_mass():
    config = ThingConfig(thing="hammer", mass=0.2)
    built = config.build("tool")
    assert built.articulation.mass == pytest.approx(0.2)
    assert built.articulation.root.inertia == pytest.approx(thing("hammer").link.inertia * (0.2 / 0.665))


def test_things_and_furniture_are_kinds_of_objects_where_the_distribution_is_installed():
    from orbit_core.objects import object_kinds

    if "thing" not in object_kinds().names:
        pytest.skip("orbit-scenes is not installed")
    assert object_config("thing", thing="bowl").rest_height == pytest.approx(thing("bowl").rest_height)
