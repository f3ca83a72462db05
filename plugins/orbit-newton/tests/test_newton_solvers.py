"""What is the own of Newton's solvers: settings, replayed graphs, and that they are found only where Newton is."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from dataclasses import replace
from typing import Any

import pytest
import torch

from orbit_conformance.bodies import WEIGHTLESS, cube, pendulum, rotor, scene
from orbit_core.interfaces import ConfigurationError, Engine, SceneLayout, SimulationError
from orbit_core.scene import ImplicitPd, JointType
from orbit_newton.backends import FeatherstoneBackend, NewtonBackend, XpbdBackend
from orbit_newton.config import FeatherstoneConfig, NewtonConfig, XpbdConfig

BACKENDS = [FeatherstoneBackend, XpbdBackend]
needs_newton = pytest.mark.skipif(
    not importlib.util.find_spec("newton"), reason='Newton is not installed: pip install "orbit-core[newton]"'
)


def engine_of(backend: type[NewtonBackend], num_envs: int = 2, **settings: Any) -> Engine:
    layout = SceneLayout.of(scene(pendulum(home=0.3), cube()))
    return backend().create_engine(layout, num_envs, torch.device("cpu"), backend.config_type(**settings))


def test_importing_the_backends_imports_no_engine() -> None:
    code = (
        "import sys, orbit_newton.backends as b; b.XpbdBackend().capabilities(); "
        "print([m for m in ('newton', 'warp', 'mujoco', 'torch') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("config", "settings"),
    [
        (FeatherstoneConfig, {"substeps": 0}),
        (FeatherstoneConfig, {"contact_stiffness": -1.0}),
        (XpbdConfig, {"iterations": 0}),
        (XpbdConfig, {"contact_gap": -0.1}),
    ],
)
def test_settings_that_cannot_be(config: type[NewtonConfig], settings: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(settings))):
        config(**settings)


@needs_newton
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_replayed_graph_does_what_its_launches_do(backend: type[NewtonBackend]) -> None:
    recorded, issued = engine_of(backend, capture=True), engine_of(backend, capture=False)
    for engine in (recorded, issued):
        for steps in (3, 1):
            engine.write_root_state(1, None, torch.tensor([[1.0, 0.2, 0.0, 0.0, 0.0, 2.0]] * 2))
            engine.step(steps)
        engine.set_masses(torch.tensor([3]), torch.tensor([[3.0]]), torch.tensor([1]))
        engine.step(2)
    assert torch.equal(recorded.link_poses, issued.link_poses)
    assert torch.equal(recorded.link_velocities, issued.link_velocities)


@needs_newton
def test_a_full_contact_buffer_is_an_error_that_names_the_remedy() -> None:
    engine = engine_of(FeatherstoneBackend, contacts_per_env=2)
    with pytest.raises(SimulationError, match="contacts_per_env=4"):
        engine.step(2)


@needs_newton
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_joint_is_driven_past_half_a_turn(backend: type[NewtonBackend]) -> None:
    robot = rotor(actuators=(ImplicitPd(joints=(".*",), stiffness=100.0, damping=20.0),))
    joint = replace(robot.articulation.joints[0], type=JointType.REVOLUTE, lower_limit=-0.02, upper_limit=3.75)
    robot = replace(robot, articulation=replace(robot.articulation, joints=(joint,)))
    layout = SceneLayout.of(scene(robot, gravity=WEIGHTLESS, terrain=()))
    engine = backend().create_engine(layout, 2, torch.device("cpu"), backend.config_type())
    engine.write_joint_state(torch.tensor([0]), torch.tensor([[3.0], [3.6]]), torch.zeros(2, 1))
    engine.position_targets.fill_(3.3)
    engine.step(400)
    assert engine.joint_positions[:, 0].tolist() == pytest.approx([3.3, 3.3], abs=2e-3)
