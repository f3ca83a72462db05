"""Houses by seed: plans, furniture, things placed by rules, and their premises on an engine."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from orbit_core.interfaces.errors import ConfigurationError, PremiseError, UnknownNameError
from orbit_core.preparation.validation import link_poses, validate_entity
from orbit_core.scene import Pose, Scene
from orbit_core.world import simulate
from orbit_scenes.certify import certify, overlaps, settled
from orbit_scenes.furnish import Piece, _joined
from orbit_scenes.furniture import furniture, furniture_kinds, furniture_table
from orbit_scenes.house import SCENES, cluttered_table, heaped_bin, make_house, make_scene, room_kinds
from orbit_scenes.placing import Beside, In, On, Placer
from orbit_scenes.plan import RoomKind, make_plan
from orbit_scenes.things import thing

KITCHEN = make_house((RoomKind.KITCHEN,), seed=3)


@pytest.mark.parametrize("kind", furniture_kinds())
def test_furniture_is_a_valid_object_of_its_size_that_stands_on_the_floor(kind: str):
    made = furniture(kind)
    validate_entity(made.build(kind))
    shapes = [shape for link in made.articulation.links for shape in link.collisions]
    lowest = min(shape.pose.position[2] - getattr(shape.geometry, "half_extents", (0, 0, 0.3))[2] for shape in shapes)
    assert lowest == pytest.approx(made.bottom, abs=0.011)
    assert made.size[:2] == tuple(furniture_table()[kind].size[:2])


@pytest.mark.parametrize("kind", [kind for kind in furniture_kinds() if furniture(kind).articulation.joints])
def test_every_drawer_and_door_of_furniture_moves_through_its_range_without_meeting_the_rest(kind: str):
    made = furniture(kind)
    free = Pose()
    for joint in made.articulation.joints:
        spec = made.build(kind, free)
        for share in (0.3, 1.0):
            scene = Scene(objects=(replace(spec, home={joint.name: share * joint.upper_limit}),), terrain=())
            poses = link_poses(made.articulation, {joint.name: share * joint.upper_limit})
            assert not list(overlaps(scene))
            moved = poses[joint.child].transform((-made.size[0] / 2, 0.0, 0.5))
            assert np.linalg.norm(moved - (-made.size[0] / 2, 0.0, 0.5)) > 0.02


def test_a_handle_is_in_front_of_its_drawer_with_its_frame_pointing_into_it():
    made = furniture("base_drawers")
    frame = made.articulation.frame("drawer_1_handle")
    assert frame.pose.position[0] < -made.size[0] / 2
    assert frame.pose.rotation_matrix()[:, 2] == pytest.approx((1.0, 0.0, 0.0))


@pytest.mark.parametrize("seed", range(6))
def test_a_plan_joins_all_rooms_by_doors_and_its_walls_share_no_volume(seed: int):
    plan = make_plan(room_kinds("house", 5), np.random.default_rng(seed))
    joined = {0}
    for _ in plan.rooms:
        joined |= {room for _, door in plan.doors() if set(door.rooms) & joined for room in door.rooms}
    assert joined == set(range(5))
    boxes = [(np.array(s.pose.position), np.array(s.geometry.half_extents)) for s in plan.shapes()]  # pyright: ignore[reportAttributeAccessIssue]
    for index, (a, half) in enumerate(boxes):
        for b, other in boxes[index + 1 :]:
            assert (np.abs(a - b) >= half + other - 1e-6).any()


@pytest.mark.parametrize("seed", range(3))
def test_a_walker_gets_from_door_to_door_of_every_room(seed: int):
    from orbit_scenes.furnish import furnished

    random = np.random.default_rng(seed)
    plan = make_plan(room_kinds("house", 3), random)
    for index in range(3):
        layout = furnished(plan, index, random)
        assert layout.pieces
        assert _joined(layout.room.inside, [piece.rectangle for piece in layout.pieces], layout.doors)


def test_one_seed_makes_one_scene_and_another_seed_another():
    again = make_house((RoomKind.KITCHEN,), seed=3)
    poses = [thing.pose for thing in KITCHEN.things]
    assert [thing.pose for thing in again.things] == poses
    other = make_house((RoomKind.KITCHEN,), seed=4)
    assert [thing.pose for thing in other.things] != poses


def test_a_kitchen_has_what_kitchens_have_and_things_within_reach():
    kinds = {piece.furniture.kind for piece in KITCHEN.pieces}
    assert {"fridge", "sink", "stove", "base_drawers"} <= kinds
    assert len(KITCHEN.things) == 10
    for placed in KITCHEN.things:
        away = np.linalg.norm(KITCHEN.floor - placed.pose.position[:2], axis=1).min()
        assert away <= 1.11, placed.name
        assert 0.1 < placed.pose.position[2] < 1.9


def test_nothing_in_a_kitchen_overlaps_and_everything_stays_when_physics_runs():
    certificate = certify(KITCHEN.scene, "mujoco", seconds=0.5)
    certificate.check()
    assert len(certificate.movements) == len(KITCHEN.scene.objects)


def test_a_house_of_five_rooms_and_forty_things_is_made_and_built_in_time():
    start = time.process_time()
    house = make_house(room_kinds("house", 5), seed=0, things=40)
    made = time.process_time()
    world = simulate(house.scene, 1, "mujoco")
    built = time.process_time()
    world.close()
    assert len(house.things) == 40
    # Measured 0.9 s and 1.0 s; the limits are those that are promised.
    assert made - start < 10.0
    assert built - made < 5.0


def test_rules_put_things_on_in_and_beside():
    table = Piece("table", furniture("work_table"), 0.0, 0.0, 0.0, 0)
    cabinet = Piece("cabinet", furniture("base_drawers"), 2.0, 0.0, 0.0, 0)
    placer = Placer([table, cabinet], np.array(((-0.7, 0.0), (1.2, 0.0))), np.random.default_rng(0))
    plate = placer.place("plate", On(furniture="work_table"))
    fork = placer.place("fork", Beside(thing="plate", distance=0.1))
    spoon = placer.place("spoon", In(furniture="base_drawers"))
    bowl = placer.place("bowl", On(furniture="work_table"))
    apple = placer.place("apple", In(furniture="bowl"))
    assert plate.support == fork.support == bowl.support == "table.top"
    assert spoon.support.startswith("cabinet.drawer_")
    assert apple.support == "bowl.inside"
    apart = np.linalg.norm(np.subtract(fork.pose.position[:2], plate.pose.position[:2]))
    assert apart < 0.129 + 0.1 + 0.11
    objects = [each.build() for each in placer.placed]
    assert not list(overlaps(Scene(objects=(table.build(), cabinet.build(), *objects))))


def test_a_rule_that_nothing_meets_and_a_place_out_of_reach_are_named():
    table = Piece("table", furniture("work_table"), 0.0, 0.0, 0.0, 0)
    placer = Placer([table], np.array(((-3.0, 0.0),)), np.random.default_rng(0))
    with pytest.raises(PremiseError, match=r"'mug' is to be placed in 'fridge.*nothing in the scene meets that"):
        placer.place("mug", In(furniture="fridge"))
    with pytest.raises(PremiseError, match="within reach"):
        placer.place("mug", On(furniture="work_table"))
    with pytest.raises(UnknownNameError, match="did you mean 'mug'"):
        placer.place("mgu", On())


def test_overlapping_things_are_named_and_so_is_one_that_falls():
    mug = thing("mug")
    a, b = mug.build("a", Pose((0.0, 0.0, 0.04))), mug.build("b", Pose((0.03, 0.0, 0.04)))
    with pytest.raises(PremiseError, match="'a' and 'b' overlap"):
        certify(Scene(objects=(a, b))).check()
    high = mug.build("high", Pose((0.0, 0.0, 1.0)))
    with pytest.raises(PremiseError, match=r"'high' falls 0.9\d m"):
        certify(Scene(objects=(high,)), "mujoco").check()
    sunk = mug.build("sunk", Pose((0.0, 0.0, 0.0)))
    with pytest.raises(PremiseError, match="'sunk' and 'ground' overlap"):
        certify(Scene(objects=(sunk,))).check()


def test_a_settled_scene_has_its_things_where_they_came_to_rest():
    mug = thing("mug")
    scene = settled(Scene(objects=(mug.build("mug", Pose((0.0, 0.0, 0.15))),)), "mujoco")
    assert scene.objects[0].pose.position[2] == pytest.approx(mug.rest_height, abs=0.002)
    certify(scene, "mujoco").check()


def test_a_thing_that_leaves_the_scene_while_it_settles_is_named():
    scene = Scene(objects=(thing("mug").build("mug", Pose((0.0, 0.0, 1.0))),), terrain=())
    with pytest.raises(PremiseError, match="'mug' leaves the scene"):
        settled(scene, "mujoco", seconds=1.0)


def test_a_heap_falls_into_its_bin():
    scene = settled(heaped_bin(seed=1, things=6), "mujoco")
    free = [each for each in scene.objects if each.is_free_body]
    assert len(free) == 6
    for each in free:
        x, y, z = each.pose.position
        assert abs(x - 0.65) < 0.15
        assert abs(y) < 0.2
        assert 0.72 < z < 1.0


def test_clutter_stands_on_a_table_without_overlap():
    scene = cluttered_table(seed=2, things=14)
    assert sum(each.is_free_body for each in scene.objects) == 14
    certify(scene).check()
    with pytest.raises(PremiseError, match="place fewer things"):
        cluttered_table(seed=2, things=300)


def test_scenes_by_name_refuse_unknown_kinds_and_numbers():
    assert {"house", "kitchen", "table", "bin"} <= set(SCENES)
    with pytest.raises(UnknownNameError, match="did you mean 'kitchen'"):
        make_scene("kitchn")
    with pytest.raises(ConfigurationError, match="1 to 12"):
        make_scene("house", rooms=13)
    with pytest.raises(ConfigurationError, match="has no rooms"):
        make_scene("bin", rooms=2)
    with pytest.raises(ConfigurationError, match="zero or more"):
        make_house((RoomKind.STUDY,), things=-1)
    with pytest.raises(UnknownNameError, match="did you mean 'stove'"):
        furniture("stov")
