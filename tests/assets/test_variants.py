"""What may stand in for an object in some environments, and which environment has which."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from orbit_assets.objects import box, cabinet, sphere
from orbit_core.interfaces import AssetError, Capability, SceneLayout, required_capabilities
from orbit_core.preparation.validation import validate_entity
from orbit_core.scene import Articulation, Frame, ObjectSpec, Plane, Scene, Shape


def varied(*variants: Articulation) -> ObjectSpec:
    return replace(box("thing", (0.1, 0.1, 0.1)), variants=variants)


def on_plane(articulation: Articulation) -> Articulation:
    return replace(articulation, links=(replace(articulation.root, collisions=(Shape(Plane()),)),))


BALL = sphere("thing", 0.1).articulation
WRONG: dict[str, Callable[[], ObjectSpec]] = {
    "single links": lambda: varied(replace(cabinet("thing").articulation, name="thing")),
    "link's name": lambda: varied(sphere("other", 0.1).articulation),
    "frames": lambda: varied(replace(BALL, frames=(Frame("grip", "thing"),))),
    "solids": lambda: varied(on_plane(BALL)),
    "no mass": lambda: varied(replace(BALL, links=(replace(BALL.root, mass=0.0, inertia=0 * BALL.root.inertia),))),
}


@pytest.mark.parametrize("complaint", WRONG)
def test_what_cannot_stand_in_is_refused(complaint: str) -> None:
    validate_entity(varied(BALL))
    with pytest.raises(AssetError, match=complaint):
        validate_entity(WRONG[complaint]())


def test_kinds_of_environments_repeat_with_every_combination() -> None:
    other = replace(box("other", (0.2, 0.2, 0.2)), variants=(box("other", (0.3, 0.3, 0.3)).articulation,) * 2)
    layout = SceneLayout.of(Scene(objects=(varied(BALL), other)))
    kinds = layout.variants
    assert len(kinds) == 6
    first, second = layout.scene.objects
    for number, kind in enumerate(kinds):
        assert kind.links == (first.alternatives[number % 2].root, second.alternatives[number % 3].root)
        assert len(kind.variants) == 1


def test_a_scene_without_variants_is_of_one_kind() -> None:
    layout = SceneLayout.of(Scene(objects=(varied(),)))
    assert layout.variants == (layout,)


def test_a_scene_needs_what_any_of_its_variants_needs() -> None:
    needs = required_capabilities(Scene(objects=(varied(BALL),)))
    assert needs[Capability.SHAPES_PER_ENVIRONMENT] == "'thing'"
    assert Capability.SHAPES_PER_ENVIRONMENT not in required_capabilities(Scene(objects=(varied(),)))
