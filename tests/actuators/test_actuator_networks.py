"""Actuator networks: fitted to a known series-elastic model, kept as data, evaluated step by step, and refused."""

from __future__ import annotations

import csv
import math
import runpy
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from orbit_core.actuators import Actuators
from orbit_core.actuators.fitting import FitSettings, fit
from orbit_core.actuators.networks import NetworkDescription, read_network, write_network
from orbit_core.actuators.recordings import QUANTITIES, read_recording
from orbit_core.cli import main
from orbit_core.dynamics.random import RandomStreams
from orbit_core.envs import Environment
from orbit_core.envs.captured_step import CapturedStep
from orbit_core.interfaces import ConfigurationError, NonFiniteError
from orbit_core.scene import ActuatorNetwork, DcMotor, IdealPd, Scene, Transmission, Windings
from orbit_core.tensor_file import write_tensors
from orbit_tasks.velocity_flat import VelocityFlat

SOURCE = Path(__file__).parents[2] / "tools" / "series_elastic.py"
Pendulums = Callable[..., Any]


@dataclass(kw_only=True)
class Learned(VelocityFlat):
    """Velocity-Flat whose robot's hips and thighs are driven by a network, its knees by motors that warm."""

    file: str

    def scene(self) -> Scene:
        scene = super().scene()
        knees = DcMotor(
            joints=(".*_calf_joint",),
            stiffness=40.0,
            damping=1.0,
            saturation_effort=20.0,
            no_load_speed=20.0,
            transmission=Transmission(positions=(-2.0, -1.0), ratios=(1.0, 2.0), rotor_inertia=0.001),
            windings=Windings(motor_constant=2.0, thermal_resistance=2.0, time_constant=0.5),
        )
        drives = (ActuatorNetwork(joints=(".*_(hip|thigh)_joint",), file=self.file), knees)
        return replace(scene, robots=(replace(scene.robots[0], actuators=drives),))


@pytest.fixture(scope="module")
def data() -> dict[str, np.ndarray]:
    """Twenty-five seconds of three series-elastic joints."""
    return runpy.run_path(str(SOURCE))["record"](25.0, joints=3)


@pytest.fixture(scope="module")
def recording(data: dict[str, np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "spring.npz"
    np.savez(path, **data)
    return path


def network(kind: str, tmp_path: Path, rate: float = 200.0, **more: Any) -> Path:
    """A file with a network of random weights; a pendulum's steps come at 200 Hz."""
    torch.manual_seed(1)
    history = (0, 1, 3) if kind == "mlp" else (0,)
    description = NetworkDescription(
        kind=kind, hidden_sizes=(5, 5), history=history, rate=rate, scales=(0.5, 2.0, 3.0), **more
    )
    write_network(tmp_path / "net.safetensors", description.build())
    return tmp_path / "net.safetensors"


def actuators_of(engine: Any) -> Actuators:
    random = RandomStreams(engine.num_envs, 0, engine.device)
    random.reset()
    return Actuators(engine, engine.layout, random)


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_a_fit_is_far_better_than_the_best_pd_law(kind: str, recording: Path) -> None:
    found = fit([read_recording(recording)], FitSettings(kind=kind, passes=80))
    assert found.line_error > 3.0, "a PD law cannot tell what the spring and the motor's limit do"
    assert found.error < 0.6 * found.line_error


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_step_by_step_is_the_whole_sequence_and_a_file_keeps_it(kind: str, tmp_path: Path) -> None:
    path = network(kind, tmp_path)
    module = read_network(path)
    inputs = torch.randn(12, 3, 2)
    past = module.past(3, torch.device("cpu"))
    steps = []
    for now in inputs:
        efforts, past = module.step(now, past)
        steps.append(efforts)
    torch.testing.assert_close(torch.stack(steps), module.sequence(inputs))


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_every_joint_and_environment_has_a_past_of_its_own(kind: str, tmp_path: Path, pendulums: Pendulums) -> None:
    file = str(network(kind, tmp_path))
    groups = (ActuatorNetwork(joints=("joint_[ac]",), file=file), IdealPd(joints=("joint_b",), stiffness=2.0))
    engine = pendulums(groups)
    actuators, module = actuators_of(engine), read_network(Path(file))
    states, targets = torch.randn(8, 2, 2, 3), torch.randn(8, 2, 3)
    given = []
    for (q, v), target in zip(states, targets, strict=True):
        engine.q[:], engine.v[:] = q, v
        actuators.position_targets[:] = target
        actuators.effort_targets[:] = 0.1
        actuators.apply()
        given.append(engine.efforts.clone())
    inputs = torch.stack((targets - states[:, 0], states[:, 1]), -1)[:, :, [0, 2]]
    limits = torch.as_tensor(engine.layout.joint_parameters.effort_limit).float()[[0, 2]]
    expected = (module.sequence(inputs.flatten(1, 2)).view(8, 2, 2) + 0.1).clamp(-limits, limits)
    torch.testing.assert_close(torch.stack(given)[:, :, [0, 2]], expected)
    torch.testing.assert_close(given[0][:, 1], 2.0 * (targets[0] - states[0, 0])[:, 1] + 0.1)
    saved = actuators.save_state()
    actuators.reset(torch.tensor([1]))
    actuators.position_targets[:], engine.q[:], engine.v[:] = targets[0], states[0, 0], states[0, 1]
    actuators.effort_targets[:] = 0.1
    actuators.apply()
    torch.testing.assert_close(engine.efforts[1], given[0][1])
    assert (engine.efforts[0, [0, 2]] - given[0][0, [0, 2]]).abs().max() > 1e-4, "the other environment remembers"
    actuators.load_state(saved)
    assert torch.equal(next(iter(actuators.memory().values())), saved.memory[-1]["past"])
    with pytest.raises(ConfigurationError, match="'joint_a' is driven by a NetworkModel, which has no gains"):
        actuators.set_gains([0], torch.ones(2, 1), torch.ones(2, 1))


def test_a_network_that_does_not_fit_is_refused_in_one_line(tmp_path: Path, pendulums: Pendulums) -> None:
    def refused(path: Path, message: str) -> None:
        engine = pendulums((ActuatorNetwork(joints=("joint_.*",), file=str(path)),))
        with pytest.raises(ConfigurationError, match=message):
            actuators_of(engine)

    refused(network("lstm", tmp_path, rate=400.0), r"fitted at 400 Hz, .* come at 200 Hz: set physics_dt=0\.0025")
    refused(network("mlp", tmp_path, unit="m"), r"positions are in m, and those of joint 'joint_a' are in rad")
    refused(tmp_path / "none.safetensors", "there is no file")
    module = read_network(network("lstm", tmp_path))
    document = {"format": 1, "actuator": {"kind": "lstm", "hidden_sizes": [6, 6], "rate": 200.0}}
    write_tensors(tmp_path / "net.safetensors", document, module.state_dict())
    refused(
        tmp_path / "net.safetensors", r"'memory\.weight_ih_l0' is \[20, 2\], .* hidden sizes \[6, 6\] has \[24, 2\]"
    )
    write_tensors(tmp_path / "net.safetensors", {"format": 1, "policy": {}}, module.state_dict())
    refused(tmp_path / "net.safetensors", "holds no actuator network")
    with pytest.raises(ConfigurationError, match="layers of one size"):
        NetworkDescription(kind="lstm", hidden_sizes=(8, 4), rate=200.0)


def test_recordings_of_three_formats_are_the_same(data: dict[str, np.ndarray], recording: Path, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "spring.h5", "w") as file:
        for name, values in data.items():
            file[name] = values.astype("S") if name == "joints" else values
    columns = [(joint, quantity) for joint in range(3) for quantity in QUANTITIES]
    with (tmp_path / "spring.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *(f"joint_{joint}.{quantity}" for joint, quantity in columns)])
        for step, time in enumerate(data["time"]):
            writer.writerow([time, *(data[quantity][step, joint] for joint, quantity in columns)])
    first = read_recording(recording)
    assert first.rate == pytest.approx(200.0)
    for name in ("spring.h5", "spring.csv"):
        other = read_recording(tmp_path / name)
        assert other.joints == first.joints == ("joint_0", "joint_1", "joint_2")
        torch.testing.assert_close(other.inputs, first.inputs)
        torch.testing.assert_close(other.efforts, first.efforts)


@pytest.mark.parametrize(
    ("change", "kind", "message"),
    [
        ({"effort": None}, ConfigurationError, "lacks effort"),
        (
            {"velocity": np.zeros((5000, 2))},
            ConfigurationError,
            r"velocity is \(5000, 2\), with 5000 times and 3 joints",
        ),
        ({"time": np.arange(5000) ** 1.1}, ConfigurationError, "resample it evenly"),
        ({"time": 1.0 - np.arange(5000.0)}, ConfigurationError, "time does not rise after 1 s"),
        ({"joints": np.array(["a", "b", "a"])}, ConfigurationError, "names a joint twice: a, b, a"),
        ({"position": np.zeros((5000, 3), complex)}, ConfigurationError, "position is of complex128"),
        ({"effort": np.zeros((5000, 3))}, ConfigurationError, "one effort throughout"),
        ({"effort": np.full((5000, 3), np.nan)}, NonFiniteError, "effort is not finite in step 0"),
    ],
)
def test_a_recording_that_cannot_be_is_refused(
    data: dict[str, np.ndarray], tmp_path: Path, change: dict[str, Any], kind: type[Exception], message: str
) -> None:
    changed = {name: value for name, value in {**data, **change}.items() if value is not None}
    np.savez(tmp_path / "bad.npz", **changed)
    with pytest.raises(kind, match=message):
        read_recording(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it is empty"),
        ("garbage", "lacks time"),
        ("time,position,velocity,effort\n0,1,2,3\n", "names no joint"),
        ("time,a.position\n0,1\n0.005\n", "row 2 has 1 values, and the header names 2 columns"),
        ("time,a.position\n0,none\n", "could not convert string to float: 'none'"),
    ],
)
def test_a_table_that_is_broken_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "broken.csv"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        read_recording(path)


def test_what_is_no_archive_is_told_so(tmp_path: Path) -> None:
    path = tmp_path / "text.npz"
    path.write_text("hello")
    with pytest.raises(ConfigurationError, match="is no NPZ archive"):
        read_recording(path)


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_fit_that_would_not_learn_is_refused(rate: float) -> None:
    with pytest.raises(ConfigurationError, match="learning_rate"):
        FitSettings(learning_rate=rate)


def test_the_command_writes_a_file_that_a_world_takes(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], pendulums: Pendulums
) -> None:
    output = tmp_path / "knee.safetensors"
    assert main(["train-actuator", str(recording), "--output", str(output), "--kind", "mlp", "--passes", "2"]) == 0
    told = capsys.readouterr()
    assert "error of the best PD law" in told.out
    assert "no better than a PD law" in told.err
    assert read_network(output).description.fitted_to == ("joint_0", "joint_1", "joint_2")
    assert actuators_of(pendulums((ActuatorNetwork(joints=("joint_.*",), file=str(output)),))).explicit


def test_a_captured_step_is_the_step_that_it_stands_for(tmp_path: Path) -> None:
    file = str(network("lstm", tmp_path))
    environments = []
    for captured in (False, True):
        env = Environment(Learned(file=file, robot="unitree_go2", episode_length=0.2), 3, "mujoco")
        if captured:
            env._closed = CapturedStep(env, compile=False, whole=True)
        env.reset(seed=0)
        environments.append(env)
    torch.manual_seed(0)
    for _ in range(14):
        action = torch.rand(3, 12) - 0.5
        first, second = (env.step(action) for env in environments)
        torch.testing.assert_close(second[0]["policy"], first[0]["policy"])
    pasts = [next(v for n, v in env.world.memory().items() if n.startswith("past of")) for env in environments]
    torch.testing.assert_close(pasts[1], pasts[0])
    heat = [env.world.robots["robot"].motor_temperatures for env in environments]
    torch.testing.assert_close(heat[1], heat[0])
    assert (heat[0] > 25.0).any(1).all()
    for env in environments:
        env.close()
