"""Contacts, what is told of them, and rays."""

from __future__ import annotations

from dataclasses import replace

import torch
from orbit_torch.engine import TorchEngine
from orbit_torch.solver import Rows
from orbit_torch.system import Equation
from torch import Tensor

from orbit_core.interfaces import BACKGROUND, TERRAIN, RayHits, SceneLayout

from .mutant import Misread, mutant, with_articulations

FRICTION = "contacts::test_a_pair_takes_the_larger_friction"
TOUCH = "contacts::test_who_may_touch_within_an_articulation"
FORCE = "contacts::test_force_is_zero_after_a_reset_until_the_next_step"


class _Rubbing(TorchEngine):
    """With a friction of pairs (N, C, 2) that a mutant combines its own way."""

    def combined(self, pairs: Tensor) -> Tensor:
        raise NotImplementedError

    def _rows(self, equation: Equation) -> tuple[Rows, Tensor]:
        rows, near = super()._rows(equation)
        shapes = self._contacts.shapes[near]
        pairs = self._friction.gather(1, shapes.flatten(1)).view(shapes.shape)
        return replace(rows, friction=self.combined(pairs)), near


@mutant(FRICTION)
class SmallerFriction(_Rubbing):
    """Gives a pair the smaller of two coefficients."""

    def combined(self, pairs: Tensor) -> Tensor:
        return pairs.amin(-1)


@mutant(FRICTION)
class MeanFriction(_Rubbing):
    """Gives a pair the mean of two coefficients."""

    def combined(self, pairs: Tensor) -> Tensor:
        return pairs.mean(-1)


@mutant(FRICTION)
class FrictionMultiplied(_Rubbing):
    """Gives a pair the product of two coefficients."""

    def combined(self, pairs: Tensor) -> Tensor:
        return pairs.prod(-1)


@mutant(FRICTION)
class NoFriction(_Rubbing):
    """Lets everything slide."""

    def combined(self, pairs: Tensor) -> Tensor:
        return torch.zeros_like(pairs[..., 0])


@mutant(TOUCH)
class SelfCollisionsAlways(Misread):
    """Lets links of one articulation collide though it says that they do not."""

    misread = with_articulations(lambda articulation: replace(articulation, self_collisions=True))


@mutant(TOUCH)
class SelfCollisionsNever(Misread):
    """Lets links of one articulation pass through each other though it says that they collide."""

    misread = with_articulations(lambda articulation: replace(articulation, self_collisions=False))


@mutant(TOUCH)
class ExclusionsIgnored(Misread):
    """Lets links collide that are excluded."""

    misread = with_articulations(lambda articulation: replace(articulation, collision_exclusions=()))


@mutant("contacts::test_a_fixed_thing_stops_a_falling_one")
class TerrainAlone(TorchEngine):
    """Lets bodies touch the terrain and nothing else."""

    def _rows(self, equation: Equation) -> tuple[Rows, Tensor]:
        rows, near = super()._rows(equation)
        between = (self._contacts.links[near][..., 1] < len(self.layout.links)).repeat_interleave(3, 1)
        rows.jacobian[:, len(rows.least) :][between] = 0.0
        rows.target[:, len(rows.least) :][between] = 0.0
        return rows, near


@mutant(FORCE)
class ForcesSummed(TorchEngine):
    """Tells the sum of the steps' contact forces, not their mean."""

    def step(self, steps: int) -> None:
        super().step(steps)
        self._contact_forces *= steps


@mutant(FORCE)
class ForcesOfTheOther(TorchEngine):
    """Tells the force that a link exerts, not the one that it feels."""

    @property
    def contact_forces(self) -> Tensor:
        return -super().contact_forces


@mutant("contact_force_pairs")
class QueriesReversed(TorchEngine):
    """Answers contact queries in the reverse order."""

    @property
    def contact_forces(self) -> Tensor:
        return super().contact_forces.flip(1)


@mutant("contact_force_pairs")
class FiltersIgnored(Misread):
    """Tells the whole force on a link where one entity's was asked for."""

    @staticmethod
    def misread(layout: SceneLayout) -> SceneLayout:
        return replace(layout, contact_queries=tuple(replace(q, others=None) for q in layout.contact_queries))


class _Rays(TorchEngine):
    """With hits that a mutant alters."""

    def altered(self, hits: RayHits) -> RayHits:
        raise NotImplementedError

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        return self.altered(super().cast_rays(origins, directions, max_distance, env_ids))


@mutant("rays::test_beyond_the_greatest_distance_there_is_nothing")
class RaysWithoutEnd(TorchEngine):
    """Ignores how far rays go."""

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        return super().cast_rays(origins, directions, 1e6, env_ids)


@mutant("rays::test_beyond_the_greatest_distance_there_is_nothing")
class MissesAtZero(_Rays):
    """Tells a distance of zero where rays meet nothing."""

    def altered(self, hits: RayHits) -> RayHits:
        return replace(hits, distances=hits.distances.nan_to_num(posinf=0.0))


@mutant("shapes::test_rays_meet_a_shape_where_its_sizes_say")
class NormalsInwards(_Rays):
    """Tells the normal that points into the shape."""

    def altered(self, hits: RayHits) -> RayHits:
        return replace(hits, normals=-hits.normals)


@mutant("rays::test_rays_tell_the_terrain_from_things_and_from_nothing")
class TerrainToldAsBackground(_Rays):
    """Tells of the terrain as of nothing at all."""

    def altered(self, hits: RayHits) -> RayHits:
        return replace(hits, links=torch.where(hits.links == TERRAIN, BACKGROUND, hits.links))


@mutant("rays::test_rays_see_what_was_just_written_in_their_own_environment")
class RaysBeforeTheWrite(TorchEngine):
    """Casts rays at where things were after the last step."""

    def cast_rays(
        self, origins: Tensor, directions: Tensor, max_distance: float, env_ids: Tensor | None = None
    ) -> RayHits:
        now = self._poses.clone()
        self.reset()
        hits = super().cast_rays(origins, directions, max_distance, env_ids)
        self._poses.copy_(now)
        return hits
