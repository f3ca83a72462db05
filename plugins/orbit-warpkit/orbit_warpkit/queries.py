"""A layout's contact queries as kernels see them, and the force that answers each, whichever engine finds contacts."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import warp as wp

from orbit_core.interfaces import TERRAIN, SceneLayout


@wp.struct
class Queries:
    """Links of one environment; the terrain is the last."""

    link_of_shape: wp.array[int]
    """Link of each shape; the number after all links for the terrain."""
    starts: wp.array[int]
    """Offsets in ``numbers`` at which the queries of each link begin."""
    numbers: wp.array[int]
    """Queries of all links, one link after another."""
    answers: wp.array2d[bool]
    """Whether contact with a link counts for a query."""


@wp.func
def _share(queries: Queries, env: int, link: int, other: int, force: wp.vec3, forces: wp.array2d[wp.vec3]):
    """Add the force on ``link`` to its queries that take ``other``."""
    for i in range(queries.starts[link], queries.starts[link + 1]):
        query = queries.numbers[i]
        if queries.answers[query, other]:
            wp.atomic_add(forces, env, query, force)


@wp.func
def add_force(queries: Queries, env: int, shape0: int, shape1: int, force: wp.vec3, forces: wp.array2d[wp.vec3]):
    """Add the force on the first of two shapes, and its reaction on the second, to the queries that ask for them."""
    first, second = queries.link_of_shape[shape0], queries.link_of_shape[shape1]
    _share(queries, env, first, second, force, forces)
    _share(queries, env, second, first, -force, forces)


class ForceMeter:
    """Averages the force of each query over the steps of a control step."""

    def __init__(self, layout: SceneLayout, link_of_shape: npt.NDArray, num_envs: int, device: wp.Device) -> None:
        self.queries = len(layout.contact_queries)
        """Number of contact queries."""
        with wp.ScopedDevice(device):
            self._queries = _queries(layout, link_of_shape)
            self.forces = wp.zeros((num_envs, self.queries), dtype=wp.vec3)
            """(N, K) newtons on each query's link, in world axes."""

    def clear(self) -> None:
        """Begin a control step."""
        if self.queries:
            self.forces.zero_()

    def average(self, steps: int) -> None:
        """Turn the sum over so many steps into their mean."""
        if self.queries:
            wp.to_torch(self.forces).div_(steps)


def _queries(layout: SceneLayout, link_of_shape: npt.NDArray) -> Queries:
    terrain = len(layout.links)
    of_link: list[list[int]] = [[] for _ in range(terrain + 1)]
    answers = np.ones((max(len(layout.contact_queries), 1), terrain + 1), dtype=bool)
    for number, query in enumerate(layout.contact_queries):
        of_link[query.link].append(number)
        if query.others is not None:
            answers[number] = False
            answers[number, [terrain if other == TERRAIN else other for other in query.others]] = True
    queries = Queries()
    # The terrain's number is negative in layouts; kernels index with it, so that it becomes the last link here.
    queries.link_of_shape = wp.array(np.where(link_of_shape == TERRAIN, terrain, link_of_shape), dtype=int)
    queries.starts = wp.array(np.cumsum([0, *map(len, of_link)]), dtype=int)
    queries.numbers = wp.array([number for numbers in of_link for number in numbers], dtype=int)
    queries.answers = wp.array(answers, dtype=bool)
    return queries
