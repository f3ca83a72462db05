"""Joint wrenches without the weight of bodies that are held up: one launch after a step takes it off."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel.addresses import Addresses
from orbit_mjmodel.wrenches import held_up_beyond
from orbit_warp.native import Native


@wp.kernel(enable_backward=False)
def take_off_weights(
    bodies: wp.array[int],
    beyond: wp.array2d[float],
    mass: wp.array2d[float],
    gravity: wp.array[wp.vec3],
    centers: wp.array2d[wp.vec3],
    origins: wp.array2d[wp.vec3],
    axes: wp.array2d[wp.mat33],
    wrenches: wp.array2d[float],
):
    env, slot = wp.tid()
    body = bodies[slot]
    force = wp.vec3()
    torque = wp.vec3()
    for other in range(beyond.shape[1]):
        share = beyond[slot, other]
        if share > 0.0:
            weight = share * mass[env % mass.shape[0], other] * gravity[env % gravity.shape[0]]
            force += weight
            torque += wp.cross(centers[env, other] - origins[env, body], weight)
    local = wp.transpose(axes[env, body])
    force = local * force
    torque = local * torque
    for axis in range(3):
        wrenches[env, 6 * slot + axis] += force[axis]
        wrenches[env, 6 * slot + 3 + axis] += torque[axis]


class WrenchMeter:
    """Takes the weight of bodies that are held up off the joints' wrenches."""

    def __init__(self, layout: SceneLayout, addresses: Addresses, native: Native) -> None:
        bodies = addresses.bodies[list(layout.wrench_links)]
        beyond = held_up_beyond(native.host_model, bodies)
        self._native, self._bears = native, bool(beyond.any())
        if self._bears:
            self._bodies, self._beyond = wp.array(bodies, dtype=int), wp.array(beyond, dtype=float)

    def settle(self) -> None:
        """Once after each step."""
        if not self._bears:
            return
        model, data = self._native.model, self._native.data
        wp.launch(
            take_off_weights,
            dim=(data.nworld, len(self._bodies)),
            inputs=[
                self._bodies, self._beyond, model.body_mass, model.opt.gravity, data.xipos, data.xpos, data.xmat,
            ],
            outputs=[data.sensordata],
        )  # fmt: skip
