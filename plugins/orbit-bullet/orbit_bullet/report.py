"""Approximations in Bullet of a scene, reported before it is built."""

from __future__ import annotations

import numpy as np

from orbit_bullet.config import BulletConfig
from orbit_bullet.deformables import deformable_report
from orbit_bullet.materials import PairProducts, material_report, nominal, rolling_friction
from orbit_core.interfaces import Approximation, EntityLayout, SceneLayout
from orbit_core.plugin_kit.inertias import inertia_approximations
from orbit_core.plugin_kit.massless import stand_in_approximations


def build_report(layout: SceneLayout, config: BulletConfig) -> tuple[Approximation, ...]:
    """The build report, with one line per difference."""
    found = material_report(layout)
    products = PairProducts(layout)
    friction = nominal(layout, "dynamic_friction")
    factors = products.factors(friction)
    found += products.report("friction", friction)
    found += products.report_lengths("torsional friction", nominal(layout, "torsional_friction"), factors)
    found += products.report_lengths("rolling friction", rolling_friction(layout), factors)
    found += products.report("restitution", nominal(layout, "restitution"))
    for entity in layout.entities:
        found += _joint_report(layout, entity)
        found += stand_in_approximations(entity, "Bullet")
        found += inertia_approximations(entity, "Bullet")
    return tuple(found + deformable_report(layout))


def _joint_report(layout: SceneLayout, entity: EntityLayout) -> list[Approximation]:
    parameters, joints = layout.joint_parameters, layout.joints
    numbers = range(entity.joints.start, entity.joints.stop)
    found: list[Approximation] = []
    fast = [joints[number].name for number in numbers if np.isfinite(parameters.velocity_limit[number])]
    if fast:
        asked = f"velocity limits of joints {', '.join(fast)}"
        why = "Bullet does not limit the velocity of single joints"
        found.append(Approximation(f"'{entity.name}'", asked, "no limits", why))
    driven = parameters.drive_stiffness + parameters.drive_damping > 0
    for number in numbers:
        if driven[number] and joints[number].mimic:
            subject = f"joint '{joints[number].name}' of '{entity.name}'"
            why = "it mimics another joint, whose drive moves both"
            found.append(Approximation(subject, "a drive of its own", "no drive", why))
    return found
