"""Repair of inertias that no body can have, on request, with a note on each."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orbit_assets.mass_properties import mass_properties
from orbit_assets.options import ReadOptions, Repair
from orbit_core.preparation.merge import MassProperties, combine, link_hosts
from orbit_core.scene import Articulation, Link, Pose, Sphere
from orbit_core.scene.inertias import raised_moments

# Least principal moment as a share of the largest; a thin rod's smallest one is about that.
_LEAST = 1e-3
# As in :mod:`orbit_core.preparation.validation`: published models round their inertias to three digits.
_TRIANGLE_TOLERANCE = 1e-3
# kg/m^3, of the ball that replaces an inertia of zero.
_WATER = 1000.0


def repaired(articulation: Articulation, options: ReadOptions) -> Articulation:
    """Return the articulation as read, or with its inertias balanced where the options say so."""
    return balance_inertias(articulation) if options.repair is Repair.BALANCE else articulation


def balance_inertias(articulation: Articulation) -> Articulation:
    """Replace inertias that no body can have by the nearest possible ones.

    Links joined by fixed joints are one body; where it is sound, its links stay as they are. Else each of its unsound
    links gets the nearest sound principal moments that are no smaller, about the same axes: each at least a thousandth
    of the largest, and the two smaller ones together no smaller than the largest (half of what lacks goes to each). A
    link with mass and an inertia of zero gets that of a ball of water of its mass. Masses stay as they are.
    """
    # Judged by rigid body, not by link: a model may split one body's inertia over links that alone are impossible.
    unsound = {name for body in _bodies(articulation) for name in _unsound_links(body)}
    if not unsound:
        return articulation
    links = tuple(_balanced(link) if link.name in unsound else link for link in articulation.links)
    changes = [
        f"'{old.name}' {_moments_text(old.inertia)} -> {_moments_text(new.inertia)}"
        for old, new in zip(articulation.links, links, strict=True)
        if new is not old
    ]
    note = f"principal moments (kg m^2) that no body has are raised: {', '.join(changes)}"
    return replace(articulation, links=links, notes=(*articulation.notes, note))


def balanced(inertia: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the inertia (3, 3), symmetric, with principal moments raised as :func:`balance_inertias` says.

    At least one principal moment must be positive.
    """
    tensor = np.asarray(inertia, dtype=float)
    moments, axes = np.linalg.eigh((tensor + tensor.T) / 2.0)
    return axes @ np.diag(raised_moments(np.maximum(moments, _LEAST * moments[2]))) @ axes.T


def _bodies(articulation: Articulation) -> list[list[tuple[Link, Pose]]]:
    """Group links that fixed joints join, each with its pose in its body."""
    hosts = link_hosts(articulation)
    bodies: dict[str, list[tuple[Link, Pose]]] = {}
    for link in articulation.links:
        host, pose = hosts[link.name]
        bodies.setdefault(host, []).append((link, pose))
    return list(bodies.values())


def _unsound_links(body: list[tuple[Link, Pose]]) -> list[str]:
    parts = [MassProperties(link.mass, link.center_of_mass, link.inertia).placed(pose) for link, pose in body]
    if not any(part.mass > 0 for part in parts) or _sound(combine(parts).inertia):
        return []
    return [link.name for link, _ in body if (link.mass > 0 or np.any(link.inertia)) and not _sound(link.inertia)]


def _sound(inertia: npt.NDArray[np.float64]) -> bool:
    if not np.isfinite(inertia).all() or not np.allclose(inertia, inertia.T, rtol=1e-6, atol=1e-12):
        return False
    small, middle, large = np.linalg.eigvalsh(inertia)
    return bool(small > 0 and small + middle >= large * (1 - _TRIANGLE_TOLERANCE))


def _balanced(link: Link) -> Link:
    if not np.isfinite(link.inertia).all():
        return link  # not to be guessed: validation names it
    if np.linalg.eigvalsh((link.inertia + link.inertia.T) / 2.0)[2] > 0:
        return replace(link, inertia=balanced(link.inertia))
    if link.mass <= 0:
        return link
    ball = Sphere((0.75 * link.mass / (math.pi * _WATER)) ** (1.0 / 3.0))
    return replace(link, inertia=mass_properties(ball, mass=link.mass).inertia)


def _moments_text(inertia: npt.NDArray[np.float64]) -> str:
    return "({:.3g}, {:.3g}, {:.3g})".format(*np.linalg.eigvalsh((inertia + inertia.T) / 2.0))
