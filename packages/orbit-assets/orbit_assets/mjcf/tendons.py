"""Fixed tendons of MJCF models that run over one joint: what they do is the joint's own."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from orbit_assets.mjcf.model import Compiled
from orbit_core.scene import Joint, JointType


@dataclass(frozen=True)
class Share:
    """What a tendon adds to its joint, in the joint's own units; see :class:`orbit_core.scene.Joint`."""

    lower_limit: float
    upper_limit: float
    stiffness: float
    rest_position: float
    damping: float
    friction: float
    armature: float

    def added(self, joint: Joint) -> Joint:
        """The joint with it: the narrower limits, and one spring that pulls as both do."""
        lower, upper = max(joint.lower_limit, self.lower_limit), min(joint.upper_limit, self.upper_limit)
        limited = (lower, upper) != (-math.inf, math.inf)
        stiffness = joint.stiffness + self.stiffness
        pull = joint.stiffness * joint.rest_position + self.stiffness * self.rest_position
        return replace(
            joint,
            type=JointType.REVOLUTE if limited and joint.type is JointType.CONTINUOUS else joint.type,
            lower_limit=lower,
            upper_limit=max(lower, upper),
            stiffness=stiffness,
            rest_position=pull / stiffness if stiffness else 0.0,
            damping=joint.damping + self.damping,
            friction=joint.friction + self.friction,
            armature=joint.armature + self.armature,
        )


def share_of(compiled: Compiled, tendon: int, coefficient: float) -> Share | None:
    """What a tendon of length ``coefficient * position`` adds to its joint; ``None`` if no joint can have that.

    The tendon's force acts on the joint times the coefficient (MuJoCo's documentation, "Computation", on actuation and
    tendons), so that its stiffness, damping and armature count with the coefficient's square.
    """
    model = compiled.model
    slack = model.tendon_lengthspring[tendon].tolist()
    stiffness = float(model.tendon_stiffness[tendon])
    curved = np.any(model.tendon_stiffnesspoly[tendon]) or np.any(model.tendon_dampingpoly[tendon])
    if not coefficient or curved or (stiffness and slack[0] != slack[1]):
        return None
    ends = (-math.inf, math.inf)
    if model.tendon_limited[tendon]:
        first, second = (float(length) / coefficient for length in model.tendon_range[tendon])
        ends = min(first, second), max(first, second)
    return Share(
        *ends,
        stiffness * coefficient**2,
        slack[0] / coefficient if stiffness else 0.0,
        float(model.tendon_damping[tendon]) * coefficient**2,
        float(model.tendon_frictionloss[tendon]) * abs(coefficient),
        float(model.tendon_armature[tendon]) * coefficient**2,
    )
