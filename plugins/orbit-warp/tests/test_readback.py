"""What the engines tell of their models is read from what they simulate, so that a wrong build is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from orbit_assets.catalogue import robot
from orbit_core.interfaces import BuildError, SceneLayout
from orbit_core.scene import Box, ObjectSpec, Scene, Shape, single_link
from orbit_core.world.checks import check_build
from orbit_warp import WarpBackend, WarpConfig
from orbit_warp.engine import WarpEngine

BLOCKS = tuple(
    single_link("block", Shape(Box((0.1, 0.1, 0.1))), mass, np.diag([1, 2, 2.5]) * mass) for mass in (1.0, 3.0)
)
SCENE = Scene(
    robots=(robot("franka_panda"),), objects=(ObjectSpec(name="block", articulation=BLOCKS[0], variants=BLOCKS[1:]),)
)


def engine_of(scene: Scene = SCENE) -> WarpEngine:
    engine = WarpBackend().create_engine(SceneLayout.of(scene), 2, torch.device("cpu"), WarpConfig())
    assert isinstance(engine, WarpEngine)
    return engine


def test_each_kind_of_environment_is_read_back() -> None:
    engine = engine_of()
    first, second = engine.built_model()
    assert (first.masses[-1], second.masses[-1]) == (1.0, 3.0)
    np.testing.assert_allclose(second.inertias[-1], np.diag([3, 6, 7.5]), atol=1e-6)
    check_build(engine, "warp")


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("body_mass", "the mass of link"),
        ("body_ipos", "the centre of mass of link"),
        ("body_inertia", "the inertia of link"),
        ("jnt_range", "the lower limit of joint"),
        ("dof_armature", "the armature of joint"),
        ("actuator_forcerange", "the effort limit of joint"),
    ],
)
def test_a_wrong_number_on_the_device_is_found(field: str, message: str) -> None:
    engine = engine_of(replace(SCENE, objects=()))
    array = getattr(engine.native.model, field)
    array.assign(array.numpy() * 1.01)
    with pytest.raises(BuildError, match=message):
        check_build(engine, "warp")
