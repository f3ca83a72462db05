"""Contact forces per query: one launch over the contacts of a physics step adds each to the queries it answers."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import mujoco_warp as mjw
import warp as wp
from mujoco_warp._src.support import contact_force_fn
from mujoco_warp._src.types import vec5f

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel.addresses import Addresses
from orbit_warpkit.queries import ForceMeter, Queries, add_force


@wp.kernel(enable_backward=False)
def add_contact_forces(
    cone: int,
    queries: Queries,
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
    add_force(queries, env, pair[0], pair[1], -force, forces)


class ContactMeter(ForceMeter):
    """Takes the forces of MuJoCo-Warp's contacts."""

    def __init__(self, layout: SceneLayout, addresses: Addresses, model: mjw.Model, data: mjw.Data) -> None:
        super().__init__(layout, addresses.link_of_geom[:-1], data.nworld, data.qpos.device)
        self._model, self._data = model, data

    def add(self, share: float) -> None:
        """Take in that share of the forces of a physics step."""
        if not self.queries:
            return
        contact = self._data.contact
        wp.launch(
            add_contact_forces,
            dim=self._data.naconmax,
            inputs=[
                self._model.opt.cone, self._queries, share,
                contact.frame, contact.friction, contact.dim, contact.geom, contact.efc_address, contact.worldid,
                contact.adhesion, self._data.efc.force, self._data.njmax, self._data.nacon,
            ],
            outputs=[self.forces],
        )  # fmt: skip
