"""Contacts between shapes, and the contact force of each query."""

# pyright: reportMissingImports=false
# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import newton
import numpy as np
import warp as wp

from orbit_core.interfaces import TERRAIN, SceneLayout
from orbit_warp.newton.builder import BuiltModel


class ContactFinder:
    """Newton's collision detection, each environment's shapes against its own."""

    def __init__(self, built: BuiltModel, num_envs: int, contacts_per_env: int) -> None:
        self.any = built.model.shape_contact_pair_count > 0
        self._pipeline = _pipeline(built.model, contacts_per_env * num_envs) if self.any else None
        self.contacts = self._pipeline.contacts() if self._pipeline else newton.Contacts(0, 0)
        self.capacity = self.contacts.rigid_contact_max
        """Of all environments together."""
        with wp.ScopedDevice(built.model.device):
            self.forces = wp.zeros(self.capacity, dtype=wp.vec3)
            """Force of each contact on its first shape, which the solver fills in, in world axes."""
            self.shapes = wp.full((2, self.capacity), -1, dtype=int)
            """Both shapes of each contact."""

    def find(self, state: newton.State) -> None:
        """Find the contacts of the state's poses."""
        if self._pipeline is not None:
            self._pipeline.collide(state, self.contacts)
            wp.copy(self.shapes[0], self.contacts.rigid_contact_shape0)
            wp.copy(self.shapes[1], self.contacts.rigid_contact_shape1)


def _pipeline(model: newton.Model, capacity: int) -> newton.CollisionPipeline:
    """``capacity`` contacts of all environments, or what Newton estimates where it is zero."""
    return newton.CollisionPipeline(
        model,
        broad_phase="explicit",
        rigid_contact_max=capacity or None,
        include_static_kinematic_pairs=False,
        verify_buffers=False,
    )


@wp.func
def _share(
    link: int,
    other: int,
    force: wp.vec3,
    env: int,
    query_starts: wp.array[int],
    query_numbers: wp.array[int],
    answers: wp.array2d[bool],
    forces: wp.array2d[wp.vec3],
):
    """Add the force on ``link`` to its queries that take ``other``; the terrain is the last link."""
    for i in range(query_starts[link], query_starts[link + 1]):
        query = query_numbers[i]
        if answers[query, other]:
            wp.atomic_add(forces, env, query, force)


@wp.kernel(enable_backward=False)
def _add_contact_forces(
    count: wp.array[int],
    shapes: wp.array2d[int],
    contact_forces: wp.array[wp.vec3],
    link_of_shape: wp.array[int],
    query_starts: wp.array[int],
    query_numbers: wp.array[int],
    answers: wp.array2d[bool],
    forces: wp.array2d[wp.vec3],
):
    contact = wp.tid()
    if contact >= count[0]:
        return
    per_env = link_of_shape.shape[0]
    env = shapes[0, contact] / per_env
    first = link_of_shape[shapes[0, contact] % per_env]
    second = link_of_shape[shapes[1, contact] % per_env]
    force = contact_forces[contact]
    _share(first, second, force, env, query_starts, query_numbers, answers, forces)
    _share(second, first, -force, env, query_starts, query_numbers, answers, forces)


class ContactMeter:
    """Averages the force of each query over the solver steps of a control step."""

    def __init__(self, layout: SceneLayout, built: BuiltModel, num_envs: int, finder: ContactFinder) -> None:
        self._finder = finder
        terrain = len(layout.links)
        of_link: list[list[int]] = [[] for _ in range(terrain + 1)]
        answers = np.ones((max(len(layout.contact_queries), 1), terrain + 1), dtype=bool)
        for number, query in enumerate(layout.contact_queries):
            of_link[query.link].append(number)
            if query.others is not None:
                answers[number] = False
                answers[number, [terrain if other == TERRAIN else other for other in query.others]] = True
        links = built.link_of_shape
        with wp.ScopedDevice(built.model.device):
            self._link_of_shape = wp.array(np.where(links == TERRAIN, terrain, links), dtype=int)
            self._starts = wp.array(np.cumsum([0, *map(len, of_link)]), dtype=int)
            self._numbers = wp.array([number for numbers in of_link for number in numbers], dtype=int)
            self._answers = wp.array(answers, dtype=bool)
            self.forces = wp.zeros((num_envs, len(layout.contact_queries)), dtype=wp.vec3)
            """(N, K) newtons on each query's link."""
        self.needed = len(layout.contact_queries) > 0 and finder.any

    def clear(self) -> None:
        """Begin a control step."""
        if self.needed:
            wp.to_torch(self.forces).zero_()

    def add(self) -> None:
        """Launch what takes in the forces of a solver step."""
        if not self.needed:
            return
        wp.launch(
            _add_contact_forces,
            dim=self._finder.capacity,
            inputs=[
                self._finder.contacts.rigid_contact_count, self._finder.shapes, self._finder.forces,
                self._link_of_shape, self._starts, self._numbers, self._answers,
            ],
            outputs=[self.forces],
        )  # fmt: skip

    def average(self, solver_steps: int) -> None:
        """End a control step."""
        if self.needed:
            wp.to_torch(self.forces).div_(solver_steps)
