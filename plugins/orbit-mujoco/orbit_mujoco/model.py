"""One environment's scene as the model that MuJoCo steps."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel import model
from orbit_mujoco.config import MujocoConfig
from orbit_mujoco.probes import add_contact_sensors


def build_model(layout: SceneLayout, config: MujocoConfig) -> model.BuiltModel:
    """Compile one environment.

    Raises:
        AssetError: MuJoCo refuses the description; says why.
    """
    never_put_back = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # a diverged environment must be seen
    return model.build_model(
        layout, config, solver=config.solver, disabled=never_put_back, add_sensors=add_contact_sensors
    )
