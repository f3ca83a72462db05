"""The deformables of N environments as particles in Warp, with tensors as their memory."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED, Approximation, SceneLayout
from orbit_core.interfaces.matter import PARAMETERS, Matter
from orbit_core.plugin_kit.rows import take_rows, write_columns, write_rows
from orbit_core.scene import Attachment
from orbit_matter import contact, kernels, self_contact, substeps
from orbit_matter.colliders import Colliders
from orbit_matter.config import MatterConfig
from orbit_matter.model import Constraints, build
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.start import start

_FREE, _WORLD = -2, -1
_MARGIN = 0.004
"""Metres that two particles may come nearer in a physics step and still be found."""


@dataclass(frozen=True)
class MatterState:
    """Everything that the continuation depends on, by name."""

    tensors: dict[str, Tensor]


class ParticleMatter(Matter):
    """Advances all environments by recorded launches; the tensors it hands out are views of its buffers."""

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: MatterConfig) -> None:
        start()
        self._layout, self._num_envs, self._device, self._config = layout, num_envs, device, config
        self._model = build(layout.scene)
        longest = substeps.chosen(layout.scene) if config.substep is None else config.substep
        self._substeps = max(1, math.ceil(layout.scene.physics_dt / longest - 1e-6))
        self._h = layout.scene.physics_dt / self._substeps
        self._graphs = Graphs(device, config.capture)
        self._colliders = Colliders(layout, self._graphs.device)
        self._tensors: dict[str, Tensor] = {}
        """State and parameters; snapshots hold them."""
        self._make_state()
        self._make_structs()

    # Memory ----------------------------------------------------------------------------------------------------------

    def _make_state(self) -> None:
        n, p, model = self._num_envs, len(self._model.rest), self._model
        scene, links = self._layout.scene, len(self._layout.links)
        make = {"dtype": torch.float32, "device": self._device}
        rest = torch.as_tensor(model.rest, **make)
        frictions = torch.tensor([spec.friction for spec in scene.deformables], **make)  # pyright: ignore[reportAttributeAccessIssue]
        parameters = torch.ones(n, len(scene.deformables), len(PARAMETERS), **make)
        parameters[..., PARAMETERS.index("friction")] = frictions
        kinds = torch.arange(n) % self._colliders.kinds
        self._rest = rest
        self._tensors = {
            "x": rest.repeat(n, 1, 1),
            "v": torch.zeros(n, p, 3, **make),
            "anchor": torch.full((n, p), _FREE, dtype=torch.int32, device=self._device),
            "place": torch.zeros(n, p, 3, **make),
            "parameters": parameters,
            "gravity": torch.tensor(scene.gravity, **make).repeat(n, 1),
            "friction": torch.as_tensor(self._colliders.friction, **make)[kinds].contiguous(),
            "forces": torch.zeros(n, len(scene.deformables), links, 3, **make),
            "torques": torch.zeros(n, links, 3, **make),
        }
        self._start = torch.zeros(n, max(links, 1), 7, **make)
        self._end = torch.zeros(n, max(links, 1), 7, **make)
        self._wrenches = torch.zeros(n, links, 6, **make)
        self._shape_links = torch.as_tensor(self._colliders.links, device=self._device)[kinds]
        """(N, S)"""
        for index, spec in enumerate(scene.deformables):
            for attachment in spec.attachments:
                self._attach(index, attachment)

    def _attach(self, deformable: int, attachment: Attachment) -> None:
        link = _WORLD
        if attachment.entity is not None and attachment.link is not None:
            entity = self._layout.entity(attachment.entity)
            link = entity.links.start + entity.spec.articulation.link_names.index(attachment.link)
        first = self._model.slices[deformable].start
        self._tensors["anchor"][:, [first + particle for particle in attachment.particles]] = link

    def _make_structs(self) -> None:
        model, t = self._model, self._tensors
        n, p, s = self._num_envs, len(model.rest), self._colliders.count
        links = self._start.shape[1]
        with wp.ScopedDevice(self._graphs.device):
            particles = self._particles = kernels.Particles()
            particles.x, particles.v = wp.from_torch(t["x"], wp.vec3), wp.from_torch(t["v"], wp.vec3)
            particles.d = wp.zeros((n, p), dtype=wp.vec3)
            particles.anchor, particles.place = wp.from_torch(t["anchor"]), wp.from_torch(t["place"], wp.vec3)
            particles.mass, particles.radius = wp.array(model.masses), wp.array(model.radii)
            particles.damping, particles.owner = wp.array(model.damping), wp.array(model.owners, dtype=int)
            particles.parameters = wp.from_torch(t["parameters"])
            self._gravity = wp.from_torch(t["gravity"], wp.vec3)
            moved = self._links = kernels.Links()
            moved.start, moved.end = wp.from_torch(self._start), wp.from_torch(self._end)
            moved.link = wp.zeros((n, links + 1), dtype=wp.transform)
            moved.shape = wp.zeros((n, s), dtype=wp.transform)
            moved.shape_before = wp.zeros((n, s), dtype=wp.transform)
            felt = self._felt = contact.Felt()
            felt.forces = wp.from_torch(t["forces"], wp.vec3)
            felt.torques = wp.from_torch(t["torques"], wp.vec3)
            felt.friction = wp.from_torch(t["friction"])
            felt.near = wp.full((n, p, int(contact.NEAREST)), -1, dtype=int)
            edges = self._edges = _struct(kernels.Edges(), model.edges)
            edges.ranges = wp.array(np.array(model.edges.ranges, np.int32).reshape(-1, 2), dtype=int, ndim=2)
            edges.upper = wp.zeros((n, len(model.edges.particles)), dtype=float)
            edges.value = wp.zeros((n, len(model.edges.particles)), dtype=float)
            self._neighbours = self._make_neighbours() if self._meets else None
            self._constraints = (
                (model.triangles, _struct(kernels.Triangles(), model.triangles), kernels.solve_triangles),
                (model.bends, _struct(kernels.Bends(), model.bends), kernels.solve_bends),
            )

    @property
    def _meets(self) -> bool:
        """Whether any two particles may touch."""
        return bool(self._model.touches.any()) or len(self._model.slices) > 1

    def _make_neighbours(self) -> Any:
        n, p, model = self._num_envs, len(self._model.rest), self._model
        made = self_contact.Neighbours()
        made.head = wp.zeros((n, 1 << (2 * p - 1).bit_length()), dtype=int)
        made.following = wp.zeros((n, p), dtype=int)
        made.found = wp.full((n, p, int(self_contact.NEIGHBOURS)), -1, dtype=int)
        made.rest, made.radius = wp.array(model.rest, dtype=wp.vec3), wp.array(model.own_radii)
        made.touches = wp.array(model.touches, dtype=int)
        made.moves = wp.zeros((n, p), dtype=wp.vec3)
        made.cell = 2.0 * float(model.own_radii.max()) + _MARGIN
        return made

    # Time ------------------------------------------------------------------------------------------------------------

    def step(self, before: Tensor, after: Tensor) -> None:
        links = before.shape[1]
        self._start[:, :links].copy_(before)
        self._end[:, :links].copy_(after)
        self._graphs.run("step", self._launch_step)
        self._wrenches[..., :3] = self._tensors["forces"].sum(1)
        self._wrenches[..., 3:] = self._tensors["torques"]

    def _launch_step(self) -> None:
        self._felt.forces.zero_()
        self._felt.torques.zero_()
        n, s, links, p = self._num_envs, self._colliders.count, self._start.shape[1], len(self._model.rest)
        for share, first in ((0.0, 1), (1.0, 0)):
            wp.launch(kernels.place_links, (n, links + 1), inputs=[self._links, links, share])
            wp.launch(kernels.place_shapes, (n, s), inputs=[self._links, self._colliders.shapes, first])
        near = [self._particles, self._links, self._colliders.shapes, self._felt, self._layout.scene.physics_dt]
        wp.launch(contact.find_near, (n, p), inputs=near)
        wp.launch(kernels.place_links, (n, links + 1), inputs=[self._links, links, 0.0])
        wp.launch(kernels.place_shapes, (n, s), inputs=[self._links, self._colliders.shapes, 1])
        if self._neighbours is not None:
            self._launch_search(self._neighbours)
        for number in range(self._substeps):
            self._launch_substep((number + 1) / self._substeps)

    def _launch_search(self, near: Any) -> None:
        n, p = self._num_envs, len(self._model.rest)
        wp.launch(self_contact.clear, near.head.shape, inputs=[near])
        wp.launch(self_contact.insert, (n, p), inputs=[self._particles, near])
        wp.launch(self_contact.find, (n, p), inputs=[self._particles, near, _MARGIN])

    def _launch_substep(self, share: float) -> None:
        n, p, links, h = self._num_envs, len(self._model.rest), self._start.shape[1], self._h
        wp.launch(kernels.place_links, (n, links + 1), inputs=[self._links, links, share])
        shapes = [self._links, self._colliders.shapes, 0]
        wp.launch(kernels.place_shapes, (n, self._colliders.count), inputs=shapes)
        wp.launch(kernels.predict, (n, p), inputs=[self._particles, self._links, self._gravity, h])
        for constraints, struct, solve in self._constraints:
            for first, stop in constraints.ranges:
                wp.launch(solve, (n, stop - first), inputs=[self._particles, struct, first, h])
        if ropes := len(self._model.edges.ranges):  # last, so that nothing makes them longer again
            wp.launch(kernels.solve_edges, (n, ropes), inputs=[self._particles, self._edges, h])
        if self._neighbours is not None:
            wp.launch(self_contact.separate, (n, p), inputs=[self._particles, self._neighbours, h])
            wp.launch(self_contact.move, (n, p), inputs=[self._particles, self._neighbours])
        contacts = [self._particles, self._links, self._colliders.shapes, self._felt, self._gravity]
        numbers = [self._config.contact_stiffness, h, 1.0 / self._substeps]
        wp.launch(contact.finish, (n, p), inputs=[*contacts, *numbers])

    # State -----------------------------------------------------------------------------------------------------------

    def positions(self, deformable: int) -> Tensor:
        return self._tensors["x"][:, self._model.slices[deformable]]

    def velocities(self, deformable: int) -> Tensor:
        return self._tensors["v"][:, self._model.slices[deformable]]

    def write(self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None) -> None:
        columns = self._model.slices[deformable]
        write_rows(self._tensors["x"][:, columns], positions, env_ids)
        write_rows(self._tensors["v"][:, columns], velocities, env_ids)

    def anchor(
        self, deformable: int, particles: Tensor, link: int | None, link_poses: Tensor, env_ids: Tensor | None = None
    ) -> None:
        columns = self._model.slices[deformable].start + particles
        self._set_anchors(columns, _WORLD if link is None else link, env_ids)
        self._hold(link_poses, env_ids)

    def release(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        self._set_anchors(self._model.slices[deformable].start + particles, _FREE, env_ids)

    def _set_anchors(self, columns: Tensor, link: int, env_ids: Tensor | None) -> None:
        shape = (len(take_rows(self._tensors["anchor"], env_ids)), len(columns))
        links = torch.full(shape, link, dtype=torch.int32, device=self._device)
        write_columns(self._tensors["anchor"], columns, links, env_ids)

    def _hold(self, link_poses: Tensor, env_ids: Tensor | None) -> None:
        """What is held is from now on held where it is."""
        chosen = torch.zeros(self._num_envs, dtype=torch.bool, device=self._device)
        write_rows(chosen, True, env_ids)
        self._end[:, : link_poses.shape[1]].copy_(link_poses)
        shape = (self._num_envs, len(self._model.rest))
        with self._graphs.stream():
            wp.launch(kernels.hold, shape, inputs=[self._particles, self._links, wp.from_torch(chosen)])

    def reset(self, link_poses: Tensor, env_ids: Tensor | None = None) -> None:
        rest = self._rest.expand(self._num_envs, -1, -1)
        write_rows(self._tensors["x"], take_rows(rest, env_ids), env_ids)
        write_rows(self._tensors["v"], torch.zeros_like(take_rows(rest, env_ids)), env_ids)
        self._hold(link_poses, env_ids)
        for name in ("forces", "torques"):
            write_rows(self._tensors[name], torch.zeros_like(take_rows(self._tensors[name], env_ids)), env_ids)
        write_rows(self._wrenches, torch.zeros_like(take_rows(self._wrenches, env_ids)), env_ids)

    # Parameters ------------------------------------------------------------------------------------------------------

    def set_parameter(self, deformable: int, name: str, values: Tensor, env_ids: Tensor | None = None) -> None:
        write_rows(self._tensors["parameters"][:, deformable, PARAMETERS.index(name)], values, env_ids)

    def set_gravity(self, gravity: Tensor, env_ids: Tensor | None = None) -> None:
        write_rows(self._tensors["gravity"], gravity, env_ids)

    def set_friction(self, links: Tensor, coefficients: Tensor, env_ids: Tensor | None = None) -> None:
        target = self._tensors["friction"]
        of = take_rows(self._shape_links, env_ids)
        changed = take_rows(target, env_ids).clone()
        for number in range(len(links)):
            changed = torch.where(of == links[number], coefficients[:, number : number + 1], changed)
        write_rows(target, changed, env_ids)

    # Measurements and snapshots --------------------------------------------------------------------------------------

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        return substeps.report(self._layout.scene, self._h)

    @property
    def wrenches(self) -> Tensor:
        return self._wrenches

    @property
    def contact_forces(self) -> Tensor:
        return self._tensors["forces"]

    def diverged(self) -> Tensor:
        # A comparison with NaN is false, so what is not within the bounds is found, whatever it is.
        near = (self._tensors["x"].abs() <= MAX_DISTANCE).all(-1)
        slow = (self._tensors["v"].abs() <= MAX_SPEED).all(-1)
        sound = near & slow
        return torch.stack([~sound[:, columns].all(1) for columns in self._model.slices], dim=1)

    def save_state(self) -> MatterState:
        saved = {name: tensor.clone() for name, tensor in self._tensors.items()}
        return MatterState({**saved, "wrenches": self._wrenches.clone()})

    def load_state(self, state: MatterState) -> None:
        for name, tensor in self._tensors.items():
            tensor.copy_(state.tensors[name])
        self._wrenches.copy_(state.tensors["wrenches"])


def _struct(made: Any, constraints: Constraints) -> Any:
    made.particles = wp.array(constraints.particles, dtype=int, ndim=2)
    made.weights = wp.array(constraints.weights, dtype=float, ndim=2)
    made.owner = wp.array(constraints.owners, dtype=int)
    return made
