"""The deformables of N environments as particles and solids in Warp, with tensors as their memory."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
import warp as wp
from torch import Tensor

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED, TERRAIN, Approximation, ConfigurationError, SceneLayout
from orbit_core.interfaces.matter import PARAMETERS, Matter
from orbit_core.plugin_kit.rows import take_rows, write_columns, write_rows
from orbit_core.scene import Attachment
from orbit_matter import attached, bodies, contact, kernels, rows, self_contact, stability, substeps
from orbit_matter.colliders import Colliders
from orbit_matter.config import MatterConfig
from orbit_matter.fluid import kernels as fluid_kernels
from orbit_matter.fluid import maps, mixing
from orbit_matter.fluid import search as fluid_search
from orbit_matter.fluid.fluids import Fluids, thickened
from orbit_matter.model import build
from orbit_matter.part import Part, Stepping
from orbit_matter.solids import blocks as solid_blocks
from orbit_matter.solids import inside as solid_inside
from orbit_matter.solids import kernels as solid_kernels
from orbit_matter.solids import launches as solid_launches
from orbit_matter.solids import limits
from orbit_matter.solids import rows as solid_rows
from orbit_matter.solids.solids import Solids
from orbit_warpkit.graphs import Graphs
from orbit_warpkit.loading import load_kernels
from orbit_warpkit.start import start

_FREE, _WORLD = -2, -1
_NOWHERE = 1e9
"""Metres; where particles of which no pairs were searched are taken to have been."""


@dataclass(frozen=True)
class MatterState:
    """Everything that the continuation depends on, by name."""

    tensors: dict[str, Tensor]
    """Copies of the state tensors, (N, ...) each."""


class ParticleMatter(Matter):
    """Advances all environments by recorded launches; the tensors it hands out are views of its buffers."""

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, config: MatterConfig) -> None:
        start()
        self._layout, self._num_envs, self._device, self._config = layout, num_envs, device, config
        stability.check(layout)
        self._model = build(layout.scene)
        longest, sweeps = substeps.chosen(layout.scene, config.substep)
        count = max(1, math.ceil(layout.scene.physics_dt / longest - 1e-6))
        solid = substeps.of_solids(layout.scene, config.substep)
        # Substeps are a multiple of the steps of solids, so that both end together.
        count = max(1, math.ceil(count / solid)) * solid if len(self._model.rest) else solid
        self._graphs = Graphs(device, config.capture)
        self._colliders = Colliders(layout, self._graphs.device)
        self._fluids = Fluids(layout.scene, num_envs, device, self._colliders.count)
        if self._fluids.model is not None:
            longest = min(self._fluids.model.longest_substep, config.substep or math.inf)
            count = max(count, math.ceil(layout.scene.physics_dt / longest / solid - 1e-6) * solid)
        self._stepping = Stepping(
            layout.scene.physics_dt, count, sweeps, config.contact_stiffness, solid, config.solid_iterations
        )
        limits.check_stiffness(layout, solid)
        limits.check_apart(layout)
        limits.check_dry(layout)
        self._solids = Solids(layout, num_envs, device, layout.scene.physics_dt / solid)
        self._begun = False
        # Kernels that loop over all particles of an environment run on CPUs only; elsewhere they cost compile time.
        by_rows = (rows,) if device.type == "cpu" else ()
        load_kernels("orbit-matter", (kernels, contact, self_contact, bodies, attached, *by_rows), self._graphs.device)
        if self._solids.model.deformables:
            steps = solid_rows if device.type == "cpu" else solid_blocks
            load_kernels("orbit-matter", (solid_inside, solid_kernels, solid_launches, steps), self._graphs.device)
        self._maps = None
        if self._fluids.model is not None:
            of_maps = (maps,) if self._colliders.surfaces else ()
            of_many = (mixing,) if len(self._fluids.model.deformables) > 1 else ()
            load_kernels("orbit-matter", (fluid_kernels, fluid_search, *of_maps, *of_many), self._graphs.device)
            self._maps = maps.build(self._colliders, self._fluids.model.spacing, self._graphs.device)
        self._tensors: dict[str, Tensor] = {}
        """State and parameters; snapshots hold them."""
        self._make_state()
        self._parts = self._make_parts(config.threads)
        self._placed = False

    # Memory ----------------------------------------------------------------------------------------------------------

    def _make_state(self) -> None:
        n, p, model = self._num_envs, len(self._model.rest), self._model
        scene, links = self._layout.scene, len(self._layout.links)
        make = {"dtype": torch.float32, "device": self._device}
        rest = torch.as_tensor(model.rest, **make)
        frictions = torch.tensor([getattr(spec, "friction", 0.0) for spec in scene.deformables], **make)
        parameters = torch.ones(n, len(scene.deformables), len(PARAMETERS), **make)
        # Scales start at 1; friction is a coefficient and no scale.
        parameters[..., PARAMETERS.index("friction")] = frictions
        kinds = torch.arange(n) % self._colliders.kinds
        mass, inertia, center = bodies.masses(self._layout)
        self._rest = rest
        self._tensors = {
            "x": rest.repeat(n, 1, 1),
            "v": torch.zeros(n, p, 3, **make),
            "anchor": torch.full((n, p), _FREE, dtype=torch.int32, device=self._device),
            "exempt": torch.full((n, p), _FREE, dtype=torch.int32, device=self._device),
            "place": torch.zeros(n, p, 3, **make),
            "parameters": parameters,
            "searched": torch.full((n, p, 3), _NOWHERE, **make),
            "gravity": torch.tensor(scene.gravity, **make).repeat(n, 1),
            "friction": torch.as_tensor(self._colliders.friction, **make)[kinds].contiguous(),
            "forces": torch.zeros(n, len(scene.deformables), links, 3, **make),
            "torques": torch.zeros(n, links, 3, **make),
            "mass": torch.as_tensor(mass, **make)[kinds].contiguous(),
            "inertia": torch.as_tensor(inertia, **make)[kinds].contiguous(),
            "center": torch.as_tensor(center, **make)[kinds].contiguous(),
            "known": torch.zeros(n, mass.shape[1], dtype=torch.int32, device=self._device),
        }
        self._tensors |= self._solids.tensors | self._fluids.tensors
        for name, width in (("seen", 13), ("given", 6), ("body_x", 3), ("body_q", 4), ("body_v", 3), ("body_w", 3)):
            self._tensors[name] = torch.zeros(n, mass.shape[1], width, **make)
        # At least one row, as kernels take no empty arrays.
        self._start = torch.zeros(n, max(links, 1), 7, **make)
        self._end = torch.zeros(n, max(links, 1), 7, **make)
        self._wrenches, self._asked = torch.zeros(n, links, 6, **make), torch.zeros(n, links, 6, **make)
        self._free = torch.tensor(bodies.free_links(self._layout), dtype=torch.int64, device=self._device)
        self._velocities = torch.zeros(2, n, len(self._free), 6, **make)
        """Of free bodies, before the engine's last step and after it."""
        self._shape_links = torch.as_tensor(self._colliders.links, device=self._device)[kinds]
        """(N, S) link of each shape."""
        for index, spec in enumerate(scene.deformables):
            for attachment in spec.attachments:
                self._attach(index, attachment)

    def _attach(self, deformable: int, attachment: Attachment) -> None:
        link = _WORLD
        if attachment.entity is not None and attachment.link is not None:
            entity = self._layout.entity(attachment.entity)
            link = entity.links.start + entity.spec.articulation.link_names.index(attachment.link)
        if self._solids.has(deformable):
            held = torch.tensor(attachment.particles, dtype=torch.int64, device=self._device)
            self._solids.set_anchors(deformable, held, link, None)
            return
        first = self._model.slices[deformable].start
        self._tensors["anchor"][:, [first + particle for particle in attachment.particles]] = link

    def _make_parts(self, threads: int) -> tuple[Part, ...]:
        """Environments in as many parts as a CPU has threads, each with whole rounds of the kinds of environments."""
        rounds = math.ceil(self._num_envs / self._colliders.kinds)
        count = 1 if self._device.type != "cpu" else min(threads or len(os.sched_getaffinity(0)), rounds)
        bounds = [min(round(rounds * k / count) * self._colliders.kinds, self._num_envs) for k in range(count + 1)]
        memory = {**self._tensors, **self._fluids.walls}
        memory |= {"start": self._start, "end": self._end, "wrenches": self._wrenches}
        memory["asked"] = self._asked
        memory["free"] = self._free.to(torch.int32).expand(self._num_envs, -1).contiguous()
        memory |= {"before": self._velocities[0], "after": self._velocities[1]}
        of_all = (self._model, self._colliders, self._stepping, self._solids, self._fluids, self._maps)
        with wp.ScopedDevice(self._graphs.device):
            return tuple(Part(slice(a, b), memory, *of_all) for a, b in pairwise(bounds))

    # Time ------------------------------------------------------------------------------------------------------------

    def step(
        self,
        before: Tensor,
        after: Tensor,
        velocities: tuple[Tensor, Tensor] | None = None,
        wrenches: Tensor | None = None,
    ) -> None:
        links = before.shape[1]
        self._start[:, :links].copy_(before)
        self._end[:, :links].copy_(after)
        if velocities is not None:
            torch.index_select(velocities[0], 1, self._free, out=self._velocities[0])
            torch.index_select(velocities[1], 1, self._free, out=self._velocities[1])
        if wrenches is not None:
            self._asked.copy_(wrenches)
        self._graphs.run_side_by_side({("step", n): part.launch_step for n, part in enumerate(self._parts)})
        self._wrenches[..., :3] = self._tensors["forces"].sum(1)
        self._wrenches[..., 3:] = self._tensors["torques"]
        if len(self._free):
            self._wrenches.index_copy_(1, self._free, self._tensors["given"])

    # State -----------------------------------------------------------------------------------------------------------

    def positions(self, deformable: int) -> Tensor:
        if self._solids.has(deformable):
            return self._solids.positions(deformable)
        if self._fluids.has(deformable):
            return self._fluids.positions(deformable)
        return self._tensors["x"][:, self._model.slices[deformable]]

    def velocities(self, deformable: int) -> Tensor:
        if self._solids.has(deformable):
            return self._solids.velocities(deformable)
        if self._fluids.has(deformable):
            return self._fluids.velocities(deformable)
        return self._tensors["v"][:, self._model.slices[deformable]]

    def write(self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None = None) -> None:
        if self._solids.has(deformable):
            self._solids.write(deformable, positions, velocities, env_ids)
            self._orient(deformable, env_ids)
            return
        if self._fluids.has(deformable):
            self._fluids.write(deformable, positions, velocities, env_ids)
            return
        columns = self._model.slices[deformable]
        write_rows(self._tensors["x"][:, columns], positions, env_ids)
        write_rows(self._tensors["v"][:, columns], velocities, env_ids)
        write_rows(self._tensors["searched"], _NOWHERE, env_ids)

    def anchor(
        self, deformable: int, particles: Tensor, link: int | None, link_poses: Tensor, env_ids: Tensor | None = None
    ) -> None:
        self._set_anchors(deformable, particles, _WORLD if link is None else link, env_ids)
        self._hold(link_poses, env_ids)

    def release(self, deformable: int, particles: Tensor, env_ids: Tensor | None = None) -> None:
        self._set_anchors(deformable, particles, _FREE, env_ids)

    def _set_anchors(self, deformable: int, particles: Tensor, link: int, env_ids: Tensor | None) -> None:
        if self._fluids.has(deformable):
            name = self._layout.scene.deformables[deformable].name
            raise ConfigurationError(f"'{name}' is a liquid, which nothing holds: hold the vessel that it is in")
        if self._solids.has(deformable):
            self._solids.set_anchors(deformable, particles, link, env_ids)
            return
        columns = self._model.slices[deformable].start + particles
        shape = (len(take_rows(self._tensors["anchor"], env_ids)), len(columns))
        links = torch.full(shape, link, dtype=torch.int32, device=self._device)
        write_columns(self._tensors["anchor"], columns, links, env_ids)

    def _hold(self, link_poses: Tensor, env_ids: Tensor | None) -> None:
        """Fix held particles to where they are now in the frames of their links."""
        chosen = self._chosen(env_ids)
        self._end[:, : link_poses.shape[1]].copy_(link_poses)
        with self._graphs.stream():
            for part in self._parts:
                part.hold(chosen)

    def _check_clear(self) -> None:
        """Refuse solids that the scene puts into other things: only the first environments differ in what these are."""
        with self._graphs.stream():
            depths = self._parts[0].depths(limits.farthest(self._layout))
        if depths is not None:
            limits.check_clear(self._layout, depths, self._colliders.links[0])

    def _orient(self, deformable: int, env_ids: Tensor | None) -> None:
        """Find the rotations of a solid from scratch."""
        number, chosen = self._solids.number(deformable), self._chosen(env_ids)
        with self._graphs.stream():
            for part in self._parts:
                part.orient(number, chosen)

    def _chosen(self, env_ids: Tensor | None) -> Tensor:
        """(N,) bool mask of environments."""
        chosen = torch.zeros(self._num_envs, dtype=torch.bool, device=self._device)
        write_rows(chosen, True, env_ids)
        return chosen

    def reset(self, link_poses: Tensor, env_ids: Tensor | None = None) -> None:
        rest = self._rest.expand(self._num_envs, -1, -1)
        write_rows(self._tensors["x"], take_rows(rest, env_ids), env_ids)
        write_rows(self._tensors["v"], torch.zeros_like(take_rows(rest, env_ids)), env_ids)
        write_rows(self._tensors["searched"], _NOWHERE, env_ids)
        self._solids.reset(env_ids)
        self._fluids.reset(env_ids)
        self._hold(link_poses, env_ids)
        if not self._begun:
            self._begun = True
            self._check_clear()
        for name in ("forces", "torques", "known"):
            write_rows(self._tensors[name], torch.zeros_like(take_rows(self._tensors[name], env_ids)), env_ids)
        write_rows(self._wrenches, torch.zeros_like(take_rows(self._wrenches, env_ids)), env_ids)
        if not self._placed:
            # Once: later resets put liquids to the same place, and to look would wait for the device.
            self._placed = True
            self._check_room()

    def _check_room(self) -> None:
        """Refuse liquid that is inside a collision shape at the start.

        Raises:
            ConfigurationError: names the liquid, the body, and how many particles are inside it.
        """
        if self._fluids.model is None:
            return
        with self._graphs.stream(), wp.ScopedDevice(self._graphs.device):
            inside = np.concatenate([part.liquid_inside() for part in self._parts])
        if not (inside >= 0).any():
            return
        env, particle = (int(found[0]) for found in np.nonzero(inside >= 0))
        model, link = self._fluids.model, int(self._shape_links[env, inside[env, particle]])
        index = int(model.owners[particle])
        columns = model.slices[model.deformables.index(index)]
        same = self._shape_links[env].cpu().numpy()[inside[env, columns]] == link
        count = int((same & (inside[env, columns] >= 0)).sum())
        name, total = self._layout.scene.deformables[index].name, columns.stop - columns.start
        raise ConfigurationError(
            f"{count} of the {total} particles of '{name}' are inside {self._name_of(link)} at the start (environment "
            f"{env}): move the liquid or make it smaller; its outermost particles are half a spacing within its box"
        )

    def _name_of(self, link: int) -> str:
        """Name a link and its entity, or the terrain."""
        if link == TERRAIN:
            return "the terrain"
        entity = next(e for e in self._layout.entities if e.links.start <= link < e.links.stop)
        return f"link '{self._layout.links[link].name}' of '{entity.name}'"

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

    def set_masses(self, links: Tensor, masses: Tensor, env_ids: Tensor | None = None) -> None:
        body, of = self._bodies(links)
        old = take_rows(self._tensors["mass"], env_ids)[:, body]
        scale = (masses[:, of] / old)[..., None, None]
        # The shape of the body stays: its inertia scales with its mass.
        inertia = take_rows(self._tensors["inertia"], env_ids)[:, body] * scale
        write_columns(self._tensors["inertia"], body, inertia, env_ids)
        write_columns(self._tensors["mass"], body, masses[:, of], env_ids)

    def set_centers_of_mass(self, links: Tensor, centers: Tensor, env_ids: Tensor | None = None) -> None:
        body, of = self._bodies(links)
        write_columns(self._tensors["center"], body, centers[:, of], env_ids)

    def _bodies(self, links: Tensor) -> tuple[Tensor, Tensor]:
        """Return the indices of the free bodies among links (k,), and the position of each in ``links``."""
        body, of = (self._free[:, None] == links[None]).nonzero(as_tuple=True)
        return body, of

    # Measurements and snapshots --------------------------------------------------------------------------------------

    @property
    def build_report(self) -> tuple[Approximation, ...]:
        of_substeps = substeps.report(self._layout.scene, self._stepping.h, self._stepping.sweeps)
        of_contacts = stability.sinking(self._layout, self._config.contact_stiffness)
        of_ropes = stability.late_links(self._layout) + stability.folding(self._layout)
        of_liquids = stability.tossed(self._layout) + stability.passing(self._layout)
        links = self._colliders.links
        surfaces = [(self._name_of(int(links[place])), own.bounds) for place, own in self._colliders.surfaces.items()]
        of_liquids += stability.rounded(self._layout) + stability.hollow(self._layout, surfaces)
        of_liquids += thickened(self._layout.scene, self._fluids.model)
        of_solids = limits.light_bodies(self._layout) + limits.squeezed(self._layout)
        of_solids += limits.thin_plates(self._layout, self._solids.h)
        return of_substeps + of_contacts + of_ropes + of_liquids + of_solids

    @property
    def wrenches(self) -> Tensor:
        return self._wrenches

    @property
    def contact_forces(self) -> Tensor:
        return self._tensors["forces"]

    def contact_pressures(self, deformable: int) -> Tensor:
        if not self._solids.has(deformable):
            return super().contact_pressures(deformable)
        return self._solids.pressures(deformable, len(self._layout.links))

    def diverged(self) -> Tensor:
        # A comparison with NaN is false, so everything outside the bounds is found, NaN too.
        near = (self._tensors["x"].abs() <= MAX_DISTANCE).all(-1)
        slow = (self._tensors["v"].abs() <= MAX_SPEED).all(-1)
        sound = near & slow
        found = [
            self._solids.diverged(number)
            if self._solids.has(number)
            else self._fluids.diverged(number)
            if self._fluids.has(number)
            else ~sound[:, columns].all(1)
            for number, columns in enumerate(self._model.slices)
        ]
        return torch.stack(found, dim=1)

    def save_state(self) -> MatterState:
        saved = {name: tensor.clone() for name, tensor in self._tensors.items()}
        return MatterState({**saved, "wrenches": self._wrenches.clone()})

    def load_state(self, state: MatterState) -> None:
        for name, tensor in self._tensors.items():
            # In place: kernels and recorded graphs keep the addresses.
            tensor.copy_(state.tensors[name])
        self._wrenches.copy_(state.tensors["wrenches"])
        with self._graphs.stream():
            for part in self._parts:
                # Lists of neighbours are no part of a snapshot: searched from the same places they are the same.
                part.search_again()
