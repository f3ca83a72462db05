"""One environment's scene as the model that MuJoCo-Warp steps."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is an extension module without type information.

from __future__ import annotations

import mujoco

from orbit_core.interfaces import SceneLayout
from orbit_mjmodel import model
from orbit_warp.config import WarpConfig

LEAST_FRICTION = 1e-5
"""Of any coefficient: friction cones of no width are degenerate in single precision."""


def build_model(layout: SceneLayout, config: WarpConfig) -> model.BuiltModel:
    """Compile one environment.

    Raises:
        AssetError: MuJoCo refuses the description; says why.
    """
    # Two boxes meet by MuJoCo's own analytic test: the general one misses boxes that overlap symmetrically.
    no_general_box_test = int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    return model.build_model(
        layout, config, solver=config.algorithm, disabled=no_general_box_test, least_friction=LEAST_FRICTION
    )
