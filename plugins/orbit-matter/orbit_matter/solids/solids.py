"""The solids of all environments: their state as tensors, and how it is read and written."""

# pyright: reportArgumentType=false
# Warp's arrays and structs carry their types at run time.

from __future__ import annotations

import torch
from torch import Tensor

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED, SceneLayout
from orbit_core.plugin_kit.rows import take_rows, write_columns, write_rows
from orbit_core.scene import SoftBody
from orbit_matter.kernels import FREE
from orbit_matter.solids.model import SolidModel, build

_FREE, _NONE = int(FREE), -1


class Solids:
    """State of the solids of N environments.

    Args:
        layout: of the scene.
        num_envs: environments.
        device: of the tensors.
        h: seconds of a step of the solids.
    """

    def __init__(self, layout: SceneLayout, num_envs: int, device: torch.device, h: float) -> None:
        scene = layout.scene
        self.model: SolidModel = build(scene, h)
        """Grids, matrices and sites of all solids, the same in every environment."""
        self.h = h
        specs = [spec for spec in scene.deformables if isinstance(spec, SoftBody)]
        parts = self.model.embeddings
        self.damping = [spec.damping for spec in specs]
        """s of each solid: stiffness-proportional damping."""
        # Tensors of state are replaced by none: kernels hold their memory, and graphs its addresses.
        self._device, self._num_envs = device, num_envs
        self._index = {deformable: number for number, deformable in enumerate(self.model.deformables)}
        make = {"dtype": torch.float32, "device": device}
        self._links = len(layout.links)
        self._corners = [torch.as_tensor(part.corners, dtype=torch.int64, device=device) for part in parts]
        self._fits = [torch.as_tensor(fit, **make) for fit in self.model.fits]
        # Warp's quaternions end with w, those of poses begin with it.
        turns = [(*spec.pose.orientation[1:], spec.pose.orientation[0]) for spec in specs]
        counts = torch.tensor([len(part.cells) for part in parts], dtype=torch.int64)
        bodies = torch.tensor(turns, **make).view(-1, 4)
        n, nodes, sites = num_envs, len(self.model.nodes), len(self.model.site_cells)
        vertices = torch.einsum("sk,skc->sc", *self._site_nodes(make))
        self._rest = {
            "solid_x": torch.as_tensor(self.model.nodes, **make),
            "solid_v": torch.zeros(nodes, 3, **make),
            "solid_before": torch.zeros(nodes, 3, **make),
            "solid_d": torch.zeros(nodes, 3, **make),
            "solid_load": torch.zeros(nodes, 3, **make),
            "solid_fresh": torch.ones(len(specs), dtype=torch.int32, device=device),
            "solid_turn": bodies.repeat_interleave(counts.to(device), dim=0),
            "solid_body_turn": bodies,
            "site_x": vertices,
            "site_v": torch.zeros(sites, 3, **make),
            "site_link": torch.full((sites,), _NONE, dtype=torch.int32, device=device),
            "site_force": torch.zeros(sites, 3, **make),
            "site_stuck": torch.full((self.model.contacts,), _NONE, dtype=torch.int32, device=device),
            "site_press": torch.zeros(self.model.contacts, 2, **make),
        }
        self.tensors = {name: rest.repeat(n, *[1] * rest.dim()) for name, rest in self._rest.items()}
        """State by name, (N, ...) each; snapshots hold them, and kernels their memory."""
        for name in ("site_anchor", "site_exempt"):
            self.tensors[name] = torch.full((n, sites), _FREE, dtype=torch.int32, device=device)
        self.tensors["site_held"] = torch.zeros(n, sites, 3, **make)
        self.tensors["site_place"] = torch.zeros(n, self.model.contacts, 3, **make)

    def _site_nodes(self, make: dict) -> tuple[Tensor, Tensor]:
        """Return the weights (S, 27) of all sites, and the rest positions of the nodes they are of (S, 27, 3)."""
        nodes = torch.as_tensor(self.model.nodes, **make)
        cells = torch.as_tensor(self.model.cells[self.model.site_cells], dtype=torch.int64, device=self._device)
        return torch.as_tensor(self.model.weights, **make), nodes[cells]

    def has(self, deformable: int) -> bool:
        """Return True if the scene's deformable of that index is a solid."""
        return deformable in self._index

    def number(self, deformable: int) -> int:
        """Return which of the solids the scene's deformable of that index is."""
        return self._index[deformable]

    def _columns(self, deformable: int) -> slice:
        return self.model.vertices[self._index[deformable]]

    def positions(self, deformable: int) -> Tensor:
        """(N, P, 3) m of the vertices of a solid."""
        return self.tensors["site_x"][:, self._columns(deformable)]

    def velocities(self, deformable: int) -> Tensor:
        """(N, P, 3) m/s of the vertices of a solid."""
        return self.tensors["site_v"][:, self._columns(deformable)]

    def pressures(self, deformable: int, links: int) -> Tensor:
        """(N, L) Pa: mean of a solid's contact with each of that many links, 0 on those that it does not touch."""
        points = self._points(self._index[deformable])
        on = self.tensors["site_link"][:, points].long()
        # Terrain and other solids have the numbers after all links, and points that touch nothing the one before.
        on = torch.where((on < 0) | (on >= links), links, on)
        none = torch.zeros(self._num_envs, links + 1, device=self._device)
        force, area = self.tensors["site_press"][:, points].unbind(2)
        # Where nothing touches both sums are zero, and any area gives no pressure.
        covered = none.scatter_add(1, on, area).clamp_min(1e-12)
        return (none.scatter_add(1, on, force) / covered)[:, :links]

    def write(self, deformable: int, positions: Tensor, velocities: Tensor, env_ids: Tensor | None) -> None:
        """Put the vertices of a solid somewhere: (n, P, 3) m and m/s. Nodes follow as smoothly as they can.

        The rotations of its cells, which launches find, are those of its last state until then.
        """
        number = self._index[deformable]
        nodes = slice(int(self.model.first_node[number]), int(self.model.first_node[number + 1]))
        # As if the last step had moved it so, and the next one knows of no step before.
        moving = self._fits[number] @ velocities
        write_rows(self.tensors["solid_x"][:, nodes], self._fits[number] @ positions, env_ids)
        for name, value in (("solid_v", moving), ("solid_before", moving), ("solid_d", self.h * moving)):
            write_rows(self.tensors[name][:, nodes], value, env_ids)
        write_rows(self.tensors["solid_fresh"][:, number], 1, env_ids)
        self._let_go(number, env_ids)

    def _points(self, number: int) -> slice:
        """Return the sites of contact of a solid."""
        counts = [len(part.contacts.cells) for part in self.model.embeddings]
        return slice(sum(counts[:number]), sum(counts[: number + 1]))

    def _let_go(self, number: int, env_ids: Tensor | None) -> None:
        """Forget where a solid sticks, and where others stick to it; those keep their holds on all other things."""
        points, vertices = self._points(number), self.model.vertices[number]
        for name, columns in (("site_stuck", points), ("site_link", points), ("site_link", vertices)):
            write_rows(self.tensors[name][:, columns], _NONE, env_ids)
        # As a thing that others press on, a solid has a number after those of all links and of terrain.
        own = max(self._links, 1) + 1 + number
        for name in ("site_stuck", "site_link"):
            old = take_rows(self.tensors[name], env_ids)
            write_rows(self.tensors[name], torch.where(old == own, _NONE, old), env_ids)

    def set_anchors(self, deformable: int, particles: Tensor, link: int, env_ids: Tensor | None) -> None:
        """Hold vertices (k,) by a link, by the world, or not at all."""
        anchors = self.tensors["site_anchor"]
        shape = (len(take_rows(anchors, env_ids)), len(particles))
        links = torch.full(shape, link, dtype=torch.int32, device=self._device)
        write_columns(anchors, self._columns(deformable).start + particles, links, env_ids)
        # A point between vertices is held where one thing holds all of them.
        number = self._index[deformable]
        around = anchors[:, self._columns(deformable)][:, self._corners[number]]
        alike = (around == around[..., :1]).all(-1)
        anchors[:, self.model.between[number]] = torch.where(alike, around[..., 0], _FREE)

    def reset(self, env_ids: Tensor | None) -> None:
        """Put solids at rest where the scene has them."""
        for name, rest in self._rest.items():
            write_rows(self.tensors[name], take_rows(rest.expand(self._num_envs, *rest.shape), env_ids), env_ids)

    def diverged(self, deformable: int) -> Tensor:
        """(N,) bool: nodes that are not within the bounds of :mod:`orbit_core.interfaces.divergence`."""
        number = self._index[deformable]
        nodes = slice(int(self.model.first_node[number]), int(self.model.first_node[number + 1]))
        # A comparison with NaN is false, so that all that is not within the bounds is found.
        near = (self.tensors["solid_x"][:, nodes].abs() <= MAX_DISTANCE).all(-1).all(-1)
        slow = (self.tensors["solid_v"][:, nodes].abs() <= MAX_SPEED).all(-1).all(-1)
        return ~(near & slow)
