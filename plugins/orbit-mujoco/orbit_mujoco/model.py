"""One environment's scene as the model that MuJoCo steps."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel import model
from orbit_mujoco.config import MujocoConfig
from orbit_mujoco.measurements import add_contact_sensors, add_matter_sensors


def build_models(layout: SceneLayout, config: MujocoConfig) -> tuple[model.BuiltModel, ...]:
    """Compile one environment of each of the layout's variants.

    Raises:
        AssetError: MuJoCo refuses the description; says why.
    """
    disabled = mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a diverged environment must be seen, not put back
    if len(layout.variants) > 1:
        disabled |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE  # trees of bounds would be one kind's for all
    built = model.build_models(layout, config, solver=config.solver, disabled=int(disabled), add_sensors=_add_sensors)
    for one in built:
        one.model.geom_contype[one.absent] = one.model.geom_conaffinity[one.absent] = 0
    return built


def _add_sensors(spec: mujoco.MjSpec, layout: SceneLayout) -> None:
    add_contact_sensors(spec, layout)
    add_matter_sensors(spec, layout)
