"""Contact forces per query: one launch over the contacts of a physics step adds each to the queries it answers."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco_warp._src.support import contact_force_fn
from mujoco_warp._src.types import vec5f

from orbit_core.interfaces import TERRAIN, SceneLayout
from orbit_mjmodel.addresses import Addresses


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
def add_contact_forces(
    cone: int,
    link_of_geom: wp.array[int],
    query_starts: wp.array[int],
    query_numbers: wp.array[int],
    answers: wp.array2d[bool],
    share: float,
    frame: wp.array[wp.mat33],
    friction: wp.array[vec5f],
    dim: wp.array[int],
    geoms: wp.array[wp.vec2i],
    efc_address: wp.array2d[int],
    env_of_contact: wp.array[int],
    adhesion: wp.array[float],
    efc_force: wp.array2d[float],
    njmax: int,
    count: wp.array[int],
    forces: wp.array2d[wp.vec3],
):
    contact = wp.tid()
    if contact >= count[0] or efc_address[contact, 0] < 0:
        return
    env = env_of_contact[contact]
    wrench = contact_force_fn(
        cone, frame, friction, dim, efc_address, adhesion, efc_force, njmax, count, env, contact, True
    )
    force = share * wp.spatial_top(wrench)  # on the second geom
    pair = geoms[contact]
    first, second = link_of_geom[pair[0]], link_of_geom[pair[1]]
    _share(first, second, -force, env, query_starts, query_numbers, answers, forces)
    _share(second, first, force, env, query_starts, query_numbers, answers, forces)


class ContactMeter:
    """Averages the force of each query over the physics steps of a control step."""

    def __init__(self, layout: SceneLayout, addresses: Addresses, model: mjw.Model, data: mjw.Data) -> None:
        self._model, self._data = model, data
        terrain = len(layout.links)
        of_link: list[list[int]] = [[] for _ in range(terrain + 1)]
        answers = np.ones((max(len(layout.contact_queries), 1), terrain + 1), dtype=bool)
        for number, query in enumerate(layout.contact_queries):
            of_link[query.link].append(number)
            if query.others is not None:
                answers[number] = False
                answers[number, [terrain if other == TERRAIN else other for other in query.others]] = True
        links = addresses.link_of_geom[:-1]
        device = data.qpos.device
        with wp.ScopedDevice(device):
            self._link_of_geom = wp.array(np.where(links == TERRAIN, terrain, links), dtype=int)
            self._starts = wp.array(np.cumsum([0, *map(len, of_link)]), dtype=int)
            self._numbers = wp.array([number for numbers in of_link for number in numbers], dtype=int)
            self._answers = wp.array(answers, dtype=bool)
            self.forces = wp.zeros((data.nworld, len(layout.contact_queries)), dtype=wp.vec3)
            """(N, K) newtons on each query's link."""
        self.queries = len(layout.contact_queries)

    def clear(self) -> None:
        """Begin a control step."""
        if self.queries:
            self.forces.zero_()

    def add(self, share: float) -> None:
        """Take in that share of the forces of a physics step."""
        if not self.queries:
            return
        contact = self._data.contact
        wp.launch(
            add_contact_forces,
            dim=self._data.naconmax,
            inputs=[
                self._model.opt.cone, self._link_of_geom, self._starts, self._numbers, self._answers, share,
                contact.frame, contact.friction, contact.dim, contact.geom, contact.efc_address, contact.worldid,
                contact.adhesion, self._data.efc.force, self._data.njmax, self._data.nacon,
            ],
            outputs=[self.forces],
        )  # fmt: skip

    def average(self, steps: int) -> None:
        """Turn the sum over so many physics steps into their mean."""
        if self.queries:
            wp.to_torch(self.forces).div_(steps)
