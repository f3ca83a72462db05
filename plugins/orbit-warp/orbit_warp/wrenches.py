"""Joint wrenches without the weight of bodies that are held up: one launch after a step takes it off."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportAttributeAccessIssue=false
# pyright: reportOperatorIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp
from mujoco_warp._src.types import vec10

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel.addresses import Addresses
from orbit_mjmodel.drives import adds_damping as integrator_adds_damping
from orbit_mjmodel.wrenches import CompositeInertias, held_up_beyond
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


@wp.func
def times_inertia(inertia: vec10, motion: wp.spatial_vector):
    """A spatial inertia as MuJoCo keeps it (moments, mass times offset, mass) times a motion: torque, then force."""
    spin = wp.spatial_top(motion)
    speed = wp.spatial_bottom(motion)
    offset = wp.vec3(inertia[6], inertia[7], inertia[8])
    turned = wp.vec3(
        inertia[0] * spin[0] + inertia[3] * spin[1] + inertia[4] * spin[2],
        inertia[3] * spin[0] + inertia[1] * spin[1] + inertia[5] * spin[2],
        inertia[4] * spin[0] + inertia[5] * spin[1] + inertia[2] * spin[2],
    )
    return wp.spatial_vector(turned + wp.cross(offset, speed), inertia[9] * speed - wp.cross(offset, spin))


@wp.kernel(enable_backward=False)
def add_damping(
    bodies: wp.array[int],
    roots: wp.array[int],
    carriers: wp.array2d[int],
    step: wp.array[float],
    before: wp.array2d[float],
    qvel: wp.array2d[float],
    qacc: wp.array2d[float],
    inertias: wp.array2d[vec10],
    motions: wp.array2d[wp.spatial_vector],
    centers: wp.array2d[wp.vec3],
    origins: wp.array2d[wp.vec3],
    axes: wp.array2d[wp.mat33],
    wrenches: wp.array2d[float],
):
    """Add what the integrator's damping of drives and joints changed of the accelerations that sensors saw."""
    env, slot = wp.tid()
    body = bodies[slot]
    total = wp.spatial_vector()
    for dof in range(carriers.shape[1]):
        carrier = carriers[slot, dof]
        if carrier >= 0:
            rate = (qvel[env, dof] - before[env, dof]) / step[env % step.shape[0]] - qacc[env, dof]
            total += times_inertia(inertias[env, carrier], rate * motions[env, dof])
    force = wp.spatial_bottom(total)
    torque = wp.spatial_top(total) - wp.cross(origins[env, body] - centers[env, roots[slot]], force)
    local = wp.transpose(axes[env, body])
    force = local * force
    torque = local * torque
    for axis in range(3):
        wrenches[env, 6 * slot + axis] += force[axis]
        wrenches[env, 6 * slot + 3 + axis] += torque[axis]


class WrenchMeter:
    """Corrects the wrenches that MuJoCo-Warp measures: for bodies that are held up, and for implicit damping."""

    def __init__(self, layout: SceneLayout, addresses: Addresses, native: Native) -> None:
        bodies = addresses.bodies[list(layout.wrench_links)]
        beyond = held_up_beyond(native.host_model, bodies)
        self._native, self._bears = native, bool(beyond.any())
        self._damped = bool(len(bodies)) and integrator_adds_damping(native.host_model)
        if self._bears or self._damped:
            self._bodies = wp.array(bodies, dtype=int)
        if self._bears:
            self._beyond = wp.array(beyond, dtype=float)
        if self._damped:
            composite = CompositeInertias(native.host_model, bodies)
            self._roots, self._carriers = wp.array(composite.roots, dtype=int), wp.array(composite.carrier, dtype=int)
            self._before = wp.zeros_like(native.data.qvel)

    def begin(self) -> None:
        """Keep the velocities that a physics step begins with."""
        if self._damped:
            wp.copy(self._before, self._native.data.qvel)

    def settle(self) -> None:
        """Correct the last physics step's wrenches, before poses are brought up to date."""
        model, data = self._native.model, self._native.data
        if self._bears:
            wp.launch(
                take_off_weights,
                dim=(data.nworld, len(self._bodies)),
                inputs=[
                    self._bodies, self._beyond, model.body_mass, model.opt.gravity, data.xipos, data.xpos, data.xmat,
                ],
                outputs=[data.sensordata],
            )  # fmt: skip
        if self._damped:
            wp.launch(
                add_damping,
                dim=(data.nworld, len(self._bodies)),
                inputs=[
                    self._bodies, self._roots, self._carriers, model.opt.timestep, self._before, data.qvel, data.qacc,
                    data.crb, data.cdof, data.subtree_com, data.xpos, data.xmat,
                ],
                outputs=[data.sensordata],
            )  # fmt: skip
