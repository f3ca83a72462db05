"""Tactile pads: normal and shear force per taxel, slip, and the picture of a gel, from contact forces and ray casts.

Engines report few contact points, and each other ones. The force on the link is alike on all of them, and so are rays
against what touches the pad: the pad is an elastic half space, pressed by that force against that surface.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import interpolate, normalize

from orbit_core.dynamics.transforms import quat_rotate, quat_rotate_inverse, transform_points
from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import TactileSpec
from orbit_core.sensors.contact import ContactSensor
from orbit_core.sensors.half_space import HalfSpace
from orbit_core.sensors.proprioception import Mount
from orbit_core.sensors.timed import SensorContext, Values

# Light of three colours from three sides, low over the gel, as in GelSight's sensors (Yuan, Dong and Adelson, GelSight:
# High-Resolution Robot Tactile Sensors for Estimating Geometry and Force, Sensors 17(12), 2017).
_LIGHTS = ((1.0, 0.0, 0.35), (-0.5, 0.866, 0.35), (-0.5, -0.866, 0.35))


class TactileSensor(ContactSensor):
    """Forces on the taxels of a pad, averaged over the sensor's period.

    Normal forces are those of an elastic half space that is pressed by the link's contact force against the surface
    that rays from the pad meet. Shear follows Coulomb's law with partial slip: the difference of two normal
    distributions (Ciavarella, The generalized Cattaneo partial slip plane contact problem, International Journal of
    Solids and Structures 35, 1998). Both add up to the contact force; an engine that declares contact forces without
    their part of friction has no shear. Where no ray meets anything within ``reach``, the
    force acts elsewhere on the link, and all taxels are zero. Noise, in newtons, goes on every taxel.
    """

    noisy = ("normal", "shear")
    costly = True

    def __init__(self, spec: TactileSpec, context: SensorContext) -> None:
        """Resolve the frame and compute the pad's compliance.

        Raises:
            ConfigurationError: the frame is on a link that ``links`` leaves out.
        """
        super().__init__(spec, context)
        self._tactile = spec
        self._mount = Mount(context.engine, context.layout, spec.entity, spec.frame, spec.name, spec.pose)
        link = context.layout.links[self._mount.link].name
        if link not in self.link_names:
            raise ConfigurationError(
                f"sensor '{spec.name}' is on link '{link}', of which it measures no contact: name it in 'links'"
            )
        self._row = self.link_names.index(link)
        columns, rows = spec.taxels
        modulus = spec.young / (1.0 - spec.poisson**2)
        self._half_space = HalfSpace(rows, columns, spec.size, modulus, self.device)
        self._taxels = _grid(rows, columns, spec.size).to(self.device)
        self._light = normalize(torch.tensor(_LIGHTS, device=self.device), dim=1)

    @property
    def normal_forces(self) -> Tensor:
        """Forces (N, rows, columns) in newtons that press on each taxel; rows along the pad's y, columns along x."""
        return self._read("normal").unflatten(1, self._tactile.taxels[::-1])

    @property
    def shear_forces(self) -> Tensor:
        """Forces (N, rows, columns, 2) in newtons along the pad's x and y on each taxel."""
        return self._read("shear").unflatten(1, self._tactile.taxels[::-1])

    @property
    def slip(self) -> Tensor:
        """Share (N,) of the loaded taxels that slip, by their friction: 0 sticks, 1 slides."""
        normal, shear = self._read("normal"), self._read("shear").norm(dim=-1)
        loaded = normal > 1e-3 * normal.amax(1, keepdim=True).clamp_min(1e-9)
        slipping = loaded & (shear > 0.99 * self._tactile.friction * normal)
        return slipping.sum(1) / loaded.sum(1).clamp_min(1)

    @property
    def indentation(self) -> Tensor:
        """Depth (N, rows, columns) in m by which the gel is pressed in."""
        depth = self._half_space.displacements(self._read("normal"))
        return depth.unflatten(1, self._tactile.taxels[::-1])

    def picture(self, height: int, width: int) -> Tensor:
        """Return what a camera behind the gel sees, (N, height, width, 3) uint8: red, green and blue light from three
        sides on its indented surface.
        """
        depth = interpolate(self.indentation[:, None], (height, width), mode="bicubic", align_corners=False)[:, 0]
        x, y = self._tactile.size
        slope_y, slope_x = torch.gradient(depth, spacing=(y / height, x / width), dim=(1, 2))
        normals = normalize(torch.stack((-slope_x, -slope_y, torch.ones_like(depth)), -1), dim=-1)
        # A flat gel is grey: what it reflects of each light is the mean of the range.
        flat = self._light[:, 2]
        shade = 0.5 + 0.9 * (normals @ self._light.transpose(0, 1) - flat)
        return (255.0 * shade.clamp(0.0, 1.0)).round().to(torch.uint8)

    def _measure(self, env_ids: Tensor | None) -> Values:
        spec, pose = self._tactile, self._mount.pose(env_ids)
        # Rays first: they end a stage of a traced step, over which forces, which share memory, could not be passed.
        gaps = self._gaps(pose, env_ids)
        values = super()._measure(env_ids)
        # Of the entities that filters name, or of all.
        on_link = values["filtered"][:, self._row].sum(1) if spec.filters else values["forces"][:, self._row]
        force = quat_rotate_inverse(pose[:, 3:], on_link)
        pressing = (-force[:, 2]).clamp_min(0.0)
        tangent = force[:, :2]
        dragging = tangent.norm(dim=1)
        # Both distributions at once: under the whole force, and under what is left of it by the drag.
        remaining = (pressing - dragging / spec.friction).clamp_min(0.0)
        both = self._half_space.loads(torch.cat((gaps, gaps)), torch.cat((pressing, remaining)))
        normal, sticking = both.chunk(2)
        sheared = normal - sticking
        share = sheared / sheared.sum(1, keepdim=True).clamp_min(1e-12)
        felt = (normal.sum(1, keepdim=True) > 0.0) & (sheared > 0.0)
        shear = torch.where(felt[..., None], share[..., None] * tangent[:, None], 0.0)
        return values | {"normal": normal, "shear": shear}

    def _gaps(self, pose: Tensor, env_ids: Tensor | None) -> Tensor:
        """Return the distance (n, T) in m from each taxel outwards to what is in front of it."""
        reach = self._tactile.reach
        # From within the pad: what touches it may have sunk into the link's own shape.
        starts = self._taxels - torch.tensor((0.0, 0.0, reach), device=self.device)
        origins = transform_points(pose[:, None], starts).contiguous()
        outward = torch.tensor((0.0, 0.0, 1.0), device=self.device).expand(len(starts), 3)
        directions = quat_rotate(pose[:, None, 3:], outward).contiguous()
        own = self._mount.entity.links
        hits = self.engine.cast_rays_past(origins, directions, 2.0 * reach, range(own.start, own.stop), env_ids)
        return hits.distances - reach


def _grid(rows: int, columns: int, size: tuple[float, float]) -> Tensor:
    """Return the middles (T, 3) of cells in the pad's plane, row after row along x from the least y."""
    x = ((torch.arange(columns) + 0.5) / columns - 0.5) * size[0]
    y = ((torch.arange(rows) + 0.5) / rows - 0.5) * size[1]
    grid_y, grid_x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack((grid_x.flatten(), grid_y.flatten(), torch.zeros(rows * columns)), 1)
