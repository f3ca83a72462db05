"""Wrenches that links receive through their joints."""

# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAssignmentType=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import warp as wp

from orbit_newton.plant import Plant


@wp.kernel(enable_backward=False)
def _read_wrenches(
    links: wp.array[int],
    links_per_env: int,
    body_q: wp.array[wp.transform],
    body_com: wp.array[wp.vec3],
    at_center: wp.array[wp.spatial_vector],
    wrenches: wp.array2d[wp.spatial_vector],
):
    """Convert wrenches from world axes about the centre of mass to the link's axes about its origin."""
    env, number = wp.tid()
    body = env * links_per_env + links[number]
    q = wp.transform_get_rotation(body_q[body])
    force = wp.quat_rotate_inv(q, wp.spatial_top(at_center[body]))
    torque = wp.quat_rotate_inv(q, wp.spatial_bottom(at_center[body])) + wp.cross(body_com[body], force)
    wrenches[env, number] = wp.spatial_vector(force, torque)


class WrenchReader:
    """Reads the layout's wrench links from a solver's ``body_parent_f``."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._links = wp.array(plant.layout.wrench_links, dtype=int, device=plant.model.device)

    def read(self, body_parent_f: wp.array) -> None:
        plant = self._plant
        wp.launch(
            _read_wrenches,
            dim=plant.wrenches.shape,
            inputs=[
                self._links, len(plant.layout.links), plant.state.body_q, plant.model.body_com, body_parent_f
            ],
            outputs=[plant.wrenches],
        )  # fmt: skip
