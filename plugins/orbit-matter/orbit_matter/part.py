"""Some environments of a world's matter: their memory as kernels take it, and the launches of one physics step."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from torch import Tensor

from orbit_matter import attached, bodies, contact, kernels, rows, self_contact
from orbit_matter.colliders import Colliders
from orbit_matter.fluid.fluids import Fluids
from orbit_matter.fluid.part import FluidPart
from orbit_matter.model import Constraints, Model
from orbit_matter.solids.part import SolidPart
from orbit_matter.solids.solids import Solids

MARGIN = 0.004
"""Metres that two particles may come nearer before pairs are searched again."""


@dataclass(frozen=True)
class Stepping:
    """Division of a physics step into substeps, sweeps and steps of solids."""

    physics_dt: float
    """Seconds."""
    substeps: int
    """Number of substeps in a physics step."""
    sweeps: int
    """Over the triangles of cloth in each."""
    contact_stiffness: float
    """N/m of one particle."""
    solid_steps: int
    """Of solids in a physics step; substeps are a multiple of it."""
    solid_iterations: int
    """Of conjugate gradients in each."""

    @property
    def h(self) -> float:
        """Seconds of a substep."""
        return self.physics_dt / self.substeps


class Part:
    """Environments in a row, whose launches touch no others.

    Args:
        rows: of the tensors in ``memory``, by name, which are theirs.
        memory: of all environments, viewed and not copied.
        model: of every environment.
        colliders: what they meet; ``rows`` begin with the first kind of environment.
        stepping: how long a substep is.
        solids: of every environment.
        fluids: of every environment.
        maps: of what hollow shapes give liquids; None without liquids.
    """

    def __init__(
        self,
        rows: slice,
        memory: Mapping[str, Tensor],
        model: Model,
        colliders: Colliders,
        stepping: Stepping,
        solids: Solids,
        fluids: Fluids,
        maps: Any,
    ) -> None:
        self._rows, memory = rows, {name: tensor[rows] for name, tensor in memory.items()}
        self._model, self._colliders, self._stepping = model, colliders, stepping
        self._n, self._p = len(memory["x"]), len(model.rest)
        self._count, self._free = memory["start"].shape[1], memory["mass"].shape[1]
        self._particles = self._make_particles(memory)
        self._gravity = wp.from_torch(memory["gravity"], wp.vec3)
        self._links = self._make_links(memory)
        self._wet_links = self._make_wet_links()
        felt = self._felt = contact.Felt()
        felt.forces, felt.torques = wp.from_torch(memory["forces"], wp.vec3), wp.from_torch(memory["torques"], wp.vec3)
        felt.friction = wp.from_torch(memory["friction"])
        felt.holds = wp.zeros((self._n, len(model.slices), self._count), dtype=int)
        # Solids and liquids have a list of near shapes each, for points of their own, and share the forces.
        felt.near = wp.full((self._n, self._p, int(contact.NEAREST)), -1, dtype=int)
        self._bodies, self._attached = self._make_bodies(memory), self._make_attached(memory)
        self._edges = self._make_edges()
        self._neighbours = self._make_neighbours(memory) if model.meets else None
        self._triangles = _struct(kernels.Triangles(), model.triangles)
        self._triangles.multiplier = wp.zeros((self._n, len(model.triangles.particles)), dtype=wp.vec3)
        self._bends = _struct(kernels.Bends(), model.bends)
        self._solids = self._make_solids(memory, solids)
        self._fluid = None if fluids.model is None else FluidPart(memory, fluids.model, felt, maps)

    def _make_solids(self, memory: Mapping[str, Tensor], solids: Solids) -> SolidPart | None:
        if not solids.model.deformables:
            return None
        damping = np.array(solids.damping, np.float32)
        iterations = self._stepping.solid_iterations
        return SolidPart(memory, solids.model, self._felt, self._bodies, damping, solids.h, iterations)

    def _make_particles(self, memory: Mapping[str, Tensor]) -> Any:
        made, model, shape = kernels.Particles(), self._model, (self._n, self._p)
        made.x, made.v = wp.from_torch(memory["x"], wp.vec3), wp.from_torch(memory["v"], wp.vec3)
        made.d, made.w = wp.zeros(shape, dtype=wp.vec3), wp.zeros(shape, dtype=float)
        made.anchor, made.place = wp.from_torch(memory["anchor"]), wp.from_torch(memory["place"], wp.vec3)
        made.exempt = wp.from_torch(memory["exempt"])
        made.solved = wp.zeros(shape, dtype=int)
        ropes = (self._model.mates >= 0).any(1)
        made.held = wp.array(np.where(ropes, float(kernels.HELD) ** 2, float(kernels.HELD)), dtype=float)
        made.mass, made.radius = wp.array(model.masses), wp.array(model.radii)
        # Exact for any damping; ``1 - h damping`` would turn velocities round where damping is strong.
        made.kept = wp.array(np.exp(-self._stepping.h * model.damping))
        made.owner = wp.array(model.owners, dtype=int)
        made.parameters = wp.from_torch(memory["parameters"])
        return made

    def _make_links(self, memory: Mapping[str, Tensor]) -> Any:
        made, shapes = kernels.Links(), (self._n, self._colliders.count)
        made.start, made.end = wp.from_torch(memory["start"]), wp.from_torch(memory["end"])
        made.link = wp.zeros((self._n, self._count + 1), dtype=wp.transform)
        made.shape, made.shape_before = wp.zeros(shapes, dtype=wp.transform), wp.zeros(shapes, dtype=wp.transform)
        made.reach = wp.zeros(shapes, dtype=float)
        made.axes, made.way = wp.zeros(shapes, dtype=wp.mat33), wp.zeros(shapes, dtype=wp.vec3)
        made.turn = wp.zeros(shapes, dtype=wp.quat)
        return made

    def _make_wet_links(self) -> Any:
        """Return the links as liquids meet them, which differ in the reach of shapes alone."""
        if self._colliders.wet is self._colliders.shapes:
            return self._links
        made, own = kernels.Links(), self._links
        made.start, made.end, made.link, made.shape = own.start, own.end, own.link, own.shape
        made.shape_before, made.axes, made.way, made.turn = own.shape_before, own.axes, own.way, own.turn
        made.reach = wp.zeros_like(own.reach)
        return made

    def _make_bodies(self, memory: Mapping[str, Tensor]) -> Any:
        made, shape = bodies.Bodies(), memory["mass"].shape
        made.link = wp.from_torch(memory["free"])
        made.mass, made.center = wp.from_torch(memory["mass"]), wp.from_torch(memory["center"], wp.vec3)
        made.inertia, made.turning = wp.from_torch(memory["inertia"], wp.mat33), wp.zeros(shape, dtype=wp.mat33)
        for name in ("before", "after", "wrenches"):
            setattr(made, name, wp.from_torch(memory[name]))
        for name in ("pull", "twist", "shift", "turned"):
            setattr(made, name, wp.zeros(shape, dtype=wp.vec3))
        made.lags = wp.zeros(shape, dtype=int)
        return made

    def _make_attached(self, memory: Mapping[str, Tensor]) -> Any:
        made, shape = attached.Attached(), memory["mass"].shape
        made.body, made.mates = wp.array(self._body_of(memory), dtype=int), wp.array(self._model.mates, dtype=int)
        made.following = wp.zeros((self._n, self._p), dtype=int)
        made.asked, made.given = wp.from_torch(memory["asked"]), wp.from_torch(memory["given"])
        made.known, made.seen = wp.from_torch(memory["known"]), wp.from_torch(memory["seen"])
        made.x, made.q = wp.from_torch(memory["body_x"], wp.vec3), wp.from_torch(memory["body_q"], wp.quat)
        made.v, made.w = wp.from_torch(memory["body_v"], wp.vec3), wp.from_torch(memory["body_w"], wp.vec3)
        names = {int: "first count", float: "held mobility", wp.mat33: "inertia turning"}
        motion = "pull twist had_pull had_twist odd_pull odd_twist begin_v begin_w drift spin"
        names[wp.vec3] = f"{motion} force torque felt_force felt_torque"
        for kind, row in names.items():
            for name in row.split():
                setattr(made, name, wp.zeros(shape, dtype=kind))
        return made

    def _body_of(self, memory: Mapping[str, Tensor]) -> np.ndarray:
        """(L,) index of the free body that each link is, or -1."""
        # Kernels take no empty arrays, even where a scene has no links.
        found = np.full(max(self._count, 1), -1, np.int32)
        found[memory["free"][0].cpu().numpy()] = np.arange(self._free)
        return found

    def _make_edges(self) -> Any:
        made, edges = _struct(kernels.Edges(), self._model.edges), self._model.edges
        made.ranges = wp.array(np.array(edges.ranges, np.int32).reshape(-1, 2), dtype=int, ndim=2)
        made.upper = wp.zeros((self._n, len(edges.particles)), dtype=float)
        made.value = wp.zeros((self._n, len(edges.particles)), dtype=float)
        made.total = wp.zeros((self._n, len(edges.particles)), dtype=float)
        made.spread = wp.zeros((self._n, self._p), dtype=float)
        made.moved = wp.zeros((self._n, self._p), dtype=wp.vec3)
        return made

    def _make_neighbours(self, memory: Mapping[str, Tensor]) -> Any:
        n, p, model = self._n, self._p, self._model
        made = self_contact.Neighbours()
        # A power of two, so that the hash is a mask, and at least twice the particles, so that few share a bucket.
        made.head = wp.zeros((n, 1 << (2 * p - 1).bit_length()), dtype=int)
        made.following = wp.zeros((n, p), dtype=int)
        made.found = wp.full((n, p, int(self_contact.NEIGHBOURS)), -1, dtype=int)
        made.searched, made.stale = wp.from_torch(memory["searched"], wp.vec3), wp.zeros(n, dtype=int)
        made.rest, made.radius = wp.array(model.rest, dtype=wp.vec3), wp.array(model.own_radii)
        made.touches = wp.array(model.touches, dtype=int)
        made.moves = wp.zeros((n, p), dtype=wp.vec3)
        made.cell = 2.0 * float(model.own_radii.max()) + MARGIN
        return made

    @property
    def takes_rows(self) -> bool:
        """True if one launch thread takes an environment, and not a particle or a constraint."""
        return bool(self._particles.x.device.is_cpu)

    def hold(self, chosen: Tensor) -> None:
        """Fix held particles to where they are now, in chosen environments of all (N,) bool."""
        mine, shape = wp.from_torch(chosen[self._rows]), (self._n, self._p)
        wp.launch(kernels.hold, shape, inputs=[self._particles, self._links, mine])
        wp.launch(contact.find_holders, (self._n, len(self._model.slices)), inputs=[self._particles, self._felt, mine])
        inputs = [self._particles, self._links, self._colliders.shapes, self._felt, mine]
        wp.launch(contact.exempt_inside, shape, inputs=inputs)
        if self._solids is not None:
            self._solids.hold(self._links, self._colliders.shapes, mine)

    def depths(self, farthest: float) -> np.ndarray | None:
        """Return how deep (m) each deformable that is a solid is in each shape, (D, S); None without solids."""
        if self._solids is None:
            return None
        return self._solids.depths(self._links, self._colliders.shapes, farthest)

    def orient(self, number: int, chosen: Tensor) -> None:
        """Find the rotations of a solid from scratch in chosen environments, of all (N,) bool."""
        if self._solids is not None:
            self._solids.orient(number, wp.from_torch(chosen[self._rows]))

    def liquid_inside(self) -> np.ndarray:
        """Return the (n, P) shape that each particle of liquid is inside of; -1 for none."""
        if self._fluid is None:
            return np.zeros((self._n, 0), np.int32)
        self._place(1.0, 1)
        # Height fields as they are: all that is below one is inside of it, however deep.
        return self._fluid.shapes_inside(self._links, self._colliders.shapes)

    def search_again(self) -> None:
        """Find the pairs that the last search found, from where particles then were."""
        if self._fluid is not None:
            self._fluid.search_again()
        if self._neighbours is not None:
            self._neighbours.stale.fill_(1)
            self._launch_search(self._neighbours, renewed=0)

    def launch_step(self) -> None:
        """Advance by one physics step."""
        if self._free:
            dt, links = self._stepping.physics_dt, self._links
            wp.launch(attached.find_attached, self._n, inputs=[self._particles, self._attached])
            inputs = [self._attached, self._bodies, links, self._particles, self._gravity, dt]
            wp.launch(attached.begin, (self._n, self._free), inputs=inputs)
            liquids = int(self._fluid is not None)
            inputs = [self._bodies, self._attached.count, links, self._gravity, dt, self._stepping.h, liquids]
            wp.launch(bodies.look_ahead, (self._n, self._free), inputs=inputs)
        # Forces gather over the substeps of one physics step.
        self._felt.forces.zero_()
        self._felt.torques.zero_()
        wp.launch(kernels.weigh, (self._n, self._p), inputs=[self._particles])
        self._place(0.0, 1)
        # Both ends of the whole step once: the difference bounds how far each shape moves while near pairs hold.
        self._place(1.0, 0)
        wp.launch(contact.bound, (self._n, self._colliders.count), inputs=[self._links, self._colliders.shapes])
        near = [self._particles, self._links, self._colliders.shapes, self._felt, self._stepping.physics_dt]
        if self._solids is not None:
            dt = self._stepping.physics_dt
            self._solids.launch_near(self._links, self._colliders.shapes, self._gravity, dt)
        if self._fluid is not None:
            links, wet = self._wet_links, self._colliders.wet
            if links is not self._links:
                wp.launch(contact.bound, (self._n, self._colliders.count), inputs=[links, wet])
            self._fluid.launch_near(links, wet, self._stepping.physics_dt)
        if self.takes_rows and self._p:
            wp.launch(rows.find_near, self._n, inputs=near)
        else:
            wp.launch(contact.find_near, (self._n, self._p), inputs=near)
        self._place(0.0, 1)
        if self._neighbours is not None:
            self._neighbours.stale.zero_()
            doubted = [self._particles, self._neighbours, MARGIN, self._stepping.physics_dt]
            wp.launch(self_contact.doubt, (self._n, self._p), inputs=doubted)
            self._launch_search(self._neighbours, renewed=1)
        for number in range(self._stepping.substeps):
            self._launch_substep(number + 1)
        if self._free:
            inputs = [self._attached, self._bodies, self._felt, self._gravity, self._stepping.physics_dt]
            wp.launch(attached.conclude, (self._n, self._free), inputs=inputs)

    def _place(self, share: float, first: int, moving: bool = False, pushed: bool = False) -> None:
        """Put links and shapes where they are after a share of the step, the first time or again.

        Free bodies respond to what they felt, where they are ``moving``; where they are ``pushed``, to solids as well,
        which are taken to do what they did last.
        """
        wp.launch(kernels.place_links, (self._n, self._count + 1), inputs=[self._links, self._count, share])
        if self._free and moving:
            dt, h, shape = self._stepping.physics_dt, self._stepping.h, (self._n, self._free)
            stage = 0 if self._fluid is None else 1
            inputs = [self._bodies, self._attached.count, self._links, self._felt, dt, share, h, stage]
            wp.launch(bodies.respond, shape, inputs=inputs)
            inputs = [self._attached, self._bodies, self._links, self._particles, self._felt, dt, h]
            wp.launch(attached.predict, shape, inputs=inputs)
            if pushed and self._solids is not None:
                self._solids.launch_push(self._links, lasting=False)
        shapes = [self._links, self._colliders.shapes, first]
        wp.launch(kernels.place_shapes, (self._n, self._colliders.count), inputs=shapes)

    def _launch_search(self, near: Any, renewed: int) -> None:
        shape = (self._n, self._p)
        wp.launch(self_contact.clear, near.head.shape, inputs=[near])
        wp.launch(self_contact.insert, shape, inputs=[self._particles, near, renewed])
        wp.launch(self_contact.find, shape, inputs=[self._particles, near, MARGIN])

    def _launch_substep(self, number: int) -> None:
        steps = self._stepping.solid_steps
        # Solids step less often than particles: their implicit step stays stable and costs more.
        due = number * steps % self._stepping.substeps == 0
        self._place(number / self._stepping.substeps, 0, moving=True, pushed=due)
        if self._solids is not None and due:
            self._solids.launch_step(self._links, self._colliders.shapes, self._gravity, 1.0 / steps)
            if self._free:
                self._solids.launch_push(self._links, lasting=True)
        if self._fluid is not None:
            self._launch_fluid(self._fluid, number)
        if not self._p:
            return
        contacts = [self._particles, self._links, self._colliders.shapes, self._felt, self._gravity]
        numbers = [self._stepping.contact_stiffness, self._stepping.h, 1.0 / self._stepping.substeps]
        if self.takes_rows:
            self._launch_rows([*contacts, *numbers])
        else:
            self._launch_wide([*contacts, *numbers])
        if self._solids is not None:
            stiffness, h = self._stepping.contact_stiffness, self._stepping.h
            self._solids.launch_lay(self._particles, stiffness, h, steps / self._stepping.substeps)

    def _launch_fluid(self, fluid: FluidPart, number: int) -> None:
        """Launch a substep of liquids, the first of which has the number 1."""
        links, shapes = self._wet_links, self._colliders.wet
        h, share = self._stepping.h, 1.0 / self._stepping.substeps
        fluid.launch_push(links, shapes, self._gravity, h, share, first=number == 1)
        if self._free:
            dt = self._stepping.physics_dt
            inputs = [self._bodies, self._attached.count, self._links, self._felt, dt, number * share, h, 2]
            wp.launch(bodies.respond, (self._n, self._free), inputs=inputs)
            wp.launch(kernels.place_shapes, (self._n, self._colliders.count), inputs=[self._links, shapes, 2])
        fluid.launch_flow(links, shapes, self._gravity, h, share)

    def _launch_rows(self, contacts: list[Any]) -> None:
        """The rest of a substep, one launch thread for each environment."""
        n, h = self._n, self._stepping.h
        wp.launch(rows.predict, n, inputs=[self._particles, self._links, self._gravity, h])
        if self._model.triangles.ranges:
            inputs = [self._particles, self._triangles, h, self._stepping.sweeps]
            wp.launch(rows.solve_triangles, n, inputs=inputs)
        if self._model.bends.ranges:
            wp.launch(rows.solve_bends, n, inputs=[self._particles, self._bends, h])
        if self._neighbours is not None:
            wp.launch(rows.separate, n, inputs=[self._particles, self._neighbours, h])
        self._launch_edges()
        self._launch_correction()
        wp.launch(rows.finish, n, inputs=contacts)

    def _launch_wide(self, contacts: list[Any]) -> None:
        """The rest of a substep, one launch thread for each particle, and for each constraint of a colour."""
        n, shape, h = self._n, (self._n, self._p), self._stepping.h
        wp.launch(kernels.predict, shape, inputs=[self._particles, self._links, self._gravity, h])
        for sweep in range(self._stepping.sweeps):
            for first, stop in self._model.triangles.ranges:
                inputs = [self._particles, self._triangles, first, h, sweep, self._stepping.sweeps]
                wp.launch(kernels.solve_triangles, (n, stop - first), inputs=inputs)
        for first, stop in self._model.bends.ranges:
            wp.launch(kernels.solve_bends, (n, stop - first), inputs=[self._particles, self._bends, first, h])
        if self._neighbours is not None:
            wp.launch(self_contact.separate, shape, inputs=[self._particles, self._neighbours, h])
            wp.launch(self_contact.move, shape, inputs=[self._particles, self._neighbours])
        self._launch_edges()
        self._launch_correction()
        wp.launch(contact.finish, shape, inputs=contacts)

    def _launch_edges(self) -> None:
        """Solve for ropes last, so that nothing makes them longer again, whose stretch would be energy from nowhere."""
        if ropes := len(self._model.edges.ranges):
            inputs = [self._particles, self._edges, self._stepping.h]
            wp.launch(kernels.solve_edges, (self._n, ropes), inputs=inputs)

    def _launch_correction(self) -> None:
        """Move free bodies by what is attached to them."""
        if self._free:
            bodies_and_matter = [self._attached, self._bodies, self._links, self._particles, self._felt]
            inputs = [*bodies_and_matter, self._gravity, self._stepping.h, 1.0 / self._stepping.substeps]
            wp.launch(attached.correct, (self._n, self._free), inputs=inputs)


def _struct(made: Any, constraints: Constraints) -> Any:
    made.particles = wp.array(constraints.particles, dtype=int, ndim=2)
    made.weights = wp.array(constraints.weights, dtype=float, ndim=2)
    made.owner = wp.array(constraints.owners, dtype=int)
    return made
