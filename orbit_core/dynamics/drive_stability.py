"""At which gains a PD law that is evaluated once a step makes the simulation diverge.

Steps of h seconds are those of semi-implicit Euler, as all engines take them: with the mass matrix M, the law's gains K
and D taken at the beginning of the step and other damping C taken at its end,
``(M + h C) (v' - v) = -h (K q + (C + D) v)`` and ``q' = q + h v'``. On each motion x this is a polynomial of second
degree in the factor by which x grows per step; by Jury's criterion (Ogata, Discrete-Time Control Systems, 2nd ed.,
section 4.5) it stays bounded while ``x (h^2 K + 2 h D) x < x (4 M + 2 h C) x``, which it reaches as a motion that
changes sign at every step. Over all x that is a generalised eigenvalue below one.

Measured on four engines with a pendulum and an arm of two links, the last of a hundredth of the mass: gains 2 % below
this limit settle, gains 2 % above it diverge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from orbit_core.dynamics.workspace import workspace_mass_matrices
from orbit_core.scene import Articulation

FloatArray = npt.NDArray[np.float64]
_HALVINGS = 24


@dataclass(frozen=True)
class UnstableDrive:
    """The joint whose drive is least stable, and what would be stable.

    ``share`` is the factor below one by which all gains of the robot's explicit drives may be taken at most, and
    ``time_step`` the longest step, s, with which they may stay as they are.
    """

    joint: str
    stiffness: float
    damping: float
    share: float
    time_step: float


@dataclass(frozen=True, kw_only=True)
class ExplicitGains:
    """Gains (J,) of the drives that are evaluated once a step, and what else damps the joints.

    Stiffness is N m/rad or N/m, damping N m s/rad or N s/m; joints without such a drive have zero. ``implicit_damping``
    is taken at the end of each step: the mechanism's own, and that of drives which the engine integrates.
    """

    stiffness: FloatArray
    damping: FloatArray
    implicit_damping: FloatArray

    def loads(self, step: float) -> FloatArray:
        """``h^2 K + 2 h D`` (J,), kg m^2 or kg."""
        return self.stiffness * step**2 + 2.0 * self.damping * step


def unstable_drive(
    articulation: Articulation, gains: ExplicitGains, armature: FloatArray, time_step: float, *, fixed_base: bool
) -> UnstableDrive | None:
    """The joint whose drive is least stable, where steps of ``time_step`` (s) diverge somewhere in the workspace.

    Configurations are drawn within the joints' limits; a free base moves. Effort limits, commands that come late and
    contacts are left out: the first two make matters worse or bound them, the last add inertia.

    Args:
        articulation: the description.
        gains: of the drives that are evaluated once a step.
        armature: (J,) reflected inertias of the motors.
        time_step: s.
        fixed_base: whether the root cannot move.
    """
    if not np.any(gains.loads(time_step)):
        return None
    base = 0 if fixed_base else 6
    matrices = workspace_mass_matrices(articulation, free_root=not fixed_base, armature=armature.tolist())
    leading = [index for index, joint in enumerate(articulation.movable_joints) if joint.mimic is None]
    free = [*range(base), *(base + index for index in leading)]
    masses = matrices[:, free][:, :, free]

    def rates(step: float) -> tuple[FloatArray, FloatArray]:
        """Largest eigenvalues (S,), below one where stable, and the joints' shares (S, leading) of their motions."""
        loads = gains.loads(step)[leading]
        inertias = 4.0 * masses
        inertias[:, range(base, len(free)), range(base, len(free))] += 2.0 * step * gains.implicit_damping[leading]
        roots = np.sqrt(loads)
        values, vectors = np.linalg.eigh(roots[:, None] * np.linalg.inv(inertias)[:, base:, base:] * roots)
        return values[:, -1], np.square(vectors[:, :, -1])

    found, shares = rates(time_step)
    worst = int(found.argmax())
    if found[worst] < 1.0:
        return None
    shortest, longest = 0.0, time_step
    for _ in range(_HALVINGS):
        middle = (shortest + longest) / 2
        shortest, longest = (middle, longest) if rates(middle)[0].max() < 1.0 else (shortest, middle)
    joint = leading[int(shares[worst].argmax())]
    return UnstableDrive(
        articulation.joint_names[joint],
        float(gains.stiffness[joint]),
        float(gains.damping[joint]),
        1.0 / float(found[worst]),
        shortest,
    )
