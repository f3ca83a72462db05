"""A policy that keeps a distance above zero: its space is curved so that the way to zero has no end."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

# Share of the range below which a distance counts as this in the metric: float32 resolves what is left free.
_NEAREST = 0.03
# The same of the margin, in the potential.
_TOUCHING = 0.05


@dataclass(frozen=True)
class Barrier:
    """The collision leaf of Cheng et al. (RMPflow, WAFR 2018, appendix on collision avoidance) for a distance x >= 0.

    With ``s = x / range`` and the speed ``v = x' / speed``, a geometric dynamical system of the metric

    ``G = weight w(s) u(v)``, ``w = (1/s^2 - 1)^2`` within the range, ``u = v^2`` while x shrinks, else 0,

    whose w is theirs, ``1/s^4``, near the obstacle, and goes to zero at the range. Its curvature terms
    ``Xi = x'/2 dG/dx'`` and ``xi = x'^2/2 dG/dx`` make the inertia ``M = G + Xi`` and the force ``-xi``, by which what
    comes nearer slows down with the distance, ``x' ~ x`` where nothing drives it, and nothing is felt at rest or on
    leaving. Only within ``margin`` a potential pushes, with ``push (margin / x - 1)^2``.
    """

    weight: float
    range: float
    speed: float
    margin: float
    push: float

    def __call__(self, distance: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Inertia M and force f (...) at distances x (...), with their speeds x' (...)."""
        share = (distance / self.range).clamp_min(_NEAREST)
        root = (share.square().reciprocal() - 1.0).clamp_min(0.0)
        square = (speed.clamp_max(0.0) / self.speed).square()
        # dw/dx = -4 root / s^3 / range; x'^2 dG/dx / 2 then is this, and Xi equals G, as u is quadratic.
        slope = -4.0 * root / share.pow(3) / self.range
        inertia = 2.0 * self.weight * root.square() * square
        near = distance.clamp_min(_TOUCHING * self.margin)
        pushing = self.push * (self.margin / near - 1.0).clamp_min(0.0).square()
        return inertia, pushing - 0.5 * self.weight * slope * square * speed.square()
