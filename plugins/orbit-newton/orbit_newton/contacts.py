"""Contacts between shapes, and the contact force of each query."""

# pyright: reportMissingImports=false
# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAssignmentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false
# Kernels are compiled by Warp; to Python they are annotations and calls that no type checker can follow.

from __future__ import annotations

import newton
import warp as wp

from orbit_core.interfaces import SceneLayout
from orbit_newton.builder import BuiltModel
from orbit_newton.config import NewtonConfig
from orbit_warpkit.queries import ForceMeter, Queries, add_force


class ContactFinder:
    """Newton's collision detection, each environment's shapes against its own."""

    def __init__(self, built: BuiltModel, num_envs: int, config: NewtonConfig, interval: float) -> None:
        """``interval`` is the time from one search to the next, in seconds."""
        self.any = built.model.shape_contact_pair_count > 0
        """True if any two shapes may touch."""
        self._interval = interval
        capacity = config.contacts_per_env * num_envs
        self._pipeline = _pipeline(built.model, capacity, config.speculative_gap) if self.any else None
        self.contacts = self._pipeline.contacts() if self._pipeline else newton.Contacts(0, 0)
        """Newton's arrays of contacts."""
        self.capacity = self.contacts.rigid_contact_max
        """Number of contacts that the buffers of all environments together hold."""
        with wp.ScopedDevice(built.model.device):
            self.forces = wp.zeros(self.capacity, dtype=wp.vec3)
            """Force of each contact on its first shape, which the solver fills in, in world axes."""
            self.shapes = wp.full((2, self.capacity), -1, dtype=int)
            """Both shapes of each contact."""

    def find(self, state: newton.State) -> None:
        """Find the contacts of the state's poses."""
        if self._pipeline is not None:
            self._pipeline.collide(state, self.contacts, dt=self._interval)
            # Copied, because XPBD overwrites the first shape of each contact to give the pair its own coefficients.
            wp.copy(self.shapes[0], self.contacts.rigid_contact_shape0)
            wp.copy(self.shapes[1], self.contacts.rigid_contact_shape1)


def _pipeline(model: newton.Model, capacity: int, ahead: float) -> newton.CollisionPipeline:
    """``capacity`` contacts of all environments, or what Newton estimates where it is zero; found ``ahead`` at most."""
    return newton.CollisionPipeline(
        model,
        # The builder has listed the pairs that may touch; Newton's other broad phases would search all of them again.
        broad_phase="explicit",
        rigid_contact_max=capacity or None,
        include_static_kinematic_pairs=False,
        verify_buffers=False,
        speculative_contact_gap_max=ahead,
    )


@wp.kernel(enable_backward=False)
def _add_contact_forces(
    queries: Queries,
    count: wp.array[int],
    shapes: wp.array2d[int],
    contact_forces: wp.array[wp.vec3],
    forces: wp.array2d[wp.vec3],
):
    contact = wp.tid()
    if contact >= count[0]:
        return
    per_env = queries.link_of_shape.shape[0]
    first, second = shapes[0, contact], shapes[1, contact]
    add_force(queries, first / per_env, first % per_env, second % per_env, contact_forces[contact], forces)


class ContactMeter(ForceMeter):
    """Takes the forces of Newton's contacts."""

    def __init__(self, layout: SceneLayout, built: BuiltModel, num_envs: int, finder: ContactFinder) -> None:
        super().__init__(layout, built.link_of_shape, num_envs, built.model.device)
        self._finder = finder
        self.needed = self.queries > 0 and finder.any
        """False without queries or contacts: forces are then not computed."""

    def add(self) -> None:
        """Launch what takes in the forces of a solver step."""
        if not self.needed:
            return
        finder = self._finder
        wp.launch(
            _add_contact_forces,
            dim=finder.capacity,
            inputs=[self._queries, finder.contacts.rigid_contact_count, finder.shapes, finder.forces],
            outputs=[self.forces],
        )
